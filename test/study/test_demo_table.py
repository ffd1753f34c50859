"""The samples of a demo as a file of a run."""


import numpy as np
import pytest

from softrobot_twin.control.target_path import read_waypoints
from softrobot_twin.simulation.building.cable_actuator import CableActuator
from softrobot_twin.study.demo_table import write_demo_table
from softrobot_twin.study.run_plot import panels_of, read_series
from softrobot_twin.study.tracking import TimedValues, TrackingRecord
from test.run_files import rows_of

KINDS = {"north": CableActuator(), "south": CableActuator()}


def line(times, offset):
    return TimedValues(times, np.outer(times, (0.01, 0.0, 0.0)) + np.asarray(offset))


def record(is_direct=False):
    """A second at 50 Hz; the device is 3 mm off and published in between."""
    times = 7.0 + np.arange(0.0, 1.0, 0.02)
    cables = TimedValues(times, np.column_stack([0.09 + 0.0 * times, 0.08 + 0.0 * times]))
    return TrackingRecord(None if is_direct else line(times, (0.0, 0.0, 0.0)),
                          line(times, (0.0, 0.0, 0.001)), line(times + 0.007, (0.0, 0.003, 0.0)),
                          ("north", "south"), ("m", "m"), ("N", "N"), cables, cables)


@pytest.mark.parametrize("is_direct", [False, True])
def test_a_row_has_targets_twin_device_and_actuators_at_one_time(tmp_path, is_direct):
    write_demo_table(tmp_path / "run.csv", record(is_direct), "tip", KINDS)
    rows = rows_of(tmp_path / "run.csv")
    targets = () if is_direct else ("tip_target_x_m", "tip_target_y_m", "tip_target_z_m")
    assert tuple(rows[0]) == (
        "step", "time_s", "tip_x_m", "tip_y_m", "tip_z_m", *targets, "tip_device_x_m",
        "tip_device_y_m", "tip_device_z_m", "tip_error_m", "north_length_m", "north_tension_N",
        "south_length_m", "south_tension_N", "driven_by")
    assert len(rows) == 49 and float(rows[0]["time_s"]) == 0.0, "the device begins 7 ms later"
    assert {row["driven_by"] for row in rows} == {"setpoints" if is_direct else "targets"}
    row = {name: float(cell) for name, cell in rows[10].items() if name != "driven_by"}
    assert row["tip_device_x_m"] == pytest.approx(row["tip_x_m"])
    off = np.hypot(0.003, 0.001) if is_direct else 0.003
    assert row["tip_error_m"] == pytest.approx(off)
    assert (row["north_length_m"], row["south_length_m"]) == (0.09, 0.08)


def test_the_targets_of_a_demo_can_be_followed_again_and_drawn(tmp_path):
    write_demo_table(tmp_path / "open_loop.csv", record(), "tip", KINDS)
    path = read_waypoints(tmp_path / "open_loop.csv", "tip")
    np.testing.assert_allclose(path.position(0.1), [0.01 * 7.12, 0.0, 0.0], atol=1e-12)
    titles = [panel.title for panel in panels_of(read_series(tmp_path / "open_loop.csv"))]
    assert titles == ["position", "error", "length", "tension"]
