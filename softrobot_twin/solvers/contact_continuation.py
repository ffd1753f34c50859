"""Newton's method from forces that are nearly right, for many contacts in full rank.

From step to step most contacts stay open, sticking or sliding, and forces change little and
smoothly. Continued from the two steps before, they lie so near the solution that the Newton step
of `contact_newton` converges at once, where sweeps, and Newton steps from the last forces alone,
first have to find out how far each contact slides. The elimination is LAPACK's, and one is enough
as long as no contact changes its state and the residual falls fast by it (the simplified Newton
method, Deuflhard 2011, section 2.1).

The answer is judged by the natural map of the whole problem: what is called solved is solved,
whatever it was begun with. Where the residual does not fall the method gives up soon; then sweeps
are asked.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from scipy.linalg import lapack

from softrobot_twin.solvers import contact_newton as newton
from softrobot_twin.solvers import contact_sweeps as sweeps
from softrobot_twin.solvers.contact_cone import CONTACT_SIZE, KERNEL
from softrobot_twin.solvers.contact_problem import ContactProblem, ContactSolution

# Steps at most, and systems factorized at most.
MOST_STEPS, MOST_SYSTEMS = 16, 5
# A step goes on with the system of an earlier one where so many of these are expected to suffice:
# they take as long as another factorization.
MOST_REPEATS = 5.0
# A step that leaves more than this share of the residual leads nowhere: sweeps from the best forces
# so far then find out who opens and closes, once; and before the first step where contacts
# cross that bear nothing yet.
SLOW, SWEEPS, MOST_RESTARTS = 0.7, 8, 1
# Share of a row's own compliance added to the diagonal, around the forces of the step before, so
# that redundant contacts divide what they carry.
PROXIMAL = 1.0e-4


class ContactContinuation:
    """Solves contact problems whose forces are nearly known.

    The same input gives the same bits. Not to be used by two threads at once.

    Attributes:
        tolerance: Residual at which a solution is good enough [m].
        force_share: The same in newtons, as a share of the largest force.
    """

    def __init__(self, tolerance: float, force_share: float):
        self.tolerance = tolerance
        self.force_share = force_share
        self._room = np.empty(0)

    def warm_up(self) -> None:
        """Compile what only a second step with the same matrix asks for; see `solve`."""
        rows, kinds = np.zeros((2, 1), dtype=np.int64)
        nothing, frame = np.zeros(1), np.zeros((1, 4))
        newton.fill_right_side(nothing, nothing, rows, kinds, frame, 1, np.empty(1))

    def solve(
        self, problem: ContactProblem, guess: np.ndarray, other: np.ndarray
    ) -> ContactSolution:
        """Multipliers from one of two guesses, that with the smaller residual.

        Args:
            problem: The problem, with W.
            guess: Multipliers that are expected [N], shape (n,).
            other: Others, in case that less is left by them [N], shape (n,).

        Returns:
            The solution; the best that was found, not converged, if the residual did not fall. If
            the problem or a guess is not finite the other guess, with infinite residuals.
        """
        W = np.ascontiguousarray(problem.W)
        bounds = (problem.lower, problem.upper, problem.friction, problem.rows_per_contact)
        n = len(W)
        # W = YᵀY: what is not finite in it shows on its diagonal.
        given = (problem.violation, problem.friction, guess, other, W.diagonal())
        if not all(np.isfinite(part).all() for part in given):
            return ContactSolution(other, np.inf, np.inf, 0, False)
        force, delta = begin(W, problem.violation, *bounds, guess)
        best = (force, *sweeps.residual(W, *bounds, force, delta))
        begun, begun_delta = begin(W, problem.violation, *bounds, other)
        gap, newtons = sweeps.residual(W, *bounds, begun, begun_delta)
        if not best[2] <= newtons:
            force, delta, best = begun, begun_delta, (begun, gap, newtons)
        if self._closes(problem, force, delta):
            force, delta = sweep(W, problem.violation, *bounds, best[0], SWEEPS)
            best = (force, *sweeps.residual(W, *bounds, force, delta))
        _, gap, newtons = best
        rows, kinds = np.empty((2, n), dtype=np.int64)
        frame, right = np.empty((n, 4)), np.empty(n)
        factor, states, share = None, None, 1.0
        made = systems = restarts = 0
        while not self._is_solved(force, gap, newtons) and made < MOST_STEPS:
            count = newton.active_rows(W, *bounds, force, delta, rows, kinds, frame)
            now = rows[:count].tobytes() + kinds[:count].tobytes()
            force = force + frame[:, 3]
            sweeps.motion(W, problem.violation, force, delta)
            asked = self.force_share * np.abs(force).max()
            step = right[:0]
            if count == 0:
                states = now
            elif now == states and share ** MOST_REPEATS * newtons <= asked:
                newton.fill_right_side(force, delta, rows, kinds, frame, count, right)
            elif systems < MOST_SYSTEMS:
                matrix = self._square(count)
                newton.fill_system(
                    W, force, delta, rows, kinds, frame, count, PROXIMAL, matrix, right
                )
                # LAPACK stores columns: to it this is the transposed matrix, and nothing is copied.
                *factor, singular = lapack.dgetrf(matrix.T, overwrite_a=True)
                states, systems = now, systems + 1
                if singular:
                    break
            else:
                break
            if count > 0:
                step, _ = lapack.dgetrs(*factor, right[:count], trans=1)
            newton.apply_step(rows, kinds, frame, count, step, force)
            force, delta = begin(W, problem.violation, *bounds, force)
            before = newtons
            gap, newtons = sweeps.residual(W, *bounds, force, delta)
            made, share = made + 1, newtons / before
            if newtons < best[2]:
                best = (force, gap, newtons)
            if not share <= SLOW and not self._is_solved(force, gap, newtons):
                if restarts == MOST_RESTARTS:
                    break
                restarts, states = restarts + 1, None
                force, delta = sweep(W, problem.violation, *bounds, best[0], SWEEPS)
                gap, newtons = sweeps.residual(W, *bounds, force, delta)
        if not np.isfinite(best[0]).all():
            return ContactSolution(other, np.inf, np.inf, made, False)
        return ContactSolution(*best, made, self._is_solved(*best))

    def end(self, problem: ContactProblem, guess: np.ndarray) -> ContactSolution:
        """Multipliers from a guess that is all but a solution; see `solve`."""
        return self.solve(problem, guess, guess)

    def _is_solved(self, force: np.ndarray, gap: float, newtons: float) -> bool:
        asked = self.force_share * np.abs(force).max(initial=0.0)
        return bool(gap <= self.tolerance and newtons <= asked)

    def _closes(self, problem: ContactProblem, force: np.ndarray, delta: np.ndarray) -> bool:
        """Whether contacts cross that bear nothing yet."""
        normals = slice(len(problem.lower), None, problem.rows_per_contact)
        return bool(((force[normals] == 0.0) & (delta[normals] < -self.tolerance)).any())

    def _square(self, count: int) -> np.ndarray:
        """Room for a system, shape (count, count)."""
        if count * count > len(self._room):
            self._room = np.empty(2 * count * count)
        return self._room[: count * count].reshape(count, count)


@njit(**KERNEL)
def begin(W, violation, lower, upper, friction, per_contact, guess):
    """Admissible forces next to a guess, and the motion δ with them."""
    force, delta = guess.copy(), np.empty(len(violation))
    sweeps.admissible(lower, upper, friction, per_contact, force)
    sweeps.motion(W, violation, force, delta)
    return force, delta


@njit(**KERNEL)
def sweep(W, violation, lower, upper, friction, per_contact, guess, count):
    """Forces and motion δ after some Gauss–Seidel sweeps from admissible forces."""
    force, delta = begin(W, violation, lower, upper, friction, per_contact, guess)
    local = np.empty((len(friction), CONTACT_SIZE))
    if per_contact == 3:
        sweeps.measure_contacts(W, len(lower), friction, local)
    for _ in range(count):
        sweeps.sweep(W, lower, upper, friction, per_contact, local, force, delta)
    return force, delta
