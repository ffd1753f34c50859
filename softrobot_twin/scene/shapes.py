"""Entries of rigid shapes, in the coordinates of the body or obstacle that has them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import model_validator

from softrobot_twin.scene.entry import Angles, Entry, Vector, unit

Radius = Annotated[float, unit("m", gt=0.0)]


class PlaneShape(Entry):
    """A half space; free is the side that its normal points to."""

    point: Vector = (0.0, 0.0, 0.0)
    normal: Annotated[tuple[float, float, float], unit("")] = (0.0, 0.0, 1.0)

    @model_validator(mode="after")
    def _has_direction(self):
        if not any(self.normal):
            raise ValueError("a plane's normal must have a direction")
        return self


class SphereShape(Entry):
    """A ball."""

    centre: Vector = (0.0, 0.0, 0.0)
    radius: Radius


class CapsuleShape(Entry):
    """A cylinder with half balls at its ends."""

    ends: tuple[Vector, Vector]
    radius: Radius

    @model_validator(mode="after")
    def _has_length(self):
        return _with_length(self)


class CylinderShape(Entry):
    """A cylinder with flat ends."""

    ends: tuple[Vector, Vector]
    radius: Radius

    @model_validator(mode="after")
    def _has_length(self):
        return _with_length(self)


class BoxShape(Entry):
    """A box."""

    centre: Vector = (0.0, 0.0, 0.0)
    size: Annotated[
        tuple[
            Annotated[float, unit("m", gt=0.0)],
            Annotated[float, unit("m", gt=0.0)],
            Annotated[float, unit("m", gt=0.0)],
        ],
        unit("m"),
    ]
    """Whole lengths of its edges."""
    rotation: Angles = (0.0, 0.0, 0.0)


class SurfaceShape(Entry):
    """A closed surface of triangles."""

    file: Path
    """Mesh file, relative to the scene file."""
    scale: Annotated[float, unit("m per file unit", gt=0.0)] = 1.0
    rotation: Angles = (0.0, 0.0, 0.0)
    translation: Vector = (0.0, 0.0, 0.0)


SHAPES = ("plane", "sphere", "capsule", "cylinder", "box", "surface")


class Shaped(Entry):
    """Something with exactly one shape, placed in the world."""

    position: Vector = (0.0, 0.0, 0.0)
    rotation: Angles = (0.0, 0.0, 0.0)
    """Angles about the world's x, y and z axes, in this order."""
    plane: PlaneShape | None = None
    sphere: SphereShape | None = None
    capsule: CapsuleShape | None = None
    cylinder: CylinderShape | None = None
    box: BoxShape | None = None
    surface: SurfaceShape | None = None

    @model_validator(mode="after")
    def _one_shape(self):
        if len(self._given()) != 1:
            raise ValueError(f"has exactly one shape of {', '.join(SHAPES)}")
        return self

    def _given(self) -> list[str]:
        return [kind for kind in SHAPES if getattr(self, kind) is not None]

    @property
    def shape(self) -> Entry:
        """The one shape."""
        return getattr(self, self._given()[0])


def _with_length(entry):
    if entry.ends[0] == entry.ends[1]:
        raise ValueError("its two ends are the same point")
    return entry
