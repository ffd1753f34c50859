"""Block Gauss–Seidel for actuators and contacts with friction (Coevoet 2017, section 4.3).

Sweeps alone need hundreds of rounds where an object of some grams is held by stiff fingers. So
between sweeps a Newton step on the rows that are active is tried, a sweep follows it, and the
result is kept if its residual is smaller; otherwise its proximal share grows and sweeps go on.
From the multipliers of the step before, one or two such rounds are enough while no contact changes
its state. The step costs as the cube of the active rows, a sweep as active rows times all: with
many, sweeps come first, and a step that failed is tried again when they have taken as long.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from softrobot_twin.solvers import contact_newton as newton
from softrobot_twin.solvers import contact_sweeps as sweeps
from softrobot_twin.solvers.contact_cone import CONTACT_SIZE, KERNEL
from softrobot_twin.solvers.contact_problem import ContactProblem, ContactSolution

_REDUCED = 0.9  # a Newton step is kept if it leaves this share of the residual, or less
_LEAST_PROXIMAL, _MOST_PROXIMAL, _PROXIMAL_FACTOR = 1.0e-9, 1.0e-2, 30.0
# Newton steps from a solution to exact forces: so many, until this share of the gap is left.
_END_STEPS, _REDUCED_ENOUGH = 2, 1.0e-4
_LEAST_PAUSE, _MOST_PAUSE = 2.0, 4.0  # sweeps after a Newton step that failed
# Sweeps that come before a Newton step on m of n rows, as a share of m² / n: while such steps
# succeed, and after one that failed, when sweeps shall take as long as the next.
_TRUSTED_COST, _FAILED_COST = 1.0 / 50.0, 1.0 / 9.0


class _Room(NamedTuple):
    """What a solve works in, for n rows.

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
    """Solves contact problems, each best from the multipliers of the one before.

    Buffers grow with the largest problem met and are used again. The same input gives the same
    bits. Not to be used by two threads at once.

    Attributes:
        tolerance: Residual at which a solution is good enough [m].
        most_sweeps: Sweeps after which the best so far is given back, as not converged.
        force_share: What may be left in newtons, as a share of the largest force: where more is
            left, Newton steps go on from the solution as long as they help.
    """

    def __init__(
        self, tolerance: float = 1.0e-9, most_sweeps: int = 300, force_share: float = np.inf
    ):
        self.tolerance = tolerance
        self.most_sweeps = most_sweeps
        self.force_share = force_share
        self._capacity = 0
        self._room = None

    def solve(self, problem: ContactProblem, guess: np.ndarray) -> ContactSolution:
        """Multipliers from a guess.

        Args:
            problem: The problem.
            guess: Multipliers to begin with [N], shape (n,); zeros if nothing is known.

        Returns:
            The solution. `converged` is False if the residual is above the tolerance. If the
            problem or the guess is not finite it holds the finite part of the guess, with
            infinite residuals.

        Raises:
            ValueError: Sizes do not fit together, see `ContactProblem.check`.
        """
        problem.check()
        guess = np.asarray(guess, dtype=np.float64)
        if guess.shape != problem.violation.shape:
            raise ValueError(f"a guess of {guess.size} multipliers for {len(problem.W)} rows")
        rows = (
            np.ascontiguousarray(problem.W, dtype=np.float64),
            np.ascontiguousarray(problem.violation, dtype=np.float64),
            np.ascontiguousarray(problem.lower, dtype=np.float64),
            np.ascontiguousarray(problem.upper, dtype=np.float64),
            np.ascontiguousarray(problem.friction, dtype=np.float64),
            problem.rows_per_contact,
        )
        if _usable(*rows[:5], guess):
            force = guess.copy()
            room = self._prepare(len(guess), len(problem.friction))
            gap, newtons, count = _iterate(*rows, force, room, self.tolerance, self.most_sweeps)
            if gap <= self.tolerance and self._leaves_too_much(newtons, force):
                gap, newtons, count = _end(*rows, force, room, gap, newtons, count)
            if np.isfinite(gap) and np.isfinite(force).all():
                return ContactSolution(force, gap, newtons, count, bool(gap <= self.tolerance))
        force = np.where(np.isfinite(guess), guess, 0.0)
        return ContactSolution(force, np.inf, np.inf, 0, False)

    def _leaves_too_much(self, newtons: float, force: np.ndarray) -> bool:
        """Whether a solution in metres is to be made one in newtons."""
        if self.force_share == np.inf:
            return False
        return bool(newtons > self.force_share * np.abs(force).max(initial=0.0))

    def _prepare(self, n: int, contact_count: int) -> _Room:
        """Room for n rows, a part of what is there if it is enough."""
        if self._room is None or n > self._capacity:
            self._capacity = max(n, 2 * self._capacity)
            self._vectors = np.zeros((5, self._capacity))
            self._indices = np.zeros((2, self._capacity), dtype=np.int64)
            self._frame = np.zeros((self._capacity, 4))
            self._matrix = np.zeros(self._capacity**2)
            self._local = np.zeros((self._capacity, CONTACT_SIZE))
            self._room = None
        if self._room is None or (len(self._room.delta), len(self._room.local)) != (
            n, contact_count,
        ):  # fmt: skip
            delta, trial, trial_delta, best, right = self._vectors[:, :n]
            self._room = _Room(
                self._local[:contact_count], delta, trial, trial_delta, best,
                self._indices[0, :n], self._indices[1, :n], self._frame[:n],
                self._matrix[: n * n].reshape(n, n), right,
            )  # fmt: skip
        return self._room


