"""Mass of deformable bodies and point masses: its distribution, its inertia, and mass damping.

Terms of motion remember the state at the beginning of the step. With the unknown q, the state q₀
and v₀ at the beginning, and the time step h, backward Euler has v = (q - q₀)/h (Coevoet 2017,
eqs. 5-8).
A diagonal mass matrix gives

    f = -c m ((q - q₀)/h - v₀),    -∂f/∂q = c m / h,

where c is 1/h for inertia. Mass damping has c = α and v₀ = 0. A consistent mass matrix,
M_ab = ∫ρ N_a N_b dV 1, gives f = -M ((q - q₀)/h - v₀)/h and the stiffness M/h². M of each element
is its mass times one small matrix, integrated exactly, the same in all three directions: one number
for each pair of nodes is stored.

Arguments of the kernels here:
    accelerations, start, start_velocities: a [m/s²], x₀ [m] and v₀ [m/s], shape (mass_count, 3).
    columns, values: Of M in compressed rows, shape (entry_count,).
    forces: On the unknowns [N], shape (free_node_count, 3); added to.
    masses, nodes, unknowns: Mass [kg], node and unknown of each, shape (mass_count,).
    offsets, strides: Places of the blocks in storage, shape (block_count,).
    row_starts: First entry of each row, shape (mass_count + 1,).
    storage: The factorization's storage [N/m], shape (size,); added to.
    x: Node positions [m], shape (node_count, 3).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.sparse import coo_array, csr_array, diags
from scipy.sparse.linalg import splu

from softrobot_twin.geometry.cell_mesh import CellBlock
from softrobot_twin.geometry.quadrature import tetrahedron_rule
from softrobot_twin.geometry.shape_functions import EDGES
from softrobot_twin.kernels.compilation import KERNEL, njit
from softrobot_twin.mechanics.force_term import ForceTerm, InertiaTerm, OwnBlocks


class RememberedNodes(ForceTerm):
    """Moving nodes whose state at the beginning of the step is remembered.

    Before the first step, and in a step of infinite duration (statics), the forces are zero.
    """

    remembers_start = True

    def __init__(self, nodes: np.ndarray, unknowns: np.ndarray):
        """Take the nodes.

        Args:
            nodes: Their rows among the positions, shape (count,).
            unknowns: Their free-node indices, shape (count,).
        """
        self._nodes = np.array(nodes, dtype=np.int64)
        self._unknowns = np.array(unknowns, dtype=np.int64)
        self._start, self._start_velocities = np.zeros((2, len(self._nodes), 3))
        self._per_second = 0.0

    def begin_step(self, positions: np.ndarray, velocities: np.ndarray, time_step: float) -> None:
        """Remember the state at the beginning of the step.

        Args:
            positions: Node positions q₀ [m], shape (node_count, 3).
            velocities: Velocities v₀ of the free nodes [m/s], shape (free_node_count, 3).
            time_step: h [s].
        """
        # What is out of range is not clipped, but refused where the nodes are given; numpy is faster so.
        positions.take(self._nodes, axis=0, out=self._start, mode="clip")
        velocities.take(self._unknowns, axis=0, out=self._start_velocities, mode="clip")
        self._per_second = 1.0 / time_step


def mass_shares(mesh) -> np.ndarray:
    """The mass matrix of a tetrahedron of unit mass, ∫N_a N_b dV / V, a row for each of its nodes.

    Edges are straight, so it is the same for all of them:  ∫Π L_iⁿⁱ dV = 6 V Π nᵢ! / (Σ nᵢ + 3)!
    Of other functions than the linear and quadratic ones, the products are integrated by a rule of
    degree five.

    Args:
        mesh: A `CellMesh`; only the kind of its elements matters.
    """
    node_count = mesh.cells.shape[1]
    if node_count not in (4, 10):
        rule = tetrahedron_rule(5)
        values = mesh.shape_functions.values(rule.points)
        return 6.0 * values.T @ (rule.weights[:, None] * values)
    if node_count == 4:
        return (np.ones((4, 4)) + np.eye(4)) / 20.0
    shared = (EDGES[:, None, :, None] == EDGES[None, :, None, :]).sum(axis=(2, 3))
    touches = np.any(EDGES[None] == np.arange(4)[:, None, None], axis=2)
    shares = np.empty((10, 10))
    shares[:4, :4] = np.ones((4, 4)) + 5.0 * np.eye(4)
    shares[:4, 4:] = np.where(touches, -4.0, -6.0)
    shares[4:, :4] = shares[:4, 4:].T
    shares[4:, 4:] = np.array([8.0, 16.0, 32.0])[shared]
    return shares / 420.0


def lumped_masses(mesh, density) -> np.ndarray:
    """Mass of a body distributed over its nodes, all shares positive [kg], shape (node_count,).

    Each element's mass is divided in proportion to the diagonal of its mass matrix (Hinton, Rock
    and Zienkiewicz 1976). The row sums, see `borne_masses`, are negative at the corners of
    quadratic tetrahedra; in linear ones both are a quarter.

    Args:
        mesh: The body, a `CellMesh`.
        density: Mass per volume [kg/m³], of all cells or of each, shape (cell_count,).
    """
    return _summed(mesh, density, _lumped_shares)


def borne_masses(mesh, density, lumped=None) -> np.ndarray:
    """Mass whose weight acts at each node, ∫ρ N dV [kg], shape (node_count,).

    Args:
        mesh: The body, a `CellMesh`.
        density: Mass per volume [kg/m³], of all cells or of each, shape (cell_count,).
        lumped: Elements whose mass is lumped, shape (element_count,) of bool; none when left out.
    """
    return _summed(mesh, density, lambda block: block.load_shares, lumped)


def _summed(mesh, density, shares_of: Callable, lumped=None) -> np.ndarray:
    """Sum of the masses that cells give to their nodes [kg], shape (node_count,).

    Args:
        mesh: The body, a `CellMesh`.
        density: Mass per volume [kg/m³], of all cells or of each, shape (cell_count,).
        shares_of: Gives the shares of the nodes of a block, the same for all cells or of each.
        lumped: Elements that are divided by `_lumped_shares` instead; none when left out.
    """
    total = np.zeros(mesh.node_count)
    for block in mesh.blocks():
        masses = (_of_cells(density, block) * block.volumes)[:, None]
        own = masses * shares_of(block)
        if lumped is not None:
            is_lumped = lumped[block.places]
            own[is_lumped] = (masses * _lumped_shares(block))[is_lumped]
        total += np.bincount(block.mesh.cells.ravel(), own.ravel(), mesh.node_count)
    return total


def _of_cells(density, block: CellBlock):
    """The density of a block's cells, or that of all [kg/m³]."""
    return density[block.places] if np.ndim(density) else density


