"""Numbers and entries of a scene in words, as `explain` prints them."""

from __future__ import annotations

import math
from collections.abc import Sized
from typing import Any


def count(things: Sized, name: str) -> str:
    """A number with a noun: ``3 nodes``, ``1 node``.

    Args:
        things: What is counted.
        name: The noun, for one of them.
    """
    return f"{len(things)} {name}{'' if len(things) == 1 else 's'}"


def number(value: float) -> str:
    """A number with at most six digits.

    Args:
        value: The number.
    """
    return f"{value + 0.0:.6g}"  # 0 in place of -0


def vector(values: Any) -> str:
    """Numbers in brackets.

    Args:
        values: The numbers.
    """
    return "[" + ", ".join(number(float(value)) for value in values) + "]"


def words(*parts: str | None) -> str:
    """The parts of a description that are not empty.

    Args:
        *parts: The parts; None or an empty text is left out.
    """
    return ", ".join(filter(None, parts))


def in_words(value: Any, form: str = "") -> str:
    """A value of an entry in words.

    Args:
        value: The value; entries describe themselves.
        form: ``mm`` for lengths [m] in millimetres, ``|`` for the distance of two points in them,
            ``%`` for two shares, ``#node`` for the number of nodes, and else what stands between
            several things.
    """
    if form.startswith("#"):
        return count(value, form[1:])
    if form == "%":
        return " to ".join(f"{100.0 * share:.0f} %" for share in value)
    if form == "|":
        return number(1e3 * math.dist(*value))
    factor = 1e3 if form == "mm" else 1.0
    if isinstance(value, int | float):
        return number(factor * value)
    if not isinstance(value, tuple):
        return value.describe() if hasattr(value, "describe") else str(value)
    if form in ("", "mm") and all(isinstance(one, int | float) for one in value):
        return vector(factor * one for one in value)
    return (form or ", ").join(map(in_words, value))
