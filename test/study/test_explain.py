"""``explain``: the text about a scene."""

from pathlib import Path

import pytest

from softrobot_twin.scene import load_scene, scene_from_mapping
from softrobot_twin.scene.schema import Effector, ObservedForce, Observer
from softrobot_twin.simulation import Simulation
from softrobot_twin.study.explain import (
    Effect,
    effects,
    grouped,
    rest_paths,
    sizes,
    terms,
    thin_warnings,
)

SCENES = Path(__file__).resolve().parents[2] / "config" / "scenes"


@pytest.mark.exhaustive
@pytest.mark.parametrize("scene", sorted(SCENES.glob("*.yaml")), ids=lambda path: path.stem)
def test_every_scene_of_the_package_is_explained(scene, call):
    done = call("explain", scene, "--no-mesh-error")
    assert done.code == 0, done.errors
    assert "Estimated error of the effectors" not in done.output
    without = "octoleg", "octoleg_device", "fetch_reduced"
    told = "elastic energy as mounted" if scene.stem.startswith("emio") else "sag by gravity"
    assert told in done.output or scene.stem in without


@pytest.mark.parametrize(("observer", "words"), [
    (None, ""), (Observer(), "force at known points; each component within 0.0"),
    (Observer(forces=(ObservedForce(name="tip"),)), "force, and its place on the surface; each"),
])  # fmt: skip
def test_explain_tells_how_surely_markers_tell_a_force(observer, words):
    scene = load_scene(SCENES / "diamond.yaml").changed(observer=observer)
    told = [one.content for one in effects(Simulation(scene)) if one.entry == "observer: tip"]
    assert len(told) == bool(words)
    assert all(one.startswith(words) for one in told)


@pytest.mark.parametrize("entry, words", [
    ({"orientation": {}}, ("orientation", "the robot's size per radian")),
    ({"orientation": {"pointing": [0, 0, 1], "length_per_radian": 0.05}, "directions": []},
     ("axis [0, 0, 1] pointing", "50 mm per radian")),
])  # fmt: skip
def test_explain_tells_what_an_orientation_asks_for(entry, words):
    told = Effector(name="tip", points=[[0, 0, 0]], **entry).describe()
    for word in words:
        assert word in told
    assert ("directions" in told) == ("directions" not in entry)


def numbered(count: int, entry: str, content: str, result: str) -> list[tuple[str, str, str]]:
    """Entries in which ``#`` is the number of each."""
    return [tuple(text.replace("#", str(number)) for text in (entry, content, result))
            for number in range(count)]


SPRINGS = numbered(12, "springs: s_#", "arm_2 to world, 10# N/m, 5 N s/m", "t")
TUBES = numbered(40, "tubes: t_#", "2 points, EA 250 N", "term springs")
DIFFERENT = [("tubes: a", "2 points, EA 250 N", "term springs"),
             ("tubes: b", "2 points, EA 251 N", "term springs"),
             ("tubes: c", "2 points, EA 250 N", "no term"),
             ("fibres: d", "2 points, EA 250 N", "term springs")]  # fmt: skip
BETWEEN = [("cables: a", "x", "r"), ("cables: b", "y", "r"), ("cables: c", "x", "r")]
PAIRS = numbered(6, "contact.between: finger_#, cube", "friction 0.7", "found")


@pytest.mark.parametrize(("listed", "expected"), [
    (SPRINGS, [("springs: s_0 to s_11 (12)", "arm_2 to world, 100 to 1011 N/m, 5 N s/m", "t")]),
    (SPRINGS[:4], SPRINGS[:4]),
    (numbered(2, "bodies[#].mesh", "finger.vtk, rotation [0, 0, #] rad, translation [#, 0, 0] m, "
              "linear elements", "158 nodes"),
     [("bodies.mesh (2)", "finger.vtk, linear elements, at 2 places", "158 nodes")]),
    (TUBES, [("tubes: t_0 to t_39 (40)", *TUBES[0][1:])]),
    (TUBES[:3], [("tubes: t_0, t_1, t_2 (3)", *TUBES[0][1:])]),
    (TUBES[5:6], TUBES[5:6]),
    (DIFFERENT, DIFFERENT),
    (BETWEEN, [("cables: a, c (2)", "x", "r"), BETWEEN[1]]),
    (PAIRS[:2], [("contact.between: finger_0, cube; finger_1, cube (2)", *PAIRS[0][1:])]),
    (PAIRS, [("contact.between: finger_0, cube; ...; finger_5, cube (6)", *PAIRS[0][1:])]),
    (numbered(12, "bodies[#].material", "E 1 Pa", "t"), [("bodies.material (12)", "E 1 Pa", "t")]),
    (numbered(12, "beams[#].material", "E 1 Pa", "t"), [("beams.material (12)", "E 1 Pa", "t")]),
    ([("beams[3].material", "E 1 Pa", "t")], [("beams[3].material", "E 1 Pa", "t")]),
    (numbered(3, "cavities: #", "wall part air_#, 2 cm³", "t"),
     [("cavities: 0, 1, 2 (3)", "wall parts air_0, air_1, air_2, 2 cm³", "t")]),
    (numbered(2, "cavities: #", "wall part air", "t"),
     [("cavities: 0, 1 (2)", "wall part air", "t")]),
])  # fmt: skip
def test_entries_that_differ_in_number_name_or_place_only_are_one_row_where_the_first_stood(
    listed, expected
):
    assert [tuple(row) for row in grouped([Effect(*entry) for entry in listed])] == expected


