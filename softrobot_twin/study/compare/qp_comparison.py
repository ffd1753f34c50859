"""QP solvers compared on inverse problems, in time and in accuracy."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from time import perf_counter
from typing import NamedTuple

import numpy as np

from softrobot_twin.solvers.quadratic_program import DAQPSolver, OSQPSolver, QPSolution, WhitenedQP
from softrobot_twin.study.bench.size_measurement import without_garbage_collection
from softrobot_twin.study.compare.exact_qp import exact_multipliers
from softrobot_twin.study.compare.qp_problems import ProblemSet
from softrobot_twin.study.offline.run_summary import Spread, spread


class InTurn:
    """OSQP, and DAQP where it reaches its iteration limit: the default where the warm start is not
    enough."""

    def __init__(self):
        self._solvers = (OSQPSolver(), DAQPSolver())

    def solve(self, problem: WhitenedQP) -> QPSolution:
        """The first answer that can be trusted."""
        for solver in self._solvers:
            solution = solver.solve(problem)
            if solution.solved:
                break
        return solution


AS_SHIPPED, OSQP = "OSQP 1e-8, then DAQP 1e-9 (default)", "OSQP 1e-8"
DAQP, TIGHT_DAQP = "DAQP 1e-6", "DAQP 1e-9"
QP_SOLVERS: dict[str, Callable[[], object]] = {
    "OSQP 1e-3": lambda: OSQPSolver(tolerance=1e-3),
    "OSQP 1e-5": lambda: OSQPSolver(tolerance=1e-5),
    OSQP: lambda: OSQPSolver(tolerance=1e-8),
    DAQP: lambda: DAQPSolver(tolerance=1e-6),
    TIGHT_DAQP: lambda: DAQPSolver(tolerance=1e-9),
    AS_SHIPPED: InTurn,
}


class QPFigures(NamedTuple):
    """What one solver did on one set of problems.

    Attributes:
        problems: Name of the set.
        count: Unknowns.
        solver: Name of the solver.
        time: Time of a solve, solved or not, through our interface [s].
        solved_share: Share of problems that it answered.
        median_error: Largest error of λ of a problem, in shares of its largest λ; median over
            the problems answered.
        worst_error: The largest of these.
        judged: Problems with an exact answer to compare with.
        posed: Problems of the set.
    """

    problems: str
    count: int
    solver: str
    time: Spread
    solved_share: float
    median_error: float
    worst_error: float
    judged: int
    posed: int


def compare_qp_solvers(sets: Sequence[ProblemSet]) -> list[QPFigures]:
    """Gives all problems to all solvers."""
    figures = []
    for problems in sets:
        exact = [[exact_multipliers(problem) for problem in sequence]
                 for sequence in problems.sequences]
        for name, make in QP_SOLVERS.items():
            with without_garbage_collection():
                figures.append(_figures(problems, name, make, exact))
    return figures


def _figures(problems: ProblemSet, name: str, make, exact) -> QPFigures:
    times, solved, errors = [], [], []
    for sequence, answers in zip(problems.sequences, exact, strict=True):
        solver = make()
        # The first sets up what later ones update; it is no step's time.
        solver.solve(sequence[0])
        for problem, answer in zip(sequence, answers, strict=True):
            start = perf_counter()
            solution = solver.solve(problem)
            times.append(perf_counter() - start)
            solved.append(solution.solved)
            if solution.solved and answer is not None:
                errors.append(_error(solution.unknowns, answer))
    judged = sum(answer is not None for answers in exact for answer in answers)
    found = spread(np.array(errors))
    return QPFigures(problems.name, problems.count, name, spread(np.array(times)),
                     float(np.mean(solved)), found.median, found.maximum, judged, len(times))


def _error(multipliers: np.ndarray, exact: np.ndarray) -> float:
    largest = np.abs(exact).max()
    return float(np.abs(multipliers - exact).max() / (largest if largest > 0.0 else 1.0))
