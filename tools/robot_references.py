"""How far shipped robots move on meshes that are fine enough: what errors are measured against.

`python tools/robot_references.py` solves all robots on their finest meshes and writes
``docs/references.yaml``, in minutes; with the argument ``errors`` it prints a table of the errors of
coarser meshes against that file.

A reference is the limit under refinement of `mesh_error.py`, from quadratic elements and their cubic
correction, with cables on patches: at single points nothing converges. Its uncertainty is the
distance from the same limit on the next coarser mesh, whose facets are others, and half of what was
extrapolated.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from time import thread_time
from typing import NamedTuple

import numpy as np
import yaml

from softrobot_twin.analysis.mesh_error import (
    LEFT_OUT,
    LONG,
    ActuatorLoads,
    MeshErrorEstimator,
    Response,
    exact_simulation,
    response,
    solve_equilibrium,
    still,
    with_element,
)
from softrobot_twin.scene import Scene, scene_from_mapping
from softrobot_twin.scene.loading import read_yaml, written_out
from softrobot_twin.simulation import CommandSetpoints
from softrobot_twin.simulation.step.newton import Newton
from softrobot_twin.study.bench_measurement import default_scene_path

FILE = Path(__file__).parents[1] / "docs" / "references.yaml"
_DIGITS = 6


@dataclass(frozen=True)
class ReferenceCase:
    """A robot, and what is given to it.

    Attributes:
        scene: Name of its scene.
        fine: Its two finest meshes, the finest last.
        coarse: Meshes whose errors are told.
        probe: An effector in place of the scene's own; None to take those.
        moves: Change of each actuator's setpoint from rest in a state far from it [m, m³, Pa];
            empty for none.
    """

    scene: str
    fine: tuple[str, str]
    coarse: tuple[str, ...]
    probe: dict | None = None
    moves: tuple[float, ...] = ()


CASES = {
    "diamond": ReferenceCase(
        "diamond", ("diamond_2700.vtk", "diamond_4500.vtk"),
        ("diamond_200.vtk", "diamond_400.vtk", "diamond_600.vtk", "diamond_1000.vtk", "diamond_1600.vtk"),
        moves=(-0.012, 0.03, 0.03, 0.03),
    ),
    "trunk": ReferenceCase(
        "trunk", ("trunk_1600.vtk", "trunk_4000.vtk"),
        ("trunk_700.vtk", "trunk_900.vtk", "trunk_1600.vtk"),
    ),
    "springy": ReferenceCase(
        "springy", ("springy_1532.msh", "springy_4000.msh"),
        ("springy_400.msh", "springy_964.msh", "springy_1444.msh", "springy_1532.msh"),
    ),
    "octoleg": ReferenceCase(
        "octoleg", ("octoleg_400.vtk", "octoleg_1000.vtk"),
        ("octoleg_120.vtk", "octoleg_173.vtk", "octoleg_400.vtk", "octoleg_1000.vtk"),
        moves=(-0.01,),
    ),
    "grasper": ReferenceCase(
        "grasper", ("grasper_finger_400.vtk", "grasper_finger_1200.vtk"),
        ("grasper_finger_158.vtk", "grasper_finger_180.vtk", "grasper_finger_360.vtk",
         "grasper_finger_400.vtk", "grasper_finger_1200.vtk"),
        probe={"name": "tip", "body": "finger_0", "points": [[0.04505498, 0.0, -0.08582189]]},
    ),
    "pneunet": ReferenceCase(
        "pneunet_inverse", ("pneunet_finger_1000.msh", "pneunet_finger_1500.msh"),
        ("pneunet_finger_400.msh", "pneunet_finger_620.msh", "pneunet_finger_1000.msh", "pneunet_finger_1500.msh"),
    ),
    "segment": ReferenceCase(
        "segment", ("segment_2300.msh", "segment_4000.msh"),
        ("segment_1000.msh", "segment_1500.msh", "segment_2300.msh"),
    ),
    "fetch": ReferenceCase(
        "fetch", ("fetch_5152.msh", "fetch_5586.msh"),
        ("fetch_1500.msh", "fetch_3714.msh", "fetch_5152.msh", "fetch_5586.msh"),
    ),
    "finger": ReferenceCase("finger", ("finger_99.msh", "finger_195.msh"), ("finger_99.msh", "finger_195.msh")),
}  # fmt: skip
"""The robots, by name."""


class ReferenceErrors(NamedTuple):
    """Relative errors of the effectors' motion; the largest over actuators, each alone.

    Attributes:
        forces: At given forces and pressures, at rest.
        lengths: At given lengths and volumes, at rest.
        state: In the state far from rest; NaN where there is none or it was not found.
    """

    forces: float
    lengths: float
    state: float


def scene_of(case: ReferenceCase, mesh: str, element: str) -> Scene:
    """The scene of a robot with a mesh file, kinds of elements, and its probe.

    Args:
        case: The robot.
        mesh: Name of the file.
        element: Kind of its elements.
    """
    path = default_scene_path().with_name(f"{case.scene}.yaml")
    text = re.sub(r"[\w]+_\d+\.(vtk|msh)", mesh, path.read_text())
    mapping = written_out(read_yaml(text))
    if case.probe is not None:
        mapping["effectors"] = [case.probe]
        mapping.pop("markers", None)
    return still(with_element(scene_from_mapping(mapping, path), element))


class Limit(NamedTuple):
    """What a fine mesh tells.

    Attributes:
        by_effort: Motion of the effector rows by each actuator's effort [m/N, m/Pa],
            shape (actuator_count, effector_row_count).
        by_setpoint: By its displacement [m/m, m/m³], same shape.
        extrapolated: How much of both is extrapolated, as shares.
        moved: Motion of the effector rows in the state [m]; None for none.
    """

    by_effort: np.ndarray
    by_setpoint: np.ndarray
    extrapolated: tuple[float, float]
    moved: np.ndarray | None


def _columns(of: Response) -> tuple[np.ndarray, np.ndarray]:
    return of.W_ea.T, (of.W_ea / of.W_aa).T


def _apart(own: np.ndarray, best: np.ndarray) -> float:
    """The largest relative distance of rows; actuators that hardly move the effectors do not count.
    """
    sizes = np.linalg.norm(best, axis=1)
    counts = sizes > 0.02 * sizes.max()
    return float((np.linalg.norm(own - best, axis=1)[counts] / sizes[counts]).max())


def limit_of(case: ReferenceCase, mesh: str) -> Limit:
    """The limit under refinement, estimated on one mesh.

    Args:
        case: The robot.
        mesh: Name of the file.
    """
    scene = scene_of(case, mesh, "quadratic")
    estimator = MeshErrorEstimator(scene)
    _, quadratic, best = estimator.responses()
    exact, known, moved = _columns(best), _columns(quadratic), None
    extrapolated = [LEFT_OUT / (1.0 + LEFT_OUT) * _apart(*both)
                    for both in zip(known, exact, strict=True)]  # fmt: skip
    if case.moves:
        simulation = exact_simulation(scene, thread_time)
        asked = ActuatorLoads(False, np.array(simulation.rest_setpoints) + case.moves, {})
        limit = estimator.limit_at(asked)
        if limit is not None:
            moved = (limit - simulation.effector_positions()).ravel()
    return Limit(*exact, tuple(extrapolated), moved)


def reference_of(case: ReferenceCase) -> dict:
    """The entry of a robot in the file.

    Args:
        case: The robot.
    """
    coarser, finest = (limit_of(case, mesh) for mesh in case.fine)
    shares = [
        _apart(other, best) + 0.5 * extrapolated
        for other, best, extrapolated in zip(
            coarser[:2], finest[:2], finest.extrapolated, strict=True)
    ]  # fmt: skip
    entry = {
        "mesh": case.fine[1],
        "by_effort": _rounded(finest.by_effort), "by_effort_uncertainty": round(shares[0], 4),
        "by_setpoint": _rounded(finest.by_setpoint), "by_setpoint_uncertainty": round(shares[1], 4),
    }  # fmt: skip
    if finest.moved is not None and coarser.moved is not None:
        apart = np.linalg.norm(finest.moved - coarser.moved) / np.linalg.norm(finest.moved)
        entry |= {"moves": list(case.moves), "moved": _rounded(finest.moved),
                  "moved_uncertainty": round(float(apart), 4)}  # fmt: skip
    return entry


def _rounded(values: np.ndarray) -> list:
    scale = 10.0 ** (_DIGITS - np.floor(np.log10(np.abs(values).max())))
    return (np.round(values * scale) / scale).tolist()


def read_references() -> dict:
    """The entries of the file, by robot."""
    return yaml.safe_load(FILE.read_text())


def errors_of(name: str, mesh: str, element: str, reference: dict) -> ReferenceErrors:
    """Errors of a mesh of a robot against its reference.

    Args:
        name: The robot.
        mesh: Name of the file.
        element: Kind of its elements.
        reference: Its entry in the file.
    """
    case = CASES[name]
    simulation = exact_simulation(scene_of(case, mesh, element), thread_time)
    own = _columns(response(Newton(simulation.model), simulation.model))
    shares = [_apart(found, np.array(reference[key]))
              for found, key in zip(own, ("by_effort", "by_setpoint"), strict=True)]  # fmt: skip
    state = float("nan")
    if "moved" in reference:
        rest, moved = simulation.effector_positions().ravel(), np.array(reference["moved"])
        command = CommandSetpoints(np.array(simulation.rest_setpoints) + case.moves, LONG)
        if solve_equilibrium(simulation, command, {}):
            found = simulation.effector_positions().ravel() - rest
            state = float(np.linalg.norm(found - moved) / np.linalg.norm(moved))
    return ReferenceErrors(*shares, state)


def error_lines(names: list[str]) -> Iterator[str]:
    """A table of the errors of elements and meshes against the references.

    Args:
        names: The robots.
    """
    references = read_references()
    yield "| robot | mesh | element | forces given | lengths given | far from rest |"
    yield "|---|---|---|---|---|---|"
    for name in names:
        for mesh in CASES[name].coarse:
            for element in ("linear", "smoothed", "quadratic"):
                found = errors_of(name, mesh, element, references[name])
                told = " | ".join("" if one != one else f"{100.0 * one:.2g} %" for one in found)
                yield f"| {name} | {mesh} | {element} | {told} |"


def main() -> None:
    """Write the file, or print the table of errors; further arguments name robots."""
    asked = sys.argv[1:]
    names = [name for name in asked if name in CASES] or list(CASES)
    if "errors" in asked:
        for line in error_lines(names):
            print(line, flush=True)
        return
    for name in names:
        entry = reference_of(CASES[name])
        print(name, entry, flush=True)
        entries = (read_references() if FILE.is_file() else {}) | {name: entry}
        FILE.write_text(yaml.safe_dump(entries, sort_keys=True, default_flow_style=None))


if __name__ == "__main__":
    main()
