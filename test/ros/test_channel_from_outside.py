"""A channel from outside of the package is one entry: tables, Python, topics, records and replays show it."""

import csv

import numpy as np
import pytest
from sensor_msgs.msg import JointState

import softrobot_twin as st
from softrobot_twin.record.replay import Replay
from softrobot_twin.record.run_file import TICK, RunFile
from softrobot_twin.record.tick_table import TickTable
from softrobot_twin.scene import load_scene
from softrobot_twin.simulation import CommandSetpoints, Simulation
from softrobot_twin.simulation.channels import Channel, register_channel, withdraw_channel
from softrobot_twin.simulation.runs.run_columns import RunColumns

LEVER = 0.25
"""A load cell at the pulley of each cable measures this share of the tension, along two axes."""
SHIFT = [0.0]
"""What it shows without a force [N]."""


@pytest.fixture
def cells():
    channel = Channel(
        "cell_forces", "N", "actuator_names", ("along", "across"),
        lambda name: (f"{name}_cell_along_N", f"{name}_cell_across_N"),
        lambda result: np.outer(result.efforts, [LEVER, -LEVER]) + SHIFT[0],
    )  # fmt: skip
    register_channel(channel)
    SHIFT[0] = 0.0
    yield channel
    withdraw_channel(channel)


def test_a_name_is_given_once(cells):
    with pytest.raises(ValueError, match="a channel cell_forces already"):
        register_channel(cells)


def test_tables_and_results_have_its_columns(cells, small_scene_file):
    robot = st.load(small_scene_file)
    result = robot.step(st.setpoints(north_shortening_m=0.002))
    tension = result["north_tension_N"]
    assert tension > 0.0 and result["north_cell_along_N"] == LEVER * tension
    assert result["north_cell_across_N"] == -LEVER * tension
    simulation = Simulation(load_scene(small_scene_file))
    made = simulation.step(CommandSetpoints(simulation.rest_setpoints - 0.002, 0.02))
    columns = RunColumns(simulation)
    row = dict(zip(columns.names, columns.texts(columns.row(0, 0.02, made)), strict=True))
    for name in simulation.actuator_names:
        assert float(row[f"{name}_cell_along_N"]) == LEVER * float(row[f"{name}_tension_N"])


def test_a_twin_publishes_and_records_it_and_a_replay_compares_it(
    cells, world, make_twin, tmp_path
):
    twin = make_twin(record=str(tmp_path / "run.mcap"))
    heard = world.hear(JointState, "/twin/cell_forces/north", 10)
    world.until(lambda: len(heard) > 3)
    assert list(heard[-1].name) == ["along", "across"]
    north = twin.loop.simulation.actuator_names.index("north")
    efforts = twin.window.newest.result.efforts
    assert heard[-1].position[0] == pytest.approx(LEVER * efforts[north], abs=1e-6)
    world.close()
    run = RunFile(tmp_path / "run.mcap")
    ticks = [entry.content["values"] for entry in run.entries() if entry.kind == TICK]
    assert ticks and np.array(ticks[-1]["cell_forces"]).shape == (len(efforts), 2)
    replay, rows = Replay(run), []
    table = TickTable(replay.loop)
    found = replay.all_ticks(lambda tick, _, time: rows.append(table.texts(tick, len(rows), time)))
    assert found.is_equal and found.ticks == len(ticks)
    with (tmp_path / "run.csv").open("w", newline="") as file:
        csv.writer(file).writerows([table.header, *rows])
    cells_told = np.genfromtxt(tmp_path / "run.csv", delimiter=",", names=True, encoding="utf-8")
    recorded = [tick["cell_forces"][north][0] for tick in ticks]
    assert cells_told["north_cell_along_N"].tolist() == recorded
    SHIFT[0] = 1.0
    found = Replay(run).all_ticks()
    assert list(found.by_quantity) == ["cell_forces"] and found.first.size == 1.0
    assert found.first.place.endswith("along [N]")
