"""Facts of the recordings of a real beam, and of how they are read."""

from pathlib import Path

import numpy as np
import pytest
from real_beam import (
    UP,
    read_beam_recording,
    ringing,
    settled_displacement,
)

from softrobot_twin.errors import SoftRobotTwinError

DATA = Path(__file__).parents[1] / "data" / "real_beam"
# Load: sag of marker Tip-2 in runs a and b [mm] and frequency [Hz], as published with the data.
PUBLISHED = {
    "gravity": (-6.49, -6.53, 7.7),
    "load52": (-17.22, -17.03, 4.4),
    "load101": (-26.04, -25.11, 3.4),
}


def beam(load, run):
    return read_beam_recording(DATA / f"beam_{load}_V2_{run}.csv")


@pytest.mark.parametrize("run", ["a", "b"])
@pytest.mark.parametrize("load", PUBLISHED)
def test_the_beam_sags_and_vibrates_as_published(load, run):
    recording = beam(load, run)
    tip = recording.marker("Tip-2")
    sag = settled_displacement(recording.times, tip)[UP]
    rung = ringing(recording.times, tip[:, UP])
    assert sag == pytest.approx(1e-3 * PUBLISHED[load]["ab".index(run)], abs=0.1e-3)
    assert rung.frequency == pytest.approx(PUBLISHED[load][2], rel=0.03)
    assert rung.damping_ratio == pytest.approx(0.06, abs=0.02)
    assert rung.swing_count >= 6


def test_the_clamped_end_hardly_moves():
    recording = beam("gravity", "a")
    assert recording.marker_names == ("Tip-1", "Tip-2", "Tip-3", "Base-1", "Base-2", "Base-3")
    for name in recording.marker_names[3:]:
        moved = settled_displacement(recording.times, recording.marker(name))
        assert np.linalg.norm(moved) < 0.2e-3


def test_a_known_vibration_about_a_creeping_rest_is_identified_exactly():
    frequency, ratio = 6.3, 0.05
    omega = 2 * np.pi * frequency / np.sqrt(1 - ratio**2)
    times = np.arange(0.0, 4.0, 0.01)
    fallen = np.maximum(times - 0.5, 0.0)
    swing = np.exp(-ratio * omega * fallen) * np.cos(2 * np.pi * frequency * fallen)
    heights = 0.07 + 0.005 * swing - 0.0001 * fallen
    found = ringing(times, heights)
    assert found.frequency == pytest.approx(frequency, rel=2e-3)
    assert found.damping_ratio == pytest.approx(ratio, rel=0.02)


def test_a_signal_without_vibration_has_no_frequency():
    times = np.arange(0.0, 1.0, 0.01)
    for heights in (np.zeros(100), np.exp(-times)):
        with pytest.raises(ValueError, match="too few"):
            ringing(times, heights)


def test_a_marker_that_does_not_come_to_rest_is_reported():
    recording = beam("gravity", "a")
    still_ringing = recording.times < 2.0
    with pytest.raises(ValueError, match="at rest"):
        settled_displacement(
            recording.times[still_ringing], recording.marker("Tip-2")[still_ringing]
        )


@pytest.mark.parametrize("text", [
    "",
    "t_s,A_x_m,A_y_m\n0,1,2\n",
    "t_s,A_x_m,A_y_m,A_z_m\n0,1,2\n",
    "t_s,A_x_m,A_y_m,A_z_m\n0,1,2,nan\n",
    "t_s,A_x_m,A_y_m,A_z_m\n0,1,2,3\n0,1,2,3\n",
    "t_s,A_x_m,A_y_m,A_z_m\n",
])  # fmt: skip
def test_an_invalid_recording_is_refused(tmp_path, text):
    path = tmp_path / "beam.csv"
    path.write_text(text)
    with pytest.raises(SoftRobotTwinError, match="beam.csv"):
        read_beam_recording(path)
