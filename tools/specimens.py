"""Test pieces of rubber without a scene: a mesh of one hyperelastic law, held, loaded and solved.

Published problems prescribe what scenes have no entry for: tractions and symmetry planes. Here
force terms are summed and factorized as in a step, by plain Newton iterations with exact tangents,
and the size of each correction is kept, so that the order of convergence can be seen.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations
from time import thread_time
from typing import NamedTuple

import numpy as np

from softrobot_twin.errors import SoftRobotTwinError
from softrobot_twin.geometry.box_mesh import read_box
from softrobot_twin.geometry.hexahedral_mesh import INTO_TETS, HexahedralMesh
from softrobot_twin.geometry.quadratic_mesh import add_mid_edge_nodes
from softrobot_twin.geometry.smoothed_mesh import smooth
from softrobot_twin.geometry.tet_mesh import TetMesh
from softrobot_twin.mechanics.elements import Elements
from softrobot_twin.mechanics.force_term import ForceTerm
from softrobot_twin.mechanics.patch_volumes import (
    PatchVolumes,
    divided,
    element_bulk,
    patched_cells,
)
from softrobot_twin.mechanics.stencil import bind_stencils, stencil_pairs
from softrobot_twin.solvers.multifrontal import Multifrontal

# Stiffness of a roller, by the largest stiffness of a node.
ROLLER = 1.0e6
# Shortest share of a move that is tried, and moves of one load at most.
LEAST_SHARE, MOST_MOVES = 1.0e-3, 60
# A residual below this share of the largest force of an element is converged; so is one that stays
# below a multiple of it.
CONVERGED = 1.0e-11


class NotSolved(SoftRobotTwinError):
    """A test piece has no equilibrium near its last one, or none was found."""


class Rollers(ForceTerm):
    """Holds coordinates of nodes at their places at rest, by springs that are very stiff."""

    name = "rollers"

    def __init__(self, rest: np.ndarray, free_index: np.ndarray, held: np.ndarray, stiffness: float):
        """Take the nodes.

        Args:
            rest: Node positions at rest [m], shape (node_count, 3).
            free_index: Unknown of each node, -1 where it is fixed, shape (node_count,).
            held: Which coordinates are held, shape (node_count, 3) of bool.
            stiffness: Of each spring [N/m].
        """
        self._nodes = np.flatnonzero(held.any(axis=1) & (free_index >= 0))
        self._free = free_index[self._nodes]
        self._stiffness = stiffness * held[self._nodes]
        self._rest = rest[self._nodes]

    def stencils(self) -> np.ndarray:
        """One node each."""
        return self._free[:, None]

    def bind(self, elimination_rank: np.ndarray, slots) -> None:
        """See `ForceTerm.bind`."""
        bound = bind_stencils(self.stencils(), elimination_rank, slots)
        self._places = bound.offsets + np.arange(3) * (bound.strides + 1)

    def add_forces(self, positions: np.ndarray, forces: np.ndarray) -> int:
        """See `ForceTerm.add_forces`."""
        forces[self._free] -= self._stiffness * (positions[self._nodes] - self._rest)
        return 0

    def add(self, positions, forces, storage, projected: bool) -> None:
        """See `ForceTerm.add`."""
        self.add_forces(positions, forces)
        storage[self._places] += self._stiffness


class Times(NamedTuple):
    """Time of one Newton iteration [s].

    Attributes:
        assembly: Forces and stiffness of all terms.
        factor: Factorization and solution.
    """

    assembly: float
    factor: float


def coupled_pairs(terms: list[ForceTerm]) -> tuple[np.ndarray, np.ndarray]:
    """All pairs of unknowns that terms couple, as rows and columns.

    Args:
        terms: The terms.
    """
    pairs = [stencil_pairs(term.stencils()) for term in terms]
    rows, columns = zip(*pairs, strict=True)
    return np.concatenate(rows), np.concatenate(columns)


class Specimen:
    """A body of one law, and what holds and loads it.

    Attributes:
        mesh: Its mesh.
        law: Parameters of its law.
        terms: Force terms, elements first.
        volumes: The term of its patches; None without patches.
        positions: Node positions [m], shape (node_count, 3).
        residuals: Largest residual before each iteration of the last solution [N].
        decrements: √|r·dx| of each iteration, r the residual and dx the correction [J^½]: twice its
            square is the energy that the iteration promises to gain.
        unknowns: Number of scalar unknowns.
    """

    def __init__(
        self, mesh, law, fixed, held=None, by_patches: bool = True,
        patch_size: int | None = None, share: float | None = None,
    ):  # fmt: skip
        """Build and bind the terms.

        Args:
            mesh: A mesh of cells of one kind.
            law: Parameters with a `shear_modulus` and a `bulk_modulus`.
            fixed: Nodes that are fixed, of bool, shape (node_count,).
            held: Coordinates that rollers hold, of bool, shape (node_count, 3); None for none.
            by_patches: Whether volumes are kept by patches, or by every element.
            patch_size: Tetrahedra of a patch; by default that of `PATCH_SIZES`.
            share: Bulk modulus that elements keep, by the shear modulus; by default `element_bulk`.
        """
        self.mesh, rest = mesh, mesh.node_positions
        free = np.flatnonzero(~np.asarray(fixed))
        free_index = np.full(len(rest), -1)
        free_index[free] = np.arange(len(free))
        self._free, self._rest, self.law = free, rest, law
        block = mesh.strained_blocks()[0].mesh
        self.volumes = None
        of_elements = law
        if by_patches:
            of_elements, rest_bulk = divided(
                law, law.shear_modulus, element_bulk(block) if share is None else share
            )
            self._patched = patched_cells(block, patch_size)
            self.volumes = PatchVolumes(
                self._patched.mesh, free_index, rest_bulk, self._patched.patches
            )
        self.elements = Elements(block, free_index, of_elements)
        self.terms: list[ForceTerm] = [self.elements]
        if self.volumes is not None:
            self.terms.append(self.volumes)
        scale = law.shear_modulus * np.cbrt(mesh.volumes.mean())
        # What rollers bear, and the round-off of these large springs, is no residual.
        self._counts = np.ones((len(free), 3), bool) if held is None else ~held[free]
        if held is not None:
            self.terms.append(Rollers(rest, free_index, held, ROLLER * scale))
        self.matrix = Multifrontal(*coupled_pairs(self.terms), len(free), rest[free])
        for term in self.terms:
            term.bind(self.matrix.elimination_rank, self.matrix.slots)
        self.positions, self.residuals, self.decrements = rest.copy(), [], []
        self.unknowns = 3 * len(free)

    def forces(self, positions: np.ndarray) -> np.ndarray:
        """Forces of all terms on the unknowns [N], shape (free_node_count, 3)."""
        forces = np.zeros((len(self._free), 3))
        for term in self.terms:
            term.add_forces(positions, forces)
        return forces

    def reactions(self) -> np.ndarray:
        """What holds the nodes, minus the material's forces [N], shape (node_count, 3)."""
        everywhere, block = np.arange(len(self._rest)), self.mesh.strained_blocks()[0].mesh
        terms: list[ForceTerm] = [Elements(block, everywhere, self.elements.law)]
        if self.volumes is not None:
            kappa = self.volumes.bulk_modulus
            mesh, patches = self._patched
            terms.append(PatchVolumes(mesh, everywhere, kappa, patches))
        forces = np.zeros((len(self._rest), 3))
        matrix = Multifrontal(*coupled_pairs(terms), len(everywhere))
        for term in terms:
            term.bind(matrix.elimination_rank, matrix.slots)
            term.add_forces(self.positions, forces)
        return -forces

    def iterate(self, loads: np.ndarray) -> tuple[np.ndarray, float, Times]:
        """One linearization.

        Args:
            loads: Dead loads on all nodes [N], shape (node_count, 3).

        Returns:
            The correction of the unknowns, the largest residual before it, and times.

        Raises:
            NotSolved: The stiffness is not positive definite, not even projected.
        """
        begin = thread_time()
        for projected in (False, True):
            forces = loads[self._free].copy()
            self.matrix.clear()
            for term in self.terms:
                term.add(self.positions, forces, self.matrix.storage, projected)
            middle = thread_time()
            if self.matrix.factor():
                break
        else:
            raise NotSolved("the stiffness is not positive definite")
        move = self.matrix.solve(forces)
        residual = float(np.abs(forces[self._counts]).max())
        self.decrements.append(float(np.sqrt(abs(np.sum(move * forces)))))
        return move, residual, Times(middle - begin, thread_time() - middle)

    def solve(self, loads: np.ndarray | None = None, scale: float | None = None) -> Times:
        """Equilibrium under dead loads, from the present positions.

        Args:
            loads: [N], shape (node_count, 3); None for none.
            scale: Force that residuals are compared with [N]; by default the largest load.

        Returns:
            Median times of its iterations.

        Raises:
            NotSolved: It does not converge; positions stay as they were.
        """
        loads = np.zeros_like(self._rest) if loads is None else loads
        scale = scale or float(np.abs(loads).max())
        begin, times = self.positions.copy(), []
        self.residuals, self.decrements = [], []
        for _ in range(MOST_MOVES):
            try:
                move, residual, spent = self.iterate(loads)
            except NotSolved:
                self.positions = begin
                raise
            self.residuals.append(residual)
            times.append(spent)
            stalled = len(self.residuals) > 3 and residual > 0.1 * self.residuals[-2]
            if residual < CONVERGED * scale or (residual < 1.0e4 * CONVERGED * scale and stalled):
                return Times(*np.median(times, axis=0))
            self._advance(move, residual, loads)
        self.positions = begin
        raise NotSolved(f"{MOST_MOVES} iterations leave a residual of {residual:.3g} N")

    def _advance(self, move: np.ndarray, residual: float, loads: np.ndarray) -> None:
        """Make the share of a move that folds nothing and along which forces do not turn round."""
        whole = self.positions.copy()
        whole[self._free] += move
        share = min(term.largest_share(self.positions, whole) for term in self.terms)
        share = 1.0 if share == 1.0 else 0.9 * share
        slope = float(np.sum((self.forces(self.positions) + loads[self._free]) * move))
        before = self.positions
        while True:
            self.positions = before.copy()
            self.positions[self._free] += share * move
            after = self.forces(self.positions) + loads[self._free]
            if np.sum(after * move) > -0.5 * abs(slope) or share < LEAST_SHARE:
                return
            share *= 0.5


