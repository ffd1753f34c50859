"""Parts of a step: optional effects around it, which are no force and no row of their own.

A force or a row is a term, inside of the step. What else a scene may name is a part: it may remember
something from step to step, replace the command, tell of loads, and report. `Simulation.step` asks
all parts in turn and knows none of them; `effects.py` lists them.

A `Steppable` is what other models of a scene, which judge or replace a simulation, use of it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any, NamedTuple, Protocol, TypeVar

import numpy as np

from softrobot_twin.scene import Scene
from softrobot_twin.simulation.building.limits import ActuatorLimits
from softrobot_twin.simulation.building.model import Model
from softrobot_twin.simulation.command import Command, FollowTargets
from softrobot_twin.simulation.result import StepResult
from softrobot_twin.simulation.state import State
from softrobot_twin.simulation.step.follower import Follower
from softrobot_twin.simulation.step.linearized import LinearizedState
from softrobot_twin.simulation.step.newton import Newton
from softrobot_twin.simulation.step.situation import NO_LOADS
from softrobot_twin.simulation.step.time_budget import StageClock

Kind = TypeVar("Kind")


class PartReport(NamedTuple):
    """What a part tells of a step.

    Attributes:
        limits: Names of limits that bind.
        figures: The part's `figures` by their names.
        entries: Entries of the step's report by their names; see `StepReport`.
        readings: Entries of the step's result by their names; see `StepResult`.
        misses: What effectors miss beside their targets after and before the step [m], each of
            shape (effector_count,), zero where nothing is asked; empty if nothing is.
        is_trusted: False where the state cannot be believed, so that the command does not count as
            carried out.
    """

    limits: tuple[str, ...] = ()
    figures: Mapping[str, float] = {}
    entries: Mapping[str, object] = {}
    readings: Mapping[str, np.ndarray] = {}
    misses: tuple[np.ndarray, ...] = ()
    is_trusted: bool = True


class StepPart:
    """An optional effect of a step. A method that a part does not define does nothing.

    Attributes:
        name: Key of its memory and of its report.
        figures: Names of what it reports of each step, which end in their units; tables, results,
            records and ``~/figures`` of a twin show them.
        takes: Class of what it takes of a step's measurements; empty if it needs none.
        samples: Measurements that change nothing, by which all that a step may need of it is compiled.
        may_rest: Whether a state in balance may be kept while the command stays.
        depends_on_time: Whether it matters how long actuators are held.
        holds_robot: Whether it holds the robot at places, where none but the hand's stiffness shows.
        loads: Its forces on the robot [N], shape (n,).
        load: Sum of these by magnitude [N].
        entry: Key and value of the scene's entry that asks for it; its name by default.
        conflict: With what of its scene it is not built; empty if it is.
        refusal: Why it is refused, with a place for the conflict.
    """

    name: str
    figures: tuple[str, ...] = ()
    takes: type | tuple[()] = ()
    samples: tuple = ()
    may_rest: bool = True
    depends_on_time: bool = False
    holds_robot: bool = False
    loads: np.ndarray = NO_LOADS
    load: float = 0.0
    entry: tuple[str, str] = ("", "")
    conflict: str = ""
    refusal: str = "is not built beside {}"

    def memory_at_rest(self) -> dict[str, np.ndarray]:
        """What it remembers of a robot at rest, by field; steps change values, not shapes."""
        return {}

    def recall(self, state: State) -> None:
        """Take its memory from the state where a step begins.

        Args:
            state: The state.
        """

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

    def command(self, command: Command, state: State) -> Command:
        """The command that is carried out, in place of one that is asked.

        Args:
            command: The command that is asked.
            state: The state where the step begins.
        """
        return command

    def rows(self, state: LinearizedState, command: FollowTargets) -> Any:
        """Its rows of the inverse problem, below those of the effectors; see `Follower`.

        Args:
            state: The linearized state.
            command: The targets that are followed.

        Returns:
            The rows; None if it wants none now.
        """

    def end(self, positions: np.ndarray, efforts: np.ndarray) -> dict[str, np.ndarray]:
        """What it remembers of a step, with the fields of `memory_at_rest`.

        Args:
            positions: Node positions where the step ended [m], shape (node_count, 3).
            efforts: Efforts of the actuators there, in their units, shape (actuator_count,).
        """
        return {}

    def reset(self) -> None:
        """Begin where the robot is in its rest shape."""

    def restore(self, state: State) -> None:
        """Begin where a saved state is put back.

        Args:
            state: The saved state.
        """

    def may_keep(self, before: State, after: State) -> bool:
        """Whether a step between two states in balance changed nothing of it.

        Args:
            before: State where the step began.
            after: State where it ended.
        """
        now = after.memory_of(self.name)
        return all(np.array_equal(one, now[field]) for field, one in before.memory_of(self.name).items())

    def report(self, state: State, newton: Newton) -> PartReport:
        """What it tells of the step that led to a state.

        Args:
            state: The state where the step ended.
            newton: Made the last linearization of the step.
        """
        return PartReport()


class Planner:
    """Looks for better places while a robot rests, beside its steps; this one for none."""

    def forget(self) -> None:
        """Forget the steps before; the state tells all that the next one depends on."""

    def warm_up(self, simulation: Steppable) -> None:
        """Build and compile what `plan` needs.

        Args:
            simulation: The simulation.
        """

    def steps_until_rest(self, command: FollowTargets, result: StepResult) -> int:
        """Steps towards targets that must keep the state before further ones need not be made.

        Args:
            command: The targets that are followed.
            result: Result of the last step towards them.
        """
        return 0

    def rest(self, simulation: Steppable, command: FollowTargets, result: StepResult) -> None:
        """See that further steps towards the same targets need not be made.

        Args:
            simulation: The simulation.
            command: What is asked.
            result: The result that they would have.
        """

    def staying(self, simulation: Steppable, command: Command, measured: list) -> StepResult | None:
        """The result of a step that is not made, since the robot stays.

        Args:
            simulation: The simulation, before the step.
            command: What is asked.
            measured: All that is measured; see `Simulation.step`.

        Returns:
            The result; None where the step is to be made as usual.
        """
        return None

    def plan(self, simulation: Steppable) -> np.ndarray | None:
        """Look on, about as long as one step takes.

        Args:
            simulation: The simulation, between two steps; it stays as it is.

        Returns:
            Where the actuators shall go first, displacements, or efforts of what is driven by them, shape
            (actuator_count,); None to stay, or where nothing is looked for.
        """
        return None


class Leader:
    """Brings bodies after what a step prescribes; this one where nothing is prescribed.

    Attributes:
        prescribes: Whether it may move bodies before a step is linearized.
    """

    prescribes = False

    def places(self, positions: np.ndarray) -> np.ndarray:
        """Coordinates of what is prescribed [m], shape (n,); another pose is another task.

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        return NO_LOADS

    def lead(
        self, simulation: Steppable, positions: np.ndarray, efforts: np.ndarray, time_step: float,
        clock: StageClock,
    ) -> bool:  # fmt: skip
        """Bring the bodies after it, where one linearization cannot.

        Args:
            simulation: The simulation, whose state is that before the step.
            positions: Node positions after what is prescribed has moved [m], shape (node_count, 3);
                moved.
            efforts: Efforts of the actuators before the step, shape (actuator_count,).
            time_step: h [s].
            clock: Books the stages.

        Returns:
            Whether all that is prescribed is reached; else it goes on in the next step.
        """
        return True


