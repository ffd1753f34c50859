"""Whether a device stands where it was sent, or was away and came back somewhere else."""

from __future__ import annotations

import numpy as np

from softrobot_twin.control.measured_lengths import MeasuredLengths
from softrobot_twin.simulation.limits import ActuatorLimits

LAG_RATE = 3.0
"""A device that follows strays from its command by this many times the actuators' rates at most."""
LAG_TIME = 0.05
"""So fast it strays for no longer than this [s]; after that it stands at worst, and its command
goes on at the actuators' rates."""
LAG_SHARE = 0.02
"""And by this share of the travel, for noise; nearer it is where it was sent."""


class DeviceWatch:
    """Finds out that a device is not where the commands left it, so that it is not driven on.

    A device that was lost is compared with the last command when it is heard again. One that was
    restarted faster than that is found by its leap: it moves away from its command faster than
    any that follows, however late, can.

    Args:
        limits: Rates and travels of the actuators.

    Attributes:
        is_on_the_way: A device that `has_moved` is on the way to its command: it was only unheard.
    """

    def __init__(self, limits: ActuatorLimits):
        self._rate = limits.rate
        # How far a cable may be let out can be without limit, how far it is wound in never is.
        least = np.where(np.isfinite(limits.displacement_min), limits.displacement_min, 0.0)
        travel = limits.displacement_max - least
        self._noise = LAG_SHARE * np.where(np.isfinite(travel), travel, np.inf)
        self.forget()

    def forget(self) -> None:
        """Knows nothing of the device, as before it was resynchronised."""
        self._was_lost = False
        self._arrived = -np.inf
        self._lag: np.ndarray | None = None
        self._measured: np.ndarray | None = None
        self.is_on_the_way = False

    def has_moved(
        self, device: MeasuredLengths, lost: bool, commanded: np.ndarray, reach: np.ndarray
    ) -> bool:
        """Whether the device is somewhere else than where it was sent. Asked once a tick.

        Args:
            device: What it measures.
            lost: It is not heard now.
            commanded: Lengths that it was sent to last [m], shape (actuator_count,).
            reach: How far actuators may move in a tick [m], same shape.
        """
        if lost or device.setpoints is None:
            self._was_lost, self._lag = True, None
            return False
        lag = np.abs(device.setpoints - commanded)
        before, since = self._lag, device.arrived - self._arrived
        if self._was_lost:
            self._was_lost = False
            self.is_on_the_way = self._is_between(device.setpoints, commanded)
            self._lag, self._arrived = lag, device.arrived
            self._measured = device.setpoints
            return bool((lag > np.minimum(reach, self._noise)).any())
        if since <= 0.0:
            return False
        self._lag, self._arrived = lag, device.arrived
        self._measured, self.is_on_the_way = device.setpoints, False
        if before is None:
            return False
        allowed = self._rate * max(LAG_RATE * min(since, LAG_TIME), since) + self._noise
        return bool((lag - before > allowed).any())

    def _is_between(self, lengths: np.ndarray, commanded: np.ndarray) -> bool:
        """True for lengths between those measured before and the command [m]."""
        if self._measured is None:
            return False
        low = np.minimum(self._measured, commanded) - self._noise
        high = np.maximum(self._measured, commanded) + self._noise
        return bool(((lengths >= low) & (lengths <= high)).all())
