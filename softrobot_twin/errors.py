"""Errors raised for user input: a scene, a mesh, a command or a parameter that cannot be used."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import ClassVar


MOST_COUNTED = 10_000_000
"""Greatest count of anything that is asked for, such as steps of a run."""


class SoftRobotTwinError(Exception):
    """Base of every error that this package raises on purpose."""


class MeshError(SoftRobotTwinError):
    """A mesh cannot be used.

    Attributes:
        path: File the mesh came from, or None for a mesh made in memory.
        reason: What is wrong, in one sentence.
    """

    def __init__(self, path: Path | str | None, reason: str):
        self.path = None if path is None else Path(path)
        self.reason = reason
        super().__init__(f"{path or 'mesh'}: {reason}")


class SceneError(SoftRobotTwinError):
    """A scene contains entries that cannot be used.

    Attributes:
        path: Scene file, or None for a scene made in memory.
        key: Dotted path of the invalid entry, such as ``cables[0].tension``.
        value: Value of the entry.
        unit: Unit the value is read in, or an empty string.
        reason: What is required.
        line: Line of the entry in the file; None where the file does not have it.
        others: Further errors of the same scene.
        further: Number of errors beyond these.
    """

    line_of_key: ClassVar[Callable[[Path, str], int | None]] = staticmethod(lambda path, key: None)
    """Finds the line of a key in a scene file; `softrobot_twin.scene.loading` sets it."""

    def __init__(
        self, path: Path | str | None, key: str, value: object, unit: str, reason: str,
        others: Sequence[SceneError] = (), further: int = 0,
    ):  # fmt: skip
        self.path = None if path is None else Path(path)
        self.key = key
        self.value = value
        self.unit = unit
        self.reason = reason
        self.line = None if self.path is None else type(self).line_of_key(self.path, key)
        self.others, self.further = tuple(others), further
        stated = f"{value!r} {unit}".rstrip()
        place = str(path or "scene") if self.line is None else f"{path}:{self.line}"
        shown = [f"{place}: {key} = {stated}: {reason}", *map(str, self.others)]
        if further:
            shown.append(f"and {further} more error{'s' if further > 1 else ''}")
        super().__init__("\n".join(shown))


class NamedError(SoftRobotTwinError):
    """Something that has a name cannot be used.

    Attributes:
        name: Its name, or its path.
        reason: What is wrong.
    """

    def __init__(self, name: Path | str, reason: str):
        self.name, self.reason = name, reason
        super().__init__(f"{name}: {reason}")


class CommandError(NamedError):
    """A command does not fit the simulation that receives it; its name is that of the actuator or
    effector that the command names or omits."""


class ParameterError(SoftRobotTwinError):
    """A node's parameter cannot be used.

    Attributes:
        name: Parameter name.
        value: Value that was given.
        unit: Unit it is read in, or an empty string.
        reason: What is required.
    """

    def __init__(self, name: str, value: object, unit: str, reason: str):
        self.name = name
        self.value = value
        self.unit = unit
        self.reason = reason
        stated = f"{value!r} {unit}".rstrip()
        super().__init__(f"parameter {name} = {stated}: {reason}")


def one_line(error: Exception) -> str:
    """What an exception says, in one line.

    Args:
        error: The exception.
    """
    return " ".join(str(error).split())


MOST_SHOWN = 4000
"""Most characters of a text from outside that are shown."""


def printable(text: str) -> str:
    """A text in which nothing moves the cursor, colours, begins a line or has no encoding.

    Such characters become escapes, ``\\x1b``: names from a network or a file may have them, and could
    forge lines of a log.

    Args:
        text: The text; what is beyond `MOST_SHOWN` characters is cut off.
    """
    shown = text if len(text) <= MOST_SHOWN else f"{text[:MOST_SHOWN]}…"
    if shown.isprintable():
        return shown
    return "".join(
        one if one.isprintable() else one.encode("unicode_escape").decode() for one in shown
    )


def printable_lines(text: str) -> str:
    """A text of several lines, each as `printable` makes it.

    Args:
        text: The text.
    """
    return "\n".join(map(printable, text.splitlines()))
