"""What the sensors of a robot would show after each step, and how far off wanted values are."""

from __future__ import annotations

import numpy as np

from softrobot_twin.simulation.building.model import Model
from softrobot_twin.simulation.building.sensor_kinds import SENSOR_KINDS, in_order, kind_of
from softrobot_twin.simulation.state import State
from softrobot_twin.simulation.step.step_part import StepPart


class Sensing(StepPart):
    """Tells what sensors show, in its memory: an array for each quantity, such as ``length``."""

    name = "sensors"

    def __init__(self, model: Model):
        """Take the sensors.

        Args:
            model: A scene with sensors.
        """
        self._sensors, self._rest = model.sensors, model.nodes.rest_positions
        words = [SENSOR_KINDS[kind_of(one)].quantity.word for _, one in in_order(model.scene)]
        self._places = {word: np.flatnonzero([own == word for own in words]) for word in dict.fromkeys(words)}

    def memory_at_rest(self) -> dict[str, np.ndarray]:
        """See `StepPart`."""
        return self.end(self._rest, np.empty(0))

    def end(self, positions: np.ndarray, efforts: np.ndarray) -> dict[str, np.ndarray]:
        """See `StepPart`."""
        shown = self._sensors.readings(positions)
        return {word: shown[places, None] for word, places in self._places.items()}

    def may_keep(self, before: State, after: State) -> bool:
        """See `StepPart`; what is shown follows from the state."""
        return True
