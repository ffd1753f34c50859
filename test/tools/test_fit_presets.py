"""The table of material presets is what the fit to its curves gives."""

import pytest
from fit_presets import errors, fitted

from softrobot_twin.scene.material_presets import MATERIAL_PRESETS


@pytest.mark.parametrize("name", MATERIAL_PRESETS)
def test_constants_and_errors_of_a_preset_are_those_of_its_fit(name):
    preset = MATERIAL_PRESETS[name]
    fit = fitted(preset)
    assert fit.constants == pytest.approx(preset.constants, rel=1e-4)
    assert fit.rms_error == pytest.approx(preset.rms_error, abs=6e-4)
    assert fit.largest_error == pytest.approx(preset.largest_error, abs=6e-4)
    # No constant near them fits better.
    for key, value in preset.constants.items():
        for factor in (0.98, 1.02):
            other = preset.constants | {key: factor * value + (value == 0.0)}
            assert (errors(preset, other) ** 2).mean() >= 0.9999 * fit.rms_error**2


def test_the_silicones_have_the_reference_stresses():
    # Engineering stress at 50 and 100 % of the Soft Robotics Materials Database [MPa].
    published = {"dragon_skin_10": (0.053, 0.113), "dragon_skin_30": (0.214, 0.437),
                 "ecoflex_00_30": (0.0169, 0.0297), "ecoflex_00_50": (0.0228, 0.0410)}  # fmt: skip
    for name, stresses in published.items():
        curve = dict(MATERIAL_PRESETS[name].curve)
        assert (curve[0.5], curve[1.0]) == pytest.approx(stresses, rel=3e-3)
