"""Reactions: the forces and torques by which supports hold the parts of a robot.

They are what a load cell under the robot shows: the residual at the nodes that the model holds, see
`released_supports`. A step that keeps a state keeps its reactions too.
"""

from __future__ import annotations

import numpy as np

from softrobot_twin.simulation.building.model import Model
from softrobot_twin.simulation.building.released_supports import ReleasedSupports
from softrobot_twin.simulation.command import Command
from softrobot_twin.simulation.state import State
from softrobot_twin.simulation.step.step_part import StepPart, memories_of_terms


class Reactions(StepPart):
    """Tells the reactions that a scene names, in its memory."""

    name = "reactions"

    def __init__(self, model: Model):
        """Build what is evaluated after each step.

        Args:
            model: The built scene.
        """
        self._supports = ReleasedSupports(model)
        self._memories = tuple(memories_of_terms(self._supports))
        self._before: State | None = None
        self._time_step = np.inf

    def memory_at_rest(self) -> dict[str, np.ndarray]:
        """See `StepPart`: nothing is known before the first step."""
        return {"wrenches": np.full((len(self._supports.supports), 6), np.nan)}

    def recall(self, state: State) -> None:
        """See `StepPart`."""
        self._before = state

    def command(self, command: Command, state: State) -> Command:
        """See `StepPart`; notes how long the step takes."""
        self._time_step = command.time_step
        return command

    def end(self, positions: np.ndarray, efforts: np.ndarray) -> dict[str, np.ndarray]:
        """See `StepPart`."""
        before = self._before
        for memory in self._memories:
            memory.recall(before)
        self._supports.begin_step(before.positions, positions, before.velocities, self._time_step)
        return {"wrenches": self._supports.wrenches(positions, efforts)}

    def may_keep(self, before: State, after: State) -> bool:
        """See `StepPart`; reactions are those of the state."""
        return bool(np.isfinite(before.memory_of(self.name)["wrenches"]).all())
