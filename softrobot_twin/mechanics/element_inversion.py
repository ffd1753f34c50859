"""Where elements are inside out: proof that det F is positive everywhere in an element.

F varies linearly in a quadratic tetrahedron, F = Σ L_i F_i with the F_i of its corners, and so
det F is a cubic polynomial. An element can be upright at all corners and quadrature points and yet
be inside out between them. Two proofs that it is not:

- If one matrix M with det M > 0 makes the symmetric part of M F_i positive definite at all corners,
  it is so at all points between, which are their means; and then det F > 0. M is det(F̄) F̄⁻¹ with
  the mean F̄ of the corners. Nearly every element passes, and it costs little.
- A cubic polynomial is at least the least of its twenty Bernstein coefficients, which for corners
  i, j, k are the mixed determinants of F_i, F_j, F_k. Where one is not positive, the element is cut
  in two at its most uneven edge, again and again, until all parts are proved or one has a corner
  that is flat or inside out.

Where F is constant, its one point tells all. Of other elements nothing is proved: they are upright
if they are so at their quadrature points.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from softrobot_twin.geometry.matrix3 import (
    add_scaled_matrix,
    cofactor,
    determinant,
    product,
    symmetric,
    transposed,
)
from softrobot_twin.geometry.quadrature import barycentric_coordinates
from softrobot_twin.geometry.vector3 import cross, dot
from softrobot_twin.mechanics.element_batches import BATCH, KERNEL, at, matrix_at
from softrobot_twin.mechanics.polar import is_upright

# A part as small as this, by halvings, that is still not proved counts as folded: it is nearly
# flat.
MOST_HALVINGS = 15


def point_to_corner_weights(shape) -> np.ndarray:
    """What gives F at the corners of an element from F at its quadrature points.

    Args:
        shape: The element's `ShapeFunctions`.

    Returns:
        Shape (corner_count, point_count); no corners where F is not linear in the element.
    """
    points = shape.quadrature.points
    if shape.gradient_degree != 1:
        return np.empty((0, len(points)))
    return np.linalg.inv(barycentric_coordinates(points))


@njit(**KERNEL)
def take_lowest(upright, lowest):
    """The lower of both, element by element."""
    for e in range(BATCH):
        lowest[e] = min(lowest[e], upright[e])


@njit(**KERNEL)
def count_inverted(weights, upright):
    """Number of elements of a batch that are not upright; weights are 0 beyond the last one."""
    upright_count = 0.0
    for e in range(BATCH):
        upright_count += upright[e]
    count = 0
    if upright_count < BATCH:
        for e in range(BATCH):
            count += weights[e] > 0.0 and upright[e] == 0.0
    return count


@njit(**KERNEL)
def find_folds(to_corners, F, corners, upright, sure):
    """Mark the elements that are flat or inside out at a corner, or anywhere between.

    Args:
        to_corners: See `point_to_corner_weights`.
        F: Deformation gradients at the points, shape (point_count, 9 BATCH).
        corners: Memory for those at the corners, shape (corner_count, 9 BATCH).
        upright: 1 where an element is upright at its points, else 0; set to 0 where it is not so
            everywhere.
        sure: Memory, shape (BATCH,).
    """
    for corner in range(len(to_corners)):
        values = corners[corner]
        values[:] = 0.0
        for q in range(len(F)):
            share, point = to_corners[corner, q], F[q]
            for i in range(9 * BATCH):
                values[i] += share * point[i]
        for e in range(BATCH):
            upright[e] = upright[e] if is_upright(matrix_at(values, 0, e)) else 0.0
    sure[:] = upright
    mark_surely_upright(corners, sure)
    cut_the_unsure(corners, sure, upright)


@njit(**KERNEL)
def mark_surely_upright(corners, sure):
    """Keep marked only the elements for which the first proof holds."""
    for e in range(BATCH):
        mean = matrix_at(corners[0], 0, e)
        for corner in range(1, 4):
            mean = add_scaled_matrix(mean, matrix_at(corners[corner], 0, e), 1.0)
        inverse = transposed(cofactor(mean))
        sure[e] = sure[e] if determinant(mean) > 0.0 else 0.0
        for corner in range(4):
            relative = symmetric(product(inverse, matrix_at(corners[corner], 0, e)))
            minors = cofactor(relative)
            definite = relative[0][0] > 0.0 and minors[2][2] > 0.0
            sure[e] = sure[e] if definite and dot(relative[0], minors[0]) > 0.0 else 0.0


@njit(**KERNEL)
def cut_the_unsure(corners, sure, upright):
    """Elements that are not surely upright and fold somewhere are upright no more.

    Args:
        corners: F at the four corners, shape (4, 9 BATCH).
        sure: 1 where the element is proved upright already.
        upright: 1 where it is so at all corners and quadrature points; set to 0.
    """
    F = np.empty((4, 3, 3))
    for e in range(BATCH):
        if upright[e] > 0.0 and sure[e] == 0.0:
            for q in range(4):
                for i in range(9):
                    F[q, i // 3, i % 3] = corners[q, at(i, e)]
            if is_folded(F):
                upright[e] = 0.0


@njit(**KERNEL)
def mixed_determinant(A, B, C):
    """Six times the mixed determinant of three matrices; that of (A, A, A) is det A."""
    return (
        of_rows(A[0], B[1], C[2]) + of_rows(A[0], C[1], B[2])
        + of_rows(B[0], A[1], C[2]) + of_rows(C[0], A[1], B[2])
        + of_rows(B[0], C[1], A[2]) + of_rows(C[0], B[1], A[2])
    )  # fmt: skip


@njit(**KERNEL)
def of_rows(a, b, c):
    """Determinant of the matrix of three rows."""
    return dot(a, cross(b, c))


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
            if not of_rows(part[i, 0], part[i, 1], part[i, 2]) > 0.0:
                return True
        if depth == MOST_HALVINGS:
            return True
        halve(part.copy(), parts[count], parts[count + 1])
        halvings[count] = halvings[count + 1] = depth + 1
        count += 2
    return False
