"""Ways to targets that would turn elements inside out are not gone: the actuators stay.

Far outside its reach a robot can be asked to fold until elements of its body invert, which no
material does. Such a step is refused and moves are made dearer, so that the robot comes to rest
next to where it would happen. Folded so far, a linearization may not know the way back either: when
the robot is asked to go elsewhere and cannot, its cables are let go until it can.
"""

from __future__ import annotations

import numpy as np

from softrobot_twin.simulation.actuation import Actuation
from softrobot_twin.simulation.newton import Newton
from softrobot_twin.solvers.inverse_problem import Bounds


class Caution:
    """Looks at every step towards targets.

    Attributes:
        lets_go: What was said to be done last lets cables go.
    """

    def __init__(self, newton: Newton, direct, inverse):
        """Take who has a say.

        Args:
            newton: Counts inverted elements.
            direct: Finds λ of what is held.
            inverse: Finds λ that leads to targets.
        """
        self._newton, self._direct, self._inverse = newton, direct, inverse
        self.forget()

    def forget(self) -> None:
        """Refuse no way any more."""
        self.lets_go = False
        # Ways to the targets [m] when a step was refused, shape (effector_row_count,).
        self._refused: np.ndarray | None = None

    def refuses(self, inverted_before: int) -> bool:
        """Whether a step that was tried must not be made.

        Args:
            inverted_before: Inverted elements before it.

        Returns:
            True when it inverts further elements, or leads on where that happened.
        """
        count = self._newton.inverted_count
        if count == 0:
            self._refused = None
            return False
        return count > inverted_before or (self._refused is not None and self._leads_on())

    def instead(self, linear, held: Actuation, bounds: Bounds) -> Actuation:
        """What to do in place of a refused step.

        Args:
            linear: The condensed system.
            held: What the actuators do when they stay.
            bounds: Bounds of this step.

        Returns:
            It, told as a refusal.
        """
        self.lets_go = self._refused is not None and not self._leads_on()
        if self.lets_go:
            loose, cables = held.displacements.copy(), linear.groups.actuators
            # Wound to its path without any tension, a cable is slack, however far it may go.
            slack = np.minimum(loose[cables], linear.actuators)
            least = bounds.displacement_min[cables]
            loose[cables] = np.where(np.isfinite(least), least, slack)
            return self._direct.wind(linear, loose, bounds)._replace(is_refused=True)
        self._refused = self._inverse.steadiness.asked
        self._inverse.steadiness.hold_harder()
        self._direct.remember(held.efforts)
        return held._replace(is_refused=True)

    def _leads_on(self) -> bool:
        """Whether what is asked leads where a step was refused."""
        return float(self._inverse.steadiness.asked @ self._refused) > 0.0
