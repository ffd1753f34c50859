"""The error of the view: what it was asked for and cannot do."""

from __future__ import annotations

from softrobot_twin.errors import SoftRobotTwinError


class ViewError(SoftRobotTwinError):
    """A view cannot be opened, or a frame cannot be shown.

    Attributes:
        key: What was asked for or given, such as ``port``.
        value: Its value.
        reason: Why it cannot be, in one sentence.
    """

    def __init__(self, key: str, value: object, reason: str):
        self.key = key
        self.value = value
        self.reason = reason
        super().__init__(f"view: {key} = {value!r}: {reason}")
