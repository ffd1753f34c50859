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

Where F is constant, its one point tells all. A hexahedron is upright if F is so at its quadrature
point, and if the map of its eight corners is so in each of them. Of other elements nothing is
proved: they are upright if they are so at their quadrature points.

Arguments of the kernels here; those of one batch have no first axis:
    A, B, C: Matrices, three rows of three numbers.
    a, b, c: Rows of a matrix, three numbers each.
    e: An element of the batch.
    F, first, second: F at the corners of one element, shape (4, 3, 3).
    corners: F at the corners, shape (4, 9 × BATCH).
    edges: Local nodes of one corner, shape (4,).
    inverse: Inverse of its edges at rest [1/m], shape (3, 3).
    nodes: Nodes of one element, shape (node_count_of_element,).
    sure, upright, lowest, weights: One number for each element, shape (BATCH,).
    x: Node positions [m], shape (node_count, 3).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softrobot_twin.geometry.matrix3 import (
    add_scaled_matrix,
    cofactor,
    determinant,
    product,
    rows,
    set_rows,
    symmetric,
    transposed,
)
from softrobot_twin.geometry.quadrature import barycentric_coordinates
from softrobot_twin.geometry.shape_functions import MEAN_HEXAHEDRON, HEXAHEDRON_CORNERS
from softrobot_twin.geometry.vector3 import add_scaled, cross, dot, row
from softrobot_twin.kernels.compilation import INNER, KERNEL, ONCE, njit
from softrobot_twin.mechanics.element_batches import BATCH, copy_entries, matrix_at, put_matrix
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


class WatchedCorners(NamedTuple):
    """Corners at which the map of the corners alone is watched.

    Attributes:
        edges: Local nodes of each corner and of the ends of the three edges from it, right-handed,
            shape (corner_count, 4); no corners for elements other than hexahedra.
        inverses: Inverse of the matrix of these edges at rest, its columns [1/m],
            shape (element_count, corner_count, 3, 3).
    """

    edges: np.ndarray
    inverses: np.ndarray


def no_corners() -> WatchedCorners:
    """Of elements that are watched at their quadrature points only, or by `find_folds`."""
    return WatchedCorners(np.empty((0, 4), np.int64), np.empty((0, 0, 3, 3)))


def watched_corners(mesh) -> WatchedCorners:
    """The corners of hexahedra.

    Args:
        mesh: The elements at rest, as far as `Elements` needs them.
    """
    if mesh.shape_functions is not MEAN_HEXAHEDRON:
        return no_corners()
    corners = HEXAHEDRON_CORNERS
    beside = np.abs(corners[:, None] - corners[None]).sum(axis=2) == 2.0
    edges = np.empty((8, 4), dtype=np.int64)
    for corner in range(8):
        edges[corner] = [corner, *np.flatnonzero(beside[corner])]
        if np.linalg.det(corners[edges[corner, 1:]] - corners[corner]) < 0.0:
            edges[corner, 2:] = edges[corner, [3, 2]]
    placed = mesh.node_positions[mesh.cells][:, edges]
    matrices = (placed[:, :, 1:] - placed[:, :, :1]).transpose(0, 1, 3, 2)
    return WatchedCorners(edges, np.ascontiguousarray(np.linalg.inv(matrices)))


@njit(**INNER)
def corner_deformation(x, nodes, edges, inverse):
    """F in one corner: its edges times the inverse of those at rest."""
    origin = row(x, nodes[edges[0]])
    a = add_scaled(row(x, nodes[edges[1]]), origin, -1.0)
    b = add_scaled(row(x, nodes[edges[2]]), origin, -1.0)
    c = add_scaled(row(x, nodes[edges[3]]), origin, -1.0)
    columns = ((a[0], b[0], c[0]), (a[1], b[1], c[1]), (a[2], b[2], c[2]))
    return product(columns, rows(inverse))


