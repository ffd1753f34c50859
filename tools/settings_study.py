"""Error and time that other settings than the mesh add: linearizations, QP solvers, precision of the factor.

`python tools/settings_study.py SCENE` varies each alone on the scene's own mesh, and prints a table.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from softrobot_twin.errors import SoftRobotTwinError
from softrobot_twin.harness.machine_facts import NUMERICAL_LIBRARIES, describe_machine
from softrobot_twin.harness.terminal import console, table
from softrobot_twin.scene import Scene, load_scene
from softrobot_twin.scene.scene_changes import without_reductions
from softrobot_twin.simulation import FollowTargets, Simulation
from softrobot_twin.solvers.quadratic_program import DAQPSolver
from softrobot_twin.solvers.superlu import OPTIONS, SuperLU
from softrobot_twin.study.accuracy_study import (
    RATE,
    FollowedPath,
    check_one_body,
    follow,
    follow_exactly,
    follow_lengths,
    length_path,
    mean_distance,
    ready_simulation,
    with_hold_radius,
)


class _RoundedSolve:
    """Solves in single precision and returns double precision."""

    def __init__(self, factor):
        self._factor = factor

    def solve(self, right: np.ndarray) -> np.ndarray:
        return self._factor.solve(right.astype(np.float32)).astype(np.float64)


class SingleSuperLU(SuperLU):
    """SuperLU with factor and solves in float32 and everything else in double precision."""

    name = "SuperLU, single precision"

    def factor(self) -> bool:
        """See `Factorization.factor`; positive pivots show definiteness."""
        if not np.all(np.isfinite(self.storage)):
            return False
        try:
            lu = splu(sp.csc_matrix(self.matrix().astype(np.float32)), **OPTIONS)
        except RuntimeError:  # exactly singular
            return False
        self._lu = _RoundedSolve(lu)
        return np.array_equal(lu.perm_r, lu.perm_c) and bool(np.all(lu.U.diagonal() > 0.0))


STEPS = 100
ITERATIONS = (1, 2, 3)
# With this tolerance DAQP's solution is exact up to rounding.
_EXACT_QP = 1.0e-12


class SettingError(NamedTuple):
    """What a setting adds.

    Attributes:
        varied: Kind of setting.
        setting: Its value.
        step: Median time of a step [s].
        error: Added error, by the displacement of the effectors from rest along the path.
    """

    varied: str
    setting: str
    step: float
    error: float


def vary_settings(scene: Scene, step_count: int = STEPS) -> Iterator[SettingError]:
    """Added error and time of each setting, varied alone.

    Args:
        scene: The scene on its own mesh.
        step_count: Number of steps of the path.
    """
    path = length_path(scene, RATE, step_count)
    targets, start = follow_exactly(scene, path)
    displacement = mean_distance(targets - Simulation(scene).effector_positions())

    def row(varied: str, setting: str, followed: FollowedPath, exact: np.ndarray) -> SettingError:
        return SettingError(varied, setting, float(np.median(followed.times)),
                            mean_distance(followed.positions - exact) / displacement)

    def inverse(solver) -> FollowedPath:
        commands = [FollowTargets(target, path.time_step) for target in targets]
        simulation = ready_simulation(scene, 1, {})
        found_by = simulation.inverse.solver
        found_by.qp_solver, found_by.uses_warm_start = solver, False
        return follow(simulation, start, commands)

    direct = partial(follow_lengths, scene, path, start)
    for iterations in ITERATIONS:
        yield row("linearizations", str(iterations), direct(iterations), targets)
    double = direct(1, factorization_type=SuperLU)
    single = direct(1, factorization_type=SingleSuperLU)
    yield row("precision of the factor", "single, SuperLU", single, double.positions)
    # Double precision is compared with the other factorization, which rounds differently.
    yield row("precision of the factor", "double, SuperLU", double, direct(1).positions)
    exact = inverse(DAQPSolver(tolerance=_EXACT_QP)).positions
    yield row("QP solver", "DAQP", inverse(DAQPSolver()), exact)


def main(arguments: Sequence[str]) -> int:
    """Prints the table of a scene."""
    try:
        scene = without_reductions(load_scene(Path(arguments[0])))
        check_one_body(scene)
        console().print(describe_machine(NUMERICAL_LIBRARIES) + "\n")
        console().print(table(
            f"{scene.name}: error added on its own mesh, at {RATE:g} Hz", "varied", "setting", "step [ms]",
            "added error [%]",
            rows=([row.varied, row.setting, f"{1e3 * row.step:.2f}", f"{100.0 * row.error:.2g}"]
                  for row in vary_settings(with_hold_radius(scene)))))
    except SoftRobotTwinError as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
