"""Reactions: supports bear the weight, the loads and the change of momentum, to round-off."""

import numpy as np
import pytest

from softrobot_twin.errors import SceneError
from softrobot_twin.simulation import CommandEfforts, CommandSetpoints, Hold, Status, Touched
from softrobot_twin.simulation.step.step_part import StepPart
from test.builder import builder

G = np.array([0.0, 0.0, -9.81])
SIZE = (0.02, 0.03, 0.06)
FOOT = {"box": {"minimum": [-1, -1, -1e-6], "maximum": [1, 1, 1e-6]}}
TOP = {"box": {"minimum": [-1, -1, 0.0599], "maximum": [1, 1, 1]}}
BASE = {"name": "base", "of": "soft"}
ABOUT = np.array([0.1, -0.05, 0.02])


@builder
def standing(simulate, body_of, block, /, reactions=(BASE,), fixed=(FOOT,), mass="lumped", attached=(),
             cells=(2, 2, 4), damping=None, **entries):  # fmt: skip
    """Makes a soft block that stands on its foot."""
    body = body_of(block(size=SIZE, cells=cells), fixed=list(fixed), mass=mass,
                   attached=list(attached), **({"damping": damping} if damping else {}))
    return simulate(body=body, reactions=list(reactions), gravity=list(G), **entries)


def wrenches(result):
    return result.state.memory["reactions.wrenches"]


def weights(simulation):
    """Place and weight of each node of the only deformable body [m] and [N]."""
    body = simulation.model.bodies[0]
    x = simulation.state.positions[: body.mesh.node_count]
    return x, body.node_masses()[:, None] * G


def total(places, forces, about):
    """Force and torque of forces at places about a point."""
    return np.concatenate([forces.sum(axis=0), np.cross(places - about, forces).sum(axis=0)])


def cable(name, x, **entries):
    return {"name": name, "pull_point": [x, 0.01, -0.03], "points": [[x, 0.01, 0.03], [x, 0.02, 0.05]],
            "shortening": [0.0, 0.05], "tension": [0.0, 20.0], **entries}  # fmt: skip


@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_the_foot_bears_the_weight_and_the_tensions(standing, friction):
    own = {"friction": friction} if friction else {}
    robot = standing([{**BASE, "about": ABOUT.tolist()}],
                     cables=[cable("left", 0.002, **own), cable("right", 0.018)])
    for _ in range(4):
        result = robot.step(CommandSetpoints(robot.rest_setpoints - [0.008, 0.001], 1.0))
    assert result.status is Status.OK and result.efforts[0] > 1.0
    x, pulls = weights(robot)
    loads = total(x, pulls, ABOUT)
    for name, effort in zip(robot.actuator_names, result.efforts):
        # Friction takes from the tension along the cable, and gives it to the body: the pull point's
        # tension is all that acts from outside.
        start, first = robot.actuator_paths()[name][:2]
        pull = effort * (start - first) / np.linalg.norm(start - first)
        loads += total(first[None], pull[None], ABOUT)
    np.testing.assert_allclose(wrenches(result)[0], -loads, atol=1e-8)


def test_supports_share_what_they_hold_together(standing):
    """A block between two plates that are pressed together, one of them a guided body."""
    plate = {"name": "plate", "motion": "guided", "position": [0.01, 0.015, 0.062],
             "box": {"size": [0.05, 0.05, 0.004]}}  # fmt: skip
    robot = standing(
        [BASE, {"name": "grip", "of": "soft", "attached_to": "plate"}, {"name": "arm", "of": "plate"}],
        attached=[{"to": "plate", **TOP}], rigid_bodies=[plate])  # fmt: skip
    robot.model.guides.aim("plate", np.array([0.014, 0.015, 0.058]), np.array([0, 0, 0, 1.0]))
    for _ in range(6):
        result = robot.step(Hold(1.0))
    base, grip, arm = wrenches(result)
    x, pulls = weights(robot)
    np.testing.assert_allclose(base[:3] + arm[:3], -pulls.sum(axis=0), atol=1e-8)
    np.testing.assert_allclose(grip[:3], arm[:3], atol=1e-12)
    assert arm[2] < -1.0 and arm[0] > 0.1
    middle = robot.state.positions[-4]
    about = robot.state.positions[np.flatnonzero(robot.model.bodies[0].mesh.node_positions[:, 2] > 0.0599)]
    np.testing.assert_allclose(arm[3:], grip[3:] + np.cross(about.mean(axis=0) - middle, grip[:3]), atol=1e-9)


@pytest.mark.parametrize("friction", [0.0, 0.5])
def test_a_plate_that_presses_bears_its_contacts(standing, friction):
    plate = {"name": "plate", "motion": "guided", "position": [0.011, 0.016, 0.0645],
             "box": {"size": [0.05, 0.05, 0.004]}}  # fmt: skip
    robot = standing([BASE, {"name": "arm", "of": "plate"}], rigid_bodies=[plate],
                     contact={"between": [{"pair": ["plate", "soft"]}], "friction": friction})
    for z in (0.062, 0.0615, 0.061, 0.061, 0.061, 0.061):
        robot.model.guides.aim("plate", np.array([0.011, 0.016, z]), np.array([0, 0, 0, 1.0]))
        result = robot.step(Hold(1.0))
    base, arm = wrenches(result)
    pressed = result.contacts.of_pairs().resultants[0]
    sign = 1.0 if result.contacts.names[0][0] == "soft" else -1.0
    assert sign * pressed[2] < -0.3
    np.testing.assert_allclose(arm[:3], sign * pressed, rtol=1e-9, atol=1e-12)
    about = np.array([*plate["position"][:2], 0.061])
    moments = total(result.contacts.positions, sign * result.contacts.forces, about)
    np.testing.assert_allclose(arm[3:], moments[3:], atol=1e-4 * abs(pressed[2]))
    np.testing.assert_allclose(base[:3] + arm[:3], -G * robot.model.bodies[0].mass, atol=1e-5)


