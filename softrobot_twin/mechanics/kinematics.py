"""Kinematics: how the nodes of a scene follow from its unknowns, x = x(q).

Unknowns come in blocks of three numbers. Most are free nodes, whose positions they are. Other kinds
of unknowns (the frame of a rigid body: a translation and a rotation) carry nodes that have no
unknowns of their own: the frame nodes of the body, and nodes of soft bodies attached to it. Such a
*carried point* p moves by

    dx_p = Σ_j D_pj dq_j,

with 3×3 derivatives D_pj by a few unknowns j. Force terms and constraint terms are independent of
this: they work on points, each of which has an index: that of its unknown, or one after all
unknowns for a carried point. Their contributions at carried points are transformed to the unknowns
here:

    forces:     f_j += D_pjᵀ f_p
    rows of H:  h_j += D_pjᵀ h_p
    stiffness:  A_jk += D_pjᵀ K_pq D_qk - (∂D_pjᵀ/∂q_k) f_p

The last term (`turning`) exists where D depends on q, as for a rotation. The unknowns are then not
a vector space, and only the symmetric part is the second derivative of an energy; the rest vanishes
in equilibrium.

A scene without carried points computes none of this.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Protocol

import numpy as np
import scipy.sparse as sp

from softrobot_twin.geometry.matrix3 import IDENTITY, product, rows, transposed, transposed_product
from softrobot_twin.geometry.vector3 import dot, row
from softrobot_twin.geometry.vector_arrays import (
    add_vectors,
    are_same,
    copy_vectors,
    multiply_transposed,
)
from softrobot_twin.kernels.compilation import INNER, KERNEL, njit
from softrobot_twin.kernels.traced_stage import clear
from softrobot_twin.mechanics.force_term import ForceTerm
from softrobot_twin.mechanics.stencil import add_block, bind_stencils, stencil_pairs


@njit(**KERNEL)
def advance_nodes(positions, free_nodes, move, share):
    """Move the free nodes by a share of the first rows of a move.

    Args:
        positions: Node positions [m], shape (node_count, 3); changed.
        free_nodes: Node of each of the first unknowns, shape (count,).
        move: Move of each unknown [m], shape (free_node_count, 3).
        share: Factor of the move.
    """
    for k in range(len(free_nodes)):
        for i in range(3):
            positions[free_nodes[k], i] += share * move[k, i]


@njit(**KERNEL)
def write_displacement(before, after, free_nodes, displacement):
    """Displacement of each free node, in the first rows.

    Args:
        before: Node positions [m], shape (node_count, 3).
        after: Node positions of the later state [m], same shape.
        free_nodes: Node of each of the first unknowns, shape (count,).
        displacement: Takes the displacements [m], shape (free_node_count, 3).
    """
    for k in range(len(free_nodes)):
        for i in range(3):
            displacement[k, i] = after[free_nodes[k], i] - before[free_nodes[k], i]


@njit(**KERNEL)
def longest_row(vectors):
    """Length of the longest of some vectors, shape (count, 3); not finite if any component is not.
    """
    largest = 0.0
    for k in range(len(vectors)):
        if not largest < np.inf:
            break
        square = dot(row(vectors, k), row(vectors, k))
        if not square <= largest:
            largest = square
    return np.sqrt(largest)


@njit(**KERNEL)
def write_longest_row(vectors, largest):
    """Write `longest_row` of `vectors`, shape (count, 3), into `largest`, shape (1,)."""
    largest[0] = longest_row(vectors)


class UnknownKind(Protocol):
    """A kind of unknowns, or of points that unknowns carry: frames of rigid bodies, reduced bodies.

    Attributes:
        is_traceable: Whether `advance`, `raise_largest`, `add_turning`, and `write_derivatives` where
            D changes, do nothing with numbers but by kernels.
        has_constant_derivatives: Whether D is the same in every state.
        carried_unknowns: Unknowns that each carried point depends on, padded with -1, shape
            (carried_count, width). The order is that of the points' indices.
        turning_unknowns: Row of each block of A that gets a turning term, shape (turning_count,).
        turning_columns: Its column, the same unknown for a diagonal block, shape (turning_count,).
    """

    is_traceable: bool
    has_constant_derivatives: bool
    carried_unknowns: np.ndarray
    turning_unknowns: np.ndarray
    turning_columns: np.ndarray

    def advance(self, positions: np.ndarray, move: np.ndarray, share: float) -> None:
        """Move the unknowns by a share of a move, and place their nodes; see `Nodes.advance`."""

    def displacement(self, before: np.ndarray, after: np.ndarray, out: np.ndarray) -> None:
        """Write the displacement of these unknowns; see `Nodes.displacement`."""

    def raise_largest(self, vectors: np.ndarray, are_forces: bool, largest: np.ndarray) -> None:
        """Raise a number to the largest displacement [m], or force [N], of a point that they carry.

        Args:
            vectors: Moves or forces of all unknowns, shape (free_node_count, 3).
            are_forces: True for forces [N] and torques [N m].
            largest: The number, shape (1,); stays where it is not finite, and is not finite then
                where any component is not.
        """

    def write_derivatives(self, positions: np.ndarray, out: np.ndarray) -> None:
        """Write D of every carried point, shape (carried_count, width, 3, 3).

        Args:
            positions: Node positions [m], shape (node_count, 3).
            out: D, shape (carried_count, width, 3, 3); overwritten.
        """

    def add_turning(self, positions: np.ndarray, forces: np.ndarray, out: np.ndarray) -> None:
        """Add the symmetric part of -Σ (∂Dᵀ/∂q) f at each pair of `turning_unknowns` and columns.

        A block beside the diagonal is added once; that on the other side is its transpose.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            forces: Force on each carried point [N], shape (carried_count, 3).
            out: Blocks, shape (turning_count, 3, 3); added to.
        """


def size_of_points(points: np.ndarray) -> float:
    """Size of a set of points, independent of their position and rotation.

    Args:
        points: Points [m], shape (count, 3).

    Returns:
        Twice the distance of the furthest one from their mean [m]; 0 for a single point.
    """
    offsets = points - points.mean(axis=0)
    return 2.0 * float(np.sqrt((offsets * offsets).sum(axis=1).max()))


def size_of_body(points: np.ndarray, tets: np.ndarray) -> float:
    """Diagonal of the box with a body's radius of gyration, independent of position and rotation.

    A box of edges a, b, c has the mean square distance (a² + b² + c²)/12 from its centre. Over a
    tetrahedron of volume V with corners x_i relative to the centre, ∫ |x|² = V (Σ |x_i|² + |Σ
    x_i|²)/20.

    Args:
        points: Positions of its nodes [m], shape (node_count, 3).
        tets: Corners of its tetrahedra, shape (tet_count, 4).

    Returns:
        √12 times the root mean square distance from its middle [m].
    """
    corners = points[tets]
    edges = corners[:, 1:] - corners[:, :1]
    volumes = np.abs(np.linalg.det(edges)) / 6.0
    middle = volumes @ corners.mean(axis=1) / volumes.sum()
    corners = corners - middle
    total = corners.sum(axis=1)
    squares = (np.einsum("tci,tci->t", corners, corners) + np.einsum("ti,ti->t", total, total)) / 20.0
    return float(np.sqrt(12.0 * (volumes @ squares) / volumes.sum()))


@dataclass(frozen=True)
class Nodes:
    """The nodes of all bodies, one after the other, and the unknowns that determine them.

    Attributes:
        rest_positions: Positions at rest [m], shape (node_count, 3).
        free_nodes: Nodes that are unknowns themselves, shape (count,); these unknowns come first.
        free_index: Unknown of each node, -1 for a fixed or guided node, and an index from
            `free_node_count` on for a carried point, shape (node_count,).
        free_node_count: Number of unknowns, three numbers each.
        size: Size of the largest body, see `size_of_body` [m]; infinite for a single point.
        kinds: Kinds of unknowns besides free nodes, in the order of their carried points.
        free_axes: 1.0 along each axis that an unknown may move along, 0.0 along those where it is held,
            shape (free_node_count, 3); None where none is held; see `held_axes`.
    """

    rest_positions: np.ndarray
    free_nodes: np.ndarray
    free_index: np.ndarray
    free_node_count: int
    size: float
    kinds: tuple[UnknownKind, ...] = field(default=())
    free_axes: np.ndarray | None = None

    @property
    def finite_size(self) -> float:
        """The same size, 1 m for a single point, which has none [m]."""
        return float(self.size) if np.isfinite(self.size) else 1.0

    @cached_property
    def carried(self) -> CarriedPoints | None:
        """The points that have no unknowns of their own but move; None without any."""
        points = CarriedPoints(self.free_node_count, self.kinds)
        return points if points.count else None

    @property
    def coordinate_nodes(self) -> np.ndarray:
        """Free nodes that are no points, but coordinates of reduced bodies, shape (count,)."""
        own = [getattr(kind, "coordinate_nodes", np.empty(0, np.int64)) for kind in self.kinds]
        return np.concatenate([np.empty(0, np.int64), *own])

    def advance(self, positions: np.ndarray, move: np.ndarray, share: float) -> None:
        """Move the nodes.

        Args:
            positions: Node positions [m], shape (node_count, 3); moved.
            move: Move of each unknown [m], of rotations [rad], shape (free_node_count, 3).
            share: Share of the move that is made.
        """
        advance_nodes(positions, self.free_nodes, move, share)
        for kind in self.kinds:
            kind.advance(positions, move, share)

    def placed_like(self, own: Nodes, positions: np.ndarray) -> np.ndarray:
        """Positions at the displacements and rotations of nodes that rest elsewhere [m].

        Args:
            own: The other nodes, of the same structure.
            positions: Their positions [m], shape (node_count, 3).
        """
        if np.array_equal(self.rest_positions, own.rest_positions):
            return positions.copy()
        placed, given = self.rest_positions.copy(), own.free_index < 0
        placed[given] += (positions - own.rest_positions)[given]
        self.advance(placed, own.displacement(own.rest_positions, positions), 1.0)
        return placed

    def displacement(self, before: np.ndarray, after: np.ndarray) -> np.ndarray:
        """Displacement [m], rotation vector [rad] for rotations, from one state to another.

        Args:
            before: Node positions [m], shape (node_count, 3).
            after: Those of the later state [m], same shape.

        Returns:
            Displacement of each unknown, shape (free_node_count, 3).
        """
        displacement = np.empty((self.free_node_count, 3))
        write_displacement(before, after, self.free_nodes, displacement)
        for kind in self.kinds:
            kind.displacement(before, after, displacement)
        return displacement

    def longest(self, move: np.ndarray) -> float:
        """Longest displacement of a point in a move [m]; not finite if any component is not.

        Args:
            move: Displacement of the unknowns [m], shape (free_node_count, 3).
        """
        largest = np.empty(1)
        self.write_largest(move, False, largest)
        return float(largest[0])

    def write_largest(self, vectors: np.ndarray, are_forces: bool, largest: np.ndarray) -> None:
        """Write the longest displacement of a point, or the largest force on a node.

        Args:
            vectors: Move [m] or forces [N] of the unknowns, shape (free_node_count, 3).
            are_forces: True for forces; torques count as forces at the body's furthest point.
            largest: Takes it, shape (1,); not finite if any component is not.
        """
        write_longest_row(vectors[: len(self.free_nodes)] if self.kinds else vectors, largest)
        for kind in self.kinds:
            kind.raise_largest(vectors, are_forces, largest)


def each_once(rows: np.ndarray) -> np.ndarray:
    """Indices of each row once and in falling order, -1 where none, shape (row_count, width).

    Args:
        rows: Indices, -1 where none, shape (row_count, any).
    """
    rows = -np.sort(-rows, axis=1)
    rows[:, 1:][rows[:, 1:] == rows[:, :-1]] = -1
    rows = -np.sort(-rows, axis=1)
    return rows[:, : max(1, int((rows >= 0).sum(axis=1).max(initial=0)))]


def moved_by(points, indices: np.ndarray) -> np.ndarray:
    """Unknowns that move nodes and points, -1 where none, shape (*indices.shape, width).

    Args:
        points: The `CarriedPoints`.
        indices: Free-node indices, those of carried points after them, -1 where none.
    """
    width = max(1, points.unknowns.shape[1])
    table = np.full((points.free_count + points.count + 1, width), -1, np.int64)
    table[: points.free_count, 0] = np.arange(points.free_count)
    table[points.free_count : -1] = points.unknowns
    return table[indices]


def points_among(indices: np.ndarray, free_count: int) -> np.ndarray:
    """The carried points among unknowns and points, each once, numbered from 0.

    Args:
        indices: Unknowns and carried points, -1 where there is none.
        free_count: Number of unknowns.
    """
    return np.unique(indices[indices >= free_count]) - free_count


class CarriedPoints:
    """All carried points of a scene, and their derivatives by the unknowns.

    Attributes:
        free_count: Number of unknowns; carried points are numbered from here on.
        count: Number of carried points.
        unknowns: Unknowns that each depends on, -1 where none, shape (count, width).
        derivatives: D, shape (count, width, 3, 3), at the state given to `update` last.
        turning_unknowns: Row of each block with a turning term, shape (turning_count,).
        turning_columns: Its column, shape (turning_count,).
    """

    def __init__(self, free_count: int, kinds: tuple[UnknownKind, ...]):
        """Collect the points of all kinds.

        Args:
            free_count: Number of unknowns.
            kinds: The kinds that carry points.
        """
        self.free_count = free_count
        self._kinds = kinds
        width = max((kind.carried_unknowns.shape[1] for kind in kinds), default=0)
        ends = np.cumsum([0] + [len(kind.carried_unknowns) for kind in kinds])
        self._parts = [slice(a, b) for a, b in zip(ends[:-1], ends[1:], strict=True)]
        self.count = int(ends[-1])
        self.unknowns = np.full((self.count, width), -1, np.int64)
        for kind, part in zip(kinds, self._parts, strict=True):
            own = kind.carried_unknowns
            self.unknowns[part, : own.shape[1]] = own
        self.derivatives = np.zeros((self.count, width, 3, 3))
        self._known_at = np.empty((0, 3))
        self._changing = []
        for kind, part in zip(kinds, self._parts, strict=True):
            if kind.has_constant_derivatives:
                kind.write_derivatives(self._known_at, self.derivatives[part])
            else:
                self._changing.append((kind, part))
        self._all = np.arange(self.count)
        self._turning_points = np.concatenate(
            [np.empty(0, np.int64), *(self._all[part] for _, part in self._changing)]
        )
        none = [np.empty(0, np.int64)]
        self.turning_unknowns = np.concatenate(none + [kind.turning_unknowns for kind in kinds])
        self.turning_columns = np.concatenate(none + [kind.turning_columns for kind in kinds])
        self._turning_blocks = np.zeros((len(self.turning_unknowns), 3, 3))
        self._moves = np.empty((free_count + self.count, 3))

    def fold(self, positions: np.ndarray, stiffness: sp.csr_array) -> sp.csr_array:
        """A stiffness of unknowns and carried points, by unknowns: Dᵀ K D.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            stiffness: K [N/m], shape (3 (free_count + count), same).

        Returns:
            Shape (3 free_count, 3 free_count).
        """
        self.update(positions)
        points, columns = np.nonzero(self.unknowns >= 0)
        own, axes = 3 * np.arange(self.free_count + self.count), np.arange(3)
        unknowns = np.concatenate([own[: self.free_count], 3 * self.unknowns[points, columns]])
        carried = np.concatenate([own[: self.free_count], own[self.free_count + points]])
        blocks = np.concatenate([np.tile(np.eye(3), (self.free_count, 1, 1)),
                                 self.derivatives[points, columns]])  # fmt: skip
        lines, rows = carried[:, None, None] + axes[:, None], unknowns[:, None, None] + axes
        lines, rows = np.broadcast_arrays(lines, rows)
        D = sp.coo_array((blocks.ravel(), (lines.ravel(), rows.ravel())),
                         shape=(len(own) * 3, 3 * self.free_count)).tocsr()  # fmt: skip
        return D.T @ stiffness @ D

    def update(self, positions: np.ndarray) -> None:
        """Compute D at a state: node positions [m], shape (node_count, 3).

        Several terms ask for the same state one after the other: it is computed once.

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        if not self._changing or are_same(self._known_at, positions):
            return
        if len(self._known_at) != len(positions):
            self._known_at = np.empty_like(positions)
        copy_vectors(positions, self._known_at)
        for kind, part in self._changing:
            kind.write_derivatives(positions, self.derivatives[part])

    @property
    def is_traceable(self) -> bool:
        """Whether all kinds write what changes by kernels; see `ForceTerm.is_traceable`."""
        return all(getattr(kind, "is_traceable", False) for kind in self._kinds)

    def fold_forces(self, point_forces: np.ndarray, forces: np.ndarray, own: np.ndarray) -> None:
        """Add Dᵀ f of some carried points; `update` has been called for the state.

        Args:
            point_forces: f [N], shape (count, 3).
            forces: Forces on the unknowns, shape (free_count, 3); added to.
            own: The points, shape (own_count,).
        """
        fold_own_forces(own, self.unknowns, self.derivatives, point_forces, forces)

    def turning(self, positions: np.ndarray, point_forces: np.ndarray) -> np.ndarray:
        """Turning terms, shape (turning_count, 3, 3), overwritten by the next call; see `UnknownKind.add_turning`."""
        blocks, first = self._turning_blocks, 0
        clear(blocks.reshape(-1))
        for kind, part in zip(self._kinds, self._parts, strict=True):
            last = first + len(kind.turning_unknowns)
            kind.add_turning(positions, point_forces[part], blocks[first:last])
            first = last
        return blocks

    def point_moves(
        self, positions: np.ndarray, move: np.ndarray, own: np.ndarray | None = None
    ) -> np.ndarray:
        """A move of the unknowns, and behind it the move of each carried point to first order [m].

        Args:
            positions: Node positions [m], shape (node_count, 3).
            move: Of each unknown, shape (free_count, 3).
            own: The points that are asked for; the moves of others are left unwritten. None for
                all.

        Returns:
            Shape (free_count + count, 3); the next call overwrites it.
        """
        self.update(positions)
        moves = self._moves
        copy_vectors(move, moves)
        own = self._all if own is None else own
        write_point_moves(own, self.unknowns, self.derivatives, moves, moves[self.free_count :])
        return moves

    def shared_unknowns(self, own: np.ndarray) -> np.ndarray | None:
        """The unknowns that some points have in common, if their derivatives are constant.

        Args:
            own: The points, shape (own_count,).

        Returns:
            Shape (width,); None where there are no points, or these differ.
        """
        unknowns = self.unknowns[own]
        turns = np.isin(own, self._turning_points).any()
        if not len(own) or turns or (unknowns != unknowns[0]).any():
            return None
        return unknowns[0]


