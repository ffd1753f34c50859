"""The arithmetic of corotational quadratic tetrahedra, many elements side by side: see `lanes.py`.

The arithmetic at one quadrature point is the linear tetrahedron's, so what does not depend on the
number of nodes is shared with `corotational_kernels.py`. What is computed is said in
`quadratic_tets.py`.
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
from softrobot_twin.mechanics.polar import FLAT, find_upright, rotate
from softrobot_twin.mechanics.quadratic_folds import find_folds, mark_surely_upright
from softrobot_twin.mechanics.quadratic_gradients import FAR

NODES, POINTS = 10, 4
# Entries of a batch's constants: thirty of each point's gradients ∇N_a, then the volume that each
# point stands for.
GRADIENTS = 3 * NODES
WEIGHT = POINTS * GRADIENTS
CONSTANT_COUNT = WEIGHT + 1
WEIGHTS = slice(WEIGHT * LANES, CONSTANT_COUNT * LANES)


@njit(**KERNEL)
def scale_column(b, weights, la, mu, g, S):
    """V λ g_b, then 2 V µ g_b: what every block of column b needs."""
    column = g[at(3 * b, 0) : at(3 * b + 3, 0)]
    for i in range(3):
        for e in range(LANES):
            S[at(i, e)] = la * weights[e] * column[at(i, e)]
        for e in range(LANES):
            S[at(3 + i, e)] = 2.0 * mu * weights[e] * column[at(i, e)]


@njit(**KERNEL)
def add_stiffness_block(a, g, S, Q, K):
    """Add V (λ g_a g_bᵀ + 2µ (g_a·g_b) 1) + [g_a]× Q at one point to K_ab, column by column."""
    row = g[at(3 * a, 0) : at(3 * a + 3, 0)]
    for e in range(LANES):
        x, y, z = row[at(0, e)], row[at(1, e)], row[at(2, e)]
        u, v, w = S[at(0, e)], S[at(1, e)], S[at(2, e)]
        dot = x * S[at(3, e)] + y * S[at(4, e)] + z * S[at(5, e)]
        K[at(0, e)] += x * u + y * Q[at(6, e)] - z * Q[at(3, e)] + dot
        K[at(1, e)] += y * u + z * Q[at(0, e)] - x * Q[at(6, e)]
        K[at(2, e)] += z * u + x * Q[at(3, e)] - y * Q[at(0, e)]
        K[at(3, e)] += x * v + y * Q[at(7, e)] - z * Q[at(4, e)]
        K[at(4, e)] += y * v + z * Q[at(1, e)] - x * Q[at(7, e)] + dot
        K[at(5, e)] += z * v + x * Q[at(4, e)] - y * Q[at(1, e)]
        K[at(6, e)] += x * w + y * Q[at(8, e)] - z * Q[at(5, e)]
        K[at(7, e)] += y * w + z * Q[at(2, e)] - x * Q[at(8, e)]
        K[at(8, e)] += z * w + x * Q[at(5, e)] - y * Q[at(2, e)] + dot


@njit(**KERNEL)
def find_flat_anywhere(F, R, upright, corners, sure):
    """Mark the elements that are flat or inside out at a corner, or anywhere between.

    F varies linearly, so its values at the four points tell those at the corners, and those tell
    what is between: see `quadratic_folds.py`. R is a rotation of the element at one point.
    """
    sure[:] = upright
    for q in range(POINTS):
        corner = corners[q]
        for i in range(9):
            for e in range(LANES):
                mean = F[0, at(i, e)] + F[1, at(i, e)] + F[2, at(i, e)] + F[3, at(i, e)]
                corner[at(i, e)] = (F[q, at(i, e)] - FAR * mean) / (1.0 - 4.0 * FAR)
        for e in range(LANES):
            a, b, c = corner[at(0, e)], corner[at(1, e)], corner[at(2, e)]
            d, f, g = corner[at(3, e)], corner[at(4, e)], corner[at(5, e)]
            h, i, j = corner[at(6, e)], corner[at(7, e)], corner[at(8, e)]
            square = a * a + b * b + c * c + d * d + f * f + g * g + h * h + i * i + j * j
            det = a * (f * j - g * i) + b * (g * h - d * j) + c * (d * i - f * h)
            upright[e] = upright[e] if det > FLAT * square * np.sqrt(square) else 0.0
        mark_surely_upright(corner, R, sure)
    find_folds(corners, sure, upright)


@njit(**KERNEL)
def count_flat(weights, lowest):
    """Elements of the batch that are not upright everywhere."""
    count = 0
    for e in range(LANES):
        count += weights[e] > 0.0 and lowest[e] == 0.0
    return count


@njit(**KERNEL)
def add_all_forces(x, tets, free, constants, la, mu, rotations, uprights, forces):
    """Internal forces of all batches; gives the number of flat or inverted elements.

    Leaves the rotations, and which points are upright, to `add_all` at the same state.
    """
    X, P, g = room(GRADIENTS), room(GRADIENTS), room(GRADIENTS)
    F, corners = np.empty((POINTS, 9 * LANES)), np.empty((POINTS, 9 * LANES))
    c, change, lowest, sure = room(1), room(1), room(1), room(1)
    flat_count = 0
    for k in range(len(tets)):
        D = constants[k]
        weights = D[WEIGHTS]
        gather(x, tets[k], X)
        P[:] = 0.0
        lowest[:] = 1.0
        for q in range(POINTS):
            G = D[at(q * GRADIENTS, 0) : at((q + 1) * GRADIENTS, 0)]
            R, upright = rotations[k, q], uprights[k, q]
            deform(X, G, F[q])
            find_upright(weights, F[q], upright, R)
            rotate(R, change)
            volume_change(la, mu, F[q], R, c)
            turn_gradients(G, R, g)
            add_stresses(G, mu, F[q], c, g, P)
            for e in range(LANES):
                lowest[e] = min(lowest[e], upright[e])
        find_flat_anywhere(F, rotations[k, 0], lowest, corners, sure)
        subtract_forces(free[k], weights, P, forces)
        flat_count += count_flat(weights, lowest)
    return flat_count


@njit(**KERNEL)
def add_all(
    x, tets, free, constants, la, mu, projected, are_known, rotations, uprights, offsets, strides,
    forces, storage,
):  # fmt: skip
    """Stiffness of all batches; forces and rotations too, unless they are known."""
    X, P = room(GRADIENTS), room(GRADIENTS)
    F, c, change = room(9), room(1), room(1)
    # What each point keeps until the blocks are summed.
    g, M = np.empty((POINTS, GRADIENTS * LANES)), np.empty((POINTS, 6 * LANES))
    Q, S, K = np.empty((POINTS, 9 * LANES)), np.empty((POINTS, 6 * LANES)), room(9)
    for k in range(len(tets)):
        D = constants[k]
        weights = D[WEIGHTS]
        gather(x, tets[k], X)
        P[:] = 0.0
        for q in range(POINTS):
            G = D[at(q * GRADIENTS, 0) : at((q + 1) * GRADIENTS, 0)]
            R, upright = rotations[k, q], uprights[k, q]
            deform(X, G, F)
            if not are_known:
                find_upright(weights, F, upright, R)
                rotate(R, change)
            volume_change(la, mu, F, R, c)
            turn_gradients(G, R, g[q])
            if not are_known:
                add_stresses(G, mu, F, c, g[q], P)
            spin_stiffness(weights, mu, projected, F, R, c, upright, M[q])
        if not are_known:
            subtract_forces(free[k], weights, P, forces)
        pair = 0
        for b in range(NODES):
            for q in range(POINTS):
                spin_columns(b, g[q], M[q], Q[q])
                scale_column(b, weights, la, mu, g[q], S[q])
            for a in range(b, NODES):
                K[:] = 0.0
                for q in range(POINTS):
                    add_stiffness_block(a, g[q], S[q], Q[q], K)
                add_block(offsets[k, pair], strides[k, pair], K, storage)
                pair += 1
