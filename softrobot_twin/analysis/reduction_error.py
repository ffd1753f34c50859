"""How far a reduced body can be believed: the error of its reduction.

**Coordinates of a basis**: the file has spare modes, which a step does not use, and points that stand for all with
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

**Vertebrae** have no estimate in a step: their command compares them with the full model at fresh states,
and a step tells whether the state is inside of the range in which they were sampled.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from softrobot_twin.mechanics.reduced_points import ReducedPoints
from softrobot_twin.mechanics.touch_loads import TouchState
from softrobot_twin.scene import Scene
from softrobot_twin.scene.scene_changes import without_reductions
from softrobot_twin.simulation import CommandSetpoints, Simulation, State, StepResult
from softrobot_twin.simulation.building.deformable_body import of_kind
from softrobot_twin.simulation.building.model import Model
from softrobot_twin.simulation.building.vertebrae import VertebraBody
from softrobot_twin.simulation.command import LONG
from softrobot_twin.simulation.effects.touches import Touched
from softrobot_twin.simulation.effects.trusted_ranges import coordinate_ranges, reduced_bodies

# A linearization that moves the effectors by at most this share of their distance from the reduced
# model is the last, and the most linearizations.
SETTLED, MOST_LINEARIZATIONS = 0.1, 12
# An error is large above this share of the displacement and this one of the robot's size.
LARGE_SHARE, LARGE_BY_SIZE = 0.05, 0.001


class BodyError(NamedTuple):
    """The error of a reduced body, seen by a better model.

    Attributes:
        distance: The largest distance of an effector on it from where the better model has it [m].
        share: The largest by the displacement of the effector from rest.
    """

    distance: float
    share: float


UNKNOWN = BodyError(float("nan"), float("nan"))


class BetterModel:
    """Judges states of a scene with reduced bodies by a better model of the scene.

    Attributes:
        model: The scene with reduced bodies.
        better: A simulation of the better model, one linearization a step.
        linearizations: Linearizations that the last estimate took.
    """

    def __init__(self, simulation: Simulation, scene: Scene, most_linearizations: int):
        """Build the better model.

        Args:
            simulation: A simulation of the scene with reduced bodies; its state is not used.
            scene: The scene of the better model.
            most_linearizations: Most linearizations of an estimate.
        """
        self.model: Model = simulation.model
        one_each = scene.changed(solver={"newton_iterations": 1})
        self.better = Simulation(one_each, with_warnings=False)
        self.linearizations, self._most = 0, most_linearizations

    def lifted(self, state: State) -> State:
        """A state of the scene with reduced bodies for the better model.

        What follows the bodies among the nodes stays.

        Args:
            state: State of the scene with reduced bodies.
        """
        parts, first = [], 0
        for body, same in zip(self.model.bodies, self.better.model.bodies, strict=True):
            parts.append(same.nodes_as(body, state.positions))
            first += body.scene_node_count
        positions = np.concatenate([*parts, state.positions[first:]])
        for kind in self.better.model.nodes.kinds:
            if isinstance(kind, ReducedPoints):
                kind.place(positions)
        return replace(state, positions=positions)

    def moves(self, state: State) -> np.ndarray:
        """How far each effector moves to the balance of the better model [m].

        Args:
            state: A state of the scene with reduced bodies.

        Returns:
            Distances, shape (effector_count,); NaN where a step of the better model failed. After the
            most linearizations they are how far it got, which is the least that they are.
        """
        effectors, better = self.model.effectors, self.better
        self.linearizations = 0
        if not effectors.effectors:
            return np.empty(0)
        better.restore(self.lifted(state))
        begin = places = effectors.positions(state.positions)
        for self.linearizations in range(1, self._most + 1):
            before, result = places, step_held(better, state)
            if result.status.is_failure:
                return np.full(len(begin), np.nan)
            places = result.effector_positions
            moves = np.linalg.norm(places - begin, axis=1)
            last = np.linalg.norm(places - before, axis=1)
            if self.linearizations > 1 and (last <= SETTLED * moves).all():
                break
        return moves

    def errors(self, state: State) -> dict[str, BodyError]:
        """Error of each reduced body, by its name; see `moves`."""
        moves = self.moves(state)
        shares = shares_of_displacement(self.model, moves, state)
        moves, shares = (largest_on_each_body(self.model, found) for found in (moves, shares))
        return {name: BodyError(moves[name], shares[name]) for name in moves}


class FullModelError(BetterModel):
    """The error by the full model, with all nodes of its reduced bodies as unknowns."""

    def __init__(self, simulation: Simulation):
        """Build the full model of a simulation's scene."""
        scene = without_reductions(simulation.scene)
        super().__init__(simulation, scene, MOST_LINEARIZATIONS)


