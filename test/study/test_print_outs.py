"""What each command prints, whole: one file a command, which holds what is typed as well.

A line that begins with ``$`` is typed, in a folder with the files of ``inputs``; below it is
what is printed, then what is told beside it, then the exit code if it is not 0. With
``RENEW_PRINT_OUTS=1`` in the environment the test writes the files again: look at their difference.
"""

import os
import re
import shlex
import shutil
from pathlib import Path

import pytest

from softrobot_twin.command_line.commands import COMMANDS
from test.cad_parts import box, finger, need_gmsh, write_stl
from test.run_files import TARGETS

ROOT, FILES = Path(__file__).parents[2], Path(__file__).parent / "print_outs"
NAMES = ("softrobot_twin", *(command.__name__.replace("_", "-") for command in COMMANDS))
NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
# Times, shares (some are of times), what another processor or a busy machine changes, the usage
# before an error, which a file holds already, and spaces that align.
MASKS = (
    (" +", " "), (r"\s*\n\s*", "\n"),
    (r"[-\d.]+ (ms|µs|%|s in all)(?!\w)", r"# \1"), (r"(of the training) \d+ s$", r"\1 #"),
    (r"(on this machine,) [\d.e+]+", r"\1 #"),
    (r"about [\d.]+ \w+ on this machine", "about # on this machine"),
    (r"^.* …$|^.*: \d+ of \d+.*$|^.*slowed this one down.*$", ""), (r"_[0-9a-f]{16}\.", "_#."),
    (r"^softrobot_twin \d[\d.]*$", "softrobot_twin #"), (r"(\+0\.00 mm) at [\d.]+ s", r"\1"),
    (r"(sum of magnitudes median) [\d.]+ N, max [\d.]+ N", r"\1 #"),
    (r"^(quadrature points \d+|spare modes, .* \d+,|linearizations for a state) [\d.]+$", r"\1 #"),
    (r"[\d.]+ mm \(largest\)", "# mm (largest)"),
    (r"^(gravity|nothing) +-?\d\S* +-?\d\S* ", r"\1 # # "),
    (r"usage: [^\x00]*?\n(softrobot_twin.* error:)", r"\1"),
    (r"error of about [^\x00]*? a step;[^\x00]*? a step", lambda told: " ".join(told[0].split())),
    (r"\n+", "\n"),
)  # fmt: skip
MASKS_OF = {"bench": (
    (r"^.*; OPENBLAS_NUM_THREADS=1.*", "# OPENBLAS_NUM_THREADS=1 #"), (r"\d+\.\d+", "#"),
)}  # fmt: skip
"""Patterns of what a print-out is compared without, and what stands there instead."""


@pytest.fixture
def inputs(column, stamp, cantilever, tmp_path, monkeypatch):
    """Makes the folder that commands are typed in."""
    for scene in (column, stamp, cantilever):
        shutil.copytree(scene.parent, tmp_path, dirs_exist_ok=True)
    (tmp_path / "bare.yaml").write_text(column.read_text().partition("cables:")[0])
    (tmp_path / "targets.csv").write_text(TARGETS)
    grid = (ROOT / "test/conversion/scenes/grid.py").read_text()
    (tmp_path / "grid.py").write_text(grid + "    bar.addObject('ConstantForceField', totalForce=[0, 0, 1])\n")
    (tmp_path / "empty.scn").write_text("<Node/>")
    write_stl(tmp_path / "finger.stl", finger())
    write_stl(tmp_path / "cube.stl", box((20, 20, 20)))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", "cache")
    monkeypatch.setenv("COLUMNS", "100")
    monkeypatch.setattr("sys.argv", ["softrobot_twin"])  # else usage names how pytest was called


@pytest.mark.parametrize("name", [
    pytest.param(name, marks=[pytest.mark.exhaustive] * (name == "mesh")) for name in NAMES])
def test_a_command_prints_what_its_file_holds(name, inputs, tmp_path, call):
    """Numbers are equal to a part in a thousand, or to a unit of their last decimal."""
    if name in ("mesh", "init"):
        need_gmsh()

    def printed(line: str) -> str:
        done = call(*shlex.split(line)[2:], code=None)
        ended = f"exit code {done.code}\n" * (done.code != 0)
        text = f"{done.output}\n{done.errors}\n{ended}".replace(f"{tmp_path}/", "")
        for pattern, word in (*MASKS_OF.get(name, ()), *MASKS):
            text = re.sub(pattern, word, text, flags=re.MULTILINE)
        return f"{line}\n{text.lstrip()}"

    file = FILES / f"{name}.txt"
    wanted = file.read_text()
    found = "\n".join(printed(line) for line in wanted.splitlines() if line.startswith("$ "))
    if "RENEW_PRINT_OUTS" in os.environ:
        file.write_text(found)
    assert NUMBER.sub("0", found) == NUMBER.sub("0", wanted)
    for one, other in zip(NUMBER.findall(found), NUMBER.findall(wanted), strict=True):
        unit = 1.1 * 10.0 ** -len(other.partition(".")[2]) if "." in other else 0.0
        assert float(one) == pytest.approx(float(other), rel=1e-3, abs=max(unit, 1e-7)), other
