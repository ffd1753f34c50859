"""Messages for invalid entries: file, key, value, unit, and what is required.

They use the terms of the scene file in place of those of pydantic.
"""

from __future__ import annotations

import reprlib
from collections.abc import Callable
from difflib import get_close_matches
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

from pydantic import BaseModel, ValidationError

from softrobot_twin.errors import SceneError
from softrobot_twin.scene.entry import is_entry, item_of_list, plain

SYNONYMS = {
    "e": "young_modulus", "nu": "poisson_ratio", "rho": "density", "mu": "friction",
    "file": "mesh", "center": "centre", "length": "shortening", "force": "tension",
}  # fmt: skip
"""Other words for keys, which a comparison of spellings does not find."""
_LIMITS = {
    "greater_than": ("above", "gt"), "greater_than_equal": ("at least", "ge"),
    "less_than": ("below", "lt"), "less_than_equal": ("at most", "le"),
}  # fmt: skip
_WRONG_KIND = ("_type", "_parsing", "_from_float", "_unicode", "_size")
_LONGEST_VALUE = 80
_MOST_ERRORS = 10
"""So many errors of a scene are written out."""
_repr = reprlib.Repr()
_repr.maxstring = _repr.maxother = _repr.maxlong = _LONGEST_VALUE
_repr.maxlist = _repr.maxtuple = 12


def scene_error(
    error: ValidationError, root: type[BaseModel], path: Path | None, above: tuple = (),
    as_written: Callable[[tuple], tuple] = lambda location: (location, None),
) -> SceneError:  # fmt: skip
    """The errors of a scene: one, with the others in it.

    Args:
        error: The errors of the whole scene.
        root: The type of the scene, or of the entry that was checked.
        path: Scene file, or None for a scene in memory.
        above: Location of the entry in the scene.
        as_written: Returns where the scene file has what is at a location, and the copy of an entry
            that it is in, or None; see `softrobot_twin.scene.patterns.as_written`.
    """
    details: list[dict[str, Any]] = [
        {**one, "loc": _place(one)} for one in error.errors(include_url=False)
    ]
    # A misspelt key also makes the correct one missing; the message names the misspelt one.
    misspelt = {tuple(d["loc"][:-1]) for d in details if d["type"] == "extra_forbidden"}
    details = [d for d in details if d["type"] != "missing" or tuple(d["loc"][:-1]) not in misspelt]
    # What is wrong inside an entry makes lists around it too short.
    around = {tuple(d["loc"][:end]) for d in details for end in range(len(d["loc"]))}
    details = [d for d in details if tuple(d["loc"]) not in around or d["type"] == "refusal"]
    details.sort(key=lambda d: d["type"] != "extra_forbidden")
    # An error of a repeated entry as it was written is one error, not one for each copy.
    alike: dict[tuple, list] = {}
    for one in details:
        key = as_written(one["loc"])[0], one["type"] if one["type"] == "refusal" else ""
        alike.setdefault(key, []).append(one)
    found = [_one_error(same, root, path, above, as_written)
             for same in list(alike.values())[:_MOST_ERRORS]]  # fmt: skip
    first = found[0]
    return SceneError(path, first.key, first.value, first.unit, first.reason, found[1:],
                      len(alike) - len(found))  # fmt: skip


def _place(one: Any) -> tuple:
    """Location of an error, without what pydantic adds for alternatives of a value."""
    place = tuple(one["loc"])
    if one["type"] == "extra_forbidden":
        return place
    odd = (index for index, part in enumerate(place)
           if isinstance(part, str) and not part.replace("_", "").isalnum())  # fmt: skip
    return place[: next(odd, len(place))]


def _one_error(
    alike: list, root: type[BaseModel], path: Path | None, above: tuple, as_written: Callable
) -> SceneError:
    """The error at one place of the file, which several copies of an entry may have."""
    one = alike[0]
    location = tuple(one["loc"])
    value, reason, own_unit = one.get("input"), "", ""
    if one["type"] == "refusal":
        context = one["ctx"]
        below = parts(context["key"])
        location, value, reason = (*location, *below), context["value"], context["reason"]
        if context["also"]:
            reason += _also(as_written, parts(context["also"]))
        own_unit = context["unit"]
    elif one["type"] == "missing":
        location, value, reason = _missing(root, location, value)
    elif one["type"] == "extra_forbidden":
        reason = _unknown_key(root, location)
    else:
        reason = _reason(root, location, one)
    written, copy = as_written(location)
    if copy is not None and len(alike) < copy.count:
        reason += f" (copy {copy.number} of {copy.count})"
    return SceneError(path, dotted((*above, *written)) or "scene", short(value),
                      own_unit or unit_at(root, location), reason)  # fmt: skip


