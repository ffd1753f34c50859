"""The inverse problem in contact (Coevoet 2017, eq. 19-22) from the condensed blocks.

    min ½ ‖Q^½ δ_e‖²/s + ½ ε λᵀ W λ        over tensions λ_a, moves u, contact forces λ_c
    δ_e = W_ea λ_a + G_e u + W_ec λ_c + δ_e,free        effectors less their targets
    δ_a = W_aa λ_a + G_a u + W_ac λ_c + δ_a,free        within the bounds on shortening
    δ_c = W_ca λ_a + G_c u + W_cc λ_c + δ_c,free        0 ≤ λ_c ⊥ δ_c ≥ 0

A move u is a displacement that an actuator prescribes, as the platform does that carries a robot:
it has no multiplier and shifts everything by its columns G. ε is a pure number, relative to the
mean curvature s of the tracking term, as without contacts. The energy is that of all multipliers,
so several tensions, or several contacts, that do the same divide the load in one way only.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softrobot_twin.solvers.complementarity_problem import ComplementarityProblem
from softrobot_twin.solvers.inverse_objective import tracking_and_energy
from softrobot_twin.solvers.inverse_qp import Bounds


class InverseContact(NamedTuple):
    """The robot seen from its effectors, actuators and contacts (eq. 14).

    Attributes:
        W_ea: Effector motion by tension [m/N], shape (e, a).
        W_ec: Effector motion by contact force [m/N], shape (e, c).
        W_aa: Shortening by tension [m/N], shape (a, a).
        W_ac: Shortening by contact force [m/N], shape (a, c); W_ca is its transpose.
        W_cc: Gap by contact force [m/N], shape (c, c).
        G_e: Effector motion by move, shape (e, u); u may be zero.
        G_a: Shortening by move, shape (a, u).
        G_c: Gap by move, shape (c, u).
        effectors: δ_e less the target, without multipliers and moves [m], shape (e,).
        actuators: δ_a without them [m], shape (a,).
        gaps: δ_c without them [m], shape (c,).
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


class ContactBounds(NamedTuple):
    """Bounds besides those of the cables.

    Attributes:
        move_min: Least move in this step [m], shape (u,).
        move_max: Greatest move in this step [m], shape (u,).
        force_max: Contact force not to be exceeded [N], infinite without one, shape (c,).
    """

    move_min: np.ndarray
    move_max: np.ndarray
    force_max: np.ndarray


def build_inverse_contact(
    system: InverseContact,
    effector_weights: np.ndarray,
    energy_weight: float,
    bounds: Bounds,
    contact_bounds: ContactBounds,
    last: np.ndarray | None = None,
    steadiness: float = 0.0,
    compiled: bool = False,
) -> ComplementarityProblem:
    """Stack the inverse problem in contact; z = (λ_a, u, λ_c).

    Args:
        system: The condensed blocks.
        effector_weights: Weight of each effector row, shape (e,).
        energy_weight: ε.
        bounds: Bounds on shortening [m] and tension [N]. Equal ones command an actuator, and the
            others are optimised around it.
        contact_bounds: Bounds on moves [m] and contact forces [N].
        last: z of the last answer, its moves zero, shape (n,); needed with a steadiness.
        steadiness: Weight of the energy of z - last, by that of z itself. What the targets leave
            open then goes to the least energy by a share 1/(1 + steadiness) of the way a step, in
            place of all of it, which a linearization cannot judge.
        compiled: Whether the kernel is called, which is compiled when it is called first, or the
            same uncompiled, as where scenes without contact come here unforeseen.

    Returns:
        The problem: bounds on shortening are its rows, those on tensions and moves its bounds.
    """
    contacts = len(system.gaps)
    motion = _side_by_side(system.W_ea, system.G_e, system.W_ec)
    A = _side_by_side(system.W_aa, system.G_a, system.W_ac)
    C = _side_by_side(system.W_ac.T, system.G_c, system.W_cc)
    assemble = tracking_and_energy if compiled else tracking_and_energy.py_func
    P, g = assemble(
        motion, A, C, system.effectors, effector_weights, energy_weight, steadiness,
        np.zeros(motion.shape[1]) if last is None else last,
    )  # fmt: skip
    return ComplementarityProblem(
        P,
        g,
        np.concatenate([bounds.effort_min, contact_bounds.move_min, np.zeros(contacts)]),
        np.concatenate([bounds.effort_max, contact_bounds.move_max, np.full(contacts, np.inf)]),
        A,
        bounds.displacement_min - system.actuators,
        bounds.displacement_max - system.actuators,
        C,
        system.gaps,
        contact_bounds.force_max,
    )


def _side_by_side(*blocks: np.ndarray) -> np.ndarray:
    # Else in the order of the blocks, which may be that of columns.
    return np.ascontiguousarray(np.concatenate(blocks, axis=1))
