"""Soft bodies attached to free rigid bodies: they fall, hang and swing together."""

import numpy as np
import pytest

from softrobot_twin.errors import SceneError
from softrobot_twin.simulation import CommandSetpoints, Hold, Status
from test.builder import builder
from test.scene_changes import solved

G = np.array([0.0, 0.0, -9.81])
SIZE = (0.02, 0.02, 0.06)
FOOT = {"minimum": [-1, -1, -1e-6], "maximum": [1, 1, 1e-6]}
TOP = {"minimum": [-1, -1, 0.0599], "maximum": [1, 1, 1]}
MASS = 0.05
BOX = {"name": "box", "mass": MASS, "box": {"size": [0.03, 0.04, 0.02]},
       "position": [0.012, 0.009, -0.01], "rotation": [0.2, -0.1, 0.4]}  # fmt: skip


@builder
def pair(simulate, body_of, block, /, integration="dynamic", gravity=G, box=BOX, more=None, **entries):
    """Makes a soft block whose foot is attached to a free rigid box."""
    mesh = block(size=SIZE, cells=(1, 1, 3))
    body = body_of(mesh, attached=[{"to": "box", "box": FOOT}], **entries)
    return simulate(
        body=body, rigid_bodies=[box], integration=integration, gravity=list(gravity),
        **(more or {}),
    )  # fmt: skip


def masses(scene):
    """Mass that moves with each unknown [kg]; rotations have none."""
    weights = sum(term.weights for term in scene.model.forces if term.name == "gravity")
    return weights[:, 2] / G[2]


@pytest.mark.parametrize("element", ["linear", "smoothed", "quadratic"])
@pytest.mark.parametrize("mass_model", ["lumped", "uniform", "consistent"])
def test_both_fall_together_without_deformation_or_rotation(pair, mass_model, element):
    scene = pair(mass=mass_model, element=element)
    body = scene.model.bodies[0]
    assert masses(scene).sum() == pytest.approx(MASS + body.mass, rel=1e-12)
    h, x = 0.01, scene.state.positions.copy()
    for count in range(1, 6):
        result = solved(scene, Hold(h))
        x += G * h**2 * count
        np.testing.assert_allclose(result.state.positions, x, atol=1e-9)


@pytest.mark.parametrize("mass_model", ["lumped", "consistent"])
def test_momentum_is_conserved_while_a_spinning_box_shakes_an_attached_body(pair, mass_model):
    velocity, spin = [0.1, -0.2, 0.3], [4.0, -3.0, 5.0]
    box = {**BOX, "velocity": velocity, "angular_velocity": spin}
    weighed = pair(mass=mass_model)
    scene = pair(mass=mass_model, gravity=np.zeros(3), box=box)
    m = masses(weighed)
    momentum = m @ scene.state.velocities
    assert np.linalg.norm(momentum) > 0.01
    stretched = 0.0
    for _ in range(40):
        result = solved(scene, Hold(0.005))
        np.testing.assert_allclose(m @ result.state.velocities, momentum, atol=1e-9)
        own = result.state.positions[: scene.model.bodies[0].mesh.node_count]
        stretched = max(stretched, np.ptp(np.linalg.norm(own - own.mean(axis=0), axis=1)))
    # The soft block was at rest and has been torn along.
    assert np.linalg.norm(result.state.velocities[0]) > 0.05 and stretched > 0.0


def test_attached_nodes_keep_their_positions_on_the_rotating_box(pair):
    scene = pair(gravity=np.zeros(3), box={**BOX, "angular_velocity": [20.0, -10.0, 15.0]})
    part, rest = scene.model.rigid[0], scene.model.nodes.rest_positions
    attached = np.flatnonzero(scene.model.bodies[0].fixed)
    np.testing.assert_array_equal(attached, part.attached)
    before = (rest[attached] - part.origin) @ part.rotation
    for _ in range(50):
        x = scene.step(Hold(0.005)).state.positions
    frame = x[part.first_node : part.first_node + 4]
    rotation = (frame[1:] - frame[0]).T
    assert np.linalg.norm(rotation - part.rotation) > 0.5
    np.testing.assert_allclose((x[attached] - frame[0]) @ rotation, before, atol=1e-12)


def held_by_its_top(pair, integration, **more):
    return pair(integration, fixed=[{"box": TOP}], **more)


