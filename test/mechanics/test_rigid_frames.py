"""Facts of rigid bodies' frame nodes."""

import numpy as np
import pytest

from softrobot_twin.mechanics.rigid_bodies import RigidFrames
from softrobot_twin.mechanics.rotation import rotation_from_vector

FREE = np.array([True, False, True])
POSES = [
    (np.array([1.0, 2.0, 3.0]), rotation_from_vector([0.1, -2.0, 0.4])),
    (np.array([-1.0, 0.5, 0.0]), rotation_from_vector([1.0, 0.0, 0.2])),
    (np.array([0.0, -0.3, 0.2]), rotation_from_vector([0.0, 0.0, 3.0])),
]


@pytest.fixture
def frames():
    """Three bodies behind five nodes and three unknowns, the middle one guided."""
    return RigidFrames(5, FREE, 3, 7)


@pytest.fixture
def positions(frames):
    soft = np.random.default_rng(0).standard_normal((5, 3))
    return np.vstack([soft, frames.rest_nodes(POSES)])


def test_the_pose_read_is_the_pose_placed(frames, positions):
    for body, (origin, rotation) in enumerate(POSES):
        read_origin, read = frames.pose(positions, body)
        np.testing.assert_array_equal(read_origin, origin)
        np.testing.assert_allclose(read, rotation, atol=1e-15)


def test_a_point_of_the_body_is_placed_by_its_pose(frames, positions):
    local = np.array([[0.0, 0.0, 0.0], [0.02, -0.03, 0.5], [4.0, 5.0, -6.0]])
    for body in range(3):
        turned = rotation_from_vector([0.3, 0.2, body])
        frames.place(positions, body, [0.1, 0.2, 0.3], turned)
        carried = frames.points(body, local).positions(positions)
        np.testing.assert_allclose(carried, [0.1, 0.2, 0.3] + local @ turned.T, atol=1e-14)


def test_a_move_rotates_about_the_body_s_origin_and_changes_no_other_body(frames, positions):
    before = positions.copy()
    move = np.random.default_rng(1).standard_normal((7, 3))
    frames.advance(positions, move, 0.5)
    for body, t in ((0, 3), (2, 5)):
        origin, rotation = frames.pose(positions, body)
        np.testing.assert_allclose(origin, POSES[body][0] + 0.5 * move[t], atol=1e-15)
        expected = rotation_from_vector(0.5 * move[t + 1]) @ POSES[body][1]
        np.testing.assert_allclose(rotation, expected, atol=1e-15)
    np.testing.assert_array_equal(positions[:5], before[:5])
    np.testing.assert_array_equal(positions[9:13], before[9:13])


def test_the_displacement_after_a_move_is_the_move(frames, positions):
    before = positions.copy()
    move = np.random.default_rng(2).standard_normal((7, 3))
    frames.advance(positions, move, 1.0)
    found = np.full((7, 3), 9.0)
    frames.displacement(before, positions, found)
    np.testing.assert_allclose(found[3:], move[3:], atol=2e-15)
    np.testing.assert_array_equal(found[:3], 9.0)


def test_many_small_turns_stay_a_rotation_and_add_up(frames, positions):
    move = np.zeros((7, 3))
    move[4] = [1e-4, 0.0, 0.0]
    move[6] = [2e-3, -1e-3, 5e-4]
    move[5] = [1e-6, 2e-6, -1e-6]
    steps = 200_000
    for _ in range(steps):
        frames.advance(positions, move, 1.0)
    for body, t in ((0, 4), (2, 6)):
        _, rotation = frames.pose(positions, body)
        np.testing.assert_allclose(rotation.T @ rotation, np.eye(3), atol=2e-15)
        expected = rotation_from_vector(steps * move[t]) @ POSES[body][1]
        # Rounding of each step adds up like a random walk.
        np.testing.assert_allclose(rotation, expected, atol=1e-12)
