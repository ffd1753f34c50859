"""Facts of the directions in which a contact's rows act."""

import numpy as np
import pytest

from softrobot_twin.constraints.contact import put_tangents


def directions(normals):
    normals = np.atleast_2d(normals).astype(float)
    made = np.empty((len(normals), 3, 3))
    put_tangents(normals, len(normals), made)
    return made


def test_normal_and_tangents_are_a_right_handed_frame():
    normals = np.random.default_rng(0).standard_normal((500, 3))
    normals[:6] = np.vstack([np.eye(3), -np.eye(3)])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    made = directions(normals)
    np.testing.assert_allclose(made @ made.transpose(0, 2, 1), np.tile(np.eye(3), (500, 1, 1)), atol=1e-14)
    np.testing.assert_allclose(np.linalg.det(made), 1.0, atol=1e-14)
    np.testing.assert_array_equal(made[:, 0], normals)


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_round_off_in_a_normal_along_an_axis_does_not_turn_its_tangents(axis, sign):
    normal = sign * np.eye(3)[axis]
    expected = directions(normal)[0]
    random = np.random.default_rng(1)
    for size in (1e-17, 1e-12, 1e-7):
        beside = normal + size * random.standard_normal((200, 3))
        beside /= np.linalg.norm(beside, axis=1, keepdims=True)
        assert np.abs(directions(beside) - expected).max() < 10.0 * size + 1e-15
