"""Steps towards targets that would invert elements are refused, and the actuators stay.

A robot that is asked to go far outside its workspace can fold until elements of its body invert,
which no material does. Such a step is refused, and the proximal weight grows, so that the robot
comes to rest beside the fold. From a folded state the linearization may not lead back either: when
the target changes its direction and steps still invert elements, the cables are let go until a
step succeeds.
"""

from __future__ import annotations

import numpy as np

from softrobot_twin.simulation.actuation import Actuation
from softrobot_twin.simulation.newton import Newton
from softrobot_twin.solvers.inverse_problem import Bounds


class InversionGuard:
    """Judges every step towards targets by the elements that it inverts.

    Attributes:
        lets_go: Whether the last replacement lets the cables go.
    """

    def __init__(self, newton: Newton, direct, inverse):
        """Keep the parts that judge and replace a step.

        Args:
            newton: Counts inverted elements.
            direct: Finds λ for held actuators.
            inverse: Finds λ for targets; its proximal weight knows the target error.
        """
        self._newton, self._direct, self._inverse = newton, direct, inverse
        self.forget()

    def forget(self) -> None:
        """Forget the last refusal."""
        self.lets_go = False
        # Target error [m] at the last refused step, shape (effector_row_count,).
        self._refused: np.ndarray | None = None

    def refuses(self, inverted_before: int) -> bool:
        """Whether a tried step must not be made.

        Args:
            inverted_before: Number of inverted elements before the step.

        Returns:
            True when the step inverts further elements, or when elements are inverted and the
            target error still has the direction in which a step was refused.
        """
        count = self._newton.inverted_count
        if count == 0:
            self._refused = None
            return False
        return count > inverted_before or (self._refused is not None and self._leads_on())

    def instead(self, linear, held: Actuation, bounds: Bounds) -> Actuation:
        """The actuation in place of a refused step.

        Args:
            linear: The condensed system.
            held: Actuation when the actuators stay.
            bounds: Bounds of this step.

        Returns:
            The actuation, marked as refused.
        """
        self.lets_go = self._refused is not None and not self._leads_on()
        if self.lets_go:
            loose, cables = held.displacements.copy(), linear.groups.actuators
            # A cable as long as its path without tension is slack, whatever its limits are.
            slack = np.minimum(loose[cables], linear.actuators)
            least = bounds.displacement_min[cables]
            loose[cables] = np.where(np.isfinite(least), least, slack)
            return self._direct.wind(linear, loose, bounds)._replace(is_refused=True)
        self._refused = self._inverse.proximal_weight.asked
        self._inverse.proximal_weight.increase()
        self._direct.remember(held.efforts)
        return held._replace(is_refused=True)

    def _leads_on(self) -> bool:
        """Whether the target error has the direction in which a step was refused."""
        return float(self._inverse.proximal_weight.asked @ self._refused) > 0.0
