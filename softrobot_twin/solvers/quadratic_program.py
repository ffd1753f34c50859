"""Convex quadratic programs in whitened unknowns, solved by DAQP.

The curvature of the inverse problem spans six decades: some directions displace the effector, the
others only cost energy. Therefore the program is posed in unknowns w in which the Hessian is the
identity, z = T w, with constraint rows of unit length and a gradient of unit length. What is left
to the solver is the projection of a point onto a polyhedron.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softrobot_twin.solvers.daqp_program import solve_program
from softrobot_twin.solvers.qpcc import QPCC

DAQP_TOLERANCE = 1.0e-9


class WhitenedQP(NamedTuple):
    """min ½ wᵀw + qᵀw, lower ≤ C w ≤ upper, with z = T w.

    Attributes:
        q: Gradient at zero, of unit length, shape (n,).
        C: Unit rows: the program's rows, then its unknowns, shape (m + n, n).
        lower: Lower bounds, shape (m + n,).
        upper: Upper bounds, shape (m + n,).
        T: Unknowns of the program by w, shape (n, n).
    """

    q: np.ndarray
    C: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    T: np.ndarray

    def solution(self, w, duals, solved: bool, iterations: int, reason: str, solver: str):
        """What a solver found, as a `QPSolution`; no number where it is not solved or not finite.

        Args:
            w: The whitened unknowns, shape (n,).
            duals: Multipliers of the rows.
            solved: Whether the solver says that it is solved.
            iterations: How many iterations it took.
            reason: Why it ended, in the solver's words.
            solver: Name of the solver.
        """
        solved = solved and bool(np.all(np.isfinite(w)))
        unknowns = self.T @ w if solved else np.full(len(self.q), np.nan)
        return QPSolution(unknowns, np.array(duals), solved, iterations, reason, solver)


class QPSolution(NamedTuple):
    """Solution of a quadratic program.

    Attributes:
        unknowns: z, shape (n,); NaN when unsolved.
        duals: Multipliers of the rows of C, positive at upper bounds, shape (m + n,).
        solved: False when the problem has no solution or the solver found none.
        iterations: Iterations done.
        reason: The solver's own status message.
        solver: Its name.
    """

    unknowns: np.ndarray
    duals: np.ndarray
    solved: bool
    iterations: int
    reason: str
    solver: str


def whiten(problem: QPCC) -> WhitenedQP:
    """Pose a program without contacts in whitened unknowns.

    Args:
        problem: A problem without contacts.

    Returns:
        The whitened program.

    Raises:
        numpy.linalg.LinAlgError: The Hessian is not finite or not positive definite.
    """
    _, _, T = problem.whitening()
    q = T.T @ problem.g
    size = np.linalg.norm(q) or 1.0
    T = T * size
    C = np.vstack([problem.A @ T, T])
    lengths = np.linalg.norm(C, axis=1)
    lengths[lengths == 0.0] = 1.0
    lower = np.concatenate([problem.row_lower, problem.lower])
    upper = np.concatenate([problem.row_upper, problem.upper])
    return WhitenedQP(q / size, C / lengths[:, None], lower / lengths, upper / lengths, T)


class DAQPSolver:
    """DAQP, a dual active-set method: exact multipliers, no set-up, nothing kept."""

    name = "DAQP"

    def __init__(self, *, tolerance: float = DAQP_TOLERANCE):
        """Remember the tolerance.

        Args:
            tolerance: Largest excess of a bound, in the unit of w.
        """
        self._tolerance = tolerance

    def solve(self, problem: WhitenedQP) -> QPSolution:
        """Solve one problem.

        Args:
            problem: The whitened QP.

        Returns:
            z, and whether it can be trusted.
        """
        found = solve_program(np.eye(len(problem.q)), problem.q, problem.C, problem.lower, problem.upper,
                              primal_tol=self._tolerance)
        return problem.solution(found.x, found.duals, found.is_found, found.iterations,
                                f"exit flag {found.flag}", self.name)
