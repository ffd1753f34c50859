"""How hard the actuators are held to where they are: a proximal weight, learnt from their moves.

Where a target is out of reach, going on gains next to nothing, and a linearization cannot judge how
far to go: what is left of the error bends the problem as much as what it sees (the large-residual
case of Gauss-Newton). Its optimum overshoots, and the next step takes it back, for ever. So moves
that turn back by as much as they went are made dearer, eight times each time; moves that go on are
made cheaper again, and a target that can be had costs nothing.
"""

from __future__ import annotations

import numpy as np

# Weights, as multiples of the energy's own; what is below the first counts as none.
FIRST, GREATEST = 1.0, 1.0e9
HARDER, LOOSER = 8.0, 0.5
# A move back that is shorter than this share of the last is on its way to rest.
SETTLING = 0.5
# Moves below this share of the actuators' scales are round-off.
MOVED = 1.0e-8


class Steadiness:
    """The weight, for all actuators of a scene alike.

    Attributes:
        weight: Weight of the energy of a change, by that of the energy itself.
        asked: Ways to the targets where the last step began [m], shape (effector_row_count,).
    """

    def __init__(self, least: float = 0.0):
        """Start with the least.

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
        """Look at how the actuators moved since the last call; not at all is no move.

        Args:
            displacements: Displacements where a step begins, as shares of the actuators' scales,
                shape (actuator_count,).
            asked: Ways to the targets from there [m], shape (effector_row_count,).
        """
        last, self._displacements = self._displacements, displacements
        before, self.asked = self.asked, asked
        if self._held_for is not None and float(asked @ self._held_for) <= 0.0:
            # Who is asked to go elsewhere starts afresh.
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
            # Who is sent back and forth turns back rightly.
            if float(asked @ before) > 0.0:
                self.hold_harder()

    def hold_harder(self) -> None:
        """Make moves dearer, as long as what is asked leads the same way."""
        self._held_for = self.asked
        self._set(max(self.weight, FIRST) * HARDER)

    def _set(self, weight: float) -> None:
        self.weight = max(self._least, min(weight, GREATEST) if weight >= FIRST else 0.0)
