"""A soft column with four cables, small enough to be run as a command in a test."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import meshio
import pytest

from softrobot_twin.__main__ import main

ROOT = Path(__file__).parents[2]

_SCENE = """
name: column
gravity: [0.0, 0.0, -9.81]
body:
  mesh: {file: column.vtk}
  material: {law: corotational, young_modulus: 200.0e3, poisson_ratio: 0.4, density: 1070.0}
  fixed:
    - box: {minimum: [-1.0, -1.0, -0.001], maximum: [1.0, 1.0, 0.001]}
cables:
"""
_CABLE = """
  - name: %s
    pull_point: [%s, %s, -0.02]
    points: [[%s, %s, 0.05], [%s, %s, 0.10]]
    shortening: [0.0, 0.02]
    tension: [0.0, 10.0]
"""
_EFFECTOR = """
effectors:
  - name: tip
    points: [[0.01, 0.01, 0.10]]
"""


class Finished(NamedTuple):
    """A command that has ended."""

    code: int
    output: str
    errors: str


@pytest.fixture(scope="session")
def column(tmp_path_factory, block) -> Path:
    """Scene file of a column, 20 × 20 × 100 mm, held at its foot."""
    folder = tmp_path_factory.mktemp("scene")
    mesh = block(size=(0.02, 0.02, 0.1), cells=(2, 2, 5), shake=0.0)
    meshio.Mesh(mesh.node_positions, [("tetra", mesh.tets)]).write(folder / "column.vtk")
    corners = {"a": (0.0, 0.0), "b": (0.02, 0.0), "c": (0.02, 0.02), "d": (0.0, 0.02)}
    cables = "".join(_CABLE % (name, *3 * corner) for name, corner in corners.items())
    scene = folder / "column.yaml"
    scene.write_text(_SCENE + cables + _EFFECTOR)
    return scene


@pytest.fixture
def command():
    """Runs ``python -m softrobot_twin`` as a user would, piped."""

    def run(*arguments) -> Finished:
        done = subprocess.run(
            [sys.executable, "-m", "softrobot_twin", *map(str, arguments)], cwd=ROOT,
            env=dict(os.environ), capture_output=True, text=True, timeout=120)
        return Finished(done.returncode, done.stdout, done.stderr)

    return run


@pytest.fixture
def call(capsys):
    """Runs the same command within this process, which is faster."""

    def run(*arguments) -> Finished:
        try:
            code = main([str(argument) for argument in arguments])
        except SystemExit as end:  # how argparse ends
            code = int(end.code or 0)
        told = capsys.readouterr()
        return Finished(code, told.out, told.err)

    return run
