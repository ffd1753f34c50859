"""Rotations: matrices, rotation vectors and quaternions.

A rotation vector θ is the axis times the angle [rad]; exp([θ]×) is its matrix (Rodrigues). The
logarithm is computed from the quaternion, whose largest component is found first (Shepperd 1978),
so that it is equally accurate for all angles from zero to π.

Arguments of the kernels here:
    R, before, after: Rotations, three rows of three numbers.
    vector: A rotation vector [rad], three numbers.
"""

from __future__ import annotations

import numpy as np

from softrobot_twin.geometry.matrix3 import (
    add_scaled_matrix,
    plus_identity,
    product,
    product_transposed,
    scaled_matrix,
    transposed_product,
)
from softrobot_twin.geometry.vector3 import dot, norm, scaled
from softrobot_twin.kernels.compilation import INLINED, KERNEL, njit

# Below this angle [rad] the series is more accurate than the closed form.
SMALL_ANGLE = 0.2


@njit(**INLINED)
def skew_polynomial(v, first, second):
    """1 + first [v]× + second [v]×²."""
    x, y, z = v
    return (
        (
            1.0 - second * (y * y + z * z),
            second * x * y - first * z,
            second * x * z + first * y,
        ),
        (
            second * x * y + first * z,
            1.0 - second * (x * x + z * z),
            second * y * z - first * x,
        ),
        (
            second * x * z - first * y,
            second * y * z + first * x,
            1.0 - second * (x * x + y * y),
        ),
    )


@njit(**KERNEL)
def exponential(vector):
    """exp([θ]×) = 1 + sin θ/θ [θ]× + (1 - cos θ)/θ² [θ]×², without cancellation."""
    angle = norm(vector)
    if angle == 0.0:
        return skew_polynomial(vector, 1.0, 0.5)
    half = np.sin(0.5 * angle) / angle
    return skew_polynomial(vector, np.sin(angle) / angle, 2.0 * half * half)


@njit(**KERNEL)
def unit_quaternion(R):
    """Quaternion (x, y, z, w) of a rotation matrix, w not negative."""
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = R
    trace = xx + yy + zz
    if trace >= xx and trace >= yy and trace >= zz:
        x, y, z, w = zy - yz, xz - zx, yx - xy, 1.0 + trace
    elif xx >= yy and xx >= zz:
        x, y, z, w = 1.0 + xx - yy - zz, xy + yx, xz + zx, zy - yz
    elif yy >= zz:
        x, y, z, w = xy + yx, 1.0 - xx + yy - zz, yz + zy, xz - zx
    else:
        x, y, z, w = xz + zx, yz + zy, 1.0 - xx - yy + zz, yx - xy
    scale = 1.0 / np.sqrt(x * x + y * y + z * z + w * w)
    if w < 0.0:
        scale = -scale
    return scale * x, scale * y, scale * z, scale * w


@njit(**KERNEL)
def logarithm(R):
    """Rotation vector of a matrix, no longer than π."""
    x, y, z, w = unit_quaternion(R)
    sine = norm((x, y, z))
    return scaled((x, y, z), 2.0 * np.arctan2(sine, w) / sine if sine > 0.0 else 2.0)


@njit(**KERNEL, forceinline=True)
def turn_between(before, after):
    """Rotation vector that leads from one rotation to another, log(R_after R_beforeᵀ)."""
    return logarithm(product_transposed(after, before))


@njit(**KERNEL)
def inverse_jacobian(vector):
    """∂ log(exp([θ]×) exp([φ]×)) / ∂θ at θ = 0: 1 - [φ]×/2 + (1 - φ/2 cot φ/2)/φ² [φ]×²."""
    square = dot(vector, vector)
    if square < SMALL_ANGLE * SMALL_ANGLE:
        q = 0.25 * square
        second = 1.0 / 12.0 + q * (1.0 / 180.0 + q * (1.0 / 1890.0 + q / 18900.0))
    else:
        half = 0.5 * np.sqrt(square)
        second = (1.0 - half * np.cos(half) / np.sin(half)) / square
    return skew_polynomial(vector, -0.5, second)


@njit(**KERNEL, inline="always")
def left_jacobian(vector):
    """∂ log(exp([θ + dθ]×) exp(-[θ]×)) / ∂dθ: 1 + (1 - cos θ)/θ² [θ]× + (θ - sin θ)/θ³ [θ]×²."""
    square = dot(vector, vector)
    angle = np.sqrt(square)
    if angle < SMALL_ANGLE:
        first = 0.5 - square * (1.0 / 24.0 - square * (1.0 / 720.0 - square / 40320.0))
        second = 1.0 / 6.0 - square * (1.0 / 120.0 - square * (1.0 / 5040.0 - square / 362880.0))
    else:
        first = 2.0 * np.sin(0.5 * angle) ** 2 / square
        second = (angle - np.sin(angle)) / (square * angle)
    return skew_polynomial(vector, first, second)


@njit(**KERNEL, forceinline=True)
def orthonormalised(R):
    """A nearly orthonormal matrix made orthonormal, R + R (1 - RᵀR)/2: the error is squared."""
    half_error = plus_identity(scaled_matrix(transposed_product(R, R), -0.5), 0.5)
    return add_scaled_matrix(R, product(R, half_error), 1.0)


def rotation_from_vector(vector) -> np.ndarray:
    """Matrix of a rotation vector [rad], shape (3, 3).

    Args:
        vector: Axis times angle [rad], shape (3,).
    """
    return np.array(exponential(tuple(np.asarray(vector, dtype=float).tolist())))


def vector_from_rotation(rotation) -> np.ndarray:
    """Rotation vector of a matrix [rad], shape (3,), no longer than π.

    Args:
        rotation: The matrix, shape (3, 3).
    """
    return np.array(logarithm(_as_rows(rotation)))


def rotation_from_quaternion(quaternion) -> np.ndarray:
    """Matrix of a quaternion.

    Args:
        quaternion: (x, y, z, w), as in ROS, of any length above zero, shape (4,).

    Returns:
        The rotation, shape (3, 3).

    Raises:
        ValueError: The quaternion is zero or not finite.
    """
    q = np.asarray(quaternion, dtype=float)
    largest = np.abs(q).max()
    if not (np.isfinite(largest) and largest > 0.0):
        raise ValueError(f"the quaternion {q.tolist()} is no rotation")
    x, y, z, w = q / largest / np.linalg.norm(q / largest)
    return np.array(
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)],
            [2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)],
            [2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)],
        ]
    )


def quaternion_from_rotation(rotation) -> np.ndarray:
    """Quaternion (x, y, z, w) of a matrix, as in ROS, w not negative, shape (4,).

    Args:
        rotation: The matrix, shape (3, 3).
    """
    return np.array(unit_quaternion(_as_rows(rotation)))


def _as_rows(matrix) -> tuple:
    """A 3×3 array as a matrix of `matrix3`."""
    return tuple(map(tuple, np.asarray(matrix, dtype=float).tolist()))
