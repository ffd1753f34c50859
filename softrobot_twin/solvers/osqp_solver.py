"""The inverse QP solved by OSQP, set up once and updated each step."""

from __future__ import annotations

import numpy as np
import osqp
import scipy.sparse as sp

from softrobot_twin.solvers.inverse_qp import WhitenedQP
from softrobot_twin.solvers.qp_solution import QPSolution

INFINITY = 1.0e20
TOLERANCE = 1.0e-8
SETTINGS = {
    "verbose": False,
    # Where rows of C are nearly parallel, splitting methods crawl; the caller has another way then.
    "max_iter": 1000,
    # The problem comes scaled.
    "scaling": 0,
    # Counted in iterations, never in seconds: the same input gives the same bits.
    "adaptive_rho_interval": 25,
}


class OSQPSolver:
    """Keeps one OSQP workspace for problems of one size."""

    name = "OSQP"

    def __init__(self, count: int, tolerance: float = TOLERANCE):
        """Remember the size; the workspace is laid out by the first problem.

        Args:
            count: Number of unknowns n.
            tolerance: Residual, absolute and relative, at which the problem counts as solved.
        """
        self._count = count
        self._tolerance = tolerance
        self.reset()

    def reset(self) -> None:
        """Forget the last solution, so that a run can be repeated to the bit."""
        self._solver = None

    def solve(self, problem: WhitenedQP) -> QPSolution:
        """Solve one problem, warm-started from the last.

        Args:
            problem: The whitened QP.

        Returns:
            λ in newtons, and whether it can be trusted.
        """
        lower = np.maximum(problem.lower, -INFINITY)
        upper = np.minimum(problem.upper, INFINITY)
        if self._solver is None:
            self._set_up(problem, lower, upper)
        else:
            # Column by column, as a sparse matrix with every entry present stores it.
            self._solver.update(q=problem.q, l=lower, u=upper, Ax=problem.C.T.ravel())
        answer = self._solver.solve(raise_error=False)
        solved = answer.info.status == "solved" and bool(np.all(np.isfinite(answer.x)))
        multipliers = problem.T @ answer.x if solved else np.full(self._count, np.nan)
        return QPSolution(
            multipliers, np.array(answer.y), solved, answer.info.iter, answer.info.status,
            self.name,
        )  # fmt: skip

    def _set_up(self, problem: WhitenedQP, lower: np.ndarray, upper: np.ndarray) -> None:
        self._solver = osqp.OSQP()
        rows, count = problem.C.shape
        C = sp.csc_matrix(
            (
                problem.C.T.ravel(),
                np.tile(np.arange(rows), count),
                np.arange(0, rows * count + 1, rows),
            ),
            shape=(rows, count),
        )
        identity = sp.eye(count, format="csc")
        self._solver.setup(
            identity, problem.q, C, lower, upper,
            eps_abs=self._tolerance, eps_rel=self._tolerance, **SETTINGS,
        )  # fmt: skip
