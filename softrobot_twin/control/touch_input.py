"""Touches of a robot as they are measured: forces and places on topics, and their timeouts."""

from __future__ import annotations

import math
from itertools import product

import numpy as np

from softrobot_twin.control.arrival import Arrival, Input, Refusal, refusal_of_vector
from softrobot_twin.control.loop_settings import LoopSettings
from softrobot_twin.simulation import Simulation, Touched

_SENDERS = _FORCE, _PLACE = "force", "place"
FARTHEST = 1.0 / 3.0
"""A touched point may be measured this far from where it is at rest, as a share of the robot's size."""


class TouchInput(Input):
    """The newest measured force or place of each touch; whichever came last counts.

    A touch ends by a force of zero, by a NaN in either message, or without a message for
    `touch_timeout`.

    Args:
        simulation: The model, at rest.
        frame_id: The only frame in which touches are accepted.
        settings: Timeouts.

    Attributes:
        timed_out: How many touches ended because no message came.
    """

    def __init__(self, simulation: Simulation, frame_id: str, settings: LoopSettings):
        self.timed_out = 0
        self.names = simulation.touch_names
        self._limits = np.array([touch.force_limit for touch in simulation.scene.touches])
        touches = simulation.touches
        self._rest = np.empty((0, 3)) if touches is None else np.array(touches.points)
        self._farthest = FARTHEST * simulation.model.nodes.size
        # A touch has two senders with clocks of their own.
        super().__init__(settings, frame_id, product(range(len(self.names)), _SENDERS))

    def reset(self) -> None:
        """Ends all touches; the counts stay."""
        super().reset()
        shape = (len(self.names), 3)
        self._forces, self._places = np.full(shape, np.nan), np.full(shape, np.nan)
        self._heard = np.full(len(self.names), -math.inf)

    def accept_force(self, touch: int, force, arrival: Arrival) -> Refusal | None:
        """Checks a measured force and keeps it.

        Args:
            touch: Index of the touch.
            force: Force on the robot [N], shape (3,); zero or NaN without a touch.
            arrival: Header and time of arrival of the message.

        Returns:
            The reason to refuse it, or None. A refused force leaves the touch as it was.
        """
        force = np.asarray(force, dtype=float)
        refusal = self._headers[touch, _FORCE].refusal(arrival)
        refusal = refusal or refusal_of_vector(force, may_be_nan=True)
        size = float(np.linalg.norm(force)) if refusal is None else 0.0
        if refusal is None and size > self._limits[touch]:
            refusal = Refusal.OUT_OF_RANGE
        if refusal is not None:
            return self.refusals.add(refusal)
        ends = not size > 0.0
        self._keep(touch, _FORCE, np.nan if ends else force, np.nan, arrival)
        return None

    def accept_place(self, touch: int, place, arrival: Arrival) -> Refusal | None:
        """Checks a measured place of a touched point and keeps it.

        Args:
            touch: Index of the touch.
            place: Place of the point [m], shape (3,); NaN without a touch.
            arrival: Header and time of arrival of the message.

        Returns:
            The reason to refuse it, or None. A refused place leaves the touch as it was.
        """
        place = np.asarray(place, dtype=float)
        refusal = self._headers[touch, _PLACE].refusal(arrival)
        refusal = refusal or refusal_of_vector(place, may_be_nan=True)
        if refusal is None and np.linalg.norm(place - self._rest[touch]) > self._farthest:
            refusal = Refusal.OUT_OF_RANGE
        if refusal is not None:
            return self.refusals.add(refusal)
        self._keep(touch, _PLACE, np.nan, np.nan if np.isnan(place).any() else place, arrival)
        return None

    def _keep(self, touch: int, sender: str, force, place, arrival: Arrival) -> None:
        self._remember(arrival, (touch, sender))
        self._forces[touch], self._places[touch] = force, place
        self._heard[touch] = arrival.time

    def read(self, now: float) -> Touched | None:
        """The touches at a time on the clock of `Arrival.time` [s]; None where nothing touches."""
        if not self.names:
            return None
        touching = ~np.isnan(self._forces).all(axis=1) | ~np.isnan(self._places).all(axis=1)
        late = touching & (now - self._heard > self.settings.touch_timeout)
        if late.any():
            self.timed_out += int(late.sum())
            self._forces[late], self._places[late] = np.nan, np.nan
        if not (touching & ~late).any():
            return None
        return Touched(self._forces.copy(), self._places.copy())