def _block_shares(block: CellBlock) -> np.ndarray:
    """∫N_a N_b dV / V, of all cells or of each."""
    return mass_shares(block.mesh) if block.mass_shares is None else block.mass_shares


def _lumped_shares(block: CellBlock) -> np.ndarray:
    """Shares of a cell's mass in proportion to the diagonal of its mass matrix."""
    diagonal = np.diagonal(_block_shares(block), axis1=-2, axis2=-1)
    return diagonal / diagonal.sum(axis=-1, keepdims=True)


def coupled_to(mesh, nodes: np.ndarray) -> np.ndarray:
    """Elements that have one of some nodes, shape (element_count,) of bool.

    Where nodes are attached to a free rigid body, their mass is added to the body, and the mass of
    these elements is lumped: a consistent mass matrix would couple the nodes to their neighbours,
    and this part of the momentum would be lost.

    Args:
        mesh: The mesh.
        nodes: Numbers of the nodes, shape (count,).
    """
    return np.isin(mesh.cells, nodes).any(axis=1)


def uniform_masses(mesh, density) -> np.ndarray:
    """A body's mass in equal shares for all its points, including fixed ones [kg], shape (node_count,).

    The total mass is right, the centre of mass is not: the body is heavier where nodes are close
    together. Scenes written for other software distribute mass in this way.

    Args:
        mesh: The body, a `CellMesh`.
        density: Mass per volume [kg/m³], of all cells or of each, shape (cell_count,).
    """
    total = np.sum(density * mesh.volumes) if np.ndim(density) else density * np.sum(mesh.volumes)
    return np.full(mesh.node_count, total / mesh.node_count)


@njit(**KERNEL)
def _add_pulls(x, nodes, unknowns, masses, start, start_velocities, per_second, rate, forces):
    """f -= c m ((x - x₀)/h - v₀), with 1/h as `per_second` and c as `rate`."""
    for k in range(len(nodes)):
        pull = rate * masses[k]
        for i in range(3):
            speed = (x[nodes[k], i] - start[k, i]) * per_second - start_velocities[k, i]
            forces[unknowns[k], i] -= pull * speed


@njit(**KERNEL)
def _add_multiples(values, factor, offsets, strides, storage):
    """Add a multiple of the unit matrix to each block."""
    for k in range(len(values)):
        value, step = factor * values[k], strides[k] + 1
        storage[offsets[k]] += value
        storage[offsets[k] + step] += value
        storage[offsets[k] + 2 * step] += value


