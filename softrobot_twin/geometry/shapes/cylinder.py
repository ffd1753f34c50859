"""A cylinder with flat caps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from softrobot_twin.errors import SceneError
from softrobot_twin.geometry.mass_properties import MassProperties
from softrobot_twin.geometry.shapes.distance_kernels import CYLINDER
from softrobot_twin.geometry.shapes.shape import (
    Shape,
    axes_along,
    positive,
    revolve,
    side_count,
    vectors,
)


@dataclass(frozen=True, eq=False)
class Cylinder(Shape):
    """A circular cylinder with flat caps perpendicular to its axis.

    Attributes:
        ends: Centres of the two caps [m], shape (2, 3).
        radius: Radius [m], > 0.

    Raises:
        SceneError: A number is not finite, the radius is not > 0, or the length is zero.
    """

    kind = CYLINDER
    ends: np.ndarray
    radius: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "ends", vectors("cylinder.ends", self.ends, (2, 3)))
        object.__setattr__(self, "radius", positive("cylinder.radius", self.radius))
        if self.length == 0.0:
            raise SceneError(None, "cylinder.ends", self.ends, "m", "must be two points")

    @property
    def length(self) -> float:
        """Length from cap to cap [m]."""
        return float(np.linalg.norm(self.ends[1] - self.ends[0]))

    def frame(self) -> tuple[np.ndarray, np.ndarray]:
        """See `Shape.frame`; the z axis runs from the first cap to the second."""
        return self.ends.mean(axis=0), axes_along(self.ends[1] - self.ends[0])

    def extents(self) -> np.ndarray:
        """Radius and half length; see `Shape.extents`."""
        return np.array([self.radius, 0.5 * self.length, 0.0])

    def _own_distances(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        from_axis = np.linalg.norm(points[:, :2], axis=1)
        radial = np.tile([1.0, 0.0, 0.0], (len(points), 1))
        off_axis = from_axis > 0.0
        radial[off_axis, :2] = points[off_axis, :2] / from_axis[off_axis, None]
        axial = np.outer(np.where(points[:, 2] >= 0.0, 1.0, -1.0), [0.0, 0.0, 1.0])
        side = from_axis - self.radius
        cap = np.abs(points[:, 2]) - 0.5 * self.length
        distances = np.maximum(side, cap)
        normals = np.where((side >= cap)[:, None], radial, axial)
        at_rim = (side > 0.0) & (cap > 0.0)
        distances[at_rim] = np.hypot(side, cap)[at_rim]
        outward = side[:, None] * radial + cap[:, None] * axial
        normals[at_rim] = outward[at_rim] / distances[at_rim, None]
        return distances, normals

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
