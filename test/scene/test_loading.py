"""Reading scene files: valid scenes, YAML, and errors that name file, key, value and unit."""

from __future__ import annotations

import copy
import re
from pathlib import Path

import pytest
import yaml

from softrobot_twin.errors import SceneError
from softrobot_twin.scene import load_scene, scene_from_mapping
from softrobot_twin.scene.loading import read_yaml, written_out
from test.places import CONFIG

pytestmark = pytest.mark.libraries

GOOD = written_out(yaml.safe_load((CONFIG / "scenes" / "diamond.yaml").read_text()))


def refused(change, path=Path("robot.yaml")) -> SceneError:
    mapping = copy.deepcopy(GOOD)
    change(mapping)
    with pytest.raises(SceneError) as error:
        scene_from_mapping(mapping, path)
    assert str(error.value).startswith("robot.yaml: ")
    assert "\n" not in str(error.value)
    return error.value


def refused_file(folder, content: str | bytes) -> tuple[SceneError, str]:
    """The error of a scene file of this content, and its text without the file's folder."""
    file = folder / "scene.yaml"
    file.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(SceneError) as error:
        load_scene(file)
    return error.value, str(error.value).replace(f"{folder}/", "")


@pytest.mark.parametrize("scene", sorted((CONFIG / "scenes").glob("*.yaml")), ids=lambda p: p.stem)
def test_our_own_scenes_load(scene):
    loaded = load_scene(scene)
    assert all(loaded.file_path(body.mesh.file).exists() for body in loaded.deformables)
    assert loaded.deformables or loaded.beams


MISSING = object()
MATERIAL, CABLE = ("body", "material"), ("cables", 0)


@pytest.mark.parametrize("place, value, key, unit, words", [
    *(((*MATERIAL, name), value, f"body.material.{name}", unit, f"body.material.{name} = {value!r}")
      for name, value, unit in (
          ("young_modulus", 0.0, "Pa"), ("young_modulus", -1.0, "Pa"),
          ("young_modulus", float("nan"), "Pa"), ("young_modulus", "soft", "Pa"),
          ("poisson_ratio", 0.5, ""), ("poisson_ratio", 0.7, ""), ("density", 0.0, "kg/m³"),
          ("density", float("inf"), "kg/m³"))),
    (("cables", 1, "tension"), [5.0, 1.0], "cables[1].tension", "N", "above"),
    ((*CABLE, "tension"), [-1.0, 5.0], "cables[0].tension", "N", "push"),
    ((*CABLE, "shortening"), [0.01, 0.02], "cables[0].shortening", "m", "rest"),
    (("shells",), [{"name": "x"}], "shells", "", "shells.*not available"),
    (("body", "element"), "cubic", "body.element", "", "quadratic"),
    (("cables", 2, "ratee"), 0.1, "cables[2].ratee", "", "rate.*shortening"),
    ((*CABLE, "pull_point"), MISSING, "cables[0].pull_point", "m", "required"),
    (("effectors", 0, "points"), [[0.0, 1.0]], "effectors[0].points[0]", "m", ""),
    (("cables", 1, "name"), "north", "cables[1].name", "", "north.*more than once"),
    (("effectors", 0, "measured_by"), [4, 99], "effectors[0].measured_by", "", "tip.*99"),
    (("body", "fixed", 0, "nodes"), [1], "body.fixed[0]", "", "exactly one"),
])  # fmt: skip
def test_impossible_values_are_refused_with_key_value_and_unit(place, value, key, unit, words):
    def spoil(mapping):
        *sections, name = place
        for section in sections:
            mapping = mapping[section]
        if value is MISSING:
            del mapping[name]
        else:
            mapping[name] = value

    error = refused(spoil)
    assert (error.key, error.unit) == (key, unit)
    assert re.search(words, str(error)), str(error)


