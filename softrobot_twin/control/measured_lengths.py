"""What a device measures: lengths that the scene's actuators can have, and where they went."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from softrobot_twin.control.cable_input import CableInput
from softrobot_twin.control.loop_settings import LoopSettings
from softrobot_twin.control.refusal import Refusal
from softrobot_twin.control.winding import Order, Winding
from softrobot_twin.simulation.limits import ActuatorLimits

OUTSIDE_SHARE = 0.1
"""A measured length may be outside the limits by this share of the travel."""
OUTSIDE_SHARE_OF_REST = 0.01
"""And by this share of the length at rest, where that is more."""


class Implausible(NamedTuple):
    """A measured length that an actuator of the scene cannot have.

    Attributes:
        name: The actuator.
        value: What was measured [m].
        low: Least length believed [m].
        high: Greatest length believed [m].
    """

    name: str
    value: float
    low: float
    high: float

    def __str__(self) -> str:
        return (
            f"{self.name} measures {self.value:.6g} m, believed are {self.low:.6g} to "
            f"{self.high:.6g} m"
        )


class MeasuredLengths(CableInput):
    """Keeps the newest lengths of a device; what no actuator of the scene can have is refused.

    Believed is what the limits allow, and a tenth of the travel or a hundredth of the length at
    rest beyond them: an encoder's zero is never exact. No cable is shorter than nothing.

    Args:
        names: Names of the actuators.
        rest_lengths: Lengths that shortening counts from [m], shape (actuator_count,).
        limits: Limits of shortening.
        slide_names: Those among the actuators that are slides.
        settings: Timeouts.

    Attributes:
        implausible: What was wrong with the newest message, when that is what was; else None.
        arrived: When the newest lengths arrived [s].
    """

    def __init__(
        self, names: Sequence[str], rest_setpoints: np.ndarray, limits: ActuatorLimits,
        slide_names: Sequence[str], settings: LoopSettings,
    ):
        winding = Winding(names, slide_names=slide_names)
        travel = limits.displacement_max - limits.displacement_min
        known = np.where(np.isfinite(travel), travel, 0.0)
        beyond = np.maximum(OUTSIDE_SHARE * known, OUTSIDE_SHARE_OF_REST * rest_setpoints)
        self._low = rest_setpoints - limits.displacement_max - beyond
        self._low = np.where(winding.slides, self._low, np.maximum(self._low, 0.0))
        self._high = rest_setpoints - limits.displacement_min + beyond
        self._names = tuple(names)
        super().__init__(winding, settings)

    def reset(self) -> None:
        """Forgets what came in; the counts stay."""
        super().reset()
        self.implausible: Implausible | None = None

    def accept(
        self, names: Sequence[str], lengths, tensions, arrival
    ) -> Refusal | None:
        """Takes one message, or says why not; see `CableInput.accept`."""
        self.implausible = None
        return super().accept(names, lengths, tensions, arrival)

    @property
    def arrived(self) -> float:
        """When the newest lengths arrived [s]; minus infinity when none did."""
        return self._newest

    def _refusal_of_values(
        self, order: Order, count: int, lengths: np.ndarray, tensions: np.ndarray
    ) -> Refusal | None:
        refusal = super()._refusal_of_values(order, count, lengths, tensions)
        if refusal is not None or not len(lengths):
            return refusal
        measured = order.values(lengths) + order.offsets
        wrong = np.flatnonzero((measured < self._low) | (measured > self._high))
        if not len(wrong):
            return None
        place = int(wrong[0])
        self.implausible = Implausible(
            self._names[place], float(measured[place]), float(self._low[place]),
            float(self._high[place]),
        )  # fmt: skip
        return Refusal.OUT_OF_RANGE
