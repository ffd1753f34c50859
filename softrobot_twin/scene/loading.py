"""Reading a scene file, with one clear error that names file, key, value and unit."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml
from pydantic import ValidationError

from softrobot_twin.errors import SceneError
from softrobot_twin.scene.refusal_words import scene_error
from softrobot_twin.scene.schema import Scene
from softrobot_twin.scene.yaml_reading import DuplicateKeyError, read_yaml, yaml_words


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

    def refused(reason: str) -> SceneError:
        return SceneError(path, "scene_file", str(path), "", reason)

    try:
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise refused(error.strerror or str(error)) from None
    except ValueError:  # bytes that are not UTF-8, or a path with a null character
        raise refused("is not a text file (UTF-8)") from None
    try:
        mapping = read_yaml(text)
    except DuplicateKeyError as error:
        first, second = error.lines
        raise SceneError(
            path, error.key, error.value, "", f"stands twice, in lines {first} and {second}"
        ) from None
    except yaml.YAMLError as error:
        raise refused(f"is not YAML: {yaml_words(error)}") from None
    if mapping is None:
        raise refused("is empty; a scene is a mapping of keys to values")
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
        found = "a list" if isinstance(mapping, list) else str(mapping)[:40]
        raise SceneError(path, "scene", found, "", "a scene is a mapping of keys to values")
    if "path" in mapping:
        raise SceneError(path, "path", mapping["path"], "", "is not a key of scenes")
    try:
        return Scene.model_validate({**mapping, "path": path})
    except ValidationError as error:
        raise scene_error(error, Scene, path) from None
