"""Facts of the polar decomposition, in batches and alone."""

import numpy as np
import pytest

from softrobot_twin.mechanics.element_batches import BATCH
from softrobot_twin.mechanics.polar import find_rotations, find_upright


def rotations_of(matrices):
    """Rotations and the number of flat elements of up to BATCH deformations."""
    filled = np.tile(np.eye(3), (BATCH, 1, 1))
    filled[: len(matrices)] = matrices
    F = np.ascontiguousarray(filled.reshape(BATCH, 9).T).ravel()
    R, upright = np.empty(9 * BATCH), np.empty(BATCH)
    find_upright(F, upright)
    find_rotations(F, upright, R)
    rotations = R.reshape(9, BATCH).T.reshape(BATCH, 3, 3)[: len(matrices)]
    return rotations, np.count_nonzero(upright == 0.0)


@pytest.mark.parametrize("seed", range(5))
def test_rotation_times_symmetric_stretch_is_the_deformation(seed):
    rng = np.random.default_rng(seed)
    batch = np.eye(3) + 0.6 * rng.standard_normal((BATCH, 3, 3))
    batch[np.linalg.det(batch) < 0.0, 0] *= -1.0
    rotations, _ = rotations_of(batch)
    for F, R in zip(batch, rotations, strict=True):
        np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-14)
        assert np.linalg.det(R) > 0.0
        S = R.T @ F
        np.testing.assert_allclose(S, S.T, atol=1e-13)


@pytest.mark.parametrize("stretch", [1e-3, 1.0, 1e3])
def test_rotation_does_not_depend_on_size(stretch):
    F = np.array([[0.9, 0.3, 0.0], [-0.2, 1.1, 0.4], [0.1, 0.0, 0.8]])
    rotations, _ = rotations_of([F, stretch * F])
    np.testing.assert_allclose(rotations[1], rotations[0], atol=1e-14)


def test_one_inverted_element_does_not_change_its_neighbours():
    F = np.array([[0.9, 0.3, 0.0], [-0.2, 1.1, 0.4], [0.1, 0.0, 0.8]])
    alone, _ = rotations_of([F])
    for bad in (np.zeros((3, 3)), -np.eye(3), np.full((3, 3), np.nan)):
        together, flat_count = rotations_of([bad, F])
        np.testing.assert_allclose(together[1], alone[0], atol=1e-15)
        assert flat_count == 1


@pytest.mark.parametrize("F", [
    np.diag([1.0, 1.0, -0.3]), np.diag([1.0, 1.0, 0.0]), np.diag([1.0, 0.0, 0.0]), np.zeros((3, 3)),
    -np.eye(3),
])  # fmt: skip
def test_flat_and_inverted_deformations_still_give_a_proper_rotation(F):
    (R,), flat_count = rotations_of([F])
    assert flat_count == 1
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(R) == pytest.approx(1.0)


def test_inverted_rotation_is_the_nearest_proper_one():
    rng = np.random.default_rng(3)
    F = np.diag([1.2, 0.9, -0.4]) + 0.1 * rng.standard_normal((3, 3))
    (R,), _ = rotations_of([F])
    best = np.trace(R.T @ F)
    for _ in range(500):
        Q, _ = np.linalg.qr(rng.standard_normal((3, 3)))
        Q *= np.sign(np.linalg.det(Q))
        assert np.trace(Q.T @ F) <= best + 1e-12
