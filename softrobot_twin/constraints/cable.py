"""Cables: a path of straight segments whose length is the setpoint (Coevoet 2017, eq. 2).

The violation of a cable is its shortening δ = L_rest - L(q), so that its multiplier λ ≥ 0 is the
tension. Every segment is a vector r = Σ c_a x_a + r_0 of node positions x_a, with constant
coefficients c_a (the barycentric weights at its two ends, one end negative) and a constant r_0
(a pull point fixed in the world). Then, with d = r/‖r‖,

    L = Σ ‖r‖,    H_a = -∂L/∂x_a = -Σ c_a d,    ∂²L/∂x_a∂x_b = Σ c_a c_b (1 - d dᵀ)/‖r‖.

The last, times the tension, is the geometric stiffness of a taut cable, positive semidefinite.

A segment of zero length has no direction and exerts no force, as if its two points were merged.
‖r‖ has a kink there, and a body compressed by its cables can have its equilibrium on the kink:
Newton's method would move the two points past each other and back without end. Therefore ‖r‖ is
smoothed below a length ρ, a tenth of the segment's length at rest, as by a guide of finite width:
the segment's length counts as (‖r‖²/ρ + ρ)/2, with d = r/ρ and ∂²L/∂x_a∂x_b = Σ c_a c_b 1/ρ; and no
step reverses the direction of a longer segment.

Arguments of the kernels here:
    coefficients: c of the nodes of each segment, shape (segment_count, width).
    constants: r_0 of each segment [m], shape (segment_count, 3).
    least: A segment that is not longer has no direction [m].
    nodes: Nodes of each segment, -1 where there is none, shape (segment_count, width).
    rounding: ρ of each segment [m], shape (segment_count,).
    x: Node positions [m], shape (node_count, 3).
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from softrobot_twin.constraints.segment_term import SegmentTerm
from softrobot_twin.constraints.spread_stiffness import MOST_COUPLED, SpreadStiffness
from softrobot_twin.geometry.matrix3 import (
    IDENTITY,
    ZERO,
    add_outer,
    scaled_matrix,
    set_rows,
)
from softrobot_twin.geometry.vector3 import divided, dot, negated, norm, row, scaled, set_row
from softrobot_twin.kernels.compilation import INLINED, KERNEL, njit
from softrobot_twin.mechanics.barycentric import BarycentricMapping
from softrobot_twin.mechanics.force_term import DenseRows
from softrobot_twin.mechanics.kinematics import (
    CarriedPoints,
    points_among,
    size_of_points,
)
from softrobot_twin.mechanics.springs import NO_LENGTH, distinct_points, segment_vector
from softrobot_twin.mechanics.stencil import add_block, add_weighted_matrices

# Two segments whose directions have a smaller cosine fold back on each other.
FOLD_COSINE = -0.5
# ρ: a segment shorter than this share of its length at rest is smoothed.
ROUNDED = 0.1


class Wrap(NamedTuple):
    """A cylinder that a segment of a cable is laid around; see `wrapped_cable`.

    Attributes:
        centre: A place on its axis [m], shape (3,).
        axis: Its direction, a unit vector, shape (3,).
        radius: r [m].
        side: Sense in which the cable turns about the axis, 1 or -1.
    """

    centre: np.ndarray
    axis: np.ndarray
    radius: float
    side: float = 1.0


class CablePath(NamedTuple):
    """The path of one cable.

    Attributes:
        name: Name of the cable.
        points: Points carried by the body, in order from the pull point on.
        pull_point: Pull point fixed in the world [m], shape (3,), or None where the first of
            `points` is the pull point.
        wraps: What segments are laid around, by the index of the point where they begin.
    """

    name: str
    points: BarycentricMapping
    pull_point: np.ndarray | None
    wraps: Mapping[int, Wrap] = MappingProxyType({})

    def positions(self, node_positions: np.ndarray) -> np.ndarray:
        """The whole path, pull point first [m], shape (point_count, 3).

        Args:
            node_positions: Node positions [m], shape (node_count, 3).
        """
        points = self.points.positions(node_positions)
        if self.pull_point is None:
            return points
        return np.vstack([self.pull_point, points])


def folds(path: np.ndarray) -> list[int]:
    """Indices of the points where a path changes its direction by more than 120 degrees.

    Args:
        path: Points in order [m], shape (point_count, 3).

    Returns:
        Indices into the path; empty for a path without folds.
    """
    kept = distinct_points(path)
    steps = np.diff(path[kept], axis=0)
    steps /= np.linalg.norm(steps, axis=1, keepdims=True)
    cosines = np.sum(steps[:-1] * steps[1:], axis=1)
    return [kept[i + 1] for i in np.flatnonzero(cosines < FOLD_COSINE)]


@njit(**KERNEL)
def evaluate_kernel(x, nodes, coefficients, constants, least, rounding, cable, entry, blocks, lengths):
    """Lengths of all cables and the entries -c_a d of their rows.

    Args:
        cable: Cable of each segment, shape (segment_count,).
        entry: Entry of H of each node, -1 where fixed, shape (segment_count, width).
        blocks: Takes the entries of H, shape (entry_count, 3).
        lengths: Takes the lengths [m], shape (cable_count,).
    """
    lengths[:] = 0.0
    for s in range(len(nodes)):
        r = segment_vector(x, nodes[s], coefficients[s], constants[s])
        length = norm(r)
        scale = 1.0 / length if length > least else 0.0
        if length < rounding[s]:
            scale = 1.0 / rounding[s]
            length = 0.5 * (length * length * scale + rounding[s])
        lengths[cable[s]] += length
        for a in range(nodes.shape[1]):
            e = entry[s, a]
            if e >= 0:
                set_row(blocks, e, scaled(r, -coefficients[s, a] * scale))


@njit(**INLINED)
def turning_stiffness(r, tension, least, rounding):
    """1 - d dᵀ of one segment, and λ/‖r‖ [N/m], λ/ρ where it is smoothed; zero where it is not taut.

    Args:
        r: The segment [m], three numbers.
        tension: λ [N].
        rounding: ρ [m].
    """
    length, d, k = norm(r), (0.0, 0.0, 0.0), 0.0
    if tension > 0.0 and length < rounding:
        k = tension / rounding
    elif tension > 0.0 and length > least:
        d, k = divided(r, length), tension / length
    return add_outer(IDENTITY, negated(d), d), k


@njit(**KERNEL)
def add_stiffness_kernel(
    x, nodes, coefficients, constants, least, rounding, cable, tensions, offsets, strides, storage
):
    """Add λ c_a c_b (1 - d dᵀ)/‖r‖ of every segment of a taut cable; 1/ρ where it is smoothed.

    Args:
        cable: Place of each segment's tension in `tensions`, shape (segment_count,).
        tensions: λ [N], of shape (cable_count,) where a cable has one tension.
        offsets: Place of each pair's block, -1 for none, shape (segment_count, pair_count).
        strides: Distance between two columns of that block, same shape.
        storage: The factorization's storage [N/m]; added to.
    """
    width = nodes.shape[1]
    for s in range(len(nodes)):
        r = segment_vector(x, nodes[s], coefficients[s], constants[s])
        across, k = turning_stiffness(r, tensions[cable[s]], least, rounding[s])
        if k == 0.0:
            continue
        pair = 0
        for b in range(width):
            if offsets[s, pair] < 0:
                pair += width - b
                continue
            for a in range(b, width):
                block = scaled_matrix(across, k * coefficients[s, a] * coefficients[s, b])
                add_block(block, offsets[s, pair], strides[s, pair], storage)
                pair += 1


@njit(**KERNEL)
def write_matrices(x, nodes, coefficients, constants, least, rounding, cable, tensions, matrices):
    """λ (1 - d dᵀ)/‖r‖ of every segment of a taut cable, 1/ρ where it is smoothed; else zero.

    Args:
        cable: Place of each segment's tension in `tensions`, shape (segment_count,).
        tensions: λ [N], of shape (cable_count,) where a cable has one tension.
        matrices: Takes the matrices [N/m], shape (segment_count, 3, 3).
    """
    for s in range(len(nodes)):
        r = segment_vector(x, nodes[s], coefficients[s], constants[s])
        stiffness = turning_stiffness(r, tensions[cable[s]], least, rounding[s])
        set_rows(matrices[s], scaled_matrix(*stiffness))


@njit(**KERNEL)
def write_squares(x, nodes, coefficients, constants, least, rounding, stiffness, matrices):
    """k d dᵀ of every segment.

    Args:
        stiffness: k of each segment [N/m], shape (segment_count,).
        matrices: Takes the matrices [N/m], shape (segment_count, 3, 3).
    """
    for s in range(len(nodes)):
        r = segment_vector(x, nodes[s], coefficients[s], constants[s])
        length = norm(r)
        scale = 1.0 / length if length > least else 0.0
        if length < rounding[s]:
            scale = 1.0 / rounding[s]
        d = scaled(r, scale)
        set_rows(matrices[s], add_outer(ZERO, scaled(d, max(stiffness[s], 0.0)), d))


@njit(**KERNEL)
def share_kernel(x, nodes, coefficients, constants, least, rounding, free, move):
    """Largest share of a move, at most one, that reverses no segment that is not smoothed.

    Args:
        free: Row of `move` of each node, -1 where fixed, shape (segment_count, width).
        move: Displacement of unknowns, then of carried points [m], shape (row_count, 3).
    """
    share = 1.0
    for s in range(len(nodes)):
        r = segment_vector(x, nodes[s], coefficients[s], constants[s])
        length = norm(r)
        if length <= max(rounding[s], least):
            continue
        shortening = 0.0
        for a in range(nodes.shape[1]):
            n = free[s, a]
            if 0 <= n < len(move):
                shortening -= coefficients[s, a] * dot(r, row(move, n)) / length
        if share * shortening > length:
            share = length / shortening
    return share


@njit(**KERNEL)
def shorten(rest_lengths, lengths):
    """Turn `lengths` into shortenings from `rest_lengths` [m], all of shape (cable_count,)."""
    for c in range(len(lengths)):
        lengths[c] = rest_lengths[c] - lengths[c]


class Cables(SegmentTerm):
    """Constraint term of all cables of a scene, and the stiffness of the taut ones.

    Attributes:
        cable_of_stretch: Cable that each segment is part of, shape (segment_count,).
        ends_on_cylinder: Whether each segment ends on a cylinder, where the next one begins, same
            shape.
    """

    name = "cables"
    is_traceable = True

    def __init__(
        self, paths: tuple[CablePath, ...], free_index: np.ndarray, rest_positions: np.ndarray,
        points: CarriedPoints | None = None, may_spread: bool = False,
    ):  # fmt: skip
        """Divide the paths into segments.

        Args:
            paths: The cables.
            free_index: Unknown or carried point of each node, -1 where fixed,
                shape (node_count,).
            rest_positions: Node positions at rest [m], shape (node_count, 3).
            points: The carried points of the scene; None without any.
            may_spread: Whether a part of the stiffness may be given as dense rows, where segments
                couple many nodes.
        """
        self.paths = paths
        self.row_count = len(paths)
        width = 2 * max((path.points.nodes.shape[1] for path in paths), default=0)
        segments = [
            (cable, segment)
            for cable, path in enumerate(paths)
            for segment in _segments(path, width)
        ]
        self.cable_of_stretch = np.array([cable for cable, _ in segments], dtype=np.int64)
        self.ends_on_cylinder = np.array([s[3] for _, s in segments], bool)
        count = len(segments)
        nodes = np.array([s[0] for _, s in segments], np.int64).reshape(count, -1)
        coefficients = np.array([s[1] for _, s in segments], float).reshape(count, -1)
        self._constants = np.array([s[2] for _, s in segments], float).reshape(-1, 3)
        self._take_segments(self.cable_of_stretch, nodes, coefficients, free_index, points)
        if may_spread and points is None and (self._free >= 0).sum(axis=1).max(initial=0) > MOST_COUPLED:
            self._spread = SpreadStiffness(self._free, self._coefficients)
        if self._points is not None:
            self._carriers = points_among(self._free, points.free_count)
        vectors = np.einsum("sa,sai->si", self._coefficients, rest_positions[self._nodes])
        lengths = np.linalg.norm(vectors + self._constants, axis=1)
        self._least = NO_LENGTH * self._scale(lengths, rest_positions)
        self._rounding = np.where(lengths > self._least, ROUNDED * lengths, 0.0)
        self.rest_lengths = self.lengths(rest_positions)

    def _scale(self, lengths: np.ndarray, rest_positions: np.ndarray) -> float:
        """Longest segment at rest [m]; if all are of zero length, the size of their elements."""
        longest = float(lengths.max(initial=0.0))
        nearby = rest_positions[self._nodes[self._nodes >= 0]]
        elements = size_of_points(nearby) if len(nearby) else 0.0
        return longest if longest > NO_LENGTH * elements else elements

    @property
    def scales(self) -> np.ndarray:
        """Lengths at rest [m], shape (row_count,)."""
        return self.rest_lengths

    @property
    def dense_rows(self) -> DenseRows | None:
        """The part of the stiffness that is not assembled, at the state where it was added last; see
        `ConstraintTerm`.
        """
        return None if self._spread is None else self._spread.dense_rows

    def clear_dense_rows(self) -> None:
        """See `ConstraintTerm.clear_dense_rows`."""
        if self._spread is not None:
            self._spread.clear_dense_rows()

    def lengths(self, positions: np.ndarray) -> np.ndarray:
        """Lengths of the paths [m], shape (row_count,).

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        lengths = np.zeros(self.row_count)
        blocks = np.empty((len(self.entry_rows), 3))
        self._write_rows(positions, blocks, lengths)
        return lengths

    def evaluate(self, positions: np.ndarray, blocks: np.ndarray, values: np.ndarray) -> None:
        """Write H and the shortenings δ [m]; see `ConstraintTerm.evaluate`."""
        self._write_rows(positions, blocks, values)
        shorten(self.rest_lengths, values)

    def _write_rows(self, positions: np.ndarray, blocks: np.ndarray, lengths: np.ndarray) -> None:
        """Write H and the lengths [m]."""
        evaluate_kernel(
            positions, self._nodes, self._coefficients, self._constants, self._least,
            self._rounding, self.cable_of_stretch, self._entry, blocks, lengths,
        )  # fmt: skip

    def largest_share(self, positions: np.ndarray, move: np.ndarray) -> float:
        """Largest share of a move before a segment reverses its direction; see `ConstraintTerm`."""
        if self._points is not None:
            move = self._points.point_moves(positions, move, self._carriers)
        return share_kernel(
            positions, self._nodes, self._coefficients, self._constants, self._least,
            self._rounding, self._free, move,
        )  # fmt: skip

    def add_stiffness(
        self, positions: np.ndarray, multipliers: np.ndarray, storage: np.ndarray,
        projected: bool = False,
    ) -> None:
        """Add the geometric stiffness of taut cables; see `ConstraintTerm.add_stiffness`.

        Projected, it omits the second-order rotation of points on free rigid bodies.
        """
        tensions = multipliers
        if self._bound is not None:
            add_stiffness_kernel(
                positions, self._nodes, self._coefficients, self._constants, self._least,
                self._rounding, self.cable_of_stretch, tensions, self._bound.offsets,
                self._bound.strides, storage,
            )  # fmt: skip
            return
        write_matrices(
            positions, self._nodes, self._coefficients, self._constants, self._least,
            self._rounding, self.cable_of_stretch, tensions, self._matrices,
        )  # fmt: skip
        if self._spread is not None:
            self._spread.add(self._matrices, storage)
            return
        self._fold_matrices(positions, self.entry_rows, tensions, projected, storage)

    def add_row_stiffness(
        self, positions: np.ndarray, stiffness: np.ndarray, storage: np.ndarray
    ) -> DenseRows:
        """Add ρ n Σ h_s h_sᵀ of the rows h_s of the n segments of each cable.

        See `ConstraintTerm.add_row_stiffness`; ρ (Σ h_s)(Σ h_s)ᵀ - ρ n Σ h_s h_sᵀ is given as dense
        rows, of as many cables in all states.
        """
        of = self.cable_of_stretch
        counts = np.bincount(of, minlength=self.row_count)
        squares = (stiffness * counts)[of]
        matrices = np.empty((len(of), 3, 3))
        write_squares(
            positions, self._nodes, self._coefficients, self._constants, self._least,
            self._rounding, squares, matrices,
        )  # fmt: skip
        if self._spread is None:
            add_weighted_matrices(
                matrices, self._coefficients, self._bound.offsets, self._bound.strides, storage
            )
        else:
            self._spread.add(matrices, storage, is_more=True)
        blocks, values = np.empty((len(self.entry_rows), 3)), np.empty(self.row_count)
        self._write_rows(positions, blocks, values)
        rows = np.concatenate([self.entry_rows, self.row_count + self.stretch_of_entry])
        # The square of a cable of one segment is whole.
        kept = np.concatenate([counts, counts[of]]) > 1
        entries, root = kept[rows], np.sqrt(np.concatenate([stiffness, squares]))
        sign = np.repeat([1.0, -1.0], [self.row_count, len(of)])
        blocks = np.concatenate([blocks, blocks]) * root[rows, None]
        return DenseRows(
            (np.cumsum(kept) - 1)[rows[entries]], np.tile(self.entry_nodes, 2)[entries], blocks[entries],
            sign[kept],
        )  # fmt: skip


