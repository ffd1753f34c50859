"""Block Gauss–Seidel for actuators and contacts with friction (Coevoet 2017, section 5.2.1).

Problems of few rows need it: from the forces of the last step it takes 10 to 30 µs, Newton's method
alone 1.6 to 4 times as long.

The motion δ of all rows is carried along: a block whose force changes adds the change times its
rows of W. A block that does not change, above all an open contact, costs nothing; the inner loop
runs along memory; and the residual after a sweep needs no product with W.

Sweeps alone need hundreds of rounds where stiff fingers hold an object of some grams. Therefore a
Newton step on the active rows is tried between sweeps (`contact_newton_step`), followed by a sweep,
and the result is kept if its residual is smaller; otherwise its proximal share grows and the sweeps
continue. From the multipliers of the last step, one or two such rounds are enough while no contact
changes its state.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softrobot_twin.kernels.compilation import INNER, KERNEL, ONCE, njit
from softrobot_twin.solvers.contact_law import (
    CONTACT_SIZE,
    admissible,
    copy_into,
    measure_contact,
    natural_residual,
    own_compliance,
    solve_contact,
)
from softrobot_twin.solvers.contact_newton_step import (
    active_rows,
    apply_step,
    fill_system,
    solve_system,
)
from softrobot_twin.solvers.contact_problem import ContactProblem, ContactSolution

_REDUCED = 0.9  # a Newton step is kept if it leaves this share of the residual, or less
_SHARING_ROUNDS = 10
_LEAST_PROXIMAL, _MOST_PROXIMAL, _PROXIMAL_FACTOR = 1.0e-9, 1.0e-2, 30.0
# Newton steps from a solution to exact forces: so many, until this share of the gap is left.
_END_STEPS, _REDUCED_ENOUGH = 2, 1.0e-4
_LEAST_PAUSE, _MOST_PAUSE = 2.0, 4.0  # sweeps after a Newton step that failed


class _Workspace(NamedTuple):
    """Buffers of a solve, for n rows.

    Attributes:
        local: `measure_contacts` of each contact, shape (contact_count, CONTACT_SIZE).
        delta: Motion of all rows [m], shape (n,).
        trial: Multipliers of a Newton step [N], shape (n,).
        trial_delta: Its motion [m], shape (n,).
        best: Multipliers with the least residual so far [N], shape (n,).
        rows: Active rows, shape (n,).
        kinds: Their kinds, shape (n,).
        frame: See `active_rows`, shape (n, 4).
        matrix: System of the active rows, shape (n, n).
        right: Its right-hand side, shape (n,).
    """

    local: np.ndarray
    delta: np.ndarray
    trial: np.ndarray
    trial_delta: np.ndarray
    best: np.ndarray
    rows: np.ndarray
    kinds: np.ndarray
    frame: np.ndarray
    matrix: np.ndarray
    right: np.ndarray


class ContactGaussSeidel:
    """Solves contact problems, best from the multipliers of the last step.

    The same input gives the same bits.

    Attributes:
        tolerance: Residual at which a solution is good enough [m].
        most_sweeps: Sweeps after which the best so far is returned, as not converged.
        force_share: Allowed residual in newtons, as a share of the largest force: where it is
            exceeded, Newton steps continue from the solution as long as they help.
    """

    def __init__(self, tolerance: float = 1.0e-9, most_sweeps: int = 300, force_share: float = np.inf):
        self.tolerance = tolerance
        self.most_sweeps = most_sweeps
        self.force_share = force_share

    def solve(self, problem: ContactProblem, guess: np.ndarray) -> ContactSolution:
        """Multipliers from a guess.

        Args:
            problem: The problem.
            guess: Multipliers to begin with [N], shape (n,); zeros if nothing is known.

        Returns:
            The solution. `converged` is False if the residual is above the tolerance. If the
            problem or the guess is not finite it holds the finite part of the guess, with
            infinite residuals.
        """
        guess = np.asarray(guess, dtype=np.float64)
        parts = tuple(np.ascontiguousarray(part, dtype=np.float64) for part in problem[:5])
        force = guess.copy()
        gap, newtons, count = _solve(
            *parts, problem.rows_per_contact, force, self.tolerance, self.most_sweeps,
            self.force_share,
        )  # fmt: skip
        if gap < np.inf:
            return ContactSolution(force, gap, newtons, count, gap <= self.tolerance)
        force = np.where(np.isfinite(guess), guess, 0.0)
        return ContactSolution(force, np.inf, np.inf, 0, False)


@njit(**INNER)
def measure_contacts(W, actuator_count, friction, local):
    """`measure_contact` of all contacts.

    Args:
        W: Compliance [m/N], shape (n, n).
        actuator_count: Rows before those of contacts.
        friction: µ of each contact, shape (contact_count,).
        local: Written, shape (contact_count, CONTACT_SIZE).
    """
    for k in range(len(friction)):
        measure_contact(W, actuator_count + 3 * k, local[k])


@njit(**KERNEL)
def motion(W, violation, force, delta):
    """δ ← W λ + violation.

    Args:
        W: Compliance [m/N], shape (n, n).
        violation: Motion without forces [m], shape (n,).
        force: λ [N], shape (n,).
        delta: δ [m], written, shape (n,).
    """
    for i in range(len(delta)):
        delta[i] = violation[i]
    for i in range(len(force)):
        if force[i] != 0.0:
            _add_row(W[i], force[i], delta)


@njit(**INNER)
def _add_row(row, factor, delta):
    for j in range(len(delta)):
        delta[j] += row[j] * factor


@njit(**ONCE)
def _add_three_rows(W, first, a, b, c, delta):
    row_1, row_2, row_3 = W[first], W[first + 1], W[first + 2]
    for j in range(len(delta)):
        delta[j] += row_1[j] * a + row_2[j] * b + row_3[j] * c


@njit(**ONCE)
def share_load(W, actuator_count, rows_per_contact, violation, force, delta):
    """First forces of contacts that penetrate, where no contact presses yet; in place.

    A sweep would give the whole load to the first of many contacts that carry it together. Here
    all of them react at once, in a few rounds of a Jacobi iteration that converges for any W.

    Args:
        W: Compliance [m/N], shape (n, n).
        actuator_count: Rows of actuators, before those of contacts.
        rows_per_contact: Rows of a contact, 1 or 3.
        violation: Motion without multipliers [m], shape (n,).
        force: λ [N], shape (n,); changed.
        delta: δ [m], shape (n,); changed.
    """
    for n in range(actuator_count, len(force), rows_per_contact):
        if force[n] != 0.0:
            return
    for _ in range(_SHARING_ROUNDS):
        for n in range(actuator_count, len(force), rows_per_contact):
            if force[n] > 0.0 or delta[n] < 0.0:
                together = 0.0
                for j in range(actuator_count, len(force), rows_per_contact):
                    if force[j] > 0.0 or delta[j] < 0.0:
                        together += abs(W[n, j])
                if together > 0.0:
                    force[n] = max(force[n] - delta[n] / together, 0.0)
        motion(W, violation, force, delta)


@njit(**INNER)
def sweep(W, lower, upper, friction, rows_per_contact, local, force, delta):
    """Solve block after block, each with all other forces held.

    Args:
        W: Compliance [m/N], shape (n, n).
        lower: Least multiplier of each actuator [N], shape (actuator_count,).
        upper: Greatest multiplier of each actuator [N], same shape.
        friction: Coefficient µ of each contact, shape (contact_count,).
        rows_per_contact: Rows of a contact, 1 or 3.
        local: `measure_contact` of each contact, shape (contact_count, CONTACT_SIZE).
        force: λ [N], shape (n,); changed.
        delta: δ [m], shape (n,); changed.
    """
    actuators = len(lower)
    for i in range(actuators):
        _solve_single(W, i, lower[i], upper[i], force, delta)
    for k in range(len(friction)):
        if rows_per_contact == 1:
            _solve_single(W, actuators + k, 0.0, np.inf, force, delta)
        else:
            _solve_triple(W, actuators + 3 * k, friction[k], local[k], force, delta)


@njit(**INNER)
def _solve_single(W, i, lower, upper, force, delta):
    """A row whose multiplier has bounds."""
    if not W[i, i] > 0.0:
        return
    value = min(max(force[i] - delta[i] / W[i, i], lower), upper)
    if value != force[i]:
        _add_row(W[i], value - force[i], delta)
        force[i] = value


@njit(**ONCE)
def _solve_triple(W, n, friction, local, force, delta):
    """A contact with friction."""
    f_n, f_1, f_2 = force[n], force[n + 1], force[n + 2]
    if not f_n > 0.0 and delta[n] >= 0.0:
        return
    q_n = delta[n] - (W[n, n] * f_n + W[n, n + 1] * f_1 + W[n, n + 2] * f_2)
    q_1 = delta[n + 1] - (W[n + 1, n] * f_n + W[n + 1, n + 1] * f_1 + W[n + 1, n + 2] * f_2)
    q_2 = delta[n + 2] - (W[n + 2, n] * f_n + W[n + 2, n + 1] * f_1 + W[n + 2, n + 2] * f_2)
    new_n, new_1, new_2 = solve_contact(local, friction, q_n, q_1, q_2)
    _add_three_rows(W, n, new_n - f_n, new_1 - f_1, new_2 - f_2, delta)
    force[n], force[n + 1], force[n + 2] = new_n, new_1, new_2


@njit(**KERNEL)
def residual(W, lower, upper, friction, rows_per_contact, force, delta):
    """Largest residual of the natural map, in metres and in newtons; see `ContactSolution`.

    Args:
        W: Compliance [m/N], shape (n, n).
        lower: Least multiplier of each actuator [N], shape (actuator_count,).
        upper: Greatest multiplier of each actuator [N], same shape.
        friction: Coefficient µ of each contact, shape (contact_count,).
        rows_per_contact: Rows of a contact, 1 or 3.
        force: λ [N], shape (n,).
        delta: δ [m], shape (n,).
    """
    own = own_compliance(W, len(lower), rows_per_contact)
    return natural_residual(own, delta, lower, upper, friction, rows_per_contact, force)


@njit(**KERNEL)
def _solve(
    W, violation, lower, upper, friction, rows_per_contact, force, tolerance, most_sweeps,
    force_share,
):  # fmt: skip
    """Sweeps, and Newton steps where forces are not exact; force in place.

    Returns:
        Residual [m] and [N], and sweeps made; a residual that is infinite if anything is not
        finite or makes no sense.
    """
    if not _usable(W, violation, lower, upper, friction, force):
        return np.inf, np.inf, 0
    rows = (W, violation, lower, upper, friction, rows_per_contact)
    n = len(force)
    # Not as rows of one array: numba takes these for arrays with gaps.
    workspace = _Workspace(
        np.empty((len(friction), CONTACT_SIZE)), np.empty(n), np.empty(n), np.empty(n), np.empty(n),
        np.empty(n, dtype=np.int64), np.empty(n, dtype=np.int64), np.empty((n, 4)),
        np.empty((n, n)), np.empty(n),
    )  # fmt: skip
    gap, newtons, count = _iterate(*rows, force, workspace, tolerance, most_sweeps)
    greatest = 0.0
    for i in range(len(force)):
        greatest = max(greatest, abs(force[i]))
    if gap <= tolerance and newtons > force_share * greatest:
        gap, newtons, count = _end(*rows, force, workspace, gap, newtons, count)
    if not (np.isfinite(gap) and np.isfinite(force).all()):
        return np.inf, np.inf, 0
    return gap, newtons, count


@njit(**INNER)
def _usable(W, violation, lower, upper, friction, guess):
    """True if all is finite, but for bounds, and no bound is reversed and no friction negative."""
    for i in range(len(lower)):
        if not lower[i] <= upper[i] or lower[i] == np.inf or upper[i] == -np.inf:
            return False
    for k in range(len(friction)):
        if friction[k] < 0.0:
            return False
    return (
        np.isfinite(W).all() and np.isfinite(violation).all() and np.isfinite(friction).all()
        and np.isfinite(guess).all()
    )  # fmt: skip


@njit(**INNER)
def _iterate(
    W, violation, lower, upper, friction, rows_per_contact, force, workspace, tolerance, most_sweeps
):
    """Sweeps and Newton steps until the residual is small; force in place.

    Returns:
        Residual [m] and [N], and sweeps made.
    """
    if rows_per_contact == 3:
        measure_contacts(W, len(lower), friction, workspace.local)
    admissible(lower, upper, friction, rows_per_contact, force)
    motion(W, violation, force, workspace.delta)
    share_load(W, len(lower), rows_per_contact, violation, force, workspace.delta)
    bounds = (lower, upper, friction, rows_per_contact)
    gap, newtons = residual(W, *bounds, force, workspace.delta)
    least, proximal, pause, since, count = np.inf, _LEAST_PROXIMAL, 0.0, 0, 0
    while count < most_sweeps:
        if gap < least:
            least = gap
            copy_into(workspace.best, force)
        if gap <= tolerance:
            # δ was updated incrementally: judge by δ computed anew.
            motion(W, violation, force, workspace.delta)
            gap, newtons = residual(W, *bounds, force, workspace.delta)
            if gap <= tolerance:
                return gap, newtons, count
            least = gap
        if since >= pause:
            active = active_rows(
                W, *bounds, force, workspace.delta, workspace.rows, workspace.kinds, workspace.frame
            )
            count += 1
            reached = _newton_round(
                W, violation, *bounds, force, workspace, active, proximal, _REDUCED * gap
            )
            since = 0
            if reached[0] < _REDUCED * gap:
                gap, newtons = reached
                proximal = max(proximal / _PROXIMAL_FACTOR, _LEAST_PROXIMAL)
                pause = 0.0
            else:
                proximal = min(proximal * _PROXIMAL_FACTOR, _MOST_PROXIMAL)
                pause = min(max(2.0 * pause, _LEAST_PAUSE), _MOST_PAUSE)
            continue
        sweep(W, *bounds, workspace.local, force, workspace.delta)
        gap, newtons = residual(W, *bounds, force, workspace.delta)
        since += 1
        count += 1
    if least < gap:
        copy_into(force, workspace.best)
    motion(W, violation, force, workspace.delta)
    gap, newtons = residual(W, *bounds, force, workspace.delta)
    return gap, newtons, count


@njit(**INNER)
def _end(W, violation, lower, upper, friction, rows_per_contact, force, workspace, gap, newtons, count):
    """A few Newton steps from a solution, as long as the residual falls; force in place.

    Returns:
        Residual [m] and [N], and sweeps made.
    """
    bounds = (lower, upper, friction, rows_per_contact)
    for _ in range(_END_STEPS):
        active = active_rows(
            W, *bounds, force, workspace.delta, workspace.rows, workspace.kinds, workspace.frame
        )
        before = gap
        reached = _newton_round(
            W, violation, *bounds, force, workspace, active, _LEAST_PROXIMAL, before
        )
        count += 1
        if not reached[0] < before:
            break
        gap, newtons = reached
        if gap <= _REDUCED_ENOUGH * before:
            break
    # δ was updated incrementally: judge by δ computed anew.
    motion(W, violation, force, workspace.delta)
    gap, newtons = residual(W, *bounds, force, workspace.delta)
    return gap, newtons, count


@njit(**INNER)
def _newton_round(
    W, violation, lower, upper, friction, rows_per_contact, force, workspace, active, proximal,
    wanted,
):  # fmt: skip
    """A Newton step and a sweep, kept if the residual is less than wanted.

    Returns:
        Its residual [m] and [N], infinite if the step could not be made.
    """
    trial, delta = workspace.trial, workspace.trial_delta
    for i in range(len(force)):
        trial[i] = force[i] + workspace.frame[i, 3]
    motion(W, violation, trial, delta)
    fill_system(
        W, trial, delta, workspace.rows, workspace.kinds, workspace.frame, active, proximal,
        workspace.matrix, workspace.right,
    )  # fmt: skip
    if not solve_system(workspace.matrix, workspace.right, active):
        return np.inf, np.inf
    apply_step(workspace.rows, workspace.kinds, workspace.frame, active, workspace.right, trial)
    admissible(lower, upper, friction, rows_per_contact, trial)
    motion(W, violation, trial, delta)
    sweep(W, lower, upper, friction, rows_per_contact, workspace.local, trial, delta)
    gap, newtons = residual(W, lower, upper, friction, rows_per_contact, trial, delta)
    if gap < wanted:
        copy_into(force, trial)
        copy_into(workspace.delta, delta)
    return gap, newtons
