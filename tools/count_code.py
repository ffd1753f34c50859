"""Counts the lines of code of each room: without docstrings, comments, blank lines and imports.

    python3 tools/count_code.py              # print them
    python3 tools/count_code.py --renew      # write the table of docs/architecture.md, and lower the limits

The package and the tests may not have more lines than tools/code_limits.txt says. A test refuses more, and a
limit that gets higher. An issue that may add lines adds a line that says how many, and for what.
"""

from __future__ import annotations

import ast
import re
import sys
from pathlib import Path
from typing import NamedTuple


class Count(NamedTuple):
    """The size of a room.

    Attributes:
        files: Its Python files.
        lines: Their lines of code.
    """

    files: int
    lines: int


def code_lines(path: Path) -> int:
    """The lines of code of a file."""
    text, without = path.read_text(encoding="utf-8"), set()
    lines = {number for number, line in enumerate(text.splitlines(), start=1)
             if line.strip() and not line.lstrip().startswith("#")}  # fmt: skip
    for node in ast.walk(ast.parse(text)):
        is_text = (isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
                   and isinstance(node.value.value, str))  # fmt: skip
        if is_text or isinstance(node, ast.Import | ast.ImportFrom):
            without.update(range(node.lineno, node.end_lineno + 1))
        elif isinstance(node, ast.Constant | ast.JoinedStr):  # lines of a long text may look like others
            lines.update(range(node.lineno, node.end_lineno + 1))
    return len(lines - without)


def count_rooms(folder: Path) -> dict[str, Count]:
    """The size of each folder below one, by its name; of files beside these under ``.``."""
    files = {".": list(folder.glob("*.py"))}
    files |= {room.name: list(room.rglob("*.py")) for room in sorted(folder.iterdir())
              if room.is_dir()}  # fmt: skip
    return {name: Count(len(paths), sum(map(code_lines, paths)))
            for name, paths in files.items() if paths}  # fmt: skip


def read_limits(text: str) -> tuple[dict[str, int], dict[str, int]]:
    """The limit of each folder, and the sum of what issues may add to it.

    Args:
        text: Content of tools/code_limits.txt.
    """
    rows = re.findall(r"^(\w+) +(\+?)(\d+)", text, re.MULTILINE)
    limits = {folder: int(lines) for folder, plus, lines in rows if not plus}
    return limits, {folder: sum(int(lines) for name, plus, lines in rows if plus and name == folder)
                    for folder in limits}  # fmt: skip


def count_all(root: Path) -> tuple[dict[str, Count], dict[str, int]]:
    """What the table of rooms tells, and the lines of code of each folder with a limit."""
    rooms, tests = count_rooms(root / "softrobot_twin"), count_rooms(root / "test")
    package, tests = (Count(*map(sum, zip(*found.values(), strict=True))) for found in (rooms, tests))
    rooms["others"] = rooms.pop(".")
    lines = {"softrobot_twin": package.lines, "test": tests.lines}
    return rooms | {"tests": tests, "whole package": package}, lines


def table_of(rooms: dict[str, Count]) -> str:
    """The rows of the table, two rooms in each."""
    cells = [f"| {name} | {count.files} | {count.lines:,} " for name, count in rooms.items()]
    half = (len(cells) + 1) // 2
    pairs = zip(cells[:half], [*cells[half:], "| | | "][:half], strict=True)
    return "".join(f"{left}{right}|\n" for left, right in pairs)


def renew(root: Path) -> None:
    """Writes the table, and lowers the limits to what there is."""
    rooms, found = count_all(root)
    page, file = root / "docs" / "architecture.md", root / "tools" / "code_limits.txt"
    table = re.compile(r"(?<=\|---\|\n)(\| [\w ]+ \| \d+ \| [\d,]+ \|.*\n)+")
    page.write_text(table.sub(table_of(rooms), page.read_text(), count=1))
    text = file.read_text()
    limits, added = read_limits(text)
    for folder, limit in limits.items():
        lowered = min(limit, found[folder] - added[folder])
        text = re.sub(rf"^{folder} +\d+", f"{folder} {lowered}", text, flags=re.MULTILINE)
    file.write_text(text)


def main(arguments: list[str]) -> None:
    """Prints the size of each room, or renews what is written of them."""
    root = Path(__file__).resolve().parents[1]
    if arguments == ["--renew"]:
        renew(root)
    for name, count in count_all(root)[0].items():
        print(f"{name:14} {count.files:4d} files {count.lines:6d} lines of code")


if __name__ == "__main__":
    main(sys.argv[1:])
