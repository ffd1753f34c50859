"""The package and the tests do not get longer: ``tools/count_code.py`` and its limits."""

import re
import subprocess

import pytest
from count_code import count_all, read_limits, renew

from test.places import ROOT

LIMITS = "tools/code_limits.txt"
SLACK = 0.1
"""Share by which a room may have become shorter or longer than docs/architecture.md says."""


@pytest.fixture(scope="module")
def counts():
    return count_all(ROOT)


def test_the_package_and_the_tests_have_no_more_lines_than_they_may(counts):
    (limits, added), found = read_limits((ROOT / LIMITS).read_text()), counts[1]
    assert set(limits) == set(found)
    too_long = {folder: f"{lines} lines, and it may have {limits[folder] + added[folder]}"
                for folder, lines in found.items() if lines > limits[folder] + added[folder]}
    assert not too_long, f"remove lines, or say in {LIMITS} which issue may add them"


def test_no_limit_was_ever_lower():
    def git(*arguments):
        return subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True).stdout

    before = [git("show", f"{commit}:{LIMITS}") for commit in git("log", "--format=%h", "--", LIMITS).split()]
    if not before:
        pytest.skip("no history here")
    limits, _ = read_limits((ROOT / LIMITS).read_text())
    assert all(limits[folder] <= lines for text in before for folder, lines in read_limits(text)[0].items())


def test_the_table_of_rooms_is_about_right(counts):
    rows = re.findall(r"\| ([\w ]+) \| \d+ \| ([\d,]+) (?=\|)", (ROOT / "docs" / "architecture.md").read_text())
    told, found = {name: int(lines.replace(",", "")) for name, lines in rows}, counts[0]
    assert set(told) == set(found)
    off = {name: (told[name], count.lines) for name, count in found.items()
           if abs(told[name] - count.lines) > SLACK * count.lines}
    assert not off, "run: python3 tools/count_code.py --renew"