class NodalMasses(RememberedNodes, OwnBlocks):
    """Masses at moving nodes whose state at the beginning of the step is remembered.

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
        """
        super().__init__(nodes, unknowns)
        self.masses = np.array(masses, dtype=float)
        self._stencils = self._unknowns[:, None]

    def add_forces(self, positions: np.ndarray, forces: np.ndarray) -> int:
        """Add -c m ((q - q₀)/h - v₀) [N] to the forces; it inverts no element.

        Args:
            positions: Node positions q [m], shape (node_count, 3).
            forces: Forces on the free nodes [N], shape (free_node_count, 3); added to.
        """
        _add_pulls(
            positions, self._nodes, self._unknowns, self.masses, self._start,
            self._start_velocities, self._per_second, self.rate, forces,
        )  # fmt: skip
        return 0

    def add_stiffness(self, positions, storage, projected: bool) -> None:
        """Add c m / h to the system matrix.

        Args:
            positions: Node positions q [m], shape (node_count, 3).
            storage: The factorization's storage [N/m]; added to.
            projected: Of no effect: masses are never negative.
        """
        factor = self.rate * self._per_second
        _add_multiples(self.masses, factor, self._offsets, self._strides, storage)


class LumpedInertia(NodalMasses, InertiaTerm):
    """Force term -M w ((q - q₀)/h - v₀)/h of masses at nodes, backward Euler as in eqs. (5-8).

    A body of quadratic tetrahedra whose inertia is lumped must have its weight at the same masses.
    Consistent weights of its corners are negative, and its nodes would fall apart under them.
    """

    name = "lumped inertia"
    is_traceable = True

    @property
    def rate(self) -> float:
        """w/h [1/s]."""
        return self._per_second * self.weight

    def add_accelerations(self, positions, forces, accelerations) -> None:
        """Add M⁻¹ f; see `InertiaTerm`."""
        accelerations[self._unknowns] += forces[self._unknowns] / self.masses[:, None]

    def momentum(self, velocities: np.ndarray) -> np.ndarray:
        """Σ m v [kg m/s], shape (3,).

        Args:
            velocities: Velocities of the free nodes [m/s], shape (free_node_count, 3).
        """
        return self.masses @ velocities[self._unknowns]

    def kinetic_energy(self, positions: np.ndarray, velocities: np.ndarray) -> float:
        """½ Σ m ‖v‖² [J]; see `ForceTerm.kinetic_energy`."""
        return float(0.5 * self.masses @ np.sum(velocities[self._unknowns] ** 2, axis=1))


class MassDamping(NodalMasses):
    """Force term -α M (q - q₀)/h of masses at nodes.

    It resists all motion against the world, including rigid motion. With inertia it is the first
    part of Rayleigh damping; without inertia it gives first-order motion towards equilibrium.

    Attributes:
        rate: α [1/s].
    """

    name = "mass damping"
    is_traceable = True

    def __init__(self, nodes: np.ndarray, unknowns: np.ndarray, masses: np.ndarray, rate: float):
        """Take the masses and the rate.

        Args:
            nodes: Their rows among the positions, shape (mass_count,).
            unknowns: Their free-node indices, shape (mass_count,).
            masses: [kg], shape (mass_count,).
            rate: α [1/s], not negative.
        """
        super().__init__(nodes, unknowns, masses)
        self.rate = float(rate)

    def begin_step(self, positions: np.ndarray, velocities: np.ndarray, time_step: float) -> None:
        """Remember the positions at the beginning of the step.

        Args:
            positions: Node positions q₀ [m], shape (node_count, 3).
            velocities: Not used: the drag is that of the velocity at the end of the step.
            time_step: h [s].
        """
        np.take(positions, self._nodes, axis=0, out=self._start, mode="clip")
        self._per_second = 1.0 / time_step


@njit(**KERNEL)
def _accelerate(x, nodes, start, start_velocities, per_second, accelerations):
    """a = ((x - x₀)/h - v₀)/h, with 1/h as `per_second`."""
    for k in range(len(nodes)):
        for i in range(3):
            speed = (x[nodes[k], i] - start[k, i]) * per_second
            accelerations[k, i] = (speed - start_velocities[k, i]) * per_second


@njit(**KERNEL)
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


