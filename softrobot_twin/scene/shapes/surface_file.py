"""A closed surface of triangles in a file."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, ClassVar

from softrobot_twin.geometry.surface_reading import SolidSurface, read_solid_surface
from softrobot_twin.scene.entry import Angles, Vector, unit
from softrobot_twin.scene.shapes.shape_entry import ShapeEntry


class SurfaceFile(ShapeEntry):
    """A closed surface of triangles."""

    told: ClassVar[tuple[str, ...]] = ("surface {file}",)
    placed_by: ClassVar[str] = "translation"

    file: Path
    """Mesh file."""
    scale: Annotated[float, unit("m per file unit", gt=0.0)] = 1.0
    """Metres in a unit of the file."""
    rotation: Angles = (0.0, 0.0, 0.0)
    """Angles about the axes; after the scale."""
    translation: Vector = (0.0, 0.0, 0.0)
    """Displacement; after the rotation."""
    hull: bool = False
    """Whether the convex hull of the file is taken."""

    def solid(self, file_path: Callable, notes: list[str]) -> SolidSurface:
        """See `ShapeEntry.solid`."""
        return read_solid_surface(
            file_path(self.file), scale=self.scale, rotation=self.rotation,
            translation=self.translation, notes=notes, hull=self.hull,
        )  # fmt: skip
