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

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np

from softrobot_twin.scene import Scene
from softrobot_twin.simulation.building.model import Model
from softrobot_twin.simulation.step.apparent_stiffness import (
    ApparentStiffness,
    ComplianceGradient,
    State,
)

# One linearization asks for no greater change of a stiffness, as a share of it.
LONGEST_CHANGE = 0.25
# ℓ by default, as a share of the robot's size.
DEFAULT_LENGTH = 0.1


class StiffnessRows(NamedTuple):
    """Rows of wanted stiffnesses around one state.

    Attributes:
        wanted: z of the targets [m], shape (n,).
        now: z [m], shape (n,).
        free: z at multipliers of zero, by the linearization [m], shape (n,).
        motion: Change of z by the multipliers of the actuators, shape (n, actuator_row_count).
        weights: Weight of each row, zero where a compliance is not positive, shape (n,).
        lengths: ℓ [m], shape (n,).
        directions: Directions, 3 × effector + axis, shape (n,).
        gradient: Compliances and their derivatives.
        with_bearing: Gives the rows if just some actuators held, shape (actuator_row_count,).
    """

    wanted: np.ndarray
    now: np.ndarray
    free: np.ndarray
    motion: np.ndarray
    weights: np.ndarray
    lengths: np.ndarray
    directions: np.ndarray
    gradient: ComplianceGradient
    with_bearing: Callable[[np.ndarray], StiffnessRows]

    @property
    def asked(self) -> np.ndarray:
        """Change of z that one linearization asks for [m], shape (n,)."""
        longest = LONGEST_CHANGE * self.lengths
        return np.clip(self.wanted - self.now, -longest, longest)

    def places(self, multipliers: np.ndarray) -> np.ndarray:
        """z under multipliers of the actuators, by the linearization [m], shape (n,)."""
        return self.free + self.motion @ multipliers[: self.motion.shape[1]]

    def after(self, move: np.ndarray, change: np.ndarray) -> np.ndarray:
        """Stiffnesses after a move, to first order from the state [N/m], shape (n,).

        Args:
            move: Displacement of the unknowns [m], shape (free_node_count, 3).
            change: Of the actuators' efforts, shape (actuator_row_count,).
        """
        found = self.gradient
        moved = np.einsum("nij,ij->n", found.by_position, move)
        k = 1.0 / found.compliance
        return k - k * k * (moved + found.by_effort @ change)


class ReachedStiffness(NamedTuple):
    """Stiffnesses of effectors after a step, along the axes along which one is wanted.

    Attributes:
        stiffness: To first order from the last linearization [N/m], shape (effector_count, 3); NaN
            where none is wanted.
        errors: The largest share of its target that a stiffness of each effector is wrong by, NaN
            where none is wanted, shape (effector_count,).
        misses: The same as distances, that share times ℓ [m], zero where none is wanted, same shape.
        misses_before: The same before the last move [m].
    """

    stiffness: np.ndarray
    errors: np.ndarray
    misses: np.ndarray
    misses_before: np.ndarray


class StiffnessTargets:
    """Makes the rows of one scene."""

    def __init__(self, model: Model):
        """Take the weights.

        Args:
            model: A scene of which an effector asks for a stiffness; see `why_no_stiffness`.
        """
        self._stiffness = ApparentStiffness(model)
        self._free_nodes = model.nodes.free_nodes
        entries = [effector.stiffness for effector in model.scene.effectors]
        self.lengths = stiffness_lengths(model)
        self._weights = np.array([0.0 if entry is None else entry.weight for entry in entries])

    def rows(
        self, state: State, wanted: np.ndarray, holding: np.ndarray | None = None
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
            lengths, directions, gradient, partial(self.rows, state, wanted),
        )  # fmt: skip

    def reached(
        self, rows: StiffnessRows, state: State, positions: np.ndarray, efforts: np.ndarray
    ) -> ReachedStiffness:
        """What a move led to.

        Args:
            rows: The rows where it began.
            state: The state there.
            positions: Node positions after it [m], shape (node_count, 3).
            efforts: Efforts of the actuators after it, shape (actuator_count,).
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
        return ReachedStiffness(
            stiffness.reshape(count, 3), errors, self.lengths * np.nan_to_num(errors),
            self.lengths * before,
        )  # fmt: skip


def stiffness_of_scene(scene: Scene) -> np.ndarray:
    """Wanted stiffnesses of a scene's effectors [N/m], NaN where free, shape (effector_count, 3)."""
    wanted = np.full((len(scene.effectors), 3), np.nan)
    for own, effector in zip(wanted, scene.effectors, strict=True):
        if effector.stiffness is not None:
            own[:] = [np.nan if one is None else one for one in effector.stiffness.target]
    return wanted


def stiffness_lengths(model: Model) -> np.ndarray:
    """ℓ of each effector [m], zero for those that ask for no stiffness, shape (effector_count,)."""
    lengths = np.zeros(len(model.scene.effectors))
    for index, effector in enumerate(model.scene.effectors):
        entry = effector.stiffness
        if entry is not None:
            lengths[index] = entry.length or DEFAULT_LENGTH * model.nodes.size
    return lengths
