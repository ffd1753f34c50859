"""A pad pressed on a cube, and commands run as a user runs them or within this process."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import meshio
import pytest

from softrobot_twin.__main__ import main
from test.builder import builder
from test.places import ROOT
from test.scene_changes import yaml_file


_PRESS_SCENE = """
name: stamp
gravity: [0.0, 0.0, -9.81]
integration: dynamic
bodies:
  - name: pad
    mesh: {file: pad.vtk, translation: [-0.02, -0.02, 0.031]}
    element: linear
    material: {law: corotational, young_modulus: 50.0e3, poisson_ratio: 0.3, density: 1000.0}
    damping: {mass: 20.0}
    attached:
      - {to: press, box: {minimum: [-1.0, -1.0, 0.0509], maximum: [1.0, 1.0, 0.0511]}}
rigid_bodies:
  - {name: press, motion: guided, box: {size: [0.04, 0.04, 0.01], centre: [0.0, 0.0, 0.056]}}
  - {name: cube, mass: 0.05, position: [0.0, 0.0, 0.015], box: {size: [0.03, 0.03, 0.03]}}
obstacles:
  - {name: floor, plane: {normal: [0.0, 0.0, 1.0]}}
contact:
  alarm_distance: 0.003
  friction: 0.5
  between:
    - {pair: [pad, cube]}
    - {pair: [cube, floor]}
"""
_STAMPING = """time_s,press_x_m,press_y_m,press_z_m
0.0,0.0,0.0,0.0
0.1,0.0,0.0,0.0
0.2,0.0,0.0,-0.003
0.5,0.0,0.0,-0.003
0.6,0.0,0.0,0.0
0.7,0.0,0.0,0.0
"""


class Finished(NamedTuple):
    """A command that has ended."""

    code: int
    output: str
    errors: str


@pytest.fixture(scope="session")
def stamp(tmp_path_factory, block) -> Path:
    """Scene file of a soft pad on a guided press above a free cube on a floor.

    Its commands file, ``stamping.csv``, is in the same folder.
    """
    folder = tmp_path_factory.mktemp("stamp")
    mesh = block(size=(0.04, 0.04, 0.02), cells=(2, 2, 1), shake=0.0)
    meshio.Mesh(mesh.node_positions, [("tetra", mesh.cells)]).write(folder / "pad.vtk")
    scene = folder / "stamp.yaml"
    scene.write_text(_PRESS_SCENE)
    (folder / "stamping.csv").write_text(_STAMPING)
    return scene


@pytest.fixture(scope="session")
def cantilever(tmp_path_factory) -> Path:
    """Scene file of a cantilever whose tip is pulled up by a cable."""
    return yaml_file(tmp_path_factory.mktemp("rod") / "rod.yaml", {
        "name": "cantilever", "gravity": [0.0, 0.0, -9.81],
        "beams": [{
            "name": "rod", "points": [[0, 0, 0], [0.2, 0, 0]], "elements": 2,
            "section": {"circle": {"radius": 0.004}}, "fixed": ["start"],
            "material": {"young_modulus": 1.0e8, "poisson_ratio": 0.4, "density": 1100.0}}],
        "effectors": [{"name": "tip", "body": "rod", "points": [[0.2, 0, 0]]}],
        "cables": [{"name": "up", "body": "rod", "pull_point": [0, 0, 0.2],
                    "points": [[0.2, 0, 0]], "tension": [0, 10]}]})


@builder
def command(*arguments) -> Finished:
    """Runs ``python -m softrobot_twin`` as a user would, piped."""
    done = subprocess.run(
        [sys.executable, "-m", "softrobot_twin", *map(str, arguments)], cwd=ROOT,
        env=dict(os.environ), capture_output=True, text=True, timeout=120)
    return Finished(done.returncode, done.stdout, done.stderr)


_HELD_RUN = """
import sys, time
from softrobot_twin.__main__ import main
from softrobot_twin.harness.sample_workers import LocalWorkers

run, held = LocalWorkers.run, int(sys.argv[1])

def run_and_hold(self, job, samples):
    for count, outcome in enumerate(run(self, job, samples)):
        if count == held:
            print("held", file=sys.stderr, flush=True)
            time.sleep(600.0)
        yield outcome

LocalWorkers.run = run_and_hold
sys.exit(main(sys.argv[2:]))
"""


@builder
def stop(*arguments, after: int) -> Finished:
    """Runs a command that computes samples in a process of its own, and stops it by Ctrl-C when so
    many samples are done: the run waits there for it, on any machine.
    """
    words = [sys.executable, "-c", _HELD_RUN, str(after), *map(str, arguments)]
    process = subprocess.Popen(words, cwd=ROOT, env=dict(os.environ), stdout=subprocess.DEVNULL,
                               stderr=subprocess.PIPE, text=True)
    told = []
    for line in process.stderr:
        told.append(line)
        if line.strip() == "held":
            process.send_signal(signal.SIGINT)
    return Finished(process.wait(timeout=60), "", "".join(told))


@builder
def call(capsys, /, *arguments, code: int | None = 0) -> Finished:
    """Runs the same command within this process, which is faster; it ends with this code, None for any."""
    try:
        ended = main([str(argument) for argument in arguments])
    except SystemExit as end:  # how argparse ends
        ended = int(end.code or 0)
    told = capsys.readouterr()
    assert code in (None, ended), told.err
    return Finished(ended, told.out, told.err)
