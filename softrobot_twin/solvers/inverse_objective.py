"""Hessian and gradient of the inverse problem in contact, see `inverse_contact`."""

from __future__ import annotations

import numpy as np
from numba import njit

from softrobot_twin.solvers.inverse_qp import CABLE_COMPLIANCE, MOVES_NOTHING

LEAST = np.finfo(float).tiny


# One function, that it can be called uncompiled too.
@njit(cache=True, nogil=True, error_model="numpy")
def tracking_and_energy(
    motion, A, C, effectors, weights, energy_weight, steadiness, last
):
    """½ ‖Q^½ (motion z + δ_e)‖²/s + ½ ε (1 + steadiness) zᵀWz, steadied towards the last answer.

    A multiplier's unit stores one joule, 1/√W_ii [√(N/m)]; a move's unit moves the effectors as
    much as the actuators' do in the mean, which is s. The energy is made definite by a share of
    one over the squared unit.

    Args:
        motion: Effector motion by z = (λ_a, u, λ_c), shape (e, n).
        A: Shortening by z, shape (a, n).
        C: Gap by z, shape (c, n).
        effectors: δ_e less the target [m], shape (e,).
        weights: Q, weight of each effector row, shape (e,).
        energy_weight: ε.
        steadiness: Weight of the energy of z - last, by that of z itself.
        last: z of the last answer, shape (n,).

    Returns:
        P, shape (n, n), and g, shape (n,).
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
    # What moves nothing has a compliance of one.
    for start, stop in ((0, actuators), (first, n)):
        most = LEAST
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
            energy[i, i] += CABLE_COMPLIANCE * own[i]
        # A move without an end is as dear as a tension that moves as much.
        elif s > 0.0 and P[i, i] > MOVES_NOTHING * most:
            energy[i, i] = P[i, i] / s
        else:
            energy[i, i] = 1.0
    if not s > 0.0:
        s = moves
    if not s > 0.0:
        # Nothing to track: the energy term alone decides.
        s, energy_weight = 1.0, 1.0
    for i in range(n):
        g[i] /= s
        for j in range(n):
            g[i] -= energy_weight * steadiness * energy[i, j] * last[j]
            P[i, j] = P[i, j] / s + energy_weight * (1.0 + steadiness) * energy[i, j]
    for i in range(n):
        for j in range(i):
            P[i, j] = P[j, i] = 0.5 * (P[i, j] + P[j, i])
    return P, g
