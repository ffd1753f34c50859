"""What all entries of a scene have in common: frozen, checked, each value with its unit."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, model_validator
from pydantic_core import PydanticCustomError

from softrobot_twin.scene.shorthand import written_out


LARGEST, SMALLEST = 1.0e30, 1.0e-30
"""Sizes beyond which products of numbers are no numbers any more; the same in any SI unit."""


class Entry(BaseModel):
    """Base of all entries: frozen, no unknown keys, no NaN or infinity."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    @model_validator(mode="before")
    @classmethod
    def _write_out(cls, entry: Any) -> Any:
        return written_out(cls, entry)

    @model_validator(mode="after")
    def _within_reckoning(self):
        for name in type(self).model_fields:
            value = getattr(self, name)
            for number in _numbers(value):
                if LARGEST < abs(number) < math.inf:
                    raise refusal(name, value, f"is beyond {LARGEST:g}, which nothing is")
                if number == value and 0.0 < abs(number) < SMALLEST:
                    raise refusal(name, value, f"is nearer to 0 than {SMALLEST:g}: give 0")
        return self


def values_below(entry: Entry, key: str = "") -> Iterator[tuple[str, str, Any]]:
    """All values of an entry and of the entries in it that are no entries themselves.

    Args:
        entry: The entry.
        key: Dotted path of the entry; empty for a whole scene.

    Yields:
        Dotted path, such as ``cables[0].rate``, the last name in it, and the value.
    """
    for name in type(entry).model_fields:
        below, value = f"{key}.{name}" if key else name, getattr(entry, name)
        if isinstance(value, Entry):
            yield from values_below(value, below)
        elif isinstance(value, tuple) and any(isinstance(item, Entry) for item in value):
            for index, item in enumerate(value):
                yield from values_below(item, f"{below}[{index}]")
        else:
            yield below, name, value


def _numbers(value: Any) -> list[float]:
    """All numbers of a value, also in lists of points; not those of other entries."""
    if isinstance(value, float):
        return [value]
    if isinstance(value, tuple):
        return [number for part in value for number in _numbers(part)]
    return []


def refusal(key: str, value: object, reason: str) -> PydanticCustomError:
    """An error that names the entry it is about, where the check looks at several.

    Args:
        key: Dotted path below the entry that is checked, such as ``cables[0].body``.
        value: What stands there.
        reason: What would be right.
    """
    # Braces would be taken for places to fill in.
    return PydanticCustomError("refusal", "{reason}",
                               {"key": key, "value": value, "reason": reason})  # fmt: skip


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
OpenNumber = Annotated[float, Field(allow_inf_nan=True)]
"""A number that may be infinite; NaN is left for a limit to refuse."""


def check_range(bounds: Range) -> Range:
    """Limits must be in order; swapping them in silence would hide a mistake."""
    if any(math.isnan(bound) for bound in bounds):
        raise ValueError("a limit must be a number; .inf where there is none")
    if bounds[0] > bounds[1]:
        raise ValueError("the lower limit is above the upper one")
    if bounds[0] == math.inf or bounds[1] == -math.inf:
        raise ValueError("nothing lies within these limits")
    return bounds


def _ends(low: float, high: float) -> BeforeValidator:
    """Puts these ends where null stands."""

    def fill(bounds: Any) -> Any:
        if isinstance(bounds, list | tuple) and len(bounds) == 2:
            ends = zip(bounds, (low, high), strict=True)
            return [end if given is None else given for given, end in ends]
        return (low, high) if bounds is None else bounds

    return BeforeValidator(fill)


_Open = tuple[OpenNumber, OpenNumber]
OpenRange = Annotated[_Open, _ends(-math.inf, math.inf), AfterValidator(check_range)]
"""Limits of which each may be infinite."""
OpenPull = Annotated[_Open, _ends(0.0, math.inf), AfterValidator(check_range)]
"""Limits of what cannot push, of which the upper may be infinite."""
