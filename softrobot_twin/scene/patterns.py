"""Patterns: an entry that is written once and repeated about an axis, along a line, or both.

Any entry of a list may have the key ``repeat``. It is replaced by its copies before the scene is
checked, so that the rest of the package sees entries as if each had been written by hand.
"""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Callable, Iterator, Mapping
from itertools import product
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from pydantic import BaseModel, BeforeValidator, Field, ValidationError

from softrobot_twin.errors import SceneError
from softrobot_twin.geometry.helix import across
from softrobot_twin.scene.entry import (
    Direction,
    Entry,
    Form,
    Vector,
    expanded,
    forms_of,
    not_zero,
    plain,
    refusal,
    unit,
)
from softrobot_twin.scene.refusal_messages import dotted, parts, scene_error, short

MOST_COPIES = 10_000
"""An entry with more copies is refused."""
MOST_VALUES = 1_000_000
"""A scene whose copies have more values than this is refused."""
MARK = re.compile(r"#(\d*)")
"""Stands for the copy's number or name; ``#1``, ``#2`` for that in the first, second pattern."""
_ROOT = 0.5 * math.sqrt(3.0)
_COSINES = (1.0, _ROOT, 0.5, 0.0, -0.5, -_ROOT, -1.0, -_ROOT, -0.5, 0.0, 0.5, _ROOT)
"""Of the multiples of 30°."""
_LETTERS = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}


def _axis(value: Any) -> Any:
    """The vector of an axis that is given by its letter."""
    if isinstance(value, str):
        if value not in _LETTERS:
            raise ValueError("must be x, y, z, or a vector of 3 numbers")
        return _LETTERS[value]
    return value


class Pattern(Entry):
    """Repeats an entry. Copy i, counted from 0, is turned by i angles and then moved by i
    steps."""

    count: Annotated[int | None, Field(ge=1, le=MOST_COPIES)] = None
    """Copies, with the entry itself; by default as many as `names`."""
    about: Annotated[Direction | None, BeforeValidator(_axis), not_zero("an axis must not be zero")] = None
    """Axis of rotation: x, y, z, or a vector."""
    point: Vector = (0.0, 0.0, 0.0)
    """A point of the axis."""
    angle: Annotated[float | None, unit("rad")] = None
    """From copy to copy; by default a full turn over `count`."""
    step: Vector = (0.0, 0.0, 0.0)
    """From copy to copy."""
    names: tuple[str, ...] | None = None
    """What ``#`` stands for; by default the number."""
    first: Annotated[int, Field(ge=0, le=1_000_000)] = 0
    """Number of the first copy."""

    def check(self) -> None:
        """Refuse patterns whose copies are not known by count, name and place."""
        if self.names is None and self.count is None:
            raise refusal("count", "(nothing)", "is required, or names")
        if self.names is not None:
            self._check_names(self.names)
        if self.about is None and any(self.point):
            raise refusal("point", self.point, "is a point of the axis: about is required")
        if self.about is None and self.angle is not None:
            raise refusal("angle", self.angle, "is an angle about an axis: about is required")
        if self.angle == 0.0 and not any(self.step):
            raise refusal("angle", self.angle, "its copies would have the same place")

    def _check_names(self, names: tuple[str, ...]) -> None:
        if self.count not in (None, len(names)) or not names:
            raise refusal("names", names, f"has {len(names)} names for {self.count or 0} copies")
        if len(names) > MOST_COPIES:
            raise refusal("names", names, f"must have at most {MOST_COPIES} names")
        if "first" in self.model_fields_set:
            raise refusal("first", self.first, "is a number, but the copies have names")
        for index, name in enumerate(names):
            if not re.fullmatch(r"[A-Za-z0-9_]+", name):
                raise refusal(f"names[{index}]", name, "must contain only letters, digits and underscores")
            if name in names[:index]:
                raise refusal(f"names[{index}]", name, "is given more than once")

    @property
    def copy_count(self) -> int:
        """Number of copies."""
        return int(self.count or 0) if self.names is None else len(self.names)

    @property
    def words(self) -> tuple[str, ...]:
        """What ``#`` stands for in each copy."""
        if self.names is not None:
            return self.names
        return tuple(str(self.first + number) for number in range(self.copy_count))

    @property
    def moves(self) -> bool:
        """Whether its copies have different places."""
        return self.about is not None or any(self.step)

    def motion(self, number: int) -> Motion:
        """The motion from the entry to a copy.

        Args:
            number: The copy, from 0.
        """
        shift = tuple(number * part for part in self.step)
        if self.about is None or number == 0:
            return Motion(None, (0.0, 0.0, 0.0), 0.0, (0.0, 0.0, 0.0), shift)
        size = math.hypot(*self.about)
        axis = tuple(part / size for part in self.about)
        along = sum(a * p for a, p in zip(axis, self.point, strict=True))
        centre = tuple(p - along * a for a, p in zip(axis, self.point, strict=True))
        return Motion(_rotation(axis, *self._turn(number)), axis, self._angle(number), centre, shift)

    def _angle(self, number: int) -> float:
        if self.angle is None:
            return 2.0 * math.pi * number / self.copy_count
        return self.angle * number

    def _turn(self, number: int) -> tuple[float, float]:
        """Cosine and sine of a copy's angle; 0, ±½ and ±1 exactly for multiples of 30°."""
        angle, twelfths = self._angle(number), None
        if self.angle is None:
            if 12 * number % self.copy_count == 0:
                twelfths = 12 * number // self.copy_count
        else:
            nearest = round(angle / (math.pi / 6.0))
            if abs(angle - nearest * (math.pi / 6.0)) <= 1e-15 * abs(angle):
                twelfths = nearest
        if twelfths is None:
            return math.cos(angle), math.sin(angle)
        return _COSINES[twelfths % 12], _COSINES[(twelfths - 3) % 12]


