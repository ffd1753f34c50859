"""How far a mesh is from fine enough: the stress jumps from element to element, the true one not.

Averaging the elements' stresses at the nodes and interpolating them gives a better stress σ*; what
it differs from the elements' own σ by, in the energy norm, estimates their error
(Zienkiewicz & Zhu 1987). The share η² of the energy that it holds is also about the share of the
displacement that is missing where a load acts, as a body's compliance is its energy.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from softrobot_twin.mechanics.corotational_kernels import VOLUME, VOLUMES
from softrobot_twin.mechanics.gradient_kernels import deform, gather
from softrobot_twin.mechanics.lanes import KERNEL, LANES, at, room
from softrobot_twin.mechanics.polar import find_upright, rotate


# A body strained by less than this has no stress but round-off.
NO_STRAIN = 1.0e-10


@njit(**KERNEL)
def strain(i, j, F, R, e):
    """Entry (i, j) of ½ (RᵀF + FᵀR) - 1 of element e."""
    entry = 0.0
    for k in range(3):
        entry += R[at(3 * k + i, e)] * F[at(3 * k + j, e)]
        entry += R[at(3 * k + j, e)] * F[at(3 * k + i, e)]
    return 0.5 * entry - (1.0 if i == j else 0.0)


@njit(**KERNEL)
def element_stresses(x, tets, constants, la, mu, stresses):
    """Stress in the element's own frame, entries 00 11 22 01 02 12."""
    X, F, R = room(12), room(9), room(9)
    upright, change = room(1), room(1)
    for k in range(len(tets)):
        D = constants[k]
        gather(x, tets[k], X)
        deform(X, D, F)
        find_upright(D[VOLUMES], F, upright, R)
        rotate(R, change)
        for e in range(LANES):
            element = k * LANES + e
            s0, s1, s2 = strain(0, 0, F, R, e), strain(1, 1, F, R, e), strain(2, 2, F, R, e)
            pressure = la * (s0 + s1 + s2)
            stresses[element, 0] = pressure + 2.0 * mu * s0
            stresses[element, 1] = pressure + 2.0 * mu * s1
            stresses[element, 2] = pressure + 2.0 * mu * s2
            stresses[element, 3] = 2.0 * mu * strain(0, 1, F, R, e)
            stresses[element, 4] = 2.0 * mu * strain(0, 2, F, R, e)
            stresses[element, 5] = 2.0 * mu * strain(1, 2, F, R, e)


@njit(**KERNEL)
def average_at_nodes(tets, constants, stresses, node_stresses, node_volumes):
    """Mean stress of the elements around each node, by volume."""
    node_stresses[:] = 0.0
    node_volumes[:] = 0.0
    for k in range(len(tets)):
        for e in range(LANES):
            volume = constants[k][at(VOLUME, e)]
            for a in range(4):
                n = tets[k, a, e]
                node_volumes[n] += volume
                for i in range(6):
                    node_stresses[n, i] += volume * stresses[k * LANES + e, i]
    for n in range(len(node_volumes)):
        if node_volumes[n] > 0.0:
            for i in range(6):
                node_stresses[n, i] /= node_volumes[n]


@njit(**KERNEL)
def energy_density(s, la, mu):
    """σ : C⁻¹ : σ."""
    square = s[0] * s[0] + s[1] * s[1] + s[2] * s[2]
    square += 2.0 * (s[3] * s[3] + s[4] * s[4] + s[5] * s[5])
    trace = s[0] + s[1] + s[2]
    return (square - la / (3.0 * la + 2.0 * mu) * trace * trace) / (2.0 * mu)


@njit(**KERNEL)
def energy_error(tets, constants, la, mu, stresses, node_stresses):
    """∫ (σ* - σ):C⁻¹:(σ* - σ) over ∫ σ:C⁻¹:σ."""
    jump, whole = np.empty(6), np.empty(6)
    missing = total = body = 0.0
    for k in range(len(tets)):
        for e in range(LANES):
            stress = stresses[k * LANES + e]
            volume = constants[k][at(VOLUME, e)]
            whole[:] = 0.0
            # A linear field's square integrates to V/20 (Σ f_a² + (Σ f_a)²).
            for a in range(4):
                for i in range(6):
                    jump[i] = node_stresses[tets[k, a, e], i] - stress[i]
                    whole[i] += jump[i]
                missing += volume / 20.0 * energy_density(jump, la, mu)
            missing += volume / 20.0 * energy_density(whole, la, mu)
            total += volume * energy_density(stress, la, mu)
            body += volume
    return missing / total if total > NO_STRAIN**2 * mu * body else 0.0


def relative_energy_error(x, tets, constants, la: float, mu: float) -> float:
    """Estimate the share η² of the energy that a mesh of linear tetrahedra misses.

    Args:
        x: Node positions [m], shape (node_count, 3).
        tets: Nodes in batches, shape (batch_count, 4, LANES).
        constants: Gradients and volumes in batches, as the kernels take them.
        la: λ [Pa].
        mu: µ [Pa].

    Returns:
        η², zero for a body without stress.
    """
    stresses = np.empty((len(tets) * LANES, 6))
    node_stresses, node_volumes = np.empty((len(x), 6)), np.empty(len(x))
    element_stresses(x, tets, constants, la, mu, stresses)
    average_at_nodes(tets, constants, stresses, node_stresses, node_volumes)
    return float(energy_error(tets, constants, la, mu, stresses, node_stresses))
