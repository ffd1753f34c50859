"""The proximal semismooth Newton of `contact_proximal_newton` on W itself, where it has full rank.

With x = Y λ its step is Δx = Y Δ, where (1 + K W) Δ = -g and g = λ - λ(δ) is the residual: Y need
not be known, and its merit ‖Y g‖² is g · W g. Rows whose force does not change with their motion
fall out: what is open, or slides along its direction d. Left is one unknown for an actuator off its
bounds and for a normal that presses, two for tangents that stick, and one for those that slide,
across d:

    row i       u / ρ + (W Δ)_i     = -g_i / ρ - (W c)_i
    across d    u / κ + τ · (W Δ)_t = -τ · g_t / κ - τ · (W c)_t,   κ = ρ_t µ λ_n / ‖z‖

with Δ = B u + c: a sliding tangent's force follows its normal's, Δ_t = µ Δ_n d + u τ + c_t. It is
the system of `contact_newton`, with a compliance that its right-hand side knows.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from softrobot_twin.solvers.contact_cone import KERNEL
from softrobot_twin.solvers.contact_law import law, natural_residual
from softrobot_twin.solvers.contact_newton import PLAIN, TURNING, system_entry
from softrobot_twin.solvers.contact_problem import ContactProblem, ContactSolution
from softrobot_twin.solvers.contact_proximal_newton import (
    COLD,
    ENOUGH,
    GROW,
    LEAST,
    MOST_HALVINGS,
    MOST_STEPS,
    MOST_STEPS_A_ROUND,
    RECOVER,
    ROUND_OFF,
    SHRINK,
    SLOWEST,
    SMALL_RESIDUAL,
    SMALL_STEP,
    WARM,
)
from softrobot_twin.solvers.contact_sweeps import admissible, motion


class ContactProximalMatrix:
    """Solves contact problems by Newton steps on the rows that press.

    Attributes:
        tolerance: Residual at which a solution is good enough [m].
        force_share: The same in newtons, as a share of the largest force.
    """

    def __init__(self, tolerance: float, force_share: float):
        self.tolerance = tolerance
        self.force_share = force_share

    def solve(self, problem: ContactProblem, guess: np.ndarray) -> ContactSolution:
        """Multipliers from a finite guess; see `ContactProximalNewton.solve`."""
        parts = (problem.W, problem.violation, problem.lower, problem.upper, problem.friction)
        parts = tuple(np.ascontiguousarray(part, dtype=np.float64) for part in parts)
        guess = np.array(guess, dtype=np.float64)
        start = WARM if guess.any() else COLD
        try:
            found = iterate(
                *parts, problem.rows_per_contact, guess, start, self.tolerance, self.force_share
            )
        except np.linalg.LinAlgError:
            return ContactSolution(guess, np.inf, np.inf, 0, False)
        return ContactSolution(*found)


@njit(**KERNEL)
def pick_rows(slope, centre_force, delta, centre, stiffness, g, friction, actuators, per_contact,
              rows, kinds, frame):  # fmt: skip
    """Unknowns of the step, and the part c of it that is known.

    Args:
        slope: From `law`, at the point the step is made from, shape (n, 3).
        centre_force: λ(δ) there [N], shape (n,).
        delta: δ there [m].
        centre: λ̄ [N].
        stiffness: ρ [N/m].
        g: λ - λ(δ) [N].
        friction: µ of each contact.
        actuators: Number of actuators.
        per_contact: Rows of a contact.
        rows: Row of each unknown, written.
        kinds: Its kind, written.
        frame: By row: as of `contact_newton.active_rows`; of a turning row its τ and 1/κ; then c.
            Written, shape (n, 4).

    Returns:
        Number of unknowns.
    """
    count, n = 0, len(g)
    for i in range(n):
        frame[i, 0] = frame[i, 1] = frame[i, 2] = 0.0
        frame[i, 3] = -g[i]
    for i in range(actuators):
        if slope[i, 0] != 0.0:
            rows[count], kinds[count], frame[i, 3] = i, PLAIN, 0.0
            count += 1
    for k in range(len(friction)):
        i = actuators + per_contact * k
        if slope[i, 0] == 0.0:
            continue
        rows[count], kinds[count], frame[i, 3] = i, PLAIN, 0.0
        count += 1
        if per_contact == 1 or friction[k] == 0.0:
            continue
        rho, limit = stiffness[i + 1], friction[k] * centre_force[i]
        z_1 = centre[i + 1] - rho * delta[i + 1]
        z_2 = centre[i + 2] - rho * delta[i + 2]
        length = np.hypot(z_1, z_2)
        if length <= limit:
            for j in (i + 1, i + 2):
                rows[count], kinds[count], frame[j, 3] = j, PLAIN, 0.0
                count += 1
            continue
        d_1, d_2 = z_1 / length, z_2 / length
        frame[i, 0], frame[i, 1], frame[i, 2] = d_1, d_2, friction[k]
        frame[i + 1, 0], frame[i + 1, 1] = -d_2, d_1
        frame[i + 1, 2] = length / (rho * limit)
        along = friction[k] * g[i] - d_1 * g[i + 1] - d_2 * g[i + 2]
        frame[i + 1, 3], frame[i + 2, 3] = along * d_1, along * d_2
        rows[count], kinds[count] = i + 1, TURNING
        count += 1
    return count


@njit(**KERNEL)
def fill_system(W, g, known, stiffness, rows, kinds, frame, count):
    """Matrix and right-hand side of the unknowns; `known` is W c."""
    matrix, right = np.empty((count, count)), np.empty(count)
    for a in range(count):
        i = rows[a]
        if kinds[a] == PLAIN:
            for b in range(count):
                matrix[a, b] = system_entry(W[i], rows[b], kinds[b], frame)
            matrix[a, a] += 1.0 / stiffness[i]
            right[a] = -g[i] / stiffness[i] - known[i]
            continue
        t_1, t_2, soft = frame[i, 0], frame[i, 1], frame[i, 2]
        for b in range(count):
            first = system_entry(W[i], rows[b], kinds[b], frame)
            second = system_entry(W[i + 1], rows[b], kinds[b], frame)
            matrix[a, b] = t_1 * first + t_2 * second
        matrix[a, a] += soft
        across = t_1 * g[i] + t_2 * g[i + 1]
        right[a] = -soft * across - t_1 * known[i] - t_2 * known[i + 1]
    return matrix, right


@njit(**KERNEL)
def spread(rows, kinds, frame, count, u, step):
    """Δ = B u + c."""
    for i in range(len(step)):
        step[i] = frame[i, 3]
    for a in range(count):
        i = rows[a]
        if kinds[a] == TURNING:
            step[i] += frame[i, 0] * u[a]
            step[i + 1] += frame[i, 1] * u[a]
            continue
        step[i] += u[a]
        if frame[i, 2] != 0.0:
            step[i + 1] += frame[i, 2] * frame[i, 0] * u[a]
            step[i + 2] += frame[i, 2] * frame[i, 1] * u[a]


@njit(**KERNEL)
def iterate(
    W, violation, lower, upper, friction, per_contact, guess, compliance, tolerance, force_share
):
    """Rounds of Newton's method around one centre after the other; see the other `iterate`."""
    n, actuators = len(W), len(lower)
    own, stiffness, delta = np.empty(n), np.empty(n), np.empty(n)
    centre, force = guess.copy(), np.empty(n)
    bounds = (lower, upper, friction, per_contact)
    for i in range(n):
        own[i] = W[i, i]
    for i in range(actuators, n, per_contact):
        if per_contact == 3:
            own[i + 1] = own[i + 2] = 0.5 * (own[i + 1] + own[i + 2])
        if own[i] == 0.0:
            centre[i : i + per_contact] = 0.0
    admissible(lower, upper, friction, per_contact, centre)
    best, least, least_newtons = centre.copy(), np.inf, np.inf
    shrink, steps, rounds = SHRINK, 0, 0
    while True:
        motion(W, violation, centre, delta)
        gap, newtons = natural_residual(own, delta, *bounds, centre)
        if gap < least:
            least, least_newtons = gap, newtons
            best[:] = centre
        asked = force_share * np.abs(centre).max()
        if gap <= tolerance and newtons <= asked:
            return centre, gap, newtons, steps, True
        if steps >= MOST_STEPS or rounds >= MOST_STEPS:
            break
        rounds += 1
        for i in range(n):
            stiffness[i] = 1.0 / (compliance * own[i]) if own[i] > 0.0 else 0.0
        made, solved = _newton_round(W, violation, *bounds, centre, stiffness, delta, force)
        steps += made
        if solved:
            centre[:] = force
            compliance, shrink = max(compliance * shrink, LEAST), max(RECOVER * shrink, SHRINK)
        else:
            compliance, shrink = min(GROW * compliance, COLD), min(np.sqrt(shrink), SLOWEST)
    solved = least <= tolerance and least_newtons <= force_share * np.abs(best).max()
    return best, least, least_newtons, steps, solved


