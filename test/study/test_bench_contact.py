"""``bench`` with contact: held commands."""

import pytest

from softrobot_twin.simulation import Simulation
from softrobot_twin.study.bench_measurement import (
    WHOLE_STEP,
    NoHoldError,
    given_cases,
    held_commands,
    measure,
)


@pytest.fixture(scope="module")
def held(stamp):
    case = given_cases([stamp], stamp.parent / "stamping.csv")[0]
    return measure(case, 5)


def test_a_hold_is_timed_in_contact(held):
    assert held.contact_count > 4  # the cube's corners on the floor, and the pad on the cube
    assert held.row_count >= 3 * held.contact_count
    assert {"detect", "optimise", WHOLE_STEP} <= set(held.stages)
    assert held.statuses["ok"] == 5


def test_a_file_without_a_hold_is_refused(tmp_path, stamp):
    path = tmp_path / "moving.csv"
    path.write_text("time_s,press_x_m,press_y_m,press_z_m\n0,0,0,0\n1,0,0,0.1\n")
    with pytest.raises(NoHoldError, match="no command"):
        held_commands(Simulation.from_scene_file(stamp), path)
