"""What drives the twin, and what it does in a tick."""

from __future__ import annotations

from enum import Enum


class Mode(Enum):
    """What drives the twin."""

    INVERSE = "inverse"
    """Targets of the effectors."""
    DIRECT = "direct"
    """Lengths or tensions of the cables."""


class Activity(Enum):
    """What the loop does in a tick. The value is the word that diagnostics show."""

    DISABLED = "disabled"
    """No command is published."""
    RESYNCHRONISING = "resynchronising"
    """The model goes to where the device is; nothing is published yet."""
    RETURNING = "returning"
    """On the way to the rest shape, within the limits, to be reset there."""
    HOLDING = "holding"
    """The cables stay as they are."""
    FOLLOWING = "following"
    """The effectors go to their targets."""
    COMMANDED = "commanded"
    """The cables go where a direct command wants them."""
