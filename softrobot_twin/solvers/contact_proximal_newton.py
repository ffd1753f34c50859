"""Actuators and contacts by a proximal semismooth Newton method.

Rigid bodies on many points need it, a soft body with more than a hundred rows without friction (an
eighth of the time of sweeps on Hertz's problem, or less), and what other solvers do not solve.

With the law λ(δ) of `contact_law` around a centre λ̄, the equation

    g(λ) = λ - λ(δ) = 0,   δ = W λ + violation,   (1 + K W) Δ = -g,   K = -∂λ/∂δ

is solved by Newton's method; the step is halved until ‖g‖_W falls. (The Jacobian is not symmetric
where contacts slide.) Then λ̄ ← λ and the law is made stiffer. This is a proximal point iteration:
the compliance acts only on the change of λ, hence its end is Signorini's and Coulomb's law without
any compliance. Redundant contacts, whose load sharing W does not determine, share it as λ̄ does.

The compliance ε W_ii begins at a share ε = 1 without a guess and at 0.01 with one, and shrinks
tenfold in each round. Where Newton's method fails, it goes back to the last centre with eight times
the compliance, which shrinks more slowly from there on.

The system is solved in one of two forms, whichever is smaller:

By the factor. Where W = YᵀY has a low rank, x = Y λ describes all effects of the forces: six
unknowns for each rigid body, however many of its points touch. Then

    g(x) = x - Y λ(δ(x)) = 0,   δ(x) = Yᵀ x + violation,   ∂g/∂x = 1 + Y K Yᵀ

By the matrix. Where W has full rank, Δ itself is solved for. Rows whose force does not change with
their motion drop out: open contacts, and the sliding direction d. What remains is one unknown for
an actuator between its bounds and for a normal that presses, two for sticking tangents, and one
for sliding ones, across d (the unit vector τ):

    row i       u / ρ + (W Δ)_i     = -g_i / ρ - (W c)_i
    across d    u / κ + τ · (W Δ)_t = -τ · g_t / κ - τ · (W c)_t,   κ = ρ_t µ λ_n / ‖z‖

with Δ = B u + c: the force of a sliding tangent follows its normal's, Δ_t = µ Δ_n d + u τ + c_t. It
is the system of `contact_newton_step`, with a compliance that its right-hand side contains. Since
x = Y λ, its merit ‖Y g‖² = g · W g is the same as by the factor.
"""

from __future__ import annotations

import numpy as np

from softrobot_twin.kernels.compilation import INNER, KERNEL, ONCE, njit
from softrobot_twin.solvers.contact_gauss_seidel import motion
from softrobot_twin.solvers.contact_law import (
    admissible,
    average_tangents,
    copy_into,
    law,
    natural_residual,
    own_compliance,
)
from softrobot_twin.solvers.contact_newton_step import (
    PLAIN,
    TURNING,
    apply_step,
    fill_matrix,
    solve_system,
)
from softrobot_twin.solvers.contact_problem import ContactProblem, ContactSolution
from softrobot_twin.solvers.small_cholesky import dot_product

# Compliance ε without a guess, with a guess, and at least.
COLD, WARM, LEAST = 1.0, 1.0e-2, 1.0e-8
# How ε shrinks after a round that converged, at the slowest after failures; how it grows after a
# failure, and how the shrinking recovers.
SHRINK, SLOWEST, GROW, RECOVER = 0.1, 0.7, 8.0, 0.8
MOST_STEPS, MOST_STEPS_A_ROUND, MOST_HALVINGS = 300, 20, 7
# A step is kept if the residual's square falls by this share of it. A round ends where the step or
# the residual is this small relative to x; a step this small that does not help is round-off.
ENOUGH, SMALL_STEP, SMALL_RESIDUAL, ROUND_OFF = 0.1, 1.0e-8, 1.0e-11, 1.0e-10
# Share of the required residual that is aimed at by the factor, where rounds are cheap, and the
# most rounds spent on it: a motion of a heavy body by a nanometre is a large force.
AIM, MOST_ROUNDS_MORE = 1.0e-3, 4

NO_MATRIX = np.empty((0, 0))


