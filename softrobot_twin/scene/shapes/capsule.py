"""A capsule: all points within a distance from a line segment."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from softrobot_twin.geometry.mass_properties import MassProperties
from softrobot_twin.geometry.shapes.distance_kernels import CAPSULE
from softrobot_twin.geometry.shapes.shape import revolve, side_count
from softrobot_twin.scene.shapes.shape_entry import AxialShape


class Capsule(AxialShape):
    """A cylinder with hemispheres at its ends."""

    told: ClassVar[tuple[str, ...]] = ("capsule of radius {radius:mm} mm", "{ends:|} mm long")
    kind: ClassVar[int] = CAPSULE

    def lowest(self, normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See `RollingShape.lowest`: of the balls at both ends."""
        half = 0.5 * self.length
        ends = np.array([[0.0, 0.0, -half], [0.0, 0.0, half]])
        return ends - self.radius * normal, np.arange(2)

    def _own_surface(self, resolution: float) -> tuple[np.ndarray, np.ndarray]:
        sides = side_count(self.radius, resolution)
        half, quarter = 0.5 * self.length, np.linspace(0.0, 0.5 * np.pi, sides // 4 + 1)
        radii, heights = self.radius * np.sin(quarter), self.radius * np.cos(quarter)
        radii[0] = 0.0
        cells = max(1, int(np.ceil(self.length / resolution)))
        between = np.linspace(-half, half, cells + 1)
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
