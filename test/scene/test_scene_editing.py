"""Numbers in the text of a scene file are changed, and nothing else."""

import pytest

from softrobot_twin.scene import load_scene, scene_from_mapping
from softrobot_twin.scene.loading import read_yaml
from softrobot_twin.scene.scene_editing import EditedValue, edited_text
from test.places import SCENES


def edited(name, numbers):
    path = SCENES / f"{name}.yaml"
    scene, text = load_scene(path), path.read_text()
    new = edited_text(text, scene, {key: EditedValue(value, f"by {key}") for key, value in numbers.items()})
    return text, new, scene_from_mapping(read_yaml(new), path)


def test_a_number_is_changed_in_its_line_which_says_so():
    text, new, scene = edited("diamond_device", {"body.material.young_modulus": 163456.7})
    assert scene.body.material.young_modulus == 163456.7
    changed = [line for line in new.split("\n") if line not in text.split("\n")]
    assert len(changed) == 1
    assert changed[0].split() == ("young_modulus: 163456.7 # Pa, 0.85 of the twin's; by "
                                  "body.material.young_modulus").split()


def test_a_key_that_the_file_leaves_out_is_added_to_its_section():
    text, new, scene = edited("diamond_device", {"cables[1].offset": -1e-5, "cables[0].points[0][1]": 0.0961,
                                                 "marker_frame.rotation[2]": 0.01})  # fmt: skip
    assert scene.cables[1].offset == -1e-5 and scene.cables[0].points[0][1] == 0.0961
    assert scene.marker_frame.rotation == (0.0, 0.0, 0.01)
    assert "    offset: -1.0e-05  # by cables[1].offset" in new
    lines = set(new.split("\n"))
    assert len([line for line in text.split("\n") if line not in lines]) == 1


@pytest.mark.parametrize(("name", "key", "value"), [
    ("diamond", "cables[3].offset", 2e-4), ("trunk", "cables[2].offset", 1e-4),
    ("fetch", "cavities[2].pressure_gain", 0.97), ("strider", "hinge_motors[1].offset", 0.02),
    ("diamond", "markers[2].point[1]", 0.001),
])  # fmt: skip
def test_copies_of_which_one_has_another_number_are_written_out(name, key, value):
    text, new, scene = edited(name, {key: value})
    section, index = key.partition("[")[0], int(key.partition("[")[2][0])
    before = load_scene(SCENES / f"{name}.yaml")
    for place, (old, now) in enumerate(zip(getattr(before, section), getattr(scene, section), strict=True)):
        assert (old == now) == (place != index)
    assert "# Written out" in new


@pytest.mark.parametrize("name", ["flexo", "strider"])
def test_a_number_that_all_copies_share_is_changed_once_and_the_pattern_stays(name):
    scene = load_scene(SCENES / f"{name}.yaml")
    keys = [f"beams[{place}].material.young_modulus" for place in range(len(scene.beams))]
    text, new, scene = edited(name, dict.fromkeys(keys, 3.3e7))
    assert {beam.material.young_modulus for beam in scene.beams} == {3.3e7}
    assert len(set(new.split("\n")) - set(text.split("\n"))) == 1 and "# Written out" not in new
