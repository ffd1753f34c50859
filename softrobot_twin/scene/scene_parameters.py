"""Numbers of a scene by their keys: read, set and scaled, in a scene that is checked again.

A key is the path of a value, such as ``body.material.young_modulus`` or ``cables[0].points[2][1]``.
An entry of a list has its place or its name: ``cables[0].rate`` is ``cables.north.rate``. A ``*``
stands for any number of letters, so ``cables.*.rate`` is the rate of each cable.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from fnmatch import fnmatchcase
from typing import Any, NamedTuple

from pydantic import ValidationError

from softrobot_twin.errors import SceneError
from softrobot_twin.scene.entry import Entry, values_below
from softrobot_twin.scene.patterns import as_written
from softrobot_twin.scene.refusal_messages import (
    dotted,
    nearest,
    parts,
    scene_error,
    unit_at,
)
from softrobot_twin.scene.schema import Scene

_KEY = re.compile(r"[^.\[\]]+(?:\[\d+\])*(?:\.[^.\[\]]+(?:\[\d+\])*)*")
# A preset gives these: where one of them has another value, the preset is no more what is asked for.
_OF_PRESET = ("law", "constants", "young_modulus")


class Parameter(NamedTuple):
    """A number of a scene. It belongs to no scene: all with such a value have it.

    Attributes:
        key: Where it is, such as ``cables[0].points[2][1]``.
        unit: Its unit; empty without one.
    """

    key: str
    unit: str

    def read(self, scene: Scene) -> float:
        """Its value in a scene, in its unit.

        Args:
            scene: The scene.
        """
        return float(value_at(scene, self.key))

    def set(self, scene: Scene, value: float) -> Scene:
        """A scene with another value.

        Args:
            scene: The scene; it stays as it is.
            value: In the parameter's unit.

        Raises:
            SceneError: The scene does not take the value.
        """
        return changed_scene(scene, self.changes(value))

    def changes(self, value: float) -> dict[str, float]:
        """The value by its key.

        Args:
            value: In the parameter's unit.
        """
        return {self.key: float(value)}

    def scale(self, scene: Scene, factor: float) -> Scene:
        """A scene in which the value is multiplied by a factor; see `set`."""
        return self.set(scene, factor * self.read(scene))

    @property
    def sections(self) -> frozenset[str]:
        """The sections of the scene that it changes, such as ``cables``."""
        return frozenset({str(_steps(self.key)[0])})


class JointParameter(NamedTuple):
    """Several numbers of a scene that change together, by one number that is 0 at first.

    Attributes:
        key: Its name.
        unit: Unit of the number.
        numbers: What it changes.
        first: Their values at first, each in its unit.
        shares: By how much each changes by one unit.
    """

    key: str
    unit: str
    numbers: tuple[Parameter, ...]
    first: tuple[float, ...]
    shares: tuple[float, ...]

    def read(self, scene: Scene) -> float:
        """See `Parameter.read`."""
        return (self.numbers[0].read(scene) - self.first[0]) / self.shares[0]

    def changes(self, value: float) -> dict[str, float]:
        """Values of its numbers, by their keys.

        Args:
            value: The number.
        """
        each = zip(self.numbers, self.first, self.shares, strict=True)
        return {one.key: first + share * value for one, first, share in each}

    def set(self, scene: Scene, value: float) -> Scene:
        """See `Parameter.set`."""
        return changed_scene(scene, self.changes(value))

    @property
    def sections(self) -> frozenset[str]:
        """See `Parameter.sections`."""
        return frozenset[str]().union(*(one.sections for one in self.numbers))


def parameters(scene: Scene, *keys: str) -> tuple[Parameter, ...]:
    """Handles of the numbers of a scene, also of those that its file leaves out.

    Args:
        scene: The scene.
        *keys: Keys, perhaps with ``*``; of a list or a section, all numbers in it. All of the scene
            where none is given.

    Raises:
        SceneError: No number has such a key.
    """
    known = {
        dotted(place): Parameter(dotted(place), unit_at(Scene, place))
        for name, _, value in values_below(scene) for place in _numbers(_steps(name), value)
    }  # fmt: skip
    if not keys:
        return tuple(known.values())
    found = dict[str, Parameter]()
    for key in keys:
        steps = _steps(key)
        places = [dotted(place) for place in _places(scene, steps)] if steps else []
        own = [name for place in places for name in known
               if name == place or name.startswith((f"{place}.", f"{place}["))]
        if not own:
            value = "" if "*" in key else value_at(scene, key)
            raise _no_key(scene, key, value, f"is no number of this scene{nearest(key, known)}")
        found |= {name: known[name] for name in own}
    return tuple(found.values())


def value_at(scene: Scene, key: str) -> Any:
    """The value at a key of a scene.

    Args:
        scene: The scene.
        key: The key, such as ``cables[0].rate``.

    Raises:
        SceneError: The scene has no such key.
    """
    value: Any = scene
    for step in _place(scene, key):
        value = _below(value, step)
    return value


def full_key(scene: Scene, key: str) -> str:
    """A key with the places of entries in place of their names, such as ``cables[0].rate``.

    Args:
        scene: The scene.
        key: The key, such as ``cables.north.rate``.

    Raises:
        SceneError: The scene has no such key.
    """
    return dotted(_place(scene, key))


def changed_scene(scene: Scene, changes: Mapping[str, Any]) -> Scene:
    """A scene with other values, checked as if they were in its file.

    Args:
        scene: The scene; it stays as it is.
        changes: Values by their keys; numbers, and whole sections or lists as a file has them.

    Raises:
        SceneError: There is no such key, or the scene does not take the value.
    """
    if not changes:
        return scene
    try:
        made = Scene.model_validate(with_values(scene, scene, changes))
    except ValidationError as error:
        raise scene_error(
            error, Scene, scene.path, as_written=lambda place: as_written(scene.source.mapping, place)
        ) from None
    made._source = scene.source
    return made


def with_values(values: Any, scene: Scene, changes: Mapping[str, Any]) -> Any:
    """The content of a scene, as its file would have it, with other values.

    Args:
        values: The scene, or the content of its file without patterns.
        scene: The scene, by which keys are read.
        changes: Values by their keys; see `changed_scene`.

    Raises:
        SceneError: There is no such key.
    """
    for key, value in changes.items():
        values = _with(values, _place(scene, key), value, scene)
    return values


def _steps(key: str) -> tuple:
    """The names and places of a key; empty where it is no key."""
    return tuple(parts(key)) if _KEY.fullmatch(key) else ()


def _place(scene: Scene, key: str) -> tuple:
    """Where a key is in a scene; its last part may be new."""
    steps = _steps(key)
    found = list(_places(scene, steps)) if steps and "*" not in key else []
    if not found:
        raise _no_key(scene, key, "", "is no key of a scene, such as body.material.young_modulus "
                      "or cables[0].tension")
    return found[0]


def _places(scene: Scene, steps: tuple) -> Iterator[tuple]:
    """The places that a key means: one, or several where it has ``*``."""
    places: list[tuple[tuple, Any]] = [((), scene)]
    for step in steps:
        places = [
            ((*place, own), _below(value, own)) for place, value in places
            for own in _own_steps(scene, place, value, step)
        ]  # fmt: skip
    return (place for place, _ in places)


def _own_steps(scene: Scene, place: tuple, value: Any, step: str | int) -> list:
    """What a part of a key means in a section or a list."""
    if not isinstance(value, tuple):
        names = list(type(value).model_fields) if isinstance(value, Entry) else list(value or ())
        if isinstance(step, int) or "*" not in step:
            return [step]
        return [name for name in names if fnmatchcase(name, step)]
    if isinstance(step, int):
        found = [step] if step < len(value) else []
    else:
        found = [i for i, one in enumerate(value) if fnmatchcase(_name_of(one), step)]
    if not found and not (isinstance(step, str) and "*" in step):
        named = [name for name in map(_name_of, value) if name]
        known = [*named, f"0 to {len(value) - 1}"] if value else ["no entry"]
        raise _no_key(scene, dotted((*place, step)), "", "is not there: the scene has "
                      f"{', '.join(known)}{nearest(step, named)}")
    return found


def _name_of(entry: Any) -> str:
    return str(getattr(entry, "name", "") or "")


def _below(value: Any, step: str | int) -> Any:
    """What is at a step into a value; None where nothing is."""
    if isinstance(value, Mapping):
        return value.get(step)
    if isinstance(value, list | tuple):
        return value[step] if isinstance(step, int) and step < len(value) else None
    return getattr(value, str(step), None)


def _with(value: Any, place: tuple, new: Any, usual: Any) -> Any:
    """A value as a file would have it, with another one at a place; entries beside it stay.

    Where the file leaves out what the place is in, it is as in the scene.
    """
    if not place:
        return new
    first, rest = place[0], place[1:]
    own, usual = _below(value, first), _below(usual, first)
    inside = _with(usual if own is None else own, rest, new, usual)
    if isinstance(value, list | tuple) and isinstance(first, int):
        return [*value[:first], inside, *value[first + 1 :]]
    if isinstance(value, Entry):
        value = {name: getattr(value, name) for name in value.model_fields_set
                 if not (name == "preset" and first in _OF_PRESET)}
    return {**value, first: inside} if isinstance(value, Mapping) else {first: inside}


def _numbers(place: tuple, value: Any) -> Iterator[tuple]:
    """Places of all numbers in a value."""
    if isinstance(value, tuple):
        for index, part in enumerate(value):
            yield from _numbers((*place, index), part)
    elif isinstance(value, Mapping):
        for name, part in value.items():
            yield from _numbers((*place, name), part)
    elif isinstance(value, float):
        yield place


def _no_key(scene: Scene, key: str, value: Any, reason: str) -> SceneError:
    return SceneError(scene.path, key, value, "", reason)
