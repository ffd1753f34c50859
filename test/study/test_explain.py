"""``explain``: the text about a scene."""

from pathlib import Path

import pytest

from softrobot_twin.scene import scene_from_mapping
from softrobot_twin.scene.schema import Effector
from softrobot_twin.simulation import Simulation
from softrobot_twin.simulation.unit_checks import expected_sag
from softrobot_twin.study.explain import (
    Effect,
    describe_effector,
    effects,
    grouped,
    sizes,
    terms,
)

SCENES = Path(__file__).resolve().parents[2] / "config" / "scenes"


def test_explain_lists_effects_terms_stages_and_size(column, command):
    done = command("explain", column)
    assert done.code == 0, done.errors
    simulation = Simulation.from_scene_file(column)
    for term in simulation.terms:
        assert term.name in done.output
    for stage in simulation.stages:
        assert stage in done.output
    for entry in ("gravity", "cables: a, b, c, d (4)", "effectors: tip", "column.vtk"):
        assert entry in done.output
    assert str(simulation.node_count) in done.output and str(simulation.dof_count) in done.output


def test_explain_is_plain_text_when_piped(column, call):
    output = call("explain", column).output
    assert "\x1b" not in output
    assert not set("│╭╰┌└┃━") & set(output)


def test_an_effect_that_a_scene_omits_makes_no_term(column, tmp_path, call):
    text = column.read_text().replace("[0.0, 0.0, -9.81]", "[0.0, 0.0, 0.0]")
    bare = tmp_path / "bare.yaml"
    bare.write_text(text.partition("cables:")[0].replace("column.vtk",
                                                         str(column.parent / "column.vtk")))
    output = call("explain", bare).output
    for absent in ("gravity", "cables", "term effectors", "optimise"):
        assert absent not in output
    assert len(terms(Simulation.from_scene_file(bare))) == 1


def test_a_scene_with_an_unknown_effect_is_refused_by_name(column, tmp_path, call):
    scene = tmp_path / "haunted.yaml"
    scene.write_text(column.read_text() + "ghosts: [1]\n")
    done = call("explain", scene)
    assert done.code == 2
    assert len(done.errors.splitlines()) == 1
    assert "haunted.yaml" in done.errors and "ghosts" in done.errors


def test_volume_mass_and_sag_are_printed(column, call):
    simulation = Simulation.from_scene_file(column)
    body = simulation.model.bodies[0]
    told = {line[0]: line[1] for line in sizes(simulation)}
    volume, mass = told["volume, mass of body"].split(", ")
    assert float(volume.removesuffix(" m³")) == pytest.approx(body.mesh.volume, rel=1e-5)
    assert float(mass.removesuffix(" kg")) == pytest.approx(body.mass, rel=1e-5)
    sag = float(told["sag by gravity alone, without actuators"].removesuffix(" mm"))
    assert sag == pytest.approx(1e3 * expected_sag(simulation.model), rel=1e-2)
    assert "volume, mass of body" in call("explain", column).output


@pytest.mark.parametrize("scene", sorted(SCENES.glob("*.yaml")), ids=lambda path: path.stem)
def test_every_scene_of_the_package_is_explained(scene, call):
    done = call("explain", scene, "--no-mesh-error")
    assert done.code == 0, done.errors
    assert "Estimated error of the effectors" not in done.output
    without = "octoleg", "octoleg_device", "fetch_reduced"
    assert "sag by gravity" in done.output or scene.stem in without


def test_explain_prints_the_discretization_error_of_each_load(column, call):
    done = call("explain", column)
    assert "Estimated error of the effectors' motion due to the mesh" in done.output
    table = done.output.partition("Estimated error of the effectors")[2]
    rows = [line.split()[0] for line in table.splitlines() if " % " in f"{line} "]
    assert rows == ["gravity", "a", "b", "c", "d"], table
    warned = [line for line in done.errors.splitlines() if "has an error of about" in line]
    assert len(warned) == 1 and "quadratic elements: " in warned[0] and "ms a step" in warned[0]


def test_without_effectors_explain_gives_the_reason_for_no_estimate(column, tmp_path, call):
    bare = tmp_path / "bare.yaml"
    text = column.read_text().replace("column.vtk", str(column.parent / "column.vtk"))
    bare.write_text(text.partition("effectors:")[0])
    assert "the error of the mesh is not estimated: the scene names no effector" in call(
        "explain", bare).output


