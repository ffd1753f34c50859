"""The last command of a twin without a device is checked like a measurement."""

import json

import numpy as np
import pytest

from softrobot_twin.control.last_command import LastCommand
from softrobot_twin.control.loop_settings import LoopSettings, Mode
from softrobot_twin.control.twin_loop import TwinLoop

TOPIC = "1 /twin/cables"


@pytest.fixture
def kept(simulation, tmp_path, monkeypatch):
    """Writes a file by changes of an honest one, offers it to a new loop; what the loop starts from,
    and why it does not use the file."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))

    def offer(**changes):
        stored, rest = LastCommand(simulation, TOPIC), simulation.rest_setpoints
        honest = {"setpoints": rest - 0.01, "efforts": np.ones(4), "rest": rest, "poses": {}}
        values = {key: getattr(one, "tolist", lambda one=one: one)() if key != "poses" else one
                  for key, one in (honest | changes).items()}  # fmt: skip
        stored.path.parent.mkdir(parents=True, exist_ok=True)
        stored.path.write_text(json.dumps(values) + "\n")
        loop = TwinLoop(simulation, LoopSettings())
        found = stored.read()
        why = stored.refusal if found is None else loop.continue_from(*found)
        return loop.last_command.setpoints, why

    return offer


def test_an_honest_file_is_used(kept, simulation):
    start, why = kept()
    assert not why and start == pytest.approx(simulation.rest_setpoints - 0.01)


def test_a_command_a_little_beyond_changed_limits_is_used(kept, simulation):
    """As after a smaller `shortening` in the scene: the robot is brought back at its rate."""
    limits, rest = simulation.limits, simulation.rest_setpoints
    start, why = kept(setpoints=rest - limits.drive_max - 0.09 * limits.travel(0.0))
    assert not why and (start < rest - limits.drive_max).all()


@pytest.mark.parametrize("case", range(10))
def test_a_command_of_another_robot_is_not_used_and_the_reason_is_told(kept, simulation, case, drawn_rng):
    draw, rest = drawn_rng, simulation.rest_setpoints.copy()
    place, far = draw.integers(4), 0.051 * draw.choice((-1.0, 1.0)) * 10.0 ** draw.uniform(0.0, 300.0)
    rest[place] += far
    start, why = kept(**{("setpoints", "rest")[case % 2]: rest})
    assert simulation.actuator_names[place] in why
    assert np.array_equal(start, simulation.rest_setpoints)


@pytest.mark.parametrize("changes", (
    {"setpoints": [10**400] * 4}, {"setpoints": [float("nan")] * 4}, {"setpoints": [None] * 4},
    {"efforts": [float("inf")] * 4}, {"rest": [float("nan")] * 4}, {"setpoints": "\x1b[31m\n"},
    {"setpoints": [0.1] * 3, "efforts": [0.0] * 3, "rest": [0.1] * 3}, {"setpoints": [[0.1] * 4]},
    {"rest": 1},
))  # fmt: skip
def test_a_damaged_command_is_not_used(kept, simulation, changes):
    start, why = kept(**changes)
    assert why and why.isprintable()
    assert np.array_equal(start, simulation.rest_setpoints)


def test_a_half_written_file_is_not_used(kept, simulation):
    kept()
    stored = LastCommand(simulation, TOPIC)
    whole = stored.path.read_bytes()
    for end in (0, 1, len(whole) // 2, len(whole) - 3):
        stored.path.write_bytes(whole[:end])
        assert stored.read() is None and "damaged" in stored.refusal
    stored.path.write_bytes(whole[: len(whole) // 2] + b"\xff\xfe" + whole)
    assert stored.read() is None and "damaged" in stored.refusal


def test_absurd_efforts_are_limited_also_where_the_scene_does_not(simulation):
    loop, rest = TwinLoop(simulation, LoopSettings()), simulation.rest_setpoints
    assert not loop.continue_from(rest, [1e300] * 4, {})
    assert (np.abs(loop.last_command.efforts) <= simulation.limits.effort_max).all()


def test_without_a_file_nothing_is_told(simulation, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    stored = LastCommand(simulation, TOPIC)
    assert stored.read() is None and stored.refusal == ""


@pytest.mark.parametrize("pose", (
    ((1e300, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)), ((np.nan, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)),
    ((0.0, 0.0, 2.0), (0.0, 0.0, 0.0, 1.0)), ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0)),
    ((0.0, 0.0), (0.0, 0.0, 0.0, 1.0)),
))  # fmt: skip
def test_a_guided_body_was_not_sent_beyond_all_bounds(grasper, pose):
    settings = LoopSettings(workspace_min=(-1.0, -1.0, -1.0), workspace_max=(1.0, 1.0, 1.0))
    loop, rest = TwinLoop(grasper, settings, Mode.DIRECT), grasper.rest_setpoints
    before = loop.tick(0.0, 1).guided_poses["palm"]
    assert loop.continue_from(rest - 0.001, 0.0 * rest, {"palm": pose}).startswith("palm: ")
    assert np.array_equal(loop.last_command.setpoints, rest)
    assert np.array_equal(loop.tick(0.01, 10**7).guided_poses["palm"].position, before.position)
    assert not loop.continue_from(rest, 0.0 * rest, {"palm": ((0.0, 0.0, 1.1), (0.0, 0.0, 0.0, 1e300))})
    assert loop.tick(0.02, 2 * 10**7).guided_poses["palm"].quaternion[3] == 1.0
