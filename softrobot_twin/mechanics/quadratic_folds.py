"""Where quadratic tetrahedra fold: proof that det F is positive everywhere in an element.

F varies linearly in an element, F = Σ L_i F_i with the F_i of its corners, and so det F is a cubic
polynomial. An element can be upright at all corners and quadrature points and yet be inside out
between them. Two proofs that it is not:

- If one rotation R makes the symmetric part of RᵀF_i positive definite at all corners, so it is at
  all points between, which are their means; and then det F > 0. Nearly every element passes, and
  it costs little.
- A cubic polynomial is at least the least of its twenty Bernstein coefficients, which for corners
  i, j, k are the mixed determinants of F_i, F_j, F_k. Where one is not positive, the element is cut
  in two at its most uneven edge, again and again, until all parts are proved or one has a corner
  that is flat or inside out.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from softrobot_twin.mechanics.lanes import KERNEL, LANES, at

# A part as small as this, by halvings, that is still not proved counts as folded: it is nearly
# flat.
MOST_HALVINGS = 15


@njit(**KERNEL)
def mark_surely_upright(C, R, sure):
    """Keep marked only the elements whose RᵀC has a positive definite symmetric part."""
    for e in range(LANES):
        a, b, c = R[at(0, e)], R[at(1, e)], R[at(2, e)]
        d, f, g = R[at(3, e)], R[at(4, e)], R[at(5, e)]
        h, i, j = R[at(6, e)], R[at(7, e)], R[at(8, e)]
        c00, c01, c02 = C[at(0, e)], C[at(1, e)], C[at(2, e)]
        c10, c11, c12 = C[at(3, e)], C[at(4, e)], C[at(5, e)]
        c20, c21, c22 = C[at(6, e)], C[at(7, e)], C[at(8, e)]
        s00 = a * c00 + d * c10 + h * c20
        s11 = b * c01 + f * c11 + i * c21
        s22 = c * c02 + g * c12 + j * c22
        s01 = 0.5 * (a * c01 + d * c11 + h * c21 + b * c00 + f * c10 + i * c20)
        s02 = 0.5 * (a * c02 + d * c12 + h * c22 + c * c00 + g * c10 + j * c20)
        s12 = 0.5 * (b * c02 + f * c12 + i * c22 + c * c01 + g * c11 + j * c21)
        minor = s00 * s11 - s01 * s01
        third = s00 * (s11 * s22 - s12 * s12) - s01 * (s01 * s22 - s12 * s02)
        third += s02 * (s01 * s12 - s11 * s02)
        definite = s00 > 0.0 and minor > 0.0 and third > 0.0
        sure[e] = sure[e] if definite else 0.0


@njit(**KERNEL)
def determinant(a, b, c):
    """Of the matrix of three rows."""
    return (
        a[0] * (b[1] * c[2] - b[2] * c[1])
        + a[1] * (b[2] * c[0] - b[0] * c[2])
        + a[2] * (b[0] * c[1] - b[1] * c[0])
    )


@njit(**KERNEL)
def mixed_determinant(A, B, C):
    """Six times the mixed determinant of three matrices; that of (A, A, A) is det A."""
    return (
        determinant(A[0], B[1], C[2]) + determinant(A[0], C[1], B[2])
        + determinant(B[0], A[1], C[2]) + determinant(C[0], A[1], B[2])
        + determinant(B[0], C[1], A[2]) + determinant(C[0], B[1], A[2])
    )  # fmt: skip


@njit(**KERNEL)
def least_coefficient(F):
    """Least Bernstein coefficient, times six, of det of the F between four corners."""
    least = np.inf
    for i in range(4):
        for j in range(i, 4):
            for k in range(j, 4):
                least = min(least, mixed_determinant(F[i], F[j], F[k]))
    return least


@njit(**KERNEL)
def halve(F, first, second):
    """Cut at the edge along which F changes most; both parts may be where F was."""
    longest, a, b = -1.0, 0, 1
    for i in range(4):
        for j in range(i + 1, 4):
            square = 0.0
            for r in range(3):
                for s in range(3):
                    square += (F[i, r, s] - F[j, r, s]) ** 2
            if square > longest:
                longest, a, b = square, i, j
    middle = 0.5 * (F[a] + F[b])
    second[:] = F
    first[:] = F
    second[a] = middle
    first[b] = middle


@njit(**KERNEL)
def is_folded(F):
    """Whether det F is zero or negative anywhere between the four corners.

    Args:
        F: Deformation gradients at the corners, shape (4, 3, 3).
    """
    parts = np.empty((MOST_HALVINGS + 2, 4, 3, 3))
    halvings = np.zeros(MOST_HALVINGS + 2, np.int64)
    parts[0] = F
    count = 1
    while count > 0:
        count -= 1
        part, depth = parts[count], halvings[count]
        if least_coefficient(part) > 0.0:
            continue
        for i in range(4):
            if not determinant(part[i, 0], part[i, 1], part[i, 2]) > 0.0:
                return True
        if depth == MOST_HALVINGS:
            return True
        halve(part.copy(), parts[count], parts[count + 1])
        halvings[count] = halvings[count + 1] = depth + 1
        count += 2
    return False


@njit(**KERNEL)
def find_folds(corners, sure, upright):
    """Elements that are not surely upright and fold somewhere are upright no more.

    Args:
        corners: F at the four corners, shape (4, 9 LANES).
        sure: 1 where the element is proved upright already.
        upright: 1 where it is so at all corners and quadrature points; set to 0.
    """
    F = np.empty((4, 3, 3))
    for e in range(LANES):
        if upright[e] > 0.0 and sure[e] == 0.0:
            for q in range(4):
                for i in range(9):
                    F[q, i // 3, i % 3] = corners[q, at(i, e)]
            if is_folded(F):
                upright[e] = 0.0
