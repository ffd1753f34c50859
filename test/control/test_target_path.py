"""Paths of targets: circle, lemniscate, waypoints from a file, and sequences."""

import math

import numpy as np
import pytest

from softrobot_twin.control.target_path import (
    Circle,
    ClosedCurve,
    Lemniscate,
    RampedIn,
    ToAndFro,
    has_orientations,
    make_path,
    make_sequence,
)
from softrobot_twin.errors import ParameterError

AROUND = ClosedCurve((0.0, 0.0, 0.13), 0.02, 10.0)


def sampled(path, end, step=0.01):
    return np.array([path.position(time) for time in np.arange(0.0, end, step)])


def test_a_circle_keeps_its_radius_and_is_closed():
    positions = sampled(make_path("circle", "tip", AROUND), 10.0) - AROUND.centre
    assert np.linalg.norm(positions, axis=1) == pytest.approx(0.02)
    circle = Circle((0.0, 0.0, 0.13), 0.02, 10.0)
    assert circle.position(10.0) == pytest.approx(circle.position(0.0))
    assert circle.position(2.5) == pytest.approx([0.0, 0.02, 0.13])


def test_a_lemniscate_crosses_its_centre_twice_and_fits_its_radius():
    path = Lemniscate((0.0, 0.0, 0.13), 0.02, 10.0)
    for quarter in (2.5, 7.5):
        assert path.position(quarter) == pytest.approx([0.0, 0.0, 0.13])
    positions = sampled(path, 10.0) - AROUND.centre
    assert np.abs(positions[:, 0]).max() == pytest.approx(0.02)
    assert np.abs(positions[:, 1]).max() == pytest.approx(0.01, rel=1e-4)


@pytest.mark.parametrize(("plane", "still"), [("xy", 2), ("xz", 1), ("yz", 0)])
def test_a_path_stays_in_its_plane(plane, still):
    path = Circle((0.1, 0.2, 0.3), 0.02, 10.0, plane)
    assert sampled(path, 10.0, 0.5)[:, still] == pytest.approx((0.1, 0.2, 0.3)[still])


def test_a_path_starts_without_a_jump_in_position_or_speed():
    start = np.array([0.0, 0.0, 0.125])
    step = 0.01
    positions = sampled(RampedIn(start, make_path("circle", "tip", AROUND), 2.0), 4.0, step)
    assert positions[0] == pytest.approx(start)
    speeds = np.diff(positions, axis=0) / step
    assert np.linalg.norm(speeds[0]) < 1e-4
    assert np.linalg.norm(np.diff(speeds, axis=0) / step, axis=1).max() < 0.1
    assert positions[250] == pytest.approx(make_path("circle", "tip", AROUND).position(2.5))


def test_paths_alternate_without_a_jump():
    path = make_sequence(["circle", "lemniscate"], "tip", AROUND, duration=7.0, ramp_time=1.0)
    step = 0.01
    speeds = np.diff(sampled(path, 21.0, step), axis=0) / step
    assert np.linalg.norm(speeds, axis=1).max() < 0.1
    assert np.linalg.norm(np.diff(speeds, axis=0), axis=1).max() / step < 0.3
    assert path.position(5.0) == pytest.approx(make_path("circle", "tip", AROUND).position(5.0))
    lemniscate = make_path("lemniscate", "tip", AROUND)
    assert path.position(7.0 + 3.0) == pytest.approx(lemniscate.position(3.0))
    assert path.position(14.0 + 3.0) == pytest.approx(
        make_path("circle", "tip", AROUND).position(3.0)
    )


@pytest.mark.parametrize("make, told", [
    (lambda: ClosedCurve((0.0, 0.0, math.nan), 0.02, 10.0), "target_center"),
    (lambda: ClosedCurve((0.0, 0.0), 0.02, 10.0), "target_center"),
    (lambda: ClosedCurve((0.0, 0.0, 0.0), 0.0, 10.0), "target_radius"),
    (lambda: ClosedCurve((0.0, 0.0, 0.0), 0.02, -1.0), "target_period"),
    (lambda: ClosedCurve((0.0, 0.0, 0.0), 0.02, 10.0, "zz"), "target_plane"),
    (lambda: ToAndFro((0.0, np.nan), 1.0), "target_setpoints"),
    (lambda: ToAndFro((0.0,), 1.0), "target_setpoints"),
    (lambda: ToAndFro((0.0, 1.0), 0.0), "target_setpoint_period"),
    (lambda: make_path("spiral", "tip", AROUND), "spiral"),
    (lambda: make_path("/nowhere/path.csv", "tip", AROUND), "cannot be read"),
    (lambda: make_sequence(["circle", "lemniscate"], "tip", AROUND, duration=1.0, ramp_time=1.0),
     "target_sequence_time"),
])  # fmt: skip
def test_an_invalid_path_is_refused_by_parameter(make, told):
    with pytest.raises(ParameterError, match=told):
        make()


