"""The closed loop: targets moved by what the model got wrong."""

from __future__ import annotations

import math

import numpy as np

from softrobot_twin.control.clock_steps import NANOSECONDS
from softrobot_twin.control.loop_settings import LoopSettings
from softrobot_twin.simulation import Status

# On the way, at a limit or failed: what is missing is not the model's error, and winding it up
# would have to be unwound later.
_WOUND_UP = frozenset(
    {
        Status.RATE_LIMITED,
        Status.SATURATED,
        Status.UNREACHABLE,
        Status.NOT_CONVERGED,
        Status.INVERTED,
        Status.REFUSED,
        Status.UNSOLVED,
        Status.DIVERGED,
    }
)


# Markers show what was commanded about one measurement before. An integrator delayed like that
# swings when a measurement takes in the whole error, and settles fastest with a quarter of it.
GREATEST_SHARE = 0.4
"""Most that one measurement may take in of the error, however slow measurements come."""


class TargetCorrection:
    """A discrete integrator with anti-windup: c ← c + k_i Δt (target − measured effector).

    It takes a step for each measurement, not for each tick: what was seen once counts once. It is
    clamped to a greatest length. Where an actuator cannot follow, it takes only what makes
    it shorter. Without a measurement it stays as it is: the last correction is still the best
    guess of the model's error.

    Args:
        effector_count: Effectors of the simulation.

    Attributes:
        offsets: Correction c of each target [m], shape (effector_count, 3).
    """

    def __init__(self, effector_count: int):
        self.offsets = np.zeros((effector_count, 3))
        self._stamp = 0

    def tick(
        self, settings: LoopSettings, following: bool, stamp: int, errors: np.ndarray,
        status: Status,
    ) -> None:
        """Closes the loop with each new measurement, or lets the correction fade when open.

        Args:
            settings: Whether the loop is closed, gain and limit.
            following: Whether the effectors are led to targets now.
            stamp: Time of the newest measurement [ns]; what is not new is not taken in again.
            errors: See `update`.
            status: How the last step ended.
        """
        since, self._stamp = (stamp - self._stamp) / NANOSECONDS, stamp
        if not settings.closed_loop:
            self.fade(settings.period, settings.correction_gain)
        elif following and since != 0.0:
            self.update(
                errors, abs(since), status, settings.correction_gain, settings.correction_limit
            )

    def update(
        self, errors: np.ndarray, time_step: float, status: Status, gain: float, limit: float
    ) -> None:
        """Integrates one measurement.

        Args:
            errors: Target minus measured effector [m], shape (effector_count, 3); NaN in a row
                without a measurement, 0 in a direction that is not controlled.
            time_step: Time since the measurement before [s].
            status: How the last step ended.
            gain: k_i [1/s].
            limit: Greatest length of a correction [m].
        """
        for offset, error in zip(self.offsets, errors, strict=True):
            if not np.isfinite(error).all():
                continue
            candidate = offset + min(gain * time_step, GREATEST_SHARE) * error
            length = float(np.linalg.norm(candidate))
            if length > limit:
                candidate *= limit / length
            if status in _WOUND_UP and np.linalg.norm(candidate) >= np.linalg.norm(offset):
                continue
            offset[:] = candidate

    def fade(self, time_step: float, gain: float) -> None:
        """Lets the correction die away as fast as it grows, when the loop is opened."""
        self.offsets *= math.exp(-gain * time_step)

    def reset(self) -> None:
        """Starts again from no correction."""
        self.offsets[:] = 0.0
