"""Rigid bodies, obstacles, springs and contact in scenes, and errors with key, value and unit."""

import copy
from pathlib import Path

import pytest

from softrobot_twin.errors import SceneError
from softrobot_twin.scene import scene_from_mapping

BALL = {"name": "ball", "sphere": {"radius": 0.01}, "mass": 0.1, "position": [0, 0, 0.1]}
FLOOR = {"name": "floor", "plane": {"normal": [0, 0, 1]}}
GOOD = {
    "name": "drop", "integration": "dynamic", "rigid_bodies": [BALL], "obstacles": [FLOOR],
    "contact": {"between": [{"pair": ["ball", "floor"]}], "friction": 0.5},
}  # fmt: skip


def refused(change) -> SceneError:
    mapping = copy.deepcopy(GOOD)
    change(mapping)
    with pytest.raises(SceneError) as error:
        scene_from_mapping(mapping, Path("drop.yaml"))
    return error.value


def test_a_scene_of_rigid_bodies_alone_is_a_scene():
    scene = scene_from_mapping(copy.deepcopy(GOOD))
    assert scene.rigid_bodies[0].shape.radius == 0.01
    assert scene.deformables == ()


CABLE = {"name": "c", "pull_point": [0, 0, 0], "points": [[0, 0, 1]], "shortening": [0, 0.1],
         "tension": [0, 1]}  # fmt: skip


@pytest.mark.parametrize("change, key, word", [
    (lambda m: m["rigid_bodies"][0].pop("mass"), "rigid_bodies[0]", "mass or a density"),
    (lambda m: m["rigid_bodies"][0].__setitem__("mass", -1.0), "rigid_bodies[0].mass", "0"),
    (lambda m: m["rigid_bodies"][0].__setitem__("box", {"size": [1, 1, 1]}), "rigid_bodies[0]",
     "exactly one of the shapes"),
    (lambda m: m["contact"]["between"][0].__setitem__("pair", ["ball", "wall"]),
     "contact.between[0].pair[1]", "wall"),
    (lambda m: m["contact"].__setitem__("friction", -0.1), "contact.friction", "0"),
    (lambda m: m["contact"].__setitem__("contact_distance", 0.1), "contact", "below alarm"),
    (lambda m: m["obstacles"][0].__setitem__("name", "ball"), "obstacles[0].name",
     "more than once"),
    (lambda m: m["obstacles"][0]["plane"].__setitem__("normal", [0, 0, 0]),
     "obstacles[0].plane.normal", "must not be zero"),
    (lambda m: m.__setitem__("shells", []), "shells", "not available"),
    (lambda m: m["rigid_bodies"][0]["sphere"].__setitem__("radius", -0.01),
     "rigid_bodies[0].sphere.radius", "-0.01 m: "),
    (lambda m: (m.pop("rigid_bodies"), m.pop("contact")), "body", "no body"),
    (lambda m: m.__setitem__("cables", [CABLE]), "cables[0].body", "name the body"),
    (lambda m: m.__setitem__("motors", [{"name": "m", "cables": ["c"]}]), "motors[0].cables[0]",
     "motor m drives c"),
])  # fmt: skip
def test_impossible_values_are_refused_with_their_key(change, key, word):
    error = refused(change)
    assert error.key == key
    assert word in str(error)
