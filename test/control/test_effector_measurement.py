"""Effectors by the markers that move with them."""

import numpy as np
import pytest

from softrobot_twin.control.effector_measurement import EffectorMeasurement
from softrobot_twin.control.marker_input import MarkerInput
from softrobot_twin.scene import scene_from_mapping
from softrobot_twin.simulation import Simulation

BELIEVED = np.array([[0.0, 0.0, 0.125]])


@pytest.fixture
def measurement(simulation):
    return EffectorMeasurement(simulation)


def misfit_of(**vectors):
    """Misfit with these vectors [m] by marker, the others hidden."""
    measured = np.full((8, 3), np.nan)
    for marker, vector in vectors.items():
        measured[int(marker[1:])] = vector
    return MarkerInput.misfit(measured, np.zeros((8, 3)))


def test_an_effector_is_moved_by_the_mean_misfit_of_its_visible_markers(measurement):
    # Markers 4 to 7 stand around the tip; marker 0 does not.
    misfit = misfit_of(m0=[9.0, 9.0, 9.0], m4=[0.001, 0.0, 0.0], m6=[0.003, 0.002, 0.0])
    assert measurement.effectors(BELIEVED, misfit) == pytest.approx(
        BELIEVED + [[0.002, 0.001, 0.0]]
    )


def test_an_effector_without_a_visible_marker_is_not_measured(measurement):
    misfit = misfit_of(m0=[0.001, 0.0, 0.0])
    assert np.isnan(measurement.effectors(BELIEVED, misfit)).all()
    assert not measurement.is_complete(misfit.vectors)
    assert measurement.is_complete(misfit_of(m7=[0.0, 0.0, 0.0]).vectors)


def test_an_error_is_measured_where_it_can_be_and_else_believed(measurement):
    targets = BELIEVED + [[0.003, 0.0, 0.004]]
    assert measurement.errors(targets, BELIEVED, np.full((1, 3), np.nan)) == pytest.approx(0.005)
    assert measurement.errors(targets, BELIEVED, targets) == pytest.approx(0.0)
    assert np.isnan(measurement.errors(np.full((1, 3), np.nan), BELIEVED, targets)).all()


def test_a_direction_that_is_not_controlled_has_no_error(small_scene_mapping):
    mapping = {**small_scene_mapping}
    mapping["effectors"] = [{**small_scene_mapping["effectors"][0], "directions": ["x", "z"]}]
    measurement = EffectorMeasurement(Simulation.from_scene(scene_from_mapping(mapping)))
    targets = BELIEVED + [[0.003, 0.1, 0.004]]
    assert measurement.differences(targets, BELIEVED) == pytest.approx(
        np.array([[0.003, 0.0, 0.004]])
    )
    assert measurement.controlled(targets, BELIEVED) == pytest.approx(
        np.array([[0.003, 0.0, 0.129]])
    )
    assert measurement.errors(targets, BELIEVED, BELIEVED) == pytest.approx(0.005)