@njit(**KERNEL)
def write_point_moves(own, unknowns, derivatives, moves, out):
    """Σ D dq of some carried points.

    Args:
        own: The points, shape (own_count,).
        unknowns: Unknowns that each carried point depends on, -1 where none,
            shape (carried_count, width).
        derivatives: D, shape (carried_count, width, 3, 3).
        moves: dq, the move of each unknown, in the first rows, shape (free_count or more, 3).
        out: Takes the moves of the points [m], shape (carried_count, 3).
    """
    for p in own:
        for i in range(3):
            out[p, i] = 0.0
        for j in range(unknowns.shape[1]):
            u = unknowns[p, j]
            if u >= 0:
                for i in range(3):
                    for k in range(3):
                        out[p, i] += derivatives[p, j, i, k] * moves[u, k]


@njit(**KERNEL)
def fold_own_forces(own, unknowns, derivatives, point_forces, forces):
    """Add Dᵀ f of some carried points to the forces on their unknowns.

    Args:
        own: The points, shape (own_count,).
        unknowns: Unknowns that each carried point depends on, -1 where none,
            shape (carried_count, width).
        derivatives: D, shape (carried_count, width, 3, 3).
        point_forces: f of each carried point [N], shape (carried_count, 3).
        forces: Forces on the unknowns, shape (free_count, 3); added to.
    """
    for p in own:
        for j in range(unknowns.shape[1]):
            u = unknowns[p, j]
            if u >= 0:
                for i in range(3):
                    for k in range(3):
                        forces[u, i] += derivatives[p, j, k, i] * point_forces[p, k]


