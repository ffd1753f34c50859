"""Robots that rest as they are mounted: strips bent into place, turned by motors, pulled by cables."""

import numpy as np
import pytest
import yaml

from softrobot_twin.analysis.prestress import prestress
from softrobot_twin.errors import SceneError
from softrobot_twin.scene import load_scene, scene_from_mapping
from softrobot_twin.scene.scene_parameters import changed_scene
from softrobot_twin.simulation import CommandSetpoints, FollowTargets, Hold, Simulation
from softrobot_twin.simulation.mounting import MountingError
from test.places import SCENES
from test.scene_changes import repeat_step, solved

LENGTH, EI = 0.2, 35.0e6 * 0.01 * 0.005**3 / 12.0

STRIP = f"""
name: strip
gravity: [0.0, 0.0, 0.0]
beams:
  - name: strip
    points: [[0.0, 0.0, 0.0], [{LENGTH}, 0.0, 0.0]]
    elements: 12
    section: {{rectangle: {{thickness: 0.005, width: 0.010}}}}
    thickness_direction: [0.0, 0.0, 1.0]
    material: {{young_modulus: 35.0e6, poisson_ratio: 0.45, density: 1220.0}}
    fixed: [start]
    joined: [{{at: end, to: clamp}}]
rigid_bodies:
  - {{name: clamp, motion: fixed, position: [{LENGTH}, 0.0, 0.0], box: {{size: [0.01, 0.01, 0.01]}}}}
"""


UP = {"name": "up", "body": "strip", "pull_point": [0.1, 0.0, 0.1], "points": [[0.1, 0.0, 0.0]],
      "tension": [0.0, 50.0]}  # fmt: skip


def strip(*stages, **changes):
    return scene_from_mapping({**yaml.safe_load(STRIP), **changes, "mounting": list(stages)})


def move(translation=(0.0, 0.0, 0.0), turn=(0.0, 0.0, 0.0), **stage):
    return {"bodies": [{"body": "clamp", "translation": list(translation), "turn": list(turn)}], **stage}


def on_an_arc(angle):
    """Brings the end of the strip to that of a circular arc, which is bent upwards."""
    radius = LENGTH / angle
    way = (radius * np.sin(angle) - LENGTH, 0.0, radius * (1.0 - np.cos(angle)))
    return move(way, (0.0, -angle, 0.0))


def emio(**changes):
    return load_scene(SCENES / "emio.yaml", changes)


@pytest.fixture(scope="module")
def mounted_emio():
    return Simulation(emio())


@pytest.mark.parametrize(("angle", "times"), [(0.5, 1.0), (1.5, 1.0), (3.0, 1.0), (3.0, 6000.0)])
def test_a_strip_bent_to_an_arc_pulls_by_its_bending_stiffness(angle, times):
    scene, stiffness = strip(on_an_arc(angle)), times * EI
    simulation = Simulation(changed_scene(scene, {"beams[0].material.young_modulus": times * 35.0e6}))
    found = prestress(simulation)
    bent = [0.0, stiffness * angle / LENGTH, 0.0]
    np.testing.assert_allclose(found.torques["clamp"], bent, rtol=1e-5, atol=times * 1e-9)
    np.testing.assert_allclose(found.forces["clamp"], 0.0, atol=times * 1e-5)
    assert found.energy == pytest.approx(0.5 * stiffness * angle**2 / LENGTH, rel=1e-5)
    places = simulation.model.beams[0].nodes_mapping().positions(simulation.state.positions)
    radius = LENGTH / angle
    distances = np.hypot(places[:, 0], places[:, 2] - radius)
    np.testing.assert_allclose(distances, radius, atol=1e-6)


def test_emio_hangs_where_others_found_it():
    """With rigid feet 146 mm below the axes of its servos, and 147.6 mm with axes at a radius of 97.5 mm."""
    for inward, depth in ((0.11244, 0.1459), (0.11494, 0.1476)):
        scene = emio(**{"beams.*.arcs": []}, **{f"mounting[0].bodies[{k}].translation": tuple(
            -inward * np.array([np.cos(k * np.pi / 2), np.sin(k * np.pi / 2), 0.0])) for k in range(4)})
        tip = Simulation(scene).effector_positions()[0]
        np.testing.assert_allclose(tip[:2], 0.0, atol=1e-9)
        assert tip[2] == pytest.approx(-depth, abs=5.0e-5)


