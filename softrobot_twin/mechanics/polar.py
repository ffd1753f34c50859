"""The rotation of a deformation: polar decomposition F = R S, also of inverted elements."""

from __future__ import annotations

import numpy as np
from numba import njit

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


@njit(cache=True, nogil=True, error_model="numpy")
def polar_rotation(f00, f01, f02, f10, f11, f12, f20, f21, f22):
    """Rotation R of F = R S by Newton's iteration R ← (R + R⁻ᵀ)/2.

    Args:
        f00: Entries of F, row by row.

    Returns:
        The nine entries of R, row by row, and True when F was flat or inverted.
    """
    a, b, c = f00, f01, f02
    d, e, f = f10, f11, f12
    g, h, i = f20, f21, f22
    square = a * a + b * b + c * c + d * d + e * e + f * f + g * g + h * h + i * i
    det = a * (e * i - f * h) + b * (f * g - d * i) + c * (d * h - e * g)
    if not det > FLAT * square * np.sqrt(square):
        if not np.isfinite(square):
            return (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0), True
        return singular_rotation(f00, f01, f02, f10, f11, f12, f20, f21, f22), True
    for _ in range(40):
        c00, c01, c02 = e * i - f * h, f * g - d * i, d * h - e * g
        c10, c11, c12 = c * h - b * i, a * i - c * g, b * g - a * h
        c20, c21, c22 = b * f - c * e, c * d - a * f, a * e - b * d
        s = 0.5 / (a * c00 + b * c01 + c * c02)
        na, nb, nc = 0.5 * a + s * c00, 0.5 * b + s * c01, 0.5 * c + s * c02
        nd, ne, nf = 0.5 * d + s * c10, 0.5 * e + s * c11, 0.5 * f + s * c12
        ng, nh, ni = 0.5 * g + s * c20, 0.5 * h + s * c21, 0.5 * i + s * c22
        change = (
            (na - a) ** 2 + (nb - b) ** 2 + (nc - c) ** 2
            + (nd - d) ** 2 + (ne - e) ** 2 + (nf - f) ** 2
            + (ng - g) ** 2 + (nh - h) ** 2 + (ni - i) ** 2
        )  # fmt: skip
        a, b, c, d, e, f, g, h, i = na, nb, nc, nd, ne, nf, ng, nh, ni
        # Newton doubles the digits: a change of 1e-8 leaves an error of 1e-16.
        if change < 1.0e-16:
            break
    return (a, b, c, d, e, f, g, h, i), False
