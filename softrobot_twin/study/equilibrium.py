"""Brings a simulation to rest at given setpoints, in steps from where it stands."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softrobot_twin.simulation import (
    CommandEfforts,
    CommandSetpoints,
    Simulation,
    Status,
    StepResult,
    Touched,
)

# Steps of the way to the setpoints, and most steps after it.
WAY, MOST_STEPS = 10, 200
# In motion the way takes as long as the rates allow, and steps have this duration [s].
TIME_STEP, MOST_STEPS_IN_MOTION = 0.05, 600
# In statics a step takes any time: no rate limits it [s].
ANY_TIME = 1.0e6
# At rest no effector or surface moves further in a step than this share of the robot's size.
STILL = 1.0e-7
# A step that fails so often in a row fails for ever.
MOST_FAILURES = 3


class Rest(NamedTuple):
    """Where a simulation came to rest, or where its last step ended.

    Attributes:
        result: The last step.
        is_reached: Whether it is at rest there, in equilibrium and at the setpoints.
    """

    result: StepResult
    is_reached: bool

    @property
    def status(self) -> str:
        """Status of the last step; ``not_converged`` where it succeeded and rest is not reached."""
        status = self.result.status
        if self.is_reached or not (status.is_success or status is Status.RATE_LIMITED):
            return status.value
        return "not_converged"


def bring_to_rest(
    simulation: Simulation, setpoints: np.ndarray, way: int = WAY, efforts: np.ndarray | None = None,
    touched: Touched | None = None,
) -> Rest:  # fmt: skip
    """Move the actuators on a straight line to setpoints, then step until nothing moves.

    Args:
        simulation: The simulation, at any state.
        setpoints: Each in the unit of its kind, shape (actuator_count,).
        way: Steps of the way.
        efforts: With which actuators act in place of setpoints, NaN for the others, shape
            (actuator_count,); None for no efforts.
        touched: Forces that act meanwhile; see `Simulation.step`.
    """
    in_motion = simulation.model.is_dynamic
    time_step = TIME_STEP if in_motion else ANY_TIME
    begin, failures = simulation.state.setpoints.copy(), 0
    count = way + (MOST_STEPS_IN_MOTION if in_motion else MOST_STEPS)
    for index in range(1, count + 1):
        share = min(1.0, index / way)
        # At the end exactly the setpoints.
        wanted = setpoints if share == 1.0 else begin + share * (setpoints - begin)
        before = simulation.state.positions
        command = (CommandSetpoints(wanted, time_step) if efforts is None
                   else CommandEfforts(share * efforts, time_step))
        result = simulation.step(command, None, touched)
        failures = failures + 1 if result.status.is_failure else 0
        if failures == MOST_FAILURES:
            break
        if index >= way and is_at_rest(simulation, result, before):
            return Rest(result, True)
    return Rest(result, False)


def is_at_rest(simulation: Simulation, result: StepResult, before: np.ndarray) -> bool:
    """Whether a step moved nothing, in balance and at the setpoints or at limits of the actuators.

    Args:
        simulation: Just after the step.
        result: Of the step.
        before: Node positions before it [m], shape (node_count, 3).
    """
    if result.status.is_failure or result.status is Status.RATE_LIMITED:
        return False
    if result.report.residual > simulation.scene.solver.residual_tolerance:
        return False
    size = simulation.model.nodes.size
    still = STILL * (size if np.isfinite(size) else 1.0)
    return bool(np.abs(simulation.state.positions - before).max(initial=0.0) <= still)
