"""The arithmetic of strain-rate damping, many elements side by side: see `lanes.py`.

How many nodes and quadrature points an element has is told by its arrays. What is computed is said
in `strain_rate_damping.py`.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from softrobot_twin.mechanics.corotational_kernels import add_block
from softrobot_twin.mechanics.gradient_kernels import (
    deform,
    gather,
    subtract_forces,
    turn_gradients,
)
from softrobot_twin.mechanics.lanes import KERNEL, LANES, at, room
from softrobot_twin.mechanics.polar import turn_flat

# An element counts as flat where ‖F₀⁻¹‖ is beyond this: pressed to about a tenth of its thickness.
# Viscosity grows with the square, so it bounds what a crushed element adds to the matrix.
THINNEST = 10.0


@njit(**KERNEL)
def invert_transposed(F, T, thin):
    """T = F⁻ᵀ, and the rotation of elements that are flat."""
    for e in range(LANES):
        a, b, c = F[at(0, e)], F[at(1, e)], F[at(2, e)]
        d, f, g = F[at(3, e)], F[at(4, e)], F[at(5, e)]
        h, i, j = F[at(6, e)], F[at(7, e)], F[at(8, e)]
        c00, c01, c02 = f * j - g * i, g * h - d * j, d * i - f * h
        c10, c11, c12 = c * i - b * j, a * j - c * h, b * h - a * i
        c20, c21, c22 = b * g - c * f, c * d - a * g, a * f - b * d
        det = a * c00 + b * c01 + c * c02
        square = (
            c00 * c00 + c01 * c01 + c02 * c02
            + c10 * c10 + c11 * c11 + c12 * c12
            + c20 * c20 + c21 * c21 + c22 * c22
        )  # fmt: skip
        # The square alone would let all zeros through; what is not a number is thin too.
        thick = det != 0.0 and square <= (THINNEST * det) ** 2
        thin[e] = 0.0 if thick else 1.0
        s = 1.0 / det if thick else 0.0
        T[at(0, e)], T[at(1, e)], T[at(2, e)] = s * c00, s * c01, s * c02
        T[at(3, e)], T[at(4, e)], T[at(5, e)] = s * c10, s * c11, s * c12
        T[at(6, e)], T[at(7, e)], T[at(8, e)] = s * c20, s * c21, s * c22
    for e in range(LANES):
        if thin[e] > 0.0:
            turn_flat(F, T, e)


@njit(**KERNEL)
def scale_gradients(shares, g):
    """Multiply each element's gradients by its share."""
    for i in range(len(g) // LANES):
        for e in range(LANES):
            g[at(i, e)] *= shares[e]


@njit(**KERNEL)
def begin_all(x, tets, constants, rate, start, gradients):
    """Keep where the nodes are, and √(V β/h) F₀⁻ᵀ ∇N_a at each point; rate is β/h."""
    F, T, thin, shares = room(9), room(9), room(1), room(1)
    point_count, width = gradients.shape[1], 3 * tets.shape[1]
    for k in range(len(tets)):
        D = constants[k]
        for e in range(LANES):
            shares[e] = np.sqrt(rate * D[at(point_count * width, e)])
        gather(x, tets[k], start[k])
        for q in range(point_count):
            G = D[at(q * width, 0) : at((q + 1) * width, 0)]
            deform(start[k], G, F)
            invert_transposed(F, T, thin)
            turn_gradients(G, T, gradients[k, q])
            scale_gradients(shares, gradients[k, q])


@njit(**KERNEL)
def gather_moves(x, tets, start, U):
    """How far the elements' nodes have moved in the step."""
    for a in range(len(tets)):
        node = U[at(3 * a, 0) : at(3 * a + 3, 0)]
        before = start[at(3 * a, 0) : at(3 * a + 3, 0)]
        for e in range(LANES):
            n = tets[a, e]
            node[at(0, e)] = x[n, 0] - before[at(0, e)]
            node[at(1, e)] = x[n, 1] - before[at(1, e)]
            node[at(2, e)] = x[n, 2] - before[at(2, e)]


@njit(**KERNEL)
def viscous_stress(la, mu, D, S):
    """S = λ tr(D) 1 + µ (D + Dᵀ), entries 00 11 22 01 02 12."""
    for e in range(LANES):
        d0, d1, d2 = D[at(0, e)], D[at(4, e)], D[at(8, e)]
        pressure = la * (d0 + d1 + d2)
        S[at(0, e)] = pressure + 2.0 * mu * d0
        S[at(1, e)] = pressure + 2.0 * mu * d1
        S[at(2, e)] = pressure + 2.0 * mu * d2
        S[at(3, e)] = mu * (D[at(1, e)] + D[at(3, e)])
        S[at(4, e)] = mu * (D[at(2, e)] + D[at(6, e)])
        S[at(5, e)] = mu * (D[at(5, e)] + D[at(7, e)])


@njit(**KERNEL)
def add_tractions(S, g, P):
    """Add S g_a at one point to each node's sum."""
    for a in range(len(g) // (3 * LANES)):
        gradient = g[at(3 * a, 0) : at(3 * a + 3, 0)]
        node = P[at(3 * a, 0) : at(3 * a + 3, 0)]
        for e in range(LANES):
            x, y, z = gradient[at(0, e)], gradient[at(1, e)], gradient[at(2, e)]
            node[at(0, e)] += S[at(0, e)] * x + S[at(3, e)] * y + S[at(4, e)] * z
            node[at(1, e)] += S[at(3, e)] * x + S[at(1, e)] * y + S[at(5, e)] * z
            node[at(2, e)] += S[at(4, e)] * x + S[at(5, e)] * y + S[at(2, e)] * z


@njit(**KERNEL)
def add_all_forces(x, tets, free, start, gradients, la, mu, forces):
    """Damping forces of all batches."""
    width = 3 * tets.shape[1]
    U, P, D, S, ones = room(width), room(width), room(9), room(6), room(1)
    ones[:] = 1.0
    for k in range(len(tets)):
        gather_moves(x, tets[k], start[k], U)
        P[:] = 0.0
        for q in range(gradients.shape[1]):
            deform(U, gradients[k, q], D)
            viscous_stress(la, mu, D, S)
            add_tractions(S, gradients[k, q], P)
        subtract_forces(free[k], ones, P, forces)


@njit(**KERNEL)
def add_viscous_block(a, b, la, mu, g, K):
    """Add λ g_a g_bᵀ + µ g_b g_aᵀ + µ (g_a·g_b) 1 at one point to K_ab, column by column."""
    row = g[at(3 * a, 0) : at(3 * a + 3, 0)]
    column = g[at(3 * b, 0) : at(3 * b + 3, 0)]
    for e in range(LANES):
        x, y, z = row[at(0, e)], row[at(1, e)], row[at(2, e)]
        u, v, w = column[at(0, e)], column[at(1, e)], column[at(2, e)]
        lu, lv, lw = la * u, la * v, la * w
        mu_u, mu_v, mu_w = mu * u, mu * v, mu * w
        dot = x * mu_u + y * mu_v + z * mu_w
        K[at(0, e)] += x * lu + mu_u * x + dot
        K[at(1, e)] += y * lu + mu_v * x
        K[at(2, e)] += z * lu + mu_w * x
        K[at(3, e)] += x * lv + mu_u * y
        K[at(4, e)] += y * lv + mu_v * y + dot
        K[at(5, e)] += z * lv + mu_w * y
        K[at(6, e)] += x * lw + mu_u * z
        K[at(7, e)] += y * lw + mu_v * z
        K[at(8, e)] += z * lw + mu_w * z + dot


@njit(**KERNEL)
def add_all_stiffness(gradients, la, mu, offsets, strides, storage):
    """Stiffness of all batches; it does not change within a step."""
    K = room(9)
    node_count = gradients.shape[2] // (3 * LANES)
    for k in range(len(gradients)):
        pair = 0
        for b in range(node_count):
            for a in range(b, node_count):
                K[:] = 0.0
                for q in range(gradients.shape[1]):
                    add_viscous_block(a, b, la, mu, gradients[k, q], K)
                add_block(offsets[k, pair], strides[k, pair], K, storage)
                pair += 1
