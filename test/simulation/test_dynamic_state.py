"""Row 36 in motion: what is reset or put back runs the same again, to the bit."""

from dataclasses import replace

import numpy as np
import pytest

from softrobot_twin.errors import CommandError
from softrobot_twin.simulation import CommandEfforts, CommandSetpoints, Hold, Status

HELD = [{"box": {"minimum": [-1, -1, -1e-6], "maximum": [1, 1, 1e-6]}}]
LOAD = {"name": "load", "box": {"size": [0.02, 0.03, 0.01]}, "mass": 0.02,
        "position": [0.01, 0.01, 0.1], "angular_velocity": [3.0, 1.0, 2.0]}  # fmt: skip
FLOOR = {"name": "floor", "plane": {"point": [0, 0, 0.09], "normal": [0, 0, 1]}}


@pytest.fixture(params=["free of contact", "in contact"])
def scene(request, simulate, body_of, block):
    """A finger with a cable and springs damped and not, and a rigid body that turns, or falls."""
    body = body_of(
        block(size=(0.02, 0.02, 0.06), cells=(1, 1, 3)), fixed=HELD, damping={"mass": 2.0}
    )
    cable = {
        "name": "tendon", "pull_point": [0.02, 0.01, -0.005],
        "points": [[0.02, 0.01, 0.02], [0.02, 0.01, 0.05]],
        "shortening": [-0.02, 0.02], "tension": [0.0, 5.0], "rate": 0.2,
    }  # fmt: skip
    touching = {}
    if request.param == "in contact":
        touching = {
            "obstacles": [FLOOR],
            "contact": {"between": [{"pair": ["load", "floor"]}], "friction": 0.5},
        }
    springs = [{"name": "band", "stiffness": 5.0, "damping": 0.01, "ends": [
        {"on": "soft", "point": [0.01, 0.01, 0.06]},
        {"on": "load", "point": [0.01, 0.01, 0.095]}]}]  # fmt: skip
    return simulate(
        body=body, rigid_bodies=[LOAD], springs=springs, cables=[cable], integration="dynamic",
        solver={"newton_iterations": 6, "residual_tolerance": 1e-8}, **touching,
    )  # fmt: skip


def run(simulation, count=25):
    """States after commands of all kinds; with the result's words."""
    found = []
    for index in range(count):
        if index % 3 == 0:
            command = CommandSetpoints(simulation.rest_setpoints - 1e-4 * index, 0.004)
        elif index % 3 == 1:
            command = CommandEfforts(np.array([0.01 * index]), 0.004)
        else:
            command = Hold(0.006)
        result = simulation.step(command)
        state = result.state
        found.append((state.positions, state.velocities, state.efforts, state.setpoints,
                      state.time, result.status, result.report.residual,
                      result.report.contact_count))  # fmt: skip
    return found


def assert_same(one, other):
    for first, second in zip(one, other, strict=True):
        for a, b in zip(first, second, strict=True):
            np.testing.assert_array_equal(a, b)


def test_a_reset_run_is_the_same_to_the_bit_twice(scene):
    first = run(scene)
    assert any(np.abs(state[1]).max() > 0.1 for state in first)
    assert any(state[-1] > 0 for state in first) == (scene.model.contacts is not None)
    for _ in range(2):
        scene.reset()
        assert scene.state.time == 0.0 and scene.state.step_count == 0
        assert_same(run(scene), first)


def test_a_reset_after_a_failure_is_the_same_to_the_bit(scene):
    first = run(scene)
    scene.reset()
    bad = scene.state.positions.copy()
    bad[scene.model.nodes.free_nodes] = np.nan
    scene.restore(replace(scene.state, positions=bad))
    assert scene.step(Hold(0.004)).status is Status.DIVERGED
    scene.reset()
    assert_same(run(scene), first)


def test_warming_up_changes_nothing(scene):
    first = run(scene)
    scene.reset()
    scene.warm_up()
    assert_same(run(scene), first)


def test_a_restored_state_gives_the_same_run_every_time(scene):
    run(scene, 10)
    saved = scene.state
    scene.restore(saved)
    first = run(scene, 10)
    run(scene, 5)
    scene.restore(saved)
    assert_same(run(scene, 10), first)
    assert first[0][4] > saved.time > 0.0


def test_a_state_without_its_velocities_is_refused(scene):
    still = replace(scene.state, velocities=np.empty((0, 3)))
    with pytest.raises(CommandError, match="not of this scene"):
        scene.restore(still)
