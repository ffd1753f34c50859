"""What one tick of the twin came to."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from softrobot_twin.control.activity import Activity
from softrobot_twin.control.command_gate import CableCommand
from softrobot_twin.control.marker_input import Misfit
from softrobot_twin.control.pose_input import Pose
from softrobot_twin.control.target_input import TargetReading
from softrobot_twin.simulation import Simulation, State, Status, StepResult


class TickOutcome(NamedTuple):
    """What one tick came to.

    Attributes:
        activity: What the loop did.
        cause: Why it did not do more; empty when it followed or was commanded.
        result: The step.
        command: What to publish, or None when nothing may be published.
        violated: Limits that the step's own command broke; the last safe one stands instead.
        reading: The targets as they were asked for, and their age.
        aims: Where the step sent the effectors: the targets, corrected, and approached when far
            [m], shape (effector_count, 3).
        predicted_markers: Where the model believes the markers [m], shape (marker_count, 3).
        measured_markers: Where they were seen [m], same shape; NaN where not, or left out.
        misfit: Measured against predicted at the moment of the measurement.
        measured_effectors: Effectors by the markers [m], shape (effector_count, 3); NaN without.
        tracking_errors: Distance of each effector, measured or else believed, from its target
            over its controlled directions [m], shape (effector_count,); NaN without a target.
        guided_poses: Where the guided bodies are sent, or are when nothing is published, by name.
        left_out: Ids of the markers whose measurement is not plausible and was left out.
        on_the_way: An effector's target is far, and was approached only.
    """

    activity: Activity
    cause: str
    result: StepResult
    command: CableCommand | None
    violated: tuple[str, ...]
    reading: TargetReading
    aims: np.ndarray
    predicted_markers: np.ndarray
    measured_markers: np.ndarray
    misfit: Misfit
    measured_effectors: np.ndarray
    tracking_errors: np.ndarray
    guided_poses: dict[str, Pose]
    left_out: tuple[int, ...] = ()
    on_the_way: bool = False


def taken_back(
    result: StepResult, before: State, released: CableCommand, simulation: Simulation
) -> StepResult:
    """A step that is told as failed, because its command could not be released.

    Args:
        result: What the step came to.
        before: The state that the model has been put back to.
        released: What stands in the command's place.
        simulation: The model, put back.

    Returns:
        The result with the state and the lengths that stand.
    """
    return replace(
        result,
        state=before,
        status=Status.UNSOLVED,
        setpoints=released.setpoints,
        efforts=released.efforts,
        displacements=simulation.rest_setpoints - released.setpoints,
        effector_positions=simulation.effector_positions(),
    )
