"""Base of all shapes: a frame in which the shape is canonical, and common constructions."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from softrobot_twin.errors import SceneError
from softrobot_twin.geometry.mass_properties import MassProperties

class Shape:
    """A convex solid in the frame of its carrier, an obstacle or a rigid body.

    Attributes:
        kind: Canonical form, one of those of ``shapes.distance_kernels``.
    """

    kind: ClassVar[int]

    def frame(self) -> tuple[np.ndarray, np.ndarray]:
        """The shape's own frame in the carrier's: origin [m], (3,), and axes as columns, (3, 3)."""
        raise NotImplementedError

    def extents(self) -> np.ndarray:
        """Sizes of the canonical form [m], shape (3,), zero where there is none."""
        raise NotImplementedError

    def signed_distances(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Measures how far points are from the shape.

        Args:
            points: Points in the carrier's frame [m], shape (count, 3).

        Returns:
            Distances [m], negative inside, shape (count,), and their unit gradients, which
            point the shortest way out, shape (count, 3). Where several ways are equally short
            it is one of them.
        """
        origin, axes = self.frame()
        distances, normals = self._own_distances((np.asarray(points, float) - origin) @ axes)
        return distances, normals @ axes.T

    def surface(self, resolution: float) -> tuple[np.ndarray, np.ndarray]:
        """Triangulates the surface, all points on it.

        Args:
            resolution: Length aimed at for the edges along curves and sides [m], > 0; infinite
                for the coarsest triangulation there is.

        Returns:
            Points in the carrier's frame [m], shape (point_count, 3), and the triangles between
            them, counter-clockwise from outside, closed, int64, shape (triangle_count, 3).

        Raises:
            SceneError: The resolution is not > 0.
        """
        origin, axes = self.frame()
        points, triangles = self._own_surface(positive("resolution", resolution, infinite=True))
        return points @ axes.T + origin, triangles

    def mass_properties(self) -> MassProperties:
        """Volume, centroid and inertia about it at unit density, along the carrier's axes."""
        origin, axes = self.frame()
        volume, centroid, inertia = self._own_mass_properties()
        return MassProperties(volume, origin + axes @ centroid, axes @ inertia @ axes.T)

    @property
    def volume(self) -> float:
        """Volume [m³]."""
        return self.mass_properties().volume

    def _own_distances(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        raise NotImplementedError

    def _own_surface(self, resolution: float) -> tuple[np.ndarray, np.ndarray]:
        raise NotImplementedError

    def _own_mass_properties(self) -> MassProperties:
        raise NotImplementedError


def positive(key: str, value: float, infinite: bool = False) -> float:
    """A length that is > 0, or a `SceneError`."""
    number = float(value)
    if not number > 0.0 or (np.isinf(number) and not infinite):
        raise SceneError(None, key, value, "m", "must be a finite length > 0")
    return number


def vectors(key: str, value: np.ndarray, shape: tuple[int, ...], unit: str = "m") -> np.ndarray:
    """A read-only array of finite numbers of the shape asked for, or a `SceneError`."""
    array = np.array(value, dtype=float)
    if array.shape != shape or not np.isfinite(array).all():
        raise SceneError(None, key, value, unit, f"must be finite numbers of shape {shape}")
    array.setflags(write=False)
    return array


def axes_along(direction: np.ndarray) -> np.ndarray:
    """Right-handed orthonormal axes as columns, the third along a direction, shape (3, 3)."""
    third = direction / np.linalg.norm(direction)
    across = np.eye(3)[np.abs(third).argmin()]
    first = across - third * (across @ third)
    first /= np.linalg.norm(first)
    return np.column_stack([first, np.cross(third, first), third])


# A round thing keeps its form with this many sides at least.
FEWEST_SIDES = 8


def side_count(radius: float, resolution: float) -> int:
    """Sides of a ring: enough for the resolution, an even number."""
    return max(FEWEST_SIDES, 2 * int(np.ceil(np.pi * radius / resolution)))


def revolve(radii: np.ndarray, heights: np.ndarray, sides: int) -> tuple[np.ndarray, np.ndarray]:
    """Turns a profile about the z axis.

    Args:
        radii: Radii of the rings from the bottom up [m], shape (ring_count,); the first and the
            last are zero, the poles.
        heights: Their heights [m], shape (ring_count,).
        sides: Points of a ring.

    Returns:
        Points [m], shape (point_count, 3), and triangles, counter-clockwise from outside, int64.
    """
    angles = 2.0 * np.pi * np.arange(sides) / sides
    circle = np.column_stack([np.cos(angles), np.sin(angles)])
    rings = [
        np.column_stack([radius * circle, np.full(sides, height)])
        for radius, height in zip(radii[1:-1], heights[1:-1], strict=True)
    ]
    poles = np.array([[0.0, 0.0, heights[0]], [0.0, 0.0, heights[-1]]])
    here = np.arange(sides)
    following = (here + 1) % sides
    top = 2 + (len(rings) - 1) * sides
    triangles = [
        np.column_stack([np.zeros(sides, np.int64), 2 + following, 2 + here]),
        np.column_stack([np.ones(sides, np.int64), top + here, top + following]),
    ]
    for ring in range(len(rings) - 1):
        low = 2 + ring * sides
        a, b, c, d = low + here, low + following, low + sides + here, low + sides + following
        triangles += [np.column_stack([a, b, d]), np.column_stack([a, d, c])]
    return np.vstack([poles, *rings]), np.vstack(triangles).astype(np.int64)
