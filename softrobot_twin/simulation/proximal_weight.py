"""A proximal weight on changes of the efforts, learnt from the moves of the actuators.

Where a target is out of reach, a further move gains almost nothing, and a linearization cannot
judge how far to move: the remaining error bends the problem as much as the linear part (the
large-residual case of Gauss-Newton). Its optimum overshoots, and the next step moves back, without
end. So a move back that is nearly as long as the move before multiplies the weight by eight. A move
that continues halves it. A target that can be reached is not affected.
"""

from __future__ import annotations

import numpy as np

# Weights, as multiples of the energy's own weight; a weight below the first counts as zero.
FIRST, GREATEST = 1.0, 1.0e9
HARDER, LOOSER = 8.0, 0.5
# A move back that is shorter than this share of the move before converges by itself.
SETTLING = 0.5
# Moves below this share of the actuators' scales are round-off.
MOVED = 1.0e-8


class ProximalWeight:
    """The weight for all actuators of a scene.

    Attributes:
        weight: Weight of the energy of a change, as a multiple of the weight of the energy itself.
        asked: Target error where the last step began [m], shape (effector_row_count,).
    """

    def __init__(self, least: float = 0.0):
        """Start with the least weight.

        Args:
            least: Least weight.
        """
        self._least = least
        self.reset()

    def reset(self) -> None:
        """Forget all moves."""
        self.weight = self._least
        self._displacements: np.ndarray | None = None
        self._move: np.ndarray | None = None
        self.asked: np.ndarray | None = None
        self._held_for: np.ndarray | None = None

    def learn(self, displacements: np.ndarray, asked: np.ndarray) -> None:
        """Compare the move of the actuators since the last call with the move before.

        Args:
            displacements: Displacements where a step begins, as shares of the actuators' scales,
                shape (actuator_count,).
            asked: Target error there [m], shape (effector_row_count,).
        """
        last, self._displacements = self._displacements, displacements
        before, self.asked = self.asked, asked
        if self._held_for is not None and float(asked @ self._held_for) <= 0.0:
            # The target has another direction now: what was learnt does not hold there.
            self.weight, self._held_for = self._least, None
        if last is None:
            return
        move = displacements - last
        length = float(np.sqrt(move @ move))
        if length <= MOVED:
            return
        move_before, self._move = self._move, move
        if move_before is None:
            return
        if float(move @ move_before) > 0.0:
            self._set(self.weight * LOOSER)
        elif length > SETTLING * float(np.sqrt(move_before @ move_before)):
            # A move back is right when the target itself has turned back.
            if float(asked @ before) > 0.0:
                self.increase()

    def increase(self) -> None:
        """Increase the weight until the target error has another direction."""
        self._held_for = self.asked
        self._set(max(self.weight, FIRST) * HARDER)

    def _set(self, weight: float) -> None:
        self.weight = max(self._least, min(weight, GREATEST) if weight >= FIRST else 0.0)
