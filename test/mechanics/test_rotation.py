"""Facts of rotations."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from softrobot_twin.mechanics.rotation import (
    inverse_jacobian,
    left_jacobian,
    orthonormalised,
    quaternion_from_rotation,
    rotation_from_quaternion,
    rotation_from_vector,
    vector_from_rotation,
)

ANGLES = [0.0, 1e-300, 1e-160, 1e-12, 1e-8, 1e-4, 0.19, 0.21, 1.0, 2.5, 3.1, np.pi - 1e-5,
          np.pi - 1e-9, np.pi - 1e-13]  # fmt: skip


@pytest.fixture(params=range(6))
def axis(request):
    axes = np.vstack([np.eye(3), np.random.default_rng(3).standard_normal((3, 3))])
    return axes[request.param] / np.linalg.norm(axes[request.param])


@pytest.mark.parametrize("angle", ANGLES)
def test_the_logarithm_undoes_the_exponential(axis, angle):
    back = vector_from_rotation(rotation_from_vector(angle * axis))
    np.testing.assert_allclose(back, angle * axis, rtol=1e-14, atol=4e-16 * max(angle, 1e-290))


@pytest.mark.parametrize("angle", [0.3, np.pi - 1e-6, np.pi, np.pi + 1e-6, 6.0])
def test_the_exponential_undoes_the_logarithm(axis, angle):
    R = rotation_from_vector(angle * axis)
    np.testing.assert_allclose(rotation_from_vector(vector_from_rotation(R)), R, atol=2e-15)
    assert np.linalg.norm(vector_from_rotation(R)) <= np.pi + 1e-15


def test_matrices_and_quaternions_are_those_of_scipy(axis):
    for angle in ANGLES[3:]:
        known = Rotation.from_rotvec(angle * axis)
        R = rotation_from_vector(angle * axis)
        np.testing.assert_allclose(R, known.as_matrix(), atol=1e-15)
        np.testing.assert_allclose(
            rotation_from_quaternion(-3.0 * known.as_quat()), known.as_matrix(), atol=1e-15
        )
        q = quaternion_from_rotation(R)
        assert q[3] >= 0.0
        assert abs(q @ known.as_quat()) == pytest.approx(1.0, abs=1e-15)
        np.testing.assert_allclose(rotation_from_quaternion(q), R, atol=1e-15)


@pytest.mark.parametrize("wrong", [[0, 0, 0, 0], [0, 0, 0, np.nan], [np.inf, 0, 0, 1]])
def test_an_invalid_quaternion_is_refused(wrong):
    with pytest.raises(ValueError, match="no rotation"):
        rotation_from_quaternion(wrong)


@pytest.mark.parametrize("angle", [0.0, 1e-6, 0.1, 0.199999, 0.200001, 1.0, 2.9, 5.0])
def test_jacobians_are_the_derivatives_of_logarithm_and_exponential(axis, angle):
    phi, R = angle * axis, rotation_from_vector(angle * axis)
    for step in 1e-6 * np.eye(3):
        ahead, behind = (rotation_from_vector(phi + s * step) @ R.T for s in (1.0, -1.0))
        slope = (vector_from_rotation(ahead) - vector_from_rotation(behind)) / 2.0
        np.testing.assert_allclose(np.array(left_jacobian(tuple(phi))) @ step, slope, atol=1e-15)
        if angle < 3.0:
            ahead, behind = (vector_from_rotation(rotation_from_vector(s * step) @ R)
                             for s in (1.0, -1.0))  # fmt: skip
            found = np.array(inverse_jacobian(tuple(phi))) @ step
            np.testing.assert_allclose(found, (ahead - behind) / 2.0, atol=1e-15)


@pytest.mark.parametrize("jacobian", [left_jacobian, inverse_jacobian])
def test_a_jacobian_is_continuous_at_the_limit_of_its_series(jacobian, axis):
    below, above = (jacobian(tuple((0.2 + off) * axis)) for off in (-1e-15, 1e-15))
    np.testing.assert_allclose(below, above, atol=1e-14)


def test_an_almost_orthogonal_matrix_becomes_the_nearest_rotation(axis):
    off = rotation_from_vector(2.0 * axis) + 1e-9 * np.random.default_rng(0).standard_normal((3, 3))
    U, _, Vt = np.linalg.svd(off)
    near = np.array(orthonormalised(tuple(map(tuple, off))))
    np.testing.assert_allclose(near, U @ Vt, atol=1e-14)
    np.testing.assert_allclose(near.T @ near, np.eye(3), atol=1e-15)
