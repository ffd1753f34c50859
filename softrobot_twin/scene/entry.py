"""What all entries of a scene share: checks of values, units, and short forms.

A user may write a file name in place of a section with the key ``file``, one entry in place of a
list with one entry, ``xz`` in place of ``[x, z]``, and one word for some sections. These short forms are expanded before the
entry is checked. A form that could mean two things is not accepted.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import cache
from pathlib import Path
from types import UnionType
from typing import (
    Annotated,
    Any,
    ClassVar,
    Literal,
    NamedTuple,
    Self,
    Union,
    get_args,
    get_origin,
)

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, model_validator
from pydantic_core import PydanticCustomError

from softrobot_twin.scene.words import in_words, words

LARGEST, SMALLEST = 1.0e30, 1.0e-30
"""Smaller or larger magnitudes are refused, because their products underflow or overflow."""

_TOLD = re.compile(r"\{(\w+):?([^}]*)\}")


class Entry(BaseModel):
    """Base of all entries: frozen, without unknown keys, NaN or infinity."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    one_of: ClassVar[tuple[str, ...]] = ()
    """Keys of which exactly one is given."""
    one_of_words: ClassVar[str] = "has exactly one of {}"
    """What is said where another number of them is."""
    by_word: ClassVar[str] = ""
    """Key whose value may stand in place of the whole section; empty for none."""
    placed: ClassVar[Mapping[str, str] | None] = None
    """How a copy of an entry in a pattern differs from it, for each key that has a place: it is a
    ``point`` or several, a ``direction``, ``angles``, a ``box``, ``letters`` of directions, a
    ``helix``, entries ``inside`` it, ``regions`` that may be in a mesh's frame, or ``numbers`` that
    count up. None: entries of this type are not repeated."""

    told: ClassVar[tuple[str, ...]] = ()
    """What `describe` tells of an entry: parts with the names of keys and how their values are
    written, see `words.in_words`, such as ``{size:mm} mm``. A part with a key that is not given, or
    has its usual value, is left out, unless its form begins with ``=``."""

    @model_validator(mode="before")
    @classmethod
    def _expand(cls, entry: Any) -> Any:
        return expanded(cls, entry)

    @model_validator(mode="after")
    def _checked(self):
        for name in type(self).model_fields:
            value = getattr(self, name)
            for number in _numbers(value):
                if LARGEST < abs(number) < math.inf:
                    raise refusal(name, value, f"must not be greater than {LARGEST:g}")
                if number == value and 0.0 < abs(number) < SMALLEST:
                    raise refusal(name, value, f"must be 0 or at least {SMALLEST:g} in magnitude")
        if self.one_of and len(self.given(self.one_of)) != 1:
            raise ValueError(self.one_of_words.format(", ".join(self.one_of)))
        self.check()
        return self

    def check(self) -> None:
        """Refuses values that do not fit each other; entries that have such values define it.

        Raises:
            ValueError: It says what is required; so does an error of `refusal`.
        """

    def describe(self) -> str:
        """What it says, in words with units, as `explain` prints it."""
        return words(*map(self.phrase, self.told))

    def phrase(self, text: str) -> str:
        """A part of its description; empty where nothing is to be told, see `told`."""
        values = []
        for name, form in _TOLD.findall(text):
            value, field = getattr(self, name), type(self).model_fields.get(name)
            is_usual = field is not None and value == field.default and form[:1] not in ("=", "#")
            if value is None or is_usual or (value == () and form[:1] != "#"):
                return ""
            values.append(in_words(value, form.removeprefix("=")))
        return _TOLD.sub("{}", text).format(*values)

    def given(self, keys: Iterable[str]) -> list[str]:
        """Those of some keys that have a value.

        Args:
            keys: Names of keys.
        """
        return [key for key in keys if getattr(self, key) is not None]

    def changed(self, **values: Any) -> Self:
        """A copy with other values of some keys, which are not checked.

        A dict has values of keys of the entry inside, or of each of a list of them; a function makes
        them of it. An entry that is not there stays so.

        Args:
            **values: New value of each key, a dict for a key that is an entry, or a function of the
                old value.
        """
        return self.model_copy(update={
            key: _inside(getattr(self, key), value) for key, value in values.items()
        })  # fmt: skip


def _inside(entry: Any, value: Any) -> Any:
    """What becomes of an entry, or of a list of them; see `Entry.changed`."""
    change = (lambda one: one.changed(**value)) if isinstance(value, dict) else value
    if entry is None or not callable(change):
        return None if callable(change) else change
    return tuple(map(change, entry)) if isinstance(entry, tuple) else change(entry)


