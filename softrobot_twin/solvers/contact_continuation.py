"""Newton's method from forces that are nearly known, for many contacts whose W has full rank.

Blocks that rub on 90 points or more need it: without it, contacts take 3 to 5 times as long. Without
its pivoting they take up to twice as long, and the slowest steps up to nine times.

From step to step most contacts stay open, sticking or sliding, and forces change little and
smoothly. Extrapolated from the last two steps, they are so near the solution that a few
Gauss–Seidel sweeps and one Newton step of `contact_newton_step` solve most problems. LAPACK
factorizes the system, and one factorization is enough as long as no contact changes its state and
the residual falls fast (the simplified Newton method, Deuflhard 2011, section 2.1).

Where many contacts open and close, Newton's method may cycle. Then the directions in which
contacts slide are fixed for a while. A linear complementarity problem remains, of the normal forces
and of the sticking contacts: block principal pivoting solves it (Judice and Pires 1994). It
terminates where Newton's method does not, because it changes a single row as soon as changing all
infeasible rows at once does not help. Sweeps then update the directions.

The solution is judged by the natural map of the whole problem, independently of how it was found.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg import lapack

from softrobot_twin.kernels.compilation import KERNEL, njit
from softrobot_twin.solvers import (
    contact_gauss_seidel as gauss_seidel,
)
from softrobot_twin.solvers import (
    contact_newton_step as newton,
)
from softrobot_twin.solvers.contact_law import CONTACT_SIZE, admissible, copy_into
from softrobot_twin.solvers.contact_problem import ContactProblem, ContactSolution

# A step reuses the factors of the last one where this many such steps are expected to suffice:
# they take as long as another factorization.
MOST_REPEATS = 5.0
# Newton steps in one round at most. A step that leaves more than this share of the least residual so
# far does not help; a round ends where more than so many in succession do not.
MOST_STEPS, SLOW, PATIENCE = 10, 0.7, 1
# Newton's method begins at once where the residual is below this share of the largest force.
NEAR = 3.0e-3
# Sweeps before the first step, after each pivoting, and before it, there as many more in each round.
SWEEPS = 5
# Rounds of Newton steps, all but the first one after pivoting.
MOST_ROUNDS = 4
# Pivots of one problem at most; those that may be made without fewer infeasible rows before rows
# are changed one by one; what counts as zero, as a share of the largest force.
MOST_PIVOTS, MOST_BLOCK_PIVOTS, PIVOT_ROUND_OFF = 40, 3, 1.0e-12
# Share of a row's own compliance added to the diagonal, around the forces of the step before, so
# that redundant contacts divide what they carry.
PROXIMAL = 1.0e-4


class _Forces(NamedTuple):
    """Forces and their residual.

    Attributes:
        force: λ [N], shape (n,).
        delta: δ by them [m], shape (n,).
        gap: Largest residual [m].
        newtons: Largest residual [N].
    """

    force: np.ndarray
    delta: np.ndarray
    gap: float
    newtons: float


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
        self._buffer = np.empty(0)

    def warm_up(self) -> None:
        """Compile what only some problems need: a repeated matrix, and pivoting."""
        rows, kinds = np.zeros((2, 1), dtype=np.int64)
        nothing, frame = np.zeros(1), np.zeros((1, 4))
        newton.fill_right_side(nothing, nothing, rows, kinds, frame, 1, np.empty(1))
        none, three = np.empty(0), np.zeros(3)
        touching = ContactProblem(np.eye(3), three, none, none, np.ones(1), 3)
        solve_with_held_directions(*_given(touching), three, three, PROXIMAL)

    def solve(self, problem: ContactProblem, guess: np.ndarray, other: np.ndarray) -> ContactSolution:
        """Multipliers from the one of two guesses that has the smaller residual.

        Args:
            problem: The problem, with W.
            guess: Multipliers that are expected [N], shape (n,).
            other: Others, used where their residual is smaller [N], shape (n,).

        Returns:
            The solution; what the last round found, not converged, if no round converged. If
            the problem or a guess is not finite the other guess, with infinite residuals.
        """
        W = np.ascontiguousarray(problem.W)
        # W = YᵀY: what is not finite in it shows on its diagonal.
        given = (problem.violation, problem.friction, guess, other, W.diagonal())
        if not all(np.isfinite(part).all() for part in given):
            return ContactSolution(other, np.inf, np.inf, 0, False)
        problem = problem._replace(W=W)
        best = self._nearer(problem, guess, other)
        if not self._is_solved(best):
            best = self._swept(problem, best, SWEEPS)
        made, asked = 0, NEAR * np.abs(best.force).max(initial=0.0)
        if best.newtons <= asked:
            best, made = self._newton_steps(problem, best)
        for round_ in range(1, MOST_ROUNDS):
            if self._is_solved(best):
                break
            start = self._pivoted(problem, self._swept(problem, best, SWEEPS * round_))
            best, more = self._newton_steps(problem, start)
            made += more + 1
        if not np.isfinite(best.force).all():
            return ContactSolution(other, np.inf, np.inf, made, False)
        return ContactSolution(
            best.force, best.gap, best.newtons, made, self._is_solved(best)
        )

    def _nearer(self, problem: ContactProblem, guess: np.ndarray, other: np.ndarray) -> _Forces:
        """The guess with the smaller residual, admissible; the other if both are alike."""
        first = _judged(problem, *begin(*_given(problem), guess))
        if other is guess:
            return first
        second = _judged(problem, *begin(*_given(problem), other))
        return first if first.newtons <= second.newtons else second

    def _swept(self, problem: ContactProblem, start: _Forces, count: int) -> _Forces:
        return _judged(problem, *sweep(*_given(problem), start.force, count))

    def _newton_steps(self, problem: ContactProblem, start: _Forces) -> tuple[_Forces, int]:
        """Newton steps as long as they help; the forces with the least residual, and steps made."""
        W, violation, *bounds = _given(problem)
        n = len(W)
        rows, kinds = np.empty((2, n), dtype=np.int64)
        frame, right = np.empty((n, 4)), np.empty(n)
        factor, states, share = None, None, 1.0
        now = best = start
        failed = made = 0
        while made < MOST_STEPS and not self._is_solved(now):
            force, delta = now.force, now.delta
            count = newton.active_rows(W, *bounds, force, delta, rows, kinds, frame)
            found = rows[:count].tobytes() + kinds[:count].tobytes()
            force, delta = force + frame[:, 3], np.empty(n)
            gauss_seidel.motion(W, violation, force, delta)
            asked = self.force_share * np.abs(force).max()
            step = right[:0]
            if count > 0 and found == states and share**MOST_REPEATS * now.newtons <= asked:
                newton.fill_right_side(force, delta, rows, kinds, frame, count, right)
            elif count > 0:
                matrix = self._square(count)
                newton.fill_system(
                    W, force, delta, rows, kinds, frame, count, PROXIMAL, matrix, right
                )
                # LAPACK stores columns: it sees the transposed matrix, and nothing is copied.
                *factor, singular = lapack.dgetrf(matrix.T, overwrite_a=True)
                if singular:
                    break
            states = found
            if count > 0:
                step, _ = lapack.dgetrs(*factor, right[:count], trans=1)
            newton.apply_step(rows, kinds, frame, count, step, force)
            before, now = now, _judged(problem, *begin(W, violation, *bounds, force))
            made, share = made + 1, now.newtons / before.newtons
            failed = 0 if now.newtons <= SLOW * best.newtons else failed + 1
            if now.newtons < best.newtons or self._is_solved(now):
                best = now
            if failed > PATIENCE:
                break
        return best, made

    def _pivoted(self, problem: ContactProblem, start: _Forces) -> _Forces:
        """Forces by pivoting with held directions, and some sweeps."""
        try:
            force = solve_with_held_directions(*_given(problem), start.force, start.delta, PROXIMAL)
        except np.linalg.LinAlgError:
            force = start.force
        return self._swept(problem, start._replace(force=force), SWEEPS)

    def _is_solved(self, found: _Forces) -> bool:
        asked = self.force_share * np.abs(found.force).max(initial=0.0)
        return bool(found.gap <= self.tolerance and found.newtons <= asked)

    def _square(self, count: int) -> np.ndarray:
        """Buffer for a system, shape (count, count)."""
        if count * count > len(self._buffer):
            self._buffer = np.empty(2 * count * count)
        return self._buffer[: count * count].reshape(count, count)


def _given(problem: ContactProblem) -> tuple:
    """The arguments of the kernels."""
    return problem[:6]


def _judged(problem: ContactProblem, force: np.ndarray, delta: np.ndarray) -> _Forces:
    W, _, *bounds = _given(problem)
    return _Forces(force, delta, *gauss_seidel.residual(W, *bounds, force, delta))


@njit(**KERNEL)
def solve_with_held_directions(W, violation, lower, upper, friction, per_contact, force, delta, share):
    """Forces where each contact slides along the direction of the natural map, or sticks.

    Args:
        W: Compliance [m/N], shape (n, n).
        violation: Motion without multipliers [m], shape (n,).
        lower: Least multiplier of each actuator [N].
        upper: Greatest one [N].
        friction: µ of each contact.
        per_contact: Rows of a contact, 1 or 3.
        force: λ, admissible [N], shape (n,).
        delta: δ by it [m], shape (n,).
        share: Share of each row's own compliance that is added to the diagonal around `force`.

    Returns:
        λ [N], shape (n,): of what slides on the cone's surface, of what sticks anywhere.
    """
    n, actuators = len(force), len(lower)
    rows, frame, count = np.empty(n, dtype=np.int64), np.zeros((n, 4)), 0
    least, greatest = np.empty(n), np.empty(n)
    state = np.zeros(n, dtype=np.int64)
    for i in range(actuators):
        if W[i, i] > 0.0:
            rows[count], least[count], greatest[count] = i, lower[i], upper[i]
            z = force[i] - delta[i] / W[i, i]
            state[count] = -1 if z <= lower[i] else 1 if z >= upper[i] else 0
            count += 1
    for k in range(len(friction)):
        i = actuators + per_contact * k
        if not W[i, i] > 0.0:
            continue
        rows[count], least[count], greatest[count] = i, 0.0, np.inf
        z_n = force[i] - delta[i] / W[i, i]
        state[count] = 0 if z_n > 0.0 else -1
        count += 1
        if per_contact == 1 or friction[k] == 0.0:
            continue
        w = 0.5 * (W[i + 1, i + 1] + W[i + 2, i + 2])
        if not w > 0.0:
            continue
        z_1, z_2 = force[i + 1] - delta[i + 1] / w, force[i + 2] - delta[i + 2] / w
        length = np.hypot(z_1, z_2)
        if z_n > 0.0 and length <= friction[k] * (force[i] if force[i] > 0.0 else z_n):
            for j in (i + 1, i + 2):
                rows[count], least[count], greatest[count] = j, -np.inf, np.inf
                count += 1
        elif length > 0.0:
            frame[i, 0], frame[i, 1], frame[i, 2] = z_1 / length, z_2 / length, friction[k]
    matrix, right = np.empty((count, count)), np.empty(count)
    newton.fill_matrix(W, rows, np.full(count, newton.PLAIN), frame, count, matrix)
    for a in range(count):
        i = rows[a]
        matrix[a, a] += share * W[i, i]
        right[a] = violation[i] - share * W[i, i] * force[i]
    x = pivot(matrix, right, least[:count], greatest[:count], state[:count])
    found = np.zeros(n)
    for i in range(actuators):
        found[i] = force[i]
    for a in range(count):
        i = rows[a]
        found[i] = x[a]
        if frame[i, 2] > 0.0:
            found[i + 1] = frame[i, 2] * frame[i, 0] * max(x[a], 0.0)
            found[i + 2] = frame[i, 2] * frame[i, 1] * max(x[a], 0.0)
    return found


@njit(**KERNEL)
def pivot(matrix, right, least, greatest, state):
    """x between bounds with y = matrix x + right complementary to it, by block pivoting.

    Args:
        matrix: Shape (m, m).
        right: Shape (m,).
        least: Least x, shape (m,).
        greatest: Greatest one.
        state: Expected: -1 at the least x, 1 at the greatest, 0 between (y = 0). Changed.

    Returns:
        x, shape (m,); where `MOST_PIVOTS` are not enough, with some rows infeasible.
    """
    count, fewest, left = len(right), len(right) + 1, MOST_BLOCK_PIVOTS
    x, following = np.empty(count), np.empty(count, dtype=np.int64)
    for _ in range(MOST_PIVOTS):
        free = np.flatnonzero(state == 0)
        y = right.copy()
        for j in range(count):
            x[j] = least[j] if state[j] < 0 else greatest[j] if state[j] > 0 else 0.0
            if x[j] != 0.0:
                y += matrix[:, j] * x[j]
        if len(free) > 0:
            system = np.empty((len(free), len(free)))
            for a in range(len(free)):
                for b in range(len(free)):
                    system[a, b] = matrix[free[a], free[b]]
            solved = np.linalg.solve(system, -y[free])
            for a in range(len(free)):
                x[free[a]] = solved[a]
        small = PIVOT_ROUND_OFF * np.abs(x).max() if count else 0.0
        infeasible, last = 0, -1
        for i in range(count):
            following[i] = state[i]
            if state[i] == 0:
                if x[i] < least[i] - small:
                    following[i] = -1
                elif x[i] > greatest[i] + small:
                    following[i] = 1
            else:
                motion = y[i]
                for b in free:
                    motion += matrix[i, b] * x[b]
                if -state[i] * motion < -small * matrix[i, i]:
                    following[i] = 0
            if following[i] != state[i]:
                infeasible, last = infeasible + 1, i
        if infeasible == 0:
            break
        if infeasible < fewest:
            fewest, left = infeasible, MOST_BLOCK_PIVOTS
        elif left > 0:
            left -= 1
        else:
            state[last] = following[last]
            continue
        copy_into(state, following)
    return x


@njit(**KERNEL)
def begin(W, violation, lower, upper, friction, per_contact, guess):
    """Admissible forces next to a guess, and the motion δ with them.

    Args:
        W: Compliance [m/N], shape (n, n).
        violation: Motion without multipliers [m], shape (n,).
        lower: Least multiplier of each actuator [N], shape (actuator_count,).
        upper: Greatest multiplier of each actuator [N], same shape.
        friction: Coefficient µ of each contact, shape (contact_count,).
        per_contact: Rows of a contact, 1 or 3.
        guess: Multipliers to begin with [N], shape (n,); left as they are.

    Returns:
        λ [N] and δ [m], shape (n,) each.
    """
    force, delta = guess.copy(), np.empty(len(violation))
    admissible(lower, upper, friction, per_contact, force)
    gauss_seidel.motion(W, violation, force, delta)
    return force, delta


@njit(**KERNEL)
def sweep(W, violation, lower, upper, friction, per_contact, guess, count):
    """Forces and motion δ after some Gauss–Seidel sweeps from admissible forces.

    Args:
        W: Compliance [m/N], shape (n, n).
        violation: Motion without multipliers [m], shape (n,).
        lower: Least multiplier of each actuator [N], shape (actuator_count,).
        upper: Greatest multiplier of each actuator [N], same shape.
        friction: Coefficient µ of each contact, shape (contact_count,).
        per_contact: Rows of a contact, 1 or 3.
        guess: Multipliers to begin with [N], shape (n,); left as they are.
        count: Number of sweeps.

    Returns:
        λ [N] and δ [m], shape (n,) each.
    """
    force, delta = begin(W, violation, lower, upper, friction, per_contact, guess)
    local = np.empty((len(friction), CONTACT_SIZE))
    if per_contact == 3:
        gauss_seidel.measure_contacts(W, len(lower), friction, local)
    for _ in range(count):
        gauss_seidel.sweep(W, lower, upper, friction, per_contact, local, force, delta)
    return force, delta