@njit(**KERNEL)
def carry_rows(free_count, unknowns, derivatives, rows, nodes, blocks, out_rows, out_nodes, out_blocks):
    """Transform entries of H to the unknowns.

    Successive entries of one row at points with the same unknowns are summed into one set.

    Args:
        free_count: Number of unknowns; a carried point's number follows on.
        unknowns: Unknowns that each carried point depends on, -1 where none,
            shape (carried_count, width).
        derivatives: D, shape (carried_count, width, 3, 3).
        rows: Row of each entry, shape (entry_count,).
        nodes: Unknown or carried point of each entry, same shape.
        blocks: Derivative by that point's position, shape (entry_count, 3).
        out_rows: Takes the row of each entry written, shape (capacity,).
        out_nodes: Takes the unknown of each entry written, same shape.
        out_blocks: Takes the derivative by that unknown, shape (capacity, 3).

    Returns:
        Number of entries written.
    """
    count, last_row, last_point, width = 0, -1, -1, 0
    for e in range(len(rows)):
        row, p = rows[e], nodes[e] - free_count
        if p < 0:
            out_rows[count], out_nodes[count] = row, nodes[e]
            for i in range(3):
                out_blocks[count, i] = blocks[e, i]
            count, last_point = count + 1, -1
            continue
        same = last_point >= 0 and row == last_row
        for j in range(unknowns.shape[1]):
            same = same and unknowns[p, j] == unknowns[last_point, j]
        if not same:
            width = 0
            for j in range(unknowns.shape[1]):
                if unknowns[p, j] >= 0:
                    out_rows[count + width], out_nodes[count + width] = row, unknowns[p, j]
                    out_blocks[count + width] = 0.0
                    width += 1
            count, last_row = count + width, row
        last_point, place = p, count - width
        for j in range(unknowns.shape[1]):
            if unknowns[p, j] >= 0:
                for i in range(3):
                    for k in range(3):
                        out_blocks[place, i] += derivatives[p, j, k, i] * blocks[e, k]
                place += 1
    return count


