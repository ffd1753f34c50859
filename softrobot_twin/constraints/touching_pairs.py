"""Pairs of things that may touch, each asked in its own way where it is near."""

from __future__ import annotations

import numpy as np

from softrobot_twin.geometry.proximities import Proximities
from softrobot_twin.geometry.shapes.distance_kernels import CAPSULE
from softrobot_twin.geometry.surface_shape import PARALLEL_FACE, RIM_POINTS


class SurfaceAndShape:
    """A triangle surface and an analytic shape on a rigid body or an obstacle."""

    def __init__(self, first, second, detector, friction: float, names: tuple[str, str]):
        """Take both.

        Args:
            first: The surface.
            second: What carries the shape.
            detector: A `SurfaceShapeDetector`.
            friction: Coefficient µ.
            names: Names of both.
        """
        self.first, self.second = first, second
        self.friction, self.names = friction, names
        self.shape = detector.shape
        self._detector = detector

    def near(self, positions: np.ndarray, margin: float) -> Proximities:
        """What is nearer than a margin [m]."""
        origin, rotation = self.second.pose(positions)
        return self._detector.detect(self.first.points(positions), origin, rotation, margin)


class TwoBoxes:
    """Two boxes: face by face; where edges or corners meet, as any surface and shape."""

    def __init__(self, faces, general: SurfaceAndShape):
        """Take both.

        Args:
            faces: A `BoxPairDetector`.
            general: The same boxes, the first as a surface.
        """
        self.first, self.second = general.first, general.second
        self.friction, self.names = general.friction, general.names
        self._faces, self._general, self._has_searched = faces, general, False

    def near(self, positions: np.ndarray, margin: float) -> Proximities:
        """What is nearer than a margin [m]."""
        found = self._faces.detect(
            self.first.pose(positions), self.second.pose(positions), margin
        )
        # The general search runs in the first call too: it is compiled before bodies touch.
        if found is None or not self._has_searched:
            self._has_searched = True
            near = self._general.near(positions, margin)
            return near if found is None else found
        return found


class TwoSurfaces:
    """Two triangle surfaces."""

    def __init__(self, first, second, detector, friction: float, names: tuple[str, str]):
        """Take both; see `SurfaceAndShape`, the detector is a `SurfacePairDetector`."""
        self.first, self.second = first, second
        self.friction, self.names = friction, names
        self._detector = detector

    def near(self, positions: np.ndarray, margin: float) -> Proximities:
        """What is nearer than a margin [m]."""
        return self._detector.detect(
            self.first.points(positions), self.second.points(positions), margin
        )


class OneSurface:
    """A surface and itself: by search, or by points and triangles known ahead."""

    def __init__(self, surface, detector, friction: float, names: tuple[str, str]):
        """Take the surface; see `SurfaceAndShape`, the detector needs only its points."""
        self.first = self.second = surface
        self.friction, self.names = friction, names
        self._detector = detector

    def near(self, positions: np.ndarray, margin: float) -> Proximities:
        """What is nearer than a margin [m]."""
        return self._detector.detect(self.first.points(positions), margin)


class BallAndShape:
    """A rigid ball and a shape: its one nearest point, exact wherever it rolls."""

    def __init__(self, ball, radius: float, centre, second, shape, friction: float, names):
        """Take both.

        Args:
            ball: What carries the ball.
            radius: Its radius [m].
            centre: Its centre in its carrier's frame [m], shape (3,).
            second: What carries the shape.
            shape: The shape.
            friction: Coefficient µ.
            names: Names of both.
        """
        self.first, self.second = ball, second
        self.friction, self.names = friction, names
        self._radius, self._centre, self._shape = radius, np.asarray(centre, float), shape

    def near(self, positions: np.ndarray, margin: float) -> Proximities:
        """What is nearer than a margin [m]."""
        at, turned = self.first.pose(positions)
        origin, rotation = self.second.pose(positions)
        centre = at + turned @ self._centre
        distances, normals = self._shape.signed_distances([(centre - origin) @ rotation])
        gap, normal = distances[0] - self._radius, normals @ rotation.T
        count = 1 if gap < margin else 0
        none, whole = np.full((count, 3), -1), np.zeros((count, 3))
        return Proximities(
            none, whole, none, whole, (centre - self._radius * normal)[:count],
            (centre - distances[0] * normal)[:count], normal[:count],
            np.full(count, gap), np.zeros(count, np.int64),
        )  # fmt: skip


class RoundAndPlane:
    """A rigid capsule or cylinder and a plane: the points of its round that come lowest.

    A capsule touches with the balls at its ends, a cylinder with the lowest points of its rims;
    where a cap is parallel to the plane, with points all round it. So it rolls as it is round.
    """

    def __init__(self, solid, shape, second, plane, friction: float, names: tuple[str, str]):
        """Take both.

        Args:
            solid: What carries the capsule or cylinder.
            shape: The capsule or cylinder, in its carrier's frame.
            second: What carries the plane.
            plane: The plane, in its carrier's frame.
            friction: Coefficient µ.
            names: Names of both.
        """
        self.first, self.second = solid, second
        self.friction, self.names = friction, names
        self._plane, self._radius = plane, shape.radius
        self._is_capsule = shape.kind == CAPSULE
        self._centre, self._axes = shape.frame()
        self._half_length = shape.extents()[1]

    def near(self, positions: np.ndarray, margin: float) -> Proximities:
        """What is nearer than a margin [m]."""
        at, turned = self.first.pose(positions)
        origin, rotation = self.second.pose(positions)
        normal = rotation @ self._plane.normal
        centre, axes = at + turned @ self._centre, turned @ self._axes
        points, keys = self._lowest(normal @ axes)
        points = centre + points @ axes.T
        if self._is_capsule:
            points -= self._radius * normal
        gaps = (points - origin - rotation @ self._plane.point) @ normal
        touching = gaps < margin
        points, gaps, keys = points[touching], gaps[touching], keys[touching]
        count = len(gaps)
        none, whole = np.full((count, 3), -1), np.zeros((count, 3))
        return Proximities(
            none, whole, none, whole, points, points - gaps[:, None] * normal,
            np.tile(normal, (count, 1)), gaps, keys,
        )  # fmt: skip

    def _lowest(self, normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Points that may touch, and their keys; of a capsule the ends of its axis.

        Args:
            normal: The plane's normal in the shape's own frame, whose third axis is its axis.
        """
        ends = np.array([[0.0, 0.0, -self._half_length], [0.0, 0.0, self._half_length]])
        if self._is_capsule:
            return ends, np.arange(2)
        across = np.hypot(normal[0], normal[1])
        caps = np.flatnonzero(np.array([-normal[2], normal[2]]) <= PARALLEL_FACE)
        if across > PARALLEL_FACE:
            lowest = np.array([*(-self._radius / across * normal[:2]), 0.0])
            return ends[caps] + lowest, 16 * caps
        angles = 2.0 * np.pi * np.arange(RIM_POINTS) / RIM_POINTS
        rim = self._radius * np.column_stack([np.cos(angles), np.sin(angles), 0.0 * angles])
        return ends[caps[0]] + rim, 16 * caps[0] + 1 + np.arange(RIM_POINTS)
