"""Content of an .rrd file after frames have been drawn into it."""

from dataclasses import replace

import numpy as np
import pytest

from softrobot_twin.view import Drawn, Entity

pytestmark = pytest.mark.libraries


def test_a_recording_holds_the_robot_its_surroundings_and_its_curves(draw, make_frame):
    entities = draw([make_frame(0)]).entities
    assert {"/robot/surface/body", "/robot/cables", "/robot/effectors", "/robot/effector_trail",
            "/targets", "/markers/predicted", "/markers/measured", "/status"} <= entities
    plots = {"/".join(path.split("/")[:3]) for path in entities if path.startswith("/plots/")}
    assert plots == {f"/plots/{name}" for name in ("cable_lengths", "stage_times", "residual")}


def test_space_is_right_handed_with_z_up(draw, make_frame):
    from rerun import ViewCoordinates
    (logged,) = draw([make_frame(0)]).static("/", "ViewCoordinates:xyz")
    expected = ViewCoordinates.RIGHT_HAND_Z_UP.as_component_batches()[-1].as_arrow_array()
    assert logged == expected.to_pylist()[-1]


def test_triangles_are_logged_once_and_positions_at_each_step(draw, make_frame, stage):
    frames = [make_frame(step) for step in (3, 4, 8)]
    recorded = draw(frames)
    assert recorded.static("/robot/surface/body", "Mesh3D:triangle_indices") == \
        stage.entities[0].triangles.tolist()
    positions = recorded.at_steps("/robot/surface/body", "Mesh3D:vertex_positions")
    assert positions.keys() == {3, 4, 8}
    for frame in frames:
        assert np.array(positions[frame.step]) == pytest.approx(
            frame.drawn["/robot/surface/body"].points, abs=1e-8)


def test_points_are_at_the_positions_of_the_frame(draw, make_frame):
    frame = make_frame(2)
    recorded = draw([frame])
    for entity in ("/robot/effectors", "/targets", "/markers/predicted", "/markers/measured"):
        logged = recorded.at_steps(entity, "Points3D:positions")[2]
        assert np.array(logged) == pytest.approx(frame.drawn[entity].points, abs=1e-8), entity


def test_a_hidden_marker_is_omitted_and_the_others_keep_their_names(draw, make_frame):
    markers = make_frame(0).drawn["/markers/measured"].points
    markers[1] = np.nan
    recorded = draw([make_frame(0, {"/markers/measured": Drawn(markers)})])
    logged = recorded.at_steps("/markers/measured", "Points3D:positions")[0]
    assert np.array(logged) == pytest.approx(markers[[0, 2]], abs=1e-8)
    assert recorded.at_steps("/markers/measured", "Points3D:labels")[0] == ["4", "9"]
    assert recorded.static("/markers/predicted", "Points3D:labels") == ["4", "7", "9"]


def test_a_removed_target_is_no_longer_shown(draw, make_frame):
    nowhere = np.full((1, 3), np.nan)
    recorded = draw([make_frame(0), make_frame(1, {"/targets": Drawn(nowhere)})])
    positions = recorded.at_steps("/targets", "Points3D:positions")
    assert len(positions[0]) == 1
    assert positions[1] == []


def test_a_solid_is_logged_once_with_sharp_edges_and_its_pose_in_each_frame(draw, make_frame, stage):
    corners, triangles = make_frame(0).drawn["/robot/surface/body"].points, stage.entities[0].triangles
    solids = [Entity(path, "solid", (0, 0, 0), triangles=triangles, points=corners)
              for path in ("/rigid_bodies/stone", "/obstacles/floor")]
    moved = [Drawn(np.array([0.1, 0.2, 0.01 * step]), np.array([0.0, 0.0, np.sin(step), np.cos(step)]))
             for step in range(3)]
    recorded = draw([make_frame(step, {"/rigid_bodies/stone": one}) for step, one in enumerate(moved)],
                    replace(stage, entities=(*stage.entities, *solids)))
    for solid in solids:
        mesh = np.array(recorded.static(solid.path, "Mesh3D:vertex_positions"))
        assert mesh == pytest.approx(corners[triangles].reshape(-1, 3), abs=1e-8)
        normals = np.array(recorded.static(solid.path, "Mesh3D:vertex_normals"))
        outward = mesh.reshape(-1, 3, 3).mean(axis=1) - mesh.mean(axis=0)
        assert (np.einsum("ti,ti->t", outward, normals[::3]) > 0.0).all()
        assert normals[0] == pytest.approx(normals[1]) and normals[0] == pytest.approx([0, 0, -1])
        assert recorded.at_steps(solid.path, "Mesh3D:vertex_positions") == {}
    places = recorded.at_steps("/rigid_bodies/stone", "Transform3D:translation")
    turns = recorded.at_steps("/rigid_bodies/stone", "Transform3D:quaternion")
    for step, one in enumerate(moved):
        assert places[step][0] == pytest.approx(one.points, abs=1e-7)
        assert turns[step][0] == pytest.approx(one.vectors, abs=1e-7)


def test_arrows_have_their_origins_and_vanish_with_what_they_show(draw, make_frame, stage):
    arrows = Entity("/contacts/forces", "arrows", (0, 0, 0))
    places, forces = np.array([[0.01, 0.02, 0.03]]), np.array([[0.0, 0.1, 0.2]])
    nothing = Drawn(np.empty((0, 3)), np.empty((0, 3)))
    recorded = draw([make_frame(0, {arrows.path: Drawn(places, forces)}),
                     make_frame(1, {arrows.path: nothing})],
                    replace(stage, entities=(*stage.entities, arrows)))
    drawn = recorded.at_steps(arrows.path, "Arrows3D:vectors")
    assert np.array(drawn[0]) == pytest.approx(forces, abs=1e-7) and drawn[1] == []
    origins = recorded.at_steps(arrows.path, "Arrows3D:origins")
    assert np.array(origins[0]) == pytest.approx(places, abs=1e-7)
