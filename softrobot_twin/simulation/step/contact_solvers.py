"""Choice of the solver of a contact problem, by its rank, its size and friction."""

from __future__ import annotations

import numpy as np

from softrobot_twin.scene.schema import Contact
from softrobot_twin.solvers.contact_active_set import solve_by_active_set
from softrobot_twin.solvers.contact_continuation import ContactContinuation
from softrobot_twin.solvers.contact_gauss_seidel import ContactGaussSeidel
from softrobot_twin.solvers.contact_problem import ContactProblem, ContactSolution
from softrobot_twin.solvers.contact_proximal_newton import ContactProximalNewton
from softrobot_twin.solvers.direct_problem import solve_by_daqp

# Sweeps after which an active set is used, without friction and with few rows: its time grows with
# the cube of the rows.
FEW_SWEEPS, MANY_ROWS = 5, 100
# Sweeps after which Newton's method is used with friction: a problem that they have not solved by
# then takes thousands.
SWEEPS_THAT_RUB = 60
# Contacts with a gap above this share of the alarm distance are not expected to close in a step.
CLEARANCE = 0.125
# Tolerance of forces, as a share of the largest.
FORCE_SHARE = 1.0e-6
# Contacts of the problem by which solvers are warmed up.
WARM_CONTACTS = 8
# The time of Newton's method in the unknowns of W grows with the cube of their number.
MOST_RANK = 120


