"""How far pneumatic robots move over their range of pressures, against solids that are fine enough.

`python tools/pressure_ranges.py` solves all robots on fine meshes, in minutes, and writes
``docs/pressure_references.yaml``; with the argument ``errors`` it prints the table of docs/pneumatics.md
of the scenes against that file. Names of robots as further arguments choose some.

Each robot is driven by one chamber and by all, to quarters of its range. Errors are those of elements
and meshes alone: both have the same law, threads and weight. A reference is that of quadratic elements,
or the limit under refinement of `mesh_error.py`, from these and their cubic correction.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import yaml
from specimens import NotSolved

from softrobot_twin.analysis.mesh_error import ActuatorLoads, MeshErrorEstimator
from softrobot_twin.scene import Scene, scene_from_mapping
from softrobot_twin.scene.loading import read_yaml, written_out
from softrobot_twin.simulation import CommandSetpoints, Simulation, Status
from softrobot_twin.simulation.command import LONG
from softrobot_twin.study.bench_measurement import default_scene_path

FILE = Path(__file__).parents[1] / "docs" / "pressure_references.yaml"
SHARES = (0.25, 0.5, 0.75, 1.0)
"""Of the greatest pressure, or the greatest growth."""
MOST_STEPS = 8


class Inflated(NamedTuple):
    """A robot, and what its reference is solved with.

    Attributes:
        scene: Name of its scene.
        mesh: Mesh of the reference.
        ways: Which chambers are driven, by name, each of shape (cavity_count,).
        top: Greatest pressure [Pa], or growth [m³].
        is_limit: Whether the cubic correction is added. It is a linearization: with thin walls far from
            rest it is too large, and that of the Segment does not converge. There hexahedra and
            quadratic elements agree, within 1.5 % (PneuNet, 4195 nodes) and 4 % (Segment, 6677).
        only: Ending of the names of what is kept of the scene, where its parts do not touch.
    """

    scene: str
    mesh: str
    ways: dict[str, tuple[float, ...]]
    top: float
    is_limit: bool = True
    only: str = ""


ROBOTS = {
    "springy": Inflated("springy", "springy_1532.msh", {"the chamber": (1.0,)}, 8.0e-6),
    "pneunet": Inflated("pneunet_inverse", "pneunet_finger_1500.msh",
                        {"a finger": (1.0,)}, 50.0e3, is_limit=False, only="_0"),
    "segment": Inflated("segment", "segment_2300.msh",
                        {"one chamber": (1.0, 0.0, 0.0, 0.0), "all": (1.0,) * 4}, 10.0e3, is_limit=False),
    "fetch": Inflated("fetch", "fetch_5152.msh",
                      {"two chambers": (1.0, 0.0, 0.0) * 2, "all": (1.0,) * 6}, 2.5e3),
}  # fmt: skip
"""The robots, by name."""


def scene_of(robot: Inflated, mesh: str = "") -> Scene:
    """The scene of a robot, without rates, solved to its tolerance.

    Args:
        robot: The robot.
        mesh: Mesh of its bodies, which then have quadratic elements; empty for those of the scene.
    """
    path = default_scene_path().with_name(f"{robot.scene}.yaml")
    text = path.read_text()
    mapping = written_out(read_yaml(re.sub(r"\w+_\d+\.msh", mesh, text) if mesh else text))
    mapping.setdefault("solver", {}).update(newton_iterations=15, residual_tolerance=1.0e-6)
    for section in ("bodies", "cavities", "effectors") if robot.only else ():
        mapping[section] = [one for one in mapping[section] if one["name"].endswith(robot.only)]
    for cavity in mapping["cavities"]:
        cavity.pop("rate", None)
    for body in mapping.get("bodies") or [mapping["body"]] if mesh else ():
        body["element"] = "quadratic"
    return scene_from_mapping(mapping, path)


def moves_of(simulation: Simulation, way: tuple[float, ...], top: float) -> np.ndarray:
    """How far the effector moves from where it hangs without pressure [m].

    Args:
        simulation: The robot; at rest afterwards.
        way: Share of each chamber.
        top: Greatest pressure [Pa], or growth [m³].

    Returns:
        A row for each of `SHARES`; NaN where no balance was found, shape (4, 3).
    """
    places, rest = [], np.array(simulation.rest_setpoints)
    for share in (0.0, *SHARES):
        for _ in range(MOST_STEPS):
            result = simulation.step(CommandSetpoints(rest + share * top * np.array(way), LONG))
            if result.status is Status.OK:
                break
        is_there = result.status in (Status.OK, Status.LINEARIZED)
        places.append(result.effector_positions[0] if is_there else np.full(3, np.nan))
    simulation.reset()
    return np.array(places[1:]) - places[0]


def limits_of(
    estimator: MeshErrorEstimator, rest: np.ndarray, way: tuple[float, ...], top: float
) -> np.ndarray:
    """The same in the limit under refinement; see `moves_of`.

    Args:
        estimator: Of the robot on its fine mesh.
        rest: Setpoints at rest, shape (cavity_count,).
        way: Share of each chamber.
        top: Greatest pressure [Pa], or growth [m³].

    Raises:
        NotSolved: A state has no balance.
    """
    places = []
    for share in (0.0, *SHARES):
        asked = ActuatorLoads(False, rest + share * top * np.array(way), {})
        place = estimator.limit_at(asked)
        if place is None:
            raise NotSolved(f"no balance at {share:g} of the range")
        places.append(place[0])
    return np.array(places[1:]) - places[0]


def read_references() -> dict:
    """The entries of the file, by robot and way."""
    return yaml.safe_load(FILE.read_text()) if FILE.is_file() else {}


def write_reference(name: str) -> None:
    """Solves a robot on its fine mesh and keeps it in the file.

    Args:
        name: The robot.
    """
    robot = ROBOTS[name]
    scene = scene_of(robot, robot.mesh)
    simulation = Simulation(scene, with_warnings=False)
    solve = partial(moves_of, simulation)
    if robot.is_limit:
        solve = partial(limits_of, MeshErrorEstimator(scene), simulation.rest_setpoints)
    found = {way: np.round(solve(shares, robot.top), 7).tolist() for way, shares in robot.ways.items()}
    entries = read_references() | {name: {"mesh": robot.mesh, **found}}
    FILE.write_text(yaml.safe_dump(entries, sort_keys=True, default_flow_style=None))
    print(name, found, flush=True)


def errors_of(name: str, way: str) -> np.ndarray:
    """Error of a scene at each of `SHARES`, by how far its reference moves, shape (4,).

    Args:
        name: The robot.
        way: Which chambers are driven.
    """
    robot, known = ROBOTS[name], np.array(read_references()[name][way])
    found = moves_of(Simulation(scene_of(robot), with_warnings=False), robot.ways[way], robot.top)
    return np.linalg.norm(found - known, axis=1) / np.linalg.norm(known, axis=1)


def error_lines(names: list[str]) -> Iterator[str]:
    """A table of the errors of scenes against the file.

    Args:
        names: The robots.
    """
    yield "| robot | driven | reference | a quarter | half | three quarters | the whole range |"
    yield "|---|---|---|---|---|---|---|"
    for name in names:
        robot = ROBOTS[name]
        for way in robot.ways:
            told = " | ".join(f"{100.0 * error:.2g} %" for error in errors_of(name, way))
            yield f"| {name} | {way} | {robot.mesh} | {told} |"


def main() -> None:
    """Write the file, or print the table of errors; further arguments name robots."""
    names = [name for name in sys.argv[1:] if name in ROBOTS] or list(ROBOTS)
    if "errors" in sys.argv[1:]:
        for line in error_lines(names):
            print(line, flush=True)
        return
    for name in names:
        write_reference(name)


if __name__ == "__main__":
    main()
