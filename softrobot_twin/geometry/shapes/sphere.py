"""A sphere."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from softrobot_twin.geometry.mass_properties import MassProperties
from softrobot_twin.geometry.shapes.distance_kernels import CAPSULE
from softrobot_twin.geometry.shapes.shape import Shape, positive, revolve, side_count, vectors


@dataclass(frozen=True, eq=False)
class Sphere(Shape):
    """A sphere. Its canonical form is a capsule of length zero.

    Attributes:
        centre: Centre [m], shape (3,).
        radius: Radius [m], > 0.

    Raises:
        SceneError: A number is not finite, or the radius is not > 0.
    """

    kind = CAPSULE
    centre: np.ndarray
    radius: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "centre", vectors("sphere.centre", self.centre, (3,)))
        object.__setattr__(self, "radius", positive("sphere.radius", self.radius))

    def frame(self) -> tuple[np.ndarray, np.ndarray]:
        """See `Shape.frame`."""
        return self.centre, np.eye(3)

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
