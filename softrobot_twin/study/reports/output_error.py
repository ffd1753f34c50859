"""The error of a result that cannot be put where the user wants it."""

from __future__ import annotations

from pathlib import Path

from softrobot_twin.errors import SoftRobotTwinError


class OutputError(SoftRobotTwinError):
    """A file of results cannot be written.

    Attributes:
        path: The file.
        reason: What the system said.
    """

    def __init__(self, path: Path | str, reason: str):
        self.path = Path(path)
        self.reason = reason
        super().__init__(f"{path}: cannot be written: {reason}")
