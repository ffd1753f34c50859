"""What is shown of simulations: entities and curves of what a robot has, and of nothing else."""

from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from softrobot_twin.simulation import Hold, Simulation
from softrobot_twin.view import ViewError
from softrobot_twin.view.drawn_parts import CavityDisplay, obstacle_skins, rigid_skins
from softrobot_twin.view.simulation_frames import SimulationFrames
from test.places import SCENES


@cache
def shown(name):
    """Simulation, stage and frame of a scene after a step."""
    simulation = Simulation.from_scene_file(SCENES / f"{name}.yaml")
    return simulation, *frame_of(simulation)


def frame_of(simulation, **changes):
    frames, result = SimulationFrames(simulation, force_scale=0.05), simulation.step(Hold(0.01))
    count, markers = len(simulation.effector_names), simulation.marker_positions()
    given = dict(targets=np.full((count, 3), np.nan), target_orientations=np.full((count, 4), np.nan),
                 errors=result.effector_errors, predicted_markers=markers,
                 measured_markers=np.full_like(markers, np.nan), status="ok")
    frame = frames.frame(7, 70, result, **{**given, **changes})
    return frames.stage, frame, result


def entity(stage, path):
    (found,) = [one for one in stage.entities if one.path == path]
    return found


@pytest.mark.parametrize(("name", "things", "plots"), [
    ("finger", {"robot", "targets", "markers"}, {"cable_lengths", "cable_tensions"}),
    ("springy", {"robot", "targets", "markers"}, {"cavity_pressures", "cavity_volumes"}),
    ("strider", {"robot", "targets", "markers", "rigid_bodies", "rigid_frames"}, {"actuators"}),
    ("grasper", {"robot", "targets", "markers", "rigid_bodies", "rigid_frames", "obstacles",
                 "contacts"},
     {"cable_lengths", "cable_tensions", "contacts"}),
])
def test_a_stage_has_what_the_robot_has_and_nothing_else(name, things, plots):
    simulation, stage, frame, _ = shown(name)
    assert {one.path.split("/")[1] for one in stage.entities} == things
    assert {plot.path.split("/")[2] for plot in stage.plots} - {"effector_error", "residual"} == plots
    drawn = {one.path.split("/")[2] for one in stage.entities if one.path.startswith("/robot")}
    assert ("cables" in drawn) == ("pull_points" in drawn) == ("cable_lengths" in plots)
    assert ("cavities" in drawn) == bool(CavityDisplay(simulation.model).skins) == ("cavities:" in stage.title)
    still = {one.path for one in stage.entities} - frame.drawn.keys()
    assert all(path.startswith(("/obstacles", "/robot/fixed")) for path in still)


def test_cables_have_paths_tensions_and_pull_points():
    simulation, stage, frame, result = shown("finger")
    paths = simulation.actuator_paths()
    cables, pulled = frame.drawn["/robot/cables"], frame.drawn["/robot/pull_points"]
    assert list(entity(stage, "/robot/cables").labels) == list(paths)
    for path, line, place in zip(paths.values(), cables.points, pulled.points, strict=True):
        np.testing.assert_array_equal(line, path)
        np.testing.assert_array_equal(place, path[0])
    np.testing.assert_array_equal(cables.values, result.efforts)
    np.testing.assert_allclose(frame.curves["/plots/cable_lengths"], 1e3 * result.setpoints)
    np.testing.assert_array_equal(frame.curves["/plots/cable_tensions"], result.efforts)
    assert len(entity(stage, "/robot/fixed/body").points) > 0
    assert frame.times["whole step"] == result.report.compute_time


def test_cavities_have_walls_pressures_and_volumes_in_their_units():
    simulation, stage, frame, _ = shown("springy")
    cavities = CavityDisplay(simulation.model)
    pressures = cavities.pressures(simulation.state)
    for skin, points, pressure in zip(cavities.skins, cavities.positions(simulation.state),
                                      pressures, strict=True):
        wall = frame.drawn[f"/robot/cavities/{skin.name}"]
        np.testing.assert_array_equal(wall.points, points)
        assert wall.values == [pressure]
    plots = {plot.path: plot.names for plot in stage.plots}
    for plot, unit in (("pressures", "kPa"), ("volumes", "cm³")):
        assert plots[f"/plots/cavity_{plot}"][0] == f"{cavities.skins[0].name} [{unit}]"
    np.testing.assert_allclose(frame.curves["/plots/cavity_pressures"], 1e-3 * pressures)
    np.testing.assert_allclose(frame.curves["/plots/cavity_volumes"],
                               1e6 * cavities.volumes(simulation.state))


def test_other_actuators_have_curves_of_setpoint_and_effort_in_their_units():
    simulation, stage, frame, result = shown("trunk")
    (plot,) = [plot for plot in stage.plots if plot.path == "/plots/actuators"]
    (name,) = simulation.actuators.kind_of.keys() - set(entity(stage, "/robot/cables").labels)
    place = list(simulation.actuator_names).index(name)
    assert plot.names == [f"{name} [mm]", f"{name} [N]"]
    np.testing.assert_allclose(frame.curves[plot.path],
                               [1e3 * result.setpoints[place], result.efforts[place]])


def test_rigid_bodies_obstacles_and_scaled_contact_forces_are_shown():
    simulation, stage, frame, result = shown("grasper")
    for skin, place, turn in zip(rigid_skins(simulation.model), *simulation.rigid_poses(), strict=True):
        path = f"/rigid_bodies/{skin.name}"
        np.testing.assert_array_equal(entity(stage, path).points, skin.points)
        np.testing.assert_array_equal(frame.drawn[path].points, place)
        np.testing.assert_array_equal(frame.drawn[path].vectors, turn)
    for skin in obstacle_skins(simulation.model):
        np.testing.assert_array_equal(entity(stage, f"/obstacles/{skin.name}").points, skin.points)
    assert len(result.contacts.forces) > 0
    np.testing.assert_array_equal(frame.drawn["/contacts/points"].points, result.contacts.positions)
    np.testing.assert_allclose(frame.drawn["/contacts/forces"].vectors, 0.05 * result.contacts.forces)
    assert frame.curves["/plots/contacts"] == [
        len(result.contacts.forces), np.linalg.norm(result.contacts.forces, axis=1).max()]


def test_orientations_of_effectors_and_targets_are_axes(oriented_rod):
    simulation = oriented_rod({})
    turn = Rotation.from_euler("z", 90.0, degrees=True)
    stage, none, _ = frame_of(simulation)
    _, turned, _ = frame_of(simulation, target_orientations=turn.as_quat()[None])
    length = np.linalg.norm(none.drawn["/robot/effector_axes"].vectors, axis=1)
    assert length == pytest.approx(0.1 * simulation.model.nodes.size)
    np.testing.assert_allclose(none.drawn["/robot/effector_axes"].vectors, length[0] * np.eye(3), atol=1e-9)
    assert len(none.drawn["/target_axes"].vectors) == 0
    np.testing.assert_allclose(
        turned.drawn["/target_axes"].vectors,
        length[0] * np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1]]), atol=1e-9)
    np.testing.assert_allclose(turned.drawn["/target_axes"].points, [[0, 0, 0.2]] * 3, atol=1e-9)


@pytest.mark.parametrize("scale", [0.0, -1.0, np.nan, np.inf])
def test_a_force_scale_that_is_not_above_zero_is_refused_by_name(scale):
    with pytest.raises(ViewError) as refusal:
        SimulationFrames(shown("finger")[0], force_scale=scale)
    assert refusal.value.key == "force_scale"
