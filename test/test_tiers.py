"""`make test` leaves out what test/conftest.py names, and its names exist."""

import ast
import re
from functools import cache
from pathlib import Path

import pytest

TESTS = Path(__file__).parent
TABLES = ("KEPT", "LIBRARIES", "LONG", "SAMPLED")


@cache
def tables() -> dict[str, dict[str, tuple[str, ...]]]:
    """The tables of conftest.py, by name."""
    body = ast.parse((TESTS / "conftest.py").read_text()).body
    return {ast.unparse(node.targets[0]): ast.literal_eval(node.value) for node in body
            if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) in TABLES}


def path_of(room: str, file: str) -> Path:
    """The file of an entry, which may be in a room below."""
    path = TESTS / room / file
    path = path.with_name(f"test_{path.name}.py")
    return path if path.exists() else next((TESTS / room).glob(f"*/{path.name}"), path)


@pytest.mark.parametrize("table", TABLES)
def test_each_name_of_a_table_is_that_of_a_test(table):
    lost = []
    for room, entries in tables()[table].items():
        for entry in entries:
            file, _, test = entry.partition("::")
            path = path_of(room, file)
            name = re.sub(r"\[.*", "", test)
            if not path.is_file() or name and f"def {name}(" not in path.read_text():
                lost.append(entry)
    assert lost == []


def test_what_is_kept_would_be_left_out():
    for room, entries in tables()["KEPT"].items():
        for entry in entries:
            text = path_of(room, entry.partition("::")[0]).read_text()
            assert "mark.slow" in text, entry
