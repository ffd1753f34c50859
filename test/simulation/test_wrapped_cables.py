"""Cables around obstacles in scenes: they pull along the tangent, and straight ones through bodies are told."""

import numpy as np
import pytest

from softrobot_twin.errors import SceneError
from softrobot_twin.simulation import CommandEfforts, CommandSetpoints, FollowTargets, Hold, Status
from test.builder import builder
from test.scene_changes import repeat_step, solved

FOOT = {"box": {"minimum": [-1, -1, -1e-6], "maximum": [1, 1, 1e-6]}}
DRUM = {"name": "drum", "cylinder": {"ends": [[0.06, -0.05, 0.03], [0.06, 0.07, 0.03]], "radius": 0.01}}


@builder
def pulled(simulate, body_of, block, /, pull=(0.1, 0.01, 0.0), wraps=("drum",), obstacles=(DRUM,),
           cable=None, **entries):  # fmt: skip
    """Makes a block that is pulled to the side by a cable over a drum."""
    body = body_of(block(size=(0.02, 0.02, 0.06), cells=(2, 2, 4)), fixed=[FOOT])
    own = {"name": "rope", "pull_point": list(pull), "points": [[0.02, 0.01, 0.05]],
           "shortening": [-0.02, 0.05], "tension": [0.0, 20.0], "wraps": list(wraps), **(cable or {})}
    return simulate(body=body, cables=[own], obstacles=list(obstacles), gravity=[0.0, 0.0, 0.0],
                    reactions=[{"name": "base", "of": "soft"}], **entries)  # fmt: skip


def test_it_pulls_along_the_tangent_of_the_drum(pulled):
    robot = pulled()
    for _ in range(5):
        result = robot.step(CommandEfforts(np.array([0.8]), 1.0))
    assert result.status is Status.OK
    path = robot.actuator_paths()["rope"]
    way = path[-2] - path[-1]
    pull = 0.8 * way / np.linalg.norm(way)
    np.testing.assert_allclose(result.state.memory["reactions.wrenches"][0, :3], -pull, atol=1e-8)
    # The same as straight from where the rope leaves the drum.
    straight = pulled(pull=path[-2], wraps=())
    expected = repeat_step(straight, CommandEfforts(np.array([0.8]), 1.0), 5)
    np.testing.assert_allclose(result.state.positions, expected.state.positions, atol=1e-9)


def test_with_friction_the_pull_falls_around_the_drum_and_less_of_it_comes_back(pulled):
    robot = pulled(cable={"friction": 0.4, "presliding": 1e-6})

    def share(tension):
        for _ in range(8):
            result = robot.step(CommandEfforts(np.array([tension]), 1.0))
        assert result.status is Status.OK
        ways = np.diff(robot.actuator_paths()["rope"], axis=0)[[0, -1]]
        first, last = ways / np.linalg.norm(ways, axis=1, keepdims=True)
        force = result.state.memory["reactions.wrenches"][0, :3]
        np.testing.assert_allclose(force / np.linalg.norm(force), last, atol=1e-6)
        return np.linalg.norm(force) / tension, 0.4 * np.arccos(first @ last)

    pulls, turn = share(0.8)
    assert pulls == pytest.approx(np.exp(-turn), rel=1e-4)
    released, turn = share(0.4)
    assert released == pytest.approx(np.exp(turn), rel=1e-4)


def test_a_wound_length_is_the_length_around_the_drum(pulled):
    robot = pulled()
    result = solved(robot, CommandSetpoints(robot.rest_setpoints - 0.01, 1.0), 8)
    assert result.efforts[0] > 0.2
    path = robot.actuator_paths()["rope"]
    length = np.linalg.norm(np.diff(path, axis=0), axis=1).sum()
    assert length == pytest.approx(robot.rest_setpoints[0] - 0.01, rel=2e-5)


def test_targets_are_reached_around_the_drum(pulled):
    robot = pulled(sensors=[{"name": "bend", "bend": [[0.01, 0.01, 0.005], [0.01, 0.01, 0.02], [0.01, 0.01, 0.04],
                             [0.01, 0.01, 0.055]], "axis": [0, 1, 0], "weight": 1.0}])  # fmt: skip
    for _ in range(10):
        result = robot.step(FollowTargets(np.empty((0, 3)), 1.0, sensors=np.array([0.2])))
    assert result.status is Status.OK
    assert result.state.memory["sensors.angle"][0, 0] == pytest.approx(0.2, abs=1e-4)


def test_a_straight_cable_through_an_obstacle_is_warned_of(pulled):
    crossed = pulled(wraps=())
    assert any("rope) passes through drum after its point 0" in note for note in crossed.notes)
    assert not any("passes through" in note for note in pulled().notes)
    far = {**DRUM, "position": [0.0, 0.0, 0.5]}
    assert not any("rope) passes" in note for note in pulled(wraps=(), obstacles=[far]).notes)
    assert crossed.step(Hold(1.0)).status is Status.OK


BALL = {"name": "ball", "sphere": {"radius": 0.01}, "position": [0.06, 0.01, 0.03]}


@pytest.mark.parametrize("change, words", [
    ({"wraps": ("dram",)}, "is drum meant"),
    ({"wraps": ("ball",), "obstacles": [BALL]}, "no capsule and no cylinder"),
    ({"cable": {"axial_stiffness": 100.0}}, "axial_stiffness.*is not built for a cable that wraps"),
    ({"pull": (0.06, 0.01, 0.03)}, "holds a point of the cable inside|axis on the cable"),
    ({"wraps": ("drum", "other"), "obstacles": [DRUM, {**DRUM, "name": "other"}]}, "the same part"),
])  # fmt: skip
def test_what_cannot_be_wrapped_is_refused_by_name(pulled, change, words):
    with pytest.raises(SceneError, match=words):
        pulled(**change)
