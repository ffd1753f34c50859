"""How λ is found when actuators are commanded and bodies touch: one problem for both."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softrobot_twin.scene.surroundings import Contact
from softrobot_twin.simulation.actuation import Actuation
from softrobot_twin.simulation.command import SetLengths
from softrobot_twin.simulation.contact_newton import ContactLinearized
from softrobot_twin.simulation.model import Model
from softrobot_twin.solvers.contact_active_set import compile_active_set, solve_by_active_set
from softrobot_twin.solvers.contact_continuation import ContactContinuation
from softrobot_twin.solvers.contact_gauss_seidel import ContactGaussSeidel
from softrobot_twin.solvers.contact_problem import ContactProblem, ContactSolution
from softrobot_twin.solvers.contact_proximal_matrix import ContactProximalMatrix
from softrobot_twin.solvers.contact_proximal_newton import ContactProximalNewton
from softrobot_twin.solvers.inverse_qp import Bounds


# Sweeps after which an active set takes over, as long as nothing rubs and rows are not many: its
# time grows with their cube.
FEW_SWEEPS, MANY_ROWS = 5, 100
# Sweeps after which Newton's method takes over where things rub: what they have not solved then
# they hardly solve in thousands.
SWEEPS_THAT_RUB = 60
# Contacts with a gap beyond this share of what is watched are not expected to touch in a step.
CLEARANCE = 0.125
# How exactly forces are solved, as a share of the largest.
FORCE_SHARE = 1.0e-6
# Newton's method in the unknowns that W has costs as the cube of their number.
MOST_RANK = 120


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
        self._solver = ContactGaussSeidel(entry.tolerance, entry.most_sweeps)
        self._short = ContactGaussSeidel(entry.tolerance, min(FEW_SWEEPS, entry.most_sweeps))
        rubbing = min(SWEEPS_THAT_RUB, entry.most_sweeps)
        self._rubbing = ContactGaussSeidel(entry.tolerance, rubbing)
        self._may_go_on = entry.most_sweeps > SWEEPS_THAT_RUB
        self._newton = ContactProximalNewton(entry.tolerance, FORCE_SHARE)
        self._continuation = ContactContinuation(entry.tolerance, FORCE_SHARE)
        self._matrix_newton = ContactProximalMatrix(entry.tolerance, FORCE_SHARE)
        # Without a sweep it only says how far an answer is from solving the problem.
        self._judge = ContactGaussSeidel(entry.tolerance, 0)
        if model.contacts.rows_per_contact == 1:
            compile_active_set()
        self._tensions = self._before = np.zeros(len(model.scene.cables))

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
        if isinstance(command, SetLengths):
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
            linear, shortening, bounds.tension_min[cables], bounds.tension_max[cables]
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
        wanted = np.clip(tensions, bounds.tension_min, bounds.tension_max)[cables]
        pulled = self._solve(linear, held.shortening, wanted, wanted)
        path = path_shortening(linear, pulled)
        within = np.clip(path, bounds.shortening_min[cables], bounds.shortening_max[cables])
        shortening = held.shortening.copy()
        shortening[cables] = within
        # What is pulled by nothing may hang slack: its path is shorter than what is wound.
        if ((within == path) | ((wanted <= 0.0) & (within < path))).all():
            return pulled._replace(shortening=shortening)
        return self.wind(linear, shortening, bounds)

    def _solve(self, linear: ContactLinearized, shortening, lower, upper) -> Actuation:
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
        guess = np.concatenate([self._tensions, contacts.memory.guess])
        found = self._found(problem, guess)
        self._tensions = found.multipliers[:count]
        touch = Touch(
            found.multipliers[count:], found.sweeps, found.gap_residual, found.force_residual,
            found.converged, moves,
        )  # fmt: skip
        return Actuation(
            self.with_loads(linear, self._tensions, touch), np.asarray(shortening), contact=touch
        )

    def _found(self, problem: ContactProblem, guess: np.ndarray) -> ContactSolution:
        """By Newton's method in the unknowns that W has, where they are few; else by sweeps."""
        if problem.Yt is not None and problem.Yt.shape[1] <= MOST_RANK:
            found = self._newton.solve(problem, guess)
            if found.converged:
                return found
            return _better(found, self._swept(problem.with_matrix(), guess))
        problem = problem.with_matrix()
        return self._swept(problem, guess)

    def _swept(self, problem: ContactProblem, guess: np.ndarray) -> ContactSolution:
        """Sweeps; where they do not converge soon, Newton's method, or as long as nothing rubs an
        active set.

        They do not where two contacts are all but one and the load goes over to the other, nor
        where friction hands it on along a whole row of contacts.
        """
        if problem.rows_per_contact != 1:
            if len(guess) > MANY_ROWS:
                found = self._continued(problem, guess)
            else:
                found = self._rubbing.solve(problem, guess)
            if found.converged or not (self._may_go_on and np.isfinite(found.gap_residual)):
                return found
            exact = self._matrix_newton.solve(problem, found.multipliers)
            return _better(found, exact._replace(sweeps=found.sweeps + exact.sweeps))
        soon = len(guess) <= MANY_ROWS
        found = (self._short if soon else self._solver).solve(problem, guess)
        if not found.converged:
            found = self._finished(problem, found)
        if soon and not found.converged:
            found = _better(found, self._solver.solve(problem, found.multipliers))
        return found

    def _continued(self, problem: ContactProblem, guess: np.ndarray) -> ContactSolution:
        """Newton's method from where the forces are expected, where that fails sweeps from there.

        What sweeps leave is small in metres, not in newtons: Newton's method ends it.
        """
        expected = np.concatenate([self._tensions, self._contacts.memory.expected])
        found = self._continuation.solve(problem, expected, guess)
        if found.converged:
            return found
        swept = self._rubbing.solve(problem, found.multipliers)
        done = found.sweeps + swept.sweeps
        if swept.converged:
            largest = np.abs(swept.multipliers).max(initial=0.0)
            if swept.force_residual > FORCE_SHARE * largest:
                ended = self._continuation.solve(problem, swept.multipliers, swept.multipliers)
                done += ended.sweeps
                swept = ended if ended.converged else swept
        return swept._replace(sweeps=done)

    def _finished(self, problem: ContactProblem, found: ContactSolution) -> ContactSolution:
        """The answer by an active set, where it is nearer."""
        clearance = CLEARANCE * self._contacts.margin
        multipliers = solve_by_active_set(problem, found.multipliers, clearance)
        if multipliers is None:
            return found
        return _better(found, self._judge.solve(problem, multipliers)._replace(sweeps=found.sweeps))

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


def _better(found: ContactSolution, other: ContactSolution) -> ContactSolution:
    """The one with the smaller residual; where both are alike the first."""
    return other if other.gap_residual < found.gap_residual else found


def path_shortening(linear: ContactLinearized, actuation: Actuation) -> np.ndarray:
    """Shortening of each cable's path [m], shape (cable_count,)."""
    a, c = linear.cables, linear.contacts
    multipliers = np.zeros(len(linear.violation))
    multipliers[a], multipliers[c] = actuation.tensions[a], actuation.contact.multipliers
    return linear.compliance.motion(a, multipliers) + linear.violation[a]
