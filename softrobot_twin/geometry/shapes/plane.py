"""A plane: the half-space below it is solid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from softrobot_twin.errors import SceneError
from softrobot_twin.geometry.shapes.distance_kernels import HALF_SPACE
from softrobot_twin.geometry.shapes.shape import Shape, axes_along, positive, vectors


@dataclass(frozen=True, eq=False)
class Plane(Shape):
    """The solid half-space below a plane. It has no volume and no mass.

    Attributes:
        point: A point of the plane [m], shape (3,).
        normal: Direction out of the solid, shape (3,); made a unit vector.

    Raises:
        SceneError: A number is not finite, or the normal has no length.
    """

    kind = HALF_SPACE
    point: np.ndarray
    normal: np.ndarray

    def __post_init__(self) -> None:
        object.__setattr__(self, "point", vectors("plane.point", self.point, (3,)))
        normal = vectors("plane.normal", self.normal, (3,), "")
        if np.linalg.norm(normal) == 0.0:
            raise SceneError(None, "plane.normal", self.normal, "", "must have a length")
        normal = vectors("plane.normal", normal / np.linalg.norm(normal), (3,), "")
        object.__setattr__(self, "normal", normal)

    def frame(self) -> tuple[np.ndarray, np.ndarray]:
        """See `Shape.frame`."""
        return self.point, axes_along(self.normal)

    def extents(self) -> np.ndarray:
        """See `Shape.extents`."""
        return np.zeros(3)

    def surface(self, half_size: float) -> tuple[np.ndarray, np.ndarray]:
        """Triangulates a square of the plane around its point, as an open surface.

        Args:
            half_size: Half the side of the square [m], finite and > 0.

        Returns:
            Points [m], shape (4, 3), and triangles, int64, shape (2, 3).

        Raises:
            SceneError: The half size is not finite and > 0.
        """
        half = positive("half_size", half_size)
        square = half * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], float)
        origin, axes = self.frame()
        return square @ axes.T + origin, np.array([[0, 1, 2], [0, 2, 3]])

    def mass_properties(self):
        """Raises an error: a half-space has no volume and no mass.

        Raises:
            SceneError: Always.
        """
        raise SceneError(None, "plane", None, "", "a plane has no volume and no mass")