@njit(**KERNEL)
def _usable(W, violation, lower, upper, friction, guess):
    """True if all is finite; bounds may be infinite."""
    for i in range(len(lower)):
        if np.isnan(lower[i]) or np.isnan(upper[i]) or lower[i] == np.inf or upper[i] == -np.inf:
            return False
    return (
        np.isfinite(W).all() and np.isfinite(violation).all() and np.isfinite(friction).all()
        and np.isfinite(guess).all()
    )  # fmt: skip


@njit(**KERNEL)
def _iterate(
    W, violation, lower, upper, friction, rows_per_contact, force, room, tolerance, most_sweeps
):
    """Sweeps and Newton steps until the residual is small; force in place.

    Returns:
        Residual [m] and [N], and sweeps made.
    """
    if rows_per_contact == 3:
        sweeps.measure_contacts(W, len(lower), friction, room.local)
    sweeps.admissible(lower, upper, friction, rows_per_contact, force)
    sweeps.motion(W, violation, force, room.delta)
    sweeps.share(W, len(lower), rows_per_contact, violation, force, room.delta)
    bounds = (lower, upper, friction, rows_per_contact)
    gap, newtons = sweeps.residual(W, *bounds, force, room.delta)
    least, proximal, pause, since, count = np.inf, _LEAST_PROXIMAL, 0.0, 0, 0
    while count < most_sweeps:
        if gap < least:
            least = gap
            room.best[:] = force
        if gap <= tolerance:
            # δ was carried along: the last word has δ computed anew.
            sweeps.motion(W, violation, force, room.delta)
            gap, newtons = sweeps.residual(W, *bounds, force, room.delta)
            if gap <= tolerance:
                return gap, newtons, count
            least = gap
        if since >= pause:
            active = newton.active_rows(
                W, *bounds, force, room.delta, room.rows, room.kinds, room.frame
            )
            cost = _FAILED_COST if pause > 0.0 else _TRUSTED_COST
            cost *= active * active / len(force)
            if since >= cost - _MOST_PAUSE:
                count += 1
                reached = _newton_round(
                    W, violation, *bounds, force, room, active, proximal, _REDUCED * gap
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
        sweeps.sweep(W, *bounds, room.local, force, room.delta)
        gap, newtons = sweeps.residual(W, *bounds, force, room.delta)
        since += 1
        count += 1
    if least < gap:
        force[:] = room.best
    sweeps.motion(W, violation, force, room.delta)
    gap, newtons = sweeps.residual(W, *bounds, force, room.delta)
    return gap, newtons, count


@njit(**KERNEL)
def _end(
    W, violation, lower, upper, friction, rows_per_contact, force, room, gap, newtons, count
):
    """A few Newton steps from a solution, as long as less is left; force in place.

    Returns:
        Residual [m] and [N], and sweeps made.
    """
    bounds = (lower, upper, friction, rows_per_contact)
    for _ in range(_END_STEPS):
        active = newton.active_rows(
            W, *bounds, force, room.delta, room.rows, room.kinds, room.frame
        )
        before = gap
        reached = _newton_round(
            W, violation, *bounds, force, room, active, _LEAST_PROXIMAL, before
        )
        count += 1
        if not reached[0] < before:
            break
        gap, newtons = reached
        if gap <= _REDUCED_ENOUGH * before:
            break
    # δ was carried along: the last word has δ computed anew.
    sweeps.motion(W, violation, force, room.delta)
    gap, newtons = sweeps.residual(W, *bounds, force, room.delta)
    return gap, newtons, count


@njit(**KERNEL)
def _newton_round(
    W, violation, lower, upper, friction, rows_per_contact, force, room, active, proximal, wanted
):
    """A Newton step and a sweep, kept if the residual is less than wanted.

    Returns:
        Its residual [m] and [N], infinite if the step could not be made.
    """
    trial, delta = room.trial, room.trial_delta
    for i in range(len(force)):
        trial[i] = force[i] + room.frame[i, 3]
    sweeps.motion(W, violation, trial, delta)
    newton.fill_system(
        W, trial, delta, room.rows, room.kinds, room.frame, active, proximal,
        room.matrix, room.right,
    )  # fmt: skip
    if not newton.solve_system(room.matrix, room.right, active):
        return np.inf, np.inf
    newton.apply_step(room.rows, room.kinds, room.frame, active, room.right, trial)
    sweeps.admissible(lower, upper, friction, rows_per_contact, trial)
    sweeps.motion(W, violation, trial, delta)
    sweeps.sweep(W, lower, upper, friction, rows_per_contact, room.local, trial, delta)
    gap, newtons = sweeps.residual(W, lower, upper, friction, rows_per_contact, trial, delta)
    if gap < wanted:
        force[:] = trial
        room.delta[:] = delta
    return gap, newtons
