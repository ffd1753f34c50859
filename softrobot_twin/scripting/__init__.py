"""A robot in Python, by names and units: load, build, step, run, plot."""

from softrobot_twin.calibration.design import Equilibria, hull_volume
from softrobot_twin.scripting.named_commands import (
    Efforts,
    HoldAll,
    NamedCommand,
    Setpoints,
    Targets,
    efforts,
    hold,
    setpoints,
    targets,
)
from softrobot_twin.scripting.robot import Robot, SceneWarning, build, load
from softrobot_twin.scripting.step_outcome import Result
from softrobot_twin.simulation import Status
from softrobot_twin.simulation.appearance import Pose

__all__ = [
    "Efforts",
    "Equilibria",
    "HoldAll",
    "NamedCommand",
    "Pose",
    "Result",
    "Robot",
    "SceneWarning",
    "Setpoints",
    "Status",
    "Targets",
    "build",
    "efforts",
    "hold",
    "hull_volume",
    "load",
    "setpoints",
    "targets",
]
