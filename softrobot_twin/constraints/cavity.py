"""Cavities: closed surfaces whose enclosed volume is the displacement (Coevoet 2017, eq. 3).

The displacement of a cavity is its growth δ = V(q) - V_rest, and its multiplier is the gauge
pressure. The triangles (i, j, k) of its surface run outwards, seen from the gas, and

    V = Σ x_i · (x_j × x_k) / 6,    ∂V/∂x_i = Σ (x_j × x_k) / 6,    ∂²V/∂x_i∂x_j = -[x_k]ₓ / 6,

where [x]ₓ is the matrix of the cross product. The first derivative is a third of the area of the
triangles around a vertex times their normal, in sum: H of eq. (3). The second derivative, times the
pressure, is the stiffness of a load that follows its surface. It is symmetric because a closed
surface has a volume, and it is neither positive nor negative.

A cavity may consist of several closed surfaces that one valve connects: they have one pressure,
and their volumes sum up. Vertices are points that bodies carry, x = Σ w_a x_a: they need not be
nodes of a mesh.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numba import njit

from softrobot_twin.constraints.row_stack import add_row_forces
from softrobot_twin.geometry.vector3 import (
    add_scaled,
    cross,
    dot,
    row,
    set_row,
    subtract,
)
from softrobot_twin.mechanics.barycentric import BarycentricMapping, writable
from softrobot_twin.mechanics.kinematics import CarriedPoints, FoldedStiffness
from softrobot_twin.mechanics.stencil import bind_stencils

# A cavity whose volume is below this share of that at rest is empty: its walls touch.
EMPTY = 0.01
# Greatest share of its volume that a cavity loses in one linearization.
GREATEST_LOSS = 0.8
# A move is halved so often at most.
MOST_HALVINGS = 10


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


@njit(cache=True, nogil=True, error_model="numpy")
def add_volumes(points, triangles, cavity, origin, volumes):
    """V of each cavity. An origin on its surface keeps round-off small, far from the world's."""
    for t in range(len(triangles)):
        c = cavity[t]
        o = row(points, origin[c])
        i = subtract(row(points, triangles[t, 0]), o)
        j = subtract(row(points, triangles[t, 1]), o)
        k = subtract(row(points, triangles[t, 2]), o)
        volumes[c] += dot(i, cross(j, k)) / 6.0


@njit(cache=True, nogil=True, error_model="numpy")
def add_volume_gradients(points, triangles, cavity, origin, gradients):
    """∂V/∂x of each vertex."""
    for t in range(len(triangles)):
        o = row(points, origin[cavity[t]])
        for m in range(3):
            b = subtract(row(points, triangles[t, (m + 1) % 3]), o)
            d = subtract(row(points, triangles[t, (m + 2) % 3]), o)
            i = triangles[t, m]
            set_row(gradients, i, add_scaled(row(gradients, i), cross(b, d), 1.0 / 6.0))


@njit(cache=True, nogil=True, error_model="numpy")
def add_to_entries(gradients, weights, entry, blocks):
    """Add w ∂V/∂x of each vertex to the entries of the nodes that carry it."""
    for v in range(len(entry)):
        g = row(gradients, v)
        for a in range(entry.shape[1]):
            e = entry[v, a]
            if e >= 0:
                set_row(blocks, e, add_scaled(row(blocks, e), g, weights[v, a]))


