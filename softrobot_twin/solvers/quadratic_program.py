"""Convex quadratic programs in whitened unknowns, solved by OSQP or DAQP.

The curvature of the inverse problem spans six decades: some directions displace the effector, the
others only cost energy. Therefore the program is posed in unknowns w in which the Hessian is the
identity, z = T w, with constraint rows of unit length and a gradient of unit length. What is left
to the solver is the projection of a point onto a polyhedron.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.sparse as sp

from softrobot_twin.solvers.daqp_program import solve_program
from softrobot_twin.solvers.qpcc import QPCC

OSQP_INFINITY = 1.0e20
OSQP_TOLERANCE = 1.0e-8
OSQP_SETTINGS = {
    "verbose": False,
    # Where rows of C are nearly parallel, splitting methods converge slowly; another solver is
    # asked then.
    "max_iter": 1000,
    # The problem comes scaled.
    "scaling": 0,
    # Counted in iterations, never in seconds: the same input gives the same bits.
    "adaptive_rho_interval": 25,
}
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
        ValueError: The problem has contacts.
    """
    if problem.contact_count:
        raise ValueError(f"{problem.contact_count} contacts: not a quadratic program")
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


class OSQPSolver:
    """OSQP; its workspace is set up once, and updated by each problem of the same size."""

    name = "OSQP"

    def __init__(self, *, tolerance: float = OSQP_TOLERANCE):
        """Set nothing up yet: the first problem does.

        Args:
            tolerance: Residual, absolute and relative, at which the problem counts as solved.
        """
        # Imported where it is used: it is slow to import, and not every scene needs it.
        import osqp

        self._osqp = osqp
        self._tolerance = tolerance
        self.reset()

    def reset(self) -> None:
        """Forget the last solution, so that a run can be repeated to the bit."""
        self._solver, self._shape = None, (0, 0)

    def solve(self, problem: WhitenedQP) -> QPSolution:
        """Solve one problem, warm-started from the last.

        Args:
            problem: The whitened QP.

        Returns:
            z, and whether it can be trusted.
        """
        lower = np.maximum(problem.lower, -OSQP_INFINITY)
        upper = np.minimum(problem.upper, OSQP_INFINITY)
        if self._shape != problem.C.shape:
            self._set_up(problem, lower, upper)
        else:
            # Column by column, as a sparse matrix with every entry present stores it.
            self._solver.update(q=problem.q, l=lower, u=upper, Ax=problem.C.T.ravel())
        found = self._solver.solve(raise_error=False)
        status = found.info.status
        return problem.solution(found.x, found.y, status == "solved", found.info.iter, status, self.name)

    def _set_up(self, problem: WhitenedQP, lower: np.ndarray, upper: np.ndarray) -> None:
        self._solver, self._shape = self._osqp.OSQP(), problem.C.shape
        # Every entry is present, also one that is zero now.
        C = sp.csc_matrix(np.ones(self._shape))
        C.data = problem.C.T.ravel()
        identity = sp.eye(self._shape[1], format="csc")
        self._solver.setup(
            identity, problem.q, C, lower, upper,
            eps_abs=self._tolerance, eps_rel=self._tolerance, **OSQP_SETTINGS,
        )  # fmt: skip


class DAQPSolver:
    """DAQP, a dual active-set method: exact multipliers, no set-up, nothing kept."""

    name = "DAQP"

    def __init__(self, *, tolerance: float = DAQP_TOLERANCE):
        """Remember the tolerance.

        Args:
            tolerance: Largest excess of a bound, in the unit of w.
        """
        self._tolerance = tolerance

    def reset(self) -> None:
        """Nothing is kept from one problem to the next."""

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