@pytest.mark.exhaustive
def test_the_number_of_steps_does_not_change_where_emio_hangs(mounted_emio):
    for steps in (1, 2, 11):
        other = Simulation(emio().changed(mounting={"steps": steps}), with_warnings=False)
        np.testing.assert_allclose(other.state.positions, mounted_emio.state.positions, atol=1e-9)


def test_what_is_at_rest_is_the_mounted_shape(mounted_emio):
    rest = mounted_emio.state.positions.copy()
    repeat_step(mounted_emio, CommandSetpoints(np.array([0.4, 0.0, -0.2, 0.1]), 1.0), 10)
    assert np.abs(mounted_emio.state.positions - rest).max() > 0.01
    mounted_emio.reset()
    np.testing.assert_array_equal(mounted_emio.state.positions, rest)
    result = solved(mounted_emio, Hold(0.02))
    np.testing.assert_allclose(mounted_emio.state.positions, rest, atol=1e-9)
    np.testing.assert_allclose(result.efforts, mounted_emio.mounted.efforts, rtol=1e-6)
    np.testing.assert_array_equal(mounted_emio.rest_setpoints, 0.0)


def test_the_mounts_bear_the_weight_and_the_torques_of_the_motors(mounted_emio):
    found, scene = prestress(mounted_emio), mounted_emio.scene
    mass = scene.rigid_bodies[0].mass + sum(beam.mass for beam in mounted_emio.model.beams)
    np.testing.assert_allclose(sum(found.forces.values()), mass * np.array(scene.gravity), atol=1e-8)
    torques = [np.linalg.norm(torque) for torque in found.torques.values()]
    np.testing.assert_allclose(torques, np.abs(mounted_emio.mounted.efforts), rtol=1e-6)


def test_targets_are_reached_from_the_mounted_shape(mounted_emio):
    mounted_emio.reset()
    rest = mounted_emio.effector_positions()
    for way in ([0.02, 0.0, 0.0], [0.0, -0.02, 0.01], [-0.01, 0.01, -0.02]):
        solved(mounted_emio, FollowTargets(rest + way, 0.02), 40)
        np.testing.assert_allclose(mounted_emio.effector_positions(), rest + way, atol=1e-5)


def test_another_number_mounts_from_the_last_mounted_shape(mounted_emio):
    changed = emio().changed(beams={"material": {"young_modulus": 30.0e6}})
    near = Simulation(changed, with_warnings=False, mounted=mounted_emio.mounted)
    anew = Simulation(changed, with_warnings=False)
    np.testing.assert_allclose(near.state.positions, anew.state.positions, atol=1e-9)
    assert np.abs(near.state.positions - mounted_emio.mounted.positions).max() > 1e-4


def test_a_strip_that_is_bent_the_other_way_is_mounted_anew():
    before = Simulation(strip(on_an_arc(1.0)), with_warnings=False).mounted
    found, anew = (Simulation(strip(on_an_arc(-1.0)), with_warnings=False, mounted=one) for one in (before, None))
    np.testing.assert_allclose(found.state.positions, anew.state.positions, atol=1e-9)


@pytest.mark.exhaustive
def test_a_robot_snaps_where_the_branch_of_its_mounting_ends():
    """Three quarters of the way two servos that are turned back let the hub over."""
    asked = {"hinge_motors[1].offset": -0.14321, "hinge_motors[2].offset": -0.07197}
    for leg, sign in enumerate((1, 1, -1, -1)):
        asked |= {f"beams[{leg}].points[0][{leg % 2}]": 0.01405 * sign, f"beams[{leg}].points[0][2]": -0.01608}
    other = changed_scene(emio(), asked)
    found, near = (Simulation(other, with_warnings=False, mounted=one) for one in (None, Simulation(emio()).mounted))
    np.testing.assert_allclose(found.state.positions, near.state.positions, atol=1e-9)


