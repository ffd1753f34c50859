"""``tools/count_code.py`` counts lines of code, and docs/architecture.md tells the counts of all rooms."""

import re
from pathlib import Path

import pytest
from count_code import Count, code_lines, count_rooms

ROOT = Path(__file__).resolve().parents[2]
SLACK = 80
"""Lines of code by which a room may have become shorter than the page says."""


def test_docstrings_comments_blank_lines_and_imports_do_not_count(tmp_path):
    file = tmp_path / "one.py"
    file.write_text('"""Text.\n\nMore.\n"""\n\nimport re\n\n# A remark.\nX = (1,\n     2)\n')
    assert code_lines(file) == 2


def _sum(rooms):
    return Count(*map(sum, zip(*rooms.values(), strict=True)))


@pytest.mark.exhaustive
def test_the_page_tells_the_size_of_each_room_and_none_grows_unnoticed():
    page = (ROOT / "docs" / "architecture.md").read_text()
    told = {name: Count(int(files), int(lines.replace(",", ""))) for name, files, lines in re.findall(
        r"\| ([\w ]+) \| (\d+) \| ([\d,]+) (?=\| [\d,]+ \|)", page)}  # fmt: skip
    found = count_rooms(ROOT / "softrobot_twin")
    whole, others = _sum(found), found.pop(".")
    tests = _sum(count_rooms(ROOT / "test"))
    found |= {"whole package": whole, "others": others, "tests": tests}
    assert set(told) == set(found)
    others = {name: (count, told[name]) for name, count in found.items()
              if not told[name].lines - SLACK <= count.lines <= told[name].lines}
    assert not others, f"found, and what docs/architecture.md says: {others}"
