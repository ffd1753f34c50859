"""Mass at the nodes: how a body's is shared out, and what masses that remember a step do.

A term of dynamics looks back at where its nodes were when the step began. With the unknown q, what
it began with, q₀ and v₀, and the time step h, backward Euler says v = (q - q₀)/h. A diagonal mass
matrix then pulls with

    f = -c m ((q - q₀)/h - v₀),    -∂f/∂q = c m / h

where c is 1/h for inertia, and a rate for damping, which knows no v₀.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from softrobot_twin.mechanics.remembered_nodes import RememberedNodes


def mass_shares(mesh) -> np.ndarray:
    """The mass matrix of a tetrahedron of unit mass, ∫N_a N_b dV / V, shape (4, 4) or (10, 10).

    Edges are straight, so it is the same for all of them:  ∫Π L_iⁿⁱ dV = 6 V Π nᵢ! / (Σ nᵢ + 3)!

    Args:
        mesh: A `TetMesh` or a `QuadraticMesh`; only the kind matters.
    """
    if mesh.cells.shape[1] == 4:
        return (np.ones((4, 4)) + np.eye(4)) / 20.0
    from softrobot_twin.geometry.shape_functions import EDGES

    shared = (EDGES[:, None, :, None] == EDGES[None, :, None, :]).sum(axis=(2, 3))
    touches = np.any(EDGES[None] == np.arange(4)[:, None, None], axis=2)
    shares = np.empty((10, 10))
    shares[:4, :4] = np.ones((4, 4)) + 5.0 * np.eye(4)
    shares[:4, 4:] = np.where(touches, -4.0, -6.0)
    shares[4:, :4] = shares[:4, 4:].T
    shares[4:, 4:] = np.array([8.0, 16.0, 32.0])[shared]
    return shares / 420.0


def lumped_masses(mesh, density: float) -> np.ndarray:
    """A body's mass shared out among its nodes, all shares positive [kg], shape (node_count,).

    Each element's mass is divided in proportion to the diagonal of its mass matrix (Hinton, Rock
    and Zienkiewicz 1976). The rows' sums, which `borne_masses` gives, are negative at the corners
    of quadratic tetrahedra; in linear ones both are a quarter.

    Args:
        mesh: The body, a `TetMesh` or a `QuadraticMesh`.
        density: Mass per volume [kg/m³].
    """
    diagonal = np.diagonal(mass_shares(mesh))
    shares = np.outer(density * mesh.volumes, diagonal / diagonal.sum())
    return np.bincount(mesh.cells.ravel(), weights=shares.ravel(), minlength=mesh.node_count)


def uniform_masses(mesh, density: float) -> np.ndarray:
    """A body's mass, the same at every node, fixed ones too [kg], shape (node_count,).

    It has the body's mass, not its centre of mass: where nodes are close together, the body is
    heavier. It is there because scenes written for other software are made so.

    Args:
        mesh: The body, a `TetMesh` or a `QuadraticMesh`.
        density: Mass per volume [kg/m³].
    """
    return np.full(mesh.node_count, density * np.sum(mesh.volumes) / mesh.node_count)


@njit(cache=True, nogil=True, error_model="numpy")
def add_pulls(x, nodes, unknowns, masses, start, start_velocities, per_second, rate, forces):
    """f -= c m ((x - x₀)/h - v₀), with 1/h as `per_second` and c as `rate`."""
    for k in range(len(nodes)):
        pull = rate * masses[k]
        for i in range(3):
            speed = (x[nodes[k], i] - start[k, i]) * per_second - start_velocities[k, i]
            forces[unknowns[k], i] -= pull * speed


@njit(cache=True, nogil=True, error_model="numpy")
def add_multiples(values, factor, offsets, strides, storage):
    """Add a multiple of the unit matrix to each block."""
    for k in range(len(values)):
        value, step = factor * values[k], strides[k] + 1
        storage[offsets[k]] += value
        storage[offsets[k] + step] += value
        storage[offsets[k] + 2 * step] += value


class NodalMasses(RememberedNodes):
    """Masses at nodes that move, and remember where they were when the step began.

    Attributes:
        masses: Mass at each node [kg], shape (mass_count,).
        rate: c [1/s].
    """

    name: str
    rate: float

    def __init__(self, nodes: np.ndarray, unknowns: np.ndarray, masses: np.ndarray):
        """Put the masses at the nodes.

        Args:
            nodes: Their rows among the positions, shape (mass_count,).
            unknowns: Their free-node indices, shape (mass_count,).
            masses: [kg], shape (mass_count,).

        Raises:
            ValueError: A mass is not positive, a node is not free, or the counts differ.
        """
        super().__init__(nodes, unknowns)
        self.masses = np.array(masses, dtype=float)
        if not self._nodes.shape == self._unknowns.shape == self.masses.shape == (len(masses),):
            raise ValueError(
                f"nodes of shape {self._nodes.shape}, unknowns {self._unknowns.shape} "
                f"and masses {self.masses.shape} [kg] do not go together"
            )
        if not np.all((self.masses > 0.0) & np.isfinite(self.masses)):
            raise ValueError("masses must be positive and finite [kg]")
        if np.any(self._unknowns < 0):
            raise ValueError("a node that does not move cannot bear a mass that does")
        self._offsets = self._strides = None

    def stencils(self) -> np.ndarray:
        """Every mass is coupled to itself only, shape (mass_count, 1)."""
        return self._unknowns[:, None]

    def bind(self, elimination_rank: np.ndarray, slots) -> None:
        """Look up where the diagonal blocks are."""
        self._offsets, self._strides = slots(self._unknowns, self._unknowns)

    def add_forces(self, positions: np.ndarray, forces: np.ndarray) -> int:
        """Add -c m ((q - q₀)/h - v₀) [N] to the forces; it inverts no element.

        Args:
            positions: Node positions q [m], shape (node_count, 3).
            forces: Forces on the free nodes [N], shape (free_node_count, 3); added to.
        """
        add_pulls(
            positions, self._nodes, self._unknowns, self.masses, self._start,
            self._start_velocities, self._per_second, self.rate, forces,
        )  # fmt: skip
        return 0

    def add(self, positions, forces, storage, projected: bool) -> None:
        """Add the forces, and c m / h to the system matrix.

        Args:
            positions: Node positions q [m], shape (node_count, 3).
            forces: Forces on the free nodes [N], shape (free_node_count, 3); added to.
            storage: The factorization's storage [N/m]; added to.
            projected: Of no effect: masses are never negative.
        """
        self.add_forces(positions, forces)
        factor = self.rate * self._per_second
        add_multiples(self.masses, factor, self._offsets, self._strides, storage)
