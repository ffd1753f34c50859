"""The scenes that the pages of docs/ show are scenes."""

import copy
import re

import pytest

from softrobot_twin.scene import scene_from_mapping
from softrobot_twin.scene.loading import read_yaml
from test.places import ROOT

PAGES = ROOT / "docs"


def text_of(page):
    """The text of a page of docs/."""
    return (PAGES / f"{page}.md").read_text()


def parts_of(page):
    """The scenes and parts of scenes that a page shows."""
    return [read_yaml(text) for text in re.findall(r"```yaml\n(.*?)```", text_of(page), re.S)]


@pytest.fixture
def shown():
    """Those of all pages; a finger, a robot and one with symmetry first."""
    pages = ("own_robot", "effectors", "surroundings", "materials", "beams")
    return [part for page in pages for part in parts_of(page)]


def test_the_scene_of_a_robot_of_the_pages_is_valid(shown):
    scene = scene_from_mapping(shown[1])
    assert scene.body.element == "quadratic" and len(scene.cables) == 1


def test_the_surroundings_and_actuators_of_the_pages_fit_the_robot(shown):
    """The parts say what they take from the robot: the body's entries, cables."""
    robot = copy.deepcopy(shown[1])
    around = {}
    for part in (*parts_of("surroundings"), *parts_of("actuators")):
        around |= part
    cables = around.pop("cables")
    around["bodies"][0] |= {key: robot["body"][key] for key in ("mesh", "material", "fixed")}
    whole = {key: robot[key] for key in robot if key != "body"} | around
    whole["cables"] += [cables[0], whole["cables"][0] | {"name": "right"}]
    for section in ("cables", "effectors", "markers"):
        whole[section] = [entry | {"body": "finger"} for entry in whole[section]]
    scene = scene_from_mapping(whole)
    assert scene.contact is not None and scene.slides and scene.motors and scene.springs
    assert scene.cavities[0].walls[0].part == "chamber" and scene.cables[1].pulley is not None


@pytest.mark.parametrize("page", ["scene_reference", "own_robot"])
def test_the_first_scene_of_a_page_is_whole(page):
    scene = scene_from_mapping(parts_of(page)[0])
    assert scene.deformables and scene.effectors


def test_the_robot_with_symmetry_of_the_pages_is_valid(shown):
    scene = scene_from_mapping(shown[2])
    assert [cable.body for cable in scene.cables] == ["arm_0", "arm_1", "arm_2"]
    assert [scene.tubes[0].name, scene.tubes[-1].name] == ["tube_0_a", "tube_4_c"]
    assert [marker.id for marker in scene.markers] == [0, 1, 2]


@pytest.mark.parametrize("keys", [["effectors"], ["touches"], ["materials"], ["material"]], ids="".join)
def test_the_parts_of_the_pages_fit_the_robot(shown, keys):
    parts = [part for part in shown if list(part) == keys]
    assert parts
    for part in parts:
        body = {key: entry for key, entry in shown[1]["body"].items() if key != "materials"}
        inside = {"body": body | part} if keys[0].startswith("material") else part
        scene_from_mapping(shown[1] | inside)


def test_the_beams_of_the_pages_are_valid(shown):
    (table,) = [part for part in shown if part.get("name") == "table"]
    scene = scene_from_mapping(table)
    assert [beam.name for beam in scene.beams] == [f"leg_{number}" for number in range(4)]
    assert scene.beams[1].points[0] == pytest.approx((0.0, 0.05, 0.0))
    assert scene.beams[1].thickness_direction == pytest.approx((0.0, 1.0, 0.0))
    given = re.search(r"`constants: (\{.*?\})`", text_of("beams"))[1]
    changed = copy.deepcopy(table)
    changed["beams"][0]["section"] = {"constants": read_yaml(given)}
    assert scene_from_mapping(changed).beams[0].section.constants is not None


def test_the_motor_of_a_hinge_of_the_pages_fits_the_beams(shown):
    text = text_of("beams")
    (table,) = [copy.deepcopy(part) for part in shown if "beams" in part]
    joint = re.search(r"`joined: (\[\{at: start.*?\}\])`", text, re.S)[1]
    motor = re.search(r"`hinge_motors: (\[\{.*?\}\])`", text, re.S)[1]
    table["beams"][0]["joined"] += read_yaml(joint)
    table["beams"][0]["fixed"] = []
    table["hinge_motors"] = read_yaml(motor)
    scene = scene_from_mapping(table)
    assert scene.hinge_motors[0].rate == 1.5 and scene.beams[0].joined[1].by == "hinge"


@pytest.mark.parametrize("page, place", [("index", [0.095, -0.02]), ("own_robot", [0.095, 0.03])])
def test_the_first_lines_of_python_lead_the_finger(page, place, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for folder in ("config", "meshes"):
        (tmp_path / folder).symlink_to(ROOT / folder)
    if page == "own_robot":
        (tmp_path / "finger.yaml").write_text(
            re.search(r"```yaml\n(.*?)```", text_of(page), re.S)[1])  # fmt: skip
    names = {}
    exec(re.search(r"```python\n(.*?)```", text_of(page), re.S)[1], names)
    axes = [0, 1] if page == "own_robot" else [0, 2]
    assert names["result"].tip[axes] == pytest.approx(place, abs=1e-4)
    assert "tip at" in capsys.readouterr().out
    assert (tmp_path / "finger.png").stat().st_size > 10_000
