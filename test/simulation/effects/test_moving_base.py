"""A moving base: its turn, its acceleration and its spin are loads, as in the frame of the world."""

import numpy as np
import pytest

import softrobot_twin as st
from softrobot_twin.errors import CommandError, SceneError
from softrobot_twin.mechanics.rotation import quaternion_from_rotation, rotation_from_vector
from softrobot_twin.simulation import Hold
from softrobot_twin.simulation.effects.moving_base import BaseTrack
from softrobot_twin.study.direct_run import run_commands
from softrobot_twin.tables.input_tables import read_commands
from softrobot_twin.tables.run_columns import RunColumns
from test.builder import builder
from test.scene_changes import repeat_step

G = np.array([0.0, 0.0, -9.81])
FOOT = {"box": {"minimum": [-1, -1, -1e-6], "maximum": [1, 1, 1e-6]}}
UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0])


@builder
def carried(simulate, body_of, block, /, gravity=G, moving=True, **entries):
    """Makes a soft block that stands on a base."""
    body = body_of(block(size=(0.02, 0.02, 0.06), cells=(2, 2, 4)), fixed=[FOOT], young_modulus=3e4)
    more = {"moving_base": {"most_acceleration": 500.0}} if moving else {}
    return simulate(body=body, gravity=list(gravity), **more, **entries)


def test_a_turned_base_is_turned_gravity(carried):
    R = rotation_from_vector(np.array([0.4, -0.3, 0.2]))
    robot, other = carried(), carried(gravity=R.T @ G, moving=False)
    robot.move_base(np.zeros(3), quaternion_from_rotation(R), 0.0)
    found, expected = (repeat_step(one, Hold(1.0), 3).state.positions for one in (robot, other))
    np.testing.assert_allclose(found, expected, atol=1e-12)
    np.testing.assert_allclose(robot.state.memory["base.load"][0], R.T @ G, atol=1e-14)


def test_an_accelerated_base_is_added_gravity(carried):
    a, h = np.array([2.0, 0.0, 3.0]), 0.01
    robot, other = carried(), carried(gravity=G - a, moving=False)
    for count in range(5):
        time = h * count
        robot.move_base(0.5 * a * time**2, None, time)
        result = robot.step(Hold(h))
    for _ in range(3):
        expected = other.step(Hold(h))
    np.testing.assert_allclose(robot.state.memory["base.load"][0], G - a, atol=1e-9)
    np.testing.assert_allclose(result.state.positions, expected.state.positions, atol=1e-10)


def test_a_spinning_base_throws_outwards_as_its_masses_say(carried):
    """About its own axis: m ω² r of each node, in equilibrium with the reaction of the foot."""
    spin, h = 20.0, 0.001
    robot = carried(gravity=(0.0, 0.0, 0.0), reactions=[{"name": "base", "of": "soft"}])
    for count in range(8):
        turn = rotation_from_vector(np.array([0.0, 0.0, spin * h * count]))
        robot.move_base(np.array([0.0, 0.0, 0.0]), quaternion_from_rotation(turn), h * count)
        before = robot.state.positions
        result = robot.step(Hold(h))
    body = robot.model.bodies[0]
    masses, x = body.node_masses(), before[: body.mesh.node_count]
    moving = ~body.fixed
    outwards = (masses[:, None] * spin**2 * x * [1.0, 1.0, 0.0])[moving].sum(axis=0)
    np.testing.assert_allclose(result.state.memory["reactions.wrenches"][0, :3], -outwards, rtol=1e-6, atol=1e-9)


def test_in_motion_it_is_a_body_on_a_guided_platform_seen_from_there(carried, simulate, body_of, block):
    h, spring = 0.002, 4.0
    places = [0.5 * spring * (h * max(0, min(k, 20) - 1)) ** 2 for k in range(40)]
    robot = carried(integration="dynamic")
    cart = {"name": "cart", "motion": "guided", "box": {"size": [0.04, 0.04, 0.01]}, "speed": 50.0}
    body = body_of(block(size=(0.02, 0.02, 0.06), cells=(2, 2, 4)), attached=[{"to": "cart", **FOOT}],
                   young_modulus=3e4, name="other")  # fmt: skip
    world = simulate(body=body, rigid_bodies=[cart], gravity=list(G), integration="dynamic")
    robot.move_base(np.zeros(3), None, 0.0)
    for count, place in enumerate(places):
        robot.move_base(np.array([place, 0.0, 0.0]), None, h * (count + 1))
        world.model.guides.aim("cart", np.array([place, 0.0, 0.0]), UPRIGHT)
        found, expected = robot.step(Hold(h)).state, world.step(Hold(h)).state
    own = robot.model.bodies[0].mesh.node_count
    np.testing.assert_allclose(found.positions, expected.positions[:own] - [place, 0.0, 0.0], atol=1e-9)
    assert np.abs(found.positions - robot.model.nodes.rest_positions).max() > 1e-4