class ContactProximalNewton:
    """Solves contact problems by the factor of W where it is given, else by W.

    The same input gives the same bits.

    Attributes:
        tolerance: Residual at which a solution is good enough [m].
        force_share: The same in newtons, as a share of the largest force.
    """

    def __init__(self, tolerance: float, force_share: float):
        self.tolerance = tolerance
        self.force_share = force_share

    def solve(self, problem: ContactProblem, guess: np.ndarray) -> ContactSolution:
        """Multipliers from a guess.

        Args:
            problem: The problem, with its factor or with W.
            guess: Multipliers to begin with [N], shape (n,); zeros if nothing is known.

        Returns:
            The solution; `sweeps` are Newton steps. `converged` is False if a residual is larger
            than required: then it is the best that was found, or the finite part of the guess
            where the problem is not finite.
        """
        guess = np.array(guess, dtype=np.float64)
        by_factor = problem.Yt is not None
        W = NO_MATRIX if by_factor else problem.W
        Yt = problem.Yt if by_factor else np.empty((len(guess), 0))
        parts = (W, Yt, problem.violation, problem.lower, problem.upper, problem.friction)
        parts = tuple(np.ascontiguousarray(part, dtype=np.float64) for part in parts)
        finite = all(np.isfinite(part).all() for part in (*parts[:3], parts[5], guess))
        if not finite or np.isnan(parts[3]).any() or np.isnan(parts[4]).any():
            finite_guess = np.where(np.isfinite(guess), guess, 0.0)
            return ContactSolution(finite_guess, np.inf, np.inf, 0, False)
        given = (*parts, problem.rows_per_contact)
        asked = (self.tolerance, self.force_share, AIM if by_factor else 1.0)
        try:
            found = iterate(*given, guess, WARM if guess.any() else COLD, *asked)
            # By the matrix a second try would take too long.
            if by_factor and not found[4] and guess.any():
                anew = iterate(*given, np.zeros_like(guess), COLD, *asked)
                steps = found[3] + anew[3]
                found = anew if anew[4] or anew[1] < found[1] else found
                found = (*found[:3], steps, found[4])
        except np.linalg.LinAlgError:
            return ContactSolution(guess, np.inf, np.inf, 0, False)
        return ContactSolution(*found)


@njit(**KERNEL)
def iterate(
    W, Yt, violation, lower, upper, friction, per_contact, guess, compliance, tolerance,
    force_share, aim,
):  # fmt: skip
    """Rounds of Newton's method, each around the centre that the last one found.

    Args:
        W: Compliance [m/N], shape (n, n); empty where the factor is used.
        Yt: Its factor, shape (n, rank); rank 0 where W is used.
        violation: See `ContactProblem`, as are the next three.
        lower: See violation.
        upper: See violation.
        friction: See violation.
        per_contact: Rows of a contact, 1 or 3.
        guess: First centre [N], shape (n,).
        compliance: First ε.
        tolerance: Required residual [m].
        force_share: Required residual in newtons, as a share of the largest force.
        aim: Share of the required residual at which to stop early.

    Returns:
        Multipliers [N], their residual [m] and [N], Newton steps made, and whether the residual is
        as small as required.
    """
    (n, rank), actuators = Yt.shape, len(lower)
    by_factor = rank > 0
    own = _own_by_factor(Yt, actuators, per_contact) if by_factor else own_compliance(
        W, actuators, per_contact
    )
    centre, best, force, stiffness = guess.copy(), guess.copy(), np.empty(n), np.empty(n)
    # The unknown of Newton's method: x = Y λ, or λ itself.
    point, delta = np.empty(rank if by_factor else n), np.empty(n)
    bounds = (lower, upper, friction, per_contact)
    for row in range(actuators, n, per_contact):
        if own[row] == 0.0:
            centre[row : row + per_contact] = 0.0
    admissible(lower, upper, friction, per_contact, centre)
    shrink, steps, rounds, more = SHRINK, 0, 0, 0
    least, gap, newtons = np.inf, np.inf, np.inf
    while True:
        if by_factor:
            gather(Yt, centre, point)
            move(Yt, violation, point, delta)
        else:
            copy_into(point, centre)
            motion(W, violation, centre, delta)
        gap_now, newtons_now = natural_residual(own, delta, *bounds, centre)
        asked = force_share * np.abs(centre).max()
        share = gap_now / tolerance
        if newtons_now > 0.0:
            share = max(share, newtons_now / asked if asked > 0.0 else np.inf)
        if share < least:
            least, gap, newtons = share, gap_now, newtons_now
            copy_into(best, centre)
        more += 1 if least <= 1.0 else 0
        if least <= aim or more > MOST_ROUNDS_MORE:
            break
        if steps >= MOST_STEPS or rounds >= MOST_STEPS:
            break
        rounds += 1
        for i in range(n):
            stiffness[i] = 1.0 / (compliance * own[i]) if own[i] > 0.0 else 0.0
        made, solved = _newton_round(
            W, Yt, violation, *bounds, centre, stiffness, point, delta, force
        )
        steps += made
        if solved:
            copy_into(centre, force)
            compliance, shrink = max(compliance * shrink, LEAST), max(RECOVER * shrink, SHRINK)
        else:
            compliance, shrink = min(GROW * compliance, COLD), min(np.sqrt(shrink), SLOWEST)
    return best, gap, newtons, steps, least <= 1.0


