"""The Trunk's shape: a tapering core with ten disks, and eight cables through them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

DISK_COUNT = 10
# Published direction of the cable at azimuth 90°: from one disk to the next, 17.5 mm along it.
DIRECTION = np.array([0.0, -8.0, 195.0]) / np.hypot(8.0, 195.0)
SPACING = 17.5


@dataclass(frozen=True)
class TrunkShape:
    """Dimensions of the body [mm].

    Attributes:
        length: Along z, from 0.
        base_radius: Radius that a disk at z 0 would have.
        tip_radius: Radius that a disk at the tip would have.
        core_share: The core's radius over the disks'.
        first_disk: z of the first disk's lower face; below it the platform holds the body.
        disk_thickness: Along z.
    """

    length: float = 195.0
    base_radius: float = 13.0
    tip_radius: float = 7.5
    core_share: float = 0.6
    first_disk: float = 20.0
    disk_thickness: float = 7.2

    def radius(self, z):
        """Radius of a disk at a height [mm]."""
        return self.base_radius + (self.tip_radius - self.base_radius) * z / self.length

    def disk_faces(self) -> np.ndarray:
        """z of both faces of every disk [mm], shape (disk_count, 2)."""
        lower = self.first_disk + SPACING * DIRECTION[2] * np.arange(DISK_COUNT)
        return np.stack([lower, lower + self.disk_thickness], axis=1)


def cable_path(azimuth: int, disk_count: int) -> np.ndarray:
    """Points of one cable: its pull point, then two points at each disk.

    Args:
        azimuth: 0 to 3, times 90° about z from +y.
        disk_count: Disks that it runs through.

    Returns:
        Points [mm], shape (1 + 2 · disk_count, 3).
    """
    steps = SPACING * np.arange(disk_count)[:, None] * DIRECTION
    points = [steps + (0.0, 10.0, z) for z in (21.0, 27.0)]
    path = np.vstack([[0.0, 10.0, 0.0], np.stack(points, axis=1).reshape(-1, 3)])
    turned = path.copy()
    for _ in range(azimuth):
        turned[:, :2] = np.stack([-turned[:, 1], turned[:, 0]], axis=1)
    return turned


def cables() -> Iterator[tuple[str, np.ndarray]]:
    """Name and path [mm] of all eight cables: four long ones, then four short ones."""
    for letter, disk_count in (("L", DISK_COUNT), ("S", DISK_COUNT // 2)):
        for azimuth in range(4):
            yield f"{letter}{azimuth}", cable_path(azimuth, disk_count)
