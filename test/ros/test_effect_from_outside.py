"""What an effect from outside of the package reports, in `test/fatigue_effect.py`, is shown everywhere."""

import numpy as np
from sensor_msgs.msg import JointState

import softrobot_twin as st
from softrobot_twin.record.replay import Replay
from softrobot_twin.record.run_file import TICK, RunFile
from softrobot_twin.record.tick_table import TickTable


def test_results_and_tables_of_runs_have_its_figures(fatigue, small_scene_file):
    robot = st.load(small_scene_file)
    commands = [st.setpoints(north_shortening_m=1e-3 * k) for k in range(3)]
    assert [robot.step(command)["fatigue_steps"] for command in commands] == [1.0, 2.0, 3.0]
    robot.reset()
    assert list(robot.run(commands)["fatigue_steps"]) == [1.0, 2.0, 3.0]


def test_a_twin_publishes_and_records_them_and_a_replay_gives_them_again(fatigue, world, make_twin, tmp_path):
    make_twin(record=str(tmp_path / "run.mcap"))
    heard = world.hear(JointState, "/twin/figures", 10)
    world.until(lambda: len(heard) > 3)
    world.close()
    assert list(heard[-1].name) == ["fatigue.steps"]
    assert np.all(np.diff([message.position[0] for message in heard]) == 1.0)
    run = RunFile(tmp_path / "run.mcap")
    ticks = [entry.content["values"] for entry in run.entries() if entry.kind == TICK]
    told = [one["figures"] for one in ticks]
    assert told == [[[count + 1.0]] for count in range(len(ticks))]
    assert run.description.names["figure_names"] == ["fatigue.steps"]
    replay, rows = Replay(run), []
    table = TickTable(replay.loop)
    found = replay.all_ticks(lambda tick, _, time: rows.append(table.texts(tick, len(rows), time)))
    assert found.is_equal and found.ticks == len(ticks)
    place = table.header.index("fatigue_steps")
    assert [float(row[place]) for row in rows] == [one[0][0] for one in told]
