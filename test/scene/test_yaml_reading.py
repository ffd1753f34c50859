"""Facts of the YAML that scenes are written in."""

from __future__ import annotations

import pytest
import yaml

from softrobot_twin.errors import SceneError
from softrobot_twin.scene import load_scene
from softrobot_twin.scene.yaml_reading import read_yaml

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


def test_a_scene_file_says_what_a_spring_is_on(tmp_path):
    file = tmp_path / "spring.yaml"
    file.write_text(SPRING)
    assert [end.on for end in load_scene(file).springs[0].ends] == ["ball", "world"]


@pytest.mark.parametrize("word", ["on", "off", "yes", "no", "On", "NO"])
def test_only_true_and_false_are_truth_values(word):
    assert read_yaml(f"{word}: {word}") == {word: word}
    assert read_yaml("[true, False]") == [True, False]


def test_what_would_run_code_is_refused():
    with pytest.raises(yaml.YAMLError):
        read_yaml("!!python/object/apply:os.getcwd []")


@pytest.mark.parametrize("text, key, lines", [
    ("name: a\ngravity: [0, 0, 1]\nname: b\n", "name", (1, 3)),
    ("cables:\n  - name: a\n    rate: 1\n    rate: 2\n", "cables[0].rate", (3, 4)),
    ("body: {mesh: {file: a, file: b}}\n", "body.mesh.file", (1, 1)),
])  # fmt: skip
def test_a_key_that_stands_twice_is_refused_with_both_lines(tmp_path, text, key, lines):
    file = tmp_path / "scene.yaml"
    file.write_text(text)
    with pytest.raises(SceneError) as error:
        load_scene(file)
    assert error.value.key == key
    assert error.value.reason == f"stands twice, in lines {lines[0]} and {lines[1]}"


def test_a_section_that_is_merged_in_may_be_overruled():
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
    (b"name: caf\xe9\n", "not a text file"),
    (b"\x00\x01\x02\xff", "not a text file"),
    ("name: a".encode("utf-16"), "not a text file"),
    (b"a: &a [*a]\n", "an anchor holds itself"),
    (b"a: &a [1, 2]\n" + ANCHORS.encode(), "anchors make more than"),
    (b"[" * 20_000, "nested too deep"),
    (b"a: " + b"9" * 6000, "digits"),
    (b"a: 2001-99-99", "month"),
    (b"? [1, 2]\n: 3\n", "a key must be a word"),
    (b"name: a\n---\nname: b\n", "single document"),
])  # fmt: skip
def test_what_is_no_scene_is_refused_in_one_line(tmp_path, content, words):
    file = tmp_path / "scene.yaml"
    file.write_bytes(content)
    with pytest.raises(SceneError) as error:
        load_scene(file)
    assert words in str(error.value) and "\n" not in str(error.value)
    assert str(error.value).startswith(f"{file}: ")


def test_a_folder_and_a_missing_file_are_refused_by_name(tmp_path):
    with pytest.raises(SceneError, match="Is a directory"):
        load_scene(tmp_path)
    with pytest.raises(SceneError, match="No such file"):
        load_scene(tmp_path / "none.yaml")


def test_a_byte_order_mark_is_no_part_of_a_scene(tmp_path):
    file = tmp_path / "spring.yaml"
    file.write_text(SPRING, encoding="utf-8-sig")
    assert load_scene(file).name == "ball_on_a_spring"
