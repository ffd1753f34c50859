"""What the actuators can do: their limits, the bounds of one step, and which of them bind."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from softrobot_twin.solvers.inverse_problem import Bounds

# A length this near to its limit [m] counts as on it; a tension, this share of its limit.
LENGTH_MARGIN = 1.0e-7
TENSION_MARGIN = 1.0e-4


@dataclass(frozen=True)
class ActuatorLimits:
    """Limits of the cables, each array of shape (actuator_count,).

    Attributes:
        names: Names of the actuators.
        displacement_min: Least displacement from rest, of a cable its shortening [m].
        displacement_max: Greatest displacement from rest [m].
        rate: Greatest change of length in a second [m/s]; infinite without a limit.
        effort_min: Least effort, of a cable its tension [N].
        effort_max: Greatest effort [N].
    """

    names: tuple[str, ...]
    displacement_min: np.ndarray
    displacement_max: np.ndarray
    rate: np.ndarray
    effort_min: np.ndarray
    effort_max: np.ndarray

    def reach(self, time_step: float) -> np.ndarray:
        """How far each actuator may move in a time [m], shape (actuator_count,).

        Args:
            time_step: The time [s].
        """
        # No time, no way: without a rate limit the product would be 0 · ∞.
        return self.rate * time_step if time_step > 0.0 else np.zeros_like(self.rate)

    def bounds(self, shortening: np.ndarray, time_step: float) -> Bounds:
        """What can be reached within one time step.

        Args:
            shortening: Wound shortening at its beginning [m], shape (actuator_count,).
            time_step: Its length [s].

        Returns:
            Bounds on shortening and tension. Where the winch already stands outside its limits,
            they lead back as fast as the rate allows.
        """
        reach = self.reach(time_step)
        least, most = shortening - reach, shortening + reach
        return Bounds(
            np.minimum(np.maximum(self.displacement_min, least), most),
            np.maximum(np.minimum(self.displacement_max, most), least),
            self.effort_min,
            self.effort_max,
        )

    def binding(self, shortening: np.ndarray, tensions: np.ndarray, bounds: Bounds) -> list[str]:
        """Names of the limits that hold an actuator back.

        Args:
            shortening: Wound shortening [m], shape (actuator_count,).
            tensions: Tensions [N], shape (actuator_count,).
            bounds: Bounds of this step.

        Returns:
            Such as ``north.shortening_max``, ``east.rate``; empty when nothing binds.
        """
        found = []
        at_lower = (shortening <= bounds.displacement_min + LENGTH_MARGIN).tolist()
        at_upper = (shortening >= bounds.displacement_max - LENGTH_MARGIN).tolist()
        at_tension = (tensions >= self.effort_max * (1.0 - TENSION_MARGIN)).tolist()
        for i, name in enumerate(self.names):
            if at_upper[i]:
                limited = bounds.displacement_max[i] >= self.displacement_max[i] - LENGTH_MARGIN
                found.append(f"{name}.{'shortening_max' if limited else 'rate'}")
            elif at_lower[i]:
                limited = bounds.displacement_min[i] <= self.displacement_min[i] + LENGTH_MARGIN
                found.append(f"{name}.{'shortening_min' if limited else 'rate'}")
            if at_tension[i]:
                found.append(f"{name}.tension_max")
        return found
