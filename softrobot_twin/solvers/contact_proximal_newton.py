"""Actuators and contacts by a proximal semismooth Newton in the few unknowns that W has.

Where W = YᵀY is of low rank, x = Y λ says all that forces do: six unknowns a rigid body, however
many points of it touch. With the law λ(δ) of `contact_law` around a centre λ̄,

    g(x) = x - Y λ(δ(x)) = 0,   δ(x) = Yᵀ x + violation,   ∂g/∂x = 1 + Y K Yᵀ,   K = -∂λ/∂δ

is solved by Newton's method (the Jacobian is not symmetric where contacts slide), halved while the
residual does not fall. Then λ̄ ← λ and the law is made stiffer: a proximal point iteration, in which
the compliance acts on the change of λ alone, so that its end is Signorini's and Coulomb's law
without any compliance. Redundant contacts, for which W says not how they share a load, share it as
λ̄ does.

The compliance ε W_ii begins at a share ε of one from nothing, of a hundredth from a guess, and
shrinks tenfold a round. Where Newton fails it goes back to the last centre with eight times the
compliance, and shrinks it more slowly from there on.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from softrobot_twin.solvers.contact_cone import KERNEL
from softrobot_twin.solvers.contact_law import law, natural_residual
from softrobot_twin.solvers.contact_newton import solve_system
from softrobot_twin.solvers.contact_problem import ContactProblem, ContactSolution
from softrobot_twin.solvers.contact_sweeps import admissible

# Compliance ε: where nothing is known, from a guess, at least; how it shrinks, also after a failure
# at the slowest, and how it grows where Newton fails.
COLD, WARM, LEAST = 1.0, 1.0e-2, 1.0e-8
SHRINK, SLOWEST, GROW, RECOVER = 0.1, 0.7, 8.0, 0.8
MOST_STEPS, MOST_STEPS_A_ROUND, MOST_HALVINGS = 300, 20, 7
# A step is kept if the residual's square falls by this share of it. A round ends where the step or
# the residual is this small beside x, and a step this small that does not help is round-off.
ENOUGH, SMALL_STEP, SMALL_RESIDUAL, ROUND_OFF = 0.1, 1.0e-8, 1.0e-11, 1.0e-10
# Share of what is asked that is aimed at, in so many rounds more at most: what moves a heavy body
# by a nanometre is a large force.
AIM, MOST_ROUNDS_MORE = 1.0e-3, 4


class ContactProximalNewton:
    """Solves contact problems that give W by a factor.

    The same input gives the same bits.

    Attributes:
        tolerance: Residual at which a solution is good enough [m].
        force_share: The same in newtons, as a share of the largest force.
    """

    def __init__(self, tolerance: float, force_share: float):
        self.tolerance = tolerance
        self.force_share = force_share

    def solve(self, problem: ContactProblem, guess: np.ndarray) -> ContactSolution:
        """Multipliers from a guess, and from nothing where that fails.

        Args:
            problem: The problem, with its factor.
            guess: Multipliers to begin with [N], shape (n,); zeros if nothing is known.

        Returns:
            The solution; `sweeps` are Newton steps. `converged` is False if a residual is above
            what is asked: then it is the best that was found, or the finite part of the guess
            where the problem is not finite.

        Raises:
            ValueError: Sizes do not fit together, see `ContactProblem.check`.
        """
        problem.check()
        guess = np.array(guess, dtype=np.float64)
        parts = (problem.Yt, problem.violation, problem.lower, problem.upper, problem.friction)
        parts = tuple(np.ascontiguousarray(part, dtype=np.float64) for part in parts)
        finite = all(np.isfinite(part).all() for part in (*parts[:2], parts[4], guess))
        if not finite or np.isnan(parts[2]).any() or np.isnan(parts[3]).any():
            return ContactSolution(np.where(np.isfinite(guess), guess, 0.0), np.inf, np.inf, 0, False)
        per_contact = problem.rows_per_contact
        asked = (self.tolerance, self.force_share)
        start = WARM if guess.any() else COLD
        found = iterate(*parts, per_contact, guess, start, *asked)
        if not found[4] and guess.any():
            anew = iterate(*parts, per_contact, np.zeros_like(guess), COLD, *asked)
            steps = found[3] + anew[3]
            found = anew if anew[4] or anew[1] < found[1] else found
            found = (*found[:3], steps, found[4])
        return ContactSolution(*found)


@njit(**KERNEL)
def _dot(a, b):
    total = 0.0
    for p in range(len(a)):
        total += a[p] * b[p]
    return total


@njit(**KERNEL)
def own_compliance(Yt, actuators, per_contact, own):
    """W_ii of every row, for both tangents of a contact their mean [m/N]."""
    for i in range(len(Yt)):
        own[i] = _dot(Yt[i], Yt[i])
    if per_contact == 3:
        for n in range(actuators, len(Yt), 3):
            own[n + 1] = own[n + 2] = 0.5 * (own[n + 1] + own[n + 2])


@njit(**KERNEL)
def gather(Yt, force, x):
    """x ← Y λ."""
    x[:] = 0.0
    for i in range(len(force)):
        if force[i] != 0.0:
            for p in range(len(x)):
                x[p] += Yt[i, p] * force[i]


@njit(**KERNEL)
def move(Yt, violation, x, delta):
    """δ ← Yᵀ x + violation."""
    for i in range(len(delta)):
        total = violation[i]
        for p in range(len(x)):
            total += Yt[i, p] * x[p]
        delta[i] = total


@njit(**KERNEL)
def fill_jacobian(Yt, slope, actuators, per_contact, matrix):
    """∂g/∂x = 1 + Y K Yᵀ, shape (rank, rank)."""
    rank = matrix.shape[1]
    matrix[:] = 0.0
    for p in range(rank):
        matrix[p, p] = 1.0
    for i in range(len(Yt)):
        rubs = per_contact == 3 and i >= actuators
        if rubs and (i - actuators) % 3 != 0:
            continue
        if slope[i, 0] == 0.0:
            continue
        for p in range(rank):
            c_0, c_1, c_2 = Yt[i, p] * slope[i, 0], 0.0, 0.0
            if rubs:
                y_1, y_2 = Yt[i + 1, p], Yt[i + 2, p]
                c_0 += y_1 * slope[i + 1, 0] + y_2 * slope[i + 2, 0]
                c_1 = y_1 * slope[i + 1, 1] + y_2 * slope[i + 2, 1]
                c_2 = y_1 * slope[i + 1, 2] + y_2 * slope[i + 2, 2]
            if c_0 != 0.0:
                for q in range(rank):
                    matrix[p, q] += c_0 * Yt[i, q]
            if c_1 != 0.0 or c_2 != 0.0:
                for q in range(rank):
                    matrix[p, q] += c_1 * Yt[i + 1, q] + c_2 * Yt[i + 2, q]


@njit(**KERNEL)
def iterate(
    Yt, violation, lower, upper, friction, per_contact, guess, compliance, tolerance, force_share
):
    """Rounds of Newton's method around one centre after the other.

    Returns:
        Multipliers [N], their residual [m] and [N], Newton steps made, and whether it is as small
        as asked.
    """
    (n, rank), actuators = Yt.shape, len(lower)
    own, stiffness = np.empty(n), np.empty(n)
    own_compliance(Yt, actuators, per_contact, own)
    centre, best, force = guess.copy(), guess.copy(), np.empty(n)
    x, delta, slope = np.empty(rank), np.empty(n), np.empty((n, 3))
    bounds = (lower, upper, friction, per_contact)
    for row in range(actuators, n, per_contact):
        if own[row] == 0.0:
            centre[row : row + per_contact] = 0.0
    admissible(lower, upper, friction, per_contact, centre)
    shrink, steps, rounds, more = SHRINK, 0, 0, 0
    least, gap, newtons = np.inf, np.inf, np.inf
    while True:
        gather(Yt, centre, x)
        move(Yt, violation, x, delta)
        gap_now, newtons_now = natural_residual(own, delta, *bounds, centre)
        asked = force_share * np.abs(centre).max()
        share = gap_now / tolerance
        if newtons_now > 0.0:
            share = max(share, newtons_now / asked if asked > 0.0 else np.inf)
        if share < least:
            least, gap, newtons = share, gap_now, newtons_now
            best[:] = centre
        more += 1 if least <= 1.0 else 0
        if least <= AIM or more > MOST_ROUNDS_MORE:
            break
        if steps >= MOST_STEPS or rounds >= MOST_STEPS:
            break
        rounds += 1
        for i in range(n):
            stiffness[i] = 1.0 / (compliance * own[i]) if own[i] > 0.0 else 0.0
        made, solved = _newton_round(
            Yt, violation, *bounds, centre, stiffness, x, delta, force, slope
        )
        steps += made
        if solved:
            centre[:] = force
            compliance, shrink = max(compliance * shrink, LEAST), max(RECOVER * shrink, SHRINK)
        else:
            compliance, shrink = min(GROW * compliance, COLD), min(np.sqrt(shrink), SLOWEST)
    return best, gap, newtons, steps, least <= 1.0


@njit(**KERNEL)
def _newton_round(
    Yt, violation, lower, upper, friction, per_contact, centre, stiffness, x, delta, force, slope
):
    """Newton's method around one centre from x and its δ; both, λ and its slopes are moved on.

    Returns:
        Steps made, and whether it ended at a root.
    """
    (n, rank), actuators = Yt.shape, len(lower)
    g, step, trial, trial_g = np.empty(rank), np.empty(rank), np.empty(rank), np.empty(rank)
    trial_delta, matrix = np.empty(n), np.empty((rank, rank))
    bounds = (lower, upper, friction, per_contact)
    law(delta, centre, stiffness, *bounds, force, slope)
    gather(Yt, force, g)
    g[:] = x - g
    square = _dot(g, g)
    for made in range(MOST_STEPS_A_ROUND):
        fill_jacobian(Yt, slope, actuators, per_contact, matrix)
        step[:] = -g
        if not solve_system(matrix, step, rank):
            return made, False
        length, part, fell = _dot(step, step), 1.0, False
        for halving in range(MOST_HALVINGS):
            trial[:] = x + part * step
            move(Yt, violation, trial, trial_delta)
            law(trial_delta, centre, stiffness, *bounds, force, slope)
            gather(Yt, force, trial_g)
            trial_g[:] = trial - trial_g
            fell = _dot(trial_g, trial_g) < square * (1.0 - ENOUGH * part)
            size = _dot(trial, trial)
            if not fell and halving == 0 and length <= ROUND_OFF * ROUND_OFF * size:
                # A whole step that moves nothing is round-off.
                return made + 1, True
            if fell:
                break
            part *= 0.5
        if not fell:
            return made + 1, False
        x[:], delta[:], g[:] = trial, trial_delta, trial_g
        square, size = _dot(g, g), _dot(x, x)
        moved = part * part * length
        if moved <= SMALL_STEP**2 * size or square <= SMALL_RESIDUAL**2 * size:
            return made + 1, True
    return MOST_STEPS_A_ROUND, False
