"""A solid given by its closed triangle surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from softrobot_twin.geometry.mass_properties import MassProperties, surface_mass_properties


@dataclass(frozen=True, eq=False)
class SolidSurface:
    """A closed surface in the frame of its carrier, an obstacle or a rigid body.

    Attributes:
        points: Its points [m], shape (point_count, 3).
        triangles: Indices of them, counter-clockwise from outside, shape (triangle_count, 3).
    """

    points: np.ndarray
    triangles: np.ndarray

    def surface(self, resolution: float = np.inf) -> tuple[np.ndarray, np.ndarray]:
        """Points and triangles as they are, whatever the resolution asked for."""
        return self.points, self.triangles

    def mass_properties(self) -> MassProperties:
        """Volume, centroid and inertia about it at unit density."""
        return surface_mass_properties(self.points, self.triangles)
