"""How far a body in the coordinates of a basis can be believed: the error of its reduction.

The file has spare modes, which a step does not use, and points that stand for all with
them. A second simulation has all modes in use. It takes the state with spare coordinates of zero
and steps once with the actuators held: how far its effectors move is the estimate. It is a whole
step, so cables that go slack, given volumes and contacts are as in any step, and bodies that are
unstable at fixed tensions are as stable as at held lengths. More steps change it by few per cent.

Nothing of this is in a step: the error is computed when somebody reads it, in the time of one step
of all modes. What the spare modes cannot see either, such as a load of a kind that the training
never had, only the full model tells.

For that, all nodes of the full model are placed where the coordinates of the basis have them, u = Φ q. A few
linearizations with the same setpoints, the same loads and, as a start, the same efforts bring the
full model to its own balance; how far its effectors move is the error of the reduced model. What
the basis cannot see has no part in it: it holds for loads that the training never had, where spare
modes tell too little.

It linearizes until the effectors move by less than a tenth of their distance so far (`SETTLED`).
Where the reduced model is within some per cent these are two linearizations, of which the first is
within 4 % of the truth; at twice the training range of a strongly bent Diamond two to a dozen.

A linearization of the full model takes hundreds of times as long as a step of the reduced one: this
is for the slack of a loop (`control/reduction_error_watch.py`) or for studies.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from softrobot_twin.mechanics.touch_loads import TouchState
from softrobot_twin.scene import Scene
from softrobot_twin.simulation.building.model import Model
from softrobot_twin.simulation.building.reduced_body import (
    with_reduced_entries,
    without_fallback,
    without_reductions,
)
from softrobot_twin.simulation.command import LONG, CommandSetpoints
from softrobot_twin.simulation.effects.coordinate_range import coordinate_ranges, reduced_bodies
from softrobot_twin.simulation.effects.touches import Touched
from softrobot_twin.simulation.effects.vertebrae_watch import LARGE_BY_SIZE, ReductionState
from softrobot_twin.simulation.result import StepResult
from softrobot_twin.simulation.state import State
from softrobot_twin.simulation.step.step_part import Steppable

# A linearization that moves the effectors by at most this share of their distance from the reduced
# model is the last, and the most linearizations.
SETTLED, MOST_LINEARIZATIONS = 0.1, 12


def full_scene(scene: Scene) -> Scene:
    """The scene with all nodes of its reduced bodies as unknowns, one linearization a step."""
    return without_reductions(scene).changed(solver={"newton_iterations": 1})


class FullError(NamedTuple):
    """The error of a reduced body, seen by the full model.

    Attributes:
        distance: The largest distance of an effector on it from where the full model has it [m].
        share: The largest by the displacement of the effector from rest.
    """

    distance: float
    share: float


class FullModelError:
    """Judges states of a scene with reduced bodies by its full model.

    Attributes:
        full: A simulation of the full model.
        linearizations: Linearizations that the last estimate took.
    """

    def __init__(self, simulation: Steppable):
        """Build the full model.

        Args:
            simulation: A simulation of the scene with reduced bodies; its state is not used.
        """
        self.model: Model = simulation.model
        self.linearizations = 0
        self.full = type(simulation)(full_scene(simulation.scene), with_warnings=False)

    def lifted(self, state: State) -> State:
        """A state of the reduced scene with all nodes placed by the coordinates."""
        parts, first = [], 0
        for body in reduced_bodies(self.model):
            nodes = body.reduction
            parts.append(state.positions[first : nodes.first_node])
            parts.append(nodes.mesh_positions(state.positions))
            first = nodes.first_node + nodes.node_count
        parts.append(state.positions[first:])
        return replace(state, positions=np.concatenate(parts), past=None)

    def moves(self, state: State) -> np.ndarray:
        """How far each effector moves to the balance of the full model [m].

        Args:
            state: A state of the reduced scene.

        Returns:
            Distances, shape (effector_count,); NaN where a step of the full model failed. After
            `MOST_LINEARIZATIONS` they are how far it got, which is the least that they are.
        """
        effectors, full = self.model.effectors, self.full
        self.linearizations = 0
        if effectors is None:
            return np.empty(0)
        full.restore(self.lifted(state))
        begin = places = effectors.positions(state.positions)
        for self.linearizations in range(1, MOST_LINEARIZATIONS + 1):
            before, result = places, step_held(full, state)
            if result.status.is_failure:
                return np.full(len(begin), np.nan)
            places = result.effector_positions
            moves = np.linalg.norm(places - begin, axis=1)
            last = np.linalg.norm(places - before, axis=1)
            if self.linearizations > 1 and (last <= SETTLED * moves).all():
                break
        return moves

    def errors(self, state: State) -> dict[str, FullError]:
        """Error of each reduced body, by its name; see `moves`."""
        moves = self.moves(state)
        shares = shares_of_displacement(self.model, moves, state)
        moves, shares = (largest_on_each_body(self.model, found) for found in (moves, shares))
        return {name: FullError(moves[name], shares[name]) for name in moves}


def with_spare_modes(scene: Scene) -> Scene:
    """The scene with the spare modes of its reduced bodies in use, and one linearization a step."""
    extended = with_reduced_entries(without_fallback(scene), {"spare_modes": True})
    return extended.changed(solver={"newton_iterations": 1})


def step_held(simulation: Steppable, state: State) -> StepResult:
    """One step of another model of a scene, with what holds its actuators and touches it kept.

    Args:
        simulation: The other model, in the state to step from.
        state: A state of the scene, whose setpoints and forces of touches are kept.
    """
    touched = None
    before = TouchState.of(state.memory)
    if before is not None:
        forces = before.forces
        touched = Touched(forces, np.full_like(forces, np.nan))
    return simulation.step(CommandSetpoints(state.setpoints, LONG), measured=touched)


def has_spare_modes(model: Model) -> bool:
    """Whether a reduced body has modes that are not in use."""
    return any(body.reduction.reduction.spare_count for body in reduced_bodies(model))


class ReductionErrors:
    """Estimates the error of reduced bodies by a simulation with their spare modes in use.

    Attributes:
        extended: That simulation.
    """

    def __init__(self, simulation: Steppable):
        """Build it, and find which of its nodes are those of the other.

        Args:
            simulation: The simulation that is judged.
        """
        extended = type(simulation)(with_spare_modes(simulation.scene), with_warnings=False)
        self.extended, self._model = extended, simulation.model
        self._inserted = np.empty(0, np.int64)
        for own, more in zip(simulation.model.bodies, extended.model.bodies, strict=True):
            if own.reduction is not None:
                added = (more.reduction.mode_count - own.reduction.mode_count) // 3
                self._inserted = np.append(
                    self._inserted, np.full(added, own.reduction.first_point)
                )

    def lifted(self, state: State) -> State:
        """A state of the judged simulation, with spare coordinates of zero."""
        positions = np.insert(state.positions, self._inserted, 0.0, axis=0)
        return replace(state, positions=positions, past=None)

    def moves(self, state: State) -> np.ndarray:
        """How far the spare modes would move each effector [m], shape (effector_count,).

        Args:
            state: A state of the judged simulation.

        Returns:
            Distances; NaN where the step failed.
        """
        effectors, extended = self._model.effectors, self.extended
        if effectors is None:
            return np.empty(0)
        extended.restore(self.lifted(state))
        result = step_held(extended, state)
        if result.status.is_failure:
            return np.full(len(result.effector_positions), np.nan)
        before = effectors.positions(state.positions)
        return np.linalg.norm(result.effector_positions - before, axis=1)


def shares_of_displacement(model: Model, moves: np.ndarray, state: State) -> np.ndarray:
    """Distances by the displacement of each effector from rest; NaN where it is at rest.

    Args:
        model: The scene.
        moves: A distance of each effector [m], shape (effector_count,).
        state: Its state.
    """
    effectors = model.effectors
    if effectors is None:
        return moves
    places = effectors.positions(state.positions)
    distances = np.linalg.norm(places - effectors.positions(model.nodes.rest_positions), axis=1)
    return np.divide(moves, distances, out=np.full_like(moves, np.nan), where=distances > 0.0)


def reduced_states(
    model: Model, state: State, errors: ReductionErrors | None
) -> dict[str, ReductionState]:
    """How far each body in the coordinates of a basis can be believed at a state, by its name.

    Args:
        model: The scene.
        state: Its state.
        errors: Estimates the error; None without spare modes.
    """
    moves = shares = np.full(len(model.scene.effectors), np.nan)
    if errors is not None:
        moves = errors.moves(state)
        shares = shares_of_displacement(model, moves, state)
    moves, shares = (largest_on_each_body(model, values) for values in (moves, shares))
    return {
        body.name: ReductionState(
            coordinates.share(state.positions), moves[body.name],
            *map(float, body.reduction.reduction.measured), shares[body.name],
            LARGE_BY_SIZE * model.nodes.size,
        )
        for body, coordinates in zip(reduced_bodies(model), coordinate_ranges(model), strict=True)
    }  # fmt: skip


def largest_on_each_body(model: Model, values: np.ndarray) -> dict[str, float]:
    """The largest value of the effectors that judge each reduced body, by its name.

    Args:
        model: The scene.
        values: One of each effector, shape (effector_count,).

    Returns:
        Of the effectors on it, else of all; NaN where one is, and without effectors.
    """
    only, entries, found = len(model.bodies) == 1, model.scene.effectors, {}
    for body in reduced_bodies(model):
        own = [entry.body == body.name or (entry.body is None and only) for entry in entries]
        chosen = values[own] if any(own) else values
        found[body.name] = float(chosen.max()) if len(chosen) else float("nan")
    return found