def test_stages_are_made_one_after_the_other():
    first, second = move((0.0, 0.0, 0.02)), move((-0.01, 0.0, 0.0), (0.0, -0.5, 0.0))
    both = Simulation(strip(first, second), with_warnings=False)
    at_once = Simulation(strip(move((-0.01, 0.0, 0.02), (0.0, -0.5, 0.0))), with_warnings=False)
    np.testing.assert_allclose(both.state.positions, at_once.state.positions, atol=1e-9)


def test_a_cable_is_pretensioned_and_its_length_counts_from_there():
    stage = {"actuators": [{"actuator": "up", "displacement": 0.01}], "steps": 3}
    simulation = Simulation(strip(stage, cables=[UP]))
    assert simulation.rest_setpoints[0] == pytest.approx(0.1 - 0.01, abs=1e-9)
    result = simulation.step(CommandSetpoints(simulation.rest_setpoints, 1.0))
    assert simulation.mounted.efforts[0] > 0.1
    assert result.efforts[0] == pytest.approx(simulation.mounted.efforts[0], rel=1e-6)
    np.testing.assert_allclose(simulation.state.positions, simulation.mounted.positions, atol=1e-9)


@pytest.mark.sampled
@pytest.mark.parametrize("tension", [0.05, 2.0])
def test_a_cable_is_wound_to_a_tension_that_it_bears_where_the_robot_is_mounted(tension):
    simulation = Simulation(strip({"actuators": [{"actuator": "up", "tension": tension}]}, cables=[UP]))
    assert simulation.mounted.efforts[0] == pytest.approx(tension, rel=1e-9)
    by_length = {"actuators": [{"actuator": "up", "displacement": 0.1 - float(simulation.rest_setpoints[0])}]}
    same = Simulation(strip(by_length, cables=[UP]))
    np.testing.assert_allclose(simulation.state.positions, same.state.positions, atol=1e-9)
    later = move((-0.01, 0.0, 0.005))
    winding = {"actuators": [{"actuator": "up", "tension": tension}]}
    after = Simulation(strip(winding, later, cables=[UP]))
    assert after.mounted.efforts[0] == pytest.approx(tension, rel=1e-9)
    at_once = Simulation(strip(later | winding, cables=[UP]))
    np.testing.assert_allclose(after.state.positions, at_once.state.positions, atol=1e-9)
    # Another number goes from the last mounted shape to its own.
    key = "mounting[0].actuators[0].tension"
    more = changed_scene(after.model.scene, {key: 1.1 * tension})
    near, anew = Simulation(more, mounted=after.mounted), Simulation(more)
    np.testing.assert_allclose(near.state.positions, anew.state.positions, atol=1e-9)
    assert near.mounted.efforts[0] == pytest.approx(1.1 * tension, rel=1e-9)


@pytest.mark.parametrize("tension", [1.0, 9e4])
def test_a_cable_that_is_wound_up_before_its_tension_is_there_is_refused(tension):
    short = UP | {"pull_point": [0.1, 0.0, 0.004], "tension": [0.0, 1e5]}
    stage = {"actuators": [{"actuator": "up", "tension": tension}]}
    with pytest.raises(SceneError, match=r"mounting\[0\].actuators\[0\].tension = .* N: up is wound up"):
        Simulation(strip(stage, cables=[short]))


def test_a_strip_that_may_snap_to_the_other_side_is_told():
    """Pressed together and pushed up a little, a strip is bent; the same shape downwards is as good."""
    stages = move((0.0, 0.0, 0.0), (0.0, -0.3, 0.0)), move((-0.004, 0.0, 0.0), (0.0, 0.3, 0.0))
    notes = Simulation(strip(*stages)).model.notes
    assert not [note for note in notes if note.startswith("mounting")]
    barely = move((-0.00045, 0.0, 0.0), (0.0, -0.05, 0.0)), move((0.0, 0.0, 0.0), (0.0, 0.05, 0.0))
    notes = Simulation(strip(*barely)).model.notes
    assert [note for note in notes if "another shape" in note]


