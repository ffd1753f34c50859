"""The rotation of a deformation: polar decomposition F = R S, also of inverted elements.

Arguments of the kernels here:
    e: An element of the batch.
    F, R: Of all elements of a batch, shape (9 × BATCH,).
    upright: 1.0 or 0.0 of each element, shape (BATCH,).
"""

from __future__ import annotations

import numpy as np

from softrobot_twin.geometry.matrix3 import (
    add_scaled_matrix,
    cofactor,
    determinant,
    inner,
    scaled_matrix,
)
from softrobot_twin.geometry.vector3 import dot
from softrobot_twin.kernels.compilation import INLINED, INNER, KERNEL, ONCE, njit
from softrobot_twin.mechanics.element_batches import BATCH, at, copy_entries, matrix_at, put_matrix

POLAR_ITERATIONS = 40
# A determinant below this share of the cube of the largest stretch counts as flat, because Newton's
# iteration divides by it.
FLAT = 1.0e-5


@njit(**INLINED)
def is_upright(F):
    """Whether a deformation is neither flat nor inverted; False for NaN."""
    square = inner(F, F)
    return determinant(F) > FLAT * square * np.sqrt(square)


@njit(**ONCE)
def singular_rotation(F):
    """Nearest proper rotation of a flat or inverted deformation, from its singular values.

    The smallest singular value takes the sign of the determinant (Irving et al. 2004), so that R is a
    proper rotation and the force on the element is directed towards positive volume.

    Args:
        F: Shape (3, 3).
    """
    U, _, Vt = np.linalg.svd(F)
    R = U @ Vt
    if np.linalg.det(R) < 0.0:
        for i in range(3):
            U[i, 2] = -U[i, 2]
        R = U @ Vt
    return R


@njit(**INNER)
def turn_flat(F, R, e):
    """Rotation of one flat or inverted element; none where F is not finite."""
    A, square = np.empty((3, 3)), 0.0
    for i in range(9):
        square += F[at(i, e)] ** 2
        A[i // 3, i % 3] = F[at(i, e)]
        R[at(i, e)] = 1.0 if i % 4 == 0 else 0.0
    if square < np.inf:
        A = singular_rotation(A)
        for i in range(9):
            R[at(i, e)] = A[i // 3, i % 3]


@njit(**KERNEL, inline="always")
def find_upright(F, upright):
    """Mark the elements of a batch that are upright by 1.0, the others by 0.0."""
    for e in range(BATCH):
        upright[e] = 1.0 if is_upright(matrix_at(F, 0, e)) else 0.0


@njit(**KERNEL, inline="always")
def find_rotations(F, upright, R):
    """Rotations of a batch: those of flat or inverted elements from their singular values."""
    copy_entries(F, R)
    upright_count = 0.0
    for e in range(BATCH):
        upright_count += upright[e]
    if upright_count < BATCH:
        for e in range(BATCH):
            if upright[e] == 0.0:
                turn_flat(F, R, e)
    iterate_to_rotations(R)


@njit(**ONCE)
def iterate_to_rotations(R):
    """Newton's iteration R ← (R + R⁻ᵀ)/2; a rotation is unchanged."""
    for _ in range(POLAR_ITERATIONS):
        changed_count = 0
        for e in range(BATCH):
            old = matrix_at(R, 0, e)
            cofactors = cofactor(old)
            s = 0.5 / dot(old[0], cofactors[0])
            new = add_scaled_matrix(scaled_matrix(old, 0.5), cofactors, s)
            difference = add_scaled_matrix(new, old, -1.0)
            # Newton doubles the digits: a change of 1e-8 leaves an error of 1e-16.
            changed_count += inner(difference, difference) >= 1.0e-16
            put_matrix(R, 0, e, new)
        if changed_count == 0:
            break