def test_an_element_is_quadratic_by_default():
    mapping = copy.deepcopy(GOOD)
    del mapping["body"]["element"]
    assert scene_from_mapping(mapping).body.element == "quadratic"


SPOILT = """
name: robot
body:
  mesh: part.msh
  material:
    young_modulos: 1.0e5
    poisson_ratio: 0.7
    density: -3
  fixed:
    - box: {minimum: [0, 0, 0],
            maximum: [1, 1]}
effectors: {name: tip, points: [[0, 0, 0]]}
cables:
  - name: a#
    repeat: {count: 3, about: z}
    rate: fast
    pull_point: [0.1, 0, 0]
    points: [[0, 0, 0.1]]
"""


def test_all_errors_of_a_scene_are_reported_with_their_lines(tmp_path):
    error, text = refused_file(tmp_path, SPOILT)
    assert re.findall(r"^scene.yaml:(\d+): (\S+) = ", text, re.MULTILINE) == [
        ("6", "body.material.young_modulos"), ("7", "body.material.poisson_ratio"),
        ("8", "body.material.density"), ("11", "body.fixed[0].box.maximum"),
        ("16", "cables[0].rate"),
    ]  # fmt: skip
    assert text.count("\n") == 4
    assert [error.line, *(one.line for one in error.others)] == [6, 7, 8, 11, 16]


def test_a_missing_key_has_the_line_of_its_section(tmp_path):
    _, text = refused_file(tmp_path, SPRING.replace("    stiffness: 10.0\n", ""))
    assert text.startswith("scene.yaml:8: springs[0].stiffness = '(nothing)'")


def test_a_key_that_is_a_number_has_its_line(tmp_path):
    error, text = refused_file(tmp_path, SPRING + "7: 8\n")
    assert "a key must be a word" in text and error.line == SPRING.count("\n") + 1


def test_an_error_in_a_value_of_several_kinds_is_one_error_at_its_key(tmp_path):
    _, text = refused_file(
        tmp_path, "name: a\nbeams:\n  - name: b\n    joined:\n      - {at: middle, to: world}\n")
    (line,) = [line for line in text.splitlines() if ".at = " in line]
    assert line.startswith("scene.yaml:5: beams[0].joined[0].at = 'middle'")


def test_errors_beyond_the_tenth_are_counted(tmp_path):
    _, text = refused_file(tmp_path, "".join(f"key_{number}: 1\n" for number in range(300)))
    assert text.count("\n") == 10 and text.endswith("and 290 more errors")


@pytest.mark.sampled
@pytest.mark.parametrize("content, words", [
    ("a: " + "x" * 5_000_000, "has 5 MB; a scene has at most 4 MB"),
    ("".join(f"key_{number}: 1\n" for number in range(60_000)), "more than 50000 entries"),
    ("a: [" + "1, " * 60_000 + "]", "more than 50000 entries"),
    ("- " * 400_000, "nested too deeply"),
    ("{a: " * 100_000, "nested too deeply"),
    ("a: 0b" + "1" * 3_000_000, "digits"),
])  # fmt: skip
def test_a_text_too_large_for_a_scene_is_refused_before_it_is_read_whole(tmp_path, content, words):
    assert words in refused_file(tmp_path, content)[1]


def test_the_mesh_is_found_from_the_scene_files_folder(tmp_path):
    scene = scene_from_mapping(copy.deepcopy(GOOD), tmp_path / "config" / "scenes" / "r.yaml")
    assert scene.mesh_path == tmp_path / "meshes" / "diamond_600.vtk"


def test_a_scene_is_frozen():
    scene = scene_from_mapping(copy.deepcopy(GOOD))
    with pytest.raises(Exception, match="frozen"):
        scene.name = "other"


SPRING = """
name: ball_on_a_spring
gravity: [0.0, 0.0, 0.0]
integration: dynamic
rigid_bodies:
  - {name: ball, mass: 0.1, sphere: {radius: 0.01}}
springs:
  - name: spring
    stiffness: 10.0
    ends:
      - {on: ball, point: [0.0, 0.0, 0.0]}
      - {on: world, point: [0.0, 0.0, 0.1]}
"""


