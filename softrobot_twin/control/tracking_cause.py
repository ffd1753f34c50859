"""Why an effector is far from its target: the first cause that applies, in words."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softrobot_twin.control.diagnostics_window import DiagnosticsWindow
from softrobot_twin.control.engagement import Activity
from softrobot_twin.control.twin_loop import TwinLoop
from softrobot_twin.simulation import Status
from softrobot_twin.simulation.result import RATE

REPORTED_SHARE = 0.03
"""A tracking error above this share of the robot's size is reported with its cause."""
OFTEN = 0.1
"""An event in more than this share of the ticks is frequent enough to be a cause."""
FAR_OFF = 0.1
"""A pressure or volume that differs from its command by more than this share of its scale is a
cause."""
_MILLI = 1.0e3
_GOES_ON = (Status.OK, Status.LINEARIZED, Status.RATE_LIMITED)
"""Statuses of steps towards a target."""


class TrackingSigns(NamedTuple):
    """The data from which a cause is derived: the ticks since the last diagnostics message.

    Attributes:
        error: Largest distance of an effector from its target [m]; NaN without a target, or
            while the loop is disabled.
        reported_above: An error up to this value is not reported [m].
        ticks: Number of ticks.
        late: Number of grid points that were missed or skipped.
        overloaded: Number of ticks with a stale factor.
        holding: Why most ticks did not follow; empty when most of them did.
        kept_back: Limits violated by commands that the gate rejected.
        worst: The most severe status.
        limits: Names of the limits that were active.
        approaching: The newest aim is a point on the line to the target, not the target itself.
        device_lag: Largest difference of a measured length or position from the command [m]; NaN
            without a measurement.
        device_off: The pressure or volume whose measurement differs most from its command, and the
            difference, in words; empty where none differs by more than `FAR_OFF`.
        closed_loop: The targets are corrected by the markers.
        markers_lost: An effector cannot be measured.
        left_out: Ids of the markers that were left out as implausible.
        correction_at_limit: The correction has its greatest allowed length.
        misfit: Distance of the measured effectors from the model's [m]; NaN without markers.
    """

    error: float
    reported_above: float
    ticks: int = 0
    late: int = 0
    overloaded: int = 0
    holding: str = ""
    kept_back: tuple[str, ...] = ()
    worst: Status = Status.OK
    limits: tuple[str, ...] = ()
    approaching: bool = False
    device_lag: float = float("nan")
    device_off: str = ""
    closed_loop: bool = False
    markers_lost: bool = False
    left_out: tuple[int, ...] = ()
    correction_at_limit: bool = False
    misfit: float = float("nan")


def tracking_cause(signs: TrackingSigns) -> str:
    """The cause of a large tracking error; empty when the error is not large.

    The order is: causes that stop the loop, causes that slow it down, errors of the model. Where
    several causes apply, the first one explains the others.

    Args:
        signs: The data since the last diagnostics message.

    Returns:
        A phrase such as ``late: 40 of 100 ticks`` or ``rate limit: north.rate``.
    """
    if not signs.error > signs.reported_above:
        return ""
    return _what_stops(signs) or _what_slows(signs) or _what_is_wrong(signs)


def _what_stops(signs: TrackingSigns) -> str:
    if signs.holding:
        return signs.holding
    if signs.kept_back:
        return "commands kept back: " + ", ".join(signs.kept_back)
    if signs.worst is Status.SATURATED and (limits := _limits_but_rates(signs)):
        return limits
    stops = signs.worst.is_failure or signs.worst is Status.UNREACHABLE
    return f"step {signs.worst.value}" if stops else ""


def _limits_but_rates(signs: TrackingSigns) -> str:
    """The active limits that are no rates, in words; empty where none is active."""
    names = [name for name in signs.limits if not name.endswith(RATE)]
    return "limit: " + ", ".join(names) if names else ""


