"""Round beams that touch: the balls along their axes carry contacts, on the frames of both ends.

See `geometry/round_axes.py` for the places, and `contact_pairs.py` for what a pair is. Arguments of the
kernels here that are not told are as in `contact_pairs`.
"""

from __future__ import annotations

import numpy as np

from softrobot_twin.constraints.contact_pairs import NO_NODE, ContactPair, Side
from softrobot_twin.geometry.round_axes import (
    RoundAxis,
    axis_distances,
    axis_point,
    hermite,
    pair_axes,
    pair_axis_with_shape,
)
from softrobot_twin.geometry.shapes.distance_kernels import place_frame
from softrobot_twin.geometry.vector3 import row, subtract
from softrobot_twin.kernels.compilation import KERNEL, njit


@njit(**KERNEL)
def write_axis(x, frames, local_places, local_tangents, places, tangents):
    """Places and tangents of the ends of every element, from the frames that carry them.

    Args:
        x: Node positions [m], shape (node_count, 3).
        frames: Origin node of the frame of both ends of each, shape (element_count, 2).
        local_places: The ends in their frames [m], shape (element_count, 2, 3).
        local_tangents: Tangents there times the element's length, in these frames [m], same shape.
        places: Takes the ends [m], shape (element_count, 2, 3).
        tangents: Takes the tangents times the element's length [m], same shape.
    """
    for e in range(len(frames)):
        for end in range(2):
            o = frames[e, end]
            for i in range(3):
                place, tangent = x[o, i], 0.0
                for k in range(3):
                    axis = x[o + 1 + k, i] - x[o, i]
                    place += local_places[e, end, k] * axis
                    tangent += local_tangents[e, end, k] * axis
                places[e, end, i], tangents[e, end, i] = place, tangent


@njit(**KERNEL)
def carry_by_axis(
    x, axis, frames, local_places, local_tangents, elements, shares, places, sign, column, span,
    nodes, coefficients,
):  # fmt: skip
    """Places on a round beam: the axis by Hermite's cubic, what is off it by the turn of the ends.

    Args:
        x: Node positions [m], shape (node_count, 3).
        axis: The axis at these positions.
        frames: Origin node of the frame of both ends of each, shape (element_count, 2).
        local_places: The ends in their frames [m], shape (element_count, 2, 3).
        local_tangents: Tangents there times the element's length, in these frames [m], same shape.
        elements: Element of each place in the first column, shape (capacity, 3).
        shares: Share along this element in the first column, shape (capacity, 3).
    """
    for c in range(span[0], min(span[1], len(nodes))):
        e, s = elements[c, 0], shares[c, 0]
        h0, h1, g0, g1 = hermite(s)
        off = subtract(row(places, c), axis_point(axis, e, s))
        for end in range(2):
            o = frames[e, end]
            place = h0 if end == 0 else h1
            along = g0 if end == 0 else g1
            turn = 1.0 - s if end == 0 else s
            first = column + 4 * end
            if place == 0.0 and turn == 0.0:
                for k in range(4):
                    nodes[c, first + k], coefficients[c, first + k] = NO_NODE, 0.0
                continue
            rest = place
            for k in range(3):
                local = place * local_places[e, end, k] + along * local_tangents[e, end, k]
                for i in range(3):
                    local += turn * (x[o + 1 + k, i] - x[o, i]) * off[i]
                nodes[c, first + 1 + k] = o + 1 + k
                coefficients[c, first + 1 + k] = sign * local
                rest -= local
            nodes[c, first] = o
            coefficients[c, first] = sign * rest


