"""Closed surfaces that bodies carry: their volume, and its derivatives.

The triangles (i, j, k) of a surface run outwards, seen from the gas inside, and

    V = Σ x_i · (x_j × x_k) / 6,    ∂V/∂x_i = Σ (x_j × x_k) / 6,    ∂²V/∂x_i∂x_j = -[x_k]ₓ / 6,

where [x]ₓ is the matrix of the cross product. The first derivative is a third of the area of the
triangles around a vertex times their normal, in sum: H of Coevoet 2017, eq. (3). The second
derivative, times a pressure, is the stiffness of a load that follows its surface. It is symmetric
because a closed surface has a volume, and it is neither positive nor negative.

A cavity may consist of several closed surfaces that one valve connects: they have one pressure,
and their volumes sum up. Vertices are points that bodies carry, x = Σ w_a x_a: they need not be
nodes of a mesh.

Arguments of the kernels here:
    blocks: Entries of ∂V/∂q [m²], shape (entry_count, 3); added to.
    cavity: Cavity of each triangle, shape (triangle_count,).
    entry, free: Entry, and unknown, of each node that carries a vertex, -1 where none, shape
        (vertex_count, carrier_count).
    gradients: ∂V/∂x [m²], shape (vertex_count, 3).
    moves: Displacements of unknowns and carried points [m], shape (count, 3).
    offsets, strides: Places of the blocks in storage, shape (triangle_count, pair_count).
    origin: Vertex from which each cavity is seen, shape (cavity_count,).
    out: Displacements of the vertices [m], shape (vertex_count, 3).
    points: Vertices [m], shape (vertex_count, 3).
    pressures, volumes: p [Pa] and V [m³], shape (cavity_count,).
    triangles: Vertices of each, shape (triangle_count, 3).
    weights: Of the carriers in each vertex, shape (vertex_count, carrier_count); by triangle in
        `_add_pressure_stiffness`, shape (triangle_count, 3, width).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from softrobot_twin.geometry.matrix3 import cross_matrix
from softrobot_twin.geometry.vector3 import add_scaled, cross, dot, row, set_row, subtract
from softrobot_twin.kernels.compilation import KERNEL, njit
from softrobot_twin.mechanics.barycentric import BarycentricMapping
from softrobot_twin.mechanics.force_term import ForceTerm
from softrobot_twin.mechanics.kinematics import each_once
from softrobot_twin.mechanics.stencil import BoundStencils, add_block, bind_stencils

# Greatest share of its volume that a cavity loses in one linearization.
GREATEST_LOSS = 0.8
# Greatest volume after one linearization, as a multiple of that before it, and of the sphere whose
# area is that of the walls at rest.
GREATEST_GROWTH = 3.0
# A move is halved so often at most: what is left then is round-off.
MOST_HALVINGS = 50


class CavitySurface(NamedTuple):
    """The closed surfaces of one cavity.

    Attributes:
        name: Name of the cavity.
        vertices: Vertices, carried by bodies.
        triangles: Vertices of each triangle, outward as seen from the gas,
            shape (triangle_count, 3).
    """

    name: str
    vertices: BarycentricMapping
    triangles: np.ndarray


@njit(**KERNEL)
def add_volumes(points, triangles, cavity, origin, volumes):
    """V of each cavity. An origin on its surface keeps round-off small, far from the world's."""
    for t in range(len(triangles)):
        c = cavity[t]
        o = row(points, origin[c])
        i = subtract(row(points, triangles[t, 0]), o)
        j = subtract(row(points, triangles[t, 1]), o)
        k = subtract(row(points, triangles[t, 2]), o)
        volumes[c] += dot(i, cross(j, k)) / 6.0


@njit(**KERNEL)
def add_volume_gradients(points, triangles, cavity, origin, gradients):
    """∂V/∂x of each vertex."""
    for t in range(len(triangles)):
        o = row(points, origin[cavity[t]])
        for m in range(3):
            b = subtract(row(points, triangles[t, (m + 1) % 3]), o)
            d = subtract(row(points, triangles[t, (m + 2) % 3]), o)
            i = triangles[t, m]
            set_row(gradients, i, add_scaled(row(gradients, i), cross(b, d), 1.0 / 6.0))


