"""The command line without a scene: help, errors and exit codes."""

import os
import shlex
import subprocess
import sys

import pytest

from softrobot_twin.__main__ import main
from softrobot_twin.command_line.commands import COMMANDS, program
from test.places import ROOT


def examples() -> list[str]:
    """The examples of all help texts, out of the files of what is printed."""
    helps = [file.read_text() for file in sorted((ROOT / "test/study/print_outs").glob("*.txt"))]
    told = "".join(text.partition("examples:\n")[2].partition("exit codes:")[0] for text in helps)
    return told.replace("\\\n", "").splitlines()


def test_every_command_has_an_example_of_its_help():
    named = {command.__name__.replace("_", "-") for command in COMMANDS}
    assert {example.split()[1] for example in examples()} == named


@pytest.mark.parametrize("example", examples())
def test_every_example_of_the_help_is_understood_and_its_inputs_exist(example):
    arguments = shlex.split(example.partition(" > ")[0])[1:]
    shipped = [text for text in arguments if text.startswith(("config/", "meshes/"))]
    assert all((ROOT / text).is_file() for text in shipped)
    assert program("softrobot_twin").parse_args(arguments).command == arguments[0]


@pytest.mark.parametrize("arguments", [["plot", "--help"], ["simulate", "none.yaml"]])
def test_help_and_a_mistyped_argument_do_not_wait_for_the_simulation(arguments):
    code = ("import sys\n"
            "from softrobot_twin.__main__ import main\n"
            "try: main(sys.argv[1:])\n"
            "finally: print('loaded', *sys.modules, file=sys.stderr)")
    done = subprocess.run([sys.executable, "-c", code, *arguments], cwd=ROOT, capture_output=True,
                          text=True, timeout=120)
    loaded = set(done.stderr.partition("loaded ")[2].split())
    assert "softrobot_twin.command_line.commands" in loaded
    assert not loaded & {"numpy", "numba", "pydantic", "softrobot_twin.simulation"}


@pytest.mark.parametrize("command", ["explain", "simulate", "workspace", "bench", "accuracy", "choose"])
@pytest.mark.parametrize("content", [None, b"", b"- 1", b"\tname: a", b"name: a\nname: b", b"\xff"])
def test_an_invalid_scene_gives_one_line_and_exit_code_two(tmp_path, capsys, command, content):
    scene = tmp_path / "scene.yaml"
    if content is not None:
        scene.write_bytes(content)
    more = {"simulate": ["--steps", "2", "--output", str(tmp_path / "run.csv")],
            "choose": ["--rate", "100"],
            "workspace": ["--output", str(tmp_path / "run.csv")]}
    assert main([command, str(scene), *more.get(command, [])]) == 2
    told = capsys.readouterr()
    assert len(told.err.splitlines()) == 1 and str(scene) in told.err
    assert [path.name for path in tmp_path.iterdir()] == ["scene.yaml"] * (content is not None)


THREADS = """
import ctypes
lines = open("/proc/self/maps").read().splitlines()
for path in {line.split()[-1] for line in lines if "openblas" in line}:
    library = ctypes.CDLL(path)
    for name in [kind + "openblas_get_num_threads" + end for kind in ("scipy_", "") for end in ("64_", "")]:
        if hasattr(library, name): print(getattr(library, name)())
"""


@pytest.mark.parametrize("order", ["softrobot_twin.mechanics.gravity, numpy, scipy.linalg",
                                   "numpy, scipy.linalg, softrobot_twin"])
def test_products_take_one_thread_whether_numpy_or_the_package_is_imported_first(order):
    environment = {key: value for key, value in os.environ.items() if key != "OPENBLAS_NUM_THREADS"}
    done = subprocess.run([sys.executable, "-c", f"import {order}\n{THREADS}"], cwd=ROOT, env=environment,
                          capture_output=True, text=True, check=True)
    assert set(done.stdout.split()) == {"1"}