@njit(**KERNEL)
def write_corners(x, cells, edges, inverses, deformations):
    """F in the corners of all elements, see `WatchedCorners`.

    Args:
        x: Node positions [m], shape (node_count, 3).
        cells: Nodes of the elements, shape (element_count, node_count).
        edges, inverses: See `WatchedCorners`.
        deformations: F; written, shape (batch_count, corner_count, 9 × BATCH).
    """
    for k in range(len(cells)):
        for corner in range(len(edges)):
            F = corner_deformation(x, cells[k], edges[corner], inverses[k, corner])
            put_matrix(deformations[k // BATCH, corner], 0, k % BATCH, F)


@njit(**KERNEL)
def count_folded(x, cells, edges, inverses, uprights):
    """Number of elements that are flat or inside out at a quadrature point or in a corner.

    Args:
        x, cells, edges, inverses: See `write_corners`.
        uprights: 1.0 where a quadrature point is upright, else 0.0,
            shape (batch_count, point_count, BATCH).
    """
    count = 0
    for k in range(len(cells)):
        folded = False
        for q in range(uprights.shape[1]):
            folded = folded or uprights[k // BATCH, q, k % BATCH] == 0.0
        for corner in range(len(edges)):
            if folded:
                break
            folded = not is_upright(
                corner_deformation(x, cells[k], edges[corner], inverses[k, corner])
            )
        count += folded
    return count


@njit(**ONCE)
def take_lowest(upright, lowest):
    """The lower of both, element by element."""
    for e in range(BATCH):
        lowest[e] = min(lowest[e], upright[e])


@njit(**ONCE)
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


@njit(**INNER)
def deform_corners(to_corners, F, corners):
    """F at the corners of a batch, or wherever else in its elements, from F at its points.

    Args:
        to_corners: See `point_to_corner_weights`, shape (corner_count, point_count).
        F: Deformation gradients at the points, shape (point_count, 9 BATCH).
        corners: Those at the corners; written, shape (corner_count, 9 BATCH).
    """
    for corner in range(len(to_corners)):
        values = corners[corner]
        values[:] = 0.0
        for q in range(len(F)):
            share, point = to_corners[corner, q], F[q]
            for i in range(9 * BATCH):
                values[i] += share * point[i]


@njit(**ONCE)
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
    deform_corners(to_corners, F, corners)
    for corner in range(len(to_corners)):
        for e in range(BATCH):
            upright[e] = upright[e] if is_upright(matrix_at(corners[corner], 0, e)) else 0.0
    copy_entries(upright, sure)
    mark_surely_upright(corners, sure)
    cut_the_unsure(corners, sure, upright)


@njit(**ONCE)
def mark_surely_upright(corners, sure):
    """Keep marked only the elements for which the first proof holds."""
    for e in range(BATCH):
        mean = sum_of_corners(corners, e)
        inverse = transposed(cofactor(mean))
        sure[e] = sure[e] if determinant(mean) > 0.0 else 0.0
        for corner in range(4):
            relative = symmetric(product(inverse, matrix_at(corners[corner], 0, e)))
            minors = cofactor(relative)
            definite = relative[0][0] > 0.0 and minors[2][2] > 0.0
            sure[e] = sure[e] if definite and dot(relative[0], minors[0]) > 0.0 else 0.0


@njit(**INNER)
def write_element(corners, e, F):
    """Write F at the corners of one element of a batch, shape (4, 3, 3)."""
    for corner in range(4):
        set_rows(F[corner], matrix_at(corners[corner], 0, e))


@njit(**INNER)
def sum_of_corners(corners, e):
    """The sum of F at the corners of one element of a batch."""
    total = matrix_at(corners[0], 0, e)
    for corner in range(1, 4):
        total = add_scaled_matrix(total, matrix_at(corners[corner], 0, e), 1.0)
    return total


@njit(**ONCE)
def cut_the_unsure(corners, sure, upright):
    """Mark the elements that fold as not upright; only elements without a proof are examined.

    Args:
        corners: F at the four corners, shape (4, 9 BATCH).
        sure: 1 where the element is proved upright already.
        upright: 1 where it is so at all corners and quadrature points; set to 0.
    """
    F = np.empty((4, 3, 3))
    for e in range(BATCH):
        if upright[e] > 0.0 and sure[e] == 0.0:
            write_element(corners, e, F)
            if is_folded(F):
                upright[e] = 0.0


@njit(**INNER)
def mixed_determinant(A, B, C):
    """Six times the mixed determinant of three matrices; that of (A, A, A) is det A."""
    return (
        of_rows(A[0], B[1], C[2]) + of_rows(A[0], C[1], B[2])
        + of_rows(B[0], A[1], C[2]) + of_rows(C[0], A[1], B[2])
        + of_rows(B[0], C[1], A[2]) + of_rows(C[0], B[1], A[2])
    )  # fmt: skip


@njit(**INNER)
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
                least = min(least, mixed_determinant(rows(F[i]), rows(F[j]), rows(F[k])))
    return least


@njit(**ONCE)
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
    for r in range(3):
        for s in range(3):
            for i in range(4):
                first[i, r, s] = second[i, r, s] = F[i, r, s]
            first[b, r, s] = second[a, r, s] = 0.5 * (F[a, r, s] + F[b, r, s])


@njit(**KERNEL)
def is_folded(F):
    """Whether det F is zero or negative anywhere between the four corners.

    Args:
        F: Deformation gradients at the corners, shape (4, 3, 3).
    """
    parts = np.empty((MOST_HALVINGS + 2, 4, 3, 3))
    halvings = np.zeros(MOST_HALVINGS + 2, np.int64)
    for i in range(4):
        set_rows(parts[0, i], rows(F[i]))
    count = 1
    while count > 0:
        count -= 1
        part, depth = parts[count], halvings[count]
        if least_coefficient(part) > 0.0:
            continue
        for i in range(4):
            if not of_rows(row(part[i], 0), row(part[i], 1), row(part[i], 2)) > 0.0:
                return True
        if depth == MOST_HALVINGS:
            return True
        halve(part.copy(), parts[count], parts[count + 1])
        halvings[count] = halvings[count + 1] = depth + 1
        count += 2
    return False