class CarriedRows:
    """Entries of H at the unknowns, in memory that is reused from call to call.

    Attributes:
        points: The carried points.
        count: Number of entries written last.
        row_index: Row of each entry; the first `count` hold, shape (capacity,).
        node_index: Its unknown, shape (capacity,).
        blocks: Derivative by that unknown [-] or [m], shape (capacity, 3).
    """

    def __init__(self, points: CarriedPoints, most_entries: int):
        """Allocate.

        Args:
            points: The carried points.
            most_entries: Entries that are expected at most; memory grows where more come.
        """
        self.points = points
        self.count = 0
        self._allocate(most_entries)

    def _allocate(self, most_entries: int) -> None:
        capacity = max(1, self.points.unknowns.shape[1]) * most_entries
        self.row_index = np.zeros(capacity, dtype=np.int64)
        self.node_index = np.zeros(capacity, dtype=np.int64)
        self.blocks = np.zeros((capacity, 3))

    def reduce(
        self,
        positions: np.ndarray,
        row_index: np.ndarray,
        node_index: np.ndarray,
        blocks: np.ndarray,
    ) -> int:
        """Write the entries.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            row_index: Row of each entry, shape (entry_count,).
            node_index: Its unknown or carried point, not negative, shape (entry_count,).
            blocks: Derivative by that point's position, shape (entry_count, 3).

        Returns:
            Number of entries written, `count`.
        """
        points = self.points
        if points.unknowns.shape[1] * len(row_index) > len(self.row_index):
            self._allocate(2 * len(row_index))
        points.update(positions)
        self.count = carry_rows(
            points.free_count, points.unknowns, points.derivatives, row_index, node_index, blocks,
            self.row_index, self.node_index, self.blocks,
        )  # fmt: skip
        return self.count


