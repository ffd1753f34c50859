"""Guided rigid bodies move to their commands at their speed limits, with all attached nodes."""

from collections import namedtuple

import numpy as np
import pytest

from softrobot_twin.errors import CommandError
from softrobot_twin.mechanics.rotation import quaternion_from_rotation, rotation_from_vector
from softrobot_twin.simulation import FollowTargets, Hold
from test.builder import builder
from test.scene_changes import repeat_step, solved

SPEED, TURN_RATE = 0.1, 2.0
_Pose = namedtuple("_Pose", "position quaternion")
PALM = {
    "name": "palm", "box": {"size": [0.04, 0.04, 0.01]}, "motion": "guided", "speed": SPEED,
    "turn_rate": TURN_RATE, "position": [0.01, 0.01, -0.005],
}  # fmt: skip
ON_PALM = [{"to": "palm", "box": {"minimum": [-1, -1, -1e-6], "maximum": [1, 1, 1e-6]}}]
INTEGRATIONS = ["quasi_static", "first_order", "dynamic"]


@builder
def finger(simulate, body_of, block, /, integration):
    """Makes a finger whose foot is attached to a palm."""
    mesh = block(size=(0.02, 0.02, 0.06), cells=(1, 1, 3))
    body = body_of(mesh, attached=ON_PALM, damping={"mass": 30.0})
    return simulate(body=body, rigid_bodies=[PALM], integration=integration)


def riders(scene):
    """Nodes of the finger's foot."""
    return np.flatnonzero(scene.model.bodies[0].fixed)


@pytest.mark.parametrize("integration", INTEGRATIONS)
def test_a_palm_moves_at_its_speed_limit_and_stops_at_its_command(finger, integration):
    scene = finger(integration)
    frame = scene.model.rigid[0].first_node
    rest = scene.model.nodes.rest_positions
    target = np.array([0.04, -0.03, 0.015])
    way = np.linalg.norm(target - PALM["position"])
    scene.model.guides.aim("palm", target)
    gone = []
    for _ in range(int(way / SPEED / 0.01) + 3):
        result = solved(scene, Hold(0.01))
        moves = result.state.positions - rest
        gone.append(np.linalg.norm(moves[frame]))
        alike = np.tile(moves[frame], (4, 1))
        np.testing.assert_allclose(moves[riders(scene)], alike, atol=1e-14)
    steps = np.diff([0.0, *gone])
    np.testing.assert_allclose(steps[: int(way / SPEED / 0.01)], SPEED * 0.01, rtol=1e-9)
    assert steps.max() <= SPEED * 0.01 * (1 + 1e-9)
    np.testing.assert_allclose(result.state.positions[frame], target, atol=1e-15)
    assert gone[-1] == pytest.approx(way, rel=1e-12)


@pytest.mark.parametrize("integration", INTEGRATIONS)
def test_a_palm_rotates_at_its_limit_and_attached_bodies_keep_their_shape(finger, integration):
    scene = finger(integration)
    turn = np.array([0.0, 0.8, 0.6])
    rotation = rotation_from_vector(turn)
    scene.model.guides.aim("palm", PALM["position"], quaternion_from_rotation(rotation))
    foot = riders(scene)
    rest = scene.model.nodes.rest_positions[foot] - PALM["position"]
    for index in range(60):
        state = scene.step(Hold(0.01)).state
        angle = min(TURN_RATE * 0.01 * (index + 1), 1.0)
        expected = rest @ rotation_from_vector(angle * turn).T
        np.testing.assert_allclose(state.positions[foot] - PALM["position"], expected, atol=1e-12)
    origin, quaternion = scene.model.guides.pose("palm", state.positions)
    np.testing.assert_allclose(origin, PALM["position"], atol=1e-14)
    expected = quaternion_from_rotation(rotation)
    np.testing.assert_allclose(quaternion * np.sign(quaternion @ expected), expected, atol=1e-12)


def test_a_moved_finger_has_the_equilibrium_of_one_built_there(finger, simulate, body_of, block):
    """Upside down after a turn by half: the same shape as a finger that was always so."""
    scene = finger("quasi_static")
    half_turn = rotation_from_vector(np.array([np.pi * 0.999999, 0.0, 0.0]))
    scene.model.guides.aim("palm", [0.2, 0.1, 0.3], quaternion_from_rotation(half_turn))
    result = solved(scene, Hold(0.01), 400)
    count = scene.model.bodies[0].mesh.node_count
    carried = result.state.positions[:count] - [0.2, 0.1, 0.3]
    mesh = block(size=(0.02, 0.02, 0.06), cells=(1, 1, 3))
    body = body_of(mesh, name="turned", fixed=[{"frame": "mesh", "box": ON_PALM[0]["box"]}])
    body["mesh"]["rotation"] = [np.pi, 0.0, 0.0]
    built = simulate(body=body)
    for _ in range(30):
        shape = built.step(Hold()).state.positions
    offset = np.array(PALM["position"]) * [1, -1, -1]
    np.testing.assert_allclose(carried, shape - offset, atol=2e-7)


def test_a_finger_in_motion_lags_behind_its_palm(finger):
    """Inertia: while the palm is brought to speed the tip stays back, at rest it comes after."""
    scene = finger("dynamic")
    rest = scene.model.nodes.rest_positions
    tip = np.flatnonzero(rest[:, 2] > 0.0599)
    scene.model.guides.aim("palm", [0.06, 0.01, -0.005])
    lags = []
    for _ in range(400):
        x = scene.step(Hold(0.005)).state.positions
        moved = x - rest
        lags.append(moved[scene.model.rigid[0].first_node, 0] - moved[tip, 0].mean())
    assert max(lags) > 2e-4
    assert abs(lags[-1]) < 1e-5