class ReductionErrors(BetterModel):
    """The error by the spare modes of the reduced bodies, in one linearization."""

    def __init__(self, simulation: Simulation):
        """Build a simulation with the spare modes in use."""
        scene = simulation.scene.with_deformables({"reduced": {"spare_modes": True}})
        super().__init__(simulation, scene, 1)


def step_held(simulation: Simulation, state: State) -> StepResult:
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
    """Whether a reduced body has modes that are not in use, which can judge its balance.

    Args:
        model: The model of a simulation. In motion there is no balance to judge.
    """
    bodies = () if model.is_dynamic else reduced_bodies(model)
    return any(body.reduction.basis.shape[2] > body.reduction.mode_count for body in bodies)


def shares_of_displacement(model: Model, moves: np.ndarray, state: State) -> np.ndarray:
    """Distances by the displacement of each effector from rest; NaN where it is at rest.

    Args:
        model: The scene.
        moves: A distance of each effector [m], shape (effector_count,).
        state: Its state.
    """
    effectors = model.effectors
    places = effectors.positions(state.positions)
    distances = np.linalg.norm(places - effectors.positions(model.nodes.rest_positions), axis=1)
    return np.divide(moves, distances, out=np.full_like(moves, np.nan), where=distances > 0.0)


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
        own = [entry.body == body.name or (only and not entry.body) for entry in entries]
        chosen = values[own] if any(own) else values
        found[body.name] = float(chosen.max()) if len(chosen) else float("nan")
    return found


class ReductionState(NamedTuple):
    """How far a reduced body can be believed.

    Attributes:
        range: Share of the range in which it was sampled; above 1 the state is outside of it. The
            largest over all superelements; of a body in the coordinates of a basis see
            `trusted_ranges.py`.
        error: Estimate of how far off the worst effector is, by modes that are not in use [m]; NaN
            without effectors or spare modes, and of vertebrae.
        measured_median: Error against the full model by the displacement, as the command found it
            over the whole range; NaN where it was not compared.
        measured_worst: The largest of these.
        share: The error by the displacement of the effector; NaN of vertebrae.
        negligible: An error that is too small to be told [m].
    """

    range: float
    error: float
    measured_median: float
    measured_worst: float
    share: float = float("nan")
    negligible: float = 0.0

    @property
    def doubt(self) -> str:
        """Why the body should not be believed here, in words; empty where nothing speaks against it.

        Range and error judge together: each sees poses that the other misses.
        """
        is_measured = self.measured_worst == self.measured_worst
        most = self.measured_worst if is_measured else LARGE_SHARE
        reasons = ["outside of the range of its reduction"] if self.range > 1.0 else []
        if self.share > most and self.error > self.negligible:
            known = f" ({100.0 * most:.2g} % at the worst fresh state)" if is_measured else ""
            reasons.append(f"{100.0 * self.share:.2g} % of the displacement off by its spare modes" + known)
        return " and ".join(reasons)


class ReductionStates:
    """Tells how far the reduced bodies of a simulation can be believed where it stands."""

    def __init__(self, simulation: Simulation):
        """Keep the simulation; its spare modes are built at the first reading of errors.

        Args:
            simulation: The simulation.
        """
        self._simulation, self._bodies = simulation, reduced_bodies(simulation.model)
        self._errors: ReductionErrors | None = None

    def read(self, with_errors: bool = True) -> dict[str, ReductionState]:
        """How far each reduced body can be believed now, by its name.

        Args:
            with_errors: Whether errors of bodies in the coordinates of a basis are estimated, which
                takes the time of a step with the spare modes; else they are NaN.
        """
        model, state = self._simulation.model, self._simulation.state
        found = {name: _of_vertebrae(model, name, state.positions) for name in model.superelements}
        if with_errors and self._errors is None and has_spare_modes(model):
            self._errors = ReductionErrors(self._simulation)
        errors = self._errors.errors(state) if with_errors and self._errors else {}
        for body, coordinates in zip(self._bodies, coordinate_ranges(model), strict=True):
            error = errors.get(body.name, UNKNOWN)
            found[body.name] = ReductionState(
                coordinates.share(state.positions), error.distance, *map(float, body.reduction.measured),
                error.share, LARGE_BY_SIZE * model.nodes.size,
            )  # fmt: skip
        return found


def _of_vertebrae(model: Model, name: str, positions: np.ndarray) -> ReductionState:
    """How far a body that is reduced to vertebrae can be believed, by its name."""
    superelements = model.superelements[name]
    reduction = next(body.reduction for body in of_kind(model.bodies, VertebraBody) if body.name == name)
    superelements.evaluate(positions)
    return ReductionState(
        float(superelements.ranges.max(initial=0.0)), float("nan"), *map(float, reduction.measured))
