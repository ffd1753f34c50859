"""docs/hard_cases.md names tests for each hard case, and they exist."""

import ast
import re
from functools import cache

import pytest

from test.places import ROOT

ROWS = [line for line in (ROOT / "docs" / "hard_cases.md").read_text().splitlines()
        if re.match(r"\d+\. ", line)]  # fmt: skip


def number(row: str) -> int:
    return int(row.split(".")[0])


@cache
def functions_of(file: str) -> set[str]:
    path = ROOT / "test" / file
    tree = ast.parse(path.read_text()) if path.is_file() else ast.Module([], [])
    return {node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)}


def test_the_page_has_each_case_once():
    assert [number(row) for row in ROWS] == [*range(1, max(54, len(ROWS)) + 1)]


@pytest.mark.parametrize("row", ROWS, ids=number)
def test_each_named_test_exists(row):
    named = re.findall(r"`(\w+/[\w/]+\.py)::(test_\w+)`", row)
    assert row.count("::") == len(named)
    assert named and [test for file, test in named if test not in functions_of(file)] == []