@njit(cache=True, nogil=True, error_model="numpy")
def add_pressure_stiffness(
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
                place = offsets[t, pair]
                if place >= 0 and a != b:
                    s = (0.0, 0.0, 0.0)
                    for k in range(3):
                        i, j = (k + 1) % 3, (k + 2) % 3
                        w = weights[t, i, a] * weights[t, j, b] - weights[t, j, a] * weights[t, i, b]
                        s = add_scaled(s, subtract(row(points, triangles[t, k]), o), p * w)
                    stride = strides[t, pair]
                    storage[place + 1] += s[2]
                    storage[place + 2] -= s[1]
                    storage[place + stride] -= s[2]
                    storage[place + stride + 2] += s[0]
                    storage[place + 2 * stride] += s[1]
                    storage[place + 2 * stride + 1] -= s[0]
                pair += 1


@njit(cache=True, nogil=True, error_model="numpy")
def write_vertex_moves(moves, weights, free, out):
    """Displacement of each vertex by those of the unknowns and carried points."""
    for v in range(len(free)):
        move = (0.0, 0.0, 0.0)
        for a in range(free.shape[1]):
            n = free[v, a]
            if 0 <= n < len(moves):
                move = add_scaled(move, row(moves, n), weights[v, a])
        set_row(out, v, move)


class Cavities:
    """Constraint term of cavities that are actuators, and the stiffness of their pressure.

    Attributes:
        surfaces: Surfaces of each cavity.
        rest_volumes: Volume of each at rest [m³], shape (row_count,).
        rest_areas: Area of the surfaces of each at rest [m²], shape (row_count,).
    """

    name = "cavities"
    group = "actuators"
    varies = False

    def __init__(
        self, surfaces: tuple[CavitySurface, ...], free_index: np.ndarray,
        rest_positions: np.ndarray, points: CarriedPoints | None = None,
    ):  # fmt: skip
        """Lay out vertices and triangles one after the other.

        Args:
            surfaces: The cavities.
            free_index: Unknown or carried point of each node, -1 where fixed, shape (node_count,).
            rest_positions: Node positions at rest [m], shape (node_count, 3).
            points: The carried points of the scene; None without any.
        """
        self.surfaces, self.row_count = surfaces, len(surfaces)
        self._free_index = free_index
        counts = [surface.vertices.point_count for surface in surfaces]
        self._origin = np.cumsum([0, *counts[:-1]])
        self._triangles = np.concatenate(
            [s.triangles + first for s, first in zip(surfaces, self._origin, strict=True)]
        )
        self._cavity = np.repeat(np.arange(self.row_count), [len(s.triangles) for s in surfaces])
        self._carriers = _joined([s.vertices for s in surfaces])
        self._free = free_index[self._carriers.nodes]
        self._lay_out_entries(np.repeat(np.arange(self.row_count), counts))
        self._lay_out_stencils()
        self._vertices = np.empty((sum(counts), 3))
        self._gradients = np.empty_like(self._vertices)
        self._points, self._folded, self._bound = None, None, None
        if points is not None and (self._free >= points.free_count).any():
            self._points = points
            self._folded = FoldedStiffness(points, self._stencil_unknowns)
        self.rest_volumes = self.volumes(rest_positions)
        self.rest_areas = self._areas(rest_positions)

    def _lay_out_entries(self, cavity_of_vertex: np.ndarray) -> None:
        """One entry of H for each cavity and unknown."""
        weights = self._carriers.barycentric_weights
        used = (self._free >= 0) & (weights != 0.0)
        cavity = np.broadcast_to(cavity_of_vertex[:, None], used.shape)
        span = int(self._free.max(initial=0)) + 1
        keys, place = np.unique(cavity[used] * span + self._free[used], return_inverse=True)
        self._entry = np.full(used.shape, -1, np.int64)
        self._entry[used] = place.ravel()
        self.entry_rows, self.entry_nodes = np.divmod(keys, span)

    def _lay_out_stencils(self) -> None:
        """Nodes that carry the vertices of each triangle, each once, and their weights."""
        nodes, weights = self._carriers.nodes, self._carriers.barycentric_weights
        count, own = len(self._triangles), nodes.shape[1]
        of_triangle = np.where(weights != 0.0, nodes, -1)[self._triangles].reshape(count, 3 * own)
        ordered = -np.sort(-of_triangle, axis=1)
        ordered[:, 1:][ordered[:, 1:] == ordered[:, :-1]] = -1
        ordered = -np.sort(-ordered, axis=1)
        width = max(1, int((ordered >= 0).sum(axis=1).max(initial=0)))
        ordered = ordered[:, :width]
        found = np.zeros((count, 3, width))
        for vertex in range(3):
            at = self._triangles[:, vertex]
            same = nodes[at][:, :, None] == ordered[:, None, :]
            found[:, vertex] = (same * weights[at][:, :, None]).sum(axis=1)
        self._stencil_weights = found
        self._stencil_unknowns = np.where(ordered >= 0, self._free_index[ordered], -1)

    @property
    def row_capacity(self) -> int:
        """Number of rows that memory is allocated for."""
        return self.row_count

    @property
    def entry_capacity(self) -> int:
        """Number of entries of H that memory is allocated for."""
        return len(self.entry_rows)

    @property
    def reached_nodes(self) -> np.ndarray:
        """Unknowns with entries in the rows."""
        return np.unique(self.entry_nodes)

    @property
    def scales(self) -> np.ndarray:
        """Volumes at rest [m³], shape (row_count,)."""
        return self.rest_volumes

    def vertices(self, positions: np.ndarray) -> list[np.ndarray]:
        """Vertices of each cavity [m], each of shape (vertex_count, 3)."""
        return [surface.vertices.positions(positions) for surface in self.surfaces]

    def _place(self, positions: np.ndarray) -> np.ndarray:
        self._vertices[:] = self._carriers.positions(positions)
        return self._vertices

    def _areas(self, positions: np.ndarray) -> np.ndarray:
        a, b, c = np.moveaxis(self._place(positions)[self._triangles], 1, 0)
        areas = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
        return np.bincount(self._cavity, areas, self.row_count)

    def volumes(self, positions: np.ndarray) -> np.ndarray:
        """Volumes [m³], shape (row_count,).

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        return self._volumes_of(self._place(positions))

    def _volumes_of(self, vertices: np.ndarray) -> np.ndarray:
        volumes = np.zeros(self.row_count)
        add_volumes(vertices, self._triangles, self._cavity, self._origin, volumes)
        return volumes

    def stencils(self) -> np.ndarray:
        """Unknowns that each triangle couples, -1 where none, shape (triangle_count, width)."""
        return self._stencil_unknowns if self._folded is None else self._folded.stencils()

    def bind(self, elimination_rank: np.ndarray, slots: Callable) -> None:
        """Find the places of the stiffness in the storage, and sort the triangles' nodes."""
        if self._folded is not None:
            elimination_rank, slots = self._folded.bind(elimination_rank, slots)
        self._bound = bind_stencils(self._stencil_unknowns, elimination_rank, slots)
        order = self._bound.order
        self._stencil_weights = np.ascontiguousarray(
            np.take_along_axis(self._stencil_weights, order[:, None, :], axis=2)
        )
        self._stencil_unknowns = np.take_along_axis(self._stencil_unknowns, order, axis=1)

    def evaluate(self, positions: np.ndarray, blocks: np.ndarray, values: np.ndarray) -> None:
        """Write H and the growths δ [m³]; see `ConstraintTerm.evaluate`."""
        vertices = self._place(positions)
        blocks[:] = 0.0
        self._gradients[:] = 0.0
        add_volume_gradients(
            vertices, self._triangles, self._cavity, self._origin, self._gradients
        )
        add_to_entries(
            self._gradients, self._carriers.barycentric_weights, self._entry, blocks
        )
        np.subtract(self._volumes_of(vertices), self.rest_volumes, out=values)

    def add_stiffness(
        self, positions: np.ndarray, multipliers: np.ndarray, storage: np.ndarray,
        projected: bool = False,
    ) -> None:
        """Add the stiffness of the pressures; see `ConstraintTerm.add_stiffness`.

        Projected, it adds nothing: of -p ∂²V no part is known that is never negative.
        """
        if projected or not multipliers.any():
            return
        folded, pressures = self._folded, writable(multipliers)
        if folded is not None:
            folded.clear()
        add_pressure_stiffness(
            self._place(positions), self._triangles, self._cavity, self._origin, pressures,
            self._stencil_weights, self._bound.offsets, self._bound.strides,
            storage if folded is None else folded.scratch,
        )  # fmt: skip
        if folded is not None:
            folded.fold(positions, self._forces_on_carried_points(positions, pressures), storage)

    def _forces_on_carried_points(self, positions, pressures) -> np.ndarray:
        """Force of the pressures on each carried point [N], shape (carried_count, 3)."""
        free = self._points.free_count
        blocks = np.empty((len(self.entry_rows), 3))
        self.evaluate(positions, blocks, np.empty(self.row_count))
        forces = np.zeros((free + self._points.count, 3))
        add_row_forces(self.entry_rows, self.entry_nodes, blocks, pressures, forces)
        return forces[free:]

    def largest_share(self, positions: np.ndarray, move: np.ndarray) -> float:
        """Share of a move in which no cavity loses most of its volume; see `ConstraintTerm`.

        So no volume becomes negative.
        """
        begin = self._place(positions).copy()
        least = (1.0 - GREATEST_LOSS) * self._volumes_of(begin)
        moves = move if self._points is None else self._points.point_moves(positions, move)
        own = np.empty_like(begin)
        write_vertex_moves(moves, self._carriers.barycentric_weights, self._free, own)
        share = 1.0
        for _ in range(MOST_HALVINGS):
            if not (self._volumes_of(begin + share * own) < least).any():
                break
            share *= 0.5
        return share


def _joined(mappings: list[BarycentricMapping]) -> BarycentricMapping:
    """The points of several mappings as one."""
    joined = mappings[0]
    for mapping in mappings[1:]:
        joined = joined.followed_by(mapping)
    return joined