def test_legs_that_are_repeated_about_an_axis_fill_one_row_of_each_kind():
    legs = {
        "name": "leg_#", "repeat": {"count": 5, "about": "z"}, "elements": 2, "fixed": "start",
        "points": [[0.1, 0, 0], [0.1, 0, 0.2]], "section": {"circle": {"radius": 0.002}},
        "material": {"young_modulus": 35e6, "poisson_ratio": 0.45, "density": 1220},
    }  # fmt: skip
    simulation = Simulation(scene_from_mapping({"name": "table", "beams": [legs]}))
    listed = [row.entry for row in grouped(effects(simulation)) if "beams" in row.entry]
    assert listed == ["beams: leg_0 to leg_4 (5)", "beams.material (5)", "beams.fixed (5)"]
    told = dict(sizes(simulation))
    assert told["beams"] == "leg_0 to leg_4" and "nodes" not in told
    assert told["length, mass of each of leg_0 to leg_4"].startswith("200 mm, ")


@pytest.fixture(scope="module")
def grasper():
    return Simulation.from_scene_file(SCENES / "grasper.yaml")


def test_mass_of_all_is_that_of_bodies_and_free_rigid_bodies_once(grasper):
    told = dict(sizes(grasper))
    fingers = 3.0 * grasper.model.bodies[0].mass
    assert float(told["mass of all"].removesuffix(" kg")) == pytest.approx(fingers + 0.03, rel=1e-5)
    assert told["mass of cube"] == "0.03 kg"


def test_nodes_and_beams_that_a_rigid_body_bears_are_not_counted_twice():
    flexo = Simulation.from_scene_file(SCENES / "flexo.yaml")
    told, model = dict(sizes(flexo)), flexo.model
    own = sum(part.mass for part in (*model.bodies, *model.beams)) + 18 * 0.003
    assert float(told["mass of all"].removesuffix(" kg")) == pytest.approx(own, rel=1e-5)
    assert told["mass of each of hub_1 to hub_17, palm"] == "0.003 kg"
    paths = dict(rest_paths(flexo))
    assert len(paths) == 4
    assert paths["lower_0, lower_1, lower_2 (3)"].startswith("275 mm, lower_0 from [68, 0, 0] ")


def test_one_element_across_the_thinnest_part_is_warned_of(grasper):
    told = dict(sizes(grasper))
    fingers = "finger_0, finger_1, finger_2"
    assert told[f"thinnest part of each of {fingers}"] == "5 mm, 1 linear element across"
    (warning,) = thin_warnings(grasper)
    assert fingers in warning and "quadratic" in warning


def test_terms_that_are_alike_are_one_row(grasper):
    told = dict(terms(grasper))
    assert told["corotational elements (3)"] == "force, 280 stencils of 4 nodes, by Elements"
    assert told["cables"] == "constraint, 3 rows, by Cables"


def test_a_picture_of_the_scene_at_rest_is_drawn_with_names(column, tmp_path, call):
    image = pytest.importorskip("matplotlib.image")
    done = call("explain", column, "--no-mesh-error", "--picture", tmp_path / "column.png",
                "--picture-view", 10, -40)
    assert done.code == 0, done.errors
    assert f"picture: {tmp_path / 'column.png'}" in done.output
    assert image.imread(tmp_path / "column.png").shape[0] > 400
