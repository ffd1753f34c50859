"""The scenes that the README shows are scenes."""

import copy
import re
from pathlib import Path

import pytest

from softrobot_twin.scene import scene_from_mapping
from softrobot_twin.scene.loading import read_yaml
from softrobot_twin.scene.material_presets import MATERIAL_PRESETS, UNFITTED

README = Path(__file__).resolve().parents[2] / "README.md"


@pytest.fixture
def shown():
    """The scenes, as they stand there."""
    return [read_yaml(text) for text in re.findall(r"```yaml\n(.*?)```", README.read_text(), re.S)]


def test_the_scene_of_a_robot_in_the_readme_is_valid(shown):
    scene = scene_from_mapping(shown[0])
    assert scene.body.element == "quadratic" and len(scene.cables) == 1


def test_the_surroundings_in_the_readme_fit_the_robot(shown):
    """The block with springs says what it takes from the first: the body's entries, cables."""
    robot = copy.deepcopy(shown[0])
    (around,) = copy.deepcopy([part for part in shown if "springs" in part])
    around["bodies"][0] |= {key: robot["body"][key] for key in ("mesh", "material", "fixed")}
    whole = {key: robot[key] for key in robot if key != "body"} | around
    whole["cables"].append(whole["cables"][0] | {"name": "right"})
    for section in ("cables", "effectors", "markers"):
        whole[section] = [entry | {"body": "finger"} for entry in whole[section]]
    scene = scene_from_mapping(whole)
    assert scene.contact is not None and scene.slides and scene.motors


def test_the_robot_with_symmetry_in_the_readme_is_valid(shown):
    scene = scene_from_mapping(shown[1])
    assert [cable.body for cable in scene.cables] == ["arm_0", "arm_1", "arm_2"]
    assert [scene.tubes[0].name, scene.tubes[-1].name] == ["tube_0_a", "tube_4_c"]
    assert [marker.id for marker in scene.markers] == [0, 1, 2]


def test_the_laws_in_the_readme_fit_the_robot_and_all_laws_of_the_package_are_in_its_table(shown):
    (part,) = (part for part in shown if list(part) == ["materials"])
    body = {**shown[0]["body"], **part}
    laws = [entry.law for entry in scene_from_mapping({**shown[0], "body": body}).body.materials]
    assert laws == ["mooney_rivlin", "yeoh", "ogden"]
    table = README.read_text().split("### Laws of materials")[1].split("```")[0]
    files = (README.parent / "softrobot_twin" / "mechanics" / "laws").glob("[a-z]*.py")
    for name in {file.stem for file in files}:
        assert f"| `{'linear' if name == 'small_displacement' else name}`" in table


def test_the_orientation_in_the_readme_fits_the_robot(shown):
    parts = (part for part in shown if list(part) == ["effectors"])
    (part,) = (part for part in parts if "orientation" in part["effectors"][0])
    orientation = scene_from_mapping({**shown[0], **part}).effectors[0].orientation
    assert orientation.pointing == (0.0, 0.0, 1.0) and len(orientation.points) == 4


def test_the_beams_in_the_readme_are_valid(shown):
    (table,) = [part for part in shown if part.get("name") == "table"]
    scene = scene_from_mapping(table)
    assert [beam.name for beam in scene.beams] == [f"leg_{number}" for number in range(4)]
    assert scene.beams[1].points[0] == pytest.approx((0.0, 0.05, 0.0))
    assert scene.beams[1].thickness_direction == pytest.approx((0.0, 1.0, 0.0))
    given = re.search(r"`constants: (\{.*?\})`", README.read_text())[1]
    changed = copy.deepcopy(table)
    changed["beams"][0]["section"] = {"constants": read_yaml(given)}
    assert scene_from_mapping(changed).beams[0].section.constants is not None


def test_the_motor_of_a_hinge_in_the_readme_fits_the_beams(shown):
    text = README.read_text()
    (table,) = [copy.deepcopy(part) for part in shown if "beams" in part]
    joint = re.search(r"`joined: (\[\{at: start.*?\}\])`", text, re.S)[1]
    motor = re.search(r"`hinge_motors: (\[\{.*?\}\])`", text, re.S)[1]
    table["beams"][0]["joined"] += read_yaml(joint)
    table["beams"][0]["fixed"] = []
    table["hinge_motors"] = read_yaml(motor)
    scene = scene_from_mapping(table)
    assert scene.hinge_motors[0].rate == 1.5 and scene.beams[0].joined[1].by == "hinge"


def test_the_touch_in_the_readme_fits_the_robot(shown):
    (part,) = (part for part in shown if list(part) == ["touches"])
    touch = scene_from_mapping({**shown[0], **part}).touches[0]
    assert len(touch.points) == 2 and touch.while_touched == "hold_actuators"


def test_the_rubber_in_the_readme_is_valid_and_its_table_is_that_of_the_presets(shown):
    (part,) = [part for part in shown if list(part) == ["material"]]
    robot = copy.deepcopy(shown[0])
    robot["body"]["material"] = part["material"]
    robot["body"].pop("materials", None)
    material = scene_from_mapping(robot).body.material
    assert len(material.viscosity) == 2 and material.softening.m == 5.0e3
    text = README.read_text()
    rows = dict(re.findall(r"^\| `(\w+)` \| (.*\d+) \|$", text, re.M))
    for name, preset in MATERIAL_PRESETS.items():
        law, constants, error, strain, density = rows[name].split(" | ")
        low, high = (100.0 * bound for bound in preset.strain_range)
        assert law == preset.law and float(density) == preset.density
        assert error == f"{100 * preset.rms_error:.1f} % ({100 * preset.largest_error:.1f} %)"
        assert strain == f"−{-low:.0f} to {high:.0f} %"
        pairs = re.findall(r"(c\d+) ([\d.]+)", constants)
        given = {key: 1e3 * float(value) for key, value in pairs}
        assert given == pytest.approx(preset.constants)
    assert all(f"`{name}`" in text for name in UNFITTED)