@njit(**KERNEL)
def _add_to_entries(gradients, weights, entry, blocks):
    """Add w ∂V/∂x of each vertex to the entries of the nodes that carry it."""
    for v in range(len(entry)):
        g = row(gradients, v)
        for a in range(entry.shape[1]):
            e = entry[v, a]
            if e >= 0:
                set_row(blocks, e, add_scaled(row(blocks, e), g, weights[v, a]))


@njit(**KERNEL)
def _add_pressure_stiffness(
    points, triangles, cavity, origin, pressures, weights, offsets, strides, storage
):
    """Add -p ∂²V of every triangle; its block for nodes a and b is p [s]ₓ / 6.

    s = Σ (w_ia w_jb - w_ja w_ib) x_k over the cyclic orders (i, j, k) of its vertices.
    """
    width = weights.shape[2]
    for t in range(len(triangles)):
        p = pressures[cavity[t]] / 6.0
        if p == 0.0:
            continue
        o = row(points, origin[cavity[t]])
        pair = 0
        for b in range(width):
            for a in range(b, width):
                if offsets[t, pair] >= 0 and a != b:
                    s = (0.0, 0.0, 0.0)
                    for k in range(3):
                        i, j = (k + 1) % 3, (k + 2) % 3
                        w = weights[t, i, a] * weights[t, j, b] - weights[t, j, a] * weights[t, i, b]
                        s = add_scaled(s, subtract(row(points, triangles[t, k]), o), p * w)
                    add_block(cross_matrix(s), offsets[t, pair], strides[t, pair], storage)
                pair += 1


@njit(**KERNEL)
def _write_vertex_moves(moves, weights, free, out):
    """Displacement of each vertex by those of the unknowns and carried points."""
    for v in range(len(free)):
        move = (0.0, 0.0, 0.0)
        for a in range(free.shape[1]):
            n = free[v, a]
            if 0 <= n < len(moves):
                move = add_scaled(move, row(moves, n), weights[v, a])
        set_row(out, v, move)


def sphere_volumes(areas: np.ndarray) -> np.ndarray:
    """Volumes of spheres of given areas: the most that walls of these areas can enclose.

    Args:
        areas: Areas [m²], shape (count,).

    Returns:
        Volumes [m³], same shape.
    """
    return areas**1.5 / (6.0 * np.sqrt(np.pi))


def surface_area(points: np.ndarray, triangles: np.ndarray) -> float:
    """Area of some triangles [m²].

    Args:
        points: Vertices [m], shape (vertex_count, 3).
        triangles: Vertices of each, shape (triangle_count, 3).
    """
    return float(_triangle_areas(points, triangles).sum())


def _triangle_areas(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    a, b, c = np.moveaxis(points[triangles], 1, 0)
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)


def share_of_volumes(volumes_at: Callable[[float], np.ndarray], sphere_volumes: np.ndarray) -> float:
    """Share of a move in which no cavity loses most of its volume, or grows by a multiple of it.

    So no volume becomes negative, and none runs away where no equilibrium exists.

    Args:
        volumes_at: Volume of each cavity [m³] after a share of the move, shape (count,).
        sphere_volumes: See `sphere_volumes` [m³], shape (count,).
    """
    before = volumes_at(0.0)
    least = (1.0 - GREATEST_LOSS) * before
    most = GREATEST_GROWTH * np.maximum(before, sphere_volumes)
    share = 1.0
    for _ in range(MOST_HALVINGS):
        after = volumes_at(share)
        if ((after >= least) & (after <= most)).all():
            break
        share *= 0.5
    return share


