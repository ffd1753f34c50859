"""An optional effect in one file, as a user would write it."""

import numpy as np

from softrobot_twin.simulation import Hold
from softrobot_twin.simulation.step.step_part import PartReport, StepPart


class Fatigue(StepPart):
    """Counts the steps; after each second one the actuators rest for a step."""

    name, figures = "fatigue", ("steps",)
    depends_on_time = True

    def __init__(self, model):
        self._count = 0.0
        self.conflict = "contact" if model.scene.contact is not None else ""

    def memory_at_rest(self):
        return {"steps": np.zeros(1)}

    def recall(self, state):
        (self._count,) = state.memory_of(self.name)["steps"]

    @property
    def _rests(self):
        return self._count % 3.0 == 2.0

    def command(self, command, state):
        return Hold(command.time_step) if self._rests else command

    def end(self, positions, efforts):
        return {"steps": np.array([self._count + 1.0])}

    def report(self, state, newton):
        limits = ("fatigue.rest",) if self._rests else ()
        return PartReport(limits, {"steps": self._count + 1.0})
