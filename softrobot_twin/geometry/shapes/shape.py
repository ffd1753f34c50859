"""Base of all rigid shapes, and constructions that they share."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from softrobot_twin.geometry.mass_properties import MassProperties
from softrobot_twin.geometry.shapes.distance_kernels import measure_points


class Shape:
    """A convex solid in the frame of its carrier, an obstacle or a rigid body.

    Attributes:
        kind: Number of a form of this package, see `distance_kernels.py`.
        is_half_space: Whether its distance is linear, so that only vertices come nearest to it.
        has_edges: Whether it is a box, around whose edges a surface may fold.
        is_round: Whether the distance has the same curvature about its axis, or its centre.
        axis: Direction of the straight side of a round shape, shape (3,); zero where it has none.
        has_round_ends: Whether what is not this side is round too.
        curvature_radius: Radius of curvature [m]; infinite where it is flat.
        width: Smallest width of what is straight on it [m]; 0 where nothing is, as on a sphere.
    """

    kind: ClassVar[int]
    is_half_space: ClassVar[bool] = False
    has_edges: ClassVar[bool] = False
    is_round: ClassVar[bool] = False
    has_round_ends: ClassVar[bool] = True

    @property
    def axis(self) -> np.ndarray:
        """See the attributes."""
        return np.zeros(3)

    @property
    def curvature_radius(self) -> float:
        """See the attributes."""
        return np.inf

    @property
    def width(self) -> float:
        """See the attributes."""
        return 0.0

    def frame(self) -> tuple[np.ndarray, np.ndarray]:
        """Frame of its form in that of the carrier: origin [m] (3,), axes as columns (3, 3)."""
        raise NotImplementedError

    def extents(self) -> np.ndarray:
        """Sizes of its form [m], shape (3,); unused ones are zero."""
        raise NotImplementedError

    def form(self) -> Any:
        """Its form, as the kernels take it."""
        return self.kind, np.array(self.extents(), float)

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
        own = np.ascontiguousarray((np.asarray(points, float) - origin) @ axes)
        distances, gradients = np.empty(len(own)), np.empty((len(own), 3))
        measure_points(self.form(), own, distances, gradients)
        return distances, gradients @ axes.T

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
        """
        origin, axes = self.frame()
        points, triangles = self._own_surface(resolution)
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


class RollingShape(Shape):
    """A shape that touches a plane with the points of its round that come lowest."""

    def lowest(self, normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The points that may touch a plane [m], shape (count, 3), and their keys, shape (count,).

        Args:
            normal: Normal of the plane in the frame of the form, shape (3,).
        """
        return np.array([self.form().farthest(tuple(-normal))]), np.zeros(1, np.int64)


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