class CavitySurfaces:
    """The surfaces of several cavities.

    Attributes:
        surfaces: Surfaces of each cavity.
        count: Number of cavities.
        entry_cavity: Cavity of each entry of ∂V/∂q, shape (entry_count,).
        entry_nodes: Unknown or carried point of each entry, shape (entry_count,).
        triangles: Vertices of the triangles of all cavities, shape (triangle_count, 3).
        cavity: Cavity of each triangle, shape (triangle_count,).
        stencils: Unknowns and carried points that each triangle couples, -1 where none,
            shape (triangle_count, width).
        stencil_weights: Weight of each of these in each vertex, shape (triangle_count, 3, width).
        bound: Order of the stencils, and the places of their blocks; after `sort`.
        rest_volumes: Volume of each at rest [m³], shape (count,).
        rest_areas: Area of the surfaces of each at rest [m²], shape (count,).
        sphere_volumes: Volume of a sphere with that area [m³], shape (count,): the most that the walls
            can enclose without being stretched.
    """

    def __init__(
        self, surfaces: tuple[CavitySurface, ...], free_index: np.ndarray,
        rest_positions: np.ndarray,
    ):  # fmt: skip
        """Lay out vertices and triangles one after the other.

        Args:
            surfaces: The cavities.
            free_index: Unknown or carried point of each node, -1 where fixed, shape (node_count,).
            rest_positions: Node positions at rest [m], shape (node_count, 3).
        """
        self.surfaces, self.count = surfaces, len(surfaces)
        counts = [surface.vertices.point_count for surface in surfaces]
        self._origin = np.cumsum([0, *counts[:-1]])
        self.triangles = np.concatenate(
            [s.triangles + first for s, first in zip(surfaces, self._origin, strict=True)]
        )
        self.cavity = np.repeat(np.arange(self.count), [len(s.triangles) for s in surfaces])
        self._carriers = _joined([s.vertices for s in surfaces])
        self._free = free_index[self._carriers.nodes]
        self._lay_out_entries(np.repeat(np.arange(self.count), counts))
        self._lay_out_stencils(free_index)
        self._vertices = np.empty((sum(counts), 3))
        self._gradients = np.empty_like(self._vertices)
        self.rest_volumes = self.volumes(rest_positions)
        self.rest_areas = self._areas(rest_positions)
        self.sphere_volumes = sphere_volumes(self.rest_areas)

    def _lay_out_entries(self, cavity_of_vertex: np.ndarray) -> None:
        """One entry of ∂V/∂q for each cavity and unknown."""
        weights = self._carriers.barycentric_weights
        used = (self._free >= 0) & (weights != 0.0)
        cavity = np.broadcast_to(cavity_of_vertex[:, None], used.shape)
        span = int(self._free.max(initial=0)) + 1
        keys, place = np.unique(cavity[used] * span + self._free[used], return_inverse=True)
        self._entry = np.full(used.shape, -1, np.int64)
        self._entry[used] = place.ravel()
        self.entry_cavity, self.entry_nodes = np.divmod(keys, span)

    def _lay_out_stencils(self, free_index: np.ndarray) -> None:
        """Nodes that carry the vertices of each triangle, each once, and their weights."""
        nodes, weights = self._carriers.nodes, self._carriers.barycentric_weights
        count, own = len(self.triangles), nodes.shape[1]
        of_triangle = np.where(weights != 0.0, nodes, -1)[self.triangles].reshape(count, 3 * own)
        ordered = each_once(of_triangle)
        found = np.zeros((count, 3, ordered.shape[1]))
        for vertex in range(3):
            at = self.triangles[:, vertex]
            same = nodes[at][:, :, None] == ordered[:, None, :]
            found[:, vertex] = (same * weights[at][:, :, None]).sum(axis=1)
        self.stencil_weights = found
        self.stencils = np.where(ordered >= 0, free_index[ordered], -1)

    def vertices(self, positions: np.ndarray) -> list[np.ndarray]:
        """Vertices of each cavity [m], each of shape (vertex_count, 3).

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        return [surface.vertices.positions(positions) for surface in self.surfaces]

    def place(self, positions: np.ndarray) -> np.ndarray:
        """All vertices at a state [m], shape (vertex_count, 3); the next call overwrites them.

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        self._vertices[:] = self._carriers.positions(positions)
        return self._vertices

    def _areas(self, positions: np.ndarray) -> np.ndarray:
        areas = _triangle_areas(self.place(positions), self.triangles)
        return np.bincount(self.cavity, areas, self.count)

    def volumes(self, positions: np.ndarray) -> np.ndarray:
        """Volumes [m³], shape (count,).

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        return self._volumes_of(self.place(positions))

    def _volumes_of(self, vertices: np.ndarray) -> np.ndarray:
        volumes = np.zeros(self.count)
        add_volumes(vertices, self.triangles, self.cavity, self._origin, volumes)
        return volumes

    def write_gradients(self, positions: np.ndarray, blocks: np.ndarray) -> np.ndarray:
        """Write ∂V/∂q.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            blocks: Entries of ∂V/∂q [m²], shape (entry_count, 3); overwritten.

        Returns:
            Volumes [m³], shape (count,).
        """
        vertices = self.place(positions)
        blocks[:] = 0.0
        self._gradients[:] = 0.0
        add_volume_gradients(
            vertices, self.triangles, self.cavity, self._origin, self._gradients
        )
        _add_to_entries(self._gradients, self._carriers.barycentric_weights, self._entry, blocks)
        return self._volumes_of(vertices)

    def carry_forces(self, vertex_forces: np.ndarray, forces: np.ndarray) -> None:
        """Add forces on the vertices to those on the unknowns that carry them.

        Args:
            vertex_forces: Forces [N], shape (vertex_count, 3).
            forces: Forces on unknowns and carried points [N], shape (count, 3); added to.
        """
        _add_to_entries(vertex_forces, self._carriers.barycentric_weights, self._free, forces)

    def sort(self, bound: BoundStencils) -> None:
        """Sort the nodes of each triangle as its blocks are bound.

        Args:
            bound: The order of `stencils`, and the places of their blocks.
        """
        self.bound = bound
        self.stencil_weights = np.ascontiguousarray(
            np.take_along_axis(self.stencil_weights, bound.order[:, None, :], axis=2)
        )
        self.stencils = bound.sorted(self.stencils)

    def add_stiffness(self, positions: np.ndarray, pressures: np.ndarray, storage: np.ndarray) -> None:
        """Add -p ∂²V of each cavity to the system matrix.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            pressures: p [Pa], shape (count,).
            storage: The factorization's storage [N/m]; added to.
        """
        _add_pressure_stiffness(
            self.place(positions), self.triangles, self.cavity, self._origin, pressures,
            self.stencil_weights, self.bound.offsets, self.bound.strides, storage,
        )  # fmt: skip

    def largest_share(self, positions: np.ndarray, moves: np.ndarray) -> float:
        """Share of a move that leaves every cavity a volume; see `share_of_volumes`.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            moves: Displacements of unknowns and carried points [m], shape (count, 3).
        """
        begin = self.place(positions).copy()
        own = np.empty_like(begin)
        _write_vertex_moves(moves, self._carriers.barycentric_weights, self._free, own)
        return self._share(begin, own)

    def share_between(self, before: np.ndarray, after: np.ndarray) -> float:
        """The same for a move from one state to another.

        Args:
            before: Node positions where the move begins [m], shape (node_count, 3).
            after: Those after the whole move [m], same shape.
        """
        begin = self.place(before).copy()
        return self._share(begin, self.place(after) - begin)

    def _share(self, begin: np.ndarray, own: np.ndarray) -> float:
        """Share of the moves of the vertices."""
        return share_of_volumes(
            lambda share: self._volumes_of(begin + share * own), self.sphere_volumes
        )


class CavityLoad(ForceTerm):
    """Base of force terms that load the walls of cavities.

    Attributes:
        walls: Surfaces of the cavities.
    """

    def __init__(
        self, surfaces: tuple[CavitySurface, ...], free_index: np.ndarray,
        rest_positions: np.ndarray,
    ):  # fmt: skip
        """Lay out the surfaces; see `CavitySurfaces`."""
        self.walls = CavitySurfaces(surfaces, free_index, rest_positions)

    def stencils(self) -> np.ndarray:
        """Unknowns that each triangle couples, -1 where none, shape (triangle_count, width)."""
        return self.walls.stencils

    def bind(self, elimination_rank: np.ndarray, slots) -> None:
        """See `ForceTerm.bind`."""
        self.walls.sort(bind_stencils(self.walls.stencils, elimination_rank, slots))


def _joined(mappings: list[BarycentricMapping]) -> BarycentricMapping:
    """The points of several mappings as one."""
    joined = mappings[0]
    for mapping in mappings[1:]:
        joined = joined.followed_by(mapping)
    return joined
