"""Numbers of a run as JSON, exactly, and the values by which two ticks are compared."""

from __future__ import annotations

import hashlib
import math
from enum import Enum
from typing import NamedTuple

import numpy as np

from softrobot_twin.control.twin_loop import TickOutcome
from softrobot_twin.simulation import State, StepResult

ACTUATORS, EFFECTORS, MARKERS, TOUCHES, NOTHING = "actuators", "effectors", "markers", "touches", ""
"""What the rows of a quantity belong to."""
SETPOINT, EFFORT = "setpoint", "effort"
"""Units that depend on the kind of each actuator."""
ONE = "1"
COMPUTE_TIME, STATE_DIGEST = "compute_time", "state_digest"


class Quantity(NamedTuple):
    """What a tick gives.

    Attributes:
        unit: Its unit, or `SETPOINT` or `EFFORT`: that of each actuator; empty for words, `ONE` for
            numbers without a unit.
        rows: What its rows belong to.
        columns: What the columns of a row mean.
    """

    unit: str = ""
    rows: str = NOTHING
    columns: str = ""

    @property
    def is_number(self) -> bool:
        """Whether two of them can be subtracted."""
        return bool(self.unit)


QUANTITIES: dict[str, Quantity] = {
    "activity": Quantity(),
    "cause": Quantity(),
    "status": Quantity(),
    "source": Quantity(),
    "is_approaching": Quantity(),
    "active_limits": Quantity(),
    "violated": Quantity(),
    "left_out": Quantity(),
    "qp_solver": Quantity(),
    "command_setpoints": Quantity(SETPOINT, ACTUATORS),
    "command_efforts": Quantity(EFFORT, ACTUATORS),
    "setpoints": Quantity(SETPOINT, ACTUATORS),
    "efforts": Quantity(EFFORT, ACTUATORS),
    "displacements": Quantity(SETPOINT, ACTUATORS),
    "effector_positions": Quantity("m", EFFECTORS, "xyz"),
    "effector_orientations": Quantity(ONE, EFFECTORS, "xyzw"),
    "effector_stiffness": Quantity("N/m", EFFECTORS, "xyz"),
    "targets": Quantity("m", EFFECTORS, "xyz"),
    "target_orientations": Quantity(ONE, EFFECTORS, "xyzw"),
    "aims": Quantity("m", EFFECTORS, "xyz"),
    "measured_effectors": Quantity("m", EFFECTORS, "xyz"),
    "tracking_errors": Quantity("m", EFFECTORS),
    "orientation_errors": Quantity("rad", EFFECTORS),
    "stiffness_errors": Quantity(ONE, EFFECTORS),
    "predicted_markers": Quantity("m", MARKERS, "xyz"),
    "measured_markers": Quantity("m", MARKERS, "xyz"),
    "misfit_rms": Quantity("m"),
    "guided_poses": Quantity(),
    "contact_positions": Quantity("m", NOTHING, "xyz"),
    "contact_forces": Quantity("N", NOTHING, "xyz"),
    "touch_forces": Quantity("N", TOUCHES, "xyz"),
    "touch_displacements": Quantity("m", TOUCHES, "xyz"),
    "residual": Quantity("N"),
    "linearization_error": Quantity("m"),
    "iterations": Quantity(ONE),
    "factor_age": Quantity(ONE),
    "is_late": Quantity(),
    "inverted_count": Quantity(ONE),
    "contact_count": Quantity(ONE),
    "figures": Quantity(),
    "step_count": Quantity(ONE),
    "time": Quantity("s"),
    COMPUTE_TIME: Quantity("s"),
    STATE_DIGEST: Quantity(),
}
"""All that two ticks are compared by. `state_digest` stands for all nodes of the model; the time of
the computation follows from the recorded readings of the clock."""


# --- JSON ----------------------------------------------------------------------------------------


