"""Bodies go after what is guided, where its move alone would fold their elements."""

from __future__ import annotations

import numpy as np

from softrobot_twin.simulation.building.guided_bodies import Guides
from softrobot_twin.simulation.building.model import Model
from softrobot_twin.simulation.state import State
from softrobot_twin.simulation.step.step_part import Leader, Steppable, StepPart
from softrobot_twin.simulation.step.time_budget import StageClock

# Parts of the move of guided bodies, and halvings of a part that would fold elements, at most.
MOST_PARTS, MOST_HALVINGS = 100, 20


class Guiding(StepPart, Leader):
    """Steps of a scene with guided bodies."""

    name, may_rest, prescribes = "guides", False, True

    def __init__(self, model: Model):
        """Take the guided bodies."""
        self._guides: Guides = model.guides

    def reset(self) -> None:
        """See `StepPart`."""
        self._guides.reset()

    def restore(self, state: State) -> None:
        """See `StepPart`."""
        self._guides.stay(state.positions)

    def places(self, positions: np.ndarray) -> np.ndarray:
        """See `Leader`."""
        return self._guides.points(positions)

    def lead(
        self, simulation: Steppable, positions: np.ndarray, efforts: np.ndarray, time_step: float,
        clock: StageClock,
    ) -> bool:  # fmt: skip
        """Make the move in parts, none of which takes most of an element's volume.

        The bodies come near balance after each part but the last. See `Leader`.
        """
        guides, newton, contacts = self._guides, simulation.newton, simulation.model.contacts
        if not guides.moved:
            return True
        if simulation.model.rows.varies:
            before = simulation.state.positions
            share = contacts.share_before_touch(before, positions, guides.place)
            if share > 0.0:
                before = before.copy()
                guides.place(before, share)
            contacts.begin_prescribed_move(before)
        if newton.balance.is_folded:
            return True
        if not newton.balance.folds(simulation.state.positions, positions):
            return True
        positions[:], gone, tried = simulation.state.positions, 0.0, positions.copy()
        for _ in range(MOST_PARTS):
            part = 1.0 - gone
            for _ in range(MOST_HALVINGS):
                tried[:] = positions
                guides.place(tried, gone + part)
                if not newton.balance.folds(positions, tried):
                    break
                part *= 0.5
            else:
                newton.balance.forget_folds()
                return False
            if simulation.model.rows.varies:
                contacts.begin_prescribed_move(positions)
            positions[:], gone = tried, gone + part
            if gone >= 1.0:
                return True
            efforts = simulation.come_near(positions, efforts, time_step, clock)
            if efforts is None:
                positions[:] = tried
                return False
        return False
