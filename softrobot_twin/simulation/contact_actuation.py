"""How λ is found when actuators are commanded and bodies touch: one problem for both."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softrobot_twin.simulation.actuation import Actuation
from softrobot_twin.simulation.command import SetLengths
from softrobot_twin.simulation.contact_newton import ContactLinearized
from softrobot_twin.simulation.model import Model
from softrobot_twin.solvers.contact_gauss_seidel import ContactGaussSeidel
from softrobot_twin.solvers.contact_problem import ContactProblem
from softrobot_twin.solvers.inverse_qp import Bounds


class Touch(NamedTuple):
    """What the contacts do in one linearization.

    Attributes:
        multipliers: λ_c [N], shape (contact_row_count,).
        sweeps: Sweeps of the solver.
        residual: Largest residual of gaps and sticking [m].
        force_residual: Largest residual of forces [N].
        converged: The residual is within the scene's tolerance.
    """

    multipliers: np.ndarray
    sweeps: int
    residual: float
    force_residual: float
    converged: bool

    @property
    def load(self) -> float:
        """Sum of the sizes of all forces [N]."""
        return float(np.abs(self.multipliers).sum())


class ContactActuation:
    """Actuators that are commanded, where bodies touch; see `DirectActuation`."""

    def __init__(self, model: Model):
        """Take the contacts.

        Args:
            model: The built scene.
        """
        entry = model.scene.contact
        self._contacts = model.contacts
        self._solver = ContactGaussSeidel(entry.tolerance, entry.most_sweeps)
        self._tensions = np.zeros(len(model.limits.names))

    def forget(self) -> None:
        """Forget the last solution."""
        self._tensions = np.zeros_like(self._tensions)

    def held(self, linear: ContactLinearized, shortening, bounds: Bounds, command):
        """What the actuators do when they stay; not asked for where lengths are commanded."""
        if isinstance(command, SetLengths):
            return None
        return self.wind(linear, shortening, bounds)

    def wind(
        self, linear: ContactLinearized, shortening: np.ndarray, bounds: Bounds
    ) -> Actuation:
        """Tensions and contact forces when every cable is wound to a shortening.

        Args:
            linear: The condensed system.
            shortening: Wound shortening [m], shape (actuator_count,).
            bounds: Bounds on the tensions [N].

        Returns:
            The actuation; where the contacts did not converge, the nearest that was found.
        """
        return self._solve(linear, shortening, bounds.tension_min, bounds.tension_max)

    def pull(
        self, linear: ContactLinearized, tensions: np.ndarray, held: Actuation, bounds: Bounds
    ) -> Actuation:
        """Wound lengths when every cable is pulled with a tension, as far as its winch can go.

        Args:
            linear: The condensed system.
            tensions: Asked tensions [N], shape (actuator_count,).
            held: What the actuators do when they stay.
            bounds: Bounds of this step.

        Returns:
            The actuation: as asked, where the path that comes of it is within the bounds.
        """
        wanted = np.clip(tensions, bounds.tension_min, bounds.tension_max)
        pulled = self._solve(linear, held.shortening, wanted, wanted)
        path = self._path(linear, pulled)
        # A slack cable's path is shorter than what is wound: holding still always fits.
        now = self._path(linear, held)
        shortening = np.clip(
            path, np.minimum(bounds.shortening_min, now), np.maximum(bounds.shortening_max, now)
        )
        if np.array_equal(shortening, path):
            wound = np.clip(path, bounds.shortening_min, bounds.shortening_max)
            return pulled._replace(shortening=wound)
        return self.wind(linear, shortening, bounds)

    @staticmethod
    def _path(linear: ContactLinearized, actuation: Actuation) -> np.ndarray:
        """Shortening of each cable's path [m]."""
        count = len(linear.actuators)
        multipliers = np.concatenate([actuation.tensions, actuation.contact.multipliers])
        return linear.W[:count] @ multipliers + linear.actuators

    def _solve(self, linear: ContactLinearized, shortening, lower, upper) -> Actuation:
        contacts, count = self._contacts, len(linear.actuators)
        violation = linear.violation.copy()
        violation[:count] -= shortening
        problem = ContactProblem(
            linear.W, violation, lower, upper, contacts.friction, contacts.rows_per_contact
        )
        guess = np.concatenate([self._tensions, contacts.memory.guess])
        found = self._solver.solve(problem, guess)
        tensions = found.multipliers[:count]
        self._tensions = tensions
        touch = Touch(
            found.multipliers[count:], found.sweeps, found.gap_residual, found.force_residual,
            found.converged,
        )  # fmt: skip
        return Actuation(tensions, np.asarray(shortening), contact=touch)

    def account(self, actuation: Actuation) -> dict:
        """What a report tells of contacts."""
        touch, per_contact = actuation.contact, self._contacts.rows_per_contact
        return {
            "contact_count": int(np.count_nonzero(touch.multipliers[::per_contact] > 0.0)),
            "contact_sweeps": touch.sweeps,
            "contact_residual": touch.residual,
            "contact_force_residual": touch.force_residual,
        }

    def imbalance(self, effectors, linear, held) -> float:
        """Not known in contact: NaN."""
        return float("nan")
