"""docs/architecture.md shows the rooms that there are."""

import re

from test.places import PACKAGE, ROOT

TEXT = (ROOT / "docs" / "architecture.md").read_text()


def test_the_picture_shows_every_room_and_only_imports_that_are_allowed():
    picture = TEXT.split("```mermaid")[1].split("```")[0]
    rooms = set(re.findall(r"^\s+(\w+)\[", picture, re.M))
    folders = {path.name for path in PACKAGE.iterdir() if (path / "__init__.py").exists()}
    assert rooms == folders
    for room, other in re.findall(r"(\w+) --> (\w+)", picture):
        pattern = re.compile(rf"(from|import) softrobot_twin\.{other}\b")
        assert any(pattern.search(path.read_text()) for path in (PACKAGE / room).rglob("*.py"))
