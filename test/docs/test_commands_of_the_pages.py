"""The command lines that README and the pages of docs/ show can be given as they stand there."""

import ast
import re
import shlex
from typing import NamedTuple

import pytest

from softrobot_twin.command_line.commands import NODES, program
from softrobot_twin.ros.demo import demo_robots
from softrobot_twin.ros.parameters import ALL_TABLES
from test.places import ROOT

PARAMETERS = {entry.name for table in ALL_TABLES for entry in table} | {"use_sim_time"}
TARGETS = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.M))


class Line(NamedTuple):
    """A command line.

    Attributes:
        page: The page that shows it.
        words: Its words, without comments and where its output goes.
    """

    page: str
    words: tuple[str, ...]


def lines() -> list[Line]:
    """All command lines of all pages."""
    found = []
    for path in [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]:
        for block in re.findall(r"^```sh\n(.*?)^```", path.read_text(), re.M | re.S):
            for text in re.sub(r"\\\n\s*", "", block).splitlines():
                words = tuple(shlex.split(re.split(r" [>|] ", text)[0], comments=True))
                if words:
                    found.append(Line(path.name, words))
    return found


LINES = lines()


def of(*beginning: str) -> list[Line]:
    """Lines that begin with these words."""
    return [line for line in LINES if line.words[: len(beginning)] == beginning]


def shown(line: Line) -> str:
    """A name of a test."""
    return f"{line.page}: {' '.join(line.words)[:60]}"


OURS = [line for line in of("softrobot_twin") if "[options]" not in line.words]


@pytest.mark.parametrize("line", OURS, ids=shown)
def test_a_command_of_the_package_can_be_given(line, capsys):
    try:
        program("softrobot_twin").parse_args(line.words[1:])
    except SystemExit as ended:
        assert ended.code == 0, capsys.readouterr().err


@pytest.mark.parametrize("line", of("make"), ids=shown)
def test_a_target_of_make_and_its_robot_exist(line):
    for word in line.words[1:]:
        if word.startswith("ROBOT="):
            assert word.removeprefix("ROBOT=") in demo_robots()
        elif "=" not in word:
            assert word in TARGETS


def test_files_of_the_repository_in_command_lines_exist():
    files = {(line.page, word.removeprefix("$SHARE/")) for line in LINES for word in line.words
             if re.match(r"(\$SHARE/)?(config|meshes|tools|examples)/", word)}  # fmt: skip
    # What such a command writes is there where it was run.
    written = {line.words[index + 1] for line in LINES for index, word in enumerate(line.words)
               if word in ("--output", "--picture")}  # fmt: skip
    assert {(page, name) for page, name in files
            if name not in written and not (ROOT / name).exists()} == set()  # fmt: skip
    assert len(files) > 15


def test_nodes_and_parameters_in_command_lines_exist():
    nodes = of("ros2", "run", "softrobot_twin")
    assert {line.words[3] for line in nodes} == set(NODES)
    given = {name for line in nodes for name in re.findall(r"(\w+):=", " ".join(line.words))
             if name not in ("cmd_vel", "__ns")}  # fmt: skip
    set_later = {line.words[4] for line in of("ros2", "param", "set")}
    assert (given | set_later) - PARAMETERS == set()
    assert given and set_later


def test_launch_files_and_their_arguments_in_command_lines_exist():
    launched = of("ros2", "launch", "softrobot_twin")
    assert launched
    for line in launched:
        tree = ast.parse((ROOT / "launch" / line.words[3]).read_text())
        (table,) = (node.value for node in tree.body if isinstance(node, ast.Assign)
                    and node.targets[0].id == "ARGUMENTS")  # fmt: skip
        known = {name for name, _, _ in ast.literal_eval(table)} | {"--show-args"}
        assert {word.partition(":=")[0] for word in line.words[4:]} <= known
