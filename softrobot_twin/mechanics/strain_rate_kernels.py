"""The arithmetic of strain-rate damping, many elements side by side: see `lanes.py`.

At one point it is the corotational law's, with other gradients and weights: what does not depend
on the number of nodes is shared with `corotational_kernels.py` and `quadratic_kernels.py`. How
many nodes and quadrature points an element has is told by its arrays. What is computed is said in
`strain_rate_damping.py`.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from softrobot_twin.mechanics.corotational_kernels import (
    add_block,
    spin_columns,
    spin_stiffness,
    volume_change,
)
from softrobot_twin.mechanics.gradient_kernels import (
    add_stresses,
    deform,
    gather,
    subtract_forces,
    turn_gradients,
)
from softrobot_twin.mechanics.lanes import KERNEL, LANES, at, room
from softrobot_twin.mechanics.polar import find_upright, rotate, turn_flat
from softrobot_twin.mechanics.quadratic_kernels import add_stiffness_block, scale_column

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
def begin_all(x, tets, constants, rate, start, gradients, weights):
    """Keep where the nodes are, g_a = F₀⁻ᵀ ∇N_a at each point, and V β/h; rate is β/h."""
    F, T, thin = room(9), room(9), room(1)
    point_count, width = gradients.shape[1], 3 * tets.shape[1]
    for k in range(len(tets)):
        D = constants[k]
        for e in range(LANES):
            weights[k, e] = rate * D[at(point_count * width, e)]
        gather(x, tets[k], start[k])
        for q in range(point_count):
            G = D[at(q * width, 0) : at((q + 1) * width, 0)]
            deform(start[k], G, F)
            invert_transposed(F, T, thin)
            turn_gradients(G, T, gradients[k, q])


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
def deform_further(U, g, F):
    """F = 1 + Σ u_a g_aᵀ at one point: the deformation in the step."""
    deform(U, g, F)
    for e in range(LANES):
        F[at(0, e)] += 1.0
        F[at(4, e)] += 1.0
        F[at(8, e)] += 1.0


@njit(**KERNEL)
def turn_with_step(weights, mu, la, g, U, F, R, upright, change, c, turned):
    """F and its rotation R at one point, c = 2µ - λ tr(RᵀF - 1), and R g_a."""
    deform_further(U, g, F)
    find_upright(weights, F, upright, R)
    rotate(R, change)
    volume_change(la, mu, F, R, c)
    turn_gradients(g, R, turned)


@njit(**KERNEL)
def add_all_forces(x, tets, free, start, gradients, weights, la, mu, forces):
    """Damping forces of all batches."""
    width = 3 * tets.shape[1]
    U, P, turned, F, R = room(width), room(width), room(width), room(9), room(9)
    upright, change, c = room(1), room(1), room(1)
    for k in range(len(tets)):
        gather_moves(x, tets[k], start[k], U)
        P[:] = 0.0
        for q in range(gradients.shape[1]):
            g = gradients[k, q]
            turn_with_step(weights[k], mu, la, g, U, F, R, upright, change, c, turned)
            add_stresses(g, mu, F, c, turned, P)
        subtract_forces(free[k], weights[k], P, forces)


@njit(**KERNEL)
def add_all(
    x, tets, free, start, gradients, weights, la, mu, projected, offsets, strides, forces, storage
):
    """Damping forces and their stiffness, of all batches."""
    point_count, node_count = gradients.shape[1], tets.shape[1]
    width = 3 * node_count
    U, P, F, R, K = room(width), room(width), room(9), room(9), room(9)
    upright, change, c = room(1), room(1), room(1)
    # What each point keeps until the blocks are summed.
    turned, M = np.empty((point_count, width * LANES)), np.empty((point_count, 6 * LANES))
    Q, S = np.empty((point_count, 9 * LANES)), np.empty((point_count, 6 * LANES))
    for k in range(len(tets)):
        gather_moves(x, tets[k], start[k], U)
        P[:] = 0.0
        for q in range(point_count):
            g = gradients[k, q]
            turn_with_step(weights[k], mu, la, g, U, F, R, upright, change, c, turned[q])
            add_stresses(g, mu, F, c, turned[q], P)
            spin_stiffness(weights[k], mu, projected, F, R, c, upright, M[q])
        subtract_forces(free[k], weights[k], P, forces)
        pair = 0
        for b in range(node_count):
            for q in range(point_count):
                spin_columns(b, turned[q], M[q], Q[q])
                scale_column(b, weights[k], la, mu, turned[q], S[q])
            for a in range(b, node_count):
                K[:] = 0.0
                for q in range(point_count):
                    add_stiffness_block(a, turned[q], S[q], Q[q], K)
                add_block(offsets[k, pair], strides[k, pair], K, storage)
                pair += 1
