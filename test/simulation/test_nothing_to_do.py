"""Row 35: scenes without actuators, effectors and contacts run, whatever they are made of."""

import numpy as np
import pytest

from softrobot_twin.errors import CommandError
from softrobot_twin.simulation import CommandEfforts, CommandSetpoints, FollowTargets, Hold
from test.scene_changes import repeat_step, solved

HELD = [{"box": {"minimum": [-1, -1, -1e-6], "maximum": [1, 1, 1e-6]}}]
FREE = {"name": "box", "box": {"size": [0.02, 0.03, 0.04]}, "mass": 0.1}
GUIDED = {"name": "palm", "box": {"size": [0.02, 0.03, 0.04]}, "motion": "guided", "speed": 0.1}


def runs(scene, time_step):
    """Every kind of command in scenes without actuators or without moving bodies."""
    for command in (
        Hold(time_step),
        CommandSetpoints(np.empty(0), time_step),
        CommandEfforts(np.empty(0), time_step),
    ):
        result = solved(scene, command)
        assert result.efforts.shape == result.setpoints.shape == (0,)
        assert result.effector_positions.shape == (0, 3)
        assert result.contacts is None and result.report.contact_count == 0
        assert np.isfinite(result.state.positions).all()
    with pytest.raises(CommandError):
        scene.step(FollowTargets(np.empty((0, 3)), time_step))
    scene.warm_up()
    scene.reset()
    return result


@pytest.mark.parametrize("integration", ["quasi_static", "first_order", "dynamic"])
def test_a_soft_body_alone_runs(simulate, body_of, block, integration):
    body = body_of(
        block(size=(0.02, 0.02, 0.06), cells=(1, 1, 2)), fixed=HELD, damping={"mass": 3.0}
    )
    result = runs(simulate(body=body, integration=integration), 0.01)
    assert result.state.time == pytest.approx(0.03)


def test_rigid_bodies_alone_run(simulate):
    second = {**FREE, "name": "other", "position": [0.2, 0, 0], "velocity": [0, 0, 1.0]}
    runs(simulate(rigid_bodies=[FREE, second, GUIDED], integration="dynamic"), 0.01)


@pytest.mark.parametrize("integration", ["quasi_static", "dynamic"])
def test_a_scene_in_which_nothing_moves_by_itself_runs(simulate, integration):
    """Only a guided body: there are no unknowns at all."""
    scene = simulate(rigid_bodies=[GUIDED], integration=integration)
    assert scene.model.nodes.free_node_count == 0
    runs(scene, 0.01)
    scene.model.guides.aim("palm", [0.0, 0.0, 0.005])
    result = repeat_step(scene, Hold(0.01), 10)
    np.testing.assert_allclose(result.state.positions[0], [0, 0, 0.005], atol=1e-12)


def test_point_masses_alone_run(simulate):
    points = {"name": "points", "points": [[0, 0, 0], [0.1, 0, 0]], "masses": [0.1]}
    runs(simulate(mass_springs=[points], integration="dynamic"), 0.01)


def test_a_dynamic_scene_needs_a_time_step(simulate):
    scene = simulate(rigid_bodies=[FREE], integration="dynamic")
    before = scene.state
    for command in (Hold(), Hold(0.0), CommandSetpoints(np.empty(0), 0.0)):
        with pytest.raises(CommandError, match="needs a time step"):
            scene.step(command)
    for bad in (-0.01, np.nan, np.inf):
        with pytest.raises(CommandError, match="duration"):
            scene.step(Hold(bad))
    assert scene.state is before
