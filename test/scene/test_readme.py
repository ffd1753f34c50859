"""The scenes that the README shows are scenes."""

import copy
import re
from pathlib import Path

import pytest

from softrobot_twin.scene import scene_from_mapping
from softrobot_twin.scene.loading import read_yaml

README = Path(__file__).resolve().parents[2] / "README.md"


@pytest.fixture
def shown():
    """The scenes and parts of scenes, as they stand there, by what only they have."""
    texts = re.findall(r"```yaml\n(.*?)```", README.read_text(), re.S)
    parts = {"robot": "body", "surroundings": "bodies", "orientation": "effectors"}
    found = {}
    for part in map(read_yaml, texts):
        found[next(name for name, key in parts.items() if key in part)] = part
    return found


def test_the_scene_of_a_robot_in_the_readme_is_valid(shown):
    scene = scene_from_mapping(shown["robot"])
    assert scene.body.element == "quadratic" and len(scene.cables) == 1


def test_the_surroundings_in_the_readme_fit_the_robot(shown):
    """The second one says what it takes from the first: the body's entries, and the cables."""
    robot, around = copy.deepcopy((shown["robot"], shown["surroundings"]))
    around["bodies"][0] |= {key: robot["body"][key] for key in ("mesh", "material", "fixed")}
    whole = {key: robot[key] for key in robot if key != "body"} | around
    whole["cables"].append(whole["cables"][0] | {"name": "right"})
    for section in ("cables", "effectors", "markers"):
        whole[section] = [entry | {"body": "finger"} for entry in whole[section]]
    scene = scene_from_mapping(whole)
    assert scene.contact is not None and scene.slides and scene.motors


def test_the_orientation_in_the_readme_fits_the_robot(shown):
    scene = scene_from_mapping({**shown["robot"], **shown["orientation"]})
    orientation = scene.effectors[0].orientation
    assert orientation.pointing == (0.0, 0.0, 1.0) and len(orientation.points) == 4
