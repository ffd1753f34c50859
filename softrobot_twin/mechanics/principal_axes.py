"""Singular values of F, and differentials of isotropic laws in the axes of their stretches.

F = U diag(λ) Vᵀ with rotations U and V; λ₁ ≥ λ₂ ≥ |λ₃|, and λ₃ is negative where F is inside out
(Irving et al. 2004). An isotropic law is a function ψ of λ, and with
dF̂ = Uᵀ dF V its differential has four independent parts (Smith et al. 2019):

    dP̂_ii = Σ_j ψ_ij dF̂_jj
    dP̂_ij = a_ij (dF̂_ij + dF̂_ji)/2 + b_ij (dF̂_ij - dF̂_ji)/2
    a_ij  = (ψ_i - ψ_j)/(λ_i - λ_j),    b_ij = (ψ_i + ψ_j)/(λ_i + λ_j)

It is positive semidefinite if and only if the 3×3 matrix ψ_ij is and no a_ij or b_ij is negative.
Pairs are in the order 23, 31, 12: pair k has the two axes other than k.

Arguments of the kernels here:
    A, diagonal: Entries 11, 22, 33, 23, 31, 12 of a symmetric matrix, six numbers.
    a, b: a_ij and b_ij of a pair [Pa].
    dF: Change of F, three rows of three numbers.
    first, second: dF̂_ij and dF̂_ji.
    p, q: Numbers of two eigenvalues that are neighbours, p < q.
    U, V: Matrices, three rows of three numbers.
    rows: Ten rows of three numbers.
    spins, twists, v, values: Three numbers.
"""

from __future__ import annotations

import math

from softrobot_twin.geometry.matrix3 import (
    IDENTITY,
    add_outer,
    product,
    product_transposed,
    transform,
    transposed,
    transposed_product,
)
from softrobot_twin.geometry.vector3 import add_scaled, cross, dot, scaled
from softrobot_twin.kernels.compilation import INLINED, KERNEL, ONCE, njit

# Sweeps of Jacobi's method for a 3×3 matrix; it converges quadratically, mostly within four.
MOST_SWEEPS = 12
# Square of a direction below which, by the largest stretch, it says nothing.
NO_DIRECTION = 1.0e-24


@njit(**INLINED)
def turned_pair(A, V, p, q):
    """One rotation of Jacobi that makes entry pq of a symmetric matrix zero.

    Args:
        A: The matrix, as a list of its six entries 11, 22, 33, 23, 31, 12.
        V: Its axes so far, three columns.
        p, q: The pair; 3 - p - q is the third axis.
    """
    k = 3 - p - q
    off = A[3 + k]
    if off == 0.0:
        return A, V
    theta = 0.5 * (A[q] - A[p]) / off
    t = 1.0 / (abs(theta) + math.sqrt(theta * theta + 1.0))
    t = -t if theta < 0.0 else t
    c = 1.0 / math.sqrt(t * t + 1.0)
    s = t * c
    to_p, to_q = A[3 + q], A[3 + p]  # Entries pk and qk.
    with_p, with_q = c * to_p - s * to_q, s * to_p + c * to_q
    column_p = add_scaled(scaled(V[p], c), V[q], -s)
    column_q = add_scaled(scaled(V[p], s), V[q], c)
    at_p, at_q = A[p] - t * off, A[q] + t * off
    if k == 0:
        return (A[0], at_p, at_q, 0.0, with_q, with_p), (V[0], column_p, column_q)
    if k == 1:
        return (at_q, A[1], at_p, with_p, 0.0, with_q), (column_q, V[1], column_p)
    return (at_p, at_q, A[2], with_q, with_p, 0.0), (column_p, column_q, V[2])


@njit(**KERNEL)
def symmetric_eigenvalues(A):
    """Eigenvalues of a symmetric matrix and its axes, a rotation, by Jacobi's method.

    Args:
        A: Entries 11, 22, 33, 23, 31, 12.

    Returns:
        The eigenvalues in no order, and the axes as three rows.
    """
    V = IDENTITY
    for _ in range(MOST_SWEEPS):
        off = A[3] * A[3] + A[4] * A[4] + A[5] * A[5]
        if not off > 1.0e-36 * (A[0] * A[0] + A[1] * A[1] + A[2] * A[2]):
            break
        A, V = turned_pair(A, V, 0, 1)
        A, V = turned_pair(A, V, 2, 0)
        A, V = turned_pair(A, V, 1, 2)
    return (A[0], A[1], A[2]), V


@njit(**INLINED)
def swapped_if_smaller(values, V, p, q):
    """Sorts two eigenvalues; the axes stay a rotation."""
    if values[p] >= values[q]:
        return values, V
    if q == 1:
        return (values[1], values[0], values[2]), (V[1], scaled(V[0], -1.0), V[2])
    return (values[0], values[2], values[1]), (V[0], V[2], scaled(V[1], -1.0))


