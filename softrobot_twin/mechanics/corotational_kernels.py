"""The arithmetic of corotational tetrahedra, many elements side by side: see `lanes.py`.

Only reading positions and adding results go element by element. What is computed is said in
`corotational.py`.
"""

from __future__ import annotations

from numba import njit

from softrobot_twin.mechanics.gradient_kernels import (
    add_stresses,
    deform,
    gather,
    subtract_forces,
    turn_gradients,
)
from softrobot_twin.mechanics.lanes import KERNEL, LANES, at, room
from softrobot_twin.mechanics.polar import find_upright, rotate

# Entries of a batch's constants D: twelve of the gradients ∇N_a, then the volume.
VOLUME = 12
CONSTANT_COUNT = 13
VOLUMES = slice(VOLUME * LANES, CONSTANT_COUNT * LANES)


@njit(**KERNEL)
def volume_change(la, mu, F, R, c):
    """c = 2µ - λ tr(RᵀF - 1)."""
    for e in range(LANES):
        trace = R[at(0, e)] * F[at(0, e)] + R[at(1, e)] * F[at(1, e)] + R[at(2, e)] * F[at(2, e)]
        trace += R[at(3, e)] * F[at(3, e)] + R[at(4, e)] * F[at(4, e)] + R[at(5, e)] * F[at(5, e)]
        trace += R[at(6, e)] * F[at(6, e)] + R[at(7, e)] * F[at(7, e)] + R[at(8, e)] * F[at(8, e)]
        c[e] = 2.0 * mu - la * (trace - 3.0)


@njit(**KERNEL)
def spin_stiffness(volumes, mu, projected, F, R, c, upright, M):
    """M = V c (tr(U) 1 - U)⁻¹ with the left stretch U = F Rᵀ: how turning changes the stress.

    Entries 00 11 22 01 02 12. An element's tangent is positive semi-definite just when
    c (tr(U) 1 - U)⁻¹ is at most µ. Where it is not and `projected` asks for it, or where the
    element is flat, µ stands in its place.
    """
    for e in range(LANES):
        a, b, d = R[at(0, e)], R[at(1, e)], R[at(2, e)]
        f, g, h = R[at(3, e)], R[at(4, e)], R[at(5, e)]
        i, j, k = R[at(6, e)], R[at(7, e)], R[at(8, e)]
        u00 = F[at(0, e)] * a + F[at(1, e)] * b + F[at(2, e)] * d
        u01 = F[at(0, e)] * f + F[at(1, e)] * g + F[at(2, e)] * h
        u02 = F[at(0, e)] * i + F[at(1, e)] * j + F[at(2, e)] * k
        u11 = F[at(3, e)] * f + F[at(4, e)] * g + F[at(5, e)] * h
        u12 = F[at(3, e)] * i + F[at(4, e)] * j + F[at(5, e)] * k
        u22 = F[at(6, e)] * i + F[at(7, e)] * j + F[at(8, e)] * k
        g00, g11, g22 = u11 + u22, u00 + u22, u00 + u11
        k00, k01, k02 = g11 * g22 - u12 * u12, u02 * u12 + u01 * g22, u01 * u12 + u02 * g11
        det = g00 * k00 - u01 * k01 - u02 * k02
        # Sylvester: is tr(U) 1 - U at least c/µ?
        bound = c[e] / mu
        p00, p11, p22 = g00 - bound, g11 - bound, g22 - bound
        minor = p00 * p11 - u01 * u01
        third = p00 * (p11 * p22 - u12 * u12) - u01 * (u01 * p22 + u12 * u02)
        third -= u02 * (u01 * u12 + p11 * u02)
        dominates = p00 > 0.0 and minor > 0.0 and third > 0.0
        exact = upright[e] > 0.0 and (dominates or not projected)
        scale = volumes[e] * c[e] / det if exact else 0.0
        stand_in = 0.0 if exact else volumes[e] * mu
        M[at(0, e)] = stand_in + scale * k00
        M[at(1, e)] = stand_in + scale * (g00 * g22 - u02 * u02)
        M[at(2, e)] = stand_in + scale * (g00 * g11 - u01 * u01)
        M[at(3, e)] = scale * k01
        M[at(4, e)] = scale * k02
        M[at(5, e)] = scale * (u01 * u02 + g00 * u12)