class ContactSolvers:
    """The solvers of a scene's contacts, and their order.

    Attributes:
        tolerance: Residual at which a solution is good enough [m].
        rubbing, sweeps: A few sweeps, to exact forces and to the tolerance alone.
        newton, continuation: Newton's method in the unknowns of W, and along a path of problems.
        judge: Computes the residual of a solution.
    """

    def __init__(self, entry: Contact):
        """Set them up.

        Args:
            entry: The contact section of the scene.
        """
        self.tolerance, self._clearance = entry.tolerance, 0.0
        self._solver = ContactGaussSeidel(entry.tolerance, entry.most_sweeps)
        self._short = ContactGaussSeidel(entry.tolerance, min(FEW_SWEEPS, entry.most_sweeps))
        rubbing = min(SWEEPS_THAT_RUB, entry.most_sweeps)
        self.rubbing = ContactGaussSeidel(entry.tolerance, rubbing, FORCE_SHARE)
        self.sweeps = ContactGaussSeidel(entry.tolerance, rubbing)
        self._may_go_on = entry.most_sweeps > SWEEPS_THAT_RUB
        self.newton = ContactProximalNewton(entry.tolerance, FORCE_SHARE)
        self.continuation = ContactContinuation(entry.tolerance, FORCE_SHARE)
        # Without a sweep it only computes the residual of a solution.
        self.judge = ContactGaussSeidel(entry.tolerance, 0)

    def warm_up(self, rows_per_contact: int) -> None:
        """Solve a small problem with every solver that a scene may use, so that none is compiled
        later.

        Args:
            rows_per_contact: 3 (normal and two tangents), or 1 without friction.
        """
        Yt = np.random.default_rng(0).standard_normal((WARM_CONTACTS * rows_per_contact, MOST_RANK))
        count, none = len(Yt), np.empty(0)
        friction = np.full(WARM_CONTACTS, 0.5 if rows_per_contact == 3 else 0.0)
        low = ContactProblem(None, np.full(count, -1.0), none, none, friction, rows_per_contact, Yt)
        problem, nothing = low.with_matrix(), np.zeros(count)
        self.newton.solve(low, nothing)
        self._solver.solve(problem, nothing)
        if rows_per_contact == 1:
            self._finished(problem, self._short.solve(problem, nothing))
            solve_by_daqp(problem.W, problem.violation, nothing, nothing)
            return
        found = self.rubbing.solve(problem, nothing)
        # Any gap is accepted and no force, so that the steps after the last sweep are compiled too.
        ContactGaussSeidel(np.inf, 1, 0.0).solve(problem, nothing)
        self.newton.solve(problem, nothing)
        self.continuation.warm_up()
        for guess in (nothing, found.multipliers, -found.multipliers):
            self.continuation.solve(problem, guess, nothing)
            self.continuation.end(problem, guess)

    def solve(
        self, problem: ContactProblem, guess: np.ndarray, expected: np.ndarray, margin: float
    ) -> ContactSolution:
        """Solve by Newton's method in the unknowns of W if they are few; else by sweeps.

        Args:
            problem: The problem.
            guess: Multipliers of the last step [N], shape (n,).
            expected: Extrapolated multipliers of this step [N], shape (n,).
            margin: Alarm distance of contacts [m].
        """
        self._clearance = CLEARANCE * margin
        if problem.Yt is not None and problem.Yt.shape[1] <= MOST_RANK:
            found = self.newton.solve(problem, guess)
            if found.converged:
                return found
            return _better(found, self.swept(problem.with_matrix(), guess, expected))
        problem = problem.with_matrix()
        return self.swept(problem, guess, expected)

    def swept(
        self, problem: ContactProblem, guess: np.ndarray, expected: np.ndarray
    ) -> ContactSolution:
        """Sweeps; if they converge slowly, Newton's method. Without friction an active set makes a
        few rows exact.

        They are slow if the load moves between two nearly identical contacts, or by friction along
        a row of contacts.

        Args:
            problem: The problem.
            guess: Multipliers to begin with [N], shape (row_count,).
            expected: Extrapolated multipliers of this step [N], same shape.
        """
        if problem.rows_per_contact != 1:
            if len(guess) > MANY_ROWS:
                found = self._continued(problem, guess, expected)
            else:
                found = self.rubbing.solve(problem, guess)
            if found.converged or not (self._may_go_on and np.isfinite(found.gap_residual)):
                return found
            exact = self.newton.solve(problem, found.multipliers)
            return _better(found, exact._replace(sweeps=found.sweeps + exact.sweeps))
        soon = len(guess) <= MANY_ROWS
        found = (self._short if soon else self._solver).solve(problem, guess)
        # Where gaps are exact to the tolerance, forces may still keep a soft body from its rest.
        if soon and len(problem.friction) or not found.converged:
            found = self._finished(problem, found)
        if soon and not found.converged:
            found = _better(found, self._solver.solve(problem, found.multipliers))
        return found

    def _continued(
        self, problem: ContactProblem, guess: np.ndarray, expected: np.ndarray
    ) -> ContactSolution:
        """Newton's method from the extrapolated forces; if it fails, sweeps from its best forces.

        The residual of sweeps is small in metres, not in newtons: Newton's method reduces it.
        """
        found = self.continuation.solve(problem, expected, guess)
        if found.converged:
            return found
        swept = self.sweeps.solve(problem, found.multipliers)
        swept = swept._replace(sweeps=found.sweeps + swept.sweeps)
        if not swept.converged or has_exact_forces(swept):
            return swept
        for exactly in (self.continuation.end, self.newton.solve):
            ended = exactly(problem, swept.multipliers)
            swept = swept._replace(sweeps=swept.sweeps + ended.sweeps)
            if ended.converged:
                return ended._replace(sweeps=swept.sweeps)
        return swept

    def _finished(self, problem: ContactProblem, found: ContactSolution) -> ContactSolution:
        """The solution by an active set, if its residual is smaller."""
        multipliers = solve_by_active_set(problem, found.multipliers, self._clearance)
        if multipliers is None:
            return found
        return _better(found, self.judge.solve(problem, multipliers)._replace(sweeps=found.sweeps))


def has_exact_forces(found: ContactSolution) -> bool:
    """Whether the residual in newtons is a small share of the largest force.

    Args:
        found: What a solver found.
    """
    return found.force_residual <= FORCE_SHARE * np.abs(found.multipliers).max(initial=0.0)


def _better(found: ContactSolution, other: ContactSolution) -> ContactSolution:
    """The one with the smaller residual; the first if both are equal."""
    return other if other.gap_residual < found.gap_residual else found