def test_a_touch_ends_in_the_foot(standing):
    robot = standing(touches=[{"name": "push", "points": [[0.01, 0.0, 0.05]]}])
    push = np.array([0.0, 0.2, 0.05])
    for _ in range(4):
        result = robot.step(Hold(1.0), None, Touched(push[None], np.full((1, 3), np.nan)))
    base = wrenches(result)[0]
    np.testing.assert_allclose(base[:3], -push - G * robot.model.bodies[0].mass, atol=1e-9)


@pytest.mark.parametrize("damping", [None, {"mass": 2.0, "stiffness": 0.01}])
@pytest.mark.parametrize("mass", ["lumped", "consistent"])
def test_in_motion_the_foot_bears_the_change_of_momentum(standing, mass, damping):
    robot = standing(integration="dynamic", mass=mass, damping=damping)
    h, terms, nodes = 0.004, robot.model.forces, robot.model.nodes
    total_mass = robot.model.bodies[0].mass
    for _ in range(5):
        before = robot.state
        result = robot.step(Hold(h))
        inertia = next(term for term in terms if term.is_inertia)
        force = inertia.momentum(result.state.velocities - before.velocities) / h
        force -= total_mass * G
        if damping is not None:
            own = robot.model.bodies[0].node_masses()[nodes.free_nodes]
            force += damping["mass"] * own @ result.state.velocities
        assert np.linalg.norm(force + total_mass * G) > 1e-3 * total_mass * 9.81
        np.testing.assert_allclose(wrenches(result)[0, :3], force, atol=1e-9)


def test_a_clamped_beam_is_held_by_a_moment(simulate):
    rod = {"name": "rod", "points": [[0, 0, 0], [0.2, 0, 0]], "elements": 8, "fixed": ["start"],
           "section": {"circle": {"radius": 0.003}},
           "material": {"young_modulus": 1e7, "poisson_ratio": 0.3, "density": 1500.0}}  # fmt: skip
    robot = simulate(beams=[rod], gravity=list(G), reactions=[{"name": "clamp", "of": "rod"}],
                     solver={"newton_iterations": 60, "residual_tolerance": 1e-11})  # fmt: skip
    result = robot.step(Hold(1.0))
    nodes = robot.model.beams[0].nodes_mapping().positions(robot.state.positions)
    weight = robot.model.beams[0].mass * 9.81
    force, torque = np.split(wrenches(result)[0], 2)
    np.testing.assert_allclose(force, [0.0, 0.0, weight], atol=1e-10)
    shares = np.full(len(nodes), 1.0)
    shares[[0, -1]] = 0.5
    lever = shares @ nodes[:, 0] / shares.sum()
    np.testing.assert_allclose(torque, [0.0, -weight * lever, 0.0], rtol=2e-3, atol=1e-10)


def test_point_masses_hang_on_their_fixed_point(simulate):
    net = {"name": "net", "points": [[0, 0, 0], [0, 0, -0.1], [0, 0.05, -0.15]], "fixed": [0],
           "springs": [[0, 1], [1, 2]], "stiffness": 50.0, "masses": 0.02}  # fmt: skip
    robot = simulate(mass_springs=[net], gravity=list(G), integration="dynamic",
                     reactions=[{"name": "hook", "of": "net"}])  # fmt: skip
    result = robot.step(Hold(0.01))
    momentum = 0.02 * result.state.velocities.sum(axis=0) / 0.01
    np.testing.assert_allclose(wrenches(result)[0, :3], momentum - 0.06 * G, atol=1e-9)


def test_a_kept_state_keeps_its_reactions_and_the_first_step_tells_them(standing):
    robot = standing(cables=[cable("left", 0.002)])
    first = robot.step(CommandEfforts(np.array([0.0]), 1.0))
    assert np.isfinite(wrenches(first)).all()
    for _ in range(3):
        result = robot.step(Hold(1.0))
    assert robot.kept is not None
    np.testing.assert_allclose(wrenches(result)[0, :3], -G * robot.model.bodies[0].mass, atol=1e-9)


def test_without_reactions_no_part_is_built(standing):
    names = [part.name for part in standing(reactions=()).parts if isinstance(part, StepPart)]
    assert "reactions" not in names


@pytest.mark.parametrize("reactions, more, words", [
    ([{"name": "base", "of": "sofd"}], {}, "is soft meant"),
    ([{"name": "base", "of": "soft", "attached_to": "plate"}], {}, "plate"),
    ([BASE, BASE], {}, "more than once"),
    ([BASE], {"integration": "dynamic", "time_scheme": "generalized_alpha"}, "time_scheme"),
    ([{"name": "box", "of": "box"}], {"integration": "dynamic", "rigid_bodies": [
        {"name": "box", "mass": 1.0, "sphere": {"radius": 0.01}}]}, "is not held"),
])  # fmt: skip
def test_what_nothing_holds_or_is_not_built_is_refused_by_name(standing, reactions, more, words):
    with pytest.raises(SceneError, match=words):
        standing(reactions, **more)
