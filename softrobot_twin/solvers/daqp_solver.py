"""The inverse QP solved by DAQP, a dual active-set method: exact multipliers, no set-up."""

from __future__ import annotations

from ctypes import c_int

import daqp
import numpy as np

from softrobot_twin.solvers.inverse_qp import WhitenedQP
from softrobot_twin.solvers.qp_solution import QPSolution

INFINITY = 1.0e30
TOLERANCE = 1.0e-9


class DAQPSolver:
    """Solves each problem from nothing."""

    name = "DAQP"

    def __init__(self, count: int, tolerance: float = TOLERANCE):
        """Prepare what does not change.

        Args:
            count: Number of unknowns n.
            tolerance: What a bound may be broken by, in the unit of z.
        """
        self._tolerance = tolerance
        self._identity = np.eye(count)
        self._sense = np.zeros(2 * count, dtype=c_int)

    def reset(self) -> None:
        """Nothing is kept from one problem to the next."""

    def solve(self, problem: WhitenedQP) -> QPSolution:
        """Solve one problem.

        Args:
            problem: The whitened QP.

        Returns:
            λ in newtons, and whether it can be trusted.
        """
        lower = np.maximum(problem.lower, -INFINITY)
        upper = np.minimum(problem.upper, INFINITY)
        z, _, exit_flag, info = daqp.solve(
            self._identity, problem.q, problem.C, upper, lower, self._sense.copy(),
            primal_tol=self._tolerance,
        )  # fmt: skip
        solved = exit_flag >= 1 and bool(np.all(np.isfinite(z)))
        multipliers = problem.T @ z if solved else np.full(len(problem.q), np.nan)
        return QPSolution(
            multipliers, np.array(info["lam"]), solved, info["iterations"],
            f"exit flag {exit_flag}", self.name,
        )  # fmt: skip
