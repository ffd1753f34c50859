"""How λ is found when actuators are commanded and bodies touch: one problem for both."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softrobot_twin.scene.surroundings import Contact
from softrobot_twin.simulation.actuation import Actuation
from softrobot_twin.simulation.command import CommandSetpoints
from softrobot_twin.simulation.contact_newton import ContactLinearized
from softrobot_twin.simulation.contact_solvers import FORCE_SHARE, ContactSolvers
from softrobot_twin.simulation.model import Model
from softrobot_twin.simulation.pressing_contacts import PressingContacts
from softrobot_twin.solvers.contact_problem import ContactProblem, ContactSolution
from softrobot_twin.solvers.inverse_qp import Bounds


class Touch(NamedTuple):
    """What the contacts do in one linearization.

    Attributes:
        multipliers: λ_c [N], shape (contact_row_count,).
        sweeps: Sweeps of the solver.
        residual: Largest residual of gaps and sticking [m].
        force_residual: Largest residual of forces [N].
        converged: The residual is within the scene's tolerance.
        moves: Moves of the slides [m], shape (slide_count,).
        limits: Limits of contact force that are reached, or could not be kept, a name each.
    """

    multipliers: np.ndarray
    sweeps: int
    residual: float
    force_residual: float
    converged: bool
    moves: np.ndarray
    limits: tuple[str, ...] = ()

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
        entry = model.scene.contact or Contact.model_construct()
        self._contacts, self._slides = model.contacts, model.slides
        self._solvers = ContactSolvers(entry)
        self._tensions = self._before = np.zeros(model.actuators.row_count)

    def warm_up(self) -> None:
        """Let every solver that may be needed be compiled now; without contact there is none."""
        if self._contacts.pairs:
            self._solvers.warm_up(self._contacts.rows_per_contact)

    def forget(self) -> None:
        """Forget the last solution."""
        self._tensions = self._before = np.zeros_like(self._tensions)

    def remember(self, tensions: np.ndarray) -> None:
        """Start the next solution from these tensions [N], of cables first, shape (n,)."""
        self._tensions = tensions[: len(self._tensions)]

    def last_solution(self) -> tuple[np.ndarray, np.ndarray]:
        """Tensions of the last linearization's answer [N], shape (cable_count,), and the forces
        that today's contacts had then [N], shape (contact_row_count,)."""
        return self._before, self._contacts.memory.guess

    def held(self, linear: ContactLinearized, shortening, bounds: Bounds, command):
        """What the actuators do when they stay; not asked for where lengths are commanded."""
        self._before = self._tensions
        if isinstance(command, CommandSetpoints):
            return None
        return self.wind(linear, shortening, bounds)

    def wind(
        self, linear: ContactLinearized, shortening: np.ndarray, bounds: Bounds
    ) -> Actuation:
        """Tensions and contact forces when every cable is wound and every slide is moved.

        Args:
            linear: The condensed system.
            shortening: Wound shortening, of slides the way back [m], shape (actuator_count,).
            bounds: Bounds on the tensions [N].

        Returns:
            The actuation; where the contacts did not converge, the nearest that was found.
        """
        cables = linear.cables
        return self._solve(
            linear, shortening, bounds.effort_min[cables], bounds.effort_max[cables]
        )

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
        cables = linear.cables
        wanted = np.clip(tensions, bounds.effort_min, bounds.effort_max)[cables]
        pulled = self._solve(linear, held.displacements, wanted, wanted)
        path = linear.path_shortening(pulled.efforts, pulled.contact.multipliers)
        within = np.clip(path, bounds.displacement_min[cables], bounds.displacement_max[cables])
        shortening = held.displacements.copy()
        shortening[cables] = within
        # What is pulled by nothing may hang slack: its path is shorter than what is wound.
        if ((within == path) | ((wanted <= 0.0) & (within < path))).all():
            return pulled._replace(displacements=shortening)
        return self.wind(linear, shortening, bounds)

    def _solve(
        self, linear: ContactLinearized | PressingContacts, shortening, lower, upper
    ) -> Actuation:
        if isinstance(linear, PressingContacts):
            found = self._pressed(linear, shortening, lower, upper)
            return self._actuation(linear, shortening, found, np.empty(0))
        contacts, count = self._contacts, linear.cables.stop
        moves = -shortening[count:] - linear.slide_positions
        compliance, violation = linear.touching_system
        violation[:count] -= shortening[:count]
        violation[count:] += linear.G_c @ moves
        low_rank = compliance.Yt is not None
        problem = ContactProblem(
            None if low_rank else compliance.W, violation, lower, upper, contacts.friction,
            contacts.rows_per_contact, compliance.Yt,
        )  # fmt: skip
        guess, expected = self._guesses()
        found = self._solvers.solve(problem, guess, expected, contacts.margin)
        return self._actuation(linear, shortening, found, moves)

    def _actuation(self, linear, shortening, found: ContactSolution, moves) -> Actuation:
        count = linear.cables.stop
        self._tensions = found.multipliers[:count]
        touch = Touch(
            found.multipliers[count:], found.sweeps, found.gap_residual, found.force_residual,
            found.converged, moves,
        )  # fmt: skip
        return Actuation(
            self.with_loads(linear, self._tensions, touch), np.asarray(shortening), contact=touch
        )

    def _guesses(self) -> tuple[np.ndarray, np.ndarray]:
        """All multipliers of the last solution, and those that are expected in this step [N]."""
        memory, tensions = self._contacts.memory, self._tensions
        return (np.concatenate([tensions, memory.guess]),
                np.concatenate([tensions, memory.expected]))

    def _pressed(
        self, linear: PressingContacts, shortening, lower, upper
    ) -> ContactSolution:
        """All multipliers by those contacts that press, and the gaps of the others.

        What crosses in the solution joins those that press. The second time all do.
        """
        count, contacts = linear.cables.stop, self._contacts
        guess, expected = self._guesses()
        sweeps, rounds = 0, 0
        while True:
            rows = np.concatenate([np.arange(count), count + linear.contact_rows])
            violation = linear.violation.copy()
            violation[:count] -= shortening[:count]
            problem = ContactProblem(
                linear.W, violation, lower, upper, contacts.friction[linear.chosen],
                contacts.rows_per_contact,
            )  # fmt: skip
            found = self._solvers.solve(
                problem, guess[rows], expected[rows], contacts.margin
            )
            sweeps, rounds = sweeps + found.sweeps, rounds + 1
            multipliers = np.zeros(len(guess))
            multipliers[rows] = found.multipliers
            gaps = linear.gaps(found.multipliers)
            crossing = gaps < -self._allowed_crossing(problem, found)
            if not crossing.any():
                crossed = max(0.0, -gaps.min(initial=np.inf))
                return found._replace(
                    multipliers=multipliers, sweeps=sweeps,
                    gap_residual=max(found.gap_residual, crossed),
                )  # fmt: skip
            guess = expected = multipliers
            linear.take(crossing if rounds == 1 else gaps < np.inf)

    def _allowed_crossing(self, problem: ContactProblem, found: ContactSolution) -> float:
        """How far an open contact may cross and count as solved [m]: within the tolerance, and so
        little that it would bear no force that counts."""
        normals = problem.W.diagonal()[len(problem.lower) :: problem.rows_per_contact]
        stiffest = normals[normals > 0.0].min(initial=np.inf)
        force = FORCE_SHARE * np.abs(found.multipliers).max(initial=0.0)
        return min(self._solvers.tolerance, stiffest * force)

    def with_loads(self, linear: ContactLinearized, tensions, touch: Touch) -> np.ndarray:
        """Tensions of cables, then the forces that hold slides [N], shape (actuator_count,)."""
        if self._slides is None:
            return tensions
        loads = self._slides.loads(linear.G_c, touch.multipliers)
        return np.concatenate([tensions, loads])

    def account(self, actuation: Actuation) -> dict:
        """What a report tells of contacts."""
        touch, per_contact = actuation.contact, self._contacts.rows_per_contact
        return {
            "contact_count": int(np.count_nonzero(touch.multipliers[::per_contact] > 0.0)),
            "contact_sweeps": touch.sweeps,
            "contact_residual": touch.residual,
            "contact_force_residual": touch.force_residual,
        }

    def imbalance(self, effectors, linear, held: Actuation | None) -> float:
        """Not known in contact: NaN."""
        return float("nan")