# Forms in which a folded block D_pjᵀ K D_qk is added to the lower triangle of A.
AS_IS, TRANSPOSED, BOTH = 0, 1, 2


@njit(**KERNEL)
def add_plain_blocks(sources, offsets, strides, scratch, storage):
    """Add 3×3 blocks without a transformation.

    Args:
        sources: Where each block begins in `scratch`, shape (count,).
        offsets: Where each block begins in the storage, same shape.
        strides: Distance between two columns of the block there, same shape.
        scratch: Blocks, column after column [N/m], shape (9 block_count,).
        storage: The factorization's storage [N/m]; added to.
    """
    for k in range(len(sources)):
        columns = rows(scratch[sources[k] : sources[k] + 9].reshape(3, 3))
        add_block(transposed(columns), offsets[k], strides[k], storage)


@njit(**KERNEL)
def add_turning_blocks(blocks, reached, is_upper, offsets, strides, storage):
    """Add some of the turning blocks, transposed where their place is.

    Args:
        blocks: All of them [N m], shape (turning_count, 3, 3).
        reached: Those that are added, shape (count,).
        is_upper: Whether each is transposed, shape (count,).
        offsets: Where each begins in the storage, shape (count,).
        strides: Distance between two columns of it there, shape (count,).
        storage: The factorization's storage, shape (size,); added to.
    """
    for k in range(len(reached)):
        block = rows(blocks[reached[k]])
        block = transposed(block) if is_upper[k] else block
        add_block(block, offsets[k], strides[k], storage)


@njit(**KERNEL)
def fold_blocks(plan, offsets, strides, derivatives, scratch, storage):
    """Add D_pjᵀ K_pq D_qk of every line of a plan; D of a free node, p < 0, is the unit matrix.

    Args:
        plan: Lines (source, p, j, q, k, form), shape (line_count, 6).
        offsets: Where the block of each line begins in the storage, shape (line_count,).
        strides: Distance between two columns of the block there, same shape.
        derivatives: D of all carried points, shape (carried_count, width, 3, 3).
        scratch: K, blocks column after column [N/m], shape (9 block_count,).
        storage: The factorization's storage [N/m]; added to.
    """
    for line in range(len(plan)):
        source, p, q, form = plan[line, 0], plan[line, 1], plan[line, 3], plan[line, 5]
        left = rows(derivatives[p, plan[line, 2]]) if p >= 0 else IDENTITY
        right = rows(derivatives[q, plan[line, 4]]) if q >= 0 else IDENTITY
        columns = rows(scratch[source : source + 9].reshape(3, 3))
        block = transposed_product(left, transposed_product(columns, right))
        o, stride = offsets[line], strides[line]
        for j in range(3):
            for i in range(3):
                if form != TRANSPOSED:
                    storage[o + j * stride + i] += block[i][j]
                if form != AS_IS:
                    storage[o + i * stride + j] += block[i][j]


@njit(**KERNEL)
def multiply_blocks(pairs, scratch, D, out):
    """K D of symmetric blocks K_ab between points: each pair (source, a, b) is one of them.

    Args:
        pairs: Where the block starts, and its two points, shape (pair_count, 3).
        scratch: The blocks, column by column.
        D: Rows of the points, shape (3 point_count, size).
        out: Takes K D, same shape.
    """
    out[:] = 0.0
    for line in range(len(pairs)):
        source, a, b = pairs[line, 0], 3 * pairs[line, 1], 3 * pairs[line, 2]
        for i in range(3):
            for j in range(3):
                value = scratch[source + 3 * j + i]
                if value == 0.0:
                    continue
                for c in range(D.shape[1]):
                    out[a + i, c] += value * D[b + j, c]
                if a != b:
                    for c in range(D.shape[1]):
                        out[b + j, c] += value * D[a + i, c]


@njit(**KERNEL)
def multiply_segments(matrices, ends, loaded, half):
    """E and K E of the segments whose K is not zero, one after the other; gives their number.

    Args:
        matrices: K of each, shape (segment_count, 3, 3).
        ends: E of each, shape (3 segment_count, size).
        loaded: Takes E, same shape.
        half: Takes K E, same shape.
    """
    count = 0
    for s in range(len(matrices)):
        K = matrices[s]
        if K[0, 0] + K[1, 1] + K[2, 2] == 0.0:
            continue
        first, second, third = ends[3 * s], ends[3 * s + 1], ends[3 * s + 2]
        for i in range(3):
            loaded[3 * count + i] = ends[3 * s + i]
            out = half[3 * count + i]
            for c in range(len(out)):
                out[c] = K[i, 0] * first[c] + K[i, 1] * second[c] + K[i, 2] * third[c]
        count += 1
    return count


@njit(**KERNEL)
def add_clique(offsets, strides, matrix, storage):
    """Add the blocks of a symmetric matrix whose offset is not negative.

    Args:
        offsets: Where each block begins in the storage, -1 for none, shape (width, width).
        strides: Distance between two columns of the block there, same shape.
        matrix: The matrix, shape (3 width, 3 width).
        storage: The factorization's storage [N/m]; added to.
    """
    for j in range(len(offsets)):
        for m in range(len(offsets)):
            block = rows(matrix[3 * j : 3 * j + 3, 3 * m : 3 * m + 3])
            add_block(block, offsets[j, m], strides[j, m], storage)


