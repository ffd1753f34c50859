"""The package and the tests do not get longer: ``tools/count_code.py`` and its limits."""

import re
import subprocess
from pathlib import Path

import pytest
from count_code import code_lines, count_all, read_limits, renew

ROOT = Path(__file__).resolve().parents[2]
LIMITS = "tools/code_limits.txt"
SLACK = 0.1
"""Share by which a room may have become shorter or longer than docs/architecture.md says."""


@pytest.fixture(scope="module")
def counts():
    return count_all(ROOT)


def test_docstrings_comments_blank_lines_and_imports_do_not_count(tmp_path):
    file = tmp_path / "one.py"
    file.write_text('"""Text.\n\nMore.\n"""\n\nimport re\n\n# A remark.\nX = (1,\n     2)\n')
    assert code_lines(file) == 2


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


def test_to_renew_writes_the_table_and_lowers_limits_but_raises_none(tmp_path):
    for name, lines in (("softrobot_twin/one.py", 3), ("softrobot_twin/room/two.py", 5), ("test/three.py", 7)):
        (file := tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        file.write_text("x = 1\n" * lines)
    (page := tmp_path / "docs" / "architecture.md").parent.mkdir()
    page.write_text("| room | files | code |\n|---|---|---|\n| old | 1 | 1 |\n\nMore.\n")
    (limits := tmp_path / LIMITS).parent.mkdir()
    limits.write_text("softrobot_twin 20\nsoftrobot_twin +2 for more\ntest 6\n")
    renew(tmp_path)
    assert limits.read_text() == "softrobot_twin 6\nsoftrobot_twin +2 for more\ntest 6\n"
    assert page.read_text() == ("| room | files | code |\n|---|---|---|\n| room | 1 | 5 | tests | 1 | 7 |\n"
                                "| others | 1 | 3 | whole package | 2 | 8 |\n\nMore.\n")  # fmt: skip
