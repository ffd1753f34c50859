"""Errors raised for user input: a scene, a mesh, a command or a parameter that cannot be used."""

from __future__ import annotations

from pathlib import Path


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
    """A scene contains an entry that cannot be used.

    Attributes:
        path: Scene file, or None for a scene made in memory.
        key: Dotted path of the invalid entry, such as ``cables[0].tension``.
        value: Value of the entry.
        unit: Unit the value is read in, or an empty string.
        reason: What is required.
    """

    def __init__(self, path: Path | str | None, key: str, value: object, unit: str, reason: str):
        self.path = None if path is None else Path(path)
        self.key = key
        self.value = value
        self.unit = unit
        self.reason = reason
        stated = f"{value!r} {unit}".rstrip()
        super().__init__(f"{path or 'scene'}: {key} = {stated}: {reason}")


class CommandError(SoftRobotTwinError):
    """A command does not fit the simulation that receives it.

    Attributes:
        name: Actuator or effector that the command names or omits.
        reason: What is required.
    """

    def __init__(self, name: str, reason: str):
        self.name = name
        self.reason = reason
        super().__init__(f"{name}: {reason}")


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
