"""Choice of the solver of a contact problem, by its rank, its size and friction.

Times are those of `tools/contact_growth.py` and of the shipped robots. Which problem needs which:

- Low rank, as of rigid bodies that touch at many points: the proximal Newton method in the unknowns
  of W, 0.2 ms for 225 points.
- Few rows with friction: sweeps with a Newton step between them; without that step the contacts of
  the Grasper and of the Octoleg take 2.5 times as long.
- More rows with friction: the continuation; without it a block that rubs on 90 to 200 points takes
  3 to 5 times as long.
- Few rows without friction: the active set; see `contact_active_set`.
- More rows without friction: sweeps, then the proximal Newton method by the matrix; a thousand sweeps
  take eight times as long on Hertz's problem, or more.
- What the others leave: the same method. It solves nearly all problems; from the start it takes 1.6 to
  10 times as long as the others.
"""

from __future__ import annotations

import numpy as np

from softrobot_twin.scene.schema import Contact
from softrobot_twin.solvers.contact_active_set import solve_by_active_set
from softrobot_twin.solvers.contact_continuation import ContactContinuation
from softrobot_twin.solvers.contact_gauss_seidel import ContactGaussSeidel
from softrobot_twin.solvers.contact_problem import ContactProblem, ContactSolution
from softrobot_twin.solvers.contact_proximal_newton import ContactProximalNewton
from softrobot_twin.solvers.direct_problem import solve_by_daqp

# Rows above which the continuation is used with friction, and no active set without: its time grows
# with the cube of the rows. Sweeps before the active set.
MANY_ROWS, SWEEPS_BEFORE_ACTIVE_SET = 100, 5
# Sweeps after which Newton's method is used: a problem that they have not solved by then takes
# thousands.
FEW_SWEEPS = 60
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
        sweeps: A few sweeps, to exact forces.
        newton, continuation: Newton's method in the unknowns of W, and along a path of problems.
        judge: Computes the residual of a solution.
    """

    def __init__(self, entry: Contact):
        """Set them up.

        Args:
            entry: The contact section of the scene.
        """
        self.tolerance, self._clearance = entry.tolerance, 0.0
        self._short = ContactGaussSeidel(entry.tolerance, min(SWEEPS_BEFORE_ACTIVE_SET, entry.most_sweeps))
        self.sweeps = ContactGaussSeidel(entry.tolerance, min(FEW_SWEEPS, entry.most_sweeps), FORCE_SHARE)
        self._may_go_on = entry.most_sweeps > FEW_SWEEPS
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
        found = self.sweeps.solve(problem, nothing)
        # Any gap is accepted and no force, so that the steps after the last sweep are compiled too.
        ContactGaussSeidel(np.inf, 1, 0.0).solve(problem, nothing)
        self.newton.solve(problem, nothing)
        if rows_per_contact == 3:
            self.continuation.warm_up()
            for guess in (nothing, found.multipliers, -found.multipliers):
                self.continuation.solve(problem, guess, nothing)
            return
        self._with_active_set(problem, nothing)
        solve_by_daqp(problem.W, problem.violation, nothing, nothing)

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
        return self.swept(problem.with_matrix(), guess, expected)

    def swept(self, problem: ContactProblem, guess: np.ndarray, expected: np.ndarray) -> ContactSolution:
        """Sweeps, the active set or the continuation; where these fail, the proximal Newton method.

        Sweeps are slow if the load moves between two nearly identical contacts, or by friction
        along a row of contacts.

        Args:
            problem: The problem, with W.
            guess: Multipliers to begin with [N], shape (row_count,).
            expected: Extrapolated multipliers of this step [N], same shape.
        """
        rubs, is_large = problem.rows_per_contact == 3, len(guess) > MANY_ROWS
        if rubs and is_large:
            found = self.continuation.solve(problem, expected, guess)
        elif rubs or is_large:
            found = self.sweeps.solve(problem, guess)
        else:
            found = self._with_active_set(problem, guess)
        if found.converged or not (self._may_go_on and np.isfinite(found.gap_residual)):
            return found
        exact = self.newton.solve(problem, found.multipliers)
        exact = exact._replace(sweeps=found.sweeps + exact.sweeps)
        return exact if exact.converged else _better(found, exact)

    def _with_active_set(self, problem: ContactProblem, guess: np.ndarray) -> ContactSolution:
        """A few sweeps, and the active set where its residual is smaller.

        Where gaps are exact to the tolerance, forces may still keep a soft body from its rest.
        """
        found = self._short.solve(problem, guess)
        if found.converged and not len(problem.friction):
            return found
        multipliers = solve_by_active_set(problem, found.multipliers, self._clearance)
        if multipliers is None:
            return found
        return _better(found, self.judge.solve(problem, multipliers)._replace(sweeps=found.sweeps))


def _better(found: ContactSolution, other: ContactSolution) -> ContactSolution:
    """The one with the smaller residual; the first if both are equal."""
    return other if other.gap_residual < found.gap_residual else found