def plain(value: object) -> object:
    """A value as JSON writes it: the shortest decimals that give each number back to the bit.

    JSON has no other numbers than finite ones: a NaN becomes null, ∞ a word.
    """
    if isinstance(value, float):
        return value if math.isfinite(value) else _word(value)
    if value is None or isinstance(value, (str, int)):
        return value
    if isinstance(value, np.ndarray):
        listed = value.tolist()
        is_finite = value.dtype.kind != "f" or bool(np.isfinite(value).all())
        return listed if is_finite else plain(listed)
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, dict):
        return {str(key): plain(one) for key, one in value.items()}
    if isinstance(value, np.generic):
        return plain(value.item())
    return [plain(one) for one in value]


def _word(value: float) -> str | None:
    if math.isnan(value):
        return None
    return "inf" if value > 0.0 else "-inf"


def number(value: object) -> float:
    """The number of `plain`."""
    return math.nan if value is None else float(value)


def numbers(value: object) -> np.ndarray:
    """The array of `plain`: null is NaN, and ``inf`` and ``-inf`` are ±∞."""
    return np.array(value, dtype=float)


# --- ticks ---------------------------------------------------------------------------------------


def tick_values(outcome: TickOutcome) -> dict[str, object]:
    """What a tick gave, as JSON; without the quantities that its scene does not have.

    Args:
        outcome: The tick.
    """
    result, command, reading = outcome.result, outcome.command, outcome.reading
    values = {
        "activity": outcome.activity.value,
        "cause": outcome.cause,
        "command_setpoints": None if command is None else command.setpoints,
        "command_efforts": None if command is None else command.efforts,
        "violated": outcome.violated,
        "targets": reading.targets,
        "target_orientations": reading.orientations,
        "source": reading.source,
        "aims": outcome.aims,
        "predicted_markers": outcome.predicted_markers,
        "measured_markers": outcome.measured_markers,
        "misfit_rms": outcome.misfit.rms,
        "measured_effectors": outcome.measured_effectors,
        "tracking_errors": outcome.tracking_errors,
        "orientation_errors": outcome.orientation_errors,
        "guided_poses": {
            name: [pose.position, pose.quaternion] for name, pose in outcome.guided_poses.items()
        },
        "left_out": outcome.left_out,
        "is_approaching": outcome.is_approaching,
        **_result_values(result),
    }
    return {name: plain(value) for name, value in values.items() if value is not None}


def _result_values(result: StepResult) -> dict[str, object]:
    report, contacts, touches = result.report, result.contacts, result.touches
    return {
        "status": result.status,
        "setpoints": result.setpoints,
        "efforts": result.efforts,
        "displacements": result.displacements,
        "effector_positions": result.effector_positions,
        "effector_orientations": result.effector_orientations,
        "effector_stiffness": result.effector_stiffness,
        "stiffness_errors": result.stiffness_errors,
        "contact_positions": None if contacts is None else contacts.positions,
        "contact_forces": None if contacts is None else contacts.forces,
        "touch_forces": None if touches is None else touches.forces,
        "touch_displacements": None if touches is None else touches.displacements,
        "residual": report.residual,
        "linearization_error": report.linearization_error,
        "iterations": report.iterations,
        "active_limits": report.active_limits,
        "factor_age": report.factor_age,
        "is_late": report.is_late,
        "inverted_count": report.inverted_count,
        "contact_count": report.contact_count,
        "qp_solver": report.qp_solver,
        "figures": dict(report.figures) or None,
        "step_count": result.state.step_count,
        "time": result.state.time,
        COMPUTE_TIME: report.compute_time,
        STATE_DIGEST: state_digest(result.state),
    }


def state_digest(state: State) -> str:
    """A word that differs for any two states, even in one bit of one node."""
    made = hashlib.blake2b(digest_size=16)
    for array in (state.positions, state.velocities, *state.memory.values()):
        made.update(np.ascontiguousarray(array).data)
    return made.hexdigest()
