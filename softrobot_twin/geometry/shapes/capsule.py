"""A capsule: all points within a distance from a line segment."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from softrobot_twin.geometry.mass_properties import MassProperties
from softrobot_twin.geometry.shapes.distance_kernels import CAPSULE
from softrobot_twin.geometry.shapes.shape import (
    Shape,
    axes_along,
    positive,
    revolve,
    side_count,
    vectors,
)


@dataclass(frozen=True, eq=False)
class Capsule(Shape):
    """A cylinder with a half-sphere at both ends.

    Attributes:
        ends: Ends of the segment, the centres of the half-spheres [m], shape (2, 3); a sphere if
            both are equal.
        radius: Radius [m], > 0.

    Raises:
        SceneError: A number is not finite, or the radius is not > 0.
    """

    kind = CAPSULE
    ends: np.ndarray
    radius: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "ends", vectors("capsule.ends", self.ends, (2, 3)))
        object.__setattr__(self, "radius", positive("capsule.radius", self.radius))

    @property
    def length(self) -> float:
        """Length of the segment [m]."""
        return float(np.linalg.norm(self.ends[1] - self.ends[0]))

    def frame(self) -> tuple[np.ndarray, np.ndarray]:
        """See `Shape.frame`; the z axis runs from the first end to the second."""
        along = self.ends[1] - self.ends[0]
        axes = axes_along(along) if self.length > 0.0 else np.eye(3)
        return self.ends.mean(axis=0), axes

    def extents(self) -> np.ndarray:
        """Radius and half length; see `Shape.extents`."""
        return np.array([self.radius, 0.5 * self.length, 0.0])

    def _own_distances(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        half = 0.5 * self.length
        away = points.copy()
        away[:, 2] -= np.clip(points[:, 2], -half, half)
        lengths = np.linalg.norm(away, axis=1)
        normals = np.tile([1.0, 0.0, 0.0], (len(points), 1))
        off_axis = lengths > 0.0
        normals[off_axis] = away[off_axis] / lengths[off_axis, None]
        return lengths - self.radius, normals

    def _own_surface(self, resolution: float) -> tuple[np.ndarray, np.ndarray]:
        sides = side_count(self.radius, resolution)
        half, quarter = 0.5 * self.length, np.linspace(0.0, 0.5 * np.pi, sides // 4 + 1)
        radii, heights = self.radius * np.sin(quarter), self.radius * np.cos(quarter)
        radii[0] = 0.0
        cells = max(1, int(np.ceil(self.length / resolution)))
        # Without a cylindrical part, both equators are one ring.
        between = np.linspace(-half, half, cells + 1) if half > 0.0 else np.zeros(1)
        return revolve(
            np.concatenate([radii[:-1], np.full(len(between), self.radius), radii[-2::-1]]),
            np.concatenate([-half - heights[:-1], between, half + heights[-2::-1]]),
            sides,
        )

    def _own_mass_properties(self) -> MassProperties:
        r, length = self.radius, self.length
        rod, ball = np.pi * r**2 * length, 4.0 / 3.0 * np.pi * r**3
        axial = rod * r**2 / 2.0 + ball * 0.4 * r**2
        # The centroid of a half-sphere is 3 r / 8 from its flat face (parallel axis theorem).
        across = rod * (r**2 / 4.0 + length**2 / 12.0)
        across += ball * (0.4 * r**2 + length**2 / 4.0 + 0.375 * length * r)
        return MassProperties(rod + ball, np.zeros(3), np.diag([across, across, axial]))
