"""What all entries of a scene have in common: frozen, checked, each value with its unit."""

from __future__ import annotations

import re
from typing import Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict, Field


class Entry(BaseModel):
    """Base of all entries: frozen, no unknown keys, no NaN or infinity."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


def unit(name: str, **limits) -> object:
    """A field whose unit is told when its value is refused."""
    return Field(json_schema_extra={"unit": name}, **limits)


def check_name(name: str) -> str:
    """A name becomes part of a ROS topic."""
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name):
        raise ValueError("a name is letters, digits and underscores, a letter first")
    return name


Name = Annotated[str, AfterValidator(check_name)]
Vector = Annotated[tuple[float, float, float], unit("m")]
Angles = Annotated[tuple[float, float, float], unit("rad")]
Acceleration = Annotated[tuple[float, float, float], unit("m/s²")]
Range = tuple[float, float]


def check_range(bounds: Range) -> Range:
    """Limits must be in order; swapping them in silence would hide a mistake."""
    if bounds[0] > bounds[1]:
        raise ValueError("the lower limit is above the upper one")
    return bounds