@njit(**KERNEL)
def _newton_round(
    W, violation, lower, upper, friction, per_contact, centre, stiffness, delta, force
):
    """Newton's method around one centre; force is left where it ends.

    Returns:
        Steps made, and whether it ended at a root.
    """
    n, actuators = len(W), len(lower)
    bounds = (lower, upper, friction, per_contact)
    slope, frame, none = np.empty((n, 3)), np.empty((n, 4)), np.zeros(n)
    rows, kinds = np.empty(n, dtype=np.int64), np.empty(n, dtype=np.int64)
    trial, trial_delta, by_law, step, known, moved = np.empty((6, n))
    multipliers, g = centre.copy(), np.empty(n)
    law(delta, centre, stiffness, *bounds, force, slope)
    motion(W, violation, force, by_law)
    square = _merit(multipliers, force, delta, by_law)
    for made in range(MOST_STEPS_A_ROUND):
        g[:] = multipliers - force
        count = pick_rows(
            slope, force, delta, centre, stiffness, g, friction, actuators, per_contact,
            rows, kinds, frame,
        )  # fmt: skip
        motion(W, none, frame[:, 3], known)
        matrix, right = fill_system(W, g, known, stiffness, rows, kinds, frame, count)
        u = np.linalg.solve(matrix, right) if count else right
        spread(rows, kinds, frame, count, u, step)
        motion(W, none, step, moved)
        length, part, fell = _product(step, moved), 1.0, False
        for halving in range(MOST_HALVINGS):
            for i in range(n):
                trial[i] = multipliers[i] + part * step[i]
                trial_delta[i] = delta[i] + part * moved[i]
            law(trial_delta, centre, stiffness, *bounds, force, slope)
            motion(W, violation, force, by_law)
            merit = _merit(trial, force, trial_delta, by_law)
            fell = merit < square * (1.0 - ENOUGH * part)
            size = _merit(trial, none, trial_delta, violation)
            if not fell and halving == 0 and length <= ROUND_OFF * ROUND_OFF * size:
                return made + 1, True
            if fell:
                break
            part *= 0.5
        if not fell:
            return made + 1, False
        multipliers[:], delta[:], square = trial, trial_delta, merit
        if part * part * length <= SMALL_STEP**2 * size or square <= SMALL_RESIDUAL**2 * size:
            return made + 1, True
    return MOST_STEPS_A_ROUND, False


@njit(**KERNEL)
def _product(a, b):
    total = 0.0
    for i in range(len(a)):
        total += a[i] * b[i]
    return total


@njit(**KERNEL)
def _merit(multipliers, force, delta, by_force):
    """(λ - λ') · W (λ - λ'), the square of Y times their difference, from the motions of both."""
    total = 0.0
    for i in range(len(force)):
        total += (multipliers[i] - force[i]) * (delta[i] - by_force[i])
    return max(total, 0.0)
