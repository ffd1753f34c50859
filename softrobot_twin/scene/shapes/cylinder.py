"""A cylinder with flat caps."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from softrobot_twin.geometry.mass_properties import MassProperties
from softrobot_twin.geometry.shapes.distance_kernels import CYLINDER
from softrobot_twin.geometry.shapes.shape import revolve, side_count
from softrobot_twin.geometry.surface_shape import CAP_STRIDE, PARALLEL_FACE, RIM_POINTS
from softrobot_twin.scene.shapes.shape_entry import AxialShape


class Cylinder(AxialShape):
    """A cylinder with flat ends."""

    told: ClassVar[tuple[str, ...]] = ("cylinder of radius {radius:mm} mm", "{ends:|} mm long")
    kind: ClassVar[int] = CYLINDER
    has_round_ends: ClassVar[bool] = False

    def lowest(self, normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See `RollingShape.lowest`: of the rims; all round a cap that is parallel to the plane."""
        half = 0.5 * self.length
        ends = np.array([[0.0, 0.0, -half], [0.0, 0.0, half]])
        across = np.hypot(normal[0], normal[1])
        caps = np.flatnonzero(np.array([-normal[2], normal[2]]) <= PARALLEL_FACE)
        if across > PARALLEL_FACE:
            lowest = np.array([*(-self.radius / across * normal[:2]), 0.0])
            return ends[caps] + lowest, CAP_STRIDE * caps
        angles = 2.0 * np.pi * np.arange(RIM_POINTS) / RIM_POINTS
        rim = self.radius * np.column_stack([np.cos(angles), np.sin(angles), 0.0 * angles])
        return ends[caps[0]] + rim, CAP_STRIDE * caps[0] + 1 + np.arange(RIM_POINTS)

    def _own_surface(self, resolution: float) -> tuple[np.ndarray, np.ndarray]:
        half = 0.5 * self.length
        inward = np.linspace(0.0, self.radius, 1 + max(1, int(np.ceil(self.radius / resolution))))
        upward = np.linspace(-half, half, 1 + max(1, int(np.ceil(self.length / resolution))))
        return revolve(
            np.concatenate([inward[:-1], np.full(len(upward), self.radius), inward[-2::-1]]),
            np.concatenate([np.full(len(inward) - 1, -half), upward, np.full(len(inward) - 1, half)]),
            side_count(self.radius, resolution),
        )

    def _own_mass_properties(self) -> MassProperties:
        square, volume = self.radius**2, np.pi * self.radius**2 * self.length
        across = volume * (square / 4.0 + self.length**2 / 12.0)
        inertia = np.diag([across, across, volume * square / 2.0])
        return MassProperties(volume, np.zeros(3), inertia)