def quadratic_constant(decrements: list[float], floor: float = 1.0e-9) -> float:
    """The least C with d' ≤ C d² for all corrections d and the next ones d' [J^-½].

    With exact tangents it does not depend on how far the iterations go: at first order it grows by
    each of them.

    Args:
        decrements: Size d of each correction [J^½].
        floor: Share of the first one below which a correction may be round-off.
    """
    pairs = zip(decrements, decrements[1:], strict=False)
    found = [after / size**2 for size, after in pairs if after > floor * decrements[0]]
    return max(found, default=0.0)


# --- meshes --------------------------------------------------------------------------------------


def mapped_mesh(kind: str, counts: tuple[int, int, int], place) -> object:
    """A block of cells, mapped.

    Args:
        kind: ``linear``, ``smoothed``, ``quadratic`` or ``hexahedral``.
        counts: Cells along each edge.
        place: Where points of the unit cube are, an array (count, 3) to an array (count, 3) [m].

    Returns:
        The mesh; nodes at the middle of edges are placed too, so that edges may be curved.
    """
    return mesh_of(kind, [read_box((1.0, 1.0, 1.0), counts, of_hexahedra=True).mesh], place)


def mesh_of(kind: str, grids: list[HexahedralMesh], place, between=None) -> object:
    """Blocks of cells, mapped and joined where their nodes meet; see `mapped_mesh`.

    Args:
        kind: See `mapped_mesh`.
        grids: The blocks.
        place: See `mapped_mesh`.
        between: Where the middle of an edge is, by the places of its ends, arrays (count, 3) [m]; by
            default what lies between them in the unit cube, which needs a single block.
    """
    points = np.concatenate([grid.node_positions for grid in grids])
    starts = np.cumsum([0, *[len(grid.node_positions) for grid in grids]])
    cells = np.concatenate([grid.hexahedra + k for grid, k in zip(grids, starts[:-1], strict=True)])
    keys = np.round(place(points), 9)
    _, first, inverse = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order))
    nodes, cells = points[np.sort(first)], rank[inverse.reshape(-1)][cells]
    placed = place(nodes)
    a, b, c = (placed[cells[:, k]] - placed[cells[:, 0]] for k in (1, 3, 4))
    mirrored = np.einsum("ki,ki->k", np.cross(a, b), c) < 0.0
    if kind == "hexahedral":
        cells[mirrored] = cells[mirrored][:, [3, 2, 1, 0, 7, 6, 5, 4]]
        return HexahedralMesh(placed, np.empty((0, 4), np.int64), cells)
    tets = cells[:, INTO_TETS]
    tets[mirrored] = tets[mirrored][:, :, [1, 0, 2, 3]]
    linear = TetMesh(placed, tets.reshape(-1, 4))
    if kind == "linear":
        return linear
    if kind == "smoothed":
        return smooth(linear)
    mesh = add_mid_edge_nodes(linear)
    ends = mesh.mid_edge_ends
    if between is None:
        middles = place(nodes[ends].mean(axis=1))
    else:
        middles = between(placed[ends[:, 0]], placed[ends[:, 1]])
    return replace(mesh, node_positions=np.concatenate([placed, middles]))


