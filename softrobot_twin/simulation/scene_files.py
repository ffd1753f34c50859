"""The files that a scene names, looked for before anything is built."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from softrobot_twin.errors import SceneError
from softrobot_twin.scene import Scene
from softrobot_twin.scene.entry import Entry


def check_files(scene: Scene) -> None:
    """Refuse files that are not there, also those of what nothing touches.

    Args:
        scene: The scene.

    Raises:
        SceneError: A file is not there; named with its key and where it was looked for.
    """
    for key, file in _files(scene, ""):
        path = file
        try:
            path = scene.file_path(file)
            if path.is_file():
                continue
            reason = "is a folder, not a file" if path.is_dir() else "there is no such file"
        except (OSError, ValueError) as error:  # a name too long, or with a null character
            reason = getattr(error, "strerror", None) or str(error)
        raise SceneError(scene.path, key, str(file), "", f"{reason} ({path})")


def _files(entry: Entry, key: str) -> Iterator[tuple[str, Path]]:
    """Every file below an entry, with its key."""
    for name in type(entry).model_fields:
        if key == "" and name == "path":
            continue
        below, value = f"{key}.{name}" if key else name, getattr(entry, name)
        if name == "file":
            yield below, value
        elif isinstance(value, Entry):
            yield from _files(value, below)
        elif isinstance(value, tuple):
            for index, item in enumerate(value):
                if isinstance(item, Entry):
                    yield from _files(item, f"{below}[{index}]")
