"""Short forms of entries, written out before they are checked.

A user may write a file in place of the section that holds it, one entry in place of a list of one,
``xz`` in place of ``[x, z]``. Only what can mean one thing is accepted.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel


def written_out(model: type[BaseModel], entry: Any) -> Any:
    """An entry with its short forms written out.

    Args:
        model: What the entry is read as.
        entry: What stands in the scene.

    Returns:
        The entry; what has no short form is returned as it is.
    """
    if isinstance(entry, str | Path) and "file" in model.model_fields:
        return {"file": entry}
    if not isinstance(entry, Mapping):
        return entry
    fields = model.model_fields
    return {
        key: _value(fields[key].annotation, value) if key in fields else value
        for key, value in entry.items()
    }


def plain(annotation: Any) -> Any:
    """An annotation without its limits, its unit, and the choice to leave it out."""
    while True:
        origin = get_origin(annotation)
        if origin is Annotated:
            annotation = get_args(annotation)[0]
        elif origin in (Union, UnionType):
            annotation = next(a for a in get_args(annotation) if a is not type(None))
        else:
            return annotation


def may_be_left_out(annotation: Any) -> bool:
    """Whether None stands for nothing."""
    return get_origin(annotation) in (Union, UnionType) and type(None) in get_args(annotation)


def item_of_list(annotation: Any) -> Any:
    """What a list of any length holds; None where the annotation is no such list."""
    arguments = get_args(plain(annotation))
    is_list = get_origin(plain(annotation)) is tuple and len(arguments) == 2
    return plain(arguments[0]) if is_list and arguments[1] is Ellipsis else None


def is_entry(annotation: Any) -> bool:
    """Whether an annotation is a section of keys."""
    return isinstance(annotation, type) and issubclass(annotation, BaseModel)


def _value(annotation: Any, value: Any) -> Any:
    item = item_of_list(annotation)
    if item is None:
        return _without_truth(plain(annotation), value)
    if value is None:
        return value if may_be_left_out(annotation) else ()
    if _is_one(item, value):
        value = _letters(item, value) or [value]
    if isinstance(value, list | tuple):
        return [_without_truth(item, one) for one in value]
    return value


def _is_one(item: Any, value: Any) -> bool:
    """Whether one item stands where a list of them belongs."""
    if is_entry(item):
        return isinstance(value, Mapping) and any(key in item.model_fields for key in value)
    if get_origin(item) is tuple:
        listed = isinstance(value, list | tuple) and len(value) == len(get_args(item))
        return listed and all(isinstance(part, int | float | str) for part in value)
    return isinstance(value, int | float | str)


def _letters(item: Any, value: Any) -> list[str] | None:
    """Words of one letter, written as one word; None where these are none."""
    words = get_args(item) if get_origin(item) is Literal else ()
    if not words or not isinstance(value, str) or any(len(word) != 1 for word in words):
        return None
    letters = [letter for letter in value if letter not in " ,"]
    return letters if letters and all(letter in words for letter in letters) else None


def _without_truth(annotation: Any, value: Any) -> Any:
    """Truth values are no numbers: written as words, they are refused where a number belongs."""
    if annotation in (float, int):
        return str(value).lower() if isinstance(value, bool) else value
    if get_origin(annotation) is tuple and isinstance(value, list | tuple):
        inner = [plain(part) for part in get_args(annotation)]
        if len(inner) == len(value):
            return [_without_truth(*pair) for pair in zip(inner, value, strict=True)]
    return value
