"""Base of all shapes: a frame in which the shape is canonical, and common constructions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from softrobot_twin.errors import SceneError
from softrobot_twin.geometry.mass_properties import MassProperties
from softrobot_twin.geometry.shapes.distance_kernels import shape_distance


class Shape:
    """A convex solid in the frame of its carrier, an obstacle or a rigid body.

    Attributes:
        kind: Number of the canonical form, see ``shapes.distance_kernels``.
    """

    kind: ClassVar[int]

    def frame(self) -> tuple[np.ndarray, np.ndarray]:
        """Frame of the canonical form in that of the carrier: origin [m] (3,), axes as columns."""
        raise NotImplementedError

    def extents(self) -> np.ndarray:
        """Sizes of the canonical form [m], shape (3,); unused ones are zero."""
        raise NotImplementedError

    def signed_distances(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Computes the signed distances of points from the shape.

        Args:
            points: Points in the frame of the carrier [m], shape (count, 3).

        Returns:
            Distances [m], negative inside, shape (count,), and their unit gradients, which
            point along the shortest path out of the shape, shape (count, 3). If several are
            equally short, one of them is returned.
        """
        origin, axes = self.frame()
        extents, own = self.extents(), (np.asarray(points, float) - origin) @ axes
        found = [shape_distance(self.kind, extents, tuple(place)) for place in own.tolist()]
        normals = np.array([normal for _, normal in found]).reshape(-1, 3)
        return np.array([distance for distance, _ in found]), normals @ axes.T

    def distances(self, points: np.ndarray) -> np.ndarray:
        """Computes the distances of points from the solid, zero inside [m]; points (count, 3).

        Args:
            points: Places in the frame of the shape [m], shape (count, 3).
        """
        return np.maximum(self.signed_distances(points)[0], 0.0)

    def surface(self, resolution: float) -> tuple[np.ndarray, np.ndarray]:
        """Triangulates the surface; all points lie on it.

        Args:
            resolution: Intended length of the edges [m], > 0; infinite for the coarsest
                triangulation.

        Returns:
            Points in the frame of the carrier [m], shape (point_count, 3), and triangles of a
            closed surface, counter-clockwise from outside, int64, shape (triangle_count, 3).

        Raises:
            SceneError: The resolution is not > 0.
        """
        origin, axes = self.frame()
        points, triangles = self._own_surface(positive("resolution", resolution, infinite=True))
        return points @ axes.T + origin, triangles

    def mass_properties(self) -> MassProperties:
        """Mass properties at unit density, in the frame of the carrier."""
        origin, axes = self.frame()
        volume, centroid, inertia = self._own_mass_properties()
        return MassProperties(volume, origin + axes @ centroid, axes @ inertia @ axes.T)

    @property
    def volume(self) -> float:
        """Volume [m³]."""
        return self.mass_properties().volume

    def _own_surface(self, resolution: float) -> tuple[np.ndarray, np.ndarray]:
        raise NotImplementedError

    def _own_mass_properties(self) -> MassProperties:
        raise NotImplementedError


@dataclass(frozen=True, eq=False)
class AxialShape(Shape):
    """A round shape along a segment.

    Attributes:
        noun: What it is called in messages.
        ends: Ends of the segment [m], shape (2, 3).
        radius: Radius [m], > 0.
    """

    noun: ClassVar[str]
    ends: np.ndarray
    radius: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "ends", vectors(f"{self.noun}.ends", self.ends, (2, 3)))
        object.__setattr__(self, "radius", positive(f"{self.noun}.radius", self.radius))

    @property
    def length(self) -> float:
        """Length of the segment [m]."""
        return float(np.linalg.norm(self.ends[1] - self.ends[0]))

    def frame(self) -> tuple[np.ndarray, np.ndarray]:
        """See `Shape.frame`; the z axis runs from the first end to the second."""
        axes = axes_along(self.ends[1] - self.ends[0]) if self.length > 0.0 else np.eye(3)
        return self.ends.mean(axis=0), axes

    def extents(self) -> np.ndarray:
        """Radius and half length; see `Shape.extents`."""
        return np.array([self.radius, 0.5 * self.length, 0.0])


def positive(key: str, value: float, infinite: bool = False) -> float:
    """Checks that a length is > 0, and finite unless allowed; raises a `SceneError` if not.

    Args:
        key: Name of the length in the scene, for the error.
        value: The length [m].
        infinite: Whether it may be infinite.
    """
    number = float(value)
    if not number > 0.0 or (np.isinf(number) and not infinite):
        raise SceneError(None, key, value, "m", "must be a finite length > 0")
    return number


def vectors(key: str, value: np.ndarray, shape: tuple[int, ...], unit: str = "m") -> np.ndarray:
    """Makes a read-only array of finite numbers of a shape; raises a `SceneError` if it cannot.

    Args:
        key: Name of the array in the scene, for the error.
        value: The numbers.
        shape: The shape that they must have.
        unit: Their unit, for the error.
    """
    array = np.array(value, dtype=float)
    if array.shape != shape or not np.isfinite(array).all():
        raise SceneError(None, key, value, unit, f"must be finite numbers of shape {shape}")
    array.setflags(write=False)
    return array


def axes_along(direction: np.ndarray) -> np.ndarray:
    """Right-handed orthonormal axes as columns, the third along a direction, shape (3, 3).

    Args:
        direction: The direction, not zero, of any length, shape (3,).
    """
    third = direction / np.linalg.norm(direction)
    across = np.eye(3)[np.abs(third).argmin()]
    first = across - third * (across @ third)
    first /= np.linalg.norm(first)
    return np.column_stack([first, np.cross(third, first), third])


# Smallest number of sides of a ring.
FEWEST_SIDES = 8


def side_count(radius: float, resolution: float) -> int:
    """Even number of sides of a ring for a resolution [m].

    Args:
        radius: Radius of the ring [m].
        resolution: Wanted length of a side [m].
    """
    return max(FEWEST_SIDES, 2 * int(np.ceil(np.pi * radius / resolution)))


def revolve(radii: np.ndarray, heights: np.ndarray, sides: int) -> tuple[np.ndarray, np.ndarray]:
    """Makes a closed surface of revolution about the z axis.

    Args:
        radii: Radii of the rings from the bottom up [m], shape (ring_count,); the first and the
            last are the poles, with radius zero.
        heights: Their heights [m], shape (ring_count,).
        sides: Number of points of a ring.

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
