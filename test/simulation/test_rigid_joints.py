"""Rigid bodies joined to each other and to the world by hinges and ball joints."""

import numpy as np
import pytest

from softrobot_twin.errors import SceneError
from softrobot_twin.mechanics.rotation import quaternion_from_rotation, rotation_from_vector
from softrobot_twin.simulation import Hold, Status
from test.scene_changes import repeat_step, solved
from test.simulation.test_beam_masses import tangent

G, MASS, STIFFNESS = 9.81, 0.1, 1.0e6
LENGTH, WIDTH = 0.1, 0.02
RADIUS = np.sqrt(LENGTH**2 + 2 * WIDTH**2) / 2
WORLD_HINGE = {"to": "world", "by": "hinge", "through": [0, 0, 0], "axis": [0, 1, 0]}


def bar(name, x, *joints, **changes):
    return {"name": name, "mass": MASS, "position": [x, 0, 0],
            "box": {"size": [LENGTH, WIDTH, WIDTH]}, "joined": list(joints), **changes}  # fmt: skip


def pose(simulation, name):
    (part,) = [part for part in simulation.model.rigid if part.name == name]
    return part.entry_pose(simulation.state.positions)


def moved(simulation, move, size):
    """Positions after a move of all unknowns from rest."""
    x = np.array(simulation.model.nodes.rest_positions)
    simulation.model.nodes.advance(x, move, size)
    return x


def chain(count, by="hinge"):
    """Bars in a row along x, the first joined to the world."""
    bars = []
    for k in range(count):
        axis = {"axis": [0, 1, 0]} if by == "hinge" else {}
        to = f"bar{k - 1}" if k else "world"
        joint = {"to": to, "by": by, "through": [k * LENGTH, 0, 0], **axis}
        bars.append(bar(f"bar{k}", (k + 0.5) * LENGTH, joint))
    return bars


def test_a_pendulum_swings_with_the_period_of_its_inertia(simulate):
    start = 0.02  # rad from the vertical: the period grows by a share of start² / 16
    turned = bar("rod", 0.0, WORLD_HINGE, position=[LENGTH / 2 * np.sin(start), 0, -LENGTH / 2 * np.cos(start)],
                 rotation=[0, np.pi / 2 - start, 0])  # fmt: skip
    scene = simulate(rigid_bodies=[turned], integration="dynamic", time_scheme="generalized_alpha")
    about_hinge = MASS * (LENGTH**2 + WIDTH**2) / 12 + MASS * (LENGTH / 2) ** 2
    period = 2 * np.pi * np.sqrt(about_hinge / (MASS * G * LENGTH / 2))
    steps, places = 400, []
    for _ in range(steps + 1):
        solved(scene, Hold(period / steps))
        places.append(pose(scene, "rod")[0][0])
    # After a period it is where it began, and crossed the vertical at a quarter and three quarters.
    crossings = np.flatnonzero(np.diff(np.sign(places)))
    np.testing.assert_allclose(crossings, [steps / 4, 3 * steps / 4], atol=2)
    assert places[-1] == pytest.approx(LENGTH / 2 * np.sin(start), rel=2e-3)


@pytest.mark.parametrize("by", ["hinge", "ball"])
def test_a_chain_in_statics_falls_to_where_it_hangs(simulate, by):
    scene = simulate(rigid_bodies=chain(4, by))
    solved(scene, Hold(0.1), 40)
    for k in range(4):
        origin, _ = pose(scene, f"bar{k}")
        # Each bearing bears all that hangs below it.
        sag = sum((4 - j) * MASS * G / STIFFNESS for j in range(k + 1))
        np.testing.assert_allclose(origin, [0, 0, -(k + 0.5) * LENGTH - sag], atol=1e-8)


