import numpy as np
import pytest

from softrobot_twin.geometry.helix import across, helix_points


@pytest.mark.parametrize("turn", [1, -1])
def test_a_helix_has_its_radius_pitch_and_handedness(turn):
    points = helix_points([0.1, 0.2, 0.3], [0, 0, 2.0], 0.05, 0.04, (-0.01, 0.11), 0.5, turn, 24)
    local = points - [0.1, 0.2, 0.3]
    np.testing.assert_allclose(np.linalg.norm(local[:, :2], axis=1), 0.05)
    np.testing.assert_allclose(local[[0, -1], 2], [-0.01, 0.11])
    assert len(points) == 3 * 24 + 1
    angles = np.unwrap(np.arctan2(local[:, 1], local[:, 0]))
    assert angles[0] == pytest.approx(0.5)
    np.testing.assert_allclose(np.diff(angles), turn * 2.0 * np.pi / 24)


def test_angles_about_an_axis_near_x_begin_at_y():
    np.testing.assert_allclose(across(np.array([1.0, 0.0, 0.0])), [0, 1, 0])
    np.testing.assert_allclose(across(np.array([0.0, 0.6, 0.8])), [1, 0, 0])


def test_a_short_helix_has_two_segments():
    assert len(helix_points([0, 0, 0], [0, 0, 1], 1.0, 100.0, (0.0, 1.0), 0.0, 1, 24)) == 3
