"""Angles of pulleys in messages of their own; elsewhere cables have lengths."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from softrobot_twin.control.arrival import Arrival, Input, Refusal
from softrobot_twin.control.inputs import ActuatorInput
from softrobot_twin.control.loop_settings import LoopSettings
from softrobot_twin.simulation.building.limits import Pulleys


class AngleInput(Input):
    """Angles of any pulleys, as commands or as measurements.

    A message concerns the pulleys that it names; everything else stays as it is.

    Args:
        pulleys: The pulleys.
        keeper: Keeps the lengths of their cables beside the setpoints of the other actuators, and
            counts the refusals.
        settings: Timeouts.
        takes_torques: Whether torques beside the angles are kept, as of measurements; a command by
            torques is refused.
    """

    def __init__(
        self, pulleys: Pulleys, keeper: ActuatorInput, settings: LoopSettings, takes_torques: bool
    ):
        self._pulleys, self._keeper = pulleys, keeper
        self._takes_torques = takes_torques
        super().__init__(settings, None, refusals=keeper.refusals)

    def accept(
        self, names: Sequence[str], angles, torques, arrival: Arrival
    ) -> Refusal | None:
        """Checks one message and keeps its angles; all of them, or none.

        Args:
            names: Names of pulleys, each at most once.
            angles: Angle of each [rad].
            torques: Torque of each about its axis [N m], or empty.
            arrival: Header and time of arrival of the message.

        Returns:
            The reason to refuse it, or None.
        """
        angles, torques = np.asarray(angles, dtype=float), np.asarray(torques, dtype=float)
        return self._refused(arrival, None, self._put, names, angles, torques, arrival.time)

    def _put(
        self, names: Sequence[str], angles: np.ndarray, torques: np.ndarray, time: float
    ) -> Refusal | None:
        """Passes values on to the keeper; the reason to refuse them, or None."""
        if refusal := self._fault_of(names, angles, torques):
            return refusal
        pulleys = self._pulleys
        places = [pulleys.names.index(name) for name in names]
        driven = np.concatenate([pulleys.driven[place] for place in places])
        lengths = np.concatenate(list(map(pulleys.lengths, places, angles)))
        refusal = self._keeper.put(driven, lengths, time)
        if refusal is None and len(torques):
            tensions = np.concatenate(list(map(pulleys.tensions, places, torques)))
            self._keeper.put_efforts(driven, tensions)
        return refusal

    def _fault_of(
        self, names: Sequence[str], angles: np.ndarray, torques: np.ndarray
    ) -> Refusal | None:
        unknown = any(name not in self._pulleys.names for name in names)
        if not len(names) or unknown or len(set(names)) != len(names):
            return Refusal.WRONG_NAMES
        if len(torques) and (not self._takes_torques or not len(angles)):
            return Refusal.WRONG_FIELDS
        if len(angles) != len(names) or len(torques) not in (0, len(names)):
            return Refusal.WRONG_SIZE
        if not (np.isfinite(angles).all() and np.isfinite(torques).all()):
            return Refusal.NOT_FINITE
        return None
