import numpy as np
import pytest

from softrobot_twin.view.picture import RecentPath

pytestmark = pytest.mark.libraries

SECOND = 1_000_000_000


def walk(effector_path, times):
    for time in times:
        positions = np.array([[time, 0.0, 0.0], [0.0, time, 0.0]])
        strips = effector_path.extend(int(time * SECOND), positions)
    return strips


def test_a_trail_leads_from_the_oldest_point_to_the_present_one():
    first, second = walk(RecentPath(5.0), np.arange(0.0, 2.0, 0.1))
    assert first[0] == pytest.approx([0.0, 0.0, 0.0])
    assert first[-1] == pytest.approx([1.9, 0.0, 0.0])
    assert (np.diff(first[:, 0]) > 0).all()
    assert second[-1] == pytest.approx([0.0, 1.9, 0.0])


def test_points_older_than_the_duration_are_dropped():
    first, _ = walk(RecentPath(5.0), np.arange(0.0, 60.0, 0.1))
    assert first[0, 0] == pytest.approx(54.9, abs=0.11)


def test_the_number_of_points_is_bounded():
    first, _ = walk(RecentPath(5.0, point_count=50), np.arange(0.0, 20.0, 0.001))
    assert 45 <= len(first) <= 52


def test_a_clock_that_steps_back_restarts_the_trail():
    effector_path = RecentPath(5.0)
    walk(effector_path, [10.0, 11.0])
    first, _ = walk(effector_path, [3.0])
    assert first.tolist() == [[3.0, 0.0, 0.0]]


def test_positions_are_copied():
    effector_path = RecentPath(5.0)
    positions = np.zeros((1, 3))
    effector_path.extend(0, positions)
    positions[:] = 7.0
    assert effector_path.extend(SECOND, positions)[0].tolist() == [[0.0] * 3, [7.0] * 3]