def test_the_ends_of_a_spring_are_named_in_the_scene(tmp_path):
    file = tmp_path / "spring.yaml"
    file.write_text(SPRING)
    assert [end.on for end in load_scene(file).springs[0].ends] == ["ball", "world"]


@pytest.mark.parametrize("word", ["on", "off", "yes", "no", "On", "NO"])
def test_only_true_and_false_are_booleans(word):
    assert read_yaml(f"{word}: {word}") == {word: word}
    assert read_yaml("[true, False]") == [True, False]


def test_yaml_tags_that_run_code_are_refused():
    with pytest.raises(yaml.YAMLError):
        read_yaml("!!python/object/apply:os.getcwd []")


@pytest.mark.parametrize("text, key, lines", [
    ("name: a\ngravity: [0, 0, 1]\nname: b\n", "name", (1, 3)),
    ("cables:\n  - name: a\n    rate: 1\n    rate: 2\n", "cables[0].rate", (3, 4)),
    ("body: {mesh: {file: a, file: b}}\n", "body.mesh.file", (1, 1)),
])  # fmt: skip
def test_a_duplicate_key_is_refused_with_both_lines(tmp_path, text, key, lines):
    error, _ = refused_file(tmp_path, text)
    assert error.key == key
    assert error.reason == f"is given twice, in lines {lines[0]} and {lines[1]}"


def test_a_merged_section_may_be_overridden():
    text = "a: &a {x: 1, y: 2}\nb: &b {<<: *a, y: 3}\nc: {d: {<<: *b, x: 4}}\ne: *b\n"
    assert read_yaml(text)["c"]["d"] == {"x": 4, "y": 3}
    assert read_yaml(text)["e"] == {"x": 1, "y": 3}


ANCHORS = "".join(
    f"{c}: &{c} [{', '.join(f'*{p}' for _ in range(9))}]\n" for p, c in zip("abcdefgh", "bcdefghi")
)


@pytest.mark.parametrize("content, words", [
    (b"name: a\n\tbody: 3\n", "a tab in line 2, column 1"),
    (b"", "is empty"),
    (b"# nothing but remarks\n", "is empty"),
    (b"- 1\n", "a scene is a mapping"),
    (b"a word", "a scene is a mapping"),
    (b"name: [1\n", "line 2"),
    (b"a: [", "not YAML"),
    (b"name: caf\xe9\n", "not a text file"),
    (b"\x00\x01\x02\xff", "not a text file"),
    ("name: a".encode("utf-16"), "not a text file"),
    (b"a: &a [*a]\n", "an anchor contains itself"),
    (b"a: &a [1, 2]\n" + ANCHORS.encode(), "anchors expand to more than"),
    (b"[" * 20_000, "nested too deep"),
    (b"a: " + b"9" * 6000, "digits"),
    (b"a: 2001-99-99", "month"),
    (b"? [1, 2]\n: 3\n", "a key must be a word"),
    (b"name: a\n---\nname: b\n", "single document"),
])  # fmt: skip
def test_an_invalid_scene_is_refused_in_one_line(tmp_path, content, words):
    _, text = refused_file(tmp_path, content)
    assert text.startswith("scene.yaml: ") and words in text and "\n" not in text


def test_a_folder_and_a_missing_file_are_refused_by_name(tmp_path):
    with pytest.raises(SceneError, match="Is a directory"):
        load_scene(tmp_path)
    with pytest.raises(SceneError, match="No such file"):
        load_scene(tmp_path / "none.yaml")


def test_a_byte_order_mark_is_ignored(tmp_path):
    file = tmp_path / "spring.yaml"
    file.write_text(SPRING, encoding="utf-8-sig")
    assert load_scene(file).name == "ball_on_a_spring"