def _also(as_written: Callable, location: list) -> str:
    written, copy = as_written(tuple(location))
    return dotted(written) + (f" (copy {copy.number})" if copy is not None else "")


def nearest(name: object, known) -> str:
    """A hint at the known name most similar to an unknown one; empty when none is similar.

    Args:
        name: The unknown name.
        known: The known ones.
    """
    found = get_close_matches(str(name), [str(word) for word in known], n=1, cutoff=0.6)
    return f"; is {found[0]} meant?" if found else ""


def unit_at(root: type[BaseModel], location: tuple) -> str:
    """The unit of the innermost named value that contains a location.

    Args:
        root: Type of the whole, such as a scene.
        location: Names of keys and places in lists, from the whole inwards.
    """
    names = [part for part in location if not isinstance(part, int)]
    model = _model_at(root, tuple(names[:-1])) if names else None
    field = model.model_fields.get(names[-1]) if model else None
    return _unit_of(field.json_schema_extra, field.annotation, field.metadata) if field else ""


def _model_at(root: type[BaseModel], location: tuple) -> type[BaseModel] | None:
    """The type of the entry at a location, through lists and optional entries."""
    found = _annotation_at(root, location)
    item = item_of_list(found)
    found = plain(found) if item is None else item
    return found if is_entry(found) else None


def _annotation_at(root: type[BaseModel], location: tuple) -> Any:
    """The annotation at a location; None for an unknown location."""
    found: Any = root
    for part in location:
        if isinstance(part, int):
            item, inner = item_of_list(found), get_args(plain(found))
            found = item if item is not None else inner[part] if part < len(inner) else None
            continue
        item = item_of_list(found)
        holder = plain(found) if item is None else item
        field = holder.model_fields.get(part) if is_entry(holder) else None
        found = field.annotation if field else None
    return found


def parts(key: str) -> list:
    """A key, such as ``cables[0].rate``, as a location.

    Args:
        key: The key.
    """
    parts: list = []
    for word in key.split("."):
        name, *indices = word.replace("]", "").split("[")
        parts += [name, *map(int, indices)] if name else map(int, indices)
    return parts


def dotted(location: tuple) -> str:
    """A location as a key, such as ``cables[0].rate``.

    Args:
        location: Names of keys and places in lists, from the whole inwards.
    """
    key = ""
    for part in location:
        key += f"[{part}]" if isinstance(part, int) else f".{part}" if key else str(part)
    return key


def short(value: Any) -> Any:
    """A value for a message; of a section only the number of keys.

    Args:
        value: The value, of any type.
    """
    if isinstance(value, dict):
        return f"(a section of {len(value)} keys)"
    shown = _repr.repr(value)
    if isinstance(value, list | tuple):
        return list(value) if len(shown) <= _LONGEST_VALUE and "..." not in shown else (
            f"(a list of {len(value)})")  # fmt: skip
    if isinstance(value, str | int | float | bool | None):
        return value if len(shown) <= _LONGEST_VALUE and "..." not in shown else shown
    return str(value)


def _missing(root, location: tuple, value: Any) -> tuple[tuple, Any, str]:
    if isinstance(location[-1], int):  # a list that is too short
        whole = location[:-1]
        return whole, value, f"must be {_kind(_annotation_at(root, whole))}; it has {len(value)}"
    return location, "(nothing)", "is required"


def _unknown_key(root, location: tuple) -> str:
    key = str(location[-1])
    if key == "shells":
        return "shells are not available in this version"
    model = _model_at(root, location[:-1])
    known = [name for name in model.model_fields if name != "path"] if model else []
    if key == "repeat":
        return _not_repeated(location)
    if isinstance(model, type) and getattr(model, "placed", None) is not None and isinstance(
            location[-2], int):  # fmt: skip
        known.append("repeat")
    synonym = SYNONYMS.get(key.lower())
    hint = f"; is {synonym} meant?" if synonym in known else nearest(key, known)
    home = "" if hint else _home(root, key, location)
    return f"is not a key here{hint or home}; known keys: {', '.join(known) or 'none'}"


