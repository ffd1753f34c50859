"""docs/architecture.md and docs/elements.md name only files and functions that exist."""

import ast
import re
import sys
from pathlib import Path

import pytest

from softrobot_twin.control.arrival import Arrival
from softrobot_twin.control.loop_settings import LoopSettings
from softrobot_twin.control.twin_loop import TwinLoop
from softrobot_twin.simulation import Simulation

ROOT = Path(__file__).resolve().parents[1]
DOCUMENT = ROOT / "docs" / "architecture.md"
PACKAGE = ROOT / "softrobot_twin"
TEXT = DOCUMENT.read_text()
ELEMENTS = (ROOT / "docs" / "elements.md").read_text()
LINKS = re.findall(r"\[`([\w./]+)`\]\(([\w./]+)\)", TEXT + ELEMENTS)
MOST_PASSED = {"target": 24, "Young's modulus": 18}
"""Functions that a value may pass on its walk."""


def defined_in(path: Path) -> set[str]:
    """Names that a file defines, those of a class with its name before them."""
    found = set()
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.ClassDef | ast.FunctionDef):
            found.add(node.name)
        if isinstance(node, ast.ClassDef):
            found |= {f"{node.name}.{inner.name}" for inner in node.body
                      if isinstance(inner, ast.FunctionDef)}
        if isinstance(node, ast.Assign):
            found |= {target.id for target in node.targets if isinstance(target, ast.Name)}
    return found


def section(title: str) -> str:
    """The text below a heading."""
    return TEXT.split(f"## {title}\n")[1].split("\n## ")[0]


@pytest.mark.parametrize("name, target", LINKS)
def test_every_link_points_to_a_file_that_defines_the_name(name, target):
    path = (DOCUMENT.parent / target).resolve()
    assert path.is_relative_to(ROOT) and path.is_file()
    assert path.name == name or name in defined_in(path)


def test_every_folder_and_constant_of_the_text_exists():
    assert all((PACKAGE / room).is_dir() for room in re.findall(r"`(\w+)/`", TEXT))
    assert all((ROOT / folder).is_dir() for folder in re.findall(r"`([\w/]+/\w+)/`", TEXT))
    for constant, target in re.findall(r"`([A-Z_]{4,})` in \[`\w+\.py`\]\(([\w./]+)\)", TEXT):
        assert constant in defined_in((DOCUMENT.parent / target).resolve())


def test_the_picture_shows_every_room_and_only_imports_that_are_allowed():
    picture = TEXT.split("```mermaid")[1].split("```")[0]
    rooms = set(re.findall(r"^\s+(\w+)\[", picture, re.M))
    folders = {path.name for path in PACKAGE.iterdir() if (path / "__init__.py").exists()}
    assert rooms == folders
    for room, other in re.findall(r"(\w+) --> (\w+)", picture):
        pattern = re.compile(rf"(from|import) softrobot_twin\.{other}\b")
        assert any(pattern.search(path.read_text()) for path in (PACKAGE / room).rglob("*.py"))


def walk(value: str) -> list[list[tuple[str, str]]]:
    """The parts of a walk: each function with its file in the package."""
    rows = [line for line in section("Two walks").splitlines() if line.startswith(f"| {value}")]
    return [
        re.findall(r"\[`([\w.]+)`\]\(\.\./softrobot_twin/([\w./]+)\)", part)
        for row in rows for part in row.split(" | ")[1].split(";")
    ]  # fmt: skip


@pytest.mark.parametrize("value", MOST_PASSED)
def test_a_value_passes_few_functions(value):
    passed = {function for row in walk(value) for function in row}
    assert 1 < len(passed) <= MOST_PASSED[value]


def test_youngs_modulus_does_not_go_back_to_where_it_was_read():
    rooms = [path.split("/")[0] for row in walk("Young's modulus") for _, path in row]
    assert "scene" not in rooms[rooms.index("simulation"):]
    assert set(rooms[rooms.index("mechanics", len(rooms) - 6):]) == {"mechanics"}


class Calls:
    """Which functions of the package call which, while a block runs."""

    def __init__(self):
        self.pairs = set()

    def __enter__(self):
        sys.setprofile(self._note)
        return self

    def __exit__(self, *_):
        sys.setprofile(None)

    def _note(self, frame, event, _):
        called = event == "call" and _function_of(frame)
        while called and (frame := frame.f_back) is not None:
            caller = _function_of(frame)
            if caller:
                self.pairs.add((caller, called))
                return


def _function_of(frame) -> tuple[str, str] | None:
    """Name and file of a function of the package; None of others, and of comprehensions."""
    code = frame.f_code
    if "<" in code.co_qualname or not code.co_filename.startswith(f"{PACKAGE}/"):
        return None
    return code.co_qualname, str(Path(code.co_filename).relative_to(PACKAGE))


def names_in(name: str, file: str) -> set[str]:
    """Names in the body of a function."""
    body = ast.parse((PACKAGE / file).read_text()).body
    for part in name.split("."):
        node = next(node for node in body if getattr(node, "name", "") == part)
        body = node.body
    return {getattr(inner, "attr", getattr(inner, "id", "")) for inner in ast.walk(node)}


def check_walk(value: str, calls: Calls, without_profile: set[str]) -> None:
    """Each function of a walk calls the next one.

    Args:
        value: What walks.
        calls: What a run was seen to call.
        without_profile: Names of functions whose calls a run does not show: kernels, and those of
            `ros/`, which are looked up in the source.
    """
    for row in walk(value):
        for caller, called in zip(row, row[1:], strict=False):
            hidden = "ros" in caller[1].split("/") or called[0] in without_profile
            name = called[0].split(".")[-1]
            seen = name in names_in(*caller) if hidden else (caller, called) in calls.pairs
            assert seen, f"{caller[0]} does not call {called[0]}"


def test_youngs_modulus_walks_as_the_page_says(tmp_path):
    file = tmp_path / "block.yaml"
    file.write_text("""
        name: block
        gravity: [0.0, 0.0, -9.81]
        body:
          mesh: {box: {size: [0.02, 0.02, 0.04], cells: [1, 1, 2]}}
          material: {law: neo_hookean, young_modulus: 1.0e+5, poisson_ratio: 0.45, density: 1000.0}
          volume: per_element
          fixed: [{box: {minimum: [-1.0, -1.0, -1.0], maximum: [1.0, 1.0, 0.001]}}]
    """)
    with Calls() as calls:
        Simulation.from_scene_file(file)
    check_walk("Young's modulus", calls, {"add_stiffness", "linearize_all", "linearize"})


def test_a_target_walks_as_the_page_says():
    simulation = Simulation.from_scene_file(ROOT / "config" / "scenes" / "finger.yaml")
    loop = TwinLoop(simulation, LoopSettings(rate=50.0))
    place = simulation.effector_positions()[0]
    with Calls() as calls:
        for tick in range(5):
            now, stamp = 0.02 * tick, 10**9 + 20_000_000 * tick
            loop.targets.accept_point(
                0, place + 1e-4 * tick, Arrival("base_link", stamp, stamp, now))
            loop.tick(now, stamp)
    check_walk("target", calls, {"guessed_actuation"})


def test_each_kind_of_addition_has_an_example_in_a_test():
    rows = [line for line in section("How to add something").splitlines() if line.startswith("| a")]
    examples = [re.findall(r"\]\(\.\./(test/[\w/]+\.py)\)", row) for row in rows]
    assert len(rows) == 5
    assert all(example and (ROOT / example[-1]).is_file() for example in examples)
