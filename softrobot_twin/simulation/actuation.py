"""How λ is found when the actuators are commanded: by length, by tension, or held.

Every way works on the condensed system: δ = W λ + δ_free, over the actuators' rows.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softrobot_twin.solvers.direct_problem import solve_direct, solve_towards
from softrobot_twin.solvers.inverse_qp import Bounds


# Name of the limit that stops a robot from turning its own elements inside out.
INVERSION = "elements.inversion"


class Linearized(NamedTuple):
    """The robot seen from its actuators and effectors, around one state (eq. 14).

    Attributes:
        W_aa: Shortening by tension [m/N], shape (actuator_count, actuator_count).
        W_ea: Effector motion by tension [m/N], shape (effector_row_count, actuator_count).
        actuators: Path shortening without tension [m], shape (actuator_count,).
        effectors: Effector coordinates without tension [m], shape (effector_row_count,).
        effectors_now: Effector coordinates at the state itself [m], same shape.
    """

    W_aa: np.ndarray
    W_ea: np.ndarray
    actuators: np.ndarray
    effectors: np.ndarray
    effectors_now: np.ndarray


class Actuation(NamedTuple):
    """What the actuators do.

    Attributes:
        tensions: λ_a [N], shape (actuator_count,).
        shortening: Wound shortening [m], shape (actuator_count,); less than the path's where a
            cable hangs slack.
        solved: False when there was no answer and the actuators were held.
        qp_solver: Name of the solver that found it; empty where no QP was posed.
        contact: What the contacts do, where the scene has any.
        is_refused: What was found is not done, the actuators stay: it would have turned elements
            inside out.
    """

    efforts: np.ndarray
    displacements: np.ndarray
    solved: bool = True
    qp_solver: str = ""
    contact: object | None = None
    is_refused: bool = False

    @property
    def load(self) -> float:
        """Sum of all multipliers' sizes [N]."""
        touching = 0.0 if self.contact is None else self.contact.load
        return float(self.efforts.sum()) + touching

    @property
    def given_up(self) -> tuple[str, ...]:
        """What held the actuators back besides their own limits."""
        limits = () if self.contact is None else self.contact.limits
        return (*limits, INVERSION) if self.is_refused else limits

    @property
    def is_exact(self) -> bool:
        """False when the contacts are solved less exactly than the scene asks for."""
        return self.contact is None or self.contact.converged


class DirectActuation:
    """Actuators that are commanded, where nothing touches anything."""

    def warm_up(self) -> None:
        """Nothing here is compiled."""

    def forget(self) -> None:
        """Nothing is remembered from step to step."""

    def remember(self, tensions: np.ndarray) -> None:
        """Nothing is."""

    def held(
        self, linear: Linearized, shortening: np.ndarray, bounds: Bounds, command
    ) -> Actuation:
        """What the actuators do when they stay where they are; see `wind`."""
        return wind(linear, shortening, bounds)

    def wind(self, linear: Linearized, shortening: np.ndarray, bounds: Bounds) -> Actuation:
        """See the function of this name."""
        return wind(linear, shortening, bounds)

    def pull(
        self, linear: Linearized, tensions: np.ndarray, held: Actuation, bounds: Bounds
    ) -> Actuation:
        """Wound lengths when every cable is pulled with a tension, as far as its winch can go.

        Args:
            linear: The condensed system.
            tensions: Asked tensions [N], shape (actuator_count,).
            held: What the actuators do when they stay; always within reach.
            bounds: Bounds of this step.

        Returns:
            The actuation nearest to the asked tensions, in the energy norm of W.
        """
        widened = reachable(linear, held, bounds)
        wanted = np.clip(tensions, bounds.effort_min, bounds.effort_max)
        found = solve_towards(linear.W_aa, linear.actuators, wanted, widened)
        if found is None:
            return held._replace(solved=False)
        return settle_slack(linear, found, bounds)

    def account(self, actuation: Actuation) -> dict:
        """What a report tells of contacts: nothing."""
        return {}

    def imbalance(self, effectors, linear: Linearized, held: Actuation) -> float:
        """How far the effectors stand from balance at held lengths, as a linearization sees it.

        Args:
            effectors: The effector term, or None.
            linear: The system condensed around the state.
            held: What the actuators do when they stay.

        Returns:
            Largest distance over the effectors [m]; NaN without effectors.
        """
        if effectors is None or effectors.row_count == 0:
            return float("nan")
        moves = linear.W_ea @ held.efforts + linear.effectors - linear.effectors_now
        return float(np.sqrt(np.bincount(effectors.row_effector, weights=moves * moves).max()))


def wind(linear: Linearized, shortening: np.ndarray, bounds: Bounds) -> Actuation:
    """Tensions when every cable is wound to a shortening.

    Args:
        linear: The condensed system.
        shortening: Wound shortening [m], shape (actuator_count,).
        bounds: Bounds on the tensions [N].

    Returns:
        The actuation; `solved` is False, with the tensions zero, when there is no answer.
    """
    tensions = solve_direct(
        linear.W_aa, linear.actuators, shortening, bounds.effort_min, bounds.effort_max
    )
    if tensions is None:
        return Actuation(np.zeros_like(shortening), shortening, solved=False)
    return Actuation(tensions, shortening)


def reachable(linear: Linearized, held: Actuation, bounds: Bounds) -> Bounds:
    """Widen bounds on the path's shortening so far that holding still fits.

    A slack cable's path is shorter than what is wound, and a slipping winch's is longer; neither
    breaks a limit of the hardware. With the held state inside, the problem is never infeasible.
    """
    path = linear.W_aa @ held.efforts + linear.actuators
    return bounds._replace(
        displacement_min=np.minimum(bounds.displacement_min, path),
        displacement_max=np.maximum(bounds.displacement_max, path),
    )


def settle_slack(linear: Linearized, tensions: np.ndarray, bounds: Bounds) -> Actuation:
    """Wind to the path's shortening within the hardware's bounds; solve anew where that differs."""
    path = linear.W_aa @ tensions + linear.actuators
    shortening = np.clip(path, bounds.displacement_min, bounds.displacement_max)
    if np.array_equal(shortening, path):
        return Actuation(tensions, shortening)
    return wind(linear, shortening, bounds)