def clique_slots(unknowns: np.ndarray, rank: np.ndarray, slots) -> tuple[np.ndarray, np.ndarray]:
    """Places in the storage of the blocks of some unknowns that are all coupled.

    Args:
        unknowns: They, -1 where none, shape (width,).
        rank: Place of each unknown in the elimination order.
        slots: The factorization's `slots`.

    Returns:
        Offset of each block, -1 where it has none of its own, and distance of its columns, both of
        shape (width, width).
    """
    rows, columns = np.meshgrid(unknowns, unknowns, indexing="ij")
    lower = (rows >= 0) & (columns >= 0)
    lower &= rank[rows] >= rank[columns]
    offsets, strides = np.full(lower.shape, -1, np.int64), np.zeros(lower.shape, np.int64)
    offsets[lower], strides[lower] = slots(rows[lower], columns[lower])
    return offsets, strides


class CommonUnknowns:
    """Stiffness between points that all depend on the same unknowns: Dᵀ K D by one product.

    A line for each two unknowns of each two points, as `FoldedStiffness` plans them in general,
    would be thousands for the coordinates of a reduced body.
    """

    def __init__(self, points: CarriedPoints, own: np.ndarray, unknowns: np.ndarray, rank, slots):
        """Find the places of the blocks in the storage.

        Args:
            points: The carried points, with constant derivatives.
            own: Those that are coupled, shape (own_count,).
            unknowns: What they depend on, -1 where none, shape (width,).
            rank: Place of each unknown in the elimination order.
            slots: The factorization's `slots`.
        """
        D = points.derivatives[own].transpose(0, 2, 1, 3)
        self.D = np.ascontiguousarray(D.reshape(3 * len(own), -1))
        self.half, self._loaded = np.empty_like(self.D), np.empty((0, 0))
        self._folded = np.empty((self.D.shape[1],) * 2)
        self._offsets, self._strides = clique_slots(unknowns, rank, slots)

    def take_segments(self, ends: np.ndarray) -> None:
        """Take E of segments in place of D, three rows each, shape (3 segment_count, size).

        Args:
            ends: E, shape (3 segment_count, size).
        """
        self.D = np.ascontiguousarray(ends)
        self.half, self._loaded = np.empty_like(self.D), np.empty_like(self.D)

    def add(self, storage: np.ndarray) -> None:
        """Add Dᵀ (K D) to the system matrix; `half` holds the product K D.

        Args:
            storage: The factorization's storage [N/m]; added to.
        """
        multiply_transposed(self.D, self.half, self._folded)
        add_clique(self._offsets, self._strides, self._folded, storage)

    def add_segments(self, matrices: np.ndarray, storage: np.ndarray) -> None:
        """Add Eᵀ K E with a matrix K of each segment, shape (segment_count, 3, 3).

        Args:
            matrices: K of each segment [N/m], shape (segment_count, 3, 3).
            storage: The factorization's storage [N/m]; added to.
        """
        count = 3 * multiply_segments(matrices, self.D, self._loaded, self.half)
        if count:
            multiply_transposed(self._loaded[:count], self.half[:count], self._folded)
            add_clique(self._offsets, self._strides, self._folded, storage)


class FoldedStiffness:
    """Stiffness between points, assembled on its own and folded into the system matrix.

    Attributes:
        scratch: Buffer to which a term adds the blocks of its points, shape (9 block_count,).
    """

    def __init__(self, points: CarriedPoints, stencils: np.ndarray):
        """Take the stencils.

        Args:
            points: The carried points.
            stencils: Unknowns and carried points that each element couples, -1 where none,
                shape (element_count, width).
        """
        self._points, self._point_stencils = points, np.asarray(stencils, np.int64)
        self.scratch = np.empty(0)

    def stencils(self) -> np.ndarray:
        """Unknowns that each element couples, each once, -1 where none, one line an element."""
        unknowns = moved_by(self._points, self._point_stencils)
        return each_once(unknowns.reshape(len(unknowns), -1))

    def bind(self, elimination_rank: np.ndarray, slots):
        """Plan the places of the blocks.

        Args:
            elimination_rank: Place of each unknown in the elimination order,
                shape (free_node_count,).
            slots: The factorization's `slots`.

        Returns:
            Ranks of unknowns and carried points, and the slots of their blocks in `scratch`, for
            binding the term itself.
        """
        points, free = self._points, self._points.free_count
        total = free + points.count
        rank = np.concatenate([elimination_rank, np.arange(free, total)])
        rows, columns = stencil_pairs(self._point_stencils)
        lower = rank[rows] >= rank[columns]
        keys = np.unique(rows[lower] * total + columns[lower])
        self.scratch = np.zeros(9 * len(keys))
        p, q = np.divmod(keys, total)
        plain = (p < free) & (q < free)
        self._sources = 9 * np.flatnonzero(plain)
        self._offsets, self._strides = slots(p[plain], q[plain])
        own = points_among(np.concatenate([p, q]), free)
        unknowns = points.shared_unknowns(own)
        self._common = None
        if unknowns is not None and (p[~plain] >= free).all() and (q[~plain] >= free).all():
            self._common = CommonUnknowns(points, own, unknowns, rank, slots)
            places = [np.searchsorted(own, index[~plain] - free) for index in (p, q)]
            self._pairs = np.column_stack([9 * np.flatnonzero(~plain), *places])
            plain = np.ones_like(plain)
        self._plan_folds(9 * np.flatnonzero(~plain), p[~plain], q[~plain], rank, slots)
        self._turning = TurningBlocks(points, self.stencils(), rank, slots)

        def scratch_slots(rows, columns):
            places = 9 * np.searchsorted(keys, np.asarray(rows) * total + columns)
            return places, np.full(places.shape, 3, np.int64)

        return rank, scratch_slots

    def _plan_folds(self, sources, p, q, rank, slots) -> None:
        """One line for each pair of unknowns of each pair of points."""
        plan, rows, columns = [], [], []
        for source, a, b in zip(sources, p, q, strict=True):
            for unknown_a, point_a, j in self._reached(a):
                for unknown_b, point_b, k in self._reached(b):
                    swapped = rank[unknown_a] < rank[unknown_b]
                    if a == b and swapped:
                        continue  # the other order of the two gives the lower block
                    form = TRANSPOSED if swapped else AS_IS
                    if a != b and unknown_a == unknown_b:
                        form = BOTH
                    plan.append((source, point_a, j, point_b, k, form))
                    rows.append(unknown_b if swapped else unknown_a)
                    columns.append(unknown_a if swapped else unknown_b)
        self._plan = np.array(plan, np.int64).reshape(-1, 6)
        self._fold_offsets, self._fold_strides = slots(
            np.array(rows, np.int64), np.array(columns, np.int64)
        )

    def _reached(self, index: int) -> list[tuple[int, int, int]]:
        """Unknown, carried point (-1 for a free node) and column of D, of a point's index."""
        free = self._points.free_count
        if index < free:
            return [(index, -1, 0)]
        own = self._points.unknowns[index - free]
        return [(int(u), int(index - free), j) for j, u in enumerate(own) if u >= 0]

    def clear(self) -> None:
        """Set the blocks of the points to zero."""
        clear(self.scratch)

    def fold(self, positions: np.ndarray, point_forces: np.ndarray | None, storage: np.ndarray) -> None:
        """Add the stiffness in `scratch` to the system matrix.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            point_forces: Forces on the carried points [N], shape (carried_count, 3); None leaves
                the turning terms out, so that a positive stiffness stays positive.
            storage: The factorization's storage; added to.
        """
        points = self._points
        points.update(positions)
        add_plain_blocks(self._sources, self._offsets, self._strides, self.scratch, storage)
        fold_blocks(
            self._plan, self._fold_offsets, self._fold_strides, points.derivatives, self.scratch,
            storage,
        )  # fmt: skip
        if self._common is not None:
            multiply_blocks(self._pairs, self.scratch, self._common.D, self._common.half)
            self._common.add(storage)
        if point_forces is not None:
            self._turning.add(positions, point_forces, storage)


