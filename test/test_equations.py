"""docs/equations.md: each equation of the paper has one row, and each row says what is true."""

import re
from importlib import import_module
from pathlib import Path
from typing import NamedTuple

import pytest

from test.places import ROOT

DOCUMENT = ROOT / "docs" / "equations.md"
EQUATIONS = range(1, 23)
"""Numbers of the equations of Coevoet et al., 2017."""
LINK = re.compile(r"\[`([\w.]+)`\]\(\.\./([\w/]+\.py)\)")
CITATION = re.compile(r"\beqs?\.\s+((?:\(?\d+\)?(?:\s*(?:-|–|,|and|to)\s*)?)+)")


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


def citations(path: Path) -> list[int]:
    """Numbers of all equations that a file cites; a range counts by its ends."""
    text = re.sub(r"\s*\n[\s#]*", " ", path.read_text())
    return [int(number) for cited in CITATION.findall(text) for number in re.findall(r"\d+", cited)]


def sources() -> list[Path]:
    """Every file that may cite an equation."""
    folders = ("softrobot_twin", "tools", "meshes", "config", "docs")
    suffixes = {".py", ".md", ".yaml"}
    return [ROOT / "README.md"] + sorted(
        path for folder in folders for path in (ROOT / folder).rglob("*") if path.suffix in suffixes
    )


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


def test_sources_cite_only_equations_of_the_paper():
    cited = {path: set(citations(path)) - set(EQUATIONS) for path in sources()}
    assert {path: numbers for path, numbers in cited.items() if numbers} == {}
    assert any(citations(path) for path in sources())


def test_a_file_of_the_table_that_cites_equations_cites_one_that_it_computes():
    computed = {}
    for row in rows():
        for _, file in row.links:
            computed.setdefault(file, set()).update(row.numbers)
    wrong = []
    for file, numbers in computed.items():
        cited = citations(ROOT / file)
        if cited and not numbers & set(cited):
            wrong.append(f"{file} computes {sorted(numbers)} and cites {sorted(cited)}")
    assert wrong == []
