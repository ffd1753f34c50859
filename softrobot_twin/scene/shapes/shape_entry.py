"""Base of the rigid shapes of scenes, in the coordinates of their body or obstacle.

A shape is one class in a file of its own: its keys in a scene, its form (see
`geometry/shapes/distance_kernels.py`), its surface and its mass properties. A shape of this package
is registered by its line in `Shaped`, another one by `register_shape`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, ClassVar, Self

import numpy as np
from pydantic import AfterValidator

from softrobot_twin.geometry.shapes.shape import RollingShape, Shape, axes_along
from softrobot_twin.geometry.surface_reading import SolidSurface
from softrobot_twin.scene.entry import Entry, Vector, unit

Length = Annotated[float, unit("m", gt=0.0)]


class ShapeEntry(Entry, Shape):
    """Base of all shapes.

    Attributes:
        placed_by: Key of the place that moves with the shape: a point, or several.
    """

    placed_by: ClassVar[str] = "centre"

    def moved(self, shift) -> Self:
        """A copy at another place.

        Args:
            shift: Displacement [m], shape (3,).
        """
        return self.changed(**{self.placed_by: np.add(shift, getattr(self, self.placed_by))})

    def solid(self, file_path: Callable, notes: list[str]) -> Shape | SolidSurface:
        """What touches other bodies; the entry itself unless it is read from a file.

        Args:
            file_path: Finds a file of the scene.
            notes: List to which repairs are appended.

        Raises:
            MeshError: A surface cannot be used.
        """
        return self


def _apart(ends: tuple) -> tuple:
    if ends[0] == ends[1]:
        raise ValueError("the two ends are the same point")
    return ends


class AxialShape(ShapeEntry, RollingShape):
    """Base of shapes that are round about a segment."""

    placed_by: ClassVar[str] = "ends"
    is_round: ClassVar[bool] = True

    ends: Annotated[tuple[Vector, Vector], AfterValidator(_apart)]
    """Centres of both ends: of hemispheres, or of flat ones."""
    radius: Length
    """Radius."""

    @property
    def length(self) -> float:
        """Length of the segment [m]."""
        return float(np.linalg.norm(np.subtract(self.ends[1], self.ends[0])))

    @property
    def curvature_radius(self) -> float:
        """See `Shape`."""
        return self.radius

    @property
    def width(self) -> float:
        """See `Shape`."""
        return 2.0 * min(self.radius, 0.5 * self.length)

    @property
    def axis(self) -> np.ndarray:
        """See `Shape`."""
        along = np.subtract(self.ends[1], self.ends[0])
        return along / np.linalg.norm(along)

    def frame(self) -> tuple[np.ndarray, np.ndarray]:
        """See `Shape.frame`; the z axis runs from the first end to the second."""
        return np.mean(self.ends, axis=0), axes_along(np.subtract(self.ends[1], self.ends[0]))

    def extents(self) -> np.ndarray:
        """Radius and half length; see `Shape.extents`."""
        return np.array([self.radius, 0.5 * self.length, 0.0])