def _rotation(axis: tuple, cosine: float, sine: float) -> tuple[tuple[float, ...], ...]:
    """Rows of a rotation matrix, a aᵀ + cos (I - a aᵀ) + sin [a]×: in this form an axis of the
    world stays exactly what it is."""
    x, y, z = axis
    crossed = ((0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0))
    return tuple(
        tuple(axis[i] * axis[j] + cosine * (float(i == j) - axis[i] * axis[j])
              + sine * crossed[i][j] for j in range(3))
        for i in range(3))  # fmt: skip


class Motion(NamedTuple):
    """A rotation about an axis, and a translation after it.

    Attributes:
        rows: Rows of the rotation matrix; None for no rotation.
        axis: Unit vector of the axis.
        angle: Angle of the rotation [rad].
        centre: The point of the axis that is nearest to the origin [m].
        shift: Translation [m].
    """

    rows: tuple[tuple[float, ...], ...] | None
    axis: tuple[float, ...]
    angle: float
    centre: tuple[float, ...]
    shift: tuple[float, ...]

    def point(self, place: tuple[float, ...]) -> tuple[float, ...]:
        """A point [m] moved.

        Args:
            place: The point [m], three numbers.
        """
        if self.rows is not None:
            (x, y, z), (a, b, c) = place, self.centre
            x, y, z = self.direction((x - a, y - b, z - c))
            place = (x + a, y + b, z + c)
        if any(self.shift):
            (x, y, z), (a, b, c) = place, self.shift
            place = (x + a, y + b, z + c)
        return place

    def direction(self, vector: tuple[float, ...]) -> tuple[float, ...]:
        """A vector turned.

        Args:
            vector: The vector, three numbers.
        """
        if self.rows is None:
            return vector
        x, y, z = vector
        # Adding 0 makes 0 of -0, as one writes it by hand.
        return tuple([sum((a * x, b * y, c * z)) + 0.0 for a, b, c in self.rows])

    def angles(self, angles: tuple[float, ...]) -> tuple[float, ...]:
        """Angles [rad] about the world's x, y and z axes in this order, of something turned.

        Args:
            angles: The angles [rad], three numbers.
        """
        if self.rows is None:
            return angles
        for place, later in ((2, ()), (1, angles[2:]), (0, angles[1:])):
            # The last rotation is about the same axis: angles about one axis add up exactly.
            if abs(self.axis[place]) == 1.0 and not any(later):
                turned = list(angles)
                turned[place] += self.axis[place] * self.angle
                if abs(turned[place]) > 2.0 * math.pi:
                    turned[place] = math.remainder(turned[place], 2.0 * math.pi)
                return tuple(turned)
        a, b, c = (_rotation(_LETTERS[letter], math.cos(angle), math.sin(angle))
                   for letter, angle in zip("xyz", angles, strict=True))
        return _angles_of(np.array(self.rows) @ np.array(c) @ np.array(b) @ np.array(a))

    @property
    def is_quarter(self) -> bool:
        """Whether axes of the world turn into axes of the world."""
        return self.rows is None or all(part in (-1.0, 0.0, 1.0) for row in self.rows for part in row)


