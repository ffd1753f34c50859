"""Numbers of a scene by their keys: read, set and scaled, in a scene that is checked again.

A key is the path of a value, such as ``body.material.young_modulus`` or ``cables[0].points[2][1]``.
An entry of a list has its place or its name: ``cables[0].rate`` is ``cables.north.rate``. A ``*``
stands for any number of letters, so ``cables.*.rate`` is the rate of each cable.

Numbers can be tied to one another (`tied`): ``beams[0].points[0][0]#`` moves all copies of a repeated
entry as its pattern turns them, and ``+-servo_1.offset+servo_2.offset`` two numbers oppositely.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from fnmatch import fnmatchcase
from typing import Any, NamedTuple

from pydantic import ValidationError

from softrobot_twin.errors import SceneError
from softrobot_twin.scene.entry import Entry, values_below
from softrobot_twin.scene.patterns import as_written, expand_patterns
from softrobot_twin.scene.refusal_messages import (dotted, nearest, parts, scene_error, unit_at)
from softrobot_twin.scene.schema import Scene

_KEY = re.compile(r"[^.\[\]]+(?:\[\d+\])*(?:\.[^.\[\]]+(?:\[\d+\])*)*")
_TIED = re.compile(r"([+-]*)(.+)")
COPIES = "#"
"""At the end of a key: with all copies of the repeated entry."""
BY_SHARE = frozenset({"Pa", "kg/m³", "N", "N/m", "N m/rad"})
"""Units of numbers above zero by their nature: tied ones keep their ratios."""
_SHIFT, _LEAST_SHARE = 1.0e-3, 1.0e-9
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
    """Several numbers of a scene that change together, by one number.

    Attributes:
        key: Its name.
        unit: Unit of the number.
        numbers: What it changes.
        first: Their values where the number is 0, each in its unit.
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


def joint_changes(
    scene: Scene, numbers: Sequence[Parameter | JointParameter], values: Iterable[float]
) -> dict[str, float]:
    """What numbers set in a scene together, by its keys: where two move one number, their moves add.

    Args:
        scene: Has the numbers before.
        numbers: The handles.
        values: Value of each, in its unit.
    """
    found = dict[str, float]()
    for one, value in zip(numbers, values, strict=True):
        for key, number in one.changes(float(value)).items():
            found[key] = found[key] + number - float(value_at(scene, key)) if key in found else number
    return found


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
    for key in map(str, keys):
        steps = _steps(key)
        places = [dotted(place) for place in _places(scene, steps)] if steps else []
        own = [name for place in places for name in known
               if name == place or name.startswith((f"{place}.", f"{place}["))]
        if not own:
            value = "" if "*" in key else value_at(scene, key)
            raise _no_key(scene, key, value, f"is no number of this scene{nearest(key, known)}")
        found |= {name: known[name] for name in own}
    return tuple(found.values())


def tied(scene: Scene, key: str) -> tuple[Parameter | JointParameter, ...]:
    """Handles of numbers, of which a key may tie several to one.

    Args:
        scene: The scene.
        key: As in `parameters`; with ``#`` at its end each number moves with those of the other copies
            of its repeated entry. Keys that are joined by ``+`` are one number; signs before them, such
            as ``+-``, say in which direction each moves, and begin again after the last.

    Raises:
        SceneError: No number has such a key.
    """
    match = _TIED.fullmatch(key)
    signs, own = match.groups() if match else ("", key)
    if not signs and "+" not in own:
        return _with_copies(scene, own.removesuffix(COPIES)) if own.endswith(COPIES) else parameters(scene, own)
    joined = [one for part in own.split("+") for one in tied(scene, part)]
    numbers, shares = list[Parameter](), list[float]()
    for place, one in enumerate(joined):
        sign = -1.0 if signs and signs[place % len(signs)] == "-" else 1.0
        numbers += [one] if isinstance(one, Parameter) else one.numbers
        shares += [sign] if isinstance(one, Parameter) else [sign * share for share in one.shares]
    return (_joint(scene, key, numbers, shares),)


def _joint(scene: Scene, key: str, numbers: list[Parameter], shares: list[float]) -> JointParameter:
    """Numbers that move together: by their shares, or in proportion to what they are."""
    first = tuple(one.read(scene) for one in numbers)
    if numbers[0].unit in BY_SHARE and first[0] > 0.0 and min(shares) > 0.0:
        return JointParameter(key, numbers[0].unit, tuple(numbers), (0.0,) * len(first),
                              tuple(value / first[0] for value in first))  # fmt: skip
    return JointParameter(key, numbers[0].unit, tuple(numbers), first, tuple(shares))


