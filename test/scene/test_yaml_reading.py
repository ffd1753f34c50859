"""Facts of the YAML that scenes are written in."""

from __future__ import annotations

import pytest
import yaml

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