@njit(**INNER)
def _newton_round(
    W, Yt, violation, lower, upper, friction, per_contact, centre, stiffness, point, delta, force
):
    """Newton's method around one centre; point, its δ and its λ(δ) are written.

    Returns:
        Steps made, and whether it ended at a root.
    """
    n, size_of_point, by_factor = len(delta), len(point), Yt.shape[1] > 0
    bounds = (lower, upper, friction, per_contact)
    slope, trial_delta, moved, by_force = np.empty((n, 3)), np.empty(n), np.empty(n), np.empty(n)
    g, step = np.empty(size_of_point), np.empty(size_of_point)
    trial, trial_g, none = np.empty(size_of_point), np.empty(size_of_point), np.zeros(n)
    law(delta, centre, stiffness, *bounds, force, slope)
    square = _residual(W, Yt, violation, point, delta, force, by_force, g)
    for made in range(MOST_STEPS_A_ROUND):
        if by_factor:
            if not _step_by_factor(Yt, slope, len(lower), per_contact, g, step):
                return made, False
            length = dot_product(step, step)
        else:
            _step_by_matrix(
                W, slope, force, delta, centre, stiffness, g, friction, len(lower), per_contact,
                step,
            )  # fmt: skip
            motion(W, none, step, moved)
            length = dot_product(step, moved)
        part, fell, merit, size = 1.0, False, 0.0, 0.0
        for halving in range(MOST_HALVINGS):
            for i in range(size_of_point):
                trial[i] = point[i] + part * step[i]
            if by_factor:
                move(Yt, violation, trial, trial_delta)
            else:
                for i in range(n):
                    trial_delta[i] = delta[i] + part * moved[i]
            law(trial_delta, centre, stiffness, *bounds, force, slope)
            merit = _residual(W, Yt, violation, trial, trial_delta, force, by_force, trial_g)
            fell = merit < square * (1.0 - ENOUGH * part)
            if by_factor:
                size = dot_product(trial, trial)
            else:
                size = _energy(trial, none, trial_delta, violation)
            if not fell and halving == 0 and length <= ROUND_OFF * ROUND_OFF * size:
                # A whole step that moves nothing is round-off.
                return made + 1, True
            if fell:
                break
            part *= 0.5
        if not fell:
            return made + 1, False
        copy_into(point, trial)
        copy_into(delta, trial_delta)
        copy_into(g, trial_g)
        square = merit
        if part * part * length <= SMALL_STEP**2 * size or square <= SMALL_RESIDUAL**2 * size:
            return made + 1, True
    return MOST_STEPS_A_ROUND, False


@njit(**INNER)
def _residual(W, Yt, violation, point, delta, force, by_force, g):
    """g, written, and its square ‖Y (λ - λ(δ))‖²; `by_force` is a buffer for the motion by λ(δ)."""
    if Yt.shape[1] > 0:
        gather(Yt, force, g)
        for i in range(len(g)):
            g[i] = point[i] - g[i]
        return dot_product(g, g)
    motion(W, violation, force, by_force)
    for i in range(len(g)):
        g[i] = point[i] - force[i]
    return _energy(point, force, delta, by_force)


@njit(**INNER)
def _energy(first, second, first_delta, second_delta):
    """(λ - λ') · W (λ - λ') of two multipliers, from the motions of both."""
    total = 0.0
    for i in range(len(first)):
        total += (first[i] - second[i]) * (first_delta[i] - second_delta[i])
    return max(total, 0.0)


@njit(**ONCE)
def _step_by_factor(Yt, slope, actuators, per_contact, g, step):
    """Newton step of x, written; False where the Jacobian is singular."""
    matrix = np.empty((len(g), len(g)))
    fill_jacobian(Yt, slope, actuators, per_contact, matrix)
    for i in range(len(g)):
        step[i] = -g[i]
    return solve_system(matrix, step, len(g))