@njit(**INNER)
def write_ends(nodes, coefficients, places, free_count, derivatives, ends):
    """E_j = Σ c_a D_aj of one segment, by each of its unknowns.

    Args:
        nodes: Unknown or carried point of each c_a, -1 where none, shape (width,).
        coefficients: c_a, same shape.
        places: Row of `ends` for each unknown of each point, -1 where none,
            shape (width, point_width).
        free_count: Number of unknowns; a carried point's number follows on.
        derivatives: D of all carried points, shape (carried_count, point_width, 3, 3).
        ends: Takes E, shape (unknown_count, 3, 3).
    """
    ends[:] = 0.0
    for a in range(len(nodes)):
        n = nodes[a]
        for j in range(places.shape[1]):
            place = places[a, j]
            if place < 0:
                continue
            for i in range(3):
                if n < free_count:
                    ends[place, i, i] += coefficients[a]
                else:
                    for k in range(3):
                        ends[place, i, k] += coefficients[a] * derivatives[n - free_count, j, i, k]


@njit(**KERNEL)
def fold_segments(
    matrices, nodes, coefficients, places, free_count, derivatives, offsets, strides, ends,
    storage,
):  # fmt: skip
    """Add E_jᵀ K E_k of every segment whose K is not zero.

    Args:
        matrices: K of each segment [N/m], shape (segment_count, 3, 3).
        nodes: Unknown or carried point of each c_a, -1 where none, shape (segment_count, width).
        coefficients: c_a, same shape.
        places: Row of `ends` for each unknown of each point, -1 where none,
            shape (segment_count, width, point_width).
        free_count: Number of unknowns; a carried point's number follows on.
        derivatives: D of all carried points, shape (carried_count, point_width, 3, 3).
        offsets: Place of each pair's block, -1 for none, shape (segment_count, pair_count).
        strides: Distance between two columns of that block, same shape.
        ends: Memory for E of one segment, shape (unknown_count, 3, 3).
        storage: The factorization's storage [N/m]; added to.
    """
    count = len(ends)
    for s in range(len(nodes)):
        K = matrices[s]
        if K[0, 0] + K[1, 1] + K[2, 2] == 0.0:
            continue
        write_ends(nodes[s], coefficients[s], places[s], free_count, derivatives, ends)
        pair = 0
        for column in range(count):
            if offsets[s, pair] < 0:  # where a segment has fewer unknowns, absent ones come first
                pair += count - column
                continue
            E = ends[column]
            half = product(rows(K), rows(E))
            for line in range(column, count):
                block = transposed_product(rows(ends[line]), half)
                add_block(block, offsets[s, pair], strides[s, pair], storage)
                pair += 1


class FoldedSegments:
    """Stiffness of segments r = Σ c_a x_a between points, folded into the system matrix.

    The stiffness of two points of a segment is c_a c_b K, with one matrix K for all of them. With
    E_j = Σ c_a D_aj it adds E_jᵀ K E_k: the number of points does not count, only that of unknowns.
    """

    def __init__(self, points: CarriedPoints, nodes: np.ndarray, coefficients: np.ndarray):
        """Take the segments.

        Args:
            points: The carried points.
            nodes: Unknown or carried point of each c_a, -1 where none, shape
                (segment_count, width).
            coefficients: c_a, same shape.
        """
        self._points, self._nodes, self._coefficients = points, nodes, coefficients
        self._unknowns = FoldedStiffness(points, nodes).stencils()
        self._ends = np.zeros((self._unknowns.shape[1], 3, 3))
        self._bound = self._places = self._turning = None

    def stencils(self) -> np.ndarray:
        """Unknowns that each segment couples, -1 where none, shape (segment_count, count)."""
        return self._unknowns

    @property
    def turns(self) -> bool:
        """Whether forces on the points add turning terms."""
        return self._common is None

    def bind(self, elimination_rank: np.ndarray, slots) -> None:
        """Find the places of the blocks in the storage; see `ForceTerm.bind`."""
        points = self._points
        self._bound = bind_stencils(self._unknowns, elimination_rank, slots)
        ordered = np.take_along_axis(self._unknowns, self._bound.order, axis=1)
        reached = moved_by(points, self._nodes)
        same = reached[:, :, :, None] == ordered[:, None, None, :]
        self._places = np.where(reached >= 0, same.argmax(axis=3), -1)
        self._turning = TurningBlocks(points, self._unknowns, elimination_rank, slots)
        free = points.free_count
        own = points_among(self._nodes, free)
        shared = points.shared_unknowns(own)
        self._common = None
        if shared is not None and not ((self._nodes >= 0) & (self._nodes < free)).any():
            self._common = CommonUnknowns(points, own, shared, elimination_rank, slots)
            ends = self._common.D.reshape(len(own), 3, -1)
            places = np.where(self._nodes >= 0, np.searchsorted(own, self._nodes - free), 0)
            shares = np.where(self._nodes >= 0, self._coefficients, 0.0)
            own_ends = np.einsum("sa,saiu->siu", shares, ends[places])
            self._common.take_segments(own_ends.reshape(3 * len(places), -1))

    def add(
        self, positions: np.ndarray, matrices: np.ndarray, point_forces: np.ndarray | None,
        storage: np.ndarray,
    ) -> None:
        """Add the stiffness to the system matrix.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            matrices: K of each segment [N/m], positive semidefinite, shape (segment_count, 3, 3).
            point_forces: Forces on the carried points [N]; see `FoldedStiffness.fold`.
            storage: The factorization's storage; added to.
        """
        points, bound = self._points, self._bound
        points.update(positions)
        if self._common is not None:
            self._common.add_segments(matrices, storage)
            return
        fold_segments(
            matrices, self._nodes, self._coefficients, self._places, points.free_count,
            points.derivatives, bound.offsets, bound.strides, self._ends, storage,
        )  # fmt: skip
        if point_forces is not None:
            self._turning.add(positions, point_forces, storage)


