"""A real beam: fitted on its own weight alone, what it does under loads is predicted.

How far off a prediction may be follows from how the beam was held, by hand: to half a millimetre at
best, as is noted beside the data. That is 8 % of its own sag, so of Young's modulus, and as much
of every other sag. The mesh matters less: that is tested here too.

`calibrate` takes the hand for a frame of the markers that is known to half a millimetre: the data do
not tell it, and so the interval of Young's modulus is as wide as the hand makes it.
"""

from pathlib import Path

import numpy as np
import pytest
from real_beam import (
    LOADS,
    MARKER,
    MARKER_POINT,
    SIZE,
    UP,
    BeamModel,
    fit_sags,
    measure,
    predict_beam,
    prediction_table,
    read_beam_recording,
    settled_displacement,
)

from softrobot_twin.calibration.calibration import RestModel, calibrate, forecast
from softrobot_twin.control.rest_watch import RestPose
from softrobot_twin.harness.terminal import console
from softrobot_twin.scene.scene_parameters import changed_scene

DATA = Path(__file__).parents[1] / "data" / "real_beam"
HELD_WITHIN = 0.5e-3
E = "body.material.young_modulus"


@pytest.fixture(scope="module")
def study():
    """The beam on the usual mesh."""
    found = predict_beam(DATA)
    console().print(prediction_table(found))
    return found


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory):
    """The beam with E by its own weight alone, and its poses under each load."""
    folder = tmp_path_factory.mktemp("beam")
    beam, nothing = BeamModel(folder, (2, 2, 6)), np.empty(0)
    height, width, length = SIZE
    edge = [[0.5 * height, y, -length] for y in np.linspace(-0.5 * width, 0.5 * width, 5)]
    scene = changed_scene(beam.scene(2.0e5, 0.0, "quasi_static"), {"touches": [{"name": "load", "points": edge}]})
    poses = {}
    for load in LOADS:
        for run in "ab":
            recording = read_beam_recording(DATA / f"beam_{load.name}_V2_{run}.csv")
            # Their axes are up, to the left and to the tip; those of the scene up, to the right and
            # to the clamp.
            moved = settled_displacement(recording.times, recording.marker(MARKER)) * [1.0, -1.0, -1.0]
            force = np.array([[-load.weight, 0.0, 0.0]])
            poses.setdefault(load, []).append(RestPose(
                nothing, (MARKER_POINT + moved)[None], np.empty((0, 3)), nothing, force,
                f"{load.name} {run}"))  # fmt: skip
    own, *loaded = (poses[load] for load in LOADS)
    known = {f"marker_frame.position[{axis}]": HELD_WITHIN for axis in range(3)}
    found = calibrate(scene, own, [E, "marker_frame.position"], known, [one for runs in loaded for one in runs])
    print(found.values, found.estimate.intervals, found.validation)
    return beam, found, poses


def test_own_weight_alone_gives_a_modulus_with_an_interval(calibrated):
    _, found, _ = calibrated
    # The hand moves up and down as the modulus does: its height is not told, but widens the interval.
    assert found.not_told == (("marker_frame.position[0]",),)
    assert found.is_accepted and not found.set_aside
    low, high = found.estimate.intervals[0]
    published = 263_824.0
    assert low < published < high
    # Half a millimetre of 6.5 is 8 %: the interval is that of the hand, and not much wider.
    assert 1.0 + 1.96 * 0.07 < np.sqrt(high / low) < 1.0 + 1.96 * 0.09


def test_intervals_of_the_predicted_sags_hold_those_under_loads(calibrated):
    _, found, poses = calibrated
    for load in LOADS[1:]:
        model = RestModel(found.start, [one.parameter for one in found.joint.unknowns], poses[load])
        told = forecast(model, found.joint, np.array([one.parameter.read(found.scene) for one in found.joint.unknowns]))
        off, reach = (one.reshape(-1, 3)[:, UP] for one in (told.off, told.reach))
        measured = np.array([pose.markers[0, UP] - MARKER_POINT[UP] for pose in poses[load]])
        console().print(f"{load.name}: measured {-1e3 * measured} mm, predicted "
                        f"{-1e3 * (measured + off)[0]:.2f} ± {1e3 * reach[0]:.2f} mm")
        assert np.all(np.abs(off) < reach)
        assert np.all(reach < 0.2 * np.abs(measured + off))


@pytest.mark.exhaustive
def test_intervals_of_the_predicted_frequencies_hold_those_measured(calibrated):
    beam, found, _ = calibrated
    for load in LOADS:
        measured = measure(DATA, load).frequencies
        low, high = (beam.frequency(float(end), load.weight, measured[0])
                     for end in found.estimate.intervals[0])
        console().print(f"{load.name}: measured {measured} Hz, predicted {low:.2f} to {high:.2f} Hz")
        assert all(low < one < high for one in measured)
        assert high / low < 1.2


@pytest.mark.exhaustive
def test_sags_under_loads_are_predicted_within_the_uncertainty_of_the_clamp(study):
    own, *loaded = study.predictions
    own_sag = np.mean(own.measured.sags)
    assert own.sag == pytest.approx(own_sag, abs=1e-6)
    for row in loaded:
        sag = np.mean(row.measured.sags)
        # What is wrong with the fit grows with the sag; then this load was held by hand too.
        bar = HELD_WITHIN * np.hypot(sag / own_sag, 1.0)
        assert row.sag == pytest.approx(sag, abs=bar)
        # A finer bar than the hand's: what another solver makes of the same beam.
        theirs = row.load.comsol_sag / LOADS[0].comsol_sag
        assert row.sag / own_sag == pytest.approx(theirs, rel=0.03)


@pytest.mark.exhaustive
def test_one_modulus_of_a_hyperelastic_law_gives_the_three_sags_within_three_percent():
    # Of the form of Dragon Skin 10, its silicone, with the modulus as the one parameter.
    fit = fit_sags(DATA, "dragon_skin_10")
    print(fit)
    assert max(map(abs, fit.errors)) < 0.03
    # The error left is that of the loads against each other, which no modulus changes.
    assert max(fit.errors) == pytest.approx(-min(fit.errors), abs=1e-3)
