"""The error of reduced bodies by the residual of the whole mesh.

All nodes of the full model are placed where the coordinates of the basis have them, u = Φ q. A few
linearizations with the same setpoints, the same loads and, as a start, the same efforts bring the
full model to its own balance; how far its effectors move is the error of the reduced model. What
the basis cannot see has no part in it: it holds for loads that the training never had, where spare
modes tell too little (`reduction_error.py`).

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

from softrobot_twin.scene import Scene
from softrobot_twin.simulation.building.model import Model
from softrobot_twin.simulation.building.reduced_body import without_reductions
from softrobot_twin.simulation.effects.coordinate_range import reduced_bodies
from softrobot_twin.simulation.effects.reduction_error import (
    largest_on_each_body,
    shares_of_displacement,
    step_held,
)
from softrobot_twin.simulation.state import State
from softrobot_twin.simulation.step.steppable import Steppable

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
