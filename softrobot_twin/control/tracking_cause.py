"""Why an effector is far from its target: the first cause that applies, in plain words."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softrobot_twin.control.activity import Activity
from softrobot_twin.control.tally import Tally
from softrobot_twin.control.twin_loop import TwinLoop
from softrobot_twin.simulation import Status

TOLD_SHARE = 0.03
"""A tracking error above this share of the robot's size is told, with its cause."""
OFTEN = 0.1
"""What happens in more than this share of the ticks is often enough to be a cause."""
_MILLI = 1.0e3


class TrackingSigns(NamedTuple):
    """What a cause is read from: the ticks since the last account.

    Attributes:
        error: Largest distance of an effector from its target [m]; NaN without a target, or
            where nothing may move.
        told_above: An error up to here is not told [m].
        ticks: Ticks.
        late: Grid points that were missed or skipped.
        overloaded: Ticks with a stale factor.
        holding: Why most ticks did not follow; empty when most of them did.
        kept_back: Limits that commands broke which the last gate kept back.
        worst: The gravest status.
        limits: Names of the limits that were active.
        on_the_way: The newest aim is not the target yet: it is approached.
        device_lag: Largest difference of a measured length from the command [m]; NaN without.
        closed_loop: The targets are corrected by the markers.
        markers_lost: An effector cannot be measured.
        left_out: Ids of the markers that were left out as implausible.
        correction_at_limit: The correction is as long as it may be.
        misfit: Distance of the measured effectors from the believed ones [m]; NaN without.
    """

    error: float
    told_above: float
    ticks: int = 0
    late: int = 0
    overloaded: int = 0
    holding: str = ""
    kept_back: tuple[str, ...] = ()
    worst: Status = Status.OK
    limits: tuple[str, ...] = ()
    on_the_way: bool = False
    device_lag: float = float("nan")
    closed_loop: bool = False
    markers_lost: bool = False
    left_out: tuple[int, ...] = ()
    correction_at_limit: bool = False
    misfit: float = float("nan")


def tracking_cause(signs: TrackingSigns) -> str:
    """The cause of a large tracking error; empty when the error is not large.

    The order is from what stops the loop, over what slows it down, to what the model gets wrong:
    where several apply, the first explains the others.

    Args:
        signs: What was seen since the last account.

    Returns:
        Such as ``late: 40 of 100 ticks`` or ``rate limit: north.rate``.
    """
    if not signs.error > signs.told_above:
        return ""
    return _what_stops(signs) or _what_slows(signs) or _what_is_wrong(signs)


def _what_stops(signs: TrackingSigns) -> str:
    if signs.holding:
        return signs.holding
    if signs.kept_back:
        return "commands kept back: " + ", ".join(signs.kept_back)
    return f"step {signs.worst.value}" if signs.worst.is_failure else ""


def _what_slows(signs: TrackingSigns) -> str:
    if signs.late > OFTEN * signs.ticks:
        return f"late: {signs.late} of {signs.ticks + signs.late} ticks"
    if signs.overloaded > OFTEN * signs.ticks:
        return f"overload: {signs.overloaded} of {signs.ticks} ticks with a stale factor"
    rates = [name for name in signs.limits if name.endswith(".rate")]
    others = [name for name in signs.limits if name not in rates]
    # A cable that hangs slack at its limit holds nothing back, as long as others still move.
    if rates and signs.worst is not Status.SATURATED:
        return "rate limit: " + ", ".join(rates)
    if others:
        return "limit: " + ", ".join(others)
    if signs.on_the_way:
        return "on the way, at approach_speed"
    if signs.device_lag > signs.told_above / 2.0:
        return f"the device is {_MILLI * signs.device_lag:.1f} mm off its command"
    return ""


def _what_is_wrong(signs: TrackingSigns) -> str:
    if signs.closed_loop and signs.left_out:
        return "markers left out: " + ", ".join(map(str, signs.left_out))
    if signs.closed_loop and signs.markers_lost:
        return "markers lost"
    if signs.closed_loop and signs.correction_at_limit:
        return "the correction is at correction_limit"
    if signs.misfit > signs.told_above / 2.0:
        opened = "" if signs.closed_loop else ", and closed_loop is off"
        return f"the model is {_MILLI * signs.misfit:.1f} mm off the markers{opened}"
    return f"step {signs.worst.value}" if not signs.worst.is_success else "not settled yet"


def tracking_signs(loop: TwinLoop, tally: Tally, late: int) -> TrackingSigns:
    """Collects the signs from a loop and what happened since the last account.

    Args:
        loop: The loop.
        tally: What happened since the last account.
        late: Grid points missed or skipped since then.
    """
    told_above = TOLD_SHARE * loop.simulation.model.nodes.size
    newest, settings = tally.newest, loop.settings
    if newest is None:
        return TrackingSigns(float("nan"), told_above)
    cause = max(tally.causes, key=tally.causes.get, default="")
    often = tally.causes.get(cause, 0) > tally.ticks / 2
    asked = newest.activity is not Activity.DISABLED
    lag = float("nan")
    if loop.device.setpoints is not None and len(newest.result.setpoints):
        lag = float(np.abs(loop.device.setpoints - newest.result.setpoints).max())
    believed = newest.result.effector_positions
    apart = np.linalg.norm(newest.measured_effectors - believed, axis=1)
    offsets = np.linalg.norm(loop.correction.offsets, axis=1).max(initial=0.0)
    return TrackingSigns(
        tally.tracking_error_max if asked else float("nan"), told_above, tally.ticks, late,
        tally.overloaded, cause if often else "", tuple(sorted(tally.violated)), tally.worst,
        tuple(sorted(tally.limits)), newest.on_the_way, lag, settings.closed_loop,
        loop.markers_are_lost(newest.measured_markers), tuple(sorted(tally.left_out)),
        bool(offsets >= 0.999 * settings.correction_limit > 0.0),
        float(np.fmax.reduce(apart, initial=float("nan"))),
    )  # fmt: skip
