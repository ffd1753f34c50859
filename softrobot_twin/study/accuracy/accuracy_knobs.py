"""Knobs besides the mesh, each turned alone on the scene's own mesh along a moving path."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from softrobot_twin.scene import Scene
from softrobot_twin.simulation import Simulation
from softrobot_twin.solvers.quadratic_program import DAQPSolver, OSQPSolver
from softrobot_twin.solvers.superlu import SuperLU
from softrobot_twin.study.accuracy.accuracy_row import NEWTON, PRECISION, QP, AccuracyRow
from softrobot_twin.study.accuracy.accuracy_study import RATE
from softrobot_twin.study.accuracy.moving_path import (
    Followed,
    follow_exactly,
    follow_lengths,
    follow_targets,
    length_path,
)
from softrobot_twin.study.accuracy.single_precision import SingleSuperLU

ITERATIONS = (1, 2, 3)
QP_TOLERANCES = (1e-2, 1e-3, 1e-4, 1e-6, 1e-8)
# So tight that DAQP's answer is exact to rounding.
_EXACT_QP = 1.0e-12


def turn_knobs(scene: Scene, displacement: float, step_count: int) -> Iterator[AccuracyRow]:
    """What each knob adds to the error, and the time it takes.

    Args:
        scene: The scene on its own mesh.
        displacement: What errors are relative to [m].
        step_count: Steps of the path.
    """
    path = length_path(scene, RATE, step_count)
    targets, start = follow_exactly(scene, path)
    size = Simulation(scene)

    def row(knob: str, setting: str, followed: Followed, exact: np.ndarray) -> AccuracyRow:
        apart = np.linalg.norm(followed.positions - exact, axis=2)
        added = float(np.sqrt(np.mean(apart**2)) / displacement)
        return AccuracyRow(
            knob, setting, scene.mesh_path.stem, scene.body.element, scene.body.material.law,
            size.node_count, size.dof_count, 1e3 * followed.times.median,
            1e3 * followed.times.p99, error_added=added)

    for iterations in ITERATIONS:
        followed = follow_lengths(scene, path, start, iterations)
        yield row(NEWTON, f"{iterations} linearization{'s' * (iterations > 1)} at {RATE:g} Hz",
                  followed, targets)
    double = follow_lengths(scene, path, start, 1, factorization_type=SuperLU)
    for kind in (SingleSuperLU, SuperLU):
        followed = follow_lengths(scene, path, start, 1, factorization_type=kind)
        name = "single" if kind is SingleSuperLU else "double"
        # Double precision is judged by the other factorization, which rounds differently.
        against = double if kind is SingleSuperLU else follow_lengths(scene, path, start, 1)
        yield row(PRECISION, f"{name}, SuperLU", followed, against.positions)
    count = len(scene.cables)
    exact = follow_targets(scene, path, targets, start,
                           qp_solvers=(DAQPSolver(tolerance=_EXACT_QP),))
    for tolerance in QP_TOLERANCES:
        solver = OSQPSolver(tolerance)
        followed = follow_targets(scene, path, targets, start, qp_solvers=(solver,))
        yield row(QP, f"OSQP at {tolerance:g}", followed, exact.positions)
    followed = follow_targets(scene, path, targets, start, qp_solvers=(DAQPSolver(),))
    yield row(QP, "DAQP", followed, exact.positions)