def test_accelerations_follow_from_poses_and_noise_is_limited():
    track, h = BaseTrack(most=50.0), 0.01
    for count in range(6):
        time = h * count
        turn = rotation_from_vector(np.array([0.0, 0.0, 1.5 * time**2]))
        track.see(np.array([time**2, 0.0, 0.0]), quaternion_from_rotation(turn), time)
    assert track.motion.angular_acceleration == pytest.approx([0.0, 0.0, 3.0], abs=1e-6)
    in_world = track.motion.rotation @ track.motion.acceleration
    assert in_world == pytest.approx([2.0, 0.0, 0.0], abs=1e-9)
    track.see(np.array([1.0, 0.0, 0.0]), None, time + h)
    assert np.linalg.norm(track.motion.acceleration) == pytest.approx(50.0)
    track.see(np.zeros(3), None, 0.0)
    assert not track.motion.acceleration.any()


def test_a_turn_from_one_pose_to_the_next_accelerates_the_robot_no_more_than_a_shift(carried):
    robot, h, turned = carried(), 0.01, quaternion_from_rotation(rotation_from_vector(np.array([0.0, 0.0, 3.0])))
    size, most = robot.model.nodes.size, robot.scene.moving_base.most_acceleration
    for count, pose in enumerate((UPRIGHT, UPRIGHT, turned)):
        robot.move_base(np.zeros(3), pose, h * count)
    told = robot.step(Hold(h)).state.memory
    assert size * np.linalg.norm(told["base.angular_acceleration"]) == pytest.approx(most)
    assert size * np.linalg.norm(told["base.angular_velocity"]) ** 2 == pytest.approx(most)
    with pytest.raises(CommandError, match="not finite"):
        robot.move_base(np.array([np.nan, 0.0, 0.0]), UPRIGHT, 1.0)


def test_a_saved_state_goes_on_under_the_same_load(carried):
    robot = carried()
    robot.move_base(np.zeros(3), quaternion_from_rotation(rotation_from_vector(np.array([0.5, 0, 0]))), 0.0)
    saved = robot.step(Hold(1.0)).state
    ahead = robot.step(Hold(1.0)).state.positions
    robot.move_base(np.zeros(3), UPRIGHT, 1.0)
    robot.step(Hold(1.0))
    robot.restore(saved)
    assert np.array_equal(robot.step(Hold(1.0)).state.positions, ahead)


def test_a_file_and_python_move_the_base(carried, tmp_path):
    robot, path = carried(), tmp_path / "commands.csv"
    rows = [f"{0.01 * k},{0.5 * 3.0 * (0.01 * k) ** 2!r},0,0" for k in range(6)]
    path.write_text("\n".join(["time_s,base_x_m,base_y_m,base_z_m", *rows]))
    columns = RunColumns(robot)
    (*_, last) = run_commands(robot, read_commands(path, robot), 100.0, columns)
    told = dict(zip(columns.names, columns.cells(last), strict=True))
    assert told["base_load_x_m_per_s2"] == pytest.approx(-3.0, abs=1e-6)
    scripted = st.Robot(robot.scene)
    for k in range(5):
        result = scripted.step(base=[1.5 * (0.01 * k) ** 2, 0.0, 0.0], time_step=0.01)
    assert result["base_load_x_m_per_s2"] == pytest.approx(-3.0, abs=1e-6)
    with pytest.raises(CommandError, match="a pose is a position of 3 numbers"):
        scripted.step(base=[0.0])


def test_without_it_no_part_is_built_and_what_is_not_built_is_refused(carried, simulate):
    robot = carried(moving=False)
    assert not any(part.name == "base" for part in robot.parts)
    with pytest.raises(CommandError, match="no moving_base"):
        robot.move_base(np.zeros(3), None, 0.0)
    rod = {"name": "rod", "points": [[0, 0, 0], [0.2, 0, 0]], "elements": 4, "fixed": ["start"],
           "section": {"circle": {"radius": 0.003}},
           "material": {"young_modulus": 1e7, "poisson_ratio": 0.3, "density": 1500.0}}  # fmt: skip
    with pytest.raises(SceneError, match="moving_base.*beams"):
        simulate(beams=[rod], moving_base={}, gravity=list(G))