@njit(**KERNEL)
def spin_columns(b, g, M, Q):
    """Q = M [g_b]×."""
    for e in range(LANES):
        x, y, z = g[at(3 * b, e)], g[at(3 * b + 1, e)], g[at(3 * b + 2, e)]
        m00, m11, m22 = M[at(0, e)], M[at(1, e)], M[at(2, e)]
        m01, m02, m12 = M[at(3, e)], M[at(4, e)], M[at(5, e)]
        Q[at(0, e)] = m01 * z - m02 * y
        Q[at(1, e)] = m02 * x - m00 * z
        Q[at(2, e)] = m00 * y - m01 * x
        Q[at(3, e)] = m11 * z - m12 * y
        Q[at(4, e)] = m12 * x - m01 * z
        Q[at(5, e)] = m01 * y - m11 * x
        Q[at(6, e)] = m12 * z - m22 * y
        Q[at(7, e)] = m22 * x - m02 * z
        Q[at(8, e)] = m02 * y - m12 * x


@njit(**KERNEL)
def stiffness_block(a, b, D, la, mu, g, Q, K):
    """K_ab = V (λ g_a g_bᵀ + 2µ (g_a·g_b) 1) + [g_a]× Q, column by column."""
    for e in range(LANES):
        x, y, z = g[at(3 * a, e)], g[at(3 * a + 1, e)], g[at(3 * a + 2, e)]
        u, v, w = g[at(3 * b, e)], g[at(3 * b + 1, e)], g[at(3 * b + 2, e)]
        volume = D[at(VOLUME, e)]
        dot = 2.0 * mu * volume * (x * u + y * v + z * w)
        u, v, w = la * volume * u, la * volume * v, la * volume * w
        K[at(0, e)] = x * u + y * Q[at(6, e)] - z * Q[at(3, e)] + dot
        K[at(1, e)] = y * u + z * Q[at(0, e)] - x * Q[at(6, e)]
        K[at(2, e)] = z * u + x * Q[at(3, e)] - y * Q[at(0, e)]
        K[at(3, e)] = x * v + y * Q[at(7, e)] - z * Q[at(4, e)]
        K[at(4, e)] = y * v + z * Q[at(1, e)] - x * Q[at(7, e)] + dot
        K[at(5, e)] = z * v + x * Q[at(4, e)] - y * Q[at(1, e)]
        K[at(6, e)] = x * w + y * Q[at(8, e)] - z * Q[at(5, e)]
        K[at(7, e)] = y * w + z * Q[at(2, e)] - x * Q[at(8, e)]
        K[at(8, e)] = z * w + x * Q[at(5, e)] - y * Q[at(2, e)] + dot


@njit(**KERNEL)
def add_block(offsets, strides, K, storage):
    """Add each element's block where it belongs."""
    for e in range(LANES):
        o = offsets[e]
        if o >= 0:
            for j in range(3):
                storage[o] += K[at(3 * j, e)]
                storage[o + 1] += K[at(3 * j + 1, e)]
                storage[o + 2] += K[at(3 * j + 2, e)]
                o += strides[e]


@njit(**KERNEL)
def add_all_forces(x, tets, free, constants, la, mu, rotations, uprights, forces):
    """Internal forces of all batches; gives the number of flat or inverted elements.

    Leaves the rotations, and which elements are upright, to `add_all` at the same state.
    """
    X, F, c, g, P, change = room(12), room(9), room(1), room(12), room(12), room(1)
    flat_count = 0
    for k in range(len(tets)):
        D, R, upright = constants[k], rotations[k, 0], uprights[k, 0]
        gather(x, tets[k], X)
        deform(X, D, F)
        flat_count += find_upright(D[VOLUMES], F, upright, R)
        rotate(R, change)
        volume_change(la, mu, F, R, c)
        turn_gradients(D, R, g)
        P[:] = 0.0
        add_stresses(D, mu, F, c, g, P)
        subtract_forces(free[k], D[VOLUMES], P, forces)
    return flat_count


@njit(**KERNEL)
def add_all(
    x, tets, free, constants, la, mu, projected, are_known, rotations, uprights, offsets, strides,
    forces, storage,
):  # fmt: skip
    """Stiffness of all batches; forces and rotations too, unless they are known."""
    X, F, c, g, P, change = room(12), room(9), room(1), room(12), room(12), room(1)
    M, Q, K = room(6), room(9), room(9)
    for k in range(len(tets)):
        D, R, upright = constants[k], rotations[k, 0], uprights[k, 0]
        gather(x, tets[k], X)
        deform(X, D, F)
        if not are_known:
            find_upright(D[VOLUMES], F, upright, R)
            rotate(R, change)
        volume_change(la, mu, F, R, c)
        turn_gradients(D, R, g)
        if not are_known:
            P[:] = 0.0
            add_stresses(D, mu, F, c, g, P)
            subtract_forces(free[k], D[VOLUMES], P, forces)
        spin_stiffness(D[VOLUMES], mu, projected, F, R, c, upright, M)
        pair = 0
        for b in range(4):
            spin_columns(b, g, M, Q)
            for a in range(b, 4):
                stiffness_block(a, b, D, la, mu, g, Q, K)
                add_block(offsets[k, pair], strides[k, pair], K, storage)
                pair += 1