class ConsistentInertia(RememberedNodes, InertiaTerm):
    """Force term -M w ((q - q₀)/h - v₀)/h of a body, backward Euler as in eqs. (5-8).

    Nodes that are not free count as unaccelerated: a guided node does not accelerate the mass of
    its neighbours.
    """

    name = "consistent inertia"

    def __init__(
        self, mesh, free_index: np.ndarray, density, free_nodes: np.ndarray, lumped=None, free_axes=None
    ):
        """Sum the mass matrix.

        Args:
            mesh: The body at rest, a `CellMesh`.
            free_index: Free-node index of each node, -1 where it is fixed, shape (node_count,).
            density: Mass per volume [kg/m³], positive, of all cells or of each, shape
                (cell_count,).
            free_nodes: The body's nodes that move, shape (body_free_node_count,).
            lumped: Elements whose mass is lumped, shape (element_count,) of bool; none when left
                out.
            free_axes: See `Nodes.free_axes`.
        """
        self._stencils = free_index[mesh.cells]
        super().__init__(free_nodes, free_index[free_nodes])
        self._borne_masses = borne_masses(mesh, density, lumped)[self._nodes]
        M = scalar_mass_matrix(mesh, density, lumped)[self._nodes][:, self._nodes].tocsr()
        self._row_starts, self._columns, self._values = M.indptr, M.indices, M.data
        self._lower_values = self._offsets = self._strides = None
        self._accelerations = np.zeros((len(self._nodes), 3))
        self._free_axes = np.ones((len(self._nodes), 3)) if free_axes is None else free_axes[self._unknowns]
        self._mass_factors = None

    def bind(self, elimination_rank: np.ndarray, slots) -> None:
        """Find the places of the lower blocks."""
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
        _accelerate(
            positions, self._nodes, self._start, self._start_velocities, self._per_second,
            self._accelerations,
        )  # fmt: skip
        if self.weight != 1.0:
            self._accelerations *= self.weight
        subtract_product(
            self._row_starts, self._columns, self._values, self._accelerations,
            self._unknowns, forces,
        )  # fmt: skip
        return 0

    def add_stiffness(self, positions, storage, projected: bool) -> None:
        """Add M/h² to the system matrix.

        Args:
            positions: Node positions q [m], shape (node_count, 3).
            storage: The factorization's storage [N/m]; added to.
            projected: Of no effect: M is positive definite.
        """
        factor = self._per_second**2 * self.weight
        _add_multiples(self._lower_values, factor, self._offsets, self._strides, storage)

    def add_accelerations(self, positions, forces, accelerations) -> None:
        """Add M⁻¹ f; see `InertiaTerm`. M is factorized when it is needed first."""
        if self._mass_factors is None:
            count, free_axes = len(self._nodes), self._free_axes
            M = csr_array((self._values, self._columns, self._row_starts), shape=(count, count))
            # Axes along which the same nodes are free have the same factor.
            self._mass_factors = []
            for free in np.unique(free_axes, axis=1).T:
                axes, D = np.flatnonzero((free_axes == free[:, None]).all(axis=0)), diags(free)
                self._mass_factors.append((axes, splu((D @ M @ D + diags(1.0 - free)).tocsc())))
        for axes, factor in self._mass_factors:
            own = np.ix_(self._unknowns, axes)
            accelerations[own] += factor.solve(forces[own])

    def momentum(self, velocities: np.ndarray) -> np.ndarray:
        """∫ρ v dV [kg m/s], shape (3,), of the free nodes.

        Args:
            velocities: Velocities of the free nodes [m/s], shape (free_node_count, 3).
        """
        return self._borne_masses @ velocities[self._unknowns]

    def kinetic_energy(self, positions: np.ndarray, velocities: np.ndarray) -> float:
        """½ ∫ρ ‖v‖² dV [J]; see `ForceTerm.kinetic_energy`."""
        moving = velocities[self._unknowns]
        minus_momenta = np.zeros_like(velocities, dtype=float)
        subtract_product(
            self._row_starts, self._columns, self._values, moving, self._unknowns, minus_momenta
        )
        return float(-0.5 * np.sum(moving * minus_momenta[self._unknowns]))


def scalar_mass_matrix(mesh, density, lumped=None):
    """∫ρ N_a N_b dV [kg] over all nodes, sparse, shape (node_count, node_count).

    Args:
        mesh: The body, a `CellMesh`.
        density: Mass per volume [kg/m³], of all cells or of each, shape (cell_count,).
        lumped: See `borne_masses`.
    """
    parts = []
    for block in mesh.blocks():
        cells, width = block.mesh.cells, block.mesh.cells.shape[1]
        masses = (_of_cells(density, block) * block.volumes)[:, None, None]
        values = masses * _block_shares(block)
        if lumped is not None:
            own = lumped[block.places]
            diagonal = _lumped_shares(block)[..., None] * np.eye(width)
            values[own] = (masses * diagonal)[own]
        rows, columns = np.repeat(cells, width, axis=1), np.tile(cells, (1, width))
        parts.append((values.ravel(), rows.ravel(), columns.ravel()))
    values, rows, columns = (np.concatenate(column) for column in zip(*parts, strict=True))
    shape = (mesh.node_count, mesh.node_count)
    return coo_array((values, (rows, columns)), shape=shape).tocsr()
