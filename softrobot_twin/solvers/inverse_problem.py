"""The inverse problem of one linearization (Coevoet 2017, eq. 17-22), from the condensed blocks.

    min ½ ‖Q^½ δ_e‖² / s + ½ ε ‖z‖²_W + ½ ε p ‖z - z̄‖²_W      with z = (λ_a, u, λ_c)
    δ_e = W_e z + δ_e,free        effector errors
    δ_a = W_a z + δ_a,free        within the bounds on displacements
    δ_c = W_c z + δ_c,free        0 ≤ λ_c ⊥ δ_c ≥ 0

λ_a are the efforts of the actuators, λ_c the contact forces. A move u is a displacement that an
actuator prescribes, for instance the slide that carries a robot: in place of an effort its own
displacement is the unknown, and its columns say what it displaces. Without contacts this is a
quadratic program; with contacts it is a quadratic program with complementarity constraints. Both
are built here, by the same function.

ε is a pure number: the energy counts relative to the mean curvature s of the tracking term. The
energy of *all* multipliers is penalised, therefore several actuators, or several contacts, that do
the same share the load in exactly one manner. p weighs the distance from a centre z̄.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softrobot_twin.kernels.compilation import KERNEL, njit
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
NO_FORCES = np.empty(0)


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


class InverseSystem(NamedTuple):
    """The robot seen from its effectors, actuators and contacts (eq. 14).

    Attributes:
        W_e: Effector displacement by the unknowns z = (λ_a, u, λ_c), shape (e, n).
        W_a: Actuator displacement by these, shape (a, n); that of a move is the move.
        W_c: Gap by these, shape (c, n), n = a + c.
        is_move: Whether the unknown of each actuator is its move, shape (a,).
        effectors: δ_e,free: effector error at z = 0 [m], shape (e,).
        actuators: δ_a,free [m], shape (a,).
        gaps: δ_c,free [m], shape (c,).
        W: ‖z‖² is zᵀ W z, where it is not that of W_a and W_c, shape (n, n): with friction, forces
            along contacts follow from z and store energy too.
    """

    W_e: np.ndarray
    W_a: np.ndarray
    W_c: np.ndarray
    is_move: np.ndarray
    effectors: np.ndarray
    actuators: np.ndarray
    gaps: np.ndarray
    W: np.ndarray | None = None

    @classmethod
    def without_contacts(
        cls, W_e: np.ndarray, W_a: np.ndarray, effectors: np.ndarray, actuators: np.ndarray
    ) -> InverseSystem:
        """A system without contacts and moves; see the attributes.

        Args:
            W_e: Effector displacement by the unknowns λ_a, shape (e, a).
            W_a: Actuator displacement by these, shape (a, a).
            effectors: δ_e,free [m], shape (e,).
            actuators: δ_a,free [m], shape (a,).
        """
        count = len(W_a)
        none, is_move = np.empty((0, count)), np.zeros(count, dtype=bool)
        return cls(W_e, W_a, none, is_move, effectors, actuators, np.empty(0))


def build_inverse_problem(
    system: InverseSystem,
    effector_weights: np.ndarray,
    energy_weight: float,
    bounds: Bounds,
    force_max: np.ndarray = NO_FORCES,
    centre: np.ndarray | None = None,
    proximal_weight: float = 0.0,
    sizes: np.ndarray | None = None,
) -> QPCC:
    """Stack the inverse problem in the unknowns z = (λ_a, u, λ_c).

    Args:
        system: The condensed blocks.
        effector_weights: Weight Q of each effector row, zero where it has no target, shape (e,).
        energy_weight: ε.
        bounds: Bounds on actuator displacements [m] and efforts [N]; no move has those of efforts.
        force_max: Greatest contact force [N], infinite where there is no limit, shape (c,).
        centre: z̄, its moves zero, shape (n,); needed with a proximal weight.
        proximal_weight: p, relative to the weight of the energy. Directions that the targets leave
            open then go only the share 1 / (1 + p) towards the least energy in one step. Without
            any target the energy alone decides, and p has no effect.
        sizes: Large displacement of each actuator in its unit, shape (a,); 1 by default.

    Returns:
        The problem. Bounds on displacements are bounds of its rows, those on efforts and moves
        bounds of its unknowns.
    """
    contacts = len(system.gaps)
    # Contiguous by rows, as the compiled kernels expect.
    motion, A, C = map(np.ascontiguousarray, system[:3])
    W = np.concatenate([A, C]) if system.W is None else np.ascontiguousarray(system.W)
    P, g = tracking_and_energy(
        motion, W, system.is_move, system.effectors, effector_weights, energy_weight,
        proximal_weight, np.zeros(motion.shape[1]) if centre is None else np.array(centre),
        np.ones(len(A)) if sizes is None else sizes,
    )  # fmt: skip
    least, most, lower, upper = bounds
    least, most = least - system.actuators, most - system.actuators
    if system.is_move.any():
        lower, least = np.where(system.is_move, (least, lower), (lower, least))
        upper, most = np.where(system.is_move, (most, upper), (upper, most))
    if contacts:
        lower = np.concatenate([lower, np.zeros(contacts)])
        upper = np.concatenate([upper, np.full(contacts, np.inf)])
    return QPCC(P, g, lower, upper, A, least, most, C, system.gaps, force_max)


def with_effort_rows(problem: QPCC, stiffness: np.ndarray, reference: np.ndarray, free: np.ndarray) -> QPCC:
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


@njit(**KERNEL)
def own_compliances(W, start, sizes):
    """W_ii of each actuator, 1 where an actuator moves nothing.

    Actuators have several units: W_ii / d_i² [1/J] compares them.

    Args:
        W: Compliance, shape (n, n).
        start: Row of the first actuator.
        sizes: Large displacement d_i of each, in its unit, shape (count,).

    Returns:
        Shape (count,).
    """
    most, own = TINY, np.ones(len(sizes))
    for i in range(len(sizes)):
        most = max(most, W[start + i, start + i] / sizes[i] ** 2)
    for i in range(len(sizes)):
        if W[start + i, start + i] > MOVES_NOTHING * most * sizes[i] ** 2:
            own[i] = W[start + i, start + i]
    return own


@njit(**KERNEL)
def tracking_and_energy(motion, W, is_move, effectors, weights, energy_weight, proximal_weight, centre, sizes):
    """Hessian and gradient of ½ ‖Q^½ δ_e‖² / s + ½ ε (‖z‖²_W + p ‖z - z̄‖²_W).

    The unit of a multiplier is the one that stores one joule, 1/√W_ii [√(N/m)]; the unit of a move
    displaces the effectors as much as the actuators' units do in the mean, which is √s. The energy
    is made definite by ADDED_COMPLIANCE in these units.

    Args:
        motion: Effector displacement by z, shape (e, n).
        W: Displacements of actuators and gaps by z, shape (n, n).
        is_move: Whether the unknown of each actuator is its move, shape (a,).
        effectors: δ_e,free [m], shape (e,).
        weights: Q, weight of each effector row, shape (e,).
        energy_weight: ε.
        proximal_weight: p.
        centre: z̄, shape (n,).
        sizes: See `own_compliances`, shape (a,).

    Returns:
        The Hessian P, shape (n, n), and the gradient g at z = 0, shape (n,).
    """
    n, actuators = motion.shape[1], len(is_move)
    stores, efforts = np.ones(n, np.bool_), 0
    for i in range(actuators):
        stores[i] = not is_move[i]
        efforts += stores[i]
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
            if stores[i] and stores[j]:
                energy[i, j] = W[i, j]
    own[:actuators] = own_compliances(energy, 0, sizes)
    own[actuators:] = own_compliances(energy, actuators, np.ones(n - actuators))
    s, moves, most = 0.0, 0.0, 0.0
    for i in range(actuators):
        if stores[i]:
            s += P[i, i] / own[i] / efforts
        else:
            moves += P[i, i] / (actuators - efforts)
            most = max(most, P[i, i])
    for i in range(n):
        if stores[i]:
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