def _angles_of(rotation: np.ndarray) -> tuple[float, ...]:
    """Angles [rad] about x, y and z in this order of a rotation matrix, shape (3, 3)."""
    across_y = math.hypot(rotation[0, 0], rotation[1, 0])
    y = math.atan2(-rotation[2, 0], across_y)
    if across_y < 1e-12:  # x and z turn about the same axis
        return math.atan2(-rotation[1, 2], rotation[1, 1]), y, 0.0
    return (math.atan2(rotation[2, 1], rotation[2, 2]), y, math.atan2(rotation[1, 0], rotation[0, 0]))


# --- copies of one entry --------------------------------------------------------------------------


class _CannotMove(Exception):
    """A value that cannot be turned as a pattern asks, with its key below the entry."""

    def __init__(self, key: str, value: object, reason: str):
        super().__init__(reason)
        self.key, self.value, self.reason = key, value, reason


def _numbers(value: Any) -> tuple[float, ...] | None:
    """A vector of three finite numbers; None for other values, which are refused later."""
    if not isinstance(value, list | tuple) or len(value) != 3:
        return None
    try:
        vector = tuple(float(part) for part in value if not isinstance(part, bool))
    except (TypeError, ValueError, OverflowError):
        return None
    return vector if len(vector) == 3 and all(map(math.isfinite, vector)) else None


def _vectors(value: Any, move: Callable[[tuple], tuple]) -> Any:
    """A vector, or a list of vectors, moved."""
    vector = _numbers(value)
    if vector is not None:
        return list(move(vector))
    if isinstance(value, list | tuple):
        return [_vectors(part, move) if isinstance(part, list | tuple) else part for part in value]
    return value


def _box(value: Any, motion: Motion, key: str) -> Any:
    """A box along the axes, moved."""
    given = [_numbers(value.get(end)) for end in ("minimum", "maximum")] if isinstance(
        value, Mapping) else [None]  # fmt: skip
    corners = [corner for corner in given if corner is not None]
    if len(corners) < len(given):
        return value
    if not motion.is_quarter:
        raise _CannotMove(
            key, value, "a box along the axes cannot be turned by "
            f"{math.degrees(motion.angle):.4g}°: give a sphere, or frame: mesh")  # fmt: skip
    ends = list(zip(*map(motion.point, corners), strict=True))
    return {**value, "minimum": [min(end) for end in ends], "maximum": [max(end) for end in ends]}


def _letters(value: Any, motion: Motion, key: str) -> Any:
    """Directions x, y, z of the world, turned."""
    value = list(value) if isinstance(value, str) else value
    if motion.rows is None or not isinstance(value, list | tuple) or not set(value) <= set("xyz"):
        return value
    turned = {letter: [other for other, row in zip("xyz", motion.rows, strict=True)
                       if abs(row["xyz".index(letter)]) > 1e-12] for letter in value}  # fmt: skip
    reached = set().union(*turned.values())
    if len(reached) != len(value):
        raise _CannotMove(
            key, value, f"cannot be turned by {math.degrees(motion.angle):.4g}°: "
            f"{', '.join(value)} are then no axes of the world")  # fmt: skip
    if reached == set(value):
        return value
    return [letter for one in value for letter in turned[one]] if motion.is_quarter else [
        letter for letter in "xyz" if letter in reached]  # fmt: skip


def _helix(value: Any, motion: Motion, model: type[Entry]) -> Any:
    """A helix moved; its phase is counted from a direction that depends on that of its axis."""
    if not isinstance(value, Mapping):
        return value
    fields = model.model_fields
    point, along = (value.get(key, fields[key].default) for key in ("point", "direction"))
    moved = {**value, "point": _vectors(point, motion.point), "direction": _vectors(along, motion.direction)}
    before, after = _numbers(along), _numbers(moved["direction"])
    phase = value.get("phase", 0.0)
    if motion.rows is None or not before or not any(before) or isinstance(phase, str | bool):
        return moved
    assert after is not None, "a direction stays one when it is turned"
    axis = np.array(after) / math.hypot(*after)
    start, counted = across(np.array(before) / math.hypot(*before)), across(axis)
    begins = np.array(motion.direction(tuple(start)))
    moved["phase"] = phase + math.atan2(float(axis @ np.cross(counted, begins)), float(counted @ begins))
    return moved


