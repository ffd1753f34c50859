"""The rotation of a deformation: polar decomposition F = R S, also of inverted elements."""

from __future__ import annotations

import numpy as np
from numba import njit

from softrobot_twin.mechanics.lanes import KERNEL, LANES, at

POLAR_ITERATIONS = 40
# A determinant this far below the cube of the largest stretch counts as flat: Newton's iteration
# would divide by it.
FLAT = 1.0e-5


@njit(cache=True, nogil=True, error_model="numpy")
def singular_rotation(f00, f01, f02, f10, f11, f12, f20, f21, f22):
    """Nearest proper rotation of a flat or inverted deformation, from its singular values.

    The smallest singular value takes the sign of the determinant (Irving 2004), so that R stays a
    rotation and the element feels a force towards its upright shape.
    """
    F = np.array([[f00, f01, f02], [f10, f11, f12], [f20, f21, f22]])
    U, _, Vt = np.linalg.svd(F)
    R = U @ Vt
    if np.linalg.det(R) < 0.0:
        U[:, 2] = -U[:, 2]
        R = U @ Vt
    return (
        R[0, 0], R[0, 1], R[0, 2],
        R[1, 0], R[1, 1], R[1, 2],
        R[2, 0], R[2, 1], R[2, 2],
    )  # fmt: skip


@njit(**KERNEL)
def find_upright(volumes, F, upright, R):
    """Start R at F. Flat or inverted elements get their rotation at once, and are counted."""
    for e in range(LANES):
        a, b, c = F[at(0, e)], F[at(1, e)], F[at(2, e)]
        d, f, g = F[at(3, e)], F[at(4, e)], F[at(5, e)]
        h, i, j = F[at(6, e)], F[at(7, e)], F[at(8, e)]
        square = a * a + b * b + c * c + d * d + f * f + g * g + h * h + i * i + j * j
        det = a * (f * j - g * i) + b * (g * h - d * j) + c * (d * i - f * h)
        upright[e] = 1.0 if det > FLAT * square * np.sqrt(square) else 0.0
    R[:] = F
    flat_count = 0
    for e in range(LANES):
        if upright[e] == 0.0:
            flat_count += volumes[e] > 0.0
            turn_flat(F, R, e)
    return flat_count


@njit(**KERNEL)
def turn_flat(F, R, e):
    """Rotation of one flat or inverted element, from its singular values."""
    square = 0.0
    for i in range(9):
        square += F[at(i, e)] ** 2
        R[at(i, e)] = 1.0 if i % 4 == 0 else 0.0
    if square < np.inf:
        rotation = singular_rotation(
            F[at(0, e)], F[at(1, e)], F[at(2, e)],
            F[at(3, e)], F[at(4, e)], F[at(5, e)],
            F[at(6, e)], F[at(7, e)], F[at(8, e)],
        )  # fmt: skip
        for i in range(9):
            R[at(i, e)] = rotation[i]


@njit(**KERNEL)
def rotate(R, change):
    """Newton's iteration R ← (R + R⁻ᵀ)/2; what is a rotation already stays."""
    for _ in range(POLAR_ITERATIONS):
        for e in range(LANES):
            a, b, c = R[at(0, e)], R[at(1, e)], R[at(2, e)]
            d, f, g = R[at(3, e)], R[at(4, e)], R[at(5, e)]
            h, i, j = R[at(6, e)], R[at(7, e)], R[at(8, e)]
            c00, c01, c02 = f * j - g * i, g * h - d * j, d * i - f * h
            c10, c11, c12 = c * i - b * j, a * j - c * h, b * h - a * i
            c20, c21, c22 = b * g - c * f, c * d - a * g, a * f - b * d
            s = 0.5 / (a * c00 + b * c01 + c * c02)
            c00, c01, c02 = 0.5 * a + s * c00, 0.5 * b + s * c01, 0.5 * c + s * c02
            c10, c11, c12 = 0.5 * d + s * c10, 0.5 * f + s * c11, 0.5 * g + s * c12
            c20, c21, c22 = 0.5 * h + s * c20, 0.5 * i + s * c21, 0.5 * j + s * c22
            change[e] = (
                (c00 - a) ** 2 + (c01 - b) ** 2 + (c02 - c) ** 2
                + (c10 - d) ** 2 + (c11 - f) ** 2 + (c12 - g) ** 2
                + (c20 - h) ** 2 + (c21 - i) ** 2 + (c22 - j) ** 2
            )  # fmt: skip
            R[at(0, e)], R[at(1, e)], R[at(2, e)] = c00, c01, c02
            R[at(3, e)], R[at(4, e)], R[at(5, e)] = c10, c11, c12
            R[at(6, e)], R[at(7, e)], R[at(8, e)] = c20, c21, c22
        worst = 0.0
        for e in range(LANES):
            worst = max(worst, change[e])
        # Newton doubles the digits: a change of 1e-8 leaves an error of 1e-16.
        if worst < 1.0e-16:
            break