def traction_loads(mesh, on_face, traction) -> np.ndarray:
    """A uniform dead traction on a face: forces on all nodes [N], shape (node_count, 3).

    Args:
        mesh: The mesh, flat on that face.
        on_face: Which nodes lie on it, of bool, shape (node_count,).
        traction: [Pa], shape (3,).
    """
    triangles = mesh.surface_triangles
    triangles = triangles[on_face[triangles].all(axis=1)]
    a, b, c = mesh.node_positions[triangles].transpose(1, 0, 2)
    areas = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
    if mesh.blocks()[0].mesh.shape_functions.node_count == 10:
        # A six-node face carries its load at the middle of its edges, a third each; the last of
        # its four triangles is the one between them.
        triangles, areas = triangles.reshape(-1, 4, 3)[:, 3], 4.0 * areas[::4]
    forces = np.zeros((len(mesh.node_positions), 3))
    np.add.at(forces, triangles, (areas[:, None, None] / 3.0) * np.asarray(traction, float))
    return forces


def column_mesh(size: tuple[float, float, float], cells: tuple[int, int, int]) -> TetMesh:
    """Meshes a column that hangs down from the plane z = 0, its axis on the z axis.

    Args:
        size: Edges along x, y, z [m].
        cells: Boxes along each of them.

    Returns:
        The mesh [m].
    """
    counts = np.array(cells) + 1
    axes = [np.linspace(-0.5, 0.5, count) for count in counts[:2]] + [
        np.linspace(-1.0, 0.0, counts[2])]
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3) * np.array(size)
    number = np.arange(len(nodes)).reshape(counts)
    tets = []
    for path in permutations(range(3)):
        corner = np.zeros(3, dtype=int)
        corners = [_corner(number, corner)]
        for axis in path:
            corner[axis] = 1
            corners.append(_corner(number, corner))
        # Odd permutations of the axes give left-handed tetrahedra, which are reversed.
        odd = np.linalg.det(np.eye(3)[list(path)]) < 0.0
        tets.append(np.stack([corners[k] for k in ((0, 2, 1, 3) if odd else range(4))], axis=-1))
    return TetMesh(nodes, np.concatenate(tets))


def _corner(number: np.ndarray, offset: np.ndarray) -> np.ndarray:
    """Node at one corner of every box."""
    ends = np.array(number.shape) - 1 + offset
    (i, j, k), (a, b, c) = offset, ends
    return number[i:a, j:b, k:c].ravel()
