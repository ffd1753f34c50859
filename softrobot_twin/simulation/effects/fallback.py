"""Another model of a scene, to which a simulation changes where its reduced bodies are too wrong.

A scene names the wanted error of a reduced body and what is fallen back to: the same basis with its
spare modes (``enrich``), or all nodes (``full_model``). Both models are built with the scene. Every
`CHECK_EVERY` steps the other one takes the state, steps once with the actuators held, and tells how
far its effectors move. Above the wanted error the simulation goes on with the better model, and it
goes back where the difference is below half of it.

Both models have the same actuators, so setpoints and efforts go over as they are, and limits of
rates hold through the change. To more modes, coordinates stay and spare ones begin at zero; all nodes
begin where the coordinates place them. Back, coordinates are those of the nearest shape of the basis.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from softrobot_twin.errors import SceneError
from softrobot_twin.scene import Scene
from softrobot_twin.scene.scene_changes import with_entries
from softrobot_twin.simulation.building.deformable_body import Body
from softrobot_twin.simulation.building.model import Model
from softrobot_twin.simulation.command import Command
from softrobot_twin.simulation.effects.reduction_error import (
    in_other_model,
    largest_on_each_body,
    refined_nodes,
    step_held,
)
from softrobot_twin.simulation.effects.trusted_ranges import reduced_bodies
from softrobot_twin.simulation.result import StepResult
from softrobot_twin.simulation.state import State
from softrobot_twin.simulation.step.step_part import PartReport, Steppable, StepPart
from softrobot_twin.simulation.step.time_budget import StageClock

# Steps between two looks at the other model, each of which takes the time of one of its steps.
CHECK_EVERY = 10
# The simulation goes back where the error is below this share of the wanted one.
BACK_SHARE = 0.5
ENRICH, FULL_MODEL = "enrich", "full_model"


def fallback_of(model: Model) -> Iterator[StepPart]:
    """The part of a scene with a fallback.

    Args:
        model: The model of a simulation.

    Raises:
        SceneError: It cannot be built for this scene.
    """
    bodies = tuple(
        body for body in reduced_bodies(model) if body.entry.reduced.fallback is not None
    )
    if bodies:
        yield Fallback(model, bodies)


def better_scene(scene: Scene, bodies: tuple[Body, ...]) -> Scene:
    """The scene that is fallen back to.

    Args:
        scene: The scene with reduced bodies.
        bodies: The bodies with a fallback.
    """
    entries = {}
    for body in bodies:
        entry = body.entry.reduced
        changed = entry.model_copy(update={"spare_modes": True, "fallback": None, "error": None})
        entries[body.name] = changed if entry.fallback == ENRICH else None
    return with_entries(scene, entries)


class Fallback(StepPart):
    """The other model, and which of the two is in use; a part of both simulations.

    Attributes:
        has_other_model: Whether the better model is in use.
        other: The simulation of the model that is not in use; None before `attach`.
        limits: Names that tell so among the active limits of a step, such as ``body.enrich``.
    """

    name, may_rest = "fallback", False
    refusal = "beside {} a fallback is not built"

    def __init__(self, model: Model, bodies: tuple[Body, ...]):
        """Take the bodies.

        Args:
            model: The built scene, with reduced bodies.
            bodies: Those with a fallback.
        """
        scene, kinds = model.scene, {body.entry.reduced.fallback for body in bodies}
        self.entry = f"{bodies[0].key}.reduced.fallback", " and ".join(sorted(kinds))
        if not scene.effectors:
            raise SceneError(scene.path, *self.entry, "", "needs an effector, whose error is judged")
        for body in bodies:
            entry = body.entry.reduced
            if entry.fallback == ENRICH and not body.reduction.reduction.spare_count:
                raise SceneError(
                    scene.path, f"{body.key}.reduced.fallback", ENRICH, "",
                    f"{entry.file} has no spare modes",
                )  # fmt: skip
        self._model, self._bodies, self._kinds, self.other = model, bodies, kinds, None
        self._wanted = {body.name: body.entry.reduced.error for body in bodies}
        self.limits = tuple(f"{body.name}.{body.entry.reduced.fallback}" for body in bodies)
        self._until_check = CHECK_EVERY
        self._inverses: dict[str, np.ndarray] = {}

    def why_not(self) -> str:
        """See `StepPart`."""
        model, scene = self._model, self._model.scene
        beside = {
            "guided rigid bodies and slides": model.guides is not None or model.slides is not None,
            "motion in time": model.is_dynamic,
            "contact": scene.contact is not None,
            "sealed cavities": bool(scene.sealed_cavities),
            "friction along cables": not model.actuators.conserves,
            "two kinds of fallback": len(self._kinds) > 1,
        }
        return next((what for what, is_there in beside.items() if is_there), "")

    def attach(self, simulation: Steppable) -> None:
        """Build the better model."""
        better = better_scene(simulation.scene, self._bodies)
        self.other = type(simulation)(better, simulation.now, with_warnings=False)
        self.other.take_parts((*self.other.parts, self))
        self._reduced, self._better = simulation.model, self.other.model

    def _is_used_by(self, simulation: Steppable) -> bool:
        """Whether a simulation has another one to change to: the other one itself has none."""
        return self.other is not None and simulation is not self.other

    def warm_up(self, simulation: Steppable) -> None:
        """See `StepPart`."""
        if self._is_used_by(simulation):
            self.other.warm_up()

    def step_in_place(
        self, simulation: Steppable, command: Command, budget: float | None,
        measured: object | None, clock: StageClock,
    ) -> StepResult | None:  # fmt: skip
        """Look at the other model when due, and change to it where it is called for."""
        if self._is_used_by(simulation):
            self._until_check -= 1
            if not self._until_check:
                self._until_check = CHECK_EVERY
                self._choose(simulation)
            clock.mark(self.name)
        return None

    def _choose(self, simulation: Steppable) -> None:
        state = simulation.state
        other = self.reduced_state(state) if self.has_other_model else self.better_state(state)
        self.other.restore(other)
        result = step_held(self.other, state)
        apart = np.linalg.norm(
            result.effector_positions - simulation.effector_positions(), axis=1
        )
        errors = largest_on_each_body(self._reduced, apart)
        shares = [errors[name] / wanted for name, wanted in self._wanted.items()]
        goes_back = self.has_other_model and max(shares) < BACK_SHARE
        goes_on = not self.has_other_model and max(shares) > 1.0
        if (goes_back or goes_on) and not result.status.is_failure:
            self.other.restore(other)
            self._exchange(simulation)

    def receive(self, simulation: Steppable, state: State | None) -> None:
        """Change to the model that a state belongs to, or to the reduced one for the rest shape."""
        if not self._is_used_by(simulation):
            return
        if state is None:
            self._until_check = CHECK_EVERY
            is_of_other = self.has_other_model
        else:
            count = len(state.positions)
            is_of_other = (
                count != len(simulation.state.positions) and count == len(self.other.state.positions)
            )
        if is_of_other:
            self._exchange(simulation)

    def _exchange(self, simulation: Steppable) -> None:
        """Exchange what the two simulations are made of."""
        simulation.__dict__, self.other.__dict__ = vars(self.other), vars(simulation)
        self.has_other_model = not self.has_other_model

    def report(self, state: State) -> PartReport:
        """See `StepPart`."""
        return PartReport(self.limits if self.has_other_model else ())

    def better_state(self, state: State) -> State:
        """A state of the reduced model for the better one.

        Args:
            state: State of the reduced model.
        """
        return in_other_model(state, self._reduced, self._better, refined_nodes)

    def reduced_state(self, state: State) -> State:
        """A state of the better model for the reduced one.

        Args:
            state: State of the better model.
        """
        return in_other_model(state, self._better, self._reduced, self._reduced_nodes)

    def _reduced_nodes(self, positions: np.ndarray, more: Body, own: Body) -> np.ndarray:
        """Nodes of a body in the reduced model, points left out of account [m]."""
        nodes, first = own.reduction, more.first_node
        if nodes is None:
            return positions[first : first + more.scene_node_count]
        reduced = np.zeros((nodes.node_count, 3))
        count = nodes.mode_count // 3
        if more.reduction is None:
            moved = positions[first : first + len(nodes.rest)] - nodes.rest
            reduced[:count] = (self._inverse_of(own) @ moved.ravel()).reshape(-1, 3)
        else:
            reduced[:count] = positions[more.reduction.coordinate_nodes[:count]]
        return reduced

    def _inverse_of(self, body: Body) -> np.ndarray:
        """(ΦᵀΦ)⁻¹Φᵀ of a body, shape (mode_count, 3 node_count)."""
        if body.name not in self._inverses:
            basis = body.reduction.basis.reshape(-1, body.reduction.mode_count)
            self._inverses[body.name] = np.linalg.solve(basis.T @ basis, basis.T)
        return self._inverses[body.name]