@njit(**ONCE)
def perpendicular(v):
    """A unit vector at a right angle to a unit vector."""
    x, y, z = abs(v[0]), abs(v[1]), abs(v[2])
    if x <= y and x <= z:
        other = cross(v, (1.0, 0.0, 0.0))
    elif y <= z:
        other = cross(v, (0.0, 1.0, 0.0))
    else:
        other = cross(v, (0.0, 0.0, 1.0))
    return scaled(other, 1.0 / math.sqrt(dot(other, other)))


@njit(**KERNEL)
def principal_axes(F):
    """U, λ and V of F = U diag(λ) Vᵀ.

    Returns:
        The axes U as three rows, the stretches, and the axes V as three rows: row i belongs to λ_i.
    """
    C = transposed_product(F, F)
    values, V = symmetric_eigenvalues((C[0][0], C[1][1], C[2][2], C[1][2], C[0][2], C[0][1]))
    values, V = swapped_if_smaller(values, V, 0, 1)
    values, V = swapped_if_smaller(values, V, 1, 2)
    values, V = swapped_if_smaller(values, V, 0, 1)
    first, second = transform(F, V[0]), transform(F, V[1])
    square = dot(first, first)
    if not square > 0.0:
        return IDENTITY, (0.0, 0.0, 0.0), V
    along = math.sqrt(square)
    u = scaled(first, 1.0 / along)
    across = add_scaled(second, u, -dot(u, second))
    if dot(across, across) > NO_DIRECTION * square:
        across = scaled(across, 1.0 / math.sqrt(dot(across, across)))
    else:
        across = perpendicular(u)
    third = cross(u, across)
    return (u, across, third), (along, dot(across, second), dot(third, transform(F, V[2]))), V


@njit(**INLINED)
def principal_rows(U, V, diagonal, twists, spins, projected):
    """The rows of `principal_differential`.

    Args:
        U, V: Of `principal_axes`.
        diagonal: ψ_ij: entries 11, 22, 33, 23, 31, 12 [Pa].
        twists: a of the pairs 23, 31, 12 [Pa].
        spins: b of them [Pa].
        projected: True for the nearest positive semidefinite differential.
    """
    if projected:
        diagonal = positive_part(diagonal)
        twists = (max(twists[0], 0.0), max(twists[1], 0.0), max(twists[2], 0.0))
        spins = (max(spins[0], 0.0), max(spins[1], 0.0), max(spins[2], 0.0))
    return (
        U[0], U[1], U[2], V[0], V[1], V[2], (diagonal[0], diagonal[1], diagonal[2]),
        (diagonal[3], diagonal[4], diagonal[5]), twists, spins,
    )  # fmt: skip


@njit(**INLINED)
def is_positive(A):
    """Whether a symmetric matrix of entries 11, 22, 33, 23, 31, 12 has no negative eigenvalue."""
    minor = A[0] * A[1] - A[5] * A[5]
    third = A[2] * minor - A[0] * A[3] * A[3] - A[1] * A[4] * A[4] + 2.0 * A[3] * A[4] * A[5]
    return A[0] > 0.0 and minor > 0.0 and third > 0.0


@njit(**KERNEL, inline="always")
def positive_part(A):
    """The positive semidefinite matrix nearest to a symmetric one; itself where it is positive."""
    if is_positive(A):
        return A
    values, V = symmetric_eigenvalues(A)
    B = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    for k in range(3):
        B = add_outer(B, scaled(V[k], max(values[k], 0.0)), V[k])
    return (B[0][0], B[1][1], B[2][2], B[1][2], B[0][2], B[0][1])


@njit(**INLINED)
def principal_differential(rows, dF):
    """dP [Pa] of the rows of `principal_rows`."""
    U, V = (rows[0], rows[1], rows[2]), (rows[3], rows[4], rows[5])
    H, off, a, b = rows[6], rows[7], rows[8], rows[9]
    D = product(U, product_transposed(dF, V))
    d = (D[0][0], D[1][1], D[2][2])
    yz, zy = pair_change(a[0], b[0], D[1][2], D[2][1])
    zx, xz = pair_change(a[1], b[1], D[2][0], D[0][2])
    xy, yx = pair_change(a[2], b[2], D[0][1], D[1][0])
    dP = (
        (H[0] * d[0] + off[2] * d[1] + off[1] * d[2], xy, xz),
        (yx, off[2] * d[0] + H[1] * d[1] + off[0] * d[2], yz),
        (zx, zy, off[1] * d[0] + off[0] * d[1] + H[2] * d[2]),
    )
    return product(transposed(U), product(dP, V))


@njit(**INLINED)
def pair_change(a, b, first, second):
    """dP̂_ij and dP̂_ji of dF̂_ij and dF̂_ji."""
    even, odd = 0.5 * a * (first + second), 0.5 * b * (first - second)
    return even + odd, even - odd
