"""Facts of elastic constants."""

import pytest

from softrobot_twin.mechanics.material import lame_parameters


def test_constants_give_back_young_and_poisson():
    lame, shear = lame_parameters(180e3, 0.45)
    assert shear * (3 * lame + 2 * shear) / (lame + shear) == pytest.approx(180e3)
    assert lame / (2 * (lame + shear)) == pytest.approx(0.45)


@pytest.mark.parametrize("young, poisson", [(0, 0.3), (-1, 0.3), (1, 0.5), (1, -1), (1, 0.7)])
def test_impossible_materials_are_refused(young, poisson):
    with pytest.raises(ValueError, match="must"):
        lame_parameters(young, poisson)


def test_not_a_number_is_refused():
    with pytest.raises(ValueError, match="young_modulus"):
        lame_parameters(float("nan"), 0.3)
