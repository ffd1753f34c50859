"""Rigid bodies, obstacles and contacts in a recording."""

import dataclasses

import numpy as np
import pytest

from softrobot_twin.view import Surface

CORNERS = 0.02 * np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)
TRIANGLES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])


@pytest.fixture
def crowded_stage(stage):
    """The stage with two more soft bodies, two rigid ones, a floor, and contact."""
    return dataclasses.replace(
        stage, bodies=(*stage.bodies, Surface("second", stage.bodies[0].triangles[:2])),
        rigid_bodies=(Surface("stone", TRIANGLES, CORNERS), Surface("palm", TRIANGLES, CORNERS)),
        obstacles=(Surface("floor", np.array([[0, 1, 2]]), CORNERS[:3] - [0, 0, 0.1]),),
        shows_contact=True, force_scale=0.05)


@pytest.fixture
def make_crowded(make_frame):
    """Makes a frame of that stage, by default without contact."""

    def make(step, **changes):
        frame = make_frame(step)
        (body,) = frame.surface_positions
        turn = np.array([0.0, 0.0, np.sin(0.1 * step), np.cos(0.1 * step)])
        return dataclasses.replace(frame, **{**dict(
            surface_positions=(body, body + [0.3, 0.0, 0.0]),
            rigid_positions=np.array([[0.1, 0.2, 0.01 * step], [0.0, 0.0, 0.5]]),
            rigid_quaternions=np.array([turn, [0.0, 0.0, 0.0, 1.0]])), **changes})

    return make


@pytest.fixture
def draw(tmp_path, read_recording):
    """Draws frames of a stage into a file, one by one, and reads it back."""
    from softrobot_twin.view import picture, recording
    from softrobot_twin.view.picture import Picture

    def draw(stage, frames):
        path = tmp_path / "drawn.rrd"
        layout = picture.layout(stage)
        drawn = Picture(recording.record_to(path, "test", layout), stage)
        for frame in frames:
            drawn.log(frame)
        drawn.close(10.0)
        return read_recording(path)

    return draw


def test_every_soft_body_is_an_entity_of_its_own(draw, crowded_stage, make_crowded):
    frame = make_crowded(2)
    recorded = draw(crowded_stage, [frame])
    for name, positions in zip(("body", "second"), frame.surface_positions):
        logged = recorded.at_steps(f"/robot/surface/{name}", "Mesh3D:vertex_positions")[2]
        assert np.array(logged) == pytest.approx(positions, abs=1e-7)


def test_a_rigid_body_s_mesh_is_logged_once_and_its_pose_in_each_frame(
    draw, crowded_stage, make_crowded
):
    frames = [make_crowded(step) for step in (1, 2, 5)]
    recorded = draw(crowded_stage, frames)
    mesh = np.array(recorded.static("/rigid_bodies/stone", "Mesh3D:vertex_positions"))
    assert mesh == pytest.approx(CORNERS[TRIANGLES].reshape(-1, 3), abs=1e-8)
    assert recorded.at_steps("/rigid_bodies/stone", "Mesh3D:vertex_positions") == {}
    places = recorded.at_steps("/rigid_bodies/stone", "Transform3D:translation")
    turns = recorded.at_steps("/rigid_bodies/stone", "Transform3D:quaternion")
    assert places.keys() == turns.keys() == {1, 2, 5}
    for frame in frames:
        assert places[frame.step][0] == pytest.approx(frame.rigid_positions[0], abs=1e-7)
        assert turns[frame.step][0] == pytest.approx(frame.rigid_quaternions[0], abs=1e-7)


def test_a_solid_s_normals_point_outward_and_keep_its_edges_sharp(
    draw, crowded_stage, make_crowded
):
    recorded = draw(crowded_stage, [make_crowded(0)])
    corners = np.array(recorded.static("/rigid_bodies/stone", "Mesh3D:vertex_positions"))
    normals = np.array(recorded.static("/rigid_bodies/stone", "Mesh3D:vertex_normals"))
    outward = corners.reshape(-1, 3, 3).mean(axis=1) - corners.mean(axis=0)
    assert (np.einsum("ti,ti->t", outward, normals[::3]) > 0.0).all()
    assert normals[0] == pytest.approx(normals[1]) and normals[0] == pytest.approx([0, 0, -1])


def test_an_obstacle_is_logged_at_its_position_for_all_times(draw, crowded_stage, make_crowded):
    recorded = draw(crowded_stage, [make_crowded(0), make_crowded(1)])
    points = recorded.static("/obstacles/floor", "Mesh3D:vertex_positions")
    assert np.array(points) == pytest.approx(CORNERS[:3] - [0, 0, 0.1], abs=1e-8)
    assert recorded.at_steps("/obstacles/floor", "Mesh3D:vertex_positions") == {}


def test_contact_forces_are_scaled_arrows_at_their_points_and_vanish_with_the_contact(
    draw, crowded_stage, make_crowded
):
    places = np.array([[0.01, 0.02, 0.03], [0.04, 0.05, 0.06]])
    forces = np.array([[0.0, 0.0, 2.0], [1.0, -1.0, 0.0]])
    recorded = draw(crowded_stage, [
        make_crowded(0), make_crowded(1, contact_positions=places, contact_forces=forces),
        make_crowded(2)])
    points = recorded.at_steps("/contacts/points", "Points3D:positions")
    arrows = recorded.at_steps("/contacts/forces", "Arrows3D:vectors")
    origins = recorded.at_steps("/contacts/forces", "Arrows3D:origins")
    assert np.array(points[1]) == pytest.approx(places, abs=1e-7)
    assert np.array(origins[1]) == pytest.approx(places, abs=1e-7)
    assert np.array(arrows[1]) == pytest.approx(0.05 * forces, abs=1e-7)
    assert [points[step] for step in (0, 2)] == [arrows[step] for step in (0, 2)] == [[], []]
    curves = recorded.curves("/plots/contacts")
    assert curves[0] == [0.0, 0.0]
    assert curves[1] == pytest.approx([2.0, 2.0])


def test_without_solids_and_contact_nothing_is_logged_for_them(draw, stage, make_frame):
    entities = draw(stage, [make_frame(0)]).entities
    assert not [path for path in entities
                if path.startswith(("/rigid_bodies", "/obstacles", "/contacts"))]
    assert "/plots/contacts" not in entities