def test_a_box_hung_on_a_soft_block_is_in_equilibrium(pair):
    scene = held_by_its_top(pair, "quasi_static")
    result = solved(scene, Hold(), 5)
    assert result.report.residual < 1e-9
    model, x = scene.model, result.state.positions
    elastic = next(term for term in model.forces if "corotational" in term.name).on_points
    carried = model.nodes.carried
    forces = np.zeros((carried.free_count + carried.count, 3))
    elastic.add_forces(x, forces)
    part = model.rigid[0]
    pulls = forces[model.nodes.free_index[part.attached]]
    weight = part.mass * G
    np.testing.assert_allclose(pulls.sum(axis=0), -weight, atol=1e-8)
    arms = x[part.attached] - x[part.first_node]
    np.testing.assert_allclose(np.cross(arms, pulls).sum(axis=0), 0.0, atol=1e-9)
    assert x[part.first_node, 2] < part.origin[2] - 1e-4


def test_the_same_box_comes_to_rest_there_in_dynamics(pair):
    still = held_by_its_top(pair, "quasi_static")
    for _ in range(5):
        expected = still.step(Hold()).state.positions
    damping = {"damping": {"mass": 5.0, "stiffness": 0.05}}
    scene = held_by_its_top(pair, "dynamic", box={**BOX, "damping": 5.0}, **damping)
    result = solved(scene, Hold(0.05), 300)
    np.testing.assert_allclose(result.state.positions, expected, atol=1e-7)


def test_a_state_in_flight_is_complete(pair):
    box = {**BOX, "velocity": [0.1, 0.0, 0.3], "angular_velocity": [4.0, -3.0, 5.0]}
    scene, other = pair(box=box), pair(box=box)
    for _ in range(5):
        state = scene.step(Hold(0.01)).state
    other.restore(state)
    for _ in range(5):
        np.testing.assert_array_equal(
            scene.step(Hold(0.01)).state.positions, other.step(Hold(0.01)).state.positions
        )


def cable_to_box(pull_point_on="world"):
    return {"cables": [{
        "name": "cable", "pull_point": [0.05, 0.01, -0.01] if pull_point_on == "box"
        else [0.05, 0.01, 0.06], "pull_point_on": pull_point_on,
        "points": [[0.018, 0.01, 0.02], [0.018, 0.01, 0.05]],
        "shortening": [0.0, 0.02], "tension": [0.0, 40.0],
    }]}  # fmt: skip


@pytest.mark.parametrize("anchor", ["world", "box"])
def test_a_cable_pulls_a_hung_pair_to_an_equilibrium(pair, anchor):
    scene = held_by_its_top(pair, "quasi_static", more=cable_to_box(anchor))
    for _ in range(8):
        result = scene.step(CommandSetpoints(scene.rest_setpoints - 0.004, 1.0))
    assert result.status is Status.OK and result.report.residual < 1e-9
    assert result.efforts[0] > 0.01


def test_attached_nodes_that_touch_a_floor_carry_the_weight_of_both(pair):
    """The box is inside the block: the block's attached foot is on the floor."""
    inside = {"name": "box", "mass": MASS, "box": {"size": [0.01, 0.01, 0.01]},
              "position": [0.01, 0.01, 0.006], "damping": 2.0}  # fmt: skip
    scene = pair(box=inside, damping={"mass": 2.0}, more={
        "obstacles": [{"name": "floor", "plane": {}, "position": [0, 0, -0.001]}],
        "contact": {"between": [{"pair": ["soft", "floor"]}], "friction": 0.5},
    })  # fmt: skip
    result = solved(scene, Hold(0.01), 150)
    attached = np.flatnonzero(scene.model.bodies[0].fixed)
    assert len(attached) and np.all(result.state.positions[attached, 2] < 0.0005)
    np.testing.assert_allclose(
        result.contacts.forces.sum(axis=0), -masses(scene).sum() * G, atol=1e-5
    )


def test_an_unsupported_free_body_is_refused_in_statics(pair):
    with pytest.raises(SceneError, match="floats|not held"):
        pair("quasi_static")


def test_nodes_attached_to_a_free_body_and_to_another_are_refused(simulate, body_of, block):
    attached = [{"to": "box", "box": FOOT}, {"to": "other", "box": FOOT}]
    body = body_of(block(size=SIZE, cells=(1, 1, 3)), attached=attached)
    for motion in ({"mass": 0.1}, {"motion": "guided"}):
        other = {"name": "other", "box": {"size": [0.04, 0.04, 0.01]}, **motion}
        with pytest.raises(SceneError, match="attached.*moves by itself, and to another"):
            simulate(body=body, rigid_bodies=[BOX, other], integration="dynamic")
