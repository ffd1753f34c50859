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
        self._forces, self._places = Touched.none(len(self.names))
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
        force, most = np.asarray(force, dtype=float), self._limits[touch]
        refusal = self._refused(arrival, (touch, _FORCE), _fault_of, force, 0.0, most)
        if refusal is None:
            self._keep(touch, force if np.linalg.norm(force) > 0.0 else np.nan, np.nan, arrival.time)
        return refusal

    def accept_place(self, touch: int, place, arrival: Arrival) -> Refusal | None:
        """Checks a measured place of a touched point and keeps it.

        Args:
            touch: Index of the touch.
            place: Place of the point [m], shape (3,); NaN without a touch.
            arrival: Header and time of arrival of the message.

        Returns:
            The reason to refuse it, or None. A refused place leaves the touch as it was.
        """
        place, rest = np.asarray(place, dtype=float), self._rest[touch]
        refusal = self._refused(arrival, (touch, _PLACE), _fault_of, place, rest, self._farthest)
        if refusal is None:
            self._keep(touch, np.nan, np.nan if np.isnan(place).any() else place, arrival.time)
        return refusal

    def _keep(self, touch: int, force, place, time: float) -> None:
        self._forces[touch], self._places[touch] = force, place
        self._heard[touch] = time

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


def _fault_of(vector: np.ndarray, start, most: float) -> Refusal | None:
    """The reason to refuse a vector, or None: it may be NaN, and ends so far from a start at most."""
    if refusal := refusal_of_vector(vector, may_be_nan=True):
        return refusal
    return Refusal.OUT_OF_RANGE if np.linalg.norm(vector - start) > most else None
