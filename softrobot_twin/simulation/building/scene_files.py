"""Existence of the files that a scene names, checked before it is built."""

from __future__ import annotations

from softrobot_twin.errors import SceneError
from softrobot_twin.scene import Scene
from softrobot_twin.scene.entry import values_below


def check_files(scene: Scene) -> None:
    """Refuse missing files, including those of bodies without contact.

    Args:
        scene: The scene.

    Raises:
        SceneError: A file is missing; the error names its key and the searched place.
    """
    for key, name, file in values_below(scene):
        if name != "file" or file is None:
            continue
        path = file
        try:
            path = scene.file_path(file)
            if path.is_file():
                continue
            reason = "is a folder, not a file" if path.is_dir() else "there is no such file"
        except (OSError, ValueError) as error:  # a name too long, or with a null character
            reason = getattr(error, "strerror", None) or str(error)
        raise SceneError(scene.path, key, str(file), "", f"{reason} ({path})")