def test_a_palm_without_limits_moves_the_robot_s_size_and_one_radian_per_second(simulate):
    palm = {key: value for key, value in PALM.items() if key not in ("speed", "turn_rate")}
    scene = simulate(rigid_bodies=[palm])
    size = scene.model.nodes.size
    assert size == pytest.approx(np.linalg.norm([0.04, 0.04, 0.01]), rel=1e-6)
    half_turn = quaternion_from_rotation(rotation_from_vector(np.array([0.0, 0.0, np.pi])))
    scene.model.guides.aim("palm", [5.0, 0.01, -0.005], half_turn)
    positions = scene.step(Hold(0.1)).state.positions
    origin, quaternion = scene.model.guides.pose("palm", positions)
    assert origin[0] - PALM["position"][0] == pytest.approx(0.1 * size)
    assert 2.0 * np.arccos(abs(quaternion[3])) == pytest.approx(0.1)


def test_a_pose_on_the_path_to_another_obeys_both_limits(finger):
    guides = finger("quasi_static").model.guides
    here = (np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))
    there = (np.array([0.3, 0.0, 0.4]), quaternion_from_rotation(rotation_from_vector(
        np.array([0.0, 0.5, 0.0]))))  # fmt: skip
    far = _Pose(*there)
    position, quaternion = guides.towards("palm", here, far, 0.1)
    np.testing.assert_allclose(position, SPEED * 0.1 * np.array([0.6, 0.0, 0.8]), atol=1e-15)
    assert 2.0 * np.arcsin(quaternion[1]) == pytest.approx(TURN_RATE * 0.1)
    near = _Pose(np.array([SPEED * 0.1, 0.0, 0.0]), here[1])
    assert guides.towards("palm", here, near, 0.1) is near


def test_a_step_that_takes_no_time_moves_no_palm(finger):
    scene = finger("quasi_static")
    scene.model.guides.aim("palm", [0.5, 0.0, 0.0])
    frame = scene.model.rigid[0].first_node
    np.testing.assert_array_equal(scene.step(Hold(0.0)).state.positions[frame], PALM["position"])


def test_a_reset_returns_the_palm_and_clears_its_command(finger):
    scene = finger("quasi_static")
    scene.model.guides.aim("palm", [0.1, 0.0, 0.0])
    scene.step(Hold(0.01))
    scene.reset()
    np.testing.assert_array_equal(
        scene.step(Hold(0.01)).state.positions[scene.model.rigid[0].first_node], PALM["position"]
    )


@pytest.mark.parametrize(
    "pose, complaint",
    [(("thumb", [0, 0, 0]), "thumb"), (("palm", [0, np.nan, 0]), "not a point"),
     (("palm", [0, 0]), "not a point"), (("palm", [0, 0, 0], [0, 0, 0, 0]), "palm")],
)  # fmt: skip
def test_an_impossible_pose_is_refused_and_nothing_moves(finger, pose, complaint):
    scene = finger("quasi_static")
    with pytest.raises(CommandError, match=complaint):
        scene.model.guides.aim(*pose)
    frame = scene.model.rigid[0].first_node
    np.testing.assert_array_equal(scene.step(Hold(0.1)).state.positions[frame], PALM["position"])


def test_the_middle_of_an_edge_between_listed_nodes_moves_with_them(simulate, body_of, block):
    mesh = block(size=(0.02, 0.02, 0.06), cells=(1, 1, 3))
    foot = np.flatnonzero(mesh.node_positions[:, 2] < 1e-9)
    body = body_of(mesh, attached=[{"to": "palm", "nodes": foot.tolist()}], element="quadratic")
    scene = simulate(body=body, rigid_bodies=[PALM], integration="quasi_static")
    nodes = riders(scene)
    assert len(nodes) > len(foot)
    scene.model.guides.aim("palm", np.add(PALM["position"], [0.0, 0.0, 0.01]))
    for _ in range(12):
        x = scene.step(Hold(0.01)).state.positions
    moves = (x - scene.model.nodes.rest_positions)[nodes]
    np.testing.assert_allclose(moves, np.tile([0.0, 0.0, 0.01], (len(nodes), 1)), atol=1e-12)


@pytest.mark.parametrize("speed", [0.02, 0.1])
def test_a_tip_stays_at_its_target_while_a_palm_carries_its_foot(beam, speed):
    """Cables are pulled from the ground: the tip would go with the palm by 20 mm."""

    def onto_a_palm(mapping):
        mapping["rigid_bodies"] = [{**PALM, "speed": speed}]
        del mapping["body"]["fixed"]
        mapping["body"].update(attached=ON_PALM, element="quadratic")
        mapping["effectors"][0]["directions"] = ["x", "y"]
        for cable in mapping["cables"]:
            cable.update(pull_point=[*cable["pull_point"][:2], -0.01], rate=0.5)

    simulation = beam(onto_a_palm)
    target = simulation.effector_positions().copy()
    repeat_step(simulation, FollowTargets(target, 0.02), 5)
    simulation.model.guides.aim("palm", np.array(PALM["position"]) + [0.02, 0.0, 0.0])
    for _ in range(int(0.02 / speed / 0.02) + 5):
        result = solved(simulation, FollowTargets(target, 0.02))
        assert result.effector_errors[0] < 1e-4
