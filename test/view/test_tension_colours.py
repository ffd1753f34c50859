import numpy as np
import pytest

from softrobot_twin.simulation.colours import tension_colours

pytestmark = pytest.mark.libraries


def test_slack_is_grey_and_the_limit_is_red():
    slack, limit = tension_colours(np.array([0.0, 20.0]), (0.0, 20.0)).astype(int)
    assert np.ptp(slack[:3]) < 15
    assert limit[0] > 200 and limit[1:3].max() < 60
    assert slack[3] == limit[3] == 255


def test_values_beyond_the_scale_have_the_colours_of_its_ends():
    colours = tension_colours(np.array([-5.0, 0.0, 20.0, 1e9]), (0.0, 20.0))
    assert (colours[0] == colours[1]).all() and (colours[2] == colours[3]).all()


def test_a_tension_that_is_not_finite_has_a_distinct_colour():
    colours = tension_colours(np.array([np.nan, np.inf]), (0.0, 20.0))
    assert colours.tolist() == [[255, 0, 255, 255]] * 2