def _with_copies(scene: Scene, key: str) -> tuple[JointParameter, ...]:
    """The numbers of a key, each with those of the other copies of its entry."""
    written = {one: as_written(scene.source.mapping, _steps(one.key))[0] for one in parameters(scene)}
    found = dict[tuple, JointParameter]()
    for place in dict.fromkeys(written[one] for one in parameters(scene, key)):
        first = next(one for one, own in written.items() if own == place)
        others = [one for one, own in written.items() if own[: len(place) - 1] == place[:-1]]
        ends = [_expanded(scene, first, place, shift) for shift in (0.0, _SHIFT)]
        shares = {one: (_moved(ends[1], one) - _moved(ends[0], one)) / _SHIFT for one in others}
        own = {one: round(share, 9) for one, share in shares.items() if abs(share) > _LEAST_SHARE}
        joint, value = _joint(scene, f"{first.key}{COPIES}", list(own), list(own.values())), first.read(scene)
        # The number is that of the first copy.
        found[place] = joint if not any(joint.first) else joint._replace(first=tuple(
            begin - share * value for begin, share in zip(joint.first, joint.shares, strict=True)))  # fmt: skip
    return tuple(found.values())


def _expanded(scene: Scene, first: Parameter, written: tuple, shift: float) -> Any:
    """The copies of a scene's entries where a number of its file is shifted."""
    place, value = _steps(first.key), first.read(scene) + shift
    if not isinstance(place[-1], int):
        return expand_patterns(_with(scene.source.written, written, value, None), Scene)
    numbers = list(value_at(scene, dotted(place[:-1])))  # The file may leave out the vector.
    numbers[place[-1]] = value
    return expand_patterns(_with(scene.source.written, written[:-1], numbers, None), Scene)


def _moved(expanded: Any, one: Parameter) -> float:
    """A number of the copies; 0 where these leave it out."""
    for step in _steps(one.key):
        expanded = _below(expanded, step)
    return float(expanded or 0.0) if isinstance(expanded, int | float) else 0.0


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


def full_keys(scene: Scene, key: str) -> list[str]:
    """Keys with the places of entries in place of their names, such as ``cables[0].rate``.

    Args:
        scene: The scene.
        key: The key, such as ``cables.north.rate``; of several numbers with ``*``.

    Raises:
        SceneError: The scene has no such key.
    """
    return [dotted(place) for place in _all_places(scene, key)]


def changed_scene(scene: Scene, changes: Mapping[str, Any]) -> Scene:
    """A scene with other values, checked as if they were in its file.

    Args:
        scene: The scene; it stays as it is.
        changes: Values by their keys; numbers, and whole sections or lists as a file has them.

    Raises:
        SceneError: There is no such key, or the scene does not take the value.
    """
    if not isinstance(changes, Mapping):
        raise SceneError(scene.path, "changes", changes, "", "must be values by keys, as a mapping")
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
        for place in _all_places(scene, key, value):
            values = _with(values, place, value, scene)
    return values


def _steps(key: str) -> tuple:
    """The names and places of a key; empty where it is no key."""
    return tuple(parts(key)) if _KEY.fullmatch(key) else ()


def _place(scene: Scene, key: str, value: Any = "") -> tuple:
    """Where a key is in a scene; its last part may be new."""
    steps = _steps(key)
    found = list(_places(scene, steps, value)) if steps and "*" not in key else []
    if not found:
        raise _no_key(scene, key, value, "is no key of a scene, such as body.material.young_modulus "
                      "or cables[0].tension")
    return found[0]


def _all_places(scene: Scene, key: str, value: Any = "") -> list[tuple]:
    """Where a key is in a scene, or where its ``*`` means several entries."""
    steps = _steps(key) if "*" in key else ()
    return (list(_places(scene, steps, value)) if steps else []) or [_place(scene, key, value)]


def _places(scene: Scene, steps: tuple, given: Any = "") -> Iterator[tuple]:
    """The places that a key means: one, or several where it has ``*``; and what they shall be, for errors."""
    places: list[tuple[tuple, Any]] = [((), scene)]
    for k in range(len(steps)):
        places = [
            ((*place, own), _below(value, own)) for place, value in places
            for own in _own_steps(scene, place, value, steps[k:], given, any("*" in str(one) for one in steps[:k]))
        ]  # fmt: skip
    return (place for place, _ in places)


def _own_steps(scene: Scene, place: tuple, value: Any, steps: tuple, given: Any, is_pattern: bool) -> list:
    """What the next part of a key means in a section or a list; nothing where a name fits none of a pattern."""
    step = steps[0]
    if not isinstance(value, tuple):
        names = getattr(type(value), "model_fields", value if isinstance(value, Mapping) else ())
        if isinstance(step, int) or "*" not in step:
            return [step]
        return [name for name in names if fnmatchcase(name, step)]
    if isinstance(step, int):
        found = [step] if step < len(value) else []
    else:
        found = [i for i, one in enumerate(value) if fnmatchcase(_name_of(one), step)]
    if not found and not (isinstance(step, str) and (is_pattern or "*" in step)):
        named = [name for name in map(_name_of, value) if name]
        known = [*named, f"0 to {len(value) - 1}"] if value else ["no entry"]
        raise _no_key(scene, dotted((*place, *steps)), given, "is not there: the scene has "
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
