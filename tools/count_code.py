"""Counts the lines of code of each room: without docstrings, comments, blank lines and imports.

    python tools/count_code.py [FOLDER ...]     # by default the package and its tests
"""

from __future__ import annotations

import ast
import sys
import tokenize
from pathlib import Path
from typing import NamedTuple

_WITHOUT_CODE = {
    tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT,
    tokenize.ENDMARKER, tokenize.ENCODING,
}  # fmt: skip


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
    with path.open("rb") as file:
        tokens = [token for token in tokenize.tokenize(file.readline)
                  if token.type not in _WITHOUT_CODE]  # fmt: skip
    lines = {line for token in tokens for line in range(token.start[0], token.end[0] + 1)}
    for node in ast.walk(ast.parse(path.read_bytes())):
        is_text = (isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
                   and isinstance(node.value.value, str))  # fmt: skip
        if is_text or isinstance(node, ast.Import | ast.ImportFrom):
            lines -= set(range(node.lineno, node.end_lineno + 1))
    return len(lines)


def count_rooms(folder: Path) -> dict[str, Count]:
    """The size of each folder below one, by its name; of files beside these under ``.``."""
    files = {".": list(folder.glob("*.py"))}
    files |= {room.name: list(room.rglob("*.py")) for room in sorted(folder.iterdir())
              if room.is_dir()}  # fmt: skip
    return {name: Count(len(paths), sum(map(code_lines, paths)))
            for name, paths in files.items() if paths}  # fmt: skip


def main(folders: list[str]) -> None:
    """Prints a table of each folder."""
    for folder in folders or ["softrobot_twin", "test"]:
        rooms = count_rooms(Path(folder))
        whole = Count(*map(sum, zip(*rooms.values(), strict=True)))
        for name, count in {**rooms, "all": whole}.items():
            print(f"{folder}/{name:14} {count.files:4d} files {count.lines:6d} lines of code")


if __name__ == "__main__":
    main(sys.argv[1:])