def _moved(
    model: type[Entry], entry: dict, motion: Motion, above: str = "", is_in_mesh: bool = False
) -> dict:
    """An entry with everything that has a place in the world moved.

    Args:
        model: Its type, which says how each key is moved.
        entry: The values of its keys.
        motion: The motion.
        above: Key of the entry, for errors.
        is_in_mesh: Whether it moves with the mesh of its body; axes of the world do not.

    Raises:
        _CannotMove: A value cannot be moved in this way.
    """
    moved = dict(entry)
    for key, kind in (model.placed or {}).items():
        field = model.model_fields[key]
        value = entry.get(key, None if field.is_required() else field.default)
        if value is None or is_in_mesh and kind != "letters":
            continue
        if kind in ("point", "direction", "angles"):
            moved[key] = _vectors(value, getattr(motion, kind))
        elif kind == "box":
            moved[key] = _box(value, motion, above + key)
        elif kind == "letters":
            moved[key] = _letters(value, motion, above + key)
        elif kind == "helix":
            moved[key] = _helix(value, motion, _model_of(forms_of(model)[key]))
        elif kind in ("inside", "regions") and key in entry:
            moved[key] = _moved_inside(_model_of(forms_of(model)[key]), value, motion, above + key)
    return moved


def _moved_inside(model: type[Entry], value: Any, motion: Motion, key: str) -> Any:
    """An entry inside another one, or a list of them, moved."""
    if isinstance(value, list | tuple):
        return _like(value, [_moved_inside(model, one, motion, f"{key}[{index}]")
                             for index, one in enumerate(value)])  # fmt: skip
    value = expanded(model, value)
    if not isinstance(value, Mapping):
        return value
    frame = model.model_fields.get("frame")
    is_in_mesh = frame is not None and value.get("frame", frame.default) == "mesh"
    return _moved(model, dict(value), motion, f"{key}.", is_in_mesh)


def _model_of(form: Form) -> type[Entry]:
    """The type of an entry, of the entries of a list, or of both ends of a pair."""
    return form.entries or form.section or plain(form.kind.__args__[0])


def _named(value: Any, words: tuple[str, ...], key: str = "") -> Any:
    """A value with the copy's words in place of each mark."""
    if isinstance(value, Mapping):
        return {name: _named(one, words, f"{key}.{name}") for name, one in value.items()}
    if isinstance(value, list | tuple):
        return _like(value, [_named(one, words, f"{key}[{index}]") for index, one in enumerate(value)])
    if not isinstance(value, str) or "#" not in value:
        return value

    def word(mark: re.Match) -> str:
        if not mark[1]:
            return "_".join(words)
        if not 1 <= int(mark[1]) <= len(words):
            raise _CannotMove(key[1:], value, f"{mark[0]} stands for the copy in pattern {mark[1]}, "
                              f"but the entry has {len(words)}")  # fmt: skip
        return words[int(mark[1]) - 1]

    return MARK.sub(word, value)


def _values_in(value: Any) -> Iterator[Any]:
    """A value, and all values inside of its sections and lists."""
    yield value
    if isinstance(value, Mapping | list | tuple):
        for inner in value.values() if isinstance(value, Mapping) else value:
            yield from _values_in(inner)


def _has_mark(value: Any) -> bool:
    return any(isinstance(one, str) and "#" in one for one in _values_in(value))


def _copy(model: type[Entry], entry: dict, marked: list[str], words: tuple[str, ...], number: int,
          motions: list[Motion]) -> dict:  # fmt: skip
    """One copy of an entry, with its own name and place; `marked` are its keys with a mark."""
    copy = dict(entry)
    if "name" in model.model_fields:
        field = model.model_fields["name"]
        name = copy.get("name", "" if field.is_required() else field.default)
        if name == "" and "name" not in copy:
            if not all(word.isdigit() for word in words):
                copy["name"] = "_".join(words)
        elif isinstance(name, str) and "#" not in name:
            copy["name"] = f"{name}_{'_'.join(words)}"
    for key in marked:
        copy[key] = _named(copy[key], words, f".{key}")
    for key, kind in (model.placed or {}).items():
        if kind == "numbers" and key in copy:
            copy[key] = _counted(copy[key], number)
    for motion in motions:
        if motion.rows is not None or any(motion.shift):
            copy = _moved(model, copy, motion)
    return copy


