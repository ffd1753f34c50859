"""The names that a message may use: actuators, and motors that drive several cables.

All cables of a motor have the same displacement against rest. A motor's position in a message is
the length of its first cable; its effort is the effort of each of its cables.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

UNNAMED = -1
"""Index of an actuator that a message does not name."""


class NameOrder(NamedTuple):
    """How the values of a message become the values of actuators.

    Attributes:
        places: Index in the message of the value for each actuator, shape (actuator_count,); -1
            where the message has none.
        offsets: What to add to the message's setpoint, in the unit of each actuator's kind, shape
            (actuator_count,): for cables of a motor, the rest length minus that of its first cable.
    """

    places: np.ndarray
    offsets: np.ndarray

    @property
    def named(self) -> np.ndarray:
        """True for actuators that the message names, shape (actuator_count,)."""
        return self.places != UNNAMED

    def values(self, message: np.ndarray) -> np.ndarray:
        """Values of the actuators, NaN for those without a name, shape (actuator_count,).

        Args:
            message: A value for each name of the message.
        """
        if not len(message):
            return np.full(len(self.places), np.nan)
        return np.where(self.named, message[self.places], np.nan)


class ActuatorNames:
    """Maps the names in a message to actuators.

    Args:
        actuator_names: Names of the actuators, in the order of the simulation.
        motors: Names of the cables of each motor, by the motor's name.
        rest_setpoints: Setpoints at rest, in the unit of each actuator's kind, shape
            (actuator_count,); needed with motors.
        by_position: Names of the actuators that take no efforts, such as slides.
        by_pressure: Names of the cavities whose pressure is commanded.
        by_angle: Names of the cables that pulleys wind.

    Attributes:
        by_position: True for actuators that take no efforts, shape (actuator_count,).
        by_pressure: True for cavities whose pressure is commanded, same shape. They have messages
            of their own, so that a message to all actuators may omit them.
        by_angle: True for cables that pulleys wind, same shape. Angles have messages of their own,
            so that a message of setpoints may omit them.
    """

    def __init__(
        self,
        actuator_names: Sequence[str],
        motors: Mapping[str, Sequence[str]] | None = None,
        rest_setpoints: np.ndarray | None = None,
        by_position: Sequence[str] = (),
        by_pressure: Sequence[str] = (),
        by_angle: Sequence[str] = (),
    ):
        names = tuple(actuator_names)
        self._count = len(names)
        self._indices = {name: [index] for index, name in enumerate(names)}
        for motor, cables in (motors or {}).items():
            self._indices[motor] = [names.index(cable) for cable in cables]
        self._rest = np.zeros(self._count) if rest_setpoints is None else np.array(rest_setpoints)
        self.by_position = np.array([name in by_position for name in names], dtype=bool)
        self.by_pressure = np.array([name in by_pressure for name in names], dtype=bool)
        self.by_angle = np.array([name in by_angle for name in names], dtype=bool)

    def order_of(self, names: Sequence[str]) -> NameOrder | None:
        """Reads the names of a message.

        Args:
            names: Names of actuators and motors.

        Returns:
            The order, or None when a name is unknown or an actuator is named twice.
        """
        places = np.full(self._count, UNNAMED)
        offsets = np.zeros(self._count)
        for place, name in enumerate(names):
            indices = self._indices.get(name)
            if indices is None or (places[indices] != UNNAMED).any():
                return None
            places[indices] = place
            offsets[indices] = self._rest[indices] - self._rest[indices[0]]
        return NameOrder(places, offsets)
