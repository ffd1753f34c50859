"""A plane: the half-space below it is solid."""

from __future__ import annotations

from typing import Annotated, ClassVar

import numpy as np

from softrobot_twin.geometry.shapes.distance_kernels import HALF_SPACE
from softrobot_twin.geometry.shapes.shape import axes_along
from softrobot_twin.scene.entry import Direction, Vector, not_zero
from softrobot_twin.scene.shapes.shape_entry import ShapeEntry


class Plane(ShapeEntry):
    """A half space; its normal points to the free side."""

    told: ClassVar[tuple[str, ...]] = ("plane", "normal {normal:=}")
    placed_by: ClassVar[str] = "point"
    kind: ClassVar[int] = HALF_SPACE
    is_half_space: ClassVar[bool] = True

    point: Vector = (0.0, 0.0, 0.0)
    """A point of the plane."""
    normal: Annotated[Direction, not_zero("the normal of a plane must not be zero")] = (0.0, 0.0, 1.0)
    """Direction to the free side."""

    @property
    def unit_normal(self) -> np.ndarray:
        """The normal, of length 1, shape (3,)."""
        # Twice: the length of a first quotient may be off by round-off.
        once = np.asarray(self.normal) / np.linalg.norm(self.normal)
        return once / np.linalg.norm(once)

    def frame(self) -> tuple[np.ndarray, np.ndarray]:
        """See `Shape.frame`."""
        return np.array(self.point), axes_along(self.unit_normal)

    def extents(self) -> np.ndarray:
        """See `Shape.extents`."""
        return np.zeros(3)

    def surface(self, resolution: float) -> tuple[np.ndarray, np.ndarray]:
        """See `Shape.surface`; a plane, which has no end, has no triangles."""
        return np.empty((0, 3)), np.empty((0, 3), np.int64)

    def square(self, centre, half_side: float) -> tuple[np.ndarray, np.ndarray]:
        """A square of the plane, as an open surface.

        Args:
            centre: Its centre is the foot of this point [m], shape (3,).
            half_side: Half of its side [m].

        Returns:
            Points [m], shape (4, 3), and triangles, int64, shape (2, 3).
        """
        normal = self.unit_normal
        foot = centre - ((centre - np.asarray(self.point)) @ normal) * normal
        corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], float)
        square = half_side * corners @ axes_along(normal).T
        return square + foot, np.array([[0, 1, 2], [0, 2, 3]])
