"""A cylinder with flat caps."""

from __future__ import annotations

import numpy as np

from softrobot_twin.errors import SceneError
from softrobot_twin.geometry.mass_properties import MassProperties
from softrobot_twin.geometry.shapes.distance_kernels import CYLINDER
from softrobot_twin.geometry.shapes.shape import AxialShape, revolve, side_count


class Cylinder(AxialShape):
    """A circular cylinder with flat caps perpendicular to its axis.

    Attributes:
        ends: Centres of the two caps [m], shape (2, 3).
        radius: Radius [m], > 0.

    Raises:
        SceneError: A number is not finite, the radius is not > 0, or the length is zero.
    """

    kind, noun = CYLINDER, "cylinder"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.length == 0.0:
            raise SceneError(None, "cylinder.ends", self.ends, "m", "must be two points")

    def _own_surface(self, resolution: float) -> tuple[np.ndarray, np.ndarray]:
        half = 0.5 * self.length
        inward = np.linspace(0.0, self.radius, 1 + max(1, int(np.ceil(self.radius / resolution))))
        upward = np.linspace(-half, half, 1 + max(1, int(np.ceil(self.length / resolution))))
        return revolve(
            np.concatenate([inward[:-1], np.full(len(upward), self.radius), inward[-2::-1]]),
            np.concatenate(
                [np.full(len(inward) - 1, -half), upward, np.full(len(inward) - 1, half)]
            ),
            side_count(self.radius, resolution),
        )

    def _own_mass_properties(self) -> MassProperties:
        square, volume = self.radius**2, np.pi * self.radius**2 * self.length
        across = volume * (square / 4.0 + self.length**2 / 12.0)
        inertia = np.diag([across, across, volume * square / 2.0])
        return MassProperties(volume, np.zeros(3), inertia)
