"""docs/architecture.md shows the rooms that there are, and a test for each addition."""

import re

from test.places import PACKAGE, ROOT

TEXT = (ROOT / "docs" / "architecture.md").read_text()


def section(title: str) -> str:
    """The text below a heading."""
    return TEXT.split(f"## {title}\n")[1].split("\n## ")[0]


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