HEADER = "time_s,tip_x_m,tip_y_m,tip_z_m,other_x_m"
TURN_HEADER = "time_s,tip_x_m,tip_y_m,tip_z_m,tip_qx,tip_qy,tip_qz,tip_qw"


def read_file(tmp_path, text):
    file = tmp_path / "path.csv"
    file.write_text(text)
    return make_path(str(file), "tip", AROUND)


def test_a_file_is_followed_in_straight_lines_and_kept_at_its_end(tmp_path):
    path = read_file(tmp_path, f"{HEADER}\n0.0,0.0,0.0,0.1,9\n2.0,0.02,0.0,0.1,9\n")
    assert path.position(0.5) == pytest.approx([0.005, 0.0, 0.1])
    assert path.position(100.0) == pytest.approx([0.02, 0.0, 0.1])


@pytest.mark.parametrize("text, reason", [
    ("time_s,tip_x_m,tip_y_m\n0,0,0\n", "tip_z_m: the header lacks"),
    (f"{HEADER}\n", "no row"),
    ("", "is empty"),
    (f"{HEADER}\n0,0,0,zero,0\n", "row 2: tip_z_m = 'zero' m: must be a number"),
    (f"{HEADER}\n0,0\n", "has 2 cells"),
    (f"{HEADER}\n0,0,0,nan,0\n", "must be finite"),
    (f"{HEADER}\n1,0,0,0,0\n1,0,0,0,0\n", "must be later"),
    ("time_s,tip_x_m,tip_y_m,tip_z_m,tip_qx,tip_qy,tip_qz\n0,0,0,0.1,0,0,0\n", "tip_qw"),
    *((f"{TURN_HEADER}\n0,0,0,0.1,0,0,0,1\n2,0.02,0,0.1,{second}\n", reason) for second, reason in (
        ("0,0,0,0", "unit length"), ("0,0,0,2", "unit length"), ("0,0,0,nan", "must be finite"))),
])  # fmt: skip
def test_an_invalid_path_file_is_refused_with_the_reason(tmp_path, text, reason):
    with pytest.raises(ParameterError, match=reason):
        read_file(tmp_path, text)


QUARTER = (0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5))


def turning_file(tmp_path, second=QUARTER):
    cells = ",".join(map(str, second))
    return read_file(tmp_path, f"{TURN_HEADER}\n0,0,0,0.1,0,0,0,1\n2,0.02,0,0.1,{cells}\n")


def test_a_file_with_quaternions_turns_evenly_about_one_axis(tmp_path):
    path = turning_file(tmp_path)
    for time, angle in ((0.0, 0.0), (0.5, np.pi / 8.0), (1.0, np.pi / 4.0), (9.0, np.pi / 2.0)):
        expected = [0.0, 0.0, np.sin(0.5 * angle), np.cos(0.5 * angle)]
        assert path.orientation(time) == pytest.approx(expected, abs=1e-12)
    assert path.position(1.0) == pytest.approx([0.01, 0.0, 0.1])
    assert has_orientations(path)


def test_a_ramp_turns_smoothly_from_the_start(tmp_path):
    start = np.array([np.sin(0.2), 0.0, 0.0, np.cos(0.2)])
    ramped = RampedIn(np.zeros(3), turning_file(tmp_path), 0.5, start)
    assert ramped.orientation(0.0) == pytest.approx(start)
    turns = np.array([ramped.orientation(time) for time in np.linspace(0.0, 1.0, 201)])
    steps = 2.0 * np.arccos(np.abs(np.sum(turns[1:] * turns[:-1], axis=1)).clip(max=1.0))
    assert steps.max() < 0.02
    assert ramped.orientation(2.0) == pytest.approx(QUARTER)


def test_a_setpoint_moves_to_and_fro_between_its_ends():
    to_and_fro = ToAndFro((0.9, 0.8), 4.0)
    assert [to_and_fro.value(time) for time in (0.0, 1.0, 2.0, 4.0)] == pytest.approx(
        [0.9, 0.85, 0.8, 0.9])
    times = np.linspace(0.0, 8.0, 400)
    rates = np.diff([to_and_fro.value(time) for time in times]) / np.diff(times)
    assert abs(rates[0]) < 5e-3 and np.abs(rates).max() == pytest.approx(0.1 * np.pi / 4, rel=1e-2)


@pytest.mark.parametrize(("columns", "cells", "expected"), [
    ("", "", [9, 9, 9]), (",tip_target_x_m,tip_target_y_m,tip_target_z_m", ",1,2,3", [1, 2, 3])])
def test_the_targets_of_a_run_can_be_played_again(tmp_path, columns, cells, expected):
    path = read_file(tmp_path, f"step,time_s,tip_x_m,tip_y_m,tip_z_m{columns},residual_N,status\n"
                     f"0,0.1,9,9,9{cells},nan,ok\n")
    assert path.position(0.0) == pytest.approx(expected)