def test_a_chain_in_motion_keeps_its_joints_closed_and_gains_no_energy(simulate, energies):
    scene = simulate(rigid_bodies=chain(3), integration="dynamic", time_scheme="generalized_alpha")
    total = []
    for _ in range(300):
        solved(scene, Hold(0.002))
        total.append(sum(energies(scene)))
        ends = []
        for k in range(3):
            origin, R = pose(scene, f"bar{k}")
            ends += [origin - R[:, 0] * LENGTH / 2, origin + R[:, 0] * LENGTH / 2]
        gaps = np.linalg.norm(np.array([ends[0], ends[2] - ends[1], ends[4] - ends[3]]), axis=1)
        assert gaps.max() < 5e-5
    fallen = 3 * MASS * G * LENGTH
    assert np.ptp(total) < 0.01 * fallen


def test_a_parallelogram_carries_its_coupler_without_turning_it(simulate):
    """A closed loop: crank (guided), coupler, rocker."""
    axis = {"by": "hinge", "axis": [0, 1, 0], "stiffness": 1.0e7}
    scene = simulate(rigid_bodies=[
        {"name": "crank", "motion": "guided", "speed": 100.0, "turn_rate": 100.0,
         "box": {"size": [WIDTH, WIDTH, LENGTH]}},
        bar("coupler", LENGTH / 2, {"to": "crank", "through": [0, 0, 0.04], **axis},
            position=[LENGTH / 2, 0, 0.04]),
        bar("rocker", LENGTH, {"to": "world", "through": [LENGTH, 0, 0], **axis},
            {"to": "coupler", "through": [LENGTH, 0, 0.04], **axis},
            box={"size": [WIDTH, WIDTH, LENGTH]}),
    ])  # fmt: skip
    for angle in np.linspace(0.1, 1.2, 12):
        R = rotation_from_vector([0, angle, 0])
        scene.model.guides.aim("crank", [0, 0, 0], quaternion_from_rotation(R))
        solved(scene, Hold(1.0), 3)
        origin, coupler = pose(scene, "coupler")
        np.testing.assert_allclose(coupler, np.eye(3), atol=1e-4)
        np.testing.assert_allclose(origin, R @ [0, 0, 0.04] + [LENGTH / 2, 0, 0], atol=1e-5)
        np.testing.assert_allclose(pose(scene, "rocker")[1], R, atol=1e-4)


def test_a_door_sags_at_its_hinge_by_its_moment_over_the_stiffness_of_the_bearing(simulate):
    door = bar("door", LENGTH / 2, {**WORLD_HINGE, "axis": [0, 0, 1]})
    scene = simulate(rigid_bodies=[door])
    assert repeat_step(scene, Hold(0.1), 10).status is Status.OK
    origin, R = pose(scene, "door")
    angle = MASS * G * LENGTH / 2 / (STIFFNESS * RADIUS**2)
    assert R[2, 0] == pytest.approx(-angle, rel=1e-6)
    assert origin[2] == pytest.approx(-MASS * G / STIFFNESS - angle * LENGTH / 2, rel=1e-4)


@pytest.mark.parametrize("integration", ["quasi_static", "dynamic"])
def test_a_soft_body_bends_and_lifts_what_hangs_on_it_by_a_hinge(simulate, body_of, block, integration):
    """A soft block stands on the ground; a bar is attached to its top, and another hangs on that."""
    top, foot = ({"box": {"minimum": [-1, -1, z - 1e-6], "maximum": [1, 1, z + 1e-6]}} for z in (0.06, 0.0))
    mesh = block(size=(0.03, 0.03, 0.06), cells=(2, 2, 4), shake=0)
    hinge = {"by": "hinge", "through": [0.115, 0.015, 0.07], "axis": [0, 1, 0]}
    scene = simulate(
        body=body_of(mesh, fixed=[foot], attached=[{"to": "arm", **top}], damping={"mass": 20.0}),
        rigid_bodies=[
            bar("arm", 0.065, position=[0.065, 0.015, 0.07], mass=0.01),
            bar("bob", 0.165, {"to": "arm", **hinge}, position=[0.165, 0.015, 0.07], mass=0.01, damping=20.0),
        ],
        integration=integration,
    )  # fmt: skip
    solved(scene, Hold(0.02), 400)
    arm, R = pose(scene, "arm")
    assert R[2, 0] < -0.02
    # The mesh is not quite symmetric: the bar hangs as low as the axis of its hinge lets it.
    axis = R[:, 1]
    down = axis * axis[2] - [0, 0, 1]
    below = arm + R @ [LENGTH / 2, 0, 0] + LENGTH / 2 * down / np.linalg.norm(down)
    np.testing.assert_allclose(pose(scene, "bob")[0], below, atol=1e-5)