def one_of(parts: Iterable[StepPart], kind: type[Kind]) -> Kind:
    """The part that is a planner or a leader; one that does nothing where none is.

    Args:
        parts: All parts of a simulation.
        kind: The class.
    """
    return next((part for part in parts if isinstance(part, kind)), kind())


def those_with(parts: Iterable[StepPart], *methods: str) -> tuple[StepPart, ...]:
    """The parts that define one of some methods: a step asks no others for it.

    Args:
        parts: All parts of a simulation.
        *methods: Names of the methods.
    """
    return tuple(part for part in parts if any(
        getattr(type(part), method) is not getattr(StepPart, method) for method in methods
    ))  # fmt: skip


def parts_by_method(parts: Iterable[StepPart]) -> dict[str, tuple[StepPart, ...]]:
    """The parts that define each method; see `those_with`.

    Args:
        parts: All parts of a simulation.
    """
    return {method: those_with(parts, method) for method in vars(StepPart) if method[0] != "_"}


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
        self._term.recall(state.memory_of(self.name), state.positions, state.efforts)

    def end(self, positions: np.ndarray, efforts: np.ndarray) -> dict[str, np.ndarray]:
        """See `StepPart`."""
        return self._term.memory_after(positions, efforts)


def memories_of_terms(model: Model) -> Iterator[StepPart]:
    """The parts of all terms that remember.

    Args:
        model: The model of a simulation.
    """
    names: dict[str, int] = {}
    for term in (*(force.on_points for force in model.forces), *model.actuators.terms):
        if term.memory_name:
            number = names[term.memory_name] = names.get(term.memory_name, -1) + 1
            yield TermMemory(term, f"{term.memory_name}_{number}")


class Steppable(Protocol):
    """A `Simulation`; see there."""

    model: Model
    parts: tuple
    newton: Newton
    inverse: Follower | None
    state: State
    now: Callable[[], float]
    is_balanced: bool
    mounted: Any

    def __init__(
        self, scene: Scene, now: Callable[[], float] = ..., *, with_warnings: bool, mounted: Any = None
    ): ...

    @property
    def scene(self) -> Scene: ...

    @property
    def limits(self) -> ActuatorLimits: ...

    def step(
        self, command: Command, budget: float | None = None, measured: object | None = None
    ) -> StepResult: ...

    def asks_as(self, before: Command, command: Command) -> bool: ...

    def come_near(
        self, positions: np.ndarray, efforts: np.ndarray, time_step: float, clock: StageClock
    ) -> np.ndarray | None: ...

    def reset(self) -> None: ...

    def restore(self, state: State) -> None: ...

    def take_over(self, other: Steppable) -> None: ...

    def warm_up(self) -> None: ...

    def effector_positions(self) -> np.ndarray: ...
