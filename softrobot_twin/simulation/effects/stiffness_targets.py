"""Wanted stiffnesses of effectors as rows of the inverse problem, beside their positions.

The stiffness k = 1/C of an effector along an axis (`apparent_stiffness.py`) has the coordinate

    z = ℓ ln k,    wanted: ℓ ln k_d,    dz = -ℓ k dC,

in metres: near its target k_d, a stiffness that is wrong by a share of it counts as much as the
distance of that share of ℓ from a target. Too stiff by a factor and too soft by it are equally
wrong, and a change of the target is a change of what is wanted, not of its weight. So stiffnesses
are tracked, weighed and judged as coordinates of positions are: these rows stand below those of the
effectors.
"""

from __future__ import annotations

from functools import cached_property, partial

import numpy as np

from softrobot_twin.scene import Scene
from softrobot_twin.simulation.building.model import Model
from softrobot_twin.simulation.command import FollowTargets
from softrobot_twin.simulation.state import State
from softrobot_twin.simulation.step.apparent_stiffness import (
    ApparentStiffness,
    StiffnessRows,
    why_no_stiffness,
)
from softrobot_twin.simulation.step.linearized import LinearizedState
from softrobot_twin.simulation.step.newton import Newton
from softrobot_twin.simulation.step.step_part import PartReport, StepPart

# ℓ by default, as a share of the robot's size.
DEFAULT_LENGTH = 0.1


class StiffnessTargets(StepPart):
    """Makes the rows of one scene, and tells what a step made of the stiffnesses."""

    name = "stiffness"
    refusal = "in a scene with {} a wanted stiffness is not built into this version"

    def __init__(self, model: Model):
        """Take what effectors ask for.

        Args:
            model: A scene of which an effector asks for a stiffness; see `why_no_stiffness`.
        """
        self._model, self._scene_stiffness = model, stiffness_of_scene(model.scene)
        self._free_nodes = model.nodes.free_nodes
        length = DEFAULT_LENGTH * model.nodes.size
        effectors = model.scene.effectors
        self.lengths, self._weights = np.array([
            (entry.length or length, entry.weight) if entry else (0.0, 0.0)
            for entry in (effector.stiffness for effector in effectors)
        ]).T.copy()  # fmt: skip
        first = int(np.argmax(self._weights > 0.0))
        self.entry = f"effectors[{first}].stiffness", effectors[first].name
        self.conflict = why_no_stiffness(model)
        self._begun: tuple[StiffnessRows, LinearizedState] | None = None
        self._told = PartReport()

    @cached_property
    def _stiffness(self) -> ApparentStiffness:
        return ApparentStiffness(self._model)

    def begin(self, state: State, measured: object | None) -> bool:
        """See `StepPart`."""
        self._begun = None
        return False

    def rows(self, state: LinearizedState, command: FollowTargets) -> StiffnessRows | None:
        """See `StepPart`; nothing is wanted along free axes, and of effectors without a weight."""
        wanted = self._scene_stiffness if command.stiffness is None else command.stiffness
        wanted = np.where(self._weights[:, None] > 0.0, wanted, np.nan)
        if np.isnan(wanted).all():
            return None
        rows = self.rows_of(state, wanted)
        self._begun = rows, state
        return rows

    def rows_of(
        self, state: LinearizedState, wanted: np.ndarray, holding: np.ndarray | None = None
    ) -> StiffnessRows:
        """The rows around a state.

        Args:
            state: The linearized state.
            wanted: Stiffnesses [N/m], NaN where free, shape (effector_count, 3).
            holding: See `ApparentStiffness.gradient`.
        """
        directions = np.flatnonzero(np.isfinite(wanted))
        targets, effectors = wanted.ravel()[directions], directions // 3
        gradient = self._stiffness.gradient(state, directions, holding)
        lengths, weights = self.lengths[effectors], self._weights[effectors]
        # Near instability a compliance has no sense, and nothing is asked of it.
        compliance = gradient.compliance
        is_stable = compliance > 0.0
        k = 1.0 / np.where(is_stable, compliance, 1.0 / targets)
        now, by_compliance = lengths * np.log(k), -lengths * k
        return StiffnessRows(
            lengths * np.log(targets), now, now + by_compliance * (gradient.free - compliance),
            by_compliance[:, None] * gradient.by_multiplier, np.where(is_stable, weights, 0.0),
            lengths, directions, gradient, partial(self.rows_of, state, wanted),
        )  # fmt: skip

    def end(self, positions: np.ndarray, efforts: np.ndarray) -> dict[str, np.ndarray]:
        """Find what the last move led to."""
        self._told = self._reached(*self._begun, positions, efforts) if self._begun else PartReport()
        return {}

    def _reached(
        self, rows: StiffnessRows, state: LinearizedState, positions: np.ndarray,
        efforts: np.ndarray,
    ) -> PartReport:  # fmt: skip
        """What a move led to.

        Args:
            rows: The rows where it began.
            state: The state there.
            positions: Node positions after it [m], shape (node_count, 3).
            efforts: Efforts of the actuators after it, shape (actuator_count,).

        Returns:
            Stiffnesses to first order from the last linearization [N/m], and the largest share of
            its target that a stiffness of each effector is wrong by, NaN where none is wanted; that
            share times ℓ is missed [m].
        """
        move = (positions - state.positions)[self._free_nodes]
        after = rows.after(move, efforts[: len(state.efforts)] - state.efforts)
        targets = np.exp(rows.wanted / rows.lengths)
        effectors, count = rows.directions // 3, len(self.lengths)
        stiffness, errors = np.full(3 * count, np.nan), np.full(count, np.nan)
        stiffness[rows.directions] = after
        np.fmax.at(errors, effectors, np.abs(after / targets - 1.0))
        before = np.zeros(count)
        np.maximum.at(before, effectors, np.abs(1.0 / rows.gradient.compliance / targets - 1.0))
        return PartReport(
            misses=(self.lengths * np.nan_to_num(errors), self.lengths * before),
            readings={
                "effector_stiffness": stiffness.reshape(count, 3), "stiffness_errors": errors,
            },
        )  # fmt: skip

    def report(self, state: State, newton: Newton) -> PartReport:
        """See `StepPart`."""
        return self._told


def stiffness_of_scene(scene: Scene) -> np.ndarray:
    """Wanted stiffnesses of a scene's effectors [N/m], NaN where free, shape (effector_count, 3).

    Args:
        scene: The scene.
    """
    free, entries = (None, None, None), [effector.stiffness for effector in scene.effectors]
    wanted = [entry.target if entry else free for entry in entries]
    return np.array(wanted, dtype=float).reshape(-1, 3)
