"""Snapshots contain solids of all kinds of objects at their positions."""

import numpy as np
import pytest

from softrobot_twin.geometry.shapes import Box
from softrobot_twin.simulation import Hold, Simulation
from softrobot_twin.study import scene_picture
from softrobot_twin.study.scene_picture import FREE_COLOUR, GUIDED_COLOUR, take_snapshot

CUBE = Box(np.zeros(3), np.array([0.03, 0.03, 0.03]), np.eye(3))


def areas(triangles):
    return 0.5 * np.linalg.norm(np.cross(triangles[:, 1] - triangles[:, 0],
                                         triangles[:, 2] - triangles[:, 0]), axis=1)


def test_cut_triangles_are_small_and_cover_the_same_area():
    points, triangles = CUBE.surface(np.inf)
    pieces = scene_picture.subdivide(points[triangles], 0.004)
    assert areas(pieces).sum() == pytest.approx(6 * 0.03**2)
    edges = np.linalg.norm(pieces - np.roll(pieces, -1, axis=1), axis=2)
    assert edges.max() <= 0.004


def test_a_box_has_twelve_creases_and_no_diagonals():
    points, triangles = CUBE.surface(np.inf)
    edges = scene_picture.creases(points, triangles, 0.6)
    assert len(edges) == 12
    np.testing.assert_allclose(np.linalg.norm(edges[:, 1] - edges[:, 0], axis=1), 0.03)


def test_a_snapshot_shows_every_body_at_its_position(stamp):
    simulation = Simulation.from_scene_file(stamp)
    simulation.model.guides.aim("press", [0.0, 0.0, -0.002])
    for _ in range(4):
        result = simulation.step(Hold(0.01))
    shot = take_snapshot(simulation, result.contacts, "pressed")

    def height(colour):
        return [np.ptp(solid.triangles.reshape(-1, 3)[:, 2]) for solid in shot.solids
                if solid.look == "rigid" and np.array_equal(solid.colour, colour)]

    assert height(FREE_COLOUR) == pytest.approx([0.03], abs=1e-6)
    assert height(GUIDED_COLOUR) == pytest.approx([0.01])
    (mesh,) = [solid for solid in shot.solids if solid.look == "mesh"]
    assert mesh.triangles[..., 2].max() == pytest.approx(0.051 - 0.002, abs=1e-9)
    ((point, normal),) = shot.planes
    assert point @ normal == 0.0 and normal[2] == 1.0
    assert len(shot.forces[0]) == result.report.contact_count > 0


def test_states_side_by_side_make_a_wider_picture(tmp_path, stamp, call):
    image = pytest.importorskip("matplotlib.image")
    widths = []
    for name, times in (("one.png", (0.1,)), ("three.png", (0.1, 0.5, 0.7))):
        done = call("simulate", stamp, "--commands", stamp.parent / "stamping.csv", "--rate", 50,
                    "--output", tmp_path / "run.csv", "--picture", tmp_path / name,
                    "--picture-at", *times, "--picture-view", 10, -40)
        assert done.code == 0, done.errors
        widths.append(image.imread(tmp_path / name).shape[1])
    assert widths[1] > 1.5 * widths[0]
