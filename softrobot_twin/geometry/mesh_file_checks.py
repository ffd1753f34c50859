"""What is checked of each file of a mesh or a surface: its size, its counts and its positions."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path

import numpy as np

from softrobot_twin.errors import MeshError, one_line

MOST_BYTES = 200_000_000
"""A larger file is not read."""
# Coordinates beyond it [m] are refused: their products in volumes and inertias could overflow.
_FARTHEST = 1e9
# Lines that state how many nodes or cells follow, for which readers allocate memory.
_COUNTS = re.compile(
    rb"(?:^|\n)\s*(?:\$(Nodes|Elements)\s*\n|(POINTS|CELLS|CELL_TYPES|POLYGONS) |element (vertex|face) )"
    rb"([0-9 ]{1,200})"
)


def check_file(path: Path, suffixes: tuple[str, ...], what: str) -> None:
    """Checks a file's name, and that there is such a file.

    Args:
        path: The file.
        suffixes: What its name may end in, in small letters.
        what: Noun for such files, for messages.

    Raises:
        MeshError: The name ends in something else; or there is no such file.
    """
    if path.suffix.lower() not in suffixes:
        raise MeshError(path, f"{what} files end in {', '.join(suffixes)}, not in '{path.suffix}'")
    if not path.is_file():
        found = "is a folder, not a file" if path.is_dir() else "there is no such file"
        raise MeshError(path, found)


def check_size(path: Path) -> None:
    """Checks a file before it is read.

    Args:
        path: The file.

    Raises:
        MeshError: It is larger than `MOST_BYTES`, or states more nodes or cells than it has bytes.
    """
    byte_count = path.stat().st_size
    if byte_count > MOST_BYTES:
        raise MeshError(path, f"has {byte_count / 1e6:.0f} MB, more than {MOST_BYTES / 1e6:.0f} MB")
    for *words, counts in _COUNTS.findall(path.read_bytes()):
        most = max(map(int, counts.split()), default=0)
        if most > byte_count:
            word = b"".join(words).decode()
            raise MeshError(path, f"is damaged: it has {byte_count} bytes, and states {most} for "
                            f"{word}")  # fmt: skip


@contextmanager
def damage_told(path: Path, what: str) -> Iterator[None]:
    """Reads a file inside the context: what readers print is dropped, and their errors become ours.

    Args:
        path: The file.
        what: What cannot be done with it, such as ``cannot be read``.

    Raises:
        MeshError: The reader raised an error.
    """
    with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
        try:
            yield
        except MeshError:
            raise
        except (Exception, SystemExit) as error:  # a damaged file may raise any exception
            detail = one_line(error) or "no reason given"
            raise MeshError(path, f"{what} ({type(error).__name__}: {detail})") from error


def check_positions(path: Path, positions: np.ndarray, scale: float, what: str) -> None:
    """Checks the positions of a file.

    Args:
        path: The file, for the error.
        positions: In the unit of the file, shape (count, 3).
        scale: Metres in one unit of the file.
        what: What is there, such as ``node``.

    Raises:
        MeshError: One is not finite or farther away than any robot is.
    """
    # A comparison with NaN is false.
    wrong = np.flatnonzero(~(np.abs(positions) <= _FARTHEST / scale).all(axis=1))
    if len(wrong):
        place = positions[wrong[0]]
        why = (f"farther than {_FARTHEST:g} m: is the file damaged, or its scale wrong?"
               if np.isfinite(place).all() else "not finite")  # fmt: skip
        raise MeshError(path, f"{what} {wrong[0]} is at {place.tolist()}, {why}")