def values_below(entry: Entry, key: str = "") -> Iterator[tuple[str, str, Any]]:
    """All values of an entry and of the entries inside it, except entries themselves.

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
    """All numbers of a value, also in lists of points; without those of other entries."""
    if isinstance(value, float):
        return [value]
    if isinstance(value, tuple):
        return [number for part in value for number in _numbers(part)]
    return []


def refusal(key: str, value: object, reason: str, also: str = "", unit: str = "") -> PydanticCustomError:
    """An error about one key, for checks that compare several entries.

    Args:
        key: Dotted path below the entry that is checked, such as ``cables[0].body``.
        value: The value of this key.
        reason: What is required.
        also: Another key that the reason ends with.
        unit: Unit of the value where the entry does not state it.
    """
    # The reason may contain braces, which a template would replace.
    return PydanticCustomError("refusal", "{reason}", {"key": key, "value": value,
                                                       "reason": reason, "also": also,
                                                       "unit": unit})  # fmt: skip


def unit(name: str, **limits) -> object:
    """A field with a unit, which the message about a refused value contains.

    Args:
        name: The unit, such as ``m``; empty for a number.
        **limits: Limits, as of pydantic's `Field`.
    """
    return Field(json_schema_extra={"unit": name}, **limits)


def check_name(name: str) -> str:
    """Checks a name, because it becomes part of a ROS topic.

    Args:
        name: The name.
    """
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name):
        raise ValueError("a name must start with a letter and contain only letters, digits and "
                         "underscores")
    return name


Name = Annotated[str, AfterValidator(check_name)]


class NamedEntry(Entry):
    """Base of the entries that have a name."""

    name: Name
    """Its name."""


FRAMED = "rigid_bodies", "beams"
"""Sections of the bodies that have frames."""


class OnBody(NamedEntry):
    """Base of the entries that are on a body: the only deformable one where they do not say which."""

    carriers: ClassVar[tuple[str, ...]] = FRAMED
    """Sections, beside that of deformable bodies, of the bodies that it may be on."""

    body: Name | None = None
    """Its body."""


def registered(kind: str, names: Callable[[], tuple[str, ...]]) -> AfterValidator:
    """A check that a name is registered.

    Args:
        kind: Kind of the named object, for the message.
        names: Returns all registered names.
    """

    def check(name: str) -> str:
        if name not in names():
            raise PydanticCustomError("literal_error", f"is not a known {kind}", {"words": names()})
        return name

    return AfterValidator(check)


Vector = Annotated[tuple[float, float, float], unit("m")]
Angles = Annotated[tuple[float, float, float], unit("rad")]
Direction = Annotated[tuple[float, float, float], unit("")]
Acceleration = Annotated[tuple[float, float, float], unit("m/s²")]
Range = tuple[float, float]
OpenNumber = Annotated[float, Field(allow_inf_nan=True)]
"""A number that may be infinite; `check_range` refuses NaN."""


def check_range(bounds: Range) -> Range:
    """Checks that limits are in order; they are not swapped, which would hide a mistake.

    Args:
        bounds: The lower and the upper limit.
    """
    if any(math.isnan(bound) for bound in bounds):
        raise ValueError("a limit must be a number; .inf for no limit")
    if bounds[0] > bounds[1]:
        raise ValueError("the lower limit is above the upper one")
    if bounds[0] == math.inf or bounds[1] == -math.inf:
        raise ValueError("no value lies within these limits")
    return bounds


def allows_zero(what: str, limits: str = "its limits") -> AfterValidator:
    """Refuses limits that 0, which is what a quantity is at rest, does not lie within.

    Args:
        what: What the quantity is at rest, for the error.
        limits: What the limits are called in the error.
    """
    return _required(lambda bounds: bounds[0] <= 0.0 <= bounds[1], f"{what}, 0, must lie within {limits}")


def not_below_zero(words: str) -> AfterValidator:
    """Refuses limits of which the lower one is negative, with these words.

    Args:
        words: Text of the error.
    """
    return _required(lambda bounds: bounds[0] >= 0.0, words)


def not_zero(words: str) -> AfterValidator:
    """Refuses a vector that is zero, with these words.

    Args:
        words: Text of the error.
    """
    return _required(lambda vector: vector is None or any(vector), words)


def _required(fits: Callable[[Any], bool], words: str) -> AfterValidator:
    """Refuses values that do not fit, with these words."""

    def check(value: Any) -> Any:
        if not fits(value):
            raise refusal("", value, words)
        return value

    return AfterValidator(check)


def _ends(low: float, high: float) -> BeforeValidator:
    """Replaces null by these limits."""

    def fill(bounds: Any) -> Any:
        if isinstance(bounds, list | tuple) and len(bounds) == 2:
            ends = zip(bounds, (low, high), strict=True)
            return [end if given is None else given for given, end in ends]
        return (low, high) if bounds is None else bounds

    return BeforeValidator(fill)


ClosedRange = Annotated[Range, AfterValidator(check_range)]
"""Limits, both finite."""
_Open = tuple[OpenNumber, OpenNumber]
OpenRange = Annotated[_Open, _ends(-math.inf, math.inf), AfterValidator(check_range)]
"""Limits, each of which may be infinite."""
OpenPull = Annotated[_Open, _ends(0.0, math.inf), AfterValidator(check_range)]
"""Limits of an effort that cannot be negative; the upper one may be infinite."""


# --- short forms ----------------------------------------------------------------------------------


def expanded(model: type[BaseModel], entry: Any) -> Any:
    """An entry with its short forms expanded.

    Args:
        model: The type of the entry.
        entry: The value in the scene file.

    Returns:
        The entry; values without a short form are unchanged.
    """
    if isinstance(entry, str | Path) and "file" in model.model_fields:
        return {"file": entry}
    if isinstance(entry, str) and issubclass(model, Entry) and model.by_word:
        return {model.by_word: entry}
    if not isinstance(entry, Mapping):
        return entry
    forms = forms_of(model)
    return {key: _value(forms[key], value) if key in forms else value
            for key, value in entry.items()}  # fmt: skip


class Form(NamedTuple):
    """What the value of a key may look like in a scene file.

    Attributes:
        kind: Its type, without limits, unit, and the alternative None.
        item: The type of the items of a list of any length; None where it is no such list.
        may_be_none: Whether None is allowed.
        numbers: Where numbers are in the value, or in an item of the list: True for a number, a
            list with a place for each part of a fixed number of values, None without numbers.
    """

    kind: Any
    item: Any
    may_be_none: bool
    numbers: Any

    @property
    def section(self) -> Any:
        """The type of the entry that the value is; None for other values."""
        return self.kind if is_entry(self.kind) else None

    @property
    def entries(self) -> Any:
        """The type of the entries of a list; None for other values."""
        return self.item if is_entry(self.item) else None


@cache
def forms_of(model: type[BaseModel]) -> dict[str, Form]:
    """The form of each key of an entry.

    Args:
        model: The type of the entry.
    """
    forms = {}
    for key, field in model.model_fields.items():
        kind, item = plain(field.annotation), item_of_list(field.annotation)
        numbers = _places_of_numbers(kind if item is None else item)
        forms[key] = Form(kind, item, may_be_none(field.annotation), numbers)
    return forms


def _places_of_numbers(kind: Any) -> Any:
    if kind in (float, int):
        return True
    if get_origin(kind) is not tuple or Ellipsis in get_args(kind):
        return None
    places = [_places_of_numbers(plain(part)) for part in get_args(kind)]
    return places if any(places) else None


def plain(annotation: Any) -> Any:
    """The type of an annotation, without limits, unit, and the alternative None.

    Args:
        annotation: The annotation of a field.
    """
    while True:
        origin = get_origin(annotation)
        if origin is Annotated:
            annotation = get_args(annotation)[0]
        elif origin in (Union, UnionType):
            annotation = next(a for a in get_args(annotation) if a is not type(None))
        else:
            return annotation


def may_be_none(annotation: Any) -> bool:
    """Whether None is allowed.

    Args:
        annotation: The annotation of a field.
    """
    return get_origin(annotation) in (Union, UnionType) and type(None) in get_args(annotation)


def item_of_list(annotation: Any) -> Any:
    """The type of the items of a list of any length; None for other annotations.

    Args:
        annotation: The annotation of a field.
    """
    arguments = get_args(plain(annotation))
    is_list = get_origin(plain(annotation)) is tuple and len(arguments) == 2
    return plain(arguments[0]) if is_list and arguments[1] is Ellipsis else None


def is_entry(annotation: Any) -> bool:
    """Whether an annotation is an entry, a section of keys.

    Args:
        annotation: The plain type of a field.
    """
    return isinstance(annotation, type) and issubclass(annotation, BaseModel)


def _value(form: Form, value: Any) -> Any:
    if form.item is None:
        return _without_truth_values(form.numbers, value)
    if value is None:
        return value if form.may_be_none else ()
    if _is_one(form.item, value):
        value = _letters(form.item, value) or [value]
    if form.numbers is not None and isinstance(value, list | tuple):
        return [_without_truth_values(form.numbers, one) for one in value]
    return value


def _is_one(item: Any, value: Any) -> bool:
    """Whether a value is one item in place of a list of items."""
    if is_entry(item):
        return isinstance(value, Mapping) and any(key in item.model_fields for key in value)
    if get_origin(item) is tuple:
        listed = isinstance(value, list | tuple) and len(value) == len(get_args(item))
        return listed and all(isinstance(part, int | float | str) for part in value)
    return isinstance(value, int | float | str)


def _letters(item: Any, value: Any) -> list[str] | None:
    """The letters of a word, for a list of words of one letter; None for other lists."""
    words = get_args(item) if get_origin(item) is Literal else ()
    if not words or not isinstance(value, str) or any(len(word) != 1 for word in words):
        return None
    letters = [letter for letter in value if letter not in " ,"]
    return letters if letters and all(letter in words for letter in letters) else None


def _without_truth_values(numbers: Any, value: Any) -> Any:
    """Replaces truth values and bytes by words where a number is required, so that they are refused."""
    if numbers is True:
        return str(value).lower() if isinstance(value, bool | bytes) else value
    if numbers is not None and isinstance(value, list | tuple) and len(numbers) == len(value):
        return [_without_truth_values(*pair) for pair in zip(numbers, value, strict=True)]
    return value
