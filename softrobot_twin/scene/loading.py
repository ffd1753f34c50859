"""Reading a scene file, with one clear error that names file, key, value and unit."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml
from pydantic import BaseModel, ValidationError

from softrobot_twin.errors import SceneError
from softrobot_twin.scene.schema import Scene
from softrobot_twin.scene.yaml_reading import read_yaml

NOT_BUILT = {
    "cavities": "pneumatic cavities",
    "beams": "beams",
    "reduction": "reduced models",
    "neo_hookean": "the Neo-Hookean law",
}


def load_scene(path: Path | str) -> Scene:
    """Read and check a scene.

    Args:
        path: YAML file.

    Returns:
        The scene; it knows its own path, so that its mesh is found.

    Raises:
        SceneError: The file cannot be read, or an entry cannot be.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise SceneError(path, "scene_file", str(path), "", error.strerror or str(error)) from None
    except UnicodeDecodeError:
        raise SceneError(path, "scene_file", str(path), "", "is not a text file") from None
    try:
        mapping = read_yaml(text)
    except yaml.YAMLError as error:
        reason = " ".join(str(error).split())
        raise SceneError(path, "scene_file", str(path), "", f"is not YAML: {reason}") from None
    return scene_from_mapping(mapping, path)


def scene_from_mapping(mapping: Any, path: Path | None = None) -> Scene:
    """Check a scene that stands in memory.

    Args:
        mapping: What the YAML file holds.
        path: File to name in errors and to find the mesh from.

    Returns:
        The scene.

    Raises:
        SceneError: An entry cannot be.
    """
    if not isinstance(mapping, dict):
        raise SceneError(path, "scene", mapping, "", "a scene is a mapping of keys to values")
    if "path" in mapping:
        raise SceneError(path, "path", mapping["path"], "", "is not a key of scenes")
    try:
        return Scene.model_validate({**mapping, "path": path})
    except ValidationError as error:
        raise _first_error(error, path) from None


def _first_error(error: ValidationError, path: Path | None) -> SceneError:
    details = error.errors(include_url=False)
    first = details[0]
    location = tuple(part for part in first["loc"])
    key = _dotted(location)
    value = first.get("input")
    reason = first["msg"].removeprefix("Value error, ")
    if first["type"] == "extra_forbidden":
        reason = _unknown_key(location)
    elif first["type"] == "literal_error" and str(value) in NOT_BUILT:
        reason = f"{NOT_BUILT[str(value)]} is not built into this version; {_lower(reason)}"
    elif first["type"] == "missing":
        value, reason = "(nothing)", "is required"
    else:
        reason = _lower(reason)
    if len(details) > 1:
        reason += f" (and {len(details) - 1} more of such errors)"
    return SceneError(path, key or "scene", _short(value), _unit_at(location), reason)


def _dotted(location: tuple) -> str:
    key = ""
    for part in location:
        key += f"[{part}]" if isinstance(part, int) else f".{part}" if key else str(part)
    return key


def _short(value: Any) -> Any:
    """A whole section is named by its kind, not printed."""
    if isinstance(value, dict):
        return f"(a section of {len(value)} keys)"
    if isinstance(value, list | tuple) and len(str(value)) > 80:
        return f"(a list of {len(value)})"
    return value


def _lower(sentence: str) -> str:
    return sentence[:1].lower() + sentence[1:]


def _unknown_key(location: tuple) -> str:
    key = str(location[-1])
    if key in NOT_BUILT:
        return f"this scene asks for {NOT_BUILT[key]}, not built into this version"
    model = _model_at(location[:-1])
    known = ", ".join(name for name in model.model_fields if name != "path") if model else "none"
    return f"is not a key here; known are: {known}"


def _model_at(location: tuple) -> type[BaseModel] | None:
    """The model that holds a location, followed through lists and optional entries."""
    model: type[BaseModel] | None = Scene
    for part in location:
        if isinstance(part, int):
            continue
        field = model.model_fields.get(part) if model else None
        model = _inner_model(field.annotation) if field else None
    return model


def _inner_model(annotation: Any) -> type[BaseModel] | None:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    for inner in getattr(annotation, "__args__", ()):
        found = _inner_model(inner)
        if found:
            return found
    return None


def _unit_at(location: tuple) -> str:
    """The unit of the nearest named entry above a location."""
    names = [part for part in location if not isinstance(part, int)]
    if not names:
        return ""
    model = _model_at(tuple(names[:-1]))
    field = model.model_fields.get(names[-1]) if model else None
    return _unit_of(field.json_schema_extra, field.annotation, field.metadata) if field else ""


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