@njit(**ONCE)
def _step_by_matrix(W, slope, force, delta, centre, stiffness, g, friction, actuators, per_contact, step):
    """Newton step Δ of λ, written.

    Raises:
        numpy.linalg.LinAlgError: The system is singular.
    """
    n = len(g)
    rows, kinds = np.empty(n, dtype=np.int64), np.empty(n, dtype=np.int64)
    frame, change, known, none = np.empty((n, 4)), np.empty(n), np.empty(n), np.zeros(n)
    count = pick_rows(
        slope, force, delta, centre, stiffness, g, friction, actuators, per_contact,
        rows, kinds, frame,
    )  # fmt: skip
    for i in range(n):
        change[i] = frame[i, 3]
    motion(W, none, change, known)
    matrix, right = fill_reduced_system(W, g, known, stiffness, rows, kinds, frame, count)
    u = np.linalg.solve(matrix, right) if count else right
    copy_into(step, change)
    apply_step(rows, kinds, frame, count, u, step)


@njit(**ONCE)
def _own_by_factor(Yt, actuators, per_contact):
    """See `own_compliance`, from the factor."""
    own = np.empty(len(Yt))
    for i in range(len(Yt)):
        own[i] = dot_product(Yt[i], Yt[i])
    average_tangents(own, actuators, per_contact)
    return own


@njit(**INNER)
def gather(Yt, force, x):
    """x ← Y λ, with `Yt` of shape (n, rank), `force` λ [N] of shape (n,) and x of shape (rank,)."""
    x[:] = 0.0
    for i in range(len(force)):
        if force[i] != 0.0:
            for p in range(len(x)):
                x[p] += Yt[i, p] * force[i]


@njit(**INNER)
def move(Yt, violation, x, delta):
    """δ ← Yᵀ x + violation.

    Args:
        Yt: Yᵀ with W = Yᵀ Y, shape (n, rank).
        violation: Motion without multipliers [m], shape (n,).
        x: Y λ, shape (rank,).
        delta: δ [m], written, shape (n,).
    """
    for i in range(len(delta)):
        total = violation[i]
        for p in range(len(x)):
            total += Yt[i, p] * x[p]
        delta[i] = total


@njit(**KERNEL, inline="always")
def fill_jacobian(Yt, slope, actuators, per_contact, matrix):
    """∂g/∂x = 1 + Y K Yᵀ.

    Args:
        Yt: Yᵀ, shape (n, rank).
        slope: Of `law` [N/m], shape (n, 3).
        actuators: Number of actuators, whose rows come first.
        per_contact: Rows of a contact, 1 or 3.
        matrix: Written, shape (rank, rank).
    """
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


@njit(**KERNEL, inline="always")
def pick_rows(slope, centre_force, delta, centre, stiffness, g, friction, actuators, per_contact,
              rows, kinds, frame):  # fmt: skip
    """Unknowns u of the step by the matrix, and its known part c.

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
        frame: By row: as in `contact_newton_step.active_rows`; of a turning row τ and 1/κ; then c.
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


@njit(**KERNEL, inline="always")
def fill_reduced_system(W, g, known, stiffness, rows, kinds, frame, count):
    """Matrix and right-hand side of the unknowns of a step.

    Args:
        W: Compliance [m/N], shape (n, n).
        g: λ - λ(δ) [N], shape (n,).
        known: W c, with the known part c of the step [m], shape (n,).
        stiffness: ρ of every row [N/m], shape (n,).
        rows: Row of each unknown, shape (count,) or longer.
        kinds: `PLAIN` or `TURNING` of each unknown, same shape.
        frame: See `pick_rows`, shape (n, 4).
        count: Number of unknowns.

    Returns:
        The matrix, shape (count, count), and the right-hand side, shape (count,).
    """
    matrix, right = np.empty((count, count)), np.empty(count)
    fill_matrix(W, rows, kinds, frame, count, matrix)
    for a in range(count):
        i = rows[a]
        if kinds[a] == PLAIN:
            matrix[a, a] += 1.0 / stiffness[i]
            right[a] = -g[i] / stiffness[i] - known[i]
            continue
        t_1, t_2, soft = frame[i, 0], frame[i, 1], frame[i, 2]
        across = t_1 * g[i] + t_2 * g[i + 1]
        right[a] = -soft * across - t_1 * known[i] - t_2 * known[i + 1]
    return matrix, right
