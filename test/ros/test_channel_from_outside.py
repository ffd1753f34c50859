"""A channel from outside of the package is one entry, in `test/force_channel.py`.

Tables, Python, topics, records and replays show it, and the twin takes what is measured of it.
"""

import csv

import numpy as np
import pytest
from rclpy.time import Time
from sensor_msgs.msg import JointState
from std_msgs.msg import Header

import softrobot_twin as st
from softrobot_twin.control.arrival import Refusal
from softrobot_twin.record.replay import Replay
from softrobot_twin.record.run_file import CALL, TICK, RunFile
from softrobot_twin.record.tick_table import TickTable
from softrobot_twin.scene import load_scene
from softrobot_twin.simulation import CommandSetpoints, Simulation
from softrobot_twin.tables import channels
from softrobot_twin.tables.channels import register_channel
from softrobot_twin.tables.run_columns import RunColumns
from test.force_channel import FORCE, LEVER
from test.registrations import taken_back

MEASURED = {"along": 1.5, "across": -0.25}


@pytest.fixture
def force():
    with taken_back():
        register_channel(FORCE)
        yield FORCE


def test_tables_and_results_have_its_columns(force, small_scene_file):
    robot = st.load(small_scene_file)
    result = robot.step(st.setpoints(north_shortening_m=0.002))
    tension = result["north_tension_N"]
    assert tension > 0.0 and result["north_force_along_N"] == LEVER * tension
    assert result["north_force_across_N"] == -LEVER * tension
    simulation = Simulation(load_scene(small_scene_file))
    made = simulation.step(CommandSetpoints(simulation.rest_setpoints - 0.002, 0.02))
    columns = RunColumns(simulation)
    row = dict(zip(columns.names, columns.texts(columns.row(0, 0.02, made)), strict=True))
    for name in simulation.actuator_names:
        assert float(row[f"{name}_force_along_N"]) == LEVER * float(row[f"{name}_tension_N"])


def message(twin, values=MEASURED, frame="base_link", age=0, **fields):
    """What a cell says; the order of its numbers is free."""
    stamp = Time(nanoseconds=twin.ros_time() - age).to_msg()
    names = sorted(values)
    return JointState(
        header=Header(frame_id=frame, stamp=stamp), name=names,
        position=[values[name] for name in names], **fields,
    )  # fmt: skip


def measured_by(twin):
    """Whether the newest tick has measured forces; False where there is none yet."""
    newest = twin.window.newest
    return newest is not None and np.isfinite(newest.measured["force"]).any()


@pytest.fixture
def recorded(force, world, make_twin, tmp_path):
    """A recorded run, in which the cell of one cable measured, and what its topic told."""
    twin = make_twin(record=str(tmp_path / "run.mcap"))
    heard = world.hear(JointState, "/twin/force/north", 10)
    cell = world.speaker(JointState, "/twin/measured_force/north")
    world.until(lambda: len(heard) > 3)
    cell.publish(message(twin))
    world.until(lambda: measured_by(twin))
    efforts = twin.window.newest.result.efforts
    names = twin.loop.simulation.actuator_names
    world.close()
    return RunFile(tmp_path / "run.mcap"), heard[-1], efforts, names


def test_a_record_and_its_table_hold_what_is_told_and_what_is_measured(recorded, tmp_path):
    run, _, efforts, names = recorded
    north = names.index("north")
    entries = list(run.entries())
    (call,) = (one.content for one in entries if one.kind == CALL)
    assert call["to"] == "measured_force.accept" and call["answer"] is None
    ticks = [one.content["values"] for one in entries if one.kind == TICK]
    assert np.array(ticks[-1]["force"]).shape == (len(efforts), 2)
    assert ticks[-1]["measured_force"][north] == [*MEASURED.values()]
    assert ticks[0]["measured_force"] == [[None, None]] * len(efforts)
    replay, rows = Replay(run), []
    table = TickTable(replay.loop)
    found = replay.all_ticks(lambda tick, _, time: rows.append(table.texts(tick, len(rows), time)))
    assert found.is_equal and found.ticks == len(ticks) and found.calls == 1
    with (tmp_path / "run.csv").open("w", newline="") as file:
        csv.writer(file).writerows([table.header, *rows])
    told = np.genfromtxt(tmp_path / "run.csv", delimiter=",", names=True, encoding="utf-8")
    assert told["north_force_along_N"].tolist() == [one["force"][north][0] for one in ticks]
    assert told["north_measured_force_along_N"][-1] == MEASURED["along"]
    assert told["north_measured_force_across_N"][-1] == MEASURED["across"]


def test_a_replay_compares_it(recorded, monkeypatch):
    shifted = FORCE._replace(read=lambda result: FORCE.read(result) + 1.0)
    monkeypatch.setattr(channels, "REGISTERED_CHANNELS", [*channels.REGISTERED_CHANNELS[:-1], shifted])
    found = Replay(recorded[0]).all_ticks()
    assert list(found.by_quantity) == ["force"] and found.first.size == 1.0
    assert found.first.place.endswith("along [N]")


@pytest.mark.parametrize("changes, refusal", [
    ({"values": {"along": 1.0}}, Refusal.WRONG_NAMES),
    ({"values": {"along": 1.0, "up": 2.0}}, Refusal.WRONG_NAMES),
    ({"values": {"along": 51.0, "across": 0.0}}, Refusal.OUT_OF_RANGE),
    ({"values": {"along": np.nan, "across": 0.0}}, Refusal.NOT_FINITE),
    ({"effort": [1.0, 1.0]}, Refusal.WRONG_FIELDS),
    ({"frame": "elsewhere"}, Refusal.WRONG_FRAME),
    ({"age": 10**10}, Refusal.STALE),
    ({"age": -(10**10)}, Refusal.FROM_THE_FUTURE),
])  # fmt: skip
def test_a_measured_number_that_cannot_be_used_is_refused(force, world, make_twin, changes, refusal):
    twin = make_twin()
    cell = world.speaker(JointState, "/twin/measured_force/north")
    cell.publish(message(twin, **changes))
    world.until(lambda: twin.loop.device.refusals.of(refusal) == 1)
    assert np.isnan(twin.loop.measured_force.read(twin.monotonic())).all()


def test_what_was_measured_ends_after_the_timeout_of_the_device(force, world, make_twin):
    twin = make_twin()
    cell = world.speaker(JointState, "/twin/measured_force/north")
    cell.publish(message(twin))
    world.until(lambda: measured_by(twin))
    world.until(lambda: twin.window.newest is not None and not measured_by(twin))
