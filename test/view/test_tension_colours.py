import numpy as np
import pytest

from softrobot_twin.simulation import colours as module
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


def test_colour_steps_are_perceptually_uniform():
    lab = module.to_oklab(tension_colours(np.linspace(0, 1, 9), (0, 1))[:, :3] / 255.0)
    steps = np.linalg.norm(np.diff(lab, axis=0), axis=1)
    assert np.ptp(steps[:4]) < 0.02 and np.ptp(steps[4:]) < 0.02
    assert steps.min() > 0.02


def test_conversion_to_oklab_and_back_is_exact():
    colours = np.array([[0.1, 0.5, 0.9], [1.0, 0.0, 0.0], [0.01, 0.02, 0.03]])
    assert module.from_oklab(module.to_oklab(colours)) == pytest.approx(colours, abs=1e-6)


def test_white_has_lightness_one_and_no_colour():
    assert module.to_oklab(np.ones((1, 3)))[0] == pytest.approx([1.0, 0.0, 0.0], abs=1e-6)


def test_a_tension_that_is_not_finite_has_a_distinct_colour():
    colours = tension_colours(np.array([np.nan, np.inf]), (0.0, 20.0))
    assert colours.tolist() == [[255, 0, 255, 255]] * 2


def test_repeated_calls_give_the_same_colours():
    first = tension_colours(np.array([np.nan, 0.0]), (0.0, 1.0))
    assert (tension_colours(np.array([np.nan, 0.0]), (0.0, 1.0)) == first).all()
