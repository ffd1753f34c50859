"""docs/statuses.md names each word that a run or a node may show."""

import ast
import re
from pathlib import Path

import pytest

from softrobot_twin.control.arrival import Refusal
from softrobot_twin.control.engagement import Activity
from softrobot_twin.control.twin_loop import DEVICE_LOST
from softrobot_twin.errors import SceneError
from softrobot_twin.scene.loading import load_scene
from softrobot_twin.simulation import Status
from softrobot_twin.simulation.building.actuator_kinds import actuator_kinds
from softrobot_twin.simulation.building.limits import ANGLE
from softrobot_twin.simulation.result import BURST, COARSE, GRIP, RATE, SAMPLED, STRAINED, UNSTABLE
from softrobot_twin.simulation.step.actuation import INVERSION
from softrobot_twin.simulation.step.goals import ENERGY, REACH

ROOT = Path(__file__).resolve().parents[2]
TEXT = (ROOT / "docs" / "statuses.md").read_text()
NAMED = set(re.findall(r"`([^`\n]+)`", TEXT))
LAST_PARTS = {name.rpartition(".")[2] for name in NAMED}


@pytest.mark.parametrize("word", [*Status, *Activity, *Refusal], ids=lambda word: word.name)
def test_the_page_has_a_row_for_each_word(word):
    rows = [line for line in TEXT.splitlines() if line.startswith(f"| `{word.value}` |")]
    assert len(rows) == 1
    meaning, remedy = rows[0].strip("| ").split(" | ")[1:3]
    assert len(meaning) > 10 and remedy


def test_the_page_names_the_limits_of_every_kind_of_actuator():
    words = {quantity.word for kind in actuator_kinds()
             for quantity in (kind.displacement, kind.effort, ANGLE)}  # fmt: skip
    assert {"shortening", "tension", "growth", "pressure"} <= words
    ends = {f"{word}_{end}" for word in words for end in ("min", "max")}
    assert ends - LAST_PARTS == set()


@pytest.mark.parametrize("name", [INVERSION, ENERGY, REACH, UNSTABLE])
def test_the_page_names_limits_that_are_not_those_of_one_object(name):
    assert name in NAMED


@pytest.mark.parametrize("ending", [RATE.lstrip("."), SAMPLED, STRAINED, COARSE, BURST,
                                    "force_limit", "force_limit_exceeded",
                                    "least_force", "least_force_missed", GRIP])  # fmt: skip
def test_the_page_names_limits_of_bodies_and_pairs(ending):
    assert ending in LAST_PARTS


def words_of(path: Path) -> tuple[set[str], set[str]]:
    """Keys that a file writes: constant ones, and the constant ends of the others."""
    whole, ends = set(), set()
    for node in ast.walk(ast.parse((ROOT / "softrobot_twin" / path).read_text())):
        keys = node.keys if isinstance(node, ast.Dict) else []
        if isinstance(node, ast.Subscript) and isinstance(node.ctx, ast.Store):
            keys = [node.slice]
        whole |= {key.value for key in keys if isinstance(key, ast.Constant)}
        last = [key.values[-1] for key in keys if isinstance(key, ast.JoinedStr)]
        ends |= {part.value for part in last if isinstance(part, ast.Constant)}
    return whole, ends


def test_the_page_names_each_entry_and_value_of_the_diagnostics():
    whole, ends = words_of(Path("ros", "diagnostics.py"))
    assert {"loop", "residual_n", "left_out"} <= whole and "_sampled_range" in ends
    unknown = {word for word in whole if word not in NAMED and f"### {word}" not in TEXT
               and not re.search(rf"^### .*\b{word}\b", TEXT, re.M)}  # fmt: skip
    assert unknown == set()
    assert {end for end in ends if not any(name.endswith(end) for name in NAMED)} == set()


def test_the_page_names_each_reason_for_holding():
    source = (ROOT / "softrobot_twin" / "control" / "twin_loop.py").read_text()
    reasons = set(re.findall(r'"(no \w+ (?:yet|for target_timeout)|markers lost)"', source))
    assert len(reasons) == 5
    assert (reasons | {DEVICE_LOST, "not enabled"}) - NAMED == set()


def test_the_refusal_on_the_page_is_what_a_scene_with_this_fault_gives(tmp_path):
    page = (ROOT / "docs" / "own_robot.md").read_text()
    text = re.search(r"```yaml\n(.*?)```", page, re.S)[1]
    file = tmp_path / "finger.yaml"
    file.write_text(re.sub(r"young_modulus: [\d.e]+", "young_modulus: -5.0", text))
    with pytest.raises(SceneError) as raised:
        load_scene(file)
    assert f"softrobot_twin: {raised.value}".replace(f"{tmp_path}/", "") in TEXT.splitlines()