class TurningBlocks:
    """Places of the turning terms of some unknowns in the system matrix."""

    def __init__(self, points: CarriedPoints, unknowns: np.ndarray, rank: np.ndarray, slots):
        """Find them.

        Args:
            points: The carried points.
            unknowns: The unknowns.
            rank: Place of each unknown in the elimination order, shape (free_count,) or more.
            slots: The factorization's `slots`.
        """
        pairs = np.column_stack([points.turning_unknowns, points.turning_columns])
        self._reached = np.flatnonzero(np.isin(pairs, unknowns).all(axis=1))
        pairs = pairs[self._reached]
        self._is_upper = rank[pairs[:, 0]] < rank[pairs[:, 1]]
        pairs[self._is_upper] = pairs[self._is_upper, ::-1]
        self._points, self._places = points, slots(pairs[:, 0], pairs[:, 1])

    def add(self, positions: np.ndarray, point_forces: np.ndarray, storage: np.ndarray) -> None:
        """Add the turning terms.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            point_forces: Forces on the carried points [N], shape (carried_count, 3).
            storage: The factorization's storage; added to.
        """
        if len(self._reached):
            blocks = self._points.turning(positions, point_forces)
            add_turning_blocks(blocks, self._reached, self._is_upper, *self._places, storage)


# What a term is and does whatever its points are carried by.
SAME_ON_POINTS = (
    "name", "remembers_start", "is_slender", "stays_upright", "is_inertia", "begin_step",
    "begin_rates", "largest_share", "energy", "kinetic_energy",
)  # fmt: skip
SAME_INERTIA = ("begin_second_order", "add_accelerations")


class CarriedTerm(ForceTerm):
    """A force term some of whose elements hold carried points."""

    def __init__(self, term: ForceTerm, points: CarriedPoints):
        """Take the term.

        Args:
            term: The term, not bound yet.
            points: The carried points.
        """
        self._term = term
        for name in SAME_ON_POINTS + (SAME_INERTIA if term.is_inertia else ()):
            setattr(self, name, getattr(term, name))
        self.is_traceable = term.is_traceable and getattr(points, "is_traceable", False)
        self._points = points
        self._stiffness = FoldedStiffness(points, term.stencils())
        self._forces = np.zeros((points.free_count + points.count, 3))
        self._own = points_among(term.stencils(), points.free_count)

    @property
    def on_points(self) -> ForceTerm:
        """The term that works on points; see `ForceTerm.on_points`."""
        return self._term

    def stencils(self) -> np.ndarray:
        """Unknowns that each element couples; see `ForceTerm.stencils`."""
        return self._stiffness.stencils()

    def bind(self, elimination_rank: np.ndarray, slots) -> None:
        """Bind the term to memory of its own, and plan the fold; see `ForceTerm.bind`."""
        self._term.bind(*self._stiffness.bind(elimination_rank, slots))

    @property
    def weight(self) -> float:
        """See `InertiaTerm`."""
        return self._term.weight

    @weight.setter
    def weight(self, weight: float) -> None:
        self._term.weight = weight

    def add_forces(self, positions: np.ndarray, forces: np.ndarray) -> int:
        """Add the forces; see `ForceTerm.add_forces`."""
        clear(self._forces.reshape(-1))
        inverted_count = self._term.add_forces(positions, self._forces)
        self.nearly_flat_count = self._term.nearly_flat_count
        self.crossed_count = self._term.crossed_count
        self._fold_forces(positions, forces)
        return inverted_count

    def add(self, positions, forces, storage, projected: bool) -> None:
        """Add the forces, and the stiffness to the system matrix; see `ForceTerm.add`."""
        clear(self._forces.reshape(-1))
        self._stiffness.clear()
        self._term.add(positions, self._forces, self._stiffness.scratch, projected)
        self._fold_forces(positions, forces)
        on_points = None if projected else self._forces[self._points.free_count :]
        self._stiffness.fold(positions, on_points, storage)

    def _fold_forces(self, positions, forces) -> None:
        free = self._points.free_count
        add_vectors(self._forces[:free], forces)
        self._points.update(positions)
        self._points.fold_forces(self._forces[free:], forces, self._own)


def on_unknowns(term: ForceTerm, points: CarriedPoints | None) -> ForceTerm:
    """A term as the system sees it: itself, or folded where it holds carried points.

    Args:
        term: A force term that works on points, not bound yet.
        points: The carried points of the scene; None without any.
    """
    if points is None or not (term.stencils() >= points.free_count).any():
        return term
    return CarriedTerm(term, points)