def _not_repeated(location: tuple) -> str:
    where = ".".join(str(part) for part in location[:-1] if not isinstance(part, int))
    if where == "body":
        return "a single body is not repeated: give it under bodies"
    return f"an entry of {where} cannot be repeated" if where else "belongs in an entry of a list"


def _home(root, key: str, location: tuple) -> str:
    """The section to which a misplaced key belongs."""
    found = _sections_with(root, key, "")
    near = [place for place in found if place.split(".")[0] == location[0]]
    found = (near or found)[:2]
    return f", it belongs in {' or '.join(found)}" if found else ""


def _sections_with(model, key: str, place: str) -> list[str]:
    found = [place] if place and key in model.model_fields else []
    for name, field in model.model_fields.items():
        item = item_of_list(field.annotation)
        inner = plain(field.annotation) if item is None else item
        if is_entry(inner):
            found += _sections_with(inner, key, f"{place}.{name}" if place else name)
    return found


def _reason(root, location: tuple, details: Any) -> str:
    """What is required at a location with an invalid value."""
    kind, context, value = details["type"], details.get("ctx", {}), details.get("input")
    unit = unit_at(root, location)
    if kind in _LIMITS:
        word, name = _LIMITS[kind]
        return f"must be {word} {context[name]:g}"
    if kind == "literal_error":
        # The error contains the words of a list that can be extended, such as that of the laws.
        words = context.get("words") or get_args(plain(_annotation_at(root, location)))
        return f"must be one of {', '.join(words)}{nearest(value, words)}"
    if kind == "finite_number":
        return "must be finite"
    if kind == "too_short":
        length, least = context["actual_length"], context["min_length"]
        return f"must have at least {least} entries; it has {length}"
    if kind == "value_error":
        return _lower(str(context.get("error", details["msg"])))
    expected = _annotation_at(root, location)
    if kind == "too_long" and expected is not None:
        return f"must be {_kind(expected)}; it has {context['actual_length']}"
    if kind == "invalid_key":
        return "a key must be a word"
    if kind in ("float_parsing", "float_type") and isinstance(value, str):
        named = f" in {unit}, written without its unit" if unit else ""
        return f"must be a number{named}"
    if expected is not None and kind.endswith(_WRONG_KIND):
        several = "; several are given as bodies" if location == ("body",) else ""
        return f"must be {_kind(expected)}{several}"
    return _lower(details["msg"])


def _kind(annotation: Any) -> str:
    """The description of an annotation: ``a number``, ``a list of 3 numbers``."""
    item, expected = item_of_list(annotation), plain(annotation)
    if item is not None:
        if is_entry(item):
            return f"a list; each entry starts with '- ' and is {_kind(item)}"
        return f"a list; each entry is {_kind(item)}"
    if is_entry(expected):
        known = ", ".join(name for name in expected.model_fields if name != "path")
        return f"a section with these keys: {known}"
    if get_origin(expected) is tuple:
        inner = {_kind(part) for part in get_args(expected)}
        noun = inner.pop().removeprefix("a ") + "s" if len(inner) == 1 else "entries"
        return f"a list of {len(get_args(expected))} {noun}"
    if get_origin(expected) is Literal:
        return f"one of {', '.join(map(str, get_args(expected)))}"
    return {float: "a number", int: "a whole number", str: "a word", Path: "a file name",
            bool: "true or false"}.get(expected, "something else")  # fmt: skip


def _lower(sentence: str) -> str:
    return sentence[:1].lower() + sentence[1:]


def _unit_of(extra: Any, annotation: Any, metadata: Any) -> str:
    if isinstance(extra, dict) and "unit" in extra:
        return str(extra["unit"])
    for item in metadata or ():
        found = getattr(item, "json_schema_extra", None)
        if isinstance(found, dict) and "unit" in found:
            return str(found["unit"])
    for inner in getattr(annotation, "__args__", ()):
        found = _unit_of(None, inner, getattr(inner, "__metadata__", ()))
        if found:
            return found
    return ""
