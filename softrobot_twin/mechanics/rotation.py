"""Rotations: matrices, rotation vectors and quaternions.

A rotation vector θ is the axis times the angle [rad]; exp([θ]×) is its matrix (Rodrigues). The
logarithm is computed from the quaternion, whose largest component is found first (Shepperd 1978),
so that it is equally accurate for all angles from zero to π.
"""

from __future__ import annotations

import numpy as np
from numba import njit

# Below this angle [rad] the series is more accurate than the closed form.
SMALL_ANGLE = 0.2


@njit(cache=True, nogil=True, error_model="numpy")
def write_exponential(vector, out):
    """exp([θ]×) = 1 + sin θ/θ [θ]× + (1 - cos θ)/θ² [θ]×², without cancellation."""
    x, y, z = vector[0], vector[1], vector[2]
    angle = np.sqrt(x * x + y * y + z * z)
    s, c = 1.0, 0.5
    if angle > 0.0:
        s = np.sin(angle) / angle
        half = np.sin(0.5 * angle) / angle
        c = 2.0 * half * half
    out[0, 0] = 1.0 - c * (y * y + z * z)
    out[0, 1] = c * x * y - s * z
    out[0, 2] = c * x * z + s * y
    out[1, 0] = c * x * y + s * z
    out[1, 1] = 1.0 - c * (x * x + z * z)
    out[1, 2] = c * y * z - s * x
    out[2, 0] = c * x * z - s * y
    out[2, 1] = c * y * z + s * x
    out[2, 2] = 1.0 - c * (x * x + y * y)


@njit(cache=True, nogil=True, error_model="numpy")
def unit_quaternion(R):
    """Quaternion (x, y, z, w) of a rotation matrix, w not negative."""
    a, b, c = R[0, 0], R[1, 1], R[2, 2]
    trace = a + b + c
    if trace >= a and trace >= b and trace >= c:
        x, y, z, w = R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1], 1.0 + trace
    elif a >= b and a >= c:
        x, y, z, w = 1.0 + a - b - c, R[0, 1] + R[1, 0], R[0, 2] + R[2, 0], R[2, 1] - R[1, 2]
    elif b >= c:
        x, y, z, w = R[0, 1] + R[1, 0], 1.0 - a + b - c, R[1, 2] + R[2, 1], R[0, 2] - R[2, 0]
    else:
        x, y, z, w = R[0, 2] + R[2, 0], R[1, 2] + R[2, 1], 1.0 - a - b + c, R[1, 0] - R[0, 1]
    scale = 1.0 / np.sqrt(x * x + y * y + z * z + w * w)
    if w < 0.0:
        scale = -scale
    return scale * x, scale * y, scale * z, scale * w


@njit(cache=True, nogil=True, error_model="numpy")
def write_logarithm(R, out):
    """Rotation vector of a matrix, no longer than π."""
    x, y, z, w = unit_quaternion(R)
    sine = np.sqrt(x * x + y * y + z * z)
    scale = 2.0 * np.arctan2(sine, w) / sine if sine > 0.0 else 2.0
    out[0], out[1], out[2] = scale * x, scale * y, scale * z


@njit(cache=True, nogil=True, error_model="numpy")
def write_turn(before, after, work, out):
    """Rotation vector that leads from one rotation to another, log(R_after R_beforeᵀ)."""
    for i in range(3):
        for j in range(3):
            work[i, j] = (
                after[i, 0] * before[j, 0] + after[i, 1] * before[j, 1] + after[i, 2] * before[j, 2]
            )
    write_logarithm(work, out)


@njit(cache=True, nogil=True, error_model="numpy")
def write_inverse_jacobian(vector, out):
    """∂ log(exp([θ]×) exp([φ]×)) / ∂θ at θ = 0: 1 - [φ]×/2 + (1 - φ/2 cot φ/2)/φ² [φ]×²."""
    x, y, z = vector[0], vector[1], vector[2]
    square = x * x + y * y + z * z
    if square < SMALL_ANGLE * SMALL_ANGLE:
        q = 0.25 * square
        c = 1.0 / 12.0 + q * (1.0 / 180.0 + q * (1.0 / 1890.0 + q / 18900.0))
    else:
        half = 0.5 * np.sqrt(square)
        c = (1.0 - half * np.cos(half) / np.sin(half)) / square
    out[0, 0] = 1.0 - c * (y * y + z * z)
    out[0, 1] = c * x * y + 0.5 * z
    out[0, 2] = c * x * z - 0.5 * y
    out[1, 0] = c * x * y - 0.5 * z
    out[1, 1] = 1.0 - c * (x * x + z * z)
    out[1, 2] = c * y * z + 0.5 * x
    out[2, 0] = c * x * z + 0.5 * y
    out[2, 1] = c * y * z - 0.5 * x
    out[2, 2] = 1.0 - c * (x * x + y * y)


@njit(cache=True, nogil=True, error_model="numpy")
def orthonormalise(R, work):
    """Make a nearly orthonormal matrix orthonormal, R ← R + R (1 - RᵀR)/2: the error is squared."""
    for i in range(3):
        for j in range(3):
            work[i, j] = -0.5 * (R[0, i] * R[0, j] + R[1, i] * R[1, j] + R[2, i] * R[2, j])
        work[i, i] += 0.5
    for i in range(3):
        a, b, c = R[i, 0], R[i, 1], R[i, 2]
        for j in range(3):
            R[i, j] += a * work[0, j] + b * work[1, j] + c * work[2, j]


def rotation_from_vector(vector) -> np.ndarray:
    """Matrix of a rotation vector [rad], shape (3, 3)."""
    rotation = np.empty((3, 3))
    write_exponential(np.asarray(vector, dtype=float), rotation)
    return rotation


def vector_from_rotation(rotation) -> np.ndarray:
    """Rotation vector of a matrix [rad], shape (3,), no longer than π."""
    vector = np.empty(3)
    write_logarithm(np.asarray(rotation, dtype=float), vector)
    return vector


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
    """Quaternion (x, y, z, w) of a matrix, as in ROS, w not negative, shape (4,)."""
    return np.array(unit_quaternion(np.asarray(rotation, dtype=float)))
