"""Parts of a step: optional effects around it, which are no force and no row of their own.

A force or a row is a term, inside of the step. What else a scene may name is a part: it may remember
something from step to step, replace the command, tell of loads, and report. `Simulation.step` asks
all parts in turn and knows none of them; `effects.py` lists them.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import NamedTuple

import numpy as np

from softrobot_twin.simulation.building.model import Model
from softrobot_twin.simulation.command import Command
from softrobot_twin.simulation.state import State


class PartReport(NamedTuple):
    """What a part tells of a step.

    Attributes:
        limits: Names of limits that bind.
        figures: Figures by their names, which end in their units.
    """

    limits: tuple[str, ...] = ()
    figures: Mapping[str, float] = {}


class StepPart:
    """An optional effect of a step. A method that a part does not define does nothing.

    Attributes:
        name: Key of its memory and of its report.
        takes: Class of what it takes of a step's measurements; None if it needs none.
        may_rest: Whether a state in balance may be kept while the command stays.
        depends_on_time: Whether it matters how long actuators are held.
        hides_stiffness: Whether the robot shows no stiffness of its own now.
        load: Sum of its forces on the robot by magnitude [N].
    """

    name: str
    takes: type | None = None
    may_rest: bool = True
    depends_on_time: bool = False
    hides_stiffness: bool = False
    load: float = 0.0

    def why_not(self) -> str:
        """With what of its scene it is not built; empty if it is."""
        return ""

    @property
    def loads(self) -> np.ndarray | None:
        """Its forces on the robot [N], shape (n,); None if it has none at all."""
        return None

    def memory_at_rest(self) -> dict[str, np.ndarray]:
        """What it remembers of a robot at rest, by field; steps change values, not shapes."""
        return {}

    def recall(self, state: State) -> None:
        """Take its memory from the state where a step begins."""

    def begin(self, state: State, measured: object | None) -> bool:
        """Look at what is measured in a step.

        Args:
            state: Where the step begins.
            measured: What is measured, of the class that it `takes`, or None.

        Returns:
            Whether the stiffness is another than in the step before.

        Raises:
            CommandError: What is measured does not fit the scene.
        """
        return False

    def measurements_to_warm_up(self, state: State) -> Iterable[object]:
        """Measurements at rest by which everything that a step may need of it is compiled."""
        return ()

    def command(self, command: Command, state: State) -> Command:
        """The command that is carried out, in place of one that is asked."""
        return command

    def end(self, positions: np.ndarray, efforts: np.ndarray) -> dict[str, np.ndarray]:
        """What it remembers of a step, with the fields of `memory_at_rest`.

        Args:
            positions: Node positions where the step ended [m], shape (node_count, 3).
            efforts: Efforts of the actuators there, in their units, shape (actuator_count,).
        """
        return {}

    def may_keep(self, before: State, after: State) -> bool:
        """Whether a step between two states in balance changed nothing of it."""
        return all(np.array_equal(array, after.memory[key]) for key, array in self.own(before))

    def report(self, state: State) -> PartReport:
        """What it tells of the step that led to a state."""
        return PartReport()

    def own(self, state: State) -> Iterator[tuple[str, np.ndarray]]:
        """Keys and arrays of its memory in a state."""
        start = f"{self.name}."
        return ((key, array) for key, array in state.memory.items() if key.startswith(start))

    def recalled(self, state: State) -> dict[str, np.ndarray]:
        """Its memory in a state, by field."""
        return {key.removeprefix(f"{self.name}."): array for key, array in self.own(state)}

    def remembered(self, fields: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Memory by field, with the keys that it has in a state."""
        return {f"{self.name}.{field}": array for field, array in fields.items()}


class TermMemory(StepPart):
    """The memory of a term whose forces depend on the steps before."""

    def __init__(self, term, name: str):
        """Take the term.

        Args:
            term: It has the methods `memory_at_rest`, `recall` and `memory_after`.
            name: Key of the memory.
        """
        self._term, self.name = term, name
        self.may_rest, self.depends_on_time = term.may_rest, True

    def memory_at_rest(self) -> dict[str, np.ndarray]:
        """See `StepPart`."""
        return self._term.memory_at_rest()

    def recall(self, state: State) -> None:
        """See `StepPart`."""
        self._term.recall(self.recalled(state), state.positions, state.efforts)

    def end(self, positions: np.ndarray, efforts: np.ndarray) -> dict[str, np.ndarray]:
        """See `StepPart`."""
        return self._term.memory_after(positions, efforts)


def memories_of_terms(model: Model) -> Iterator[StepPart]:
    """The parts of all terms that remember."""
    names: dict[str, int] = {}
    for term in (*(force.on_points for force in model.forces), *model.actuators.terms):
        if term.memory_name:
            number = names[term.memory_name] = names.get(term.memory_name, -1) + 1
            yield TermMemory(term, f"{term.memory_name}_{number}")
