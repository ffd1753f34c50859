"""Scenes, meshes and tables that come with the package.

In a checkout they are beside it. An installation, by pip or colcon, has them in
``share/softrobot_twin``, with the same names.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable
from pathlib import Path


def shared_folders() -> list[Path]:
    """Folders that may have the package's ``config/`` and ``meshes/``, in order of search."""
    package = Path(__file__).resolve().parent
    prefixes = [*package.parents[3:4], Path(sys.prefix)]
    return [package.parent, *(prefix / "share" / package.name for prefix in prefixes)]


def given_file(path: Path | str) -> Path:
    """The file that a user names.

    Args:
        path: A path. One that begins with ``config/`` and is no file below the working directory
            names a file that comes with the package.

    Returns:
        The path of that file; the given path where the package has no such file either.
    """
    path = Path(path)
    if path.parts[:1] != ("config",) or path.exists():
        return path
    return next((folder / path for folder in shared_folders() if (folder / path).is_file()), path)


class ScenePath(Path):
    """The path of a scene file, with other values of its entries, which a scene is loaded with.

    Attributes:
        changes: Keys and their values, such as ``cables[0].tension=[0, 5]``.
    """

    def __init__(self, path: Path | str, changes: Iterable[str]):
        super().__init__(path)
        self.changes = tuple(changes)

    def __reduce__(self):
        return ScenePath, (str(self), self.changes)

    def with_segments(self, *segments) -> Path:  # type: ignore[override]
        """A path made from this one, such as that of a file beside it: without changes.

        Args:
            *segments: Its parts, as of `Path`.
        """
        return Path(*segments)

    def resolve(self, strict: bool = False) -> ScenePath:
        """The absolute path of the file, with the same changes.

        Args:
            strict: Whether the file must exist, as of `Path.resolve`.
        """
        return ScenePath(super().resolve(strict), self.changes)
