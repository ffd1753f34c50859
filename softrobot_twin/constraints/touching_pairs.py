"""Pairs of things that may touch, each asked in its own way where it is near."""

from __future__ import annotations

import numpy as np

from softrobot_twin.geometry.proximities import Proximities


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
        self._faces, self._general, self._has_looked = faces, general, False

    def near(self, positions: np.ndarray, margin: float) -> Proximities:
        """What is nearer than a margin [m]."""
        found = self._faces.detect(
            self.first.pose(positions), self.second.pose(positions), margin
        )
        # The first time both look: so nothing is left to be compiled at a touch.
        if found is None or not self._has_looked:
            self._has_looked = True
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
