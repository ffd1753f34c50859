"""Measures how condensing grows with the nodes that a row touches, and with the number of rows.

``python tools/measure_condensation.py`` inflates Springys of three meshes, whose one cavity is a
row that touches hundreds of nodes, then the same bodies pulled by a cable at a point, a row of four
nodes, and the Fetch with one, three and six cavities. Times are processor times of one thread.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from time import thread_time
from typing import NamedTuple

import numpy as np

from softrobot_twin.harness.terminal import console, table
from softrobot_twin.scene import scene_from_mapping
from softrobot_twin.simulation import CommandSetpoints, Simulation

MESHES = Path(__file__).resolve().parents[1] / "meshes"
SPRINGYS = ("springy_400", "springy_1532", "springy_4000")
FETCHES = ("fetch_1500", "fetch_5152")
CAVITY_COUNTS = (1, 3, 6)
FETCH_CAVITIES = tuple(f"cavity_{platform}_{leg}" for platform in (1, 2) for leg in "abc")
WARM_STEPS = 20
PRESSURE, PULL = 500.0, 5.0e-4
"""Mean pressure [Pa] and shortening [m]."""


class Measured(NamedTuple):
    """Times of a step of one linearization, medians.

    Attributes:
        mesh: Name of the mesh.
        unknowns: Number of unknowns.
        rows: Rows of H, and what they are.
        nodes: Most free nodes that a row touches.
        condense: Time to condense [s].
        factor: Time to factorize [s].
        step: Time of the whole step [s].
    """

    mesh: str
    unknowns: int
    rows: str
    nodes: int
    condense: float
    factor: float
    step: float


def _body(mesh: str, **actuators) -> dict:
    """A scene of silicone held at its foot."""
    return {
        "name": mesh,
        "body": {
            "mesh": {"file": f"{mesh}.msh"}, "element": "linear",
            "material": {"young_modulus": 5.0e4, "poisson_ratio": 0.3, "density": 1070.0},
            "fixed": [{"box": {"minimum": [-1, -1, -1], "maximum": [1, 1, 1e-4]}}],
        },
        **actuators,
    }  # fmt: skip


def inflated(mesh: str, cavities: tuple[str, ...]) -> dict:
    """A scene with cavities that are parts of its mesh."""
    return _body(mesh, cavities=[{"name": name, "walls": [{"part": name}]} for name in cavities])


def pulled(mesh: str) -> dict:
    """A scene with a cable to one point, 48 mm above its foot."""
    cable = {"name": "line", "pull_point": [0.0, 0.0, -0.01], "points": [[0.0, 0.0, 0.048]]}
    return _body(mesh, cables=[cable])


def measure(mapping: dict, steps: int) -> Measured:
    """Times the steps of a scene while its actuators oscillate a little.

    Args:
        mapping: The scene.
        steps: Number of timed steps.
    """
    simulation = Simulation(scene_from_mapping(mapping, MESHES / "scene.yaml"), thread_time)
    simulation.warm_up()
    actuators, times = simulation.actuators, []
    mean = np.where(actuators.is_effort_driven, PRESSURE, PULL)
    for number in range(WARM_STEPS + steps):
        drives = mean * (1.0 + 0.2 * np.sin(0.2 * number))
        report = simulation.step(CommandSetpoints(actuators.setpoints(drives), 0.02)).report
        stages = report.stage_times
        times.append((stages["condense"], stages["factor"], report.compute_time))
    (term,) = actuators.terms
    count = actuators.count
    return Measured(
        mapping["name"], simulation.dof_count,
        f"{count} {actuators.kinds[0].noun if count == 1 else actuators.kinds[0].section}",
        int(np.bincount(term.entry_rows).max()), *np.median(times[WARM_STEPS:], axis=0),
    )  # fmt: skip


def measure_all(steps: int, springys: tuple[str, ...], fetches: tuple[str, ...]) -> list[Measured]:
    """Times all scenes; see the module.

    Args:
        steps: Number of timed steps of each.
        springys: Names of the Springy's meshes.
        fetches: Names of the Fetch's meshes.
    """
    scenes = [make for mesh in springys for make in (pulled(mesh), inflated(mesh, ("cavity",)))]
    scenes += [inflated(mesh, FETCH_CAVITIES[:count])
               for mesh in fetches for count in CAVITY_COUNTS]  # fmt: skip
    return [measure(scene, steps) for scene in scenes]


def main() -> int:
    """Measures and prints the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--steps", type=int, default=200, metavar="N", help="timed steps of each")
    steps = parser.parse_args().steps
    made = table("Times in ms, medians", "mesh", "unknowns", "rows of H", "nodes a row touches",
                 "condense", "factor", "whole step")  # fmt: skip
    for one in measure_all(steps, SPRINGYS, FETCHES):
        times = (f"{1e3 * time:.2f}" for time in (one.condense, one.factor, one.step))
        made.add_row(one.mesh, str(one.unknowns), one.rows, str(one.nodes), *times)
    console().print(made)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
