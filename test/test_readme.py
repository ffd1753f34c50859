"""The README: its code runs as it is written, its files exist, and it stays short."""

import csv
import re
import shlex

import pytest

from softrobot_twin.__main__ import main
from test.places import ROOT

TEXT = (ROOT / "README.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```(\w+)\n(.*?)^```$", TEXT, re.M | re.S)
PYTHON = [code for language, code in BLOCKS if language == "python"]
# Comments end a line, and a backslash joins it with the next.
SHELL = [line.partition("  # ")[0].strip() for language, code in BLOCKS if language == "sh"
         for line in code.replace("\\\n", " ").splitlines()]


@pytest.fixture
def clone(tmp_path, monkeypatch):
    """A folder that stands for a clone, without the sources: what a block writes stays in it."""
    pytest.importorskip("matplotlib").use("agg")
    for name in ("config", "meshes"):
        (tmp_path / name).symlink_to(ROOT / name)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_it_has_at_most_150_lines():
    assert len(TEXT.splitlines()) <= 150


def test_every_file_and_picture_that_it_links_exists():
    links = re.findall(r"\]\(([^)#]+)|src=\"([^\"]+)\"", TEXT)
    paths = [first or second for first, second in links]
    assert paths and [path for path in paths if not (ROOT / path).is_file()] == []


@pytest.mark.parametrize("code", PYTHON)
def test_its_python_runs_and_brings_the_tip_to_the_target(clone, code, capsys):
    assert len(code.splitlines()) <= 15
    exec(compile(code, "README.md", "exec"), {"__name__": "__main__"})
    told = capsys.readouterr().out
    x, z = map(float, re.search(r"tip=\[([-\d.]+), [-\d.]+, ([-\d.]+)\]", code).groups())
    ended = re.search(r"Status\.OK \[ *(\S+) +\S+ +([^\]\s]+) *\]", told)
    assert ended, told
    assert (float(ended[1]), float(ended[2])) == pytest.approx((x, z), abs=1e-4)
    assert (clone / "finger.png").stat().st_size > 10_000


@pytest.mark.exhaustive
def test_its_commands_run_one_after_the_other(clone, capsys):
    commands = [shlex.split(line) for line in SHELL if line.startswith("softrobot_twin ")]
    assert {command[1] for command in commands} == {"explain", "simulate", "plot"}
    for command in commands:
        assert main(command[1:]) == 0, capsys.readouterr().err
    written = {"explained.png", "finger.csv", "finger.png", "finger_plot.png"}
    assert written <= {file.name for file in clone.iterdir()}


def test_its_times_of_steps_are_those_of_the_bench():
    rows = csv.DictReader((ROOT / "docs/bench.csv").open())
    measured = {row["scene"].removesuffix("_reduced"): float(row["median_ms"]) for row in rows
                if row["stage"] == "whole step" and row["modes"] == ""}  # fmt: skip
    shown = re.findall(r"\| `(\w+)` \|.*\| ([\d.]+) ms \(", TEXT)
    assert len(shown) == 7 and len(measured.keys() & dict(shown).keys()) >= 6
    for robot, time in shown:
        if robot in measured:
            assert float(time) == pytest.approx(measured[robot], rel=0.04), robot
