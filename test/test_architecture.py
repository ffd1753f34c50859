"""docs/architecture.md and docs/elements.md name only files and functions that exist."""

import ast
import re
from pathlib import Path

import pytest

from test.places import PACKAGE, ROOT


DOCUMENT = ROOT / "docs" / "architecture.md"
TEXT = DOCUMENT.read_text()
ELEMENTS = (ROOT / "docs" / "elements.md").read_text()
LINKS = re.findall(r"\[`([\w./]+)`\]\(([\w./]+)\)", TEXT + ELEMENTS)


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


def test_each_kind_of_addition_has_an_example_in_a_test():
    rows = [line for line in section("How to add something").splitlines() if line.startswith("| a")]
    examples = [re.findall(r"\]\(\.\./(test/[\w/]+\.py)\)", row) for row in rows]
    assert len(rows) == 7
    assert all(example and (ROOT / example[-1]).is_file() for example in examples)
