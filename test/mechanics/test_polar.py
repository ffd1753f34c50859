"""Facts of the polar decomposition."""

import numpy as np
import pytest

from softrobot_twin.mechanics.polar import polar_rotation


def rotation_of(F):
    R, flat = polar_rotation(*F.ravel())
    return np.array(R).reshape(3, 3), flat


@pytest.mark.parametrize("seed", range(20))
def test_rotation_times_symmetric_stretch_gives_back_the_deformation(seed):
    rng = np.random.default_rng(seed)
    F = np.eye(3) + 0.6 * rng.standard_normal((3, 3))
    if np.linalg.det(F) < 0.05:
        F[0] *= -1.0
    R, _ = rotation_of(F)
    S = R.T @ F
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(R) > 0.0
    np.testing.assert_allclose(S, S.T, atol=1e-13)


@pytest.mark.parametrize("stretch", [1e-3, 1.0, 1e3])
def test_rotation_does_not_depend_on_size(stretch):
    F = np.array([[0.9, 0.3, 0.0], [-0.2, 1.1, 0.4], [0.1, 0.0, 0.8]])
    np.testing.assert_allclose(rotation_of(stretch * F)[0], rotation_of(F)[0], atol=1e-14)


@pytest.mark.parametrize(
    "F",
    [
        np.diag([1.0, 1.0, -0.3]),
        np.diag([1.0, 1.0, 0.0]),
        np.diag([1.0, 0.0, 0.0]),
        np.zeros((3, 3)),
        -np.eye(3),
    ],
)
def test_flat_and_inverted_deformations_still_give_a_proper_rotation(F):
    R, flat = rotation_of(F)
    assert flat
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(R) == pytest.approx(1.0)


def test_inverted_rotation_is_the_nearest_proper_one():
    rng = np.random.default_rng(3)
    F = np.diag([1.2, 0.9, -0.4]) + 0.1 * rng.standard_normal((3, 3))
    R, _ = rotation_of(F)
    best = np.trace(R.T @ F)
    for _ in range(500):
        Q, _ = np.linalg.qr(rng.standard_normal((3, 3)))
        Q *= np.sign(np.linalg.det(Q))
        assert np.trace(Q.T @ F) <= best + 1e-12


def test_not_finite_deformation_is_told_as_flat():
    assert rotation_of(np.full((3, 3), np.nan))[1]
