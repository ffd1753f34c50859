"""Short forms of scenes: what is accepted, and how the others are explained."""

from __future__ import annotations

import copy
import math
from pathlib import Path

import pytest
import yaml

from softrobot_twin.errors import SceneError
from softrobot_twin.scene import scene_from_mapping
from softrobot_twin.scene.loading import read_yaml, written_out

pytestmark = pytest.mark.libraries

CONFIG = Path(__file__).resolve().parents[2] / "config" / "scenes"
DIAMOND = written_out(read_yaml((CONFIG / "diamond.yaml").read_text()))
GRASPER = written_out(read_yaml((CONFIG / "grasper.yaml").read_text()))


def changed(original: dict, keys: str, value) -> dict:
    """A scene with another value at dotted keys; numbers are places in lists."""
    mapping = copy.deepcopy(original)
    *above, last = [int(key) if key.isdigit() else key for key in keys.split(".")]
    holder = mapping
    for key in above:
        holder = holder[key]
    holder[last] = value
    return mapping


@pytest.mark.parametrize("original, keys, short, long", [
    (DIAMOND, "body.mesh", "a.vtk", {"file": "a.vtk"}),
    (DIAMOND, "body.visual", "skin.stl", {"file": "skin.stl"}),
    (GRASPER, "obstacles.0", {"name": "floor", "surface": "rock.stl"},
     {"name": "floor", "surface": {"file": "rock.stl"}}),
    (DIAMOND, "effectors.0.directions", "xz", ["x", "z"]),
    (DIAMOND, "effectors.0.directions", "x, z", ["x", "z"]),
    (DIAMOND, "effectors.0.directions", "z", ["z"]),
    (DIAMOND, "effectors.0.points", [0.0, 0.0, 0.125], [[0.0, 0.0, 0.125]]),
    (DIAMOND, "effectors.0.measured_by", 4, [4]),
    (DIAMOND, "body.fixed", {"nodes": 5}, [{"nodes": [5]}]),
    (DIAMOND, "body.fixed", {"sphere": {"centre": [0, 0, 0], "radius": 1}},
     [{"sphere": {"centre": [0, 0, 0], "radius": 1}}]),
    (GRASPER, "motors", {"name": "m", "cables": "cable_0"}, [{"name": "m", "cables": ["cable_0"]}]),
    (GRASPER, "contact.between", {"pair": ["finger_0", "cube"]}, [{"pair": ["finger_0", "cube"]}]),
    (GRASPER, "motors", None, []),
    (DIAMOND, "cables.0.shortening", [None, 0.02], [-math.inf, 0.02]),
    (DIAMOND, "cables.0.tension", [None, None], [0.0, math.inf]),
])  # fmt: skip
def test_unambiguous_entries_have_a_short_form(original, keys, short, long):
    asked = scene_from_mapping(changed(original, keys, short))
    assert asked == scene_from_mapping(changed(original, keys, long))


@pytest.mark.parametrize("original, keys, value, key, words", [
    (DIAMOND, "cables", {"north": {"points": [0, 0, 0]}}, "cables", "each entry starts with '- '"),
    (DIAMOND, "body.material", "silicone", "body.material.preset", "is none of the presets"),
    (DIAMOND, "body.mesh.rotation", 90, "body.mesh.rotation", "must be a list of 3 numbers"),
    (DIAMOND, "effectors.0.points", [[0, 0]], "effectors[0].points[0]",
     "must be a list of 3 numbers; it has 2"),
    (DIAMOND, "cables.0.pull_point", [0, 0, 0, 0], "cables[0].pull_point", "it has 4"),
    (DIAMOND, "effectors.0.directions", "xw", "effectors[0].directions[0]", "one of x, y, z"),
    (DIAMOND, "cables.0.rate", "50 mm/s", "cables[0].rate", "in m/s, written without its unit"),
    (DIAMOND, "cables.0.rate", True, "cables[0].rate", "must be a number"),
    (DIAMOND, "cables.0.pull_point", [0, True, 0], "cables[0].pull_point[1]", "must be a number"),
    (DIAMOND, "cables.0.tension", 20, "cables[0].tension", "must be a list of 2 numbers"),
    (DIAMOND, "cables.0.tension", [0, math.nan], "cables[0].tension", ".inf for no limit"),
    (DIAMOND, "cables.0.tension", [math.inf, math.inf], "cables[0].tension", "no value lies"),
    (DIAMOND, "cables.0.rate", math.nan, "cables[0].rate", "must be above 0"),
    (DIAMOND, "gravity", [0, 0, math.inf], "gravity[2]", "must be finite"),
    (DIAMOND, "gravity", [0, 0, 1e200], "gravity", "greater than 1e+30"),
    (DIAMOND, "solver", {"newton_iterations": 1.5}, "solver.newton_iterations", "a whole number"),
    (DIAMOND, "integration", "quasistatic", "integration", "is quasi_static meant?"),
    (DIAMOND, "body.materail", {}, "body.materail", "is material meant?"),
    (DIAMOND, "cables.2.ratee", 1, "cables[2].ratee", "is rate meant?"),
    (DIAMOND, "body.young_modulus", 1, "body.young_modulus", "it belongs in body.material"),
    (DIAMOND, "body.material.E", 1e5, "body.material.E", "is young_modulus meant?"),
    (DIAMOND, "body", [], "body", "several are given as bodies"),
    (DIAMOND, "cables.1.pull_point_on", "bdy", "cables[1].pull_point_on", "is body meant?"),
    (GRASPER, "contact.between.3.pair", ["cube", "flor"], "contact.between[3].pair[1]",
     "is floor meant?"),
    (GRASPER, "motors.0.cables", "cable0", "motors[0].cables[0]", "is cable_0 meant?"),
    (DIAMOND, "3", 5, "[3]", "a key must be a word"),
])  # fmt: skip
def test_invalid_values_are_reported_in_terms_of_yaml(original, keys, value, key, words):
    mapping = changed(original, keys, value)
    with pytest.raises(SceneError) as error:
        scene_from_mapping(mapping, Path("robot.yaml"))
    assert error.value.key == key
    assert words in error.value.reason
    assert str(error.value).startswith("robot.yaml: ") and "\n" not in str(error.value)


def test_a_misspelt_key_is_reported_before_a_missing_key():
    mapping = changed(DIAMOND, "body.material.young_modulos", 1e5)
    del mapping["body"]["material"]["young_modulus"]
    with pytest.raises(SceneError, match="is young_modulus meant"):
        scene_from_mapping(mapping)


def test_limits_of_a_cable_may_be_omitted():
    mapping = copy.deepcopy(DIAMOND)
    for key in ("shortening", "tension", "rate"):
        mapping["cables"][0].pop(key)
    mapping["cables"][1]["tension"] = yaml.safe_load("[0.5, .inf]")
    left_out, half_open = scene_from_mapping(mapping).cables[:2]
    assert left_out.shortening == (-math.inf, math.inf)
    assert left_out.tension == (0.0, math.inf) and left_out.rate is None
    assert half_open.tension == (0.5, math.inf)
