"""Error against time: every mesh, element and law against a reference that can be defended."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from softrobot_twin.simulation import Simulation
from softrobot_twin.study.accuracy.accuracy_error import AccuracyError
from softrobot_twin.study.accuracy.accuracy_row import MESH, AccuracyRow
from softrobot_twin.study.accuracy.load_cases import (
    Poses,
    prescribed_tensions,
    pull_poses,
    shortenings,
    wind_poses,
)
from softrobot_twin.study.accuracy.mesh_family import MeshLevel
from softrobot_twin.study.accuracy.moving_path import length_path, time_steps
from softrobot_twin.study.accuracy.only_body import only_body
from softrobot_twin.study.accuracy.richardson import Extrapolation, extrapolate
from softrobot_twin.study.accuracy.scene_variant import weightless, with_element, with_law

CASES = ("lengths", "tensions", "weightless")
"""Displacements prescribed, forces prescribed, displacements prescribed without gravity."""
RATE = 100.0
"""Rate of the moving path on which steps are timed [Hz]."""
ASYMPTOTIC = 2.25
"""Meshes up to so many times coarser than the finest serve the extrapolation."""
Tell = Callable[[str], None]


class Limits(NamedTuple):
    """How fine a study goes.

    Attributes:
        timed_dof: Most unknowns of a setting that is timed and judged.
        reference_dof: Most unknowns of a mesh that serves the reference only.
        timed_steps: Most steps a setting is timed over.
    """

    timed_dof: int = 60_000
    reference_dof: int = 200_000
    timed_steps: int = 200


class Reference(NamedTuple):
    """What the meshes are judged by, for one load case.

    Attributes:
        limit: Positions of the effectors that quadratic meshes tend to [m], and how surely.
        displacement: Root mean square of the effectors' way from rest [m].
        meshes: Meshes it was found from, the coarsest first.
    """

    limit: Extrapolation
    displacement: float
    meshes: tuple[str, ...]

    @property
    def uncertainty(self) -> float:
        """Relative to the displacement."""
        return self.limit.uncertainty / np.sqrt(_count(self.limit.value)) / self.displacement

    def error(self, poses: Poses) -> float:
        """Root mean square over poses and effectors, relative to the displacement."""
        apart = poses.positions - self.limit.value
        return float(np.linalg.norm(apart) / np.sqrt(_count(apart)) / self.displacement)


class Study(NamedTuple):
    """What was found.

    Attributes:
        rows: Mesh, element and law, each with its errors and its time.
        references: By load case.
    """

    rows: list[AccuracyRow]
    references: dict[str, Reference]


class _Loads(NamedTuple):
    wound: np.ndarray
    pulled: np.ndarray


def study_meshes(levels: list[MeshLevel], limits: Limits, tell: Tell) -> Study:
    """Judges every mesh with every element and law.

    Args:
        levels: Meshes, the coarsest first.
        limits: How fine to go.
        tell: Takes a line for each thing begun.

    Raises:
        AccuracyError: The scene moves no effector, or no reference was found.
    """
    name = levels[0].scene.name
    wound = shortenings(levels[0].scene)
    quadratic = [level._replace(scene=with_element(level.scene, "quadratic")) for level in levels]
    used = [level for level in quadratic if dof_count(level) <= limits.reference_dof]
    if len(used) < 2:
        raise AccuracyError(name, "a reference needs two quadratic meshes of at most "
                            f"{limits.reference_dof} dof; there are {len(used)}")
    loads, solved = _solve_reference(used, wound, tell)
    references = {case: _reference(name, case, used, solved) for case in CASES}
    rows = []
    for law in ("corotational", "linear"):
        for level in [*levels, *quadratic]:
            if dof_count(level) > limits.timed_dof:
                continue
            known = solved.get(level.name) if law == "corotational" and level in used else None
            rows.append(_judge(level, law, loads, references, known, limits.timed_steps, tell))
    return Study(rows, references)


def dof_count(level: MeshLevel) -> int:
    """Unknowns, without building all of a simulation."""
    return 3 * int(np.count_nonzero(~only_body(level.scene).fixed))


def _solve_reference(
    used: list[MeshLevel], wound: np.ndarray, tell: Tell
) -> tuple[_Loads, dict[str, dict[str, Poses]]]:
    """Equilibria on the quadratic meshes; the finest says which tensions are prescribed."""
    solved: dict[str, dict[str, Poses]] = {}
    loads = None
    for level in reversed(used):
        tell(f"reference: {level.name}, quadratic")
        lengths = wind_poses(level.scene, wound)
        if loads is None:
            loads = _Loads(wound, prescribed_tensions(level.scene, lengths.tensions))
        solved[level.name] = {"lengths": lengths, **_other_cases(level.scene, loads)}
    return loads, solved


def _other_cases(scene, loads: _Loads) -> dict[str, Poses]:
    return {"tensions": pull_poses(scene, loads.pulled),
            "weightless": wind_poses(weightless(scene), loads.wound)}


def _reference(name: str, case: str, used: list[MeshLevel], solved) -> Reference:
    good = [level for level in used if solved[level.name][case].found]
    if len(good) < 2:
        raise AccuracyError(name, f"no reference for prescribed {case}: Newton's iterations "
                            "converged on fewer than two quadratic meshes")
    asymptotic = [level for level in good if level.size <= ASYMPTOTIC * good[-1].size]
    good = asymptotic if len(asymptotic) > 2 else good[-3:]
    limit = extrapolate([level.size for level in good],
                        [solved[level.name][case].positions for level in good])
    way = limit.value - solved[good[-1].name][case].rest
    displacement = float(np.linalg.norm(way) / np.sqrt(_count(way)))
    return Reference(limit, displacement, tuple(level.name for level in good))


def _judge(level, law, loads, references, known, timed_steps, tell) -> AccuracyRow:
    element = level.scene.body.element
    tell(f"{level.name}, {element}, {law} law")
    scene = with_law(level.scene, law)
    solved = known or {"lengths": wind_poses(scene, loads.wound), **_other_cases(scene, loads)}
    times = time_steps(scene, length_path(scene, RATE, timed_steps), 1)
    simulation = Simulation(scene)
    errors = {f"error_{case}": references[case].error(solved[case]) for case in CASES}
    doubts = {f"uncertainty_{case}": references[case].uncertainty for case in CASES}
    return AccuracyRow(
        MESH, f"{element}, {law}", level.name, element, law, simulation.node_count,
        simulation.dof_count, 1e3 * times.median, 1e3 * times.p99, **errors, **doubts,
        displacement_mm=1e3 * references["lengths"].displacement)


def _count(positions: np.ndarray) -> int:
    """Points whose squares are averaged."""
    return int(np.prod(positions.shape[:-1]))