class RoundBeam:
    """A beam as all that is nearer to its axis than its radius; a side of contact pairs.

    Attributes:
        nodes: Frame nodes that carry it.
        width: Nodes that carry a place on it, at most.
        radius: [m].
        element_count: Number of its elements.
    """

    width = 8

    def __init__(self, frames, local_places, local_tangents, radius: float):
        """Take the elements.

        Args:
            frames: Origin node of the frame of both ends of each, shape (element_count, 2).
            local_places: The ends in their frames [m], shape (element_count, 2, 3).
            local_tangents: Tangents there times the element's length, in these frames [m], same
                shape.
            radius: [m].
        """
        self._frames = np.ascontiguousarray(frames, np.int64)
        self._local_places = np.ascontiguousarray(local_places, float)
        self._local_tangents = np.ascontiguousarray(local_tangents, float)
        self.radius, self.element_count = float(radius), len(frames)
        self.nodes = (np.unique(frames)[:, None] + np.arange(4)).ravel()
        self._axis = RoundAxis(np.empty(local_places.shape), np.empty(local_places.shape), self.radius)

    def axis(self, positions: np.ndarray) -> RoundAxis:
        """Its axis at a state; the next call overwrites it.

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        write_axis(
            positions, self._frames, self._local_places, self._local_tangents,
            self._axis.places, self._axis.tangents,
        )  # fmt: skip
        return self._axis

    def outline(self, positions: np.ndarray) -> np.ndarray:
        """See `CarriedSurface.outline`."""
        return self.axis(positions).places.reshape(-1, 3).copy()

    def carry(self, positions, points, weights, places, *where) -> None:
        """See `CarriedSurface.carry`; points are elements, weights shares along them."""
        carry_by_axis(
            positions, self.axis(positions), self._frames, self._local_places,
            self._local_tangents, points, weights, places, *where,
        )  # fmt: skip


class BeamAndShape(ContactPair):
    """A round beam and a shape on a rigid body or an obstacle."""

    def __init__(self, first: Side, second: Side, friction: float, rest: np.ndarray, held_nodes=()):
        """Take both sides.

        Args:
            first: The side of the beam, whose surface is a `RoundBeam`.
            second: The side of the shape.
            friction: Coefficient µ.
            rest: Node positions at rest [m], shape (node_count, 3).
            held_nodes: Nodes of the beam that do not move against the shape. Where they lie inside
                it at rest, they never touch it, nor do nodes that follow them inside it.
        """
        super().__init__(first, second, friction)
        self._form, self._bend = self.shape.form(), float(self.shape.curvature_radius)
        origin, axes = self.shape.frame()
        self._origin, self._axes = np.array(origin, float), np.array(axes, float)
        self._placed = np.empty((4, 3))
        self._excluded = np.zeros(2 * self.first.element_count + 1, np.bool_)
        if len(held_nodes):
            self._exclude(set((self.near(rest, 0.0).keys // 2).tolist()), held_nodes)

    def _exclude(self, inside: set, held_nodes) -> None:
        """Exclude runs of nodes inside the shape that begin at held ones, and all between them."""
        for node in held_nodes:
            for way in (1, -1):
                k = node
                while k in inside:
                    self._excluded[max(2 * k - 1, 0) : 2 * k + 2] = True
                    k += way

    def write(self, positions, reach, rows, span) -> None:
        """See `ContactPair.write`."""
        place_frame(self._origin, self._axes, *self.second.kept_pose(positions), self._placed)
        axis = self.first.axis(positions)
        pair_axis_with_shape(axis, self._excluded, self._form, self._bend, self._placed, reach, rows, span)


class TwoRoundBeams(ContactPair):
    """Two round beams, or one and itself."""

    def __init__(self, first: Side, second: Side, friction: float, excluded: np.ndarray):
        """Take both sides.

        Args:
            first: A side whose surface is a `RoundBeam`.
            second: Another, or the same.
            friction: Coefficient µ.
            excluded: Pairs of elements that never touch, see `never_touching`.
        """
        super().__init__(first, second, friction)
        self._excluded = np.ascontiguousarray(excluded, np.bool_)

    def write(self, positions, reach, rows, span) -> None:
        """See `ContactPair.write`."""
        first, second = self.first.axis(positions), self.second.axis(positions)
        pair_axes(first, second, self.first is self.second, self._excluded, reach, rows, span)


def never_touching(first: RoundBeam, second: RoundBeam, rest: np.ndarray) -> np.ndarray:
    """Pairs of elements of joined beams that overlap at rest, as those at the joint do.

    Args:
        first: A beam.
        second: Another, or the same.
        rest: Node positions at rest [m], shape (node_count, 3).

    Returns:
        Shape (first_count, second_count) of bool.
    """
    distances = np.empty((first.element_count, second.element_count))
    axis_distances(first.axis(rest), second.axis(rest), distances)
    return distances < first.radius + second.radius


def neighbours(lengths: np.ndarray, radius: float) -> np.ndarray:
    """Pairs of elements of one beam that are neighbours along it.

    Between them lies no element, or no more of the axis than a half circle whose inside the beam
    fills: where they are bent further, the beam's own section overlaps.

    Args:
        lengths: Of the elements [m], shape (element_count,).
        radius: Of the beam [m].

    Returns:
        Shape (element_count, element_count) of bool.
    """
    ends = np.cumsum(lengths)
    starts = ends - lengths
    between = np.maximum(starts[:, None] - ends, starts - ends[:, None])
    index = np.arange(len(lengths))
    return (np.abs(index[:, None] - index) <= 1) | (between <= np.pi * radius)
