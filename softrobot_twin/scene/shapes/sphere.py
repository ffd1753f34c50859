"""A sphere."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from softrobot_twin.geometry.mass_properties import MassProperties
from softrobot_twin.geometry.shapes.distance_kernels import CAPSULE
from softrobot_twin.geometry.shapes.shape import revolve, side_count
from softrobot_twin.scene.entry import Vector
from softrobot_twin.scene.shapes.shape_entry import Length, ShapeEntry


class Sphere(ShapeEntry):
    """A ball."""

    told: ClassVar[tuple[str, ...]] = ("sphere of radius {radius:mm} mm",)
    # A capsule of length zero.
    kind: ClassVar[int] = CAPSULE
    is_round: ClassVar[bool] = True

    centre: Vector = (0.0, 0.0, 0.0)
    """Centre."""
    radius: Length
    """Radius."""

    @property
    def curvature_radius(self) -> float:
        """See `Shape`."""
        return self.radius

    def frame(self) -> tuple[np.ndarray, np.ndarray]:
        """See `Shape.frame`."""
        return np.array(self.centre), np.eye(3)

    def extents(self) -> np.ndarray:
        """The radius; see `Shape.extents`."""
        return np.array([self.radius, 0.0, 0.0])

    def _own_surface(self, resolution: float) -> tuple[np.ndarray, np.ndarray]:
        sides = side_count(self.radius, resolution)
        polar = np.linspace(0.0, np.pi, sides // 2 + 1)
        radii = self.radius * np.sin(polar)
        radii[[0, -1]] = 0.0
        return revolve(radii, -self.radius * np.cos(polar), sides)

    def _own_mass_properties(self) -> MassProperties:
        volume = 4.0 / 3.0 * np.pi * self.radius**3
        return MassProperties(volume, np.zeros(3), 0.4 * volume * self.radius**2 * np.eye(3))