def test_a_too_small_energy_weight_is_reported_with_the_used_one(
    column, tmp_path, call
):
    told = {}
    for weight in (1e-12, 1e-6):
        scene = tmp_path / f"light_{weight}.yaml"
        text = "".join(
            line for line in column.read_text().splitlines(keepends=True)
            if not line.startswith("solver:")
        ).replace("column.vtk", str(column.parent / "column.vtk"))
        scene.write_text(f"{text}\nsolver: {{energy_weight: {weight:.1e}}}\n")
        told[weight] = " ".join(call("explain", scene).output.split())
    assert "1.49012e-08 in the inverse problem, the least" in told[1e-12]
    assert "1e-06 in the inverse" in told[1e-6] and "the least" not in told[1e-6]


@pytest.mark.parametrize(
    ("entry", "words"),
    [
        ({"orientation": {}}, ("orientation", "the robot's size per radian")),
        ({"orientation": {"pointing": [0, 0, 1], "length_per_radian": 0.05}, "directions": []},
         ("axis [0, 0, 1] pointing", "50 mm per radian")),
    ],
)
def test_explain_tells_what_an_orientation_asks_for(entry, words):
    told = describe_effector(Effector(name="tip", points=[[0, 0, 0]], **entry))
    for word in words:
        assert word in told
    assert ("directions" in told) == ("directions" not in entry)


def rows(*listed: tuple[str, str, str]) -> list[tuple[str, str, str]]:
    return [tuple(row) for row in grouped([Effect(*entry) for entry in listed])]


def test_entries_that_differ_in_name_only_are_one_row():
    tubes = [(f"tubes: t_{number}", "2 points, EA 250 N", "term springs") for number in range(40)]
    assert rows(*tubes) == [("tubes: t_0 to t_39 (40)", "2 points, EA 250 N", "term springs")]
    assert rows(*tubes[:3])[0][0] == "tubes: t_0, t_1, t_2 (3)"
    assert rows(tubes[5]) == [tubes[5]]


def test_entries_that_differ_in_anything_else_keep_their_rows():
    thin = ("tubes: a", "2 points, EA 250 N", "term springs")
    others = [("tubes: b", "2 points, EA 251 N", "term springs"),
              ("tubes: c", "2 points, EA 250 N", "no term"),
              ("fibres: d", "2 points, EA 250 N", "term springs")]  # fmt: skip
    assert rows(thin, *others) == [thin, *others]


def test_a_row_stands_where_the_first_of_its_entries_does():
    listed = [("cables: a", "x", "r"), ("cables: b", "y", "r"), ("cables: c", "x", "r")]
    assert rows(*listed) == [("cables: a, c (2)", "x", "r"), listed[1]]


def test_pairs_in_one_row_are_kept_apart():
    pairs = [(f"contact.between: finger_{number}, cube", "friction 0.7", "found")
             for number in range(6)]  # fmt: skip
    assert rows(*pairs[:2])[0][0] == "contact.between: finger_0, cube; finger_1, cube (2)"
    assert rows(*pairs)[0][0] == "contact.between: finger_0, cube; ...; finger_5, cube (6)"


@pytest.mark.parametrize("section", ["bodies", "beams"])
def test_keys_of_alike_bodies_are_one_row(section):
    listed = [(f"{section}[{number}].material", "E 1 Pa", "term") for number in range(12)]
    assert rows(*listed) == [(f"{section}.material (12)", "E 1 Pa", "term")]
    assert rows(listed[3]) == [listed[3]]


def test_cavities_that_differ_in_their_part_only_are_one_row_that_lists_the_parts():
    listed = [(f"cavities: {number}", f"wall part air_{number}, 2 cm³", "term cavities")
              for number in range(3)]
    assert rows(*listed) == [
        ("cavities: 0, 1, 2 (3)", "wall parts air_0, air_1, air_2, 2 cm³", "term cavities")]
    assert rows(*[(f"cavities: {number}", "wall part air", "t") for number in range(2)]) == [
        ("cavities: 0, 1 (2)", "wall part air", "t")]


def test_legs_that_are_repeated_about_an_axis_fill_one_row_of_each_kind():
    legs = {
        "name": "leg_#", "repeat": {"count": 5, "about": "z"}, "elements": 2, "fixed": "start",
        "points": [[0.1, 0, 0], [0.1, 0, 0.2]], "section": {"circle": {"radius": 0.002}},
        "material": {"young_modulus": 35e6, "poisson_ratio": 0.45, "density": 1220},
    }  # fmt: skip
    simulation = Simulation.from_scene(scene_from_mapping({"name": "table", "beams": [legs]}))
    listed = [row.entry for row in grouped(effects(simulation)) if "beams" in row.entry]
    assert listed == ["beams: leg_0 to leg_4 (5)", "beams.material (5)", "beams.fixed (5)"]
    told = dict(sizes(simulation))
    assert told["beams"] == "leg_0 to leg_4" and "nodes" not in told
    assert told["length, mass of each of leg_0 to leg_4"].startswith("200 mm, ")
