"""Facts of elastic constants."""

import pytest

from softrobot_twin.mechanics.material import lame_parameters


def test_constants_give_back_young_and_poisson():
    lame, shear = lame_parameters(180e3, 0.45)
    assert shear * (3 * lame + 2 * shear) / (lame + shear) == pytest.approx(180e3)
    assert lame / (2 * (lame + shear)) == pytest.approx(0.45)
