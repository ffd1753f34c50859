"""Beams on hinges and ball joints, and motors that turn hinges, against closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import trapezoid

from softrobot_twin.errors import SceneError
from softrobot_twin.mechanics.beam_masses import BeamWeight
from softrobot_twin.mechanics.beams import Beams
from softrobot_twin.mechanics.rotation import quaternion_from_rotation, rotation_from_vector
from softrobot_twin.scene import scene_from_mapping
from softrobot_twin.simulation import (
    CommandEfforts,
    CommandSetpoints,
    FollowTargets,
    Hold,
    Simulation,
    Status,
)
from test.builder import builder
from test.scene_changes import repeat_step, solved

E, DENSITY = 35e6, 1220.0
THICKNESS, WIDTH, LENGTH = 0.005, 0.01, 0.2
BENDING = E * WIDTH * THICKNESS**3 / 12.0
MASS = DENSITY * THICKNESS * WIDTH * LENGTH
G = 9.81
Y = [0, 1, 0]


def hinge(at, to="world", axis=Y, **through):
    return {"at": at, "to": to, "by": "hinge", "axis": axis} | through


# The hinge is at the end of the strip, or beside it.
THROUGH = pytest.mark.parametrize("through", [(0.0, 0.0, 0.0), (0.022, 0.003, 0.01)])


def strip(name="leg", points=((0, 0, 0), (0, 0, -LENGTH)), elements=8, stiffer=1.0, **changes):
    """A strip that bends about y; by default it hangs."""
    entry = {
        "name": name, "points": [list(map(float, p)) for p in points], "elements": elements,
        "section": {"rectangle": {"thickness": THICKNESS, "width": WIDTH}},
        "thickness_direction": [1.0, 0.0, 0.013],
        "material": {"young_modulus": E * stiffer, "poisson_ratio": 0.45, "density": DENSITY},
    }  # fmt: skip
    return entry | changes


def motor(name="m", beam="leg", at="start", angle=(-2.9, 2.9), **changes):
    return {"name": name, "beam": beam, "at": at, "angle": list(angle)} | changes


@builder
def scene(*beams, **others) -> Simulation:
    """Makes a simulation of beams; by default without gravity."""
    mapping = {
        "name": "hinges", "gravity": [0.0, 0.0, 0.0], "beams": list(beams),
        "solver": {"newton_iterations": 60, "residual_tolerance": 1e-9},
    } | others  # fmt: skip
    return Simulation(scene_from_mapping(mapping, None))


def turn(simulation, *angles):
    """The result of a step to given angles, without limits of time."""
    result = simulation.step(CommandSetpoints(np.array(angles, float), 1.0))
    assert result.status is Status.OK, result.status
    return result


def energy(simulation):
    return sum(term.energy(simulation.state.positions) for term in simulation.model.forces)


def nodes(simulation, beam=0):
    """Places of the nodes of a beam [m], shape (node_count, 3)."""
    return simulation.model.beams[beam].nodes_mapping().positions(simulation.state.positions)


@THROUGH
def test_a_motor_turns_a_beam_without_load_as_a_rigid_body(scene, through):
    simulation = scene(strip(joined=[hinge("start", through=through)]), hinge_motors=[motor()])
    rest = nodes(simulation) - through
    for angle in (0.3, 2.0, 2.9, 0.5, -1.5, -2.9):
        result = turn(simulation, angle)
        np.testing.assert_allclose(
            nodes(simulation), rest @ rotation_from_vector([0.0, angle, 0.0]).T + through, atol=1e-9
        )
        assert result.setpoints[0] == angle
        assert abs(result.efforts[0]) < 1e-8


@THROUGH
def test_a_motor_bears_the_moment_of_the_weight_about_its_axis(scene, through):
    simulation = scene(
        strip(joined=[hinge("start", through=through)]), hinge_motors=[motor()], gravity=[0.0, 0.0, -G]
    )
    terms = (term.on_points for term in simulation.model.forces)
    weight = next(term for term in terms if isinstance(term, BeamWeight))
    for angle in (0.3, 1.0, 2.0, -2.5):
        result = turn(simulation, angle)
        places = weight.ends(simulation.state.positions)[:, :, 0]
        moment = -G * (np.sum(weight.masses.borne * places) - MASS * through[0])
        assert result.efforts[0] == pytest.approx(moment, rel=1e-6)
        assert abs(moment) > 1e-3


@pytest.mark.parametrize(
    "far, factor", [({"fixed": ["end"]}, 4.0), ({"by": "hinge"}, 3.0), ({"by": "ball"}, 3.0)]
)
def test_the_torque_of_a_turned_beam_is_that_of_beam_theory(scene, far, factor):
    """M = 4 EI/L α of a beam that is clamped at its other end, 3 EI/L α where it can turn."""
    joined = [hinge("start")]
    if "by" in far:
        joined.append({"at": "end", "to": "world", "by": far["by"]})
    if far.get("by") == "hinge":
        joined[-1]["axis"] = Y
    simulation = scene(strip(joined=joined, fixed=far.get("fixed", [])), hinge_motors=[motor()])
    angle = 1e-3
    result = turn(simulation, angle)
    shear = 12.0 * BENDING / (5.0 / 6.0 * THICKNESS * WIDTH * E / 2.9 * LENGTH**2)
    softer = 1.0 + shear / 4.0
    exact = factor * BENDING / LENGTH * angle
    exact *= (softer / (1.0 + shear)) if factor == 4.0 else 1.0 / softer
    assert result.efforts[0] == pytest.approx(exact, rel=2e-3)


def test_a_servo_that_yields_leaves_the_angle_open_by_its_torque(scene):
    """Two springs in series: the servo, and the beam that is clamped at its other end."""
    stiff, soft = (scene(strip(joined=[hinge("start")], fixed=["end"]), hinge_motors=[motor() | own])
                   for own in ({}, {"stiffness": 0.5}))  # fmt: skip
    (held,), (left,) = (turn(one, 0.01).efforts for one in (stiff, soft))
    k = held / 0.01
    assert left == pytest.approx(0.01 / (1.0 / k + 1.0 / 0.5), rel=1e-3)
    term = soft.model.actuators.terms[0]
    angle = float(term.angles(soft.state.positions)[0])
    assert angle == pytest.approx(0.01 - left / 0.5, rel=1e-6) and angle < 0.99 * 0.01
    assert not hasattr(stiff.model.actuators.terms[0], "compliance")
    with pytest.raises(SceneError, match="stiffness"):
        scene(strip(joined=[hinge("start")], fixed=["end"]), hinge_motors=[motor() | {"stiffness": 0.0}])


def test_a_beam_of_one_element_may_be_on_joints_at_both_ends(scene):
    joined = [hinge("start"), {"at": "end", "to": "world", "by": "ball"}]
    simulation = scene(strip(joined=joined, elements=1), hinge_motors=[motor()])
    result = turn(simulation, 1e-3)
    assert result.efforts[0] == pytest.approx(3e-3 * BENDING / LENGTH, rel=2e-3)


def test_beams_that_share_a_hinged_node_turn_together(scene):
    simulation = scene(
        strip("a", joined=[hinge("start")]),
        strip("b", [[0, 0, 0], [0.1, 0, 0]], 4, thickness_direction=[0, 0, 1],
              joined=[{"at": "start", "to": "a"}]),
        hinge_motors=[motor(beam="b")],
    )  # fmt: skip
    rest = [nodes(simulation, beam) for beam in (0, 1)]
    turn(simulation, 0.7)
    R = rotation_from_vector([0.0, 0.7, 0.0])
    for beam in (0, 1):
        np.testing.assert_allclose(nodes(simulation, beam), rest[beam] @ R.T, atol=1e-9)


def test_a_beam_between_two_hinges_sags_like_a_simply_supported_one(scene):
    """5 q L⁴/384 EI: neither hinge bears a moment about its axis."""
    g = 1e-3
    simulation = scene(
        strip(points=[[0, 0, 0], [LENGTH, 0, 0]], elements=40, thickness_direction=[0, 0, 1],
              joined=[hinge("start"), {"at": "end", "to": "world", "by": "ball"}]),
        gravity=[0.0, 0.0, -g],
    )  # fmt: skip
    assert simulation.step(Hold()).status is Status.OK
    load = g * MASS / LENGTH
    sag = 5.0 * load * LENGTH**4 / (384.0 * BENDING)
    assert nodes(simulation)[20, 2] == pytest.approx(-sag, rel=5e-3)


def test_the_end_of_a_beam_at_a_hinge_has_no_moment_about_its_axis(scene):
    simulation = scene(
        strip(points=[[0, 0, 0], [LENGTH, 0, 0]], elements=10, thickness_direction=[0, 1, 1],
              joined=[hinge("start", axis=[0, 1, 1])], fixed=["end"]),
        gravity=[0.0, -2.0, -G],
    )  # fmt: skip
    assert simulation.step(Hold()).status is Status.OK
    frames = simulation.model.nodes.kinds[0]
    first = next(
        term.on_points for term in simulation.model.forces
        if isinstance(term.on_points, Beams) and term.on_points.element_count == 1
    )  # fmt: skip
    weight = next(
        term.on_points for term in simulation.model.forces
        if isinstance(term.on_points, BeamWeight)
    )  # fmt: skip
    on_ends = np.zeros((frames.free_node_count + 2, 3))
    for term in (first, weight):
        term.add_forces(simulation.state.positions, on_ends)
    moment = on_ends[frames.free_node_count + 1]
    axis = frames.world_axes(simulation.state.positions)[0]
    assert np.linalg.norm(moment) > 1e-4
    assert abs(moment @ axis) < 1e-8


def test_the_work_of_a_motor_is_the_energy_of_the_beam(scene):
    simulation = scene(strip(joined=[hinge("start")], fixed=["end"]), hinge_motors=[motor()])
    angles = np.linspace(0.0, 1.2, 41)
    torques = [turn(simulation, angle).efforts[0] for angle in angles]
    work = trapezoid(torques, angles)
    assert work == pytest.approx(energy(simulation), rel=1e-3)
    assert work > 0.5 * BENDING / LENGTH


def test_a_commanded_torque_turns_the_beam_to_the_angle_that_needs_it(scene):
    def made():
        return scene(strip(joined=[hinge("start")], fixed=["end"]), hinge_motors=[motor()])

    by_angle, by_torque = made(), made()
    torque = turn(by_angle, 0.8).efforts
    result = solved(by_torque, CommandEfforts(torque, 1.0))
    assert result.setpoints[0] == pytest.approx(0.8, abs=1e-6)
    np.testing.assert_allclose(nodes(by_torque), nodes(by_angle), atol=1e-7)


def test_a_motor_stops_at_its_angle_rate_and_torque_limits(scene):
    limited = motor(angle=(-0.5, 0.5), rate=2.0, torque=(-0.005, 0.02))
    simulation = scene(strip(joined=[hinge("start")], fixed=["end"]), hinge_motors=[limited])
    result = simulation.step(CommandSetpoints(np.array([0.4]), 0.05))
    assert result.setpoints[0] == pytest.approx(0.1)
    result = simulation.step(CommandSetpoints(np.array([2.0]), 1.0))
    # It stalls: the angle is what the torque bends the beam to.
    assert 0.1 < result.setpoints[0] < 0.3
    assert result.setpoints[0] == pytest.approx(simulation.actuators.terms[0].angles(
        simulation.state.positions)[0], abs=1e-9)
    assert result.efforts[0] == pytest.approx(0.02, rel=1e-6)
    assert result.report.active_limits == ("m.torque_max",)
    result = simulation.step(CommandSetpoints(np.array([0.0]), 1.0))
    assert result.setpoints[0] == pytest.approx(0.0, abs=1e-9)
    simulation = scene(strip(joined=[hinge("start")]), hinge_motors=[limited])
    result = simulation.step(CommandSetpoints(np.array([2.0]), 1.0))
    assert result.setpoints[0] == pytest.approx(0.5)
    assert result.report.active_limits == ("m.angle_max",)


def test_a_beam_on_a_ball_joint_swings_until_it_hangs_down(scene):
    tilted = [0.1, 0.05, -0.166]
    simulation = scene(
        strip(points=[[0, 0, 0], tilted], stiffer=1e3, elements=2, thickness_direction=[1, -2, 0],
              joined=[{"at": "start", "to": "world", "by": "ball"}], damping={"mass": 8.0}),
        gravity=[0.0, 0.0, -G], integration="dynamic",
    )  # fmt: skip
    ways = [(simulation.step(Hold(0.02)), nodes(simulation)[-1])[1] for _ in range(200)]
    np.testing.assert_allclose(ways[-1], [0.0, 0.0, -np.linalg.norm(tilted)], atol=1e-4)
    # It swings in the plane in which it began.
    across = np.array([0.05, -0.1, 0.0])
    np.testing.assert_allclose(np.array(ways) @ across, 0.0, atol=1e-9)
    assert np.min(ways, axis=0)[0] < -0.01


@pytest.mark.sampled
@pytest.mark.parametrize("elements", [1, 2, 4])
def test_a_stiff_beam_on_a_hinge_swings_with_the_period_of_its_moment_of_inertia(scene, elements):
    tilt, step = 0.05, 0.002
    end = [LENGTH * np.sin(tilt), 0.0, -LENGTH * np.cos(tilt)]
    simulation = scene(
        strip(points=[[0, 0, 0], end], elements=elements, stiffer=1e3, joined=[hinge("start")]),
        gravity=[0.0, 0.0, -G], integration="dynamic",
    )  # fmt: skip
    x = np.array([nodes(simulation)[-1, 0]] + [
        (simulation.step(Hold(step)), nodes(simulation)[-1, 0])[1] for _ in range(1000)
    ])  # fmt: skip
    down = np.flatnonzero((x[:-1] > 0.0) & (x[1:] <= 0.0))
    crossings = step * (down + x[down] / (x[down] - x[down + 1]))
    inertia = MASS * (LENGTH**2 / 3.0 + THICKNESS**2 / 12.0)
    omega = np.sqrt(G * MASS * LENGTH / 2.0 / inertia)
    slower = np.arctan(step * omega) / (step * omega)
    assert len(crossings) >= 2
    found = np.diff(crossings).mean() / (2 * np.pi / omega / slower)
    print(elements, found - 1.0)
    assert found == pytest.approx(1.0, abs=5e-4)
    np.testing.assert_array_less(np.abs(nodes(simulation)[:, 1]), 1e-9)


def test_a_pendulum_on_a_hinge_keeps_its_swing_by_the_scheme_of_second_order(scene):
    end = [LENGTH * np.sin(0.5), 0.0, -LENGTH * np.cos(0.5)]
    simulation = scene(
        strip(points=[[0, 0, 0], end], elements=4, stiffer=1e2, joined=[hinge("start")]),
        gravity=[0.0, 0.0, -G], integration="dynamic", time_scheme="generalized_alpha",
        spectral_radius=0.8,
    )  # fmt: skip
    x = np.array([(simulation.step(Hold(0.004)), nodes(simulation)[-1, 0])[1] for _ in range(600)])
    assert x[-250:].max() == pytest.approx(end[0], rel=2e-3)
    assert x[-250:].min() == pytest.approx(-end[0], rel=2e-3)


CRANK, COUPLER, ROCKER, GROUND = 0.05, 0.15, 0.12, 0.14


def four_bar(scene, **others):
    """Stiff beams: a crank on the left, a coupler, and a rocker on the right, in the plane xz."""
    crank = np.array([0.0, 0.0, CRANK])
    place = rocker_place(crank)
    right = [GROUND, 0.0, 0.0]
    bars = [
        strip("crank", [[0, 0, 0], crank], 1, 1e3, joined=[hinge("start")],
              thickness_direction=[0, 1, 0]),
        strip("coupler", [crank, place], 2, 1e3, thickness_direction=[0, 1, 0],
              joined=[hinge("start", "crank"), {"at": "end", "to": "rocker", "by": "hinge",
                                                "axis": Y}]),
        strip("rocker", [right, place], 2, 1e3, joined=[hinge("start")],
              thickness_direction=[0, 1, 0]),
    ]  # fmt: skip
    return scene(*bars, hinge_motors=[motor(beam="crank")], **others)


def rocker_place(crank):
    """Joint of coupler and rocker: the upper intersection of two circles."""
    between = np.array([GROUND, 0.0, 0.0]) - crank
    distance = np.linalg.norm(between)
    along = (COUPLER**2 - ROCKER**2 + distance**2) / (2.0 * distance)
    up = np.array([-between[2], 0.0, between[0]]) / distance
    return crank + along * between / distance + np.sqrt(COUPLER**2 - along**2) * up


def test_a_closed_loop_of_hinged_beams_moves_as_a_four_bar_linkage(scene):
    simulation = four_bar(scene)
    for angle in np.linspace(0.0, 2.9, 15):
        turn(simulation, angle)
        crank = CRANK * np.array([np.sin(angle), 0.0, np.cos(angle)])
        np.testing.assert_allclose(nodes(simulation, 0)[-1], crank, atol=1e-8)
        np.testing.assert_allclose(nodes(simulation, 1)[-1], rocker_place(crank), atol=1e-6)
        np.testing.assert_allclose(nodes(simulation, 1)[-1], nodes(simulation, 2)[-1], atol=1e-14)


@pytest.mark.exhaustive
def test_a_beam_that_spins_on_a_hinge_keeps_its_axis_and_its_length_over_many_turns(scene):
    simulation = scene(
        strip(elements=1, points=[[0, 0, 0], [LENGTH, 0, 0]], thickness_direction=[0, 0, 1],
              joined=[hinge("start", axis=[0, 0, 1])]),
        integration="dynamic",
    )  # fmt: skip
    frames = simulation.model.nodes.kinds[0]
    velocities = np.zeros((frames.free_node_count, 3))
    velocities[frames.own[0], 0] = velocities[frames.rotations[0], 2] = 20.0
    velocities[frames.translations[0], 1] = 20.0 * LENGTH
    simulation.restore(replace(simulation.state, velocities=velocities))
    angles = [0.0]
    for _ in range(5_000):
        simulation.step(Hold(0.002))
        angles.append(frames.angles(simulation.state.positions)[0])
    assert np.unwrap(angles)[-1] > 10 * 2.0 * np.pi
    tip = nodes(simulation)[-1]
    assert abs(tip[2]) < 2.5e-10
    np.testing.assert_allclose(nodes(simulation)[0], 0.0, atol=1e-14)
    assert np.linalg.norm(tip) == pytest.approx(LENGTH, rel=0.01)


def test_beams_hinged_to_a_guided_body_follow_it(scene):
    base = {"name": "base", "motion": "guided", "box": {"size": [0.05, 0.05, 0.01]},
            "position": [0.0, 0.0, 0.0], "speed": 100.0, "turn_rate": 100.0}  # fmt: skip
    simulation = scene(
        strip(joined=[hinge("start", "base")]), hinge_motors=[motor()], rigid_bodies=[base]
    )
    turn(simulation, 0.5)
    rest = nodes(simulation)
    R = rotation_from_vector([0.3, -0.2, 0.4])
    simulation.model.guides.aim("base", [0.1, 0.2, 0.3], quaternion_from_rotation(R))
    result = turn(simulation, 0.5)
    np.testing.assert_allclose(nodes(simulation), rest @ R.T + [0.1, 0.2, 0.3], atol=1e-8)
    assert abs(result.efforts[0]) < 1e-8


def test_a_platform_on_hinged_legs_bears_its_weight_on_the_motors(scene):
    """A parallelogram of two legs: the motors bear the moment of the weights of all."""
    weight = 0.05
    platform = {"name": "platform", "mass": weight, "motion": "free",
                "box": {"size": [0.1, 0.02, 0.004]}, "position": [0.0, 0.0, -LENGTH]}  # fmt: skip
    legs = [
        strip(f"leg_{k}", [[x, 0, 0], [x, 0, -LENGTH]], stiffer=1e3,
              joined=[hinge("start"), {"at": "end", "to": "platform", "by": "hinge", "axis": Y}])
        for k, x in enumerate((-0.04, 0.04))
    ]  # fmt: skip
    simulation = scene(
        *legs, rigid_bodies=[platform], gravity=[0.0, 0.0, -G],
        hinge_motors=[motor(f"m{k}", f"leg_{k}") for k in range(2)],
        solver={"newton_iterations": 60, "residual_tolerance": 1e-7},
    )  # fmt: skip
    result = turn(simulation, 0.6, 0.6)
    sine = np.sin(0.6)
    moment = G * sine * LENGTH * (weight + MASS)
    assert result.efforts.sum() == pytest.approx(moment, rel=1e-3)
    _, R = simulation.model.nodes.kinds[0].pose(simulation.state.positions, 0)
    np.testing.assert_allclose(R, np.eye(3), atol=1e-4)


def test_the_inverse_problem_turns_motors_to_bring_an_effector_to_its_target(scene):
    simulation = scene(
        strip("a", joined=[hinge("start")]),
        strip("b", [[0, 0, -LENGTH], [LENGTH, 0, -LENGTH]], thickness_direction=[0, 0, 1],
              joined=[hinge("start", "a")]),
        hinge_motors=[motor("m", "a"), motor("n", "b")], gravity=[0.0, 0.0, -G],
        effectors=[{"name": "tip", "body": "b", "points": [[LENGTH, 0, -LENGTH]],
                    "directions": ["x", "z"]}],
        solver={"newton_iterations": 20, "residual_tolerance": 1e-8},
    )  # fmt: skip
    for target in ([0.15, 0.0, -0.25], [0.05, 0.0, -0.3], [-0.1, 0.0, -0.2]):
        result = repeat_step(simulation, FollowTargets(np.array([target]), 0.1), 30)
        tip = simulation.effector_positions()[0]
        np.testing.assert_allclose(tip[[0, 2]], np.array(target)[[0, 2]], atol=2e-5)
    assert result.status is Status.OK
