"""The straight way to a far target."""

import numpy as np
import pytest

from softrobot_twin.control.approach import approach

HERE = np.array([[0.0, 0.0, 0.1], [0.1, 0.0, 0.0], [0.0, 0.0, 0.0]])
AIMS = np.array([[0.03, 0.04, 0.1], [0.1, 0.001, 0.0], [np.nan] * 3])


def test_a_far_aim_is_approached_and_a_near_one_is_taken():
    points = approach(HERE, AIMS, 0.01)
    assert points[0] == pytest.approx([0.006, 0.008, 0.1])
    assert points[1].tolist() == AIMS[1].tolist()
    assert np.isnan(points[2]).all()


def test_without_a_limit_every_aim_is_taken_as_it_is():
    assert np.array_equal(approach(HERE, AIMS, np.inf), AIMS, equal_nan=True)


def test_an_aim_that_is_reached_stays():
    assert approach(HERE, HERE, 0.01).tolist() == HERE.tolist()
