"""Colours of pressures."""

import numpy as np
import pytest

from softrobot_twin.simulation.colours import pressure_colours, pressure_legend


def test_no_pressure_is_grey_the_limit_red_and_a_vacuum_blue():
    vacuum, nothing, limit = pressure_colours(
        np.array([-20.0e3, 0.0, 20.0e3]), (-20.0e3, 20.0e3)
    ).astype(int)
    assert vacuum[2] > 180 and vacuum[0] < 80
    assert np.ptp(nothing[:3]) < 15
    assert limit[0] > 200 and limit[1:3].max() < 60
    assert vacuum[3] == nothing[3] == limit[3] == 255


def test_a_pressure_that_is_not_finite_is_magenta():
    assert pressure_colours([np.nan, np.inf], (0.0, 1.0)).tolist() == [[255, 0, 255, 255]] * 2


@pytest.mark.parametrize(("pressures", "words"), [
    ((0.0, 20.0e3), "grey 0, red 20 kPa"),
    ((-5.0e3, 20.0e3), "blue -20, grey 0, red 20 kPa"),
    ((-5.0e3, 0.0), "blue -5, grey 0 kPa"),
])
def test_the_legend_states_both_ends_of_the_scale(pressures, words):
    assert pressure_legend(pressures) == words
