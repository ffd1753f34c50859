"""The demo's report, checked on artificial runs with known errors."""

import json
from dataclasses import replace

import numpy as np
import pytest

from softrobot_twin.study.tracking import (
    RecordError,
    TimedValues,
    TrackingRecord,
    distances,
    draw_tracking,
    tracking_figures,
    tracking_report,
    write_report,
)

TWIN = {"compute_time_ms": {"median": 4.0, "p99": 6.0, "max": 9.0}, "period_ms": 20.0,
        "ticks": 1500, "missed_ticks": 2, "skipped_ticks": 1,
        "mesh": {"nodes": 1600, "tets": 4500, "dof": 4700}}


def line(times, speed=(0.01, 0.0, 0.0), offset=(0.0, 0.0, 0.0)):
    times = np.asarray(times, dtype=float)
    return TimedValues(times, np.outer(times, speed) + np.asarray(offset))


def record(offset, end=4.0):
    times = np.arange(0.0, end, 0.02)
    cables = TimedValues(times, np.column_stack([0.09 + 0.001 * times, 0.08 - 0.001 * times]))
    return TrackingRecord(target=line(times), twin=line(times, offset=(0.0, 0.0, 0.0001)),
                          device=line(times + 0.007, offset=offset),
                          actuator_names=("north", "south"), setpoint_units=("m", "Pa"),
                          effort_units=("N", "Pa"), setpoints=cables, efforts=cables)


def test_an_error_is_measured_between_the_targets_samples():
    errors = distances(line([0.0, 1.0, 2.0]), line([0.25, 1.75], offset=(0.0, 0.003, 0.004)))
    np.testing.assert_allclose(errors.values[:, 0], 0.005, rtol=1e-12)


def test_times_without_a_target_do_not_count():
    errors = distances(line([1.0, 2.0]), line([0.5, 1.0, 1.5, 2.5], offset=(0.0, 1.0, 0.0)))
    np.testing.assert_array_equal(errors.times, [1.0, 1.5])


def test_a_delay_counts_as_error():
    late = TimedValues(np.array([0.5, 1.5]), np.array([[0.004, 0, 0], [0.014, 0, 0]]))
    errors = distances(line([0.0, 2.0]), late)
    np.testing.assert_allclose(errors.values[:, 0], 0.001, rtol=1e-12)


def test_without_targets_the_device_is_compared_with_the_twin(tmp_path):
    runs = {"direct": replace(record((0.0, 0.0, -0.002)), target=None)}
    report = tracking_report("octoleg", runs, TWIN)
    assert report["direct"]["mean_error_mm"] == pytest.approx(2.1)
    assert report["direct"]["seconds"] == pytest.approx(3.98)
    assert report["open_loop"] is report["quasi_static"] is report["closed_to_open_ratio"] is None
    draw_tracking("octoleg", runs, tmp_path / "tracking.png")
    assert (tmp_path / "tracking.png").read_bytes().startswith(b"\x89PNG")


def test_a_run_without_device_measurements_is_refused_by_name():
    blind = record((0.0, 0.0, 0.0))
    blind = replace(blind, device=TimedValues(np.empty(0), np.empty((0, 3))))
    with pytest.raises(RecordError, match="closed_loop"):
        tracking_figures("closed_loop", blind)


def test_the_report_is_json_with_the_ratio_of_closed_to_open_loop(tmp_path):
    runs = {"open_loop": record((0.0, 0.0, -0.002)), "closed_loop": record((0.0, 0.0, -0.0003))}
    report = tracking_report("diamond", runs, TWIN)
    write_report(tmp_path / "report.json", report)
    read = json.loads((tmp_path / "report.json").read_text())
    assert read == report
    assert read["closed_to_open_ratio"] == pytest.approx(0.15)
    assert read["compute_time_ms"] == pytest.approx({"median": 4.0, "p99": 6.0, "max": 9.0})
    assert (read["period_ms"], read["ticks"], read["missed_ticks"]) == (20.0, 1500, 2)
    assert read["mesh"] == {"nodes": 1600, "tets": 4500, "dof": 4700}
    assert read["versions"]["numpy"] == np.__version__
