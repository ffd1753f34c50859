"""Files of reduced models: archives of numpy with arrays and fingerprints, read whole and checked.

A file may have been cut short on its way, or written by another program. Each array is checked when
it is taken: that it is there, its shape, that its numbers are finite and within bounds. What is
wrong is said by one error that names the file and the array. That all files exist which a scene
names is checked before it is built.
"""

from __future__ import annotations

import io
import zipfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from softrobot_twin.errors import SoftRobotTwinError
from softrobot_twin.scene import Scene
from softrobot_twin.scene.entry import values_below

# Most bytes that a file may unpack to: a basis of 70 000 nodes and 120 modes. Reading it takes three
# times as much memory.
MOST_BYTES = 100_000_000
# Least and greatest magnitude of any number that a model has in SI units: beyond, products overflow.
LEAST, MOST = 1.0e-30, 1.0e30
_KINDS = {"f": ("real numbers", "fiu"), "i": ("integers", "iu"), "b": ("truth values", "b"),
          "U": ("text", "U")}  # fmt: skip


class ModelFileError(SoftRobotTwinError):
    """A file of a reduced model cannot be used.

    Attributes:
        path: The file.
        reason: What is wrong, in one sentence.
        changed: What it was made from and has changed since; ``file`` where there is none, empty
            where the file itself is damaged.
    """

    def __init__(self, path: Path, reason: str, changed: tuple[str, ...] = ()):
        self.path, self.reason, self.changed = path, reason, changed
        super().__init__(f"{path}: {reason}")


def saved_prints(prints: Mapping[str, str]) -> np.ndarray:
    """Fingerprints as the array `prints` of a file."""
    return np.array([f"{name}={value}" for name, value in prints.items()])


class ModelFile:
    """The arrays of a file.

    Attributes:
        path: The file.
    """

    def __init__(self, path: Path):
        """Read all arrays.

        Args:
            path: The file.

        Raises:
            ModelFileError: It is not there, is no archive of arrays, or was cut short or changed on
                its way.
        """
        self.path = path
        if not path.is_file():
            raise ModelFileError(path, "does not exist", ("file",))
        try:
            self._arrays = dict(_arrays_of(path))
        # A damaged archive raises errors of a dozen classes of zipfile, zlib, tokenize and numpy.
        except Exception as error:
            words = " ".join(str(error).split())[:200] or type(error).__name__
            raise self.damaged(words) from None

    def damaged(self, reason: str) -> ModelFileError:
        """The error that says what is wrong in the file."""
        return ModelFileError(self.path, f"is no reduced model, or damaged: {reason}")

    def check_prints(self, prints: Mapping[str, str]) -> None:
        """Refuse a file that was made of something else.

        Args:
            prints: Fingerprints of the scene's body.

        Raises:
            ModelFileError: It names what has changed.
        """
        pairs = [str(entry).partition("=") for entry in self.taken("prints", None, kind="U")]
        found = {name: value for name, _, value in pairs}
        changed = tuple(name for name, value in prints.items() if found.get(name) != value)
        if changed:
            raise ModelFileError(self.path, f"was made of another {', '.join(changed)}", changed)

    def taken(
        self, name: str, *shape: int | None, kind: str = "f", least: float = -MOST,
        most: float = MOST, may_be_nan: bool = False,
    ) -> np.ndarray:  # fmt: skip
        """An array of the file, checked.

        Args:
            name: Its name.
            shape: Its shape, None for an axis of any length.
            kind: ``f`` for real numbers, ``i`` for integers, ``b`` for truth values, ``U`` for text.
            least: Least value.
            most: Greatest value.
            may_be_nan: Whether NaN is among the values of real numbers.

        Returns:
            The array: real numbers in double precision, integers as int64.

        Raises:
            ModelFileError: It is missing, of another shape or kind, or has values beyond bounds.
        """
        if name not in self._arrays:
            raise self.damaged(f"it has no array {name}")
        found = self._arrays[name]
        fits = found.ndim == len(shape) and all(
            wanted in (None, length) for wanted, length in zip(shape, found.shape, strict=False)
        )
        words, kinds = _KINDS[kind]
        if not fits or found.dtype.kind not in kinds:
            needed = ", ".join("any" if length is None else str(length) for length in shape)
            raise self.damaged(
                f"{name} has shape ({', '.join(map(str, found.shape))}) and type "
                f"{found.dtype.name}; {words} of shape ({needed}) are needed"
            )
        if kind in "bU":
            return found
        values = found.astype(float if kind == "f" else np.int64)
        is_good = (values >= least) & (values <= most)
        if may_be_nan:
            is_good |= np.isnan(values)
        if not is_good.all():
            wrong = values[~is_good].ravel()
            raise self.damaged(f"{len(wrong)} of {name} are not between {least:g} and {most:g}, "
                               f"such as {wrong[0]:g}")  # fmt: skip
        return values


def _arrays_of(path: Path):
    """Names and arrays of an archive; all bytes of each member have the sum that is stored."""
    with zipfile.ZipFile(path) as archive:
        members = archive.infolist()
        size = sum(member.file_size for member in members)
        if size > MOST_BYTES:
            raise ValueError(f"it unpacks to {1e-6 * size:.0f} MB, the most is "
                             f"{1e-6 * MOST_BYTES:.0f} MB")  # fmt: skip
        for member in members:
            with archive.open(member) as packed:
                stream = io.BytesIO(packed.read(member.file_size))
            array = np.lib.format.read_array(stream, allow_pickle=False)
            if stream.read(1):
                raise ValueError(f"{member.filename} is longer than its array")
            yield member.filename.removesuffix(".npy"), array


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
        raise scene.error(key, str(file), f"{reason} ({path})")
