"""What drives the twin, and what it does in a tick."""

from __future__ import annotations

from enum import Enum

from softrobot_twin.errors import ParameterError
from softrobot_twin.simulation import Simulation
from softrobot_twin.simulation.interpretation import why_not_followed


class Mode(Enum):
    """What drives the twin."""

    INVERSE = "inverse"
    """Targets of the effectors; single actuators may be commanded beside them."""
    DIRECT = "direct"
    """Lengths or tensions of the cables, positions of the slides."""


class Activity(Enum):
    """What the loop does in a tick. The value is the word that diagnostics show."""

    DISABLED = "disabled"
    """No command is published."""
    RESYNCHRONISING = "resynchronising"
    """The model goes to where the robot is; nothing is published yet."""
    RETURNING = "returning"
    """On the way to the rest shape, within the limits, to be reset there."""
    HOLDING = "holding"
    """The cables stay as they are."""
    FOLLOWING = "following"
    """The effectors go to their targets."""
    COMMANDED = "commanded"
    """The cables go where a direct command wants them."""

    @property
    def follows_robot(self) -> bool:
        """True when the model is where the robot was sent, so that the two can be compared."""
        return self not in (Activity.DISABLED, Activity.RESYNCHRONISING)


def refuse_impossible(mode: Mode, simulation: Simulation) -> None:
    """Refuses a mode that a scene cannot be driven in.

    Raises:
        ParameterError: Targets should drive a scene whose contacts the inverse cannot solve.
    """
    reason = why_not_followed(simulation.model)
    if mode is Mode.INVERSE and simulation.scene.contact is not None and reason:
        raise ParameterError(
            "mode", mode.value, "",
            f"scene {simulation.scene.name}: {reason}; or set mode to {Mode.DIRECT.value}",
        )