def _counted(value: Any, number: int) -> Any:
    """Numbers that count up with the copies."""
    if isinstance(value, list | tuple):
        return [_counted(one, number) for one in value]
    return value + number if type(value) is int else value


# --- all entries of a scene -----------------------------------------------------------------------


class Origin(NamedTuple):
    """Where an entry of an expanded list was written.

    Attributes:
        index: Its place in the list as written.
        number: The copy, from 1; 0 for an entry that is not repeated.
        count: Number of copies.
    """

    index: int  # type: ignore[assignment]  # names of a tuple's methods, which nobody calls
    number: int = 0
    count: int = 0  # type: ignore[assignment]


class Expanded(list):
    """A list of entries in which some were repeated.

    Attributes:
        origins: Where each entry was written.
    """

    def __init__(self, entries: list, origins: list[Origin]):
        super().__init__(entries)
        self.origins = origins


def _like(original: Any, items: list) -> list:
    return Expanded(items, original.origins) if isinstance(original, Expanded) else items


def expand_patterns(mapping: Any, root: type[BaseModel], path: Path | None = None) -> Any:
    """A scene with copies in place of each entry that has the key ``repeat``.

    Args:
        mapping: The content of a scene file.
        root: The type of the scene.
        path: Scene file, for errors.

    Returns:
        The scene; the same object when nothing is repeated. The lists with copies are `Expanded`.

    Raises:
        SceneError: A pattern is not valid, or an entry cannot be repeated in this way.
    """
    has_pattern = any(isinstance(one, Mapping) and "repeat" in one for one in _values_in(mapping))
    return _Expansion(path).section(root, mapping, ()) if has_pattern else mapping


class _Expansion:
    """Expands the patterns of one scene."""

    def __init__(self, path: Path | None):
        self._path, self._made = path, 0

    def section(self, model: type[BaseModel], section: Any, place: tuple) -> Any:
        """A section with the lists inside it expanded."""
        section = expanded(model, section)
        if not isinstance(section, Mapping):
            return section
        made = {}
        forms = forms_of(model)
        for key, value in section.items():
            form = forms.get(key)
            if form is None:
                pass
            elif form.entries is not None and isinstance(value, list | tuple):
                value = self._list(form.entries, list(value), (*place, key))
            elif form.section is not None:
                value = self.section(form.section, value, (*place, key))
            made[key] = value
        return made

    def _list(self, item: type[Entry], entries: list, place: tuple) -> list:
        made, origins = [], []
        for index, entry in enumerate(entries):
            entry = self.section(item, entry, (*place, index))
            if isinstance(entry, dict) and "repeat" in entry and item.placed is not None:
                copies = list(self._copies(item, entry, (*place, index)))
                made += copies
                origins += [Origin(index, number, len(copies)) for number in range(1, len(copies) + 1)]
            else:
                made.append(entry)
                origins.append(Origin(index))
        return Expanded(made, origins) if len(made) > len(entries) else made

    def _copies(self, model: type[Entry], entry: dict, place: tuple) -> Iterator[dict]:
        patterns = self._patterns(entry.pop("repeat"), (*place, "repeat"))
        count = math.prod(pattern.copy_count for pattern in patterns)
        self._check_count(count, entry, place)
        alike = [pattern.copy_count for pattern in patterns if not pattern.moves or not model.placed]
        named = {key: value for key, value in entry.items() if key not in ("name", "id")}
        if math.prod(alike) > 1 and not _has_mark(named):
            needed = "about or step, or # in a name inside it" if model.placed else "# in its names"
            raise self._refused((*place, "repeat"), f"{count} copies", f"they would be alike: give {needed}")
        # The first pattern runs fastest: each further one repeats what those before it made.
        ranges = [range(pattern.copy_count) for pattern in reversed(patterns)]
        marked = [key for key, value in entry.items() if _has_mark(value)]
        words_of = [pattern.words for pattern in patterns]
        motions_of = [[pattern.motion(one) for one in range(pattern.copy_count)] for pattern in patterns]
        for number, chosen in enumerate(product(*ranges)):
            turns = chosen[::-1]
            words = tuple(words[one] for words, one in zip(words_of, turns, strict=True))
            motions = [moved[one] for moved, one in zip(motions_of, turns, strict=True)]
            try:
                yield _copy(model, entry, marked, words, number, motions)
            except _CannotMove as error:
                reason = f"{error.reason} (copy {number + 1} of {count})"
                raise self._refused((*place, error.key), error.value, reason) from None

    def _patterns(self, given: Any, place: tuple) -> list[Pattern]:
        several = list(given) if isinstance(given, list | tuple) else [given]
        patterns = []
        for index, one in enumerate(several):
            if isinstance(one, int) and not isinstance(one, bool):
                one = {"count": one}
            here = (*place, index) if isinstance(given, list | tuple) else place
            try:
                patterns.append(Pattern.model_validate(one))
            except ValidationError as error:
                raise scene_error(error, Pattern, self._path, here) from None
        if not patterns:
            raise self._refused(place, [], "must have at least one pattern")
        return patterns

    def _check_count(self, count: int, entry: dict, place: tuple) -> None:
        if count > MOST_COPIES:
            raise self._refused((*place, "repeat"), f"{count} copies",
                                f"an entry has at most {MOST_COPIES} copies")
        self._made += count * sum(1 for _ in _values_in(entry))
        if self._made > MOST_VALUES:
            raise self._refused((*place, "repeat"), f"{count} copies",
                                f"the copies of the scene have more than {MOST_VALUES} values")

    def _refused(self, place: tuple, value: object, reason: str) -> SceneError:
        return SceneError(self._path, dotted(place), short(value), "", reason)


