"""``explain``: the text about a scene."""

from pathlib import Path

import pytest

from softrobot_twin.scene.schema import Effector
from softrobot_twin.simulation import Simulation
from softrobot_twin.simulation.unit_checks import expected_sag
from softrobot_twin.study.explain import describe_effector, sizes, terms

SCENES = Path(__file__).resolve().parents[2] / "config" / "scenes"


def test_explain_lists_effects_terms_stages_and_size(column, command):
    done = command("explain", column)
    assert done.code == 0, done.errors
    simulation = Simulation.from_scene_file(column)
    for term in simulation.terms:
        assert term.name in done.output
    for stage in simulation.stages:
        assert stage in done.output
    for entry in ("gravity", "cables: a", "cables: d", "effectors: tip", "column.vtk"):
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
    without = "octoleg", "fetch_reduced"
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