def test_a_strip_that_cannot_be_bent_so_is_refused_with_the_stage():
    with pytest.raises(MountingError, match=r"mounting\[1\]\.steps = 1: no equilibrium") as caught:
        Simulation(strip(move((0.0, 0.0, 0.01)), move((1.0e5, 0.0, 0.0), (1.0, 1.0, 1.0), steps=1)))
    assert caught.value.simulation.state.positions.shape[1] == 3


@pytest.mark.parametrize("stage, message", [
    ({}, "moves nothing"),
    ({"bodies": [{"body": "clmap", "translation": [0.0, 0.0, 0.0]}]}, "clmap.*clamp"),
    ({"actuators": [{"actuator": "motor", "displacement": 1.0}]}, "motor.*does not have"),
    ({"actuators": [{"actuator": "up"}]}, "displacement or to a tension"),
    ({"actuators": [{"actuator": "up", "tension": 0.0}]}, "tension = 0.0 N: must be above 0"),
    ({"actuators": [{"actuator": "up", "tension": 1.0}, {"actuator": "up", "displacement": 0.01}]},
     "up is moved by other entries"),
    ({"actuators": [{"actuator": "up", "tension": 51.0}]}, "more than up bears, 50 N"),
    ({"bodies": [{"body": "ball", "translation": [0.0, 0.0, 0.0]}]}, "ball.*moves by forces alone"),
])
def test_a_mounting_that_moves_what_it_cannot_is_refused_by_name(stage, message):
    ball = {"name": "ball", "mass": 0.01, "sphere": {"radius": 0.01}}
    bodies = [*yaml.safe_load(STRIP)["rigid_bodies"], ball]
    with pytest.raises(SceneError, match=message):
        strip(stage, rigid_bodies=bodies, cables=[UP])


@pytest.mark.exhaustive
def test_twelve_elements_a_strip_are_within_a_tenth_of_a_millimetre(drawn_rng):
    rng, found = drawn_rng, []
    angles = rng.uniform(-0.8, 0.8, (10, 4))
    for elements in (12, 64):
        simulation = Simulation(emio().changed(beams={"elements": elements}), with_warnings=False)
        places = [simulation.effector_positions()[0]]
        for aim in angles:
            simulation.reset()
            for share in np.linspace(0.1, 1.0, 10):
                repeat_step(simulation, CommandSetpoints(share * aim, 1.0), 3)
            places.append(simulation.effector_positions()[0])
        found.append(np.array(places))
    apart = np.linalg.norm(found[0] - found[1], axis=1)
    print(f"largest difference of 12 and 64 elements {1000.0 * apart.max():.3f} mm")
    assert apart.max() < 1.0e-4


@pytest.mark.exhaustive
def test_the_points_at_which_its_makers_measured_it_are_reached():
    """A ball of 80 mm across, 130 mm below the axes (SofaComplianceRobotics, Emio.validation, 2026)."""
    grid = 0.016 * np.stack(np.meshgrid(*3 * [np.arange(-2, 3)], indexing="ij"), axis=-1).reshape(-1, 3)
    poles = 0.04 * np.vstack([np.eye(3), -np.eye(3)])
    points = np.vstack([grid[np.linalg.norm(grid, axis=1) <= 0.04], poles]) - [0.0, 0.0, 0.13]
    simulation = Simulation(emio(), with_warnings=False)
    for point in points:
        solved(simulation, FollowTargets(point[None], 0.02), 60)
        assert np.linalg.norm(simulation.effector_positions() - point) < 1.0e-5


@pytest.mark.exhaustive
def test_sixty_reachable_poses_are_reached(drawn_rng):
    rng, simulation = drawn_rng, Simulation(emio(), with_warnings=False)
    for _ in range(60):
        simulation.reset()
        aim = rng.uniform(-1.1, 1.7, 4)
        for share in np.linspace(0.2, 1.0, 5):
            simulation.step(CommandSetpoints(share * aim, 1.0))
        repeat_step(simulation, CommandSetpoints(aim, 1.0), 5)
        target = simulation.effector_positions().copy()
        simulation.reset()
        solved(simulation, FollowTargets(target, 0.02), 40)
        assert np.linalg.norm(simulation.effector_positions() - target) < 1.0e-5
