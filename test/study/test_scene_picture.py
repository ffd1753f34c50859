"""Snapshots contain solids of all kinds of objects at their positions."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from softrobot_twin.geometry.shapes import Box
from softrobot_twin.simulation import Hold, Simulation
from softrobot_twin.study import scene_picture
from softrobot_twin.study.rasterization import Triangles, camera_at, rasterize
from softrobot_twin.study.scene_picture import (
    FREE_COLOUR,
    GUIDED_COLOUR,
    LEGEND,
    figure_of,
    take_snapshot,
)
from test.scene_changes import repeat_step

SCENES = Path(__file__).resolve().parents[2] / "config" / "scenes"
CUBE = Box(np.zeros(3), np.array([0.03, 0.03, 0.03]), np.eye(3))


def test_a_box_has_twelve_creases_and_no_diagonals():
    points, triangles = CUBE.surface(np.inf)
    edges = scene_picture.creases(points, triangles, 0.6)
    assert len(edges) == 12
    np.testing.assert_allclose(np.linalg.norm(edges[:, 1] - edges[:, 0], axis=1), 0.03)


def test_a_snapshot_shows_every_body_at_its_position(stamp):
    simulation = Simulation.from_scene_file(stamp)
    simulation.model.guides.aim("press", [0.0, 0.0, -0.002])
    result = repeat_step(simulation, Hold(0.01), 4)
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


@pytest.mark.libraries
@pytest.mark.exhaustive
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


WINDOW, PIXELS = (-1.0, 1.0, -1.0, 1.0), (40, 40)
NOTHING = Triangles(np.empty((0, 3, 3)), np.empty((0, 3)), np.empty(0, bool))


def square(size: float, nearness: float, colour) -> Triangles:
    """A square across the view."""
    corners = size * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], float)
    corners = np.column_stack([corners, np.full(4, nearness)])
    return Triangles(corners[[[0, 1, 2], [0, 2, 3]]], np.tile(np.array(colour, float), (2, 1)),
                     np.zeros(2, bool))


def middle_and_corner(**layers: Triangles):
    image = rasterize({"solid": NOTHING, "marks": NOTHING, "clear": NOTHING} | layers, WINDOW,
                      PIXELS)
    return image[21, 20], image[0, 0]


def test_the_nearer_of_two_surfaces_hides_the_other():
    far, near = square(0.5, 0.0, [1, 0, 0]), square(0.5, 1.0, [0, 0, 1])
    for order in ((far, near), (near, far)):
        both = Triangles(*(np.concatenate(parts) for parts in zip(*order)))
        middle, corner = middle_and_corner(solid=both)
        np.testing.assert_allclose(middle, [0, 0, 1, 1], atol=1e-6)
        assert corner[3] == 0.0


def test_a_mark_behind_a_surface_shows_through_it_and_one_in_front_is_whole():
    surface, mark = square(0.5, 0.0, [0, 0, 1]), [1.0, 0.0, 0.0]
    behind, _ = middle_and_corner(solid=surface, marks=square(0.2, -1.0, mark))
    assert 0.3 < behind[0] < 0.7 and 0.3 < behind[2] < 0.7 and behind[3] == 1.0
    front, _ = middle_and_corner(solid=surface, marks=square(0.2, 1.0, mark))
    np.testing.assert_allclose(front, [1, 0, 0, 1], atol=1e-6)
    alone, _ = middle_and_corner(marks=square(0.2, -1.0, mark))
    np.testing.assert_allclose(alone, [1, 0, 0, 1], atol=1e-6)


def test_what_stands_in_front_of_a_clear_surface_keeps_its_colour():
    clear = square(0.5, 0.0, [0, 0, 1])
    inside, _ = middle_and_corner(solid=square(0.2, -1.0, [1, 0, 0]), clear=clear)
    assert inside[0] > 0.6 and 0.1 < inside[2] < 0.4
    front, _ = middle_and_corner(solid=square(0.2, 1.0, [1, 0, 0]), clear=clear)
    np.testing.assert_allclose(front, [1, 0, 0, 1], atol=1e-6)


def test_a_camera_looks_along_orthogonal_unit_vectors_with_z_upwards():
    rng_seed = np.random.SeedSequence().entropy
    print("seed", rng_seed)
    angles = np.random.default_rng(rng_seed).uniform([-80, -180], [80, 180], (20, 2))
    for elevation, azimuth in angles:
        camera = camera_at(elevation, azimuth)
        np.testing.assert_allclose(np.array(camera) @ np.array(camera).T, np.eye(3), atol=1e-12)
        np.testing.assert_allclose(np.cross(camera.right, camera.up), camera.eye, atol=1e-12)
        assert camera.up[2] > 0.0 and camera.right[2] == 0.0


KINDS = {
    "diamond": {"fixed", "cable", "pull point", "marker", "effector"},
    "stifface": {"fixed", "cable", "pull point", "hold", "touch", "marker", "effector"},
    "springy": {"fixed", "cavity", "marker", "effector"},
    "strider": {"axis", "frame", "marker", "effector"},
    "trunk": {"cable", "pull point", "thread", "frame", "marker", "effector"},
    "cantilever": {"fixed", "cable", "pull point"},
}


@pytest.fixture(scope="module")
def shots():
    return {name: take_snapshot(Simulation.from_scene_file(SCENES / f"{name}.yaml"), None, name)
            for name in KINDS}


@pytest.fixture(scope="module")
def drawn(shots):
    """Gives the labelled picture of a scene, drawn once for each view."""
    pyplot = pytest.importorskip("matplotlib.pyplot")
    yield cache(lambda name, view=None: figure_of([shots[name]], name, view, labelled=True))
    pyplot.close("all")


# Together they have all kinds.
@pytest.mark.libraries
@pytest.mark.exhaustive
@pytest.mark.parametrize("name", ["stifface", "springy", "strider", "trunk"])
def test_the_legend_names_all_that_a_scene_has_and_nothing_else(name, drawn):
    (legend,) = drawn(name).legends
    texts = [text.get_text() for text in legend.get_texts()]
    assert texts == [text for kind, (_, _, text) in LEGEND.items() if kind in KINDS[name]]


@pytest.mark.exhaustive
@pytest.mark.parametrize(("name", "view"), [
    ("stifface", None), ("stifface", (90.0, 0.0)), ("strider", (0.0, -90.0))])
def test_no_text_of_a_labelled_picture_is_clipped_or_overlaps_another(name, view, drawn, check_texts):
    check_texts(drawn(name) if view is None else drawn(name, view))


@pytest.mark.parametrize("names", [("cantilever",) * 2, ("trunk",) * 3])
def test_no_text_beside_several_states_is_clipped_or_overlaps_another(names, shots, check_texts):
    pyplot = pytest.importorskip("matplotlib.pyplot")
    pushed = [shots[name]._replace(
        title=f"{index} s", solids=[solid._replace(value=1e3 * index) if solid.kind == "cable"
                                    else solid for solid in shots[name].solids])
        for index, name in enumerate(names)]
    figure = figure_of(pushed, "")
    check_texts(figure)
    pyplot.close(figure)


def test_labels_name_every_thing_once_and_alike_ones_together(shots):
    told = [label.text for label in shots["diamond"].labels]
    assert {"body", "cable north", "cable east", "cable south", "cable west", "effector tip",
            "markers 0 … 7 (8)"} <= set(told)
    assert len(told) == len(set(told))
    assert "cables L0 … L3 (4)" in [label.text for label in shots["trunk"].labels]


def test_labels_are_a_step_apart_and_move_as_little_as_possible():
    assert scene_picture.spread([0.0, 1.0, 2.0], 0.2) == [0.0, 1.0, 2.0]
    np.testing.assert_allclose(scene_picture.spread([0.0, 0.0, 2.0], 0.2), [-0.1, 0.1, 2.0])
    crowded = scene_picture.spread([0.0, 0.0, 0.05, 0.3, 0.3], 0.2)
    np.testing.assert_array_less(0.2 - 1e-12, np.diff(crowded))


@pytest.mark.libraries
def test_springs_are_drawn_between_their_ends(tmp_path):
    from softrobot_twin.scene import scene_from_mapping
    simulation = Simulation(scene_from_mapping({
        "name": "hung", "integration": "dynamic",
        "mass_springs": [{"name": "ball", "points": [[0.0, 0.0, 0.1]], "masses": [0.1]}],
        "springs": [{"name": "hanger", "stiffness": 100.0, "ends": [
            {"point": [0.0, 0.0, 0.3]}, {"on": "ball", "point": [0.0, 0.0, 0.1]}]}]}))
    (spring,) = take_snapshot(simulation, None, "").of_kind("spring")
    assert np.ptp(spring.triangles[..., 2]) == pytest.approx(0.2)
    assert spring.triangles[..., 2].max() == pytest.approx(0.3)


def test_a_small_mark_keeps_its_colour_and_white_stays_white(tmp_path):
    image = pytest.importorskip("matplotlib.image")
    pyplot = pytest.importorskip("matplotlib.pyplot")
    from softrobot_twin.study.figure import save_figure
    figure = pyplot.figure(figsize=(4.0, 4.0))
    axes = figure.add_axes((0, 0, 1, 1))
    axes.imshow(np.random.default_rng(0).uniform(0.2, 0.8, (60, 60)), cmap="Blues")
    axes.set_position((0.1, 0.1, 0.8, 0.8))
    axes.set_facecolor("#fdfdfd")
    axes.set(xlim=(-20, 80), ylim=(-20, 80))
    figure.text(0.5, 0.03, "a text with pale edges", fontsize=7, color="#777777")
    axes.plot([30], [30], marker="o", markersize=4, color="#208040")
    save_figure(figure, tmp_path / "few.png", 100)
    pyplot.close(figure)
    picture = image.imread(tmp_path / "few.png")[..., :3]
    assert (picture[:8] == 1.0).all()
    colours = picture.reshape(-1, 3)
    assert (colours == 1.0).all(axis=1).mean() > 0.2
    assert (np.abs(colours - np.array([0x20, 0x80, 0x40]) / 255.0).max(axis=1) < 0.08).any()


def test_a_tube_is_round_and_has_no_part_where_two_points_are_the_same():
    path = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, 1.0], [0.0, 2.0, 1.0]])
    corners = scene_picture.tubes([path], 0.1)
    assert len(corners) == 2 * len(scene_picture.tubes([path[:2]], 0.1))
    upright = corners[np.ptp(corners[:, :, 2], axis=1) > 0.9].reshape(-1, 3)
    np.testing.assert_allclose(np.linalg.norm(upright[:, :2], axis=1), 0.1)
    assert scene_picture.tubes([], 0.1).shape == (0, 3, 3)


def test_an_arrow_ends_in_a_tip_that_is_wider_than_its_shaft():
    corners = scene_picture.arrow(np.zeros(3), np.array([0.0, 0.0, 1.0]), 0.02).reshape(-1, 3)
    widths = np.linalg.norm(corners[:, :2], axis=1)
    assert widths[corners[:, 2] == 0.0] == pytest.approx(0.02)
    assert widths[corners[:, 2] == 1.0].max() == 0.0
    assert widths.max() == pytest.approx(0.06)
