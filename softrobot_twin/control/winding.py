"""Who winds which cable: each cable by itself, or a motor that winds several by the same length.

A motor's position is the length of its first cable: all of its cables are as much shorter than at
rest as that one. A motor's effort is the tension of each of its cables.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np


class Order(NamedTuple):
    """How the values of a message become the values of cables.

    Attributes:
        places: Place in the message of what winds each cable, shape (actuator_count,).
        offsets: What a cable is longer than the length that winds it [m], same shape.
    """

    places: np.ndarray
    offsets: np.ndarray


class Winding:
    """Knows the names that a message may use, and which cables each of them winds.

    Args:
        actuator_names: Names of the cables, in the order of the simulation.
        motors: Names of the cables of each motor, by the motor's name.
        rest_lengths: Cable lengths at rest [m], shape (actuator_count,); needed with motors.
    """

    def __init__(
        self,
        actuator_names: Sequence[str],
        motors: Mapping[str, Sequence[str]] | None = None,
        rest_lengths: np.ndarray | None = None,
    ):
        names = tuple(actuator_names)
        self._count = len(names)
        self._cables = {name: [index] for index, name in enumerate(names)}
        for motor, cables in (motors or {}).items():
            self._cables[motor] = [names.index(cable) for cable in cables]
        self._rest = np.zeros(self._count) if rest_lengths is None else np.array(rest_lengths)

    def order_of(self, names: Sequence[str]) -> Order | None:
        """Reads the names of a message.

        Args:
            names: Names of cables and motors.

        Returns:
            The order, or None when a name is unknown, or a cable is not wound exactly once.
        """
        places = np.full(self._count, -1)
        offsets = np.zeros(self._count)
        for place, name in enumerate(names):
            cables = self._cables.get(name)
            if cables is None or (places[cables] >= 0).any():
                return None
            places[cables] = place
            offsets[cables] = self._rest[cables] - self._rest[cables[0]]
        return Order(places, offsets) if (places >= 0).all() else None
