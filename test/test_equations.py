"""docs/equations.md: each equation of the paper has one row, and each row says what is true."""

import re
from importlib import import_module
from typing import NamedTuple

import pytest

from test.places import ROOT

DOCUMENT = ROOT / "docs" / "equations.md"
EQUATIONS = range(1, 23)
"""Numbers of the equations of Coevoet et al., 2017."""
LINK = re.compile(r"\[`([\w.]+)`\]\(\.\./([\w/]+\.py)\)")
class Row(NamedTuple):
    """A row of the table.

    Attributes:
        numbers: The equations.
        links: Function or class, and its file, of each link.
        text: The last column.
    """

    numbers: list[int]
    links: list[tuple[str, str]]
    text: str


def rows() -> list[Row]:
    """The rows of the table."""
    found = []
    for line in DOCUMENT.read_text().splitlines():
        if line.startswith("| ("):
            first, *_, last = line.strip("|").split(" | ")
            found.append(Row([int(n) for n in re.findall(r"\d+", first)], LINK.findall(last), last))
    return found


def test_every_equation_of_the_paper_has_one_row():
    assert sorted(n for row in rows() for n in row.numbers) == list(EQUATIONS)


def test_every_row_names_functions_or_says_what_is_not_built():
    assert [row.numbers for row in rows()
            if bool(row.links) == row.text.strip().startswith("not built: ")] == []


@pytest.mark.parametrize("name, file", sorted({link for row in rows() for link in row.links}))
def test_every_function_of_the_table_exists(name, file):
    module = import_module(file.removesuffix(".py").replace("/", "."))
    found = module
    for part in name.split("."):
        found = getattr(found, part)
    assert callable(found)
    assert found.__module__ == module.__name__, "it is only imported there"
