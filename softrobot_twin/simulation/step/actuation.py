"""Efforts, displacements and contact forces of one linearization: the result of its optimisation.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softrobot_twin.simulation.building.limits import ActuatorLimits

# Name of the limit that prevents the actuators from inverting elements.
INVERSION = "elements.inversion"
# Name of the limit that prevents prescribed moves from leading bodies through each other.
PASSING = "contact.passing"
# An effort below this share of the largest is none.
NO_EFFORT = 1.0e-6


class ContactLoads(NamedTuple):
    """Forces of the contacts, and their residuals.

    Attributes:
        multipliers: λ_c of all contact rows [N], shape (contact_row_count,).
        sweeps: Sweeps of the solver.
        residual: Largest residual of gaps and sticking [m].
        force_residual: Largest residual of forces [N].
        converged: The residual is within the scene's tolerance.
        limits: Names of the limits of contact force that are reached or exceeded.
    """

    multipliers: np.ndarray
    sweeps: int = 0
    residual: float = 0.0
    force_residual: float = 0.0
    converged: bool = True
    limits: tuple[str, ...] = ()

    @property
    def load(self) -> float:
        """Sum of the magnitudes of all forces [N]."""
        return float(np.abs(self.multipliers).sum()) if len(self.multipliers) else 0.0


NOTHING_TOUCHES = ContactLoads(np.empty(0))


class Actuation(NamedTuple):
    """What actuators and contacts do.

    Attributes:
        efforts: λ_a [N], shape (actuator_count,); of slides their displacements from where they are
            [m], until a correction tells what holds them.
        displacements: Set displacements δ_a of the actuators [m], shape (actuator_count,); for a
            slack cable less than the shortening of its path. Those of effort-driven actuators
            follow from their efforts.
        solved: False when there was no solution and the actuators were held.
        qp_solver: Name of the solver that found it; empty where no QP was posed.
        contact: The contacts.
        is_refused: The solution was rejected because it would invert elements; the actuators were
            held.
        are_efforts_given: Whether efforts were asked for, and not displacements or targets.
    """

    efforts: np.ndarray
    displacements: np.ndarray
    solved: bool = True
    qp_solver: str = ""
    contact: ContactLoads = NOTHING_TOUCHES
    is_refused: bool = False
    are_efforts_given: bool = False

    def drives(self, limits: ActuatorLimits) -> np.ndarray:
        """What setpoints hold: displacements, or efforts of what is effort-driven.

        Args:
            limits: Limits of the actuators, which know what is effort-driven.

        Returns:
            Shape (actuator_count,).
        """
        if limits.are_all_effort_driven:
            return self.efforts
        if not limits.has_effort_driven:
            return self.displacements
        return np.where(limits.is_effort_driven, self.efforts, self.displacements)

    @property
    def given_up(self) -> tuple[str, ...]:
        """Active limits other than those of the actuators."""
        limits = self.contact.limits
        return (*limits, INVERSION) if self.is_refused else limits
