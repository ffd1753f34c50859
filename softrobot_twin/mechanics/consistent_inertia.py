"""Inertia of a body whose mass is where it is: M of Coevoet 2017, eq. (1), by shape functions.

    M_ab = ∫ρ N_a N_b dV 1

Every element's M is its mass times the same small matrix, exactly integrated, and all three
directions are alike: only one number a pair of nodes is stored.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from scipy.sparse import coo_array

from softrobot_twin.mechanics.gravity import borne_masses
from softrobot_twin.mechanics.nodal_masses import add_multiples, mass_shares
from softrobot_twin.mechanics.remembered_nodes import RememberedNodes


@njit(cache=True, nogil=True, error_model="numpy")
def accelerate(x, nodes, start, start_velocities, per_second, accelerations):
    """a = ((x - x₀)/h - v₀)/h, with 1/h as `per_second`."""
    for k in range(len(nodes)):
        for i in range(3):
            speed = (x[nodes[k], i] - start[k, i]) * per_second
            accelerations[k, i] = (speed - start_velocities[k, i]) * per_second


@njit(cache=True, nogil=True, error_model="numpy")
def subtract_product(row_starts, columns, values, accelerations, unknowns, forces):
    """f -= M a, M in compressed rows."""
    for k in range(len(unknowns)):
        x = y = z = 0.0
        for entry in range(row_starts[k], row_starts[k + 1]):
            value, column = values[entry], columns[entry]
            x += value * accelerations[column, 0]
            y += value * accelerations[column, 1]
            z += value * accelerations[column, 2]
        forces[unknowns[k], 0] -= x
        forces[unknowns[k], 1] -= y
        forces[unknowns[k], 2] -= z


class ConsistentInertia(RememberedNodes):
    """Force term -M ((q - q₀)/h - v₀)/h of a body, backward Euler as in eqs. (5-8).

    Nodes that are not free count as unaccelerated: one that is moved from outside drags no mass of
    its neighbours along.
    """

    name = "consistent inertia"

    def __init__(
        self, mesh, free_index: np.ndarray, density: float, free_nodes: np.ndarray
    ):
        """Sum the mass matrix.

        Args:
            mesh: The body at rest, a `TetMesh` or a `QuadraticMesh`.
            free_index: Free-node index of each node, -1 where it is fixed, shape (node_count,).
            density: Mass per volume [kg/m³], positive.
            free_nodes: The body's nodes that move, shape (body_free_node_count,).

        Raises:
            ValueError: The density is not positive and finite.
        """
        if not 0.0 < density < np.inf:
            raise ValueError(f"density must be positive and finite, not {density} kg/m³")
        self._stencils = free_index[mesh.cells]
        super().__init__(free_nodes, free_index[free_nodes])
        self._borne_masses = borne_masses(mesh, density)[self._nodes]
        M = _scalar_mass_matrix(mesh, density)[self._nodes][:, self._nodes].tocsr()
        self._row_starts, self._columns, self._values = M.indptr, M.indices, M.data
        self._lower_values = self._offsets = self._strides = None
        self._accelerations = np.zeros((len(self._nodes), 3))

    def stencils(self) -> np.ndarray:
        """Free nodes that each element couples, -1 where fixed, shape (tet_count, 4 or 10)."""
        return self._stencils

    def bind(self, elimination_rank: np.ndarray, slots) -> None:
        """Look up where the lower blocks are."""
        counts = np.diff(self._row_starts)
        rows = np.repeat(self._unknowns, counts)
        columns = self._unknowns[self._columns]
        lower = elimination_rank[rows] >= elimination_rank[columns]
        self._lower_values = self._values[lower]
        self._offsets, self._strides = slots(rows[lower], columns[lower])

    def add_forces(self, positions: np.ndarray, forces: np.ndarray) -> int:
        """Add -M ((q - q₀)/h - v₀)/h [N] to the forces; it inverts no element.

        Args:
            positions: Node positions q [m], shape (node_count, 3).
            forces: Forces on the free nodes [N], shape (free_node_count, 3); added to.
        """
        accelerate(
            positions, self._nodes, self._start, self._start_velocities, self._per_second,
            self._accelerations,
        )  # fmt: skip
        subtract_product(
            self._row_starts, self._columns, self._values, self._accelerations,
            self._unknowns, forces,
        )  # fmt: skip
        return 0

    def add(self, positions, forces, storage, projected: bool) -> None:
        """Add the forces, and M/h² to the system matrix.

        Args:
            positions: Node positions q [m], shape (node_count, 3).
            forces: Forces on the free nodes [N], shape (free_node_count, 3); added to.
            storage: The factorization's storage [N/m]; added to.
            projected: Of no effect: M is positive definite.
        """
        self.add_forces(positions, forces)
        factor = self._per_second**2
        add_multiples(self._lower_values, factor, self._offsets, self._strides, storage)

    def momentum(self, velocities: np.ndarray) -> np.ndarray:
        """∫ρ v dV [kg m/s], shape (3,), with what the free nodes move.

        Args:
            velocities: Velocities of the free nodes [m/s], shape (free_node_count, 3).
        """
        return self._borne_masses @ velocities[self._unknowns]

    def kinetic_energy(self, velocities: np.ndarray) -> float:
        """½ ∫ρ ‖v‖² dV [J].

        Args:
            velocities: Velocities of the free nodes [m/s], shape (free_node_count, 3).
        """
        moving = velocities[self._unknowns]
        minus_momenta = np.zeros_like(velocities, dtype=float)
        subtract_product(
            self._row_starts, self._columns, self._values, moving, self._unknowns, minus_momenta
        )
        return float(-0.5 * np.sum(moving * minus_momenta[self._unknowns]))


def _scalar_mass_matrix(mesh, density: float):
    """∫ρ N_a N_b dV [kg] over all nodes, sparse, shape (node_count, node_count)."""
    width = mesh.cells.shape[1]
    values = np.multiply.outer(density * mesh.volumes, mass_shares(mesh))
    rows, columns = np.repeat(mesh.cells, width, axis=1), np.tile(mesh.cells, (1, width))
    shape = (mesh.node_count, mesh.node_count)
    return coo_array((values.ravel(), (rows.ravel(), columns.ravel())), shape=shape).tocsr()
