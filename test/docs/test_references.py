"""docs/references.md: every source that is cited has an entry, and every entry is cited."""

import ast
import io
import re
import tokenize
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "references.md"
FOLDERS = ("softrobot_twin", "tools", "meshes", "examples")
AUTHOR = r"(?:de )?[A-ZÀ-Þ][\w-]+(?: Neto)?"
AUTHORS = rf"(?:{AUTHOR}(?:, {AUTHOR})* and )?{AUTHOR}(?: et al\.)?"
YEAR = r"(?:18[5-9]\d|19\d\d|20[0-2]\d)\b"
CITATION = re.compile(rf"\b({AUTHORS} {YEAR})")
# A year as only a source has it: in parentheses, or at the end of a phrase in them.
OF_A_SOURCE = re.compile(rf"\({YEAR}\)|\([^()]*?[A-Z][^()]*?, {YEAR}[);,]")


def prose(path: Path) -> list[str]:
    """Docstrings and comments of a Python file or the text of a page, each in one line."""
    text = path.read_text()
    if path.suffix == ".md":
        return [" ".join(text.split())]
    found = [node.value for node in ast.walk(ast.parse(text))
             if isinstance(node, ast.Constant) and isinstance(node.value, str) and " " in node.value]
    found.append("\n".join(token.string.lstrip("# ")
                           for token in tokenize.generate_tokens(io.StringIO(text).readline)
                           if token.type == tokenize.COMMENT))
    return [" ".join(each.split()) for each in found]


@cache
def all_prose() -> list[tuple[Path, str]]:
    files = [path for folder in FOLDERS for path in sorted((ROOT / folder).rglob("*.py"))]
    pages = [path for path in sorted((ROOT / "docs").glob("*.md")) if path != PAGE]
    return [(path.relative_to(ROOT), text) for path in files + pages for text in prose(path)]


def entries() -> list[str]:
    return re.findall(r"^- \*\*(.+?)\.\*\* ", PAGE.read_text(), re.M)


def test_every_source_that_is_cited_has_an_entry():
    known = set(entries())
    missing = {(str(path), found) for path, text in all_prose() for found in CITATION.findall(text)
               if found not in known}
    assert missing == set()


def test_every_entry_is_cited():
    assert set(entries()) - {found for _, text in all_prose() for found in CITATION.findall(text)} == set()


def test_entries_are_unique_and_in_alphabetical_order():
    found = entries()
    assert len(found) > 40 and found == sorted(set(found), key=str.lower)


def test_sources_are_cited_by_name_and_year_alone():
    other = {(str(path), found) for path, text in all_prose() if "docs" not in path.parts
             for found in OF_A_SOURCE.findall(CITATION.sub("", text))}
    assert other == set()


def test_a_citation_is_its_authors_and_year():
    text = ("As in Smith et al. 2019 and (Duff and Reid 1983; Liu 1992), by Coevoet 2017, eq. 4, "
            "(Hinton, Rock and Zienkiewicz 1976), with 2000 triangles.")
    assert CITATION.findall(text) == [
        "Smith et al. 2019", "Duff and Reid 1983", "Liu 1992", "Coevoet 2017",
        "Hinton, Rock and Zienkiewicz 1976"]
    assert OF_A_SOURCE.findall("(Bey, Grids, 1995), by Cowper (1966)") == [
        "(Bey, Grids, 1995)", "(1966)"]