@dataclasses.dataclass(frozen=True)
class Source:
    """What a scene was read from. All sources count as equal, so that scenes are compared by their
    entries.

    Attributes:
        mapping: The expanded scene, or None for a scene that was not read.
        written: The scene with its patterns.
    """

    mapping: Any = dataclasses.field(default=None, compare=False, repr=False)
    written: Any = dataclasses.field(default=None, compare=False, repr=False)

    def error(self, error: SceneError) -> SceneError:
        """An error of the expanded scene with the key that the scene file has.

        Args:
            error: The error.
        """
        key, copy = self._key(error.key)
        if key == error.key and copy is None:
            return error
        reason = error.reason + _copy_words(copy)
        return SceneError(error.path, key, error.value, error.unit, reason)

    def notes(self, notes: list[str]) -> list[str]:
        """Notes on the expanded scene with the keys that the scene file has; what is true of all
        copies of an entry is said once.

        Args:
            notes: The notes.
        """
        made: dict[str, list[Origin | None]] = {}
        for note in notes:
            copies: list[Origin | None] = []

            def written(found: re.Match, copies: list = copies) -> str:
                key, copy = self._key(found[0])
                copies += [] if copy is None else [copy]
                return key

            made.setdefault(_KEY.sub(written, note), []).append(copies[0] if copies else None)
        return [text + _copy_words(copy) for text, copies in made.items()
                for copy in (copies if _is_some(copies) else [None])]  # fmt: skip

    def _key(self, key: str) -> tuple[str, Origin | None]:
        if "[" not in key or not _KEY.fullmatch(key):
            return key, None
        written, copy = as_written(self.mapping, tuple(parts(key)))
        return dotted(written), copy


_KEY = re.compile(r"[a-z_]+(?:\[\d+\])?(?:\.[a-z_]+(?:\[\d+\])?)*")


def _is_some(copies: list[Origin | None]) -> bool:
    """Whether a note is about some copies only."""
    return copies[0] is not None and len(copies) < copies[0].count


def _copy_words(copy: Origin | None) -> str:
    return "" if copy is None else f" (copy {copy.number} of {copy.count})"


def as_written(mapping: Any, location: tuple) -> tuple[tuple, Origin | None]:
    """Where the scene file has what is at a location of the expanded scene.

    Args:
        mapping: The scene that `expand_patterns` returned.
        location: Keys and places in lists.

    Returns:
        The location in the file, and the innermost copy that it is in; None where it is in none.
    """
    written, copy, node = [], None, mapping
    for part in location:
        origins = node.origins if isinstance(node, Expanded) else ()
        if isinstance(part, int) and part < len(origins):
            written.append(origins[part].index)
            copy = origins[part] if origins[part].number else copy
        else:
            written.append(part)
        try:
            node = node[part]
        except (KeyError, IndexError, TypeError):
            node = None
    return tuple(written), copy
