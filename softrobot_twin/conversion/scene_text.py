"""Writes a scene as YAML: each value with its unit, each entry below a comment that names its source."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from textwrap import wrap
from typing import Any

import numpy as np

SOURCE = "#"
"""Key of an entry for the comment above it; a list of texts has a line for each."""
_UNITS = {
    "gravity": "m/s²", "scale": "m per unit of the file", "rotation": "rad", "translation": "m",
    "young_modulus": "Pa", "density": "kg/m³", "total_mass": "kg", "mass": "kg", "damping.mass": "1/s", "damping.stiffness": "s",
    "stiffness": "N/m", "rest_length": "m", "shortening": "m", "tension": "N", "rate": "per s",
    "pressure": "Pa", "growth": "m³", "pull_point": "m", "position": "m", "angle": "rad",
    "alarm_distance": "m", "contact_distance": "m", "constants": "Pa",
}  # fmt: skip
_WIDTH = 100


def scene_yaml(scene: Mapping[str, Any], head: list[str]) -> str:
    """The text of a scene.

    Args:
        scene: Its sections: values, mappings, and lists of mappings.
        head: Lines of the comment at the top.
    """
    lines = [f"# {part}" for line in head for part in wrap(line, _WIDTH - 2)]
    for key, value in scene.items():
        if isinstance(value, Mapping | list) and value and key != "gravity":
            lines.append("")
        lines += _entry(key, value, 0)
    return "\n".join(lines) + "\n"


def _entry(key: str, value: Any, indent: int, above: str = "") -> Iterator[str]:
    """The lines of a key and its value, in an entry with the key `above`."""
    space = " " * indent
    if isinstance(value, list) and value and isinstance(value[0], Mapping):
        yield f"{space}{key}:"
        for part in value:
            yield from _item(part, indent + 2)
        return
    if isinstance(value, Mapping):
        flow = _flow(value)
        if SOURCE in value or len(flow) + indent + len(key) > 60:
            yield from _comment(value, space)
            yield f"{space}{key}:"
            for own, part in value.items():
                if own != SOURCE:
                    yield from _entry(own, part, indent + 2, key)
            return
    has_unit = (indent or key == "gravity") and not isinstance(value, str)
    unit = _UNITS.get(f"{above}.{key}", _UNITS.get(key, "")) if has_unit else ""
    text = f"{space}{key}: {_flow(value)}"
    if len(text) > _WIDTH and isinstance(value, list):
        yield f"{space}{key}: ["
        row = ""
        for part in value:
            word = _flow(part) + ", "
            if row and len(row) + len(word) > _WIDTH - indent - 2:
                yield f"{space}  {row.rstrip()}"
                row = ""
            row += word
        yield f"{space}  {row.rstrip(', ')}]"
        return
    yield f"{text}  # {unit}" if unit else text


def _item(entry: Mapping[str, Any], indent: int) -> Iterator[str]:
    """The lines of an entry of a list."""
    space = " " * indent
    yield from _comment(entry, space)
    own = {key: value for key, value in entry.items() if key != SOURCE}
    flow = _flow(own)
    if len(flow) + indent < _WIDTH - 2 and not any(isinstance(one, list) and one and isinstance(
            one[0], Mapping) for one in own.values()):  # fmt: skip
        yield f"{space}- {flow}"
        return
    first = True
    for key, value in own.items():
        for line in _entry(key, value, indent + 2):
            yield f"{space}- {line[indent + 2:]}" if first else line
            first = False


def _comment(entry: Mapping[str, Any], space: str) -> Iterator[str]:
    told = entry.get(SOURCE, ())
    for line in (told,) if isinstance(told, str) else told:
        for part in wrap(line, _WIDTH - 2 - len(space)):
            yield f"{space}# {part}"


def _flow(value: Any) -> str:
    """A value in one line."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{key}: {_flow(part)}" for key, part in value.items() if key != SOURCE) + "}"
    if isinstance(value, list | tuple | np.ndarray):
        return "[" + ", ".join(map(_flow, value)) + "]"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float | np.floating):
        return _number(float(value))
    if isinstance(value, int | np.integer):
        return str(value)
    text = str(value)
    is_word = re.fullmatch(r"[A-Za-z_./][\w./-]*", text) and text not in ("null", "true", "false", "y", "n", "on", "off", "yes", "no")
    return text if is_word else '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'


def _number(value: float) -> str:
    """A number with a point, so that YAML reads it as one; ten digits at most."""
    if not np.isfinite(value):
        return {np.inf: ".inf", -np.inf: "-.inf"}[value]
    if value and not 1e-4 <= abs(value) < 1e7:
        mantissa, _, exponent = f"{value:.9e}".partition("e")
        return f"{mantissa.rstrip('0').rstrip('.')}{'' if '.' in mantissa.rstrip('0').rstrip('.') else '.0'}e{int(exponent):+03d}"
    return np.format_float_positional(float(f"{value:.10g}"), trim="0")
