"""Cables that are laid around round obstacles, without friction and with it.

Between two of its points a cable runs straight to an infinite cylinder of radius r, around it on a helix,
and straight on: the shortest way, always on the side on which it lies at rest. Across the axis the
straight parts have the lengths l_a = √(r_a² - r²) and l_b, and the arc r φ with

    φ = θ - acos(r/r_a) - acos(r/r_b),

θ the angle from one point to the other about the axis. Where φ ≤ 0 the cable runs clear of the cylinder.
Along the axis it advances in proportion to its length. As it is the shortest way, its length changes with
its points as if the places where it leaves the cylinder stayed: so each of both straight parts is a
segment that ends at a place in the world, which every state has of its own, and the arc adds its length.
The stiffness is that of these segments. Across the axis that is exact while the cable touches.

With friction the arc is one point more of the path (`cable_friction`), at which the cable turns by the angle
of its helix, r φ² / arc: where it slips, the tension falls by the capstan equation over the whole arc.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softrobot_twin.constraints.cable import CablePath, Cables, Wrap
from softrobot_twin.constraints.cable_friction import FrictionCables

# An angle beyond is one that is past the other side of the cylinder, which the cable left.
FARTHEST = 1.75 * np.pi
# Where a cable runs clear of a cylinder, it is divided between these shares of its length.
LEAST_SHARE, MOST_SHARE = 0.1, 0.9
# Angle between two places of an arc that is drawn [rad].
DRAWN = 0.02


class Course(NamedTuple):
    """How a cable runs from one point to another past a cylinder.

    Attributes:
        leaves: Where it leaves the first straight part [m], shape (3,).
        joins: Where it joins the second one [m], shape (3,).
        arc: Length between both along the cylinder [m].
        angle: φ [rad]; 0 where it runs clear.
    """

    leaves: np.ndarray
    joins: np.ndarray
    arc: float
    angle: float


def side_at(first: np.ndarray, second: np.ndarray, wrap: Wrap) -> float:
    """Sense in which the way between two points turns about an axis: 1, -1, or 0 for none.

    Args:
        first: One point [m], shape (3,).
        second: The other one [m], shape (3,).
        wrap: The cylinder.
    """
    turn = float(wrap.axis @ np.cross(first - wrap.centre, second - wrap.centre))
    lever = np.linalg.norm(np.cross(wrap.axis, first - wrap.centre)) * np.linalg.norm(second - first)
    return 0.0 if abs(turn) <= 1.0e-9 * lever else float(np.sign(turn))


def course(first: np.ndarray, second: np.ndarray, wrap: Wrap) -> Course:
    """The shortest way between two points past a cylinder.

    Args:
        first: One point [m], shape (3,).
        second: The other one [m], shape (3,).
        wrap: The cylinder, with the side of the way.
    """
    n, r = wrap.axis, wrap.radius
    a, b = first - wrap.centre, second - wrap.centre
    rise = n @ (b - a)
    p, q = a - (n @ a) * n, b - (n @ b) * n
    far = np.array([np.linalg.norm(p), np.linalg.norm(q)])
    angle = 0.0
    if far.min() > r:
        turned = np.arctan2(wrap.side * (n @ np.cross(p, q)), p @ q) % (2.0 * np.pi)
        turned -= 2.0 * np.pi * (turned > FARTHEST)
        ends = np.arccos(r / far)
        angle = turned - ends.sum()
    if angle <= 0.0:
        way = q - p
        share = np.clip(-(p @ way) / max(way @ way, np.finfo(float).tiny), LEAST_SHARE, MOST_SHARE)
        place = first + share * (second - first)
        return Course(place, place, 0.0, 0.0)
    straight = np.sqrt(far**2 - r**2)
    across = straight.sum() + r * angle
    leaves = wrap.centre + _turned(p, n, wrap.side * ends[0]) * (r / far[0])
    joins = wrap.centre + _turned(q, n, -wrap.side * ends[1]) * (r / far[1])
    leaves = leaves + (n @ a + rise * straight[0] / across) * n
    joins = joins + (n @ b - rise * straight[1] / across) * n
    return Course(leaves, joins, r * angle * np.hypot(1.0, rise / across), angle)


def _turned(vector: np.ndarray, axis: np.ndarray, angle: float) -> np.ndarray:
    """A vector across an axis, turned about it."""
    return np.cos(angle) * vector + np.sin(angle) * np.cross(axis, vector)


def drawn_path(path: CablePath, points: np.ndarray) -> np.ndarray:
    """A path with the places of its arcs [m], shape (count, 3).

    Args:
        path: The path.
        points: Its points, pull point first [m], shape (point_count, 3).
    """
    parts = []
    for index, point in enumerate(points):
        parts.append(point[None])
        wrap = path.wraps.get(index)
        if wrap is not None:
            way = course(point, points[index + 1], wrap)
            count = 1 + int(np.ceil(way.angle / DRAWN))
            arms = way.leaves - wrap.centre
            along = (wrap.axis @ arms) * wrap.axis
            rise = wrap.axis @ (way.joins - way.leaves) * wrap.axis
            parts.append(np.array([
                wrap.centre + along + share * rise
                + _turned(arms - along, wrap.axis, wrap.side * share * way.angle)
                for share in np.linspace(0.0, 1.0, count)
            ]))  # fmt: skip
    return np.concatenate(parts)


class WrappedCables(Cables):
    """Constraint term of cables of which some are laid around cylinders."""

    def __init__(self, paths: tuple[CablePath, ...], *places, **options):
        """See `Cables`; `CablePath.wraps` says which segments are laid around what."""
        self._wraps = [wrap for path in paths for _, wrap in sorted(path.wraps.items())]
        self._arcs, self._of_wraps = np.zeros(len(paths)), np.zeros((2, len(self._wraps)))
        self._first: np.ndarray | None = None
        super().__init__(paths, *places, **options)

    def _write_rows(self, positions, blocks, lengths) -> None:
        self._place(positions)
        super()._write_rows(positions, blocks, lengths)
        lengths += self._arcs

    def _place(self, positions: np.ndarray) -> None:
        """Put the ends of the segments at cylinders where they are at a state."""
        if self._first is None:
            # Of each two segments of a wrap the first ends on the cylinder; see `Cables`.
            self._first = np.flatnonzero(self.ends_on_cylinder)
            self._bases = self._constants.copy()
            self._rounding[self._first] = self._rounding[self._first + 1] = 0.0
        self._arcs[:] = 0.0
        for index, (s, wrap) in enumerate(zip(self._first, self._wraps, strict=True)):
            moving = np.einsum("sa,sai->si", self._coefficients[s : s + 2], positions[self._nodes[s : s + 2]])
            ends = moving + self._bases[s : s + 2]
            way = course(-ends[0], ends[1], wrap)
            self._constants[s] = self._bases[s] + way.leaves
            self._constants[s + 1] = self._bases[s + 1] - way.joins
            self._arcs[self.cable_of_stretch[s]] += way.arc
            self._of_wraps[:, index] = way.arc, wrap.radius * way.angle**2 / way.arc if way.arc else 0.0

    def largest_share(self, positions: np.ndarray, move: np.ndarray) -> float:
        """See `Cables`."""
        self._place(positions)
        return super().largest_share(positions, move)

    def add_stiffness(self, positions, multipliers, storage, projected: bool = False) -> None:
        """See `Cables`."""
        self._place(positions)
        super().add_stiffness(positions, multipliers, storage, projected)

    def add_row_stiffness(self, positions, stiffness, storage):
        """See `Cables`."""
        self._place(positions)
        return super().add_row_stiffness(positions, stiffness, storage)


class RubbingWraps(WrappedCables, FrictionCables):
    """Constraint term of cables of which some are laid around cylinders, and some rub."""

    def _measure(self, positions: np.ndarray) -> None:
        self._place(positions)
        super()._measure(positions)
        # The point is where the arc begins: what passes it has left the segment before.
        arcs, self.angles[self._first + 1] = self._of_wraps
        self._lengths[self._first + 1] += arcs