def _segments(path: CablePath, width: int):
    """Nodes, coefficients and constant of each segment of one path, padded to a width.

    Also whether it ends on a cylinder; a segment that is laid around one is two segments.
    """
    ends: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
    nothing = (np.empty(0, np.int64), np.empty(0))
    if path.pull_point is not None:
        ends.append((*nothing, np.asarray(path.pull_point, float)))
    for nodes, weights in zip(path.points.nodes, path.points.barycentric_weights, strict=True):
        ends.append((nodes, weights, np.zeros(3)))
    ways = []
    for index, (first, second) in enumerate(zip(ends[:-1], ends[1:], strict=True)):
        # The constants of a place on a cylinder are written at each state.
        place = (*nothing, np.zeros(3))
        is_wrapped = index in path.wraps
        ways += [(first, place, True), (place, second, False)] if is_wrapped else [(first, second, False)]
    for (nodes_a, weights_a, fixed_a), (nodes_b, weights_b, fixed_b), ends_on_cylinder in ways:
        nodes, place = np.unique(np.concatenate([nodes_a, nodes_b]), return_inverse=True)
        merged = np.bincount(place.ravel(), np.concatenate([-weights_a, weights_b]), len(nodes))
        padded_nodes = np.full(width, -1, np.int64)
        padded_nodes[: len(nodes)] = nodes
        padded = np.zeros(width)
        padded[: len(nodes)] = merged
        yield padded_nodes, padded, fixed_b - fixed_a, ends_on_cylinder
