"""Cables that are commanded while others are optimised around them.

A winch holds such a cable to a length. Its path is as short as that or shorter, and it pulls only
where it is taut: 0 ≤ λ ⊥ δ_a - wound ≥ 0, the law of contact. So the inverse problem takes it for
one contact more.
"""

from __future__ import annotations

import numpy as np

from softrobot_twin.simulation.actuation import Linearized
from softrobot_twin.solvers.inverse_contact import (
    ContactBounds,
    InverseContact,
    build_inverse_contact,
)
from softrobot_twin.solvers.inverse_qp import Bounds
from softrobot_twin.solvers.pivoting import solve_by_pivoting


def split(
    W: np.ndarray, violation: np.ndarray, effectors: slice, contacts: slice,
    slides: tuple[np.ndarray, np.ndarray], commanded: np.ndarray, wound: np.ndarray,
) -> InverseContact:  # fmt: skip
    """Blocks of the inverse problem with commanded cables before the contacts.

    Args:
        W: Compliance of cables, effectors, contacts [m/N], shape (n, n).
        violation: Their δ without multipliers, effectors' less the targets [m], shape (n,).
        effectors: The effectors' rows.
        contacts: The contacts' rows.
        slides: G_e and G_c.
        commanded: Which cables are, shape (cable_count,).
        wound: What they are wound to [m], shape (cable_count,).

    Returns:
        The blocks.
    """
    G_e, G_c = slides
    moves = G_e.shape[1]
    e, c = effectors, contacts
    if not commanded.any():
        a = slice(0, len(wound))
        return InverseContact(
            W[e, a], W[e, c], W[a, a], W[a, c], W[c, c], G_e, np.zeros((a.stop, moves)), G_c,
            violation[e], violation[a], violation[c],
        )  # fmt: skip
    a, taut = np.flatnonzero(~commanded), np.flatnonzero(commanded)
    own = np.concatenate([taut, np.arange(c.start, c.stop)])
    gaps = violation[own]
    gaps[: len(taut)] -= wound[taut]
    return InverseContact(
        W[e, a], W[e, own], W[np.ix_(a, a)], W[np.ix_(a, own)], W[np.ix_(own, own)],
        G_e, np.zeros((len(a), moves)), np.concatenate([np.zeros((len(taut), moves)), G_c]),
        violation[e], violation[a], gaps,
    )  # fmt: skip


def of_cables(bounds: Bounds, cables: np.ndarray) -> Bounds:
    """The bounds of some of the cables.

    Args:
        bounds: Bounds of all actuators.
        cables: Which, shape (cable_count,).
    """
    return Bounds(*(bound[: len(cables)][cables] for bound in bounds))


def tensions_around(
    linear: Linearized, violation: np.ndarray, weights: np.ndarray, energy_weight: float,
    start: np.ndarray, bounds: Bounds, commanded: np.ndarray, steadiness: float = 0.0,
) -> np.ndarray | None:  # fmt: skip
    """Tensions that bring effectors to their targets where some cables are commanded.

    Args:
        linear: The condensed system, without contacts.
        violation: Effectors' δ less the targets [m], shape (effector_row_count,).
        weights: Weight of each effector row, same shape.
        energy_weight: ε.
        start: Tensions when the others stay [N], shape (actuator_count,).
        bounds: Bounds of this step, as wide as that needs.
        commanded: Which cables are, shape (actuator_count,).
        steadiness: Weight of staying at `start`; see `build_inverse_contact`.

    Returns:
        Tensions [N], shape (actuator_count,), or None where there is no answer.
    """
    a, e = len(start), len(start) + len(violation)
    W = np.zeros((e, e))
    W[:a, :a], W[a:, :a], W[:a, a:] = linear.W_aa, linear.W_ea, linear.W_ea.T
    system = split(
        W, np.concatenate([linear.actuators, violation]), slice(a, e), slice(e, e),
        (np.empty((e - a, 0)), np.empty((0, 0))), commanded, bounds.displacement_max,
    )  # fmt: skip
    none = np.empty(0)
    order = np.concatenate([np.flatnonzero(~commanded), np.flatnonzero(commanded)])
    problem = build_inverse_contact(
        system, weights, energy_weight, of_cables(bounds, ~commanded),
        ContactBounds(none, none, bounds.effort_max[commanded]), start[order], steadiness,
    )  # fmt: skip
    found = solve_by_pivoting(problem, start[order], start[commanded] > 0.0)
    if not found.solved:
        return None
    tensions = np.empty(a)
    tensions[order] = found.unknowns
    return tensions
