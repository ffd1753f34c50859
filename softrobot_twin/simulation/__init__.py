"""Builds terms from a scene and steps them: Coevoet 2017, eq. 5-15."""

from softrobot_twin.simulation.command import (
    Command,
    CommandEfforts,
    CommandSetpoints,
    FollowTargets,
    Hold,
)
from softrobot_twin.simulation.effects.touches import Touched
from softrobot_twin.simulation.result import Status, StepReport, StepResult
from softrobot_twin.simulation.simulation import Simulation
from softrobot_twin.simulation.state import State

__all__ = [
    "Command",
    "CommandEfforts",
    "CommandSetpoints",
    "FollowTargets",
    "Hold",
    "Simulation",
    "State",
    "Status",
    "StepReport",
    "StepResult",
    "Touched",
]
