from dataclasses import replace

import pytest

from softrobot_twin.study.accuracy_study import MESH, REDUCED, AccuracyRow
from softrobot_twin.study.choice import (
    MARGIN,
    Measured,
    NoSettingError,
    measure_candidates,
    pick,
    reference_uncertainty,
)

# Error and time [ms] of one linearization.
FINE = {"coarse": (0.10, 0.5), "middle": (0.05, 1.5), "fine": (0.02, 6.0)}


def rows():
    unknown = float("nan")
    return [AccuracyRow(MESH, "", mesh, "linear", "corotational", 0, 0, ms, ms, error, 5.0 * error, 0.5 * error,
                        unknown, unknown, unknown, unknown)
            for mesh, (error, ms) in FINE.items()]


def clock(setting):
    """A measurement in which two linearizations take twice as long with a hundredth of the
    error.
    """
    time = 1e-3 * FINE[setting.mesh][1] * setting.iterations
    return Measured(time, 1.1 * time, 0.01 * 0.01 ** (setting.iterations - 1))


@pytest.mark.parametrize("rate, mesh, iterations", [
    (20.0, "fine", 3), (50.0, "fine", 2), (100.0, "fine", 1), (200.0, "middle", 2),
    (500.0, "coarse", 2)])
def test_the_most_accurate_setting_that_keeps_the_rate_is_chosen(rate, mesh, iterations):
    best = pick(measure_candidates(rows(), rate, clock), rate)
    assert best.setting.mesh == mesh
    # A third linearization reduces the error too little.
    assert best.setting.iterations == min(iterations, 2)
    assert best.measured.p99 <= MARGIN / rate


def test_the_faster_of_equally_accurate_settings_is_chosen():
    twins = [replace(row, error_lengths=0.1, error_tensions=0.5) for row in rows()[:2]]
    assert pick(measure_candidates(twins, 100.0, clock), 100.0).setting.mesh == "coarse"


def test_a_mesh_with_a_small_error_by_chance_is_rated_by_its_other_load_case():
    lucky = replace(rows()[0], error_lengths=0.001, error_weightless=0.08)
    found = measure_candidates([lucky, rows()[1]], 100.0, clock)
    assert pick(found, 100.0).setting.mesh == "middle"


def test_meshes_that_the_reference_cannot_distinguish_are_rated_by_forces():
    lucky = replace(rows()[0], error_lengths=0.04, error_weightless=0.0)
    known = [replace(row, uncertainty_lengths=0.02, uncertainty_weightless=0.0)
             for row in (lucky, rows()[1])]
    found = measure_candidates(known, 100.0, clock)
    assert pick(found, 100.0, reference_uncertainty(known)).setting.mesh == "middle"
    assert pick(found, 100.0).setting.mesh == "coarse"


def test_only_settings_with_a_known_error_are_candidates():
    assert measure_candidates([replace(rows()[1], error_lengths=float("nan"))], 100.0, clock) == []


def test_a_rate_that_no_setting_keeps_is_refused_with_the_highest_possible_rate():
    with pytest.raises(NoSettingError, match="keeps 1273 Hz") as refused:
        pick(measure_candidates(rows(), 5000.0, clock), 5000.0)
    assert refused.value.rate == 5000.0 and refused.value.nearest.setting.mesh == "coarse"


def reduced_row(**changes):
    """The fine mesh, reduced."""
    return replace(rows()[2], knob=REDUCED, file="fine_reduced.npz", mode_count=45, **changes)


def clock_of_reduced(setting):
    return Measured(3e-4, 4e-4, 1e-4) if setting.reduced else clock(setting)


def test_a_reduced_model_that_keeps_the_rate_is_chosen_before_a_coarser_mesh():
    found = measure_candidates([*rows(), reduced_row()], 500.0, clock_of_reduced)
    best = pick(found, 500.0).setting
    assert (best.mesh, best.reduced) == ("fine", "fine_reduced.npz")
    # The full model of this mesh is another setting, which is late.
    late = [one for one in found if not one.keeps_rate]
    assert [(one.setting.mesh, one.setting.reduced) for one in late] == [("fine", "")]


def test_a_model_whose_error_under_forces_is_not_known_is_not_preferred_for_it():
    alike = replace(reduced_row(), error_tensions=float("nan"))
    found = measure_candidates([*rows(), alike], 100.0, clock_of_reduced)
    assert pick(found, 100.0, reference_uncertainty=0.01).setting.reduced == ""
