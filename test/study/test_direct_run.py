"""``simulate --commands``: driven bodies, contacts, and the columns of a run."""

import numpy as np
import pytest

from softrobot_twin.errors import CommandError
from softrobot_twin.simulation import Simulation
from softrobot_twin.study.direct_run import run_commands, step_times
from softrobot_twin.study.run_summary import RunSummary
from softrobot_twin.tables.input_tables import read_commands
from test.run_files import rows_of

WEIGHT = 0.05 * 9.81


@pytest.fixture(scope="module")
def stamped(stamp):
    """Rows of the stamping at 200 Hz, and their summary."""
    simulation = Simulation.from_scene_file(stamp)
    table = read_commands(stamp.parent / "stamping.csv", simulation)
    summary = RunSummary(simulation, table.longest_hold)
    rows = []
    for row in run_commands(simulation, table, 200.0):
        summary.add(row)
        rows.append(row)
    return rows, summary


def row_at(rows, time):
    return min(rows, key=lambda row: abs(row.time - time))


def force_at(rows, time, pair):
    """Upward part of the resultant on the pair's first body [N]."""
    return row_at(rows, time).pair_resultants[pair, 2]


def test_the_floor_carries_the_weight_and_the_pressing_force(stamped):
    rows, _ = stamped
    assert force_at(rows, 0.1, 0) == 0.0
    # Friction holds the corners apart. Its forces cancel, so their size is not unique.
    pressed = abs(force_at(rows, 0.5, 0))
    assert pressed > WEIGHT
    for time, weight in ((0.1, WEIGHT), (0.5, WEIGHT + pressed), (0.7, WEIGHT)):
        row = row_at(rows, time)
        # The stamp's friction may push the cube to a side, and the floor's holds it: not unique.
        on_stamp, on_cube_by_floor = row.pair_resultants
        np.testing.assert_allclose(on_cube_by_floor - on_stamp, [0.0, 0.0, WEIGHT], atol=1e-3 * WEIGHT)
        assert on_cube_by_floor[2] == pytest.approx(weight, rel=1e-3)
        magnitudes = row.pair_magnitude_sums[1]
        assert (1.0 - 1e-3) * weight < magnitudes < (1.0 + 1e-3) * np.hypot(1.0, 0.5) * weight


def test_a_guided_body_ends_at_its_command(stamped):
    rows, _ = stamped
    for time, height in ((0.15, -0.0015), (0.5, -0.003), (0.7, 0.0)):
        row = min(rows, key=lambda row: abs(row.time - time))
        np.testing.assert_allclose(row.rigid_poses[0], [0, 0, height, 0, 0, 0, 1], atol=1e-12)


def test_a_cube_between_stamp_and_floor_neither_rises_nor_creeps(stamped):
    _, summary = stamped
    ((rise, _),) = summary.heights().values()
    assert abs(rise) < 1e-4
    assert set(summary.creep()) == {"cube"} and summary.creep()["cube"] < 1e-4


def test_heights_are_measured_against_gravity_from_the_initial_position(stamp):
    simulation = Simulation.from_scene_file(stamp)
    table = read_commands(stamp.parent / "stamping.csv", simulation)
    summary = RunSummary(simulation, (0.01, 0.02))
    for row in run_commands(simulation, table, 100.0):
        lifted = row.rigid_poses.copy()
        lifted[1, 2] += 0.05 * min(row.time, 0.35)
        summary.add(row._replace(rigid_poses=lifted))
    height, time = summary.heights()["cube"]
    assert height == pytest.approx(0.05 * 0.35, abs=2e-4) and time >= 0.35 - 1e-9
    assert summary.creep()["cube"] == pytest.approx(0.05 * 0.01, abs=1e-5)


def test_steps_are_even_and_end_with_the_last_row(stamp):
    simulation = Simulation.from_scene_file(stamp)
    table = read_commands(stamp.parent / "stamping.csv", simulation)
    times = step_times(table, 30.0)
    assert len(times) == 21 and times[-1] == pytest.approx(0.7)
    assert np.ptp(np.diff(times)) < 1e-12
    assert len(step_times(table, 200.0)) == 140
    with pytest.raises(CommandError, match="time_s: 0.7 s are more than 10,000,000 steps at 1e\\+09 Hz"):
        step_times(table, 1e9)


def test_a_run_writes_all_columns(tmp_path, stamp, call):
    call("simulate", stamp, "--commands", stamp.parent / "stamping.csv", "--rate", 100,
         "--output", tmp_path / "run.csv")
    rows = rows_of(tmp_path / "run.csv")
    pose = ("x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")
    assert list(rows[0]) == [
        "step", "time_s", *(f"press_{p}" for p in pose), *(f"cube_{p}" for p in pose),
        "contact_count",
        "force_on_pad_by_cube_x_N", "force_on_pad_by_cube_y_N", "force_on_pad_by_cube_z_N",
        "sum_of_magnitudes_pad_cube_N",
        "force_on_cube_by_floor_x_N", "force_on_cube_by_floor_y_N", "force_on_cube_by_floor_z_N",
        "sum_of_magnitudes_cube_floor_N",
        "contact_residual_m", "residual_N", "iterations", "compute_time_s", "active_limits",
        "driven_by", "status"]
    assert len(rows) == 70 and float(rows[-1]["time_s"]) == pytest.approx(0.7)
    assert int(rows[8]["contact_count"]) == 4  # a cube stands on its corners
    assert float(rows[8]["force_on_cube_by_floor_z_N"]) == pytest.approx(WEIGHT, rel=1e-3)
