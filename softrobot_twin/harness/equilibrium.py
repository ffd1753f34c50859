"""Brings a simulation to rest at given setpoints, in steps from where it stands.

`FollowedPoses` does so for several poses while numbers of the scene change.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from softrobot_twin.analysis.sensitivities import Sensitivities, Sensitivity
from softrobot_twin.scene import Scene
from softrobot_twin.scene.scene_parameters import JointParameter, Parameter, changed_scene, joint_changes
from softrobot_twin.simulation import (
    CommandEfforts,
    CommandSetpoints,
    Simulation,
    State,
    Status,
    StepResult,
    Touched,
)
from softrobot_twin.simulation.mounting import Mounted

# Steps of the way to the setpoints, and most steps after it.
WAY, MOST_STEPS = 10, 200
# In motion the way takes as long as the rates allow, and steps have this duration [s].
TIME_STEP, MOST_STEPS_IN_MOTION = 0.05, 600
# In statics a step takes any time: no rate limits it [s].
ANY_TIME = 1.0e6
# At rest no effector or surface moves further in a step than this share of the robot's size.
STILL = 1.0e-7
# A step that fails so often in a row fails for ever.
MOST_FAILURES = 3


class Rest(NamedTuple):
    """Where a simulation came to rest, or where its last step ended.

    Attributes:
        result: The last step.
        is_reached: Whether it is at rest there, in equilibrium and at the setpoints.
    """

    result: StepResult
    is_reached: bool

    @property
    def status(self) -> str:
        """Status of the last step; ``not_converged`` where it succeeded and rest is not reached."""
        status = self.result.status
        if self.is_reached or not (status.is_success or status is Status.RATE_LIMITED):
            return status.value
        return "not_converged"


def bring_to_rest(
    simulation: Simulation, setpoints: np.ndarray, way: int = WAY, efforts: np.ndarray | None = None,
    touched: Touched | None = None,
) -> Rest:  # fmt: skip
    """Move the actuators on a straight line to setpoints, then step until nothing moves.

    Args:
        simulation: The simulation, at any state.
        setpoints: Each in the unit of its kind, shape (actuator_count,).
        way: Steps of the way.
        efforts: With which actuators act in place of setpoints, NaN for the others, shape
            (actuator_count,); None for no efforts.
        touched: Forces that act meanwhile; see `Simulation.step`.
    """
    in_motion = simulation.model.is_dynamic
    time_step = TIME_STEP if in_motion else ANY_TIME
    begin, failures = simulation.state.setpoints.copy(), 0
    count = way + (MOST_STEPS_IN_MOTION if in_motion else MOST_STEPS)
    for index in range(1, count + 1):
        share = min(1.0, index / way)
        # At the end exactly the setpoints.
        wanted = setpoints if share == 1.0 else begin + share * (setpoints - begin)
        before = simulation.state.positions
        command = (CommandSetpoints(wanted, time_step) if efforts is None
                   else CommandEfforts(share * efforts, time_step))
        result = simulation.step(command, None, touched)
        failures = failures + 1 if result.status.is_failure else 0
        if failures == MOST_FAILURES:
            break
        if index >= way and is_at_rest(simulation, result, before):
            return Rest(result, True)
    return Rest(result, False)


def is_at_rest(simulation: Simulation, result: StepResult, before: np.ndarray) -> bool:
    """Whether a step moved nothing, in balance and at the setpoints or at limits of the actuators.

    Args:
        simulation: Just after the step.
        result: Of the step.
        before: Node positions before it [m], shape (node_count, 3).
    """
    is_on_way = result.status.is_failure or result.status is Status.RATE_LIMITED
    if is_on_way or result.report.residual > simulation.scene.solver.residual_tolerance:
        return False
    still = STILL * simulation.model.nodes.finite_size
    if not np.abs(simulation.state.positions - before).max(initial=0.0) <= still:
        return False
    # A short step moves little, and so does a long one of a robot that creeps or turns back.
    return _residual_of_statics(simulation) <= simulation.scene.solver.residual_tolerance


def _residual_of_statics(simulation: Simulation) -> float:
    """Largest force out of balance on a node [N] without inertia and damping, with relaxed materials."""
    model, state = simulation.model, simulation.state
    starting = [term for term in model.forces if term.remembers_start]
    if not starting:
        return 0.0
    forces, largest = np.zeros((model.nodes.free_node_count, 3)), np.zeros(1)
    for term in starting:
        term.begin_step(state.positions, forces, np.inf)  # The next step begins them again.
    for term in model.forces:
        term.add_forces(state.positions, forces)
    model.rows.tell_efforts(state.efforts)
    model.rows.evaluate(state.positions)
    model.rows.add_forces(model.rows.multipliers(state.efforts), forces)
    model.nodes.write_largest(forces, True, largest)
    return float(largest[0])


class _Near(NamedTuple):
    """Where a pose rested.

    Attributes:
        simulation: In which it did.
        values: Of the numbers, shape (number_count,).
        state: Where.
        by_numbers: Derivatives there or at an earlier rest; None for unknown ones.
    """

    simulation: Simulation
    values: np.ndarray
    state: State
    by_numbers: Sensitivity | None


class FollowedPoses:
    """Brings poses to rest while numbers of their scene change.

    A pose begins where it rested with the numbers before, moved by its derivatives where these are known.

    Attributes:
        begin: The scene with the first values.
        scene: With the present values.
        simulation: Of what is simulated in its place.
        tangent: Its sensitivities.
        values: Of the numbers, each in its unit, shape (number_count,).
    """

    def __init__(
        self, scene: Scene, numbers: Sequence[Parameter | JointParameter],
        simulated: Callable[[Scene], Scene] = lambda scene: scene,
    ):  # fmt: skip
        """Build the simulation.

        Args:
            scene: The scene.
            numbers: What changes.
            simulated: Gives the scene that is simulated in place of one with the numbers.
        """
        self.begin, self._numbers, self._simulated = scene, tuple(numbers), simulated
        self.values = np.array([one.read(scene) for one in numbers])
        self._near: dict[Hashable, _Near] = {}
        self._build(scene, None)

    def _build(self, scene: Scene, mounted: Mounted | None) -> None:
        self.simulation = Simulation(self._simulated(scene), with_warnings=False, mounted=mounted)
        self.scene = scene
        self.tangent = Sensitivities(self.simulation)
        self._rested: dict[Hashable, State] = {}

    def stay(self, pose: Hashable) -> None:
        """Lets a pose begin from the present state, as long as the numbers stay.

        Args:
            pose: Any name of it.
        """
        self._rested[pose] = self.simulation.state

    def scene_at(self, values: np.ndarray) -> Scene:
        """The scene with other values of the numbers.

        Args:
            values: Each in its unit, shape (number_count,).

        Raises:
            SceneError: The scene does not take a value.
        """
        return changed_scene(self.begin, joint_changes(self.begin, self._numbers, values))

    def take(self, values: np.ndarray) -> None:
        """Builds the simulation with these values, unless it has them.

        Args:
            values: See `scene_at`.

        Raises:
            SceneError: The scene does not take a value.
        """
        if not np.array_equal(values, self.values):
            self._build(self.scene_at(values), self.simulation.mounted)
            self.values = np.array(values, float)

    def knows(self, pose: Hashable) -> bool:
        """Whether it is known where a pose rested.

        Args:
            pose: Any name of it.
        """
        return pose in self._near

    def settle(
        self, pose: Hashable, setpoints: np.ndarray, efforts: np.ndarray | None = None,
        touched: Touched | None = None,
    ) -> Rest:  # fmt: skip
        """Brings the simulation to rest at a pose, from where it rested before, else from rest.

        Args:
            pose: Any name of it.
            setpoints: See `bring_to_rest`.
            efforts: See there.
            touched: See there.
        """
        near, simulation = self._near.get(pose), self.simulation
        if pose in self._rested:
            simulation.restore(self._rested[pose])
            if (rest := bring_to_rest(simulation, setpoints, 1, efforts, touched)).is_reached:
                return rest
        if near is None:
            simulation.reset()
            return bring_to_rest(simulation, setpoints, WAY, efforts, touched)
        if near.by_numbers is not None:
            simulation.take_over(near.simulation, self._moved(near, near.by_numbers))
            if (rest := bring_to_rest(simulation, setpoints, 1, efforts, touched)).is_reached:
                return rest
        simulation.take_over(near.simulation, near.state)
        return bring_to_rest(simulation, setpoints, 1, efforts, touched)

    def _moved(self, near: _Near, found: Sensitivity) -> State:
        """A state, moved by its derivatives to the present values."""
        change = self.values - near.values
        positions = near.state.positions.copy()
        near.simulation.model.nodes.advance(positions, found.moves @ change, 1.0)
        return replace(near.state, positions=positions, efforts=near.state.efforts + found.efforts @ change)

    def keep(self, pose: Hashable, state: State, by_numbers: Sensitivity | None = None) -> None:
        """Lets a pose begin from a state of the simulation next time.

        Args:
            pose: Any name of it.
            state: The state.
            by_numbers: Its derivatives; None where these are unknown: those before are near.
        """
        before = self._near.get(pose)
        if by_numbers is None and before is not None:
            by_numbers = before.by_numbers
        self._near[pose] = _Near(self.simulation, self.values, state, by_numbers)
