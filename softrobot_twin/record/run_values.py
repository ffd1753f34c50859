"""Numbers of a run as JSON, exactly, and the values by which two ticks are compared."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import fields, is_dataclass
from enum import Enum
from typing import NamedTuple

import numpy as np

from softrobot_twin.control.twin_loop import TickOutcome
from softrobot_twin.simulation import State
from softrobot_twin.tables.channels import BUILT_IN, Channel, channels

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
        path: Where it stands in a `TickOutcome`, or what reads it there; empty for its own name.
    """

    unit: str = ""
    rows: str = NOTHING
    columns: Sequence[str] = ""
    path: str | Callable[[TickOutcome], object] = ""


def of_channels(given: Iterable[Channel]) -> dict[str, Quantity]:
    """Channels as quantities of ticks: what the model tells and, with most, what is measured.

    Args:
        given: The channels.
    """
    found, rows = {}, {"effector_names": EFFECTORS, "touch_names": TOUCHES}
    for one in given:
        told = Quantity(one.unit, rows.get(one.objects, one.objects), one.parts,
                        lambda tick, one=one: one.read(tick.result))  # fmt: skip
        found[one.name] = told
        if one.most:
            found[one.measured_name] = told._replace(path=lambda tick, one=one: tick.measured[one.name])
    return found


QUANTITIES: dict[str, Quantity] = {
    "activity": Quantity(),
    "cause": Quantity(),
    "status": Quantity(path="result.status"),
    "source": Quantity(path="reading.source"),
    "is_approaching": Quantity(),
    "active_limits": Quantity(path="result.report.active_limits"),
    "violated": Quantity(),
    "left_out": Quantity(),
    "qp_solver": Quantity(path="result.report.qp_solver"),
    "command_setpoints": Quantity(SETPOINT, ACTUATORS, path="command.setpoints"),
    "command_efforts": Quantity(EFFORT, ACTUATORS, path="command.efforts"),
    "setpoints": Quantity(SETPOINT, ACTUATORS, path="result.setpoints"),
    "efforts": Quantity(EFFORT, ACTUATORS, path="result.efforts"),
    "displacements": Quantity(SETPOINT, ACTUATORS, path="result.displacements"),
    **of_channels(BUILT_IN),
    "targets": Quantity("m", EFFECTORS, "xyz", path="reading.targets"),
    "target_orientations": Quantity(ONE, EFFECTORS, "xyzw", path="reading.orientations"),
    "aims": Quantity("m", EFFECTORS, "xyz"),
    "measured_effectors": Quantity("m", EFFECTORS, "xyz"),
    "tracking_errors": Quantity("m", EFFECTORS),
    "orientation_errors": Quantity("rad", EFFECTORS),
    "stiffness_errors": Quantity(ONE, EFFECTORS, path="result.stiffness_errors"),
    "predicted_markers": Quantity("m", MARKERS, "xyz"),
    "measured_markers": Quantity("m", MARKERS, "xyz"),
    "misfit_rms": Quantity("m", path="misfit.rms"),
    "guided_poses": Quantity(path=lambda tick: {name: [*pose] for name, pose in tick.guided_poses.items()}),
    "contact_positions": Quantity("m", NOTHING, "xyz", path="result.contacts.positions"),
    "contact_forces": Quantity("N", NOTHING, "xyz", path="result.contacts.forces"),
    "residual": Quantity("N", path="result.report.residual"),
    "linearization_error": Quantity("m", path="result.report.linearization_error"),
    "iterations": Quantity(ONE, path="result.report.iterations"),
    "factor_age": Quantity(ONE, path="result.report.factor_age"),
    "is_late": Quantity(path="result.report.is_late"),
    "inverted_count": Quantity(ONE, path="result.report.inverted_count"),
    "contact_count": Quantity(ONE, path="result.report.contact_count"),
    "step_count": Quantity(ONE, path="result.state.step_count"),
    "time": Quantity("s", path="result.state.time"),
    COMPUTE_TIME: Quantity("s", path="result.report.compute_time"),
    STATE_DIGEST: Quantity(path=lambda tick: state_digest(tick.result.state)),
}
"""All that two ticks are compared by. `state_digest` stands for all nodes of the model; the time of
the computation follows from the recorded readings of the clock."""


def quantities() -> dict[str, Quantity]:
    """The same with channels from outside."""
    return QUANTITIES | of_channels(channels())


# --- JSON ----------------------------------------------------------------------------------------


def plain(value: object) -> object:
    """A value as JSON writes it: the shortest decimals that give each number back to the bit.

    JSON has no other numbers than finite ones: a NaN becomes null, ∞ a word.

    Args:
        value: A number, text, array, enumeration or dataclass, or a dict, list or tuple of these.
    """
    if isinstance(value, float):
        return value if math.isfinite(value) else None if math.isnan(value) else str(value)
    if value is None or isinstance(value, (str, int)):
        return value
    if isinstance(value, np.ndarray):
        listed = value.tolist()
        is_finite = value.dtype.kind != "f" or bool(np.isfinite(value).all())
        return listed if is_finite else plain(listed)
    if isinstance(value, Enum):
        return value.value
    if is_dataclass(value):
        return {one.name: plain(getattr(value, one.name)) for one in fields(value)}
    if isinstance(value, dict):
        return {str(key): plain(one) for key, one in value.items()}
    if isinstance(value, np.generic):
        return plain(value.item())
    return [plain(one) for one in value]


def number(value: object) -> float:
    """The number of `plain`.

    Args:
        value: What JSON holds.
    """
    return math.nan if value is None else float(value)


def numbers(value: object) -> np.ndarray:
    """The array of `plain`: null is NaN, and ``inf`` and ``-inf`` are ±∞.

    Args:
        value: What JSON holds, a list of any depth.
    """
    return np.array(value, dtype=float)


# --- ticks ---------------------------------------------------------------------------------------


def tick_values(outcome: TickOutcome) -> dict[str, object]:
    """What a tick gave, as JSON; without the quantities that its scene does not have.

    Args:
        outcome: The tick.
    """
    found = ((name, _value(outcome, one.path or name)) for name, one in quantities().items())
    return {name: plain(value) for name, value in found if value is not None}


def _value(outcome: TickOutcome, path: str | Callable[[TickOutcome], object]) -> object:
    """What stands at a path of names in an outcome; None where something on it is None."""
    if callable(path):
        return path(outcome)
    value: object = outcome
    for name in path.split("."):
        value = None if value is None else getattr(value, name)
    return value


def state_digest(state: State) -> str:
    """A word that differs for any two states, even in one bit of one node.

    Args:
        state: The state.
    """
    made = hashlib.blake2b(digest_size=16)
    for array in (state.positions, state.velocities, *state.memory.values()):
        made.update(np.ascontiguousarray(array).data)
    return made.hexdigest()
