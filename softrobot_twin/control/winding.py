"""Who winds which cable: each cable by itself, or a motor that winds several by the same length.

A motor's position is the length of its first cable: all of its cables are as much shorter than at
rest as that one. A motor's effort is the tension of each of its cables. A slide is an actuator
like a cable; its position is how far it stands from rest, and its effort is only measured.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

# Place of an actuator that a message does not name.
UNNAMED = -1


class Order(NamedTuple):
    """How the values of a message become the values of actuators.

    Attributes:
        places: Place in the message of what winds each actuator, shape (actuator_count,); -1
            where nothing does.
        offsets: What an actuator is longer than the length that winds it [m], same shape.
    """

    places: np.ndarray
    offsets: np.ndarray

    @property
    def named(self) -> np.ndarray:
        """True where the message names an actuator, shape (actuator_count,)."""
        return self.places != UNNAMED

    def values(self, message: np.ndarray) -> np.ndarray:
        """Values of the actuators, NaN where none is named, shape (actuator_count,).

        Args:
            message: A value for each name of the message.
        """
        if not len(message):
            return np.full(len(self.places), np.nan)
        return np.where(self.named, message[self.places], np.nan)


class Winding:
    """Knows the names that a message may use, and which actuators each of them winds.

    Args:
        actuator_names: Names of cables and slides, in the order of the simulation.
        motors: Names of the cables of each motor, by the motor's name.
        rest_lengths: Lengths at rest [m], shape (actuator_count,); needed with motors.
        slide_names: Those among the actuators that are slides.

    Attributes:
        slides: True where an actuator is a slide, shape (actuator_count,).
    """

    def __init__(
        self,
        actuator_names: Sequence[str],
        motors: Mapping[str, Sequence[str]] | None = None,
        rest_setpoints: np.ndarray | None = None,
        slide_names: Sequence[str] = (),
    ):
        names = tuple(actuator_names)
        self._count = len(names)
        self._cables = {name: [index] for index, name in enumerate(names)}
        for motor, cables in (motors or {}).items():
            self._cables[motor] = [names.index(cable) for cable in cables]
        self._rest = np.zeros(self._count) if rest_setpoints is None else np.array(rest_setpoints)
        self.slides = np.array([name in slide_names for name in names], dtype=bool)

    def order_of(self, names: Sequence[str]) -> Order | None:
        """Reads the names of a message.

        Args:
            names: Names of cables, slides and motors.

        Returns:
            The order, or None when a name is unknown, or an actuator is named twice.
        """
        places = np.full(self._count, UNNAMED)
        offsets = np.zeros(self._count)
        for place, name in enumerate(names):
            cables = self._cables.get(name)
            if cables is None or (places[cables] != UNNAMED).any():
                return None
            places[cables] = place
            offsets[cables] = self._rest[cables] - self._rest[cables[0]]
        return Order(places, offsets)
