"""The draw list of a simulation: what each effect draws, and what labels name."""

import numpy as np
import pytest

from softrobot_twin.scene import scene_from_mapping
from softrobot_twin.simulation import Hold, Simulation
from softrobot_twin.view.draw_list import DrawList, Shown
from softrobot_twin.view.drawn_parts import rigid_skins
from test.places import SCENES


def listed(simulation, **changes):
    """Entities and what is drawn of them, by path."""
    drawing = DrawList(simulation, force_scale=0.5)
    entities = {entity.path: entity for entity in drawing.entities}
    drawn = drawing.drawn(Shown.of(simulation)._replace(**changes))
    return entities, drawn


def test_masses_springs_and_threads_are_drawn_where_they_are():
    simulation = Simulation(scene_from_mapping({
        "name": "hung", "integration": "dynamic",
        "mass_springs": [{"name": "pair", "points": [[0.0, 0.0, 0.1], [0.1, 0.0, 0.1]],
                          "masses": [0.1, 0.2], "springs": [[0, 1]], "stiffness": 50.0}],
        "springs": [{"name": "hanger", "stiffness": 100.0, "ends": [
            {"point": [0.0, 0.0, 0.3]}, {"on": "pair", "point": [0.0, 0.0, 0.1]}]}]}))  # fmt: skip
    for _ in range(3):
        simulation.step(Hold(0.01))
    entities, drawn = listed(simulation)
    assert {entity.kind for entity in entities.values()} >= {"mass", "spring"}
    assert "/robot/threads" not in entities
    masses = drawn["/robot/masses"].points
    assert masses[0][2] < 0.1
    hanger, own = drawn["/robot/springs"].points
    np.testing.assert_allclose(hanger, [masses[0], [0.0, 0.0, 0.3]], atol=1e-12)
    np.testing.assert_allclose(own, masses, atol=1e-12)


def test_threads_of_tubes_are_lines_of_two_points():
    entities, drawn = listed(Simulation.from_scene_file(SCENES / "trunk.yaml"))
    threads = drawn["/robot/threads"].points
    assert threads.shape[1:] == (2, 3) and len(threads) > 10
    assert entities["/robot/threads"].kind == "thread" and "/robot/springs" not in entities


def test_motors_have_axes_and_no_pull_points():
    simulation = Simulation.from_scene_file(SCENES / "strider.yaml")
    entities, drawn = listed(simulation)
    (path,) = [path for path, entity in entities.items() if entity.kind == "axis"]
    assert list(entities[path].labels) == list(simulation.actuator_names)
    np.testing.assert_array_equal(
        drawn[path].points[0], simulation.actuator_paths()[simulation.actuator_names[0]])
    assert "/robot/pull_points" not in entities


def test_frames_of_rigid_bodies_turn_with_them_and_are_no_longer_than_they():
    simulation = Simulation.from_scene_file(SCENES / "grasper.yaml")
    entities, drawn = listed(simulation)
    frames = drawn["/rigid_frames"]
    places, _ = simulation.rigid_poses()
    np.testing.assert_array_equal(frames.points, np.repeat(places, 3, axis=0))
    triads = frames.vectors.reshape(-1, 3, 3)
    lengths = np.linalg.norm(triads, axis=2)
    for triad, length, skin in zip(triads, lengths, rigid_skins(simulation.model), strict=True):
        np.testing.assert_allclose(triad @ triad.T, length[0] ** 2 * np.eye(3), atol=1e-12)
        assert length[0] < np.ptp(skin.points, axis=0).max()
    assert {entity.kind for path, entity in entities.items() if path.startswith("/rigid_bodies")} == {
        "free body", "guided body"}


def test_touches_show_points_and_scaled_forces():
    simulation = Simulation.from_scene_file(SCENES / "stifface.yaml")
    entities, drawn = listed(simulation)
    assert list(entities["/touches/points"].labels) == list(simulation.touch_names)
    assert np.shape(drawn["/touches/forces"].vectors) == (len(simulation.touch_names), 3)


def test_an_effector_that_points_shows_the_one_axis(oriented_rod):
    simulation = oriented_rod({"pointing": [0, 3, 0]})
    _, drawn = listed(simulation)
    axes = drawn["/robot/effector_axes"]
    assert axes.vectors == pytest.approx(np.array([[0.0, 0.1 * simulation.model.nodes.size, 0.0]]))
    np.testing.assert_allclose(axes.points, [[0.0, 0.0, 0.2]])
