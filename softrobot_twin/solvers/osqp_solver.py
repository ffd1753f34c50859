"""The inverse QP solved by OSQP, set up once and updated each step."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import osqp
import scipy.sparse as sp

from softrobot_twin.solvers.inverse_qp import BoxedQP

INFINITY = 1.0e20
SETTINGS = {
    "verbose": False,
    "eps_abs": 1.0e-8,
    "eps_rel": 1.0e-8,
    "eps_prim_inf": 1.0e-7,
    "max_iter": 4000,
    "scaling": 0,
    "polishing": True,
    # Counted in iterations, never in seconds: the same input gives the same bits.
    "adaptive_rho_interval": 25,
}


class QPSolution(NamedTuple):
    """Answer of a QP.

    Attributes:
        multipliers: λ [N], shape (n,).
        duals: Multipliers of the rows of C, shape (2 n,).
        solved: False when the problem has no answer or the solver found none.
        iterations: Iterations done.
        reason: The solver's own word.
    """

    multipliers: np.ndarray
    duals: np.ndarray
    solved: bool
    iterations: int
    reason: str


class OSQPSolver:
    """Keeps one OSQP workspace for problems of one size."""

    name = "OSQP"

    def __init__(self, count: int):
        """Lay out the workspace.

        Args:
            count: Number of unknowns n.
        """
        self._count = count
        self._upper = np.triu_indices(count)
        self.reset()

    def reset(self) -> None:
        """Forget the last solution, so that a run can be repeated to the bit."""
        self._solver = None

    def solve(self, problem: BoxedQP) -> QPSolution:
        """Solve one problem, warm-started from the last.

        Args:
            problem: The scaled QP.

        Returns:
            λ in newtons, and whether it can be trusted.
        """
        lower = np.maximum(problem.lower, -INFINITY)
        upper = np.minimum(problem.upper, INFINITY)
        # Column order, as a sparse matrix with every entry present stores it.
        P_entries = problem.P.T[np.tril_indices(self._count)]
        C_entries = problem.C.T.ravel()
        if self._solver is None:
            self._set_up(problem, lower, upper)
        else:
            self._solver.update(Px=P_entries, Ax=C_entries)
            self._solver.update(q=problem.q, l=lower, u=upper)
        answer = self._solver.solve(raise_error=False)
        solved = answer.info.status == "solved" and bool(np.all(np.isfinite(answer.x)))
        multipliers = problem.scale * answer.x if solved else np.full(self._count, np.nan)
        return QPSolution(
            multipliers, np.asarray(answer.y), solved, answer.info.iter, answer.info.status
        )

    def _set_up(self, problem: BoxedQP, lower: np.ndarray, upper: np.ndarray) -> None:
        self._solver = osqp.OSQP()
        count = self._count
        P = sp.csc_matrix(
            (
                problem.P.T[np.tril_indices(count)],
                np.concatenate([np.arange(j + 1) for j in range(count)]),
                np.concatenate([[0], np.cumsum(np.arange(1, count + 1))]),
            ),
            shape=(count, count),
        )
        rows = 2 * count
        C = sp.csc_matrix(
            (
                problem.C.T.ravel(),
                np.tile(np.arange(rows), count),
                np.arange(0, rows * count + 1, rows),
            ),
            shape=(rows, count),
        )
        self._solver.setup(P, problem.q, C, lower, upper, **SETTINGS)