def test_what_hangs_on_a_mounted_body_rests_below_it(simulate):
    hook = {"name": "hook", "motion": "fixed", "sphere": {"radius": 0.01}}
    scene = simulate(
        rigid_bodies=[hook, bar("rod", 0.0, {**WORLD_HINGE, "to": "hook"}, rotation=[0, np.pi / 2, 0],
                                position=[0, 0, -LENGTH / 2])],
        mounting=[{"bodies": [{"body": "hook", "translation": [0.0, 0.0, 0.3]}]}],
    )
    np.testing.assert_allclose(pose(scene, "rod")[0], [0, 0, 0.3 - LENGTH / 2], atol=2e-6)
    before = scene.state.positions.copy()
    assert repeat_step(scene, Hold(0.1), 3).status is Status.OK
    np.testing.assert_allclose(scene.state.positions, before, atol=1e-8)


def test_forces_and_stiffness_are_the_slopes_of_the_energy(simulate, drawn_rng):
    scene = simulate(rigid_bodies=chain(2) + [bar("free", 0.0)], integration="dynamic")
    nodes = scene.model.nodes
    (term,) = [term for term in scene.model.forces if term.name == "joints"]
    x = moved(scene, drawn_rng.normal(size=(nodes.free_node_count, 3)), 0.05)
    direction = drawn_rng.normal(size=(nodes.free_node_count, 3))
    K, h = tangent(term, scene, x), 1.0e-5
    slopes, bends = np.zeros((2, nodes.free_node_count, 3))
    for sign in (-1.0, 1.0):
        other = np.array(x)
        nodes.advance(other, direction, sign * h)
        forces = np.zeros_like(direction)
        term.add_forces(other, forces)
        bends += sign * forces / (2 * h)
        slopes += sign * term.on_points.energy(other) / (2 * h)
    forces = np.zeros_like(direction)
    term.add_forces(x, forces)
    assert slopes[0, 0] == pytest.approx(-np.sum(forces * direction), rel=1e-6)
    # Turns are relative to the pose, so the symmetric tangent is the slope of the work alone.
    work = direction.ravel() @ K @ direction.ravel()
    assert np.sum(bends * direction) == pytest.approx(-work, rel=1e-6)


@pytest.mark.parametrize(("changes", "message"), [
    ({"joined": [{**WORLD_HINGE, "axis": None}]}, r"rigid_bodies\[0\].joined\[0\].*a hinge has an axis"),
    ({"joined": [{**WORLD_HINGE, "by": "ball"}]}, "a ball joint has none"),
    ({"joined": [{**WORLD_HINGE, "axis": [0, 0, 0]}]}, "must not be zero"),
    ({"joined": [{**WORLD_HINGE, "to": "rod"}]}, r"joined\[0\].to = 'rod'"),
    ({"joined": [{**WORLD_HINGE, "to": "nobody"}]}, r"joined\[0\].to = 'nobody'"),
    ({"joined": [{**WORLD_HINGE, "stiffness": -1.0}]}, "stiffness"),
    ({"joined": [WORLD_HINGE], "motion": "guided", "mass": None}, "join the free body"),
    ({"joined": []}, "rod floats"),
])  # fmt: skip
def test_joints_that_cannot_be_are_refused(simulate, changes, message):
    with pytest.raises(SceneError, match=message):
        simulate(rigid_bodies=[bar("rod", LENGTH / 2, **changes) if "joined" not in changes
                               else {**bar("rod", LENGTH / 2), **changes}])  # fmt: skip
