"""The inverse problem of one linearization (Coevoet 2017, eq. 17-22), from the condensed blocks.

    min ½ ‖Q^½ δ_e‖² / s + ½ ε ‖z‖²_W + ½ ε p ‖z - z̄‖²_W      with z = (λ_a, u, λ_c)
    δ_e = W_ea λ_a + G_e u + W_ec λ_c + δ_e,free        effector errors
    δ_a = W_aa λ_a + G_a u + W_ac λ_c + δ_a,free        within the bounds on displacements
    δ_c = W_ca λ_a + G_c u + W_cc λ_c + δ_c,free        0 ≤ λ_c ⊥ δ_c ≥ 0

λ_a are the efforts of the actuators, λ_c the contact forces. A move u is a displacement that an
actuator prescribes, for instance the slide that carries a robot: it has no multiplier, and its
columns G say what it displaces. Without contacts this is a quadratic program; with contacts it is a
quadratic program with complementarity constraints. Both are built here, by the same function.

ε is a pure number: the energy counts relative to the mean curvature s of the tracking term. The
energy of *all* multipliers is penalised, therefore several actuators, or several contacts, that do
the same share the load in exactly one manner. p weighs the distance from a centre z̄.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softrobot_twin.compilation import KERNEL, njit
from softrobot_twin.solvers.qpcc import QPCC

# Share of each row's own compliance that is added to W in the energy term, as if each actuator were
# slightly compliant: two cables on one path then share the load.
ADDED_COMPLIANCE = 1.0e-3
# A compliance or a displacement below this share of the largest counts as zero.
MOVES_NOTHING = 1.0e-14
# Least usable ε. The tracking term is rounded at about 1e-16 of s. Along directions that only cost
# energy the curvature can be as small as ε times ADDED_COMPLIANCE; with a smaller ε it would be
# rounding noise. This ε costs a billionth of the displacement in tracking.
LEAST_ENERGY_WEIGHT = float(np.sqrt(np.finfo(float).eps))

TINY = np.finfo(float).tiny


class Bounds(NamedTuple):
    """Bounds of the actuators in one step.

    Attributes:
        displacement_min: Least displacement δ_min [m], shape (n,).
        displacement_max: Greatest displacement δ_max [m], shape (n,).
        effort_min: Least effort λ_min [N], shape (n,).
        effort_max: Greatest effort λ_max [N], shape (n,).
    """

    displacement_min: np.ndarray
    displacement_max: np.ndarray
    effort_min: np.ndarray
    effort_max: np.ndarray


class ContactBounds(NamedTuple):
    """Bounds on moves and contact forces.

    Attributes:
        move_min: Least move in this step [m], shape (u,).
        move_max: Greatest move in this step [m], shape (u,).
        force_max: Greatest contact force [N], infinite where there is no limit, shape (c,).
    """

    move_min: np.ndarray
    move_max: np.ndarray
    force_max: np.ndarray

NO_CONTACTS = ContactBounds(np.empty(0), np.empty(0), np.empty(0))


class InverseSystem(NamedTuple):
    """The robot seen from its effectors, actuators and contacts (eq. 14).

    Attributes:
        W_ea: Effector displacement by effort [m/N], shape (e, a).
        W_ec: Effector displacement by contact force [m/N], shape (e, c).
        W_aa: Actuator displacement by effort [m/N], shape (a, a).
        W_ac: Actuator displacement by contact force [m/N], shape (a, c); W_ca is its transpose.
        W_cc: Gap by contact force [m/N], shape (c, c).
        G_e: Effector displacement by move, shape (e, u); u may be zero.
        G_a: Actuator displacement by move, shape (a, u).
        G_c: Gap by move, shape (c, u).
        effectors: δ_e,free: effector error without multipliers and moves [m], shape (e,).
        actuators: δ_a,free [m], shape (a,).
        gaps: δ_c,free [m], shape (c,).
    """

    W_ea: np.ndarray
    W_ec: np.ndarray
    W_aa: np.ndarray
    W_ac: np.ndarray
    W_cc: np.ndarray
    G_e: np.ndarray
    G_a: np.ndarray
    G_c: np.ndarray
    effectors: np.ndarray
    actuators: np.ndarray
    gaps: np.ndarray

    @classmethod
    def without_contacts(
        cls, W_ea: np.ndarray, W_aa: np.ndarray, effectors: np.ndarray, actuators: np.ndarray
    ) -> InverseSystem:
        """A system without contacts and moves; see the attributes."""
        e, a = W_ea.shape
        return cls(
            W_ea, np.empty((e, 0)), W_aa, np.empty((a, 0)), np.empty((0, 0)),
            np.empty((e, 0)), np.empty((a, 0)), np.empty((0, 0)),
            effectors, actuators, np.empty(0),
        )  # fmt: skip


def build_inverse_problem(
    system: InverseSystem,
    effector_weights: np.ndarray,
    energy_weight: float,
    bounds: Bounds,
    contact_bounds: ContactBounds = NO_CONTACTS,
    centre: np.ndarray | None = None,
    proximal_weight: float = 0.0,
) -> QPCC:
    """Stack the inverse problem in the unknowns z = (λ_a, u, λ_c).

    Args:
        system: The condensed blocks.
        effector_weights: Weight Q of each effector row, zero where it has no target, shape (e,).
        energy_weight: ε.
        bounds: Bounds on actuator displacements [m] and efforts [N].
        contact_bounds: Bounds on moves [m] and contact forces [N].
        centre: z̄, its moves zero, shape (n,); needed with a proximal weight.
        proximal_weight: p, relative to the weight of the energy. Directions that the targets leave
            open then go only the share 1 / (1 + p) towards the least energy in one step. Without
            any target the energy alone decides, and p has no effect.

    Returns:
        The problem. Bounds on displacements are bounds of its rows, those on efforts and moves
        bounds of its unknowns.
    """
    contacts = len(system.gaps)
    motion = _side_by_side(system.W_ea, system.G_e, system.W_ec)
    A = _side_by_side(system.W_aa, system.G_a, system.W_ac)
    C = _side_by_side(system.W_ac.T, system.G_c, system.W_cc)
    P, g = tracking_and_energy(
        motion, A, C, system.effectors, effector_weights, energy_weight, proximal_weight,
        np.zeros(motion.shape[1]) if centre is None else np.array(centre),
    )  # fmt: skip
    lower, upper = bounds.effort_min, bounds.effort_max
    if len(g) > len(lower):
        lower = np.concatenate([lower, contact_bounds.move_min, np.zeros(contacts)])
        upper = np.concatenate([upper, contact_bounds.move_max, np.full(contacts, np.inf)])
    return QPCC(
        P,
        g,
        lower,
        upper,
        A,
        bounds.displacement_min - system.actuators,
        bounds.displacement_max - system.actuators,
        C,
        system.gaps,
        contact_bounds.force_max,
    )


def with_effort_rows(
    problem: QPCC, stiffness: np.ndarray, reference: np.ndarray, free: np.ndarray
) -> QPCC:
    """Bound efforts where the unknowns are λ̂ = λ + ρ (δ_a - δ_ref), by rows in place of bounds.

    Args:
        problem: The problem in λ̂, with the bounds of λ.
        stiffness: ρ of each actuator, zero where λ̂ is λ [N/m], shape (a,).
        reference: δ_ref [m], shape (a,).
        free: δ_a,free [m], shape (a,).
    """
    shifted = np.flatnonzero(stiffness)
    rows = -stiffness[shifted, None] * problem.A[shifted]
    rows[np.arange(len(shifted)), shifted] += 1.0
    offsets = stiffness[shifted] * (free - reference)[shifted]
    lower, upper = problem.lower.copy(), problem.upper.copy()
    lower[shifted], upper[shifted] = -np.inf, np.inf
    return problem._replace(
        lower=lower, upper=upper,
        A=np.concatenate([problem.A, rows]),
        row_lower=np.concatenate([problem.row_lower, problem.lower[shifted] + offsets]),
        row_upper=np.concatenate([problem.row_upper, problem.upper[shifted] + offsets]),
    )  # fmt: skip


def _side_by_side(of_efforts, of_moves, of_forces) -> np.ndarray:
    """Blocks side by side, contiguous by rows as the compiled kernels expect."""
    if of_moves.shape[1] or of_forces.shape[1]:
        of_efforts = np.concatenate((of_efforts, of_moves, of_forces), axis=1)
    return np.ascontiguousarray(of_efforts)


@njit(**KERNEL)
def tracking_and_energy(motion, A, C, effectors, weights, energy_weight, proximal_weight, centre):
    """Hessian and gradient of ½ ‖Q^½ δ_e‖² / s + ½ ε (‖z‖²_W + p ‖z - z̄‖²_W).

    The unit of a multiplier is the one that stores one joule, 1/√W_ii [√(N/m)]; the unit of a move
    displaces the effectors as much as the actuators' units do in the mean, which is √s. The energy
    is made definite by ADDED_COMPLIANCE in these units.

    Args:
        motion: Effector displacement by z, shape (e, n).
        A: Actuator displacement by z, shape (a, n).
        C: Gap by z, shape (c, n).
        effectors: δ_e,free [m], shape (e,).
        weights: Q, weight of each effector row, shape (e,).
        energy_weight: ε.
        proximal_weight: p.
        centre: z̄, shape (n,).

    Returns:
        The Hessian P, shape (n, n), and the gradient g at z = 0, shape (n,).
    """
    n, actuators = motion.shape[1], len(A)
    first = n - len(C)
    P, energy, g, own = np.zeros((n, n)), np.zeros((n, n)), np.zeros(n), np.zeros(n)
    for r in range(len(motion)):
        for i in range(n):
            weighted = motion[r, i] * weights[r]
            g[i] += weighted * effectors[r]
            for j in range(n):
                P[i, j] += weighted * motion[r, j]
    # Moves store no energy.
    for i in range(n):
        for j in range(n):
            if i < actuators and not actuators <= j < first:
                energy[i, j] = A[i, j]
            elif i >= first and not actuators <= j < first:
                energy[i, j] = C[i - first, j]
        own[i] = energy[i, i]
    # A row that nothing displaces gets a compliance of one.
    for start, stop in ((0, actuators), (first, n)):
        most = TINY
        for i in range(start, stop):
            most = max(most, own[i])
        for i in range(start, stop):
            own[i] = own[i] if own[i] > MOVES_NOTHING * most else 1.0
    s, moves, most = 0.0, 0.0, 0.0
    for i in range(first):
        if i < actuators:
            s += P[i, i] / own[i] / actuators
        else:
            moves += P[i, i] / (first - actuators)
            most = max(most, P[i, i])
    for i in range(n):
        if not actuators <= i < first:
            energy[i, i] += ADDED_COMPLIANCE * own[i]
        # A move costs as much as an effort that displaces the effectors as far.
        elif s > 0.0 and P[i, i] > MOVES_NOTHING * most:
            energy[i, i] = P[i, i] / s
        else:
            energy[i, i] = 1.0
    if not s > 0.0:
        s = moves
    if not s > 0.0:
        # Nothing to track: the energy alone decides.
        s, energy_weight, proximal_weight = 1.0, 1.0, 0.0
    for i in range(n):
        g[i] /= s
        for j in range(n):
            g[i] -= energy_weight * proximal_weight * energy[i, j] * centre[j]
            P[i, j] = P[i, j] / s + energy_weight * (1.0 + proximal_weight) * energy[i, j]
    for i in range(n):
        for j in range(i):
            P[i, j] = P[j, i] = 0.5 * (P[i, j] + P[j, i])
    return P, g
