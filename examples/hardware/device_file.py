"""Files that describe hardware: values that are checked, and errors that name file, key, value and unit."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from pathlib import Path

import yaml

from softrobot_twin.errors import SoftRobotTwinError


class DeviceFileError(SoftRobotTwinError):
    """A file that describes hardware cannot be used.

    Attributes:
        file: The file.
        key: The key in it.
        value: Its value.
        unit: Its unit.
    """

    def __init__(self, file: Path, key: str, value: object, unit: str, reason: str):
        self.file, self.key, self.value, self.unit = file, key, value, unit
        shown = f"{key} = {value!r} {unit}".rstrip() + ": " if key else ""
        super().__init__(f"{file}: {shown}{reason}")


def read_entries(file: Path, section: str, noun: str) -> tuple[dict, list]:
    """Reads a file that has keys, and a list of the parts of the hardware.

    Args:
        file: The file.
        section: Key of the list.
        noun: What an entry of it is.

    Returns:
        The other keys, and the list, which is not empty.

    Raises:
        DeviceFileError: The file cannot be read, or has no such list.
    """
    try:
        given = yaml.safe_load(file.read_text())
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise DeviceFileError(file, "", "", "", f"cannot be read: {error}") from error
    if not isinstance(given, dict) or not isinstance(given.get(section), list):
        raise DeviceFileError(file, section, given and type(given).__name__, "", "must be a list")
    entries = given.pop(section)
    if not entries:
        raise DeviceFileError(file, section, [], "", f"names no {noun}")
    return given, entries


def checked(file: Path, where: str, given: object, wanted: Mapping) -> dict[str, object]:
    """Values of a mapping, each with its type and in its range.

    Args:
        file: The file.
        where: Beginning of its keys.
        given: The mapping.
        wanted: Type, unit, least and greatest value of each key.

    Raises:
        DeviceFileError: A value is missing, unknown or out of range.
    """
    if not isinstance(given, dict):
        raise DeviceFileError(file, where.rstrip("."), given, "", "must be keys with values")
    for key in given:
        if key not in wanted:
            raise DeviceFileError(file, f"{where}{key}", given[key], "",
                                  f"is unknown; known are {', '.join(wanted)}")  # fmt: skip
    values = {}
    for key, (kind, unit, low, high) in wanted.items():
        if key not in given:
            raise DeviceFileError(file, f"{where}{key}", None, unit, "is missing")
        value = given[key]
        is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
        if kind is float and (is_number or isinstance(value, str)):
            # PyYAML reads 20.0e3, without a sign in the exponent, as text.
            with contextlib.suppress(ValueError):
                value = float(value)
        if type(value) is not kind:
            raise DeviceFileError(file, f"{where}{key}", value, unit, f"must be a {kind.__name__}")
        if kind is not str and not low <= value <= high:
            raise DeviceFileError(file, f"{where}{key}", value, unit, f"must be {low:g} to {high:g}")
        values[key] = value
    return values
