"""Writes a file of results that replaces an older file only when it is complete."""

from __future__ import annotations

import csv
import os
import shutil
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from softrobot_twin.errors import SoftRobotTwinError


class OutputError(SoftRobotTwinError):
    """A file of results cannot be written.

    Attributes:
        path: The file.
        reason: Message of the system.
    """

    def __init__(self, path: Path | str, reason: str):
        self.path, self.reason = Path(str(path)), reason
        super().__init__(f"{path}: cannot be written: {reason}")


BROKEN_OFF = ".part"
"""Suffix of an incomplete file that is left after Ctrl-C."""


@contextmanager
def writing(path: Path | str, error_too: type[Exception] = OSError) -> Iterator[None]:
    """Turns errors of the system into `OutputError`.

    Args:
        path: What is written.
        error_too: A further kind of error that means the same.

    Raises:
        OutputError: It cannot be written.
    """
    try:
        yield
    except (OSError, error_too) as error:
        raise OutputError(path, getattr(error, "strerror", None) or str(error)) from error


def make_folder(folder: Path) -> None:
    """Makes a folder for results.

    Args:
        folder: The folder; one that exists stays as it is.

    Raises:
        OutputError: It cannot be made.
    """
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)


@contextmanager
def output_file(path: Path | str) -> Iterator[Path]:
    """Yields a temporary path in the same folder and moves it to the requested path at the end.

    After an error the requested file stays unchanged. After Ctrl-C the incomplete file is kept
    beside it, see `BROKEN_OFF`. A device or a pipe is written directly.

    Args:
        path: The requested file. Missing folders are created.

    Raises:
        OutputError: The file cannot be written.
    """
    partial = None
    with writing(path, Exception):  # a name too long, with a null character, or none at all
        path = Path(path)
        target = path.resolve()
    try:
        if target.exists() and not target.is_file():
            if target.is_dir():
                raise OutputError(path, "is a folder, not a file")
            yield target
            return
        if target.exists() and not os.access(target, os.W_OK):
            raise OutputError(path, "Permission denied")
        target.parent.mkdir(parents=True, exist_ok=True)
        # The suffix is kept, because it determines the format of a picture.
        partial = target.with_name(f".{target.stem}.{os.getpid()}{target.suffix}")
        partial.touch()
        yield partial
        if target.exists():
            shutil.copymode(target, partial)
        os.replace(partial, target)
    except KeyboardInterrupt:
        if partial is not None and partial.exists():
            os.replace(partial, path.with_name(path.name + BROKEN_OFF))
        raise
    except OSError as error:
        raise OutputError(path, error.strerror or str(error)) from error
    finally:
        if partial is not None:
            partial.unlink(missing_ok=True)


@contextmanager
def csv_output(path: Path | str, header: Sequence[str]) -> Iterator[Callable[[Iterable], None]]:
    """Opens a CSV file of results, see `output_file`, and returns a function that appends a row.

    Args:
        path: The requested file.
        header: Its columns.

    Raises:
        OutputError: The file cannot be written.
    """
    with output_file(path) as partial, partial.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        yield writer.writerow
        file.close()


def cell(value: object) -> str:
    """A value of a table of measurements: six digits, empty where it is unknown or not finite.

    Args:
        value: A number, a text, or None.
    """
    if value is None or (isinstance(value, float) and not np.isfinite(value)):
        return ""
    return f"{value:.6g}" if isinstance(value, float) else str(value)