def _what_slows(signs: TrackingSigns) -> str:
    if signs.late > OFTEN * signs.ticks:
        return f"late: {signs.late} of {signs.ticks + signs.late} ticks"
    if signs.overloaded > OFTEN * signs.ticks:
        return f"overload: {signs.overloaded} of {signs.ticks} ticks with a stale factor"
    # A slack cable at its limit does not limit the effector while other actuators still move.
    if rates := [name for name in signs.limits if name.endswith(RATE)]:
        return "rate limit: " + ", ".join(rates)
    if limits := _limits_but_rates(signs):
        return limits
    if signs.approaching and signs.worst in _GOES_ON:
        return "approaching at approach_speed"
    if signs.device_lag > signs.reported_above / 2.0:
        return f"the device differs from its command by {_MILLI * signs.device_lag:.1f} mm"
    if signs.device_off:
        return f"the device differs from its command: {signs.device_off}"
    return ""


def _what_is_wrong(signs: TrackingSigns) -> str:
    if signs.closed_loop and signs.left_out:
        return "markers left out: " + ", ".join(map(str, signs.left_out))
    if signs.closed_loop and signs.markers_lost:
        return "markers lost"
    if signs.closed_loop and signs.correction_at_limit:
        return "the correction is at correction_limit"
    if signs.misfit > signs.reported_above / 2.0:
        is_open = "" if signs.closed_loop else ", and closed_loop is off"
        return f"the model differs from the markers by {_MILLI * signs.misfit:.1f} mm{is_open}"
    return f"step {signs.worst.value}" if not signs.worst.is_success else "not settled yet"


def tracking_signs(loop: TwinLoop, window: DiagnosticsWindow, late: int) -> TrackingSigns:
    """Collects the signs from a loop and the ticks since the last diagnostics message.

    Args:
        loop: The loop.
        window: The ticks since the last diagnostics message.
        late: Number of grid points missed or skipped since then.
    """
    reported_above = REPORTED_SHARE * loop.simulation.model.nodes.size
    newest, settings = window.newest, loop.settings
    if newest is None:
        return TrackingSigns(float("nan"), reported_above)
    cause = max(window.causes, key=window.causes.get, default="")
    often = window.causes.get(cause, 0) > window.ticks / 2
    enabled = newest.activity is not Activity.DISABLED
    lag, off = _difference(loop, newest.result.setpoints)
    predicted = newest.result.effector_positions
    apart = np.linalg.norm(newest.measured_effectors - predicted, axis=1)
    offsets = np.linalg.norm(loop.correction.offsets, axis=1).max(initial=0.0)
    return TrackingSigns(
        window.tracking_error_max if enabled else float("nan"), reported_above, window.ticks, late,
        window.overloaded, cause if often else "", tuple(sorted(window.violated)), window.worst,
        tuple(sorted(window.limits)), newest.is_approaching, lag, off, settings.closed_loop,
        loop.markers_are_lost(newest.measured_markers), tuple(sorted(window.left_out)),
        bool(offsets >= 0.999 * settings.correction_limit > 0.0),
        float(np.fmax.reduce(apart, initial=float("nan"))),
    )  # fmt: skip


def _difference(loop: TwinLoop, commanded: np.ndarray) -> tuple[float, str]:
    """How far the device is from its command: `device_lag` and `device_off` of `TrackingSigns`."""
    measured, actuators = loop.device.setpoints, loop.simulation.actuators
    limits = actuators.limits
    if measured is None or not len(commanded):
        return float("nan"), ""
    apart = np.abs(measured - commanded)
    is_length = np.array([kind.setpoint.unit == "m" for kind in actuators.kinds])
    lag = float(apart[is_length].max(initial=0.0)) if is_length.any() else float("nan")
    shares = np.where(is_length, 0.0, apart / limits.travel(limits.drive_scale))
    worst = int(shares.argmax())
    if not shares[worst] > FAR_OFF:
        return lag, ""
    unit = actuators.kinds[worst].setpoint.unit
    return lag, f"{actuators.names[worst]} by {apart[worst]:.3g} {unit}"
