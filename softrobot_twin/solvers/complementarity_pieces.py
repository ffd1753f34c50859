"""One piece of a program with complementarity, QP_I: which contacts touch is given, and exact.

    i in I: gap_i = 0, force_i ≥ 0        else: force_i = 0, gap_i ≥ 0

The problem is whitened once: unknowns w with z = T w in which the Hessian is the identity, rows of
unit length, w of size one. Pieces then differ by bounds alone, and DAQP keeps its factors from one
to the next. An equality is posed as two bounds WIDTH apart, since redundant contacts make rows that
depend on each other, which older DAQP refuses among equalities.

Where a piece is empty, bounds give way in the order of `complementarity_problem`. Force bounds get
slack so dear (1/DEARNESS) that it is the least possible to that share, and the objective is minimised
in what is left: one convex program, so the answer moves continuously with every bound.
"""

from __future__ import annotations

from collections.abc import Callable
from ctypes import c_int
from typing import NamedTuple

import daqp
import numpy as np

from softrobot_twin.solvers.complementarity_problem import ComplementarityProblem

INFINITY = 1.0e30
# What separates the two bounds of an equality, for DAQP to take it as two inequalities. Rows are of
# unit length in a metric where directions that only spend energy are long, so it has to be small.
WIDTH = 1.0e-14
SETTINGS = {"primal_tol": 1.0e-13, "zero_tol": 1.0e-16}
# An answer that breaks its bounds by more is not believed.
BELIEVED = 1.0e-8
# Rows that are dependent to this share are, in the last correction.
DEPENDENT = 1.0e-9
# Square of the unit slack's size where slack costs as much as w.
DEARNESS = 1.0e-8
# Objectives that differ by less are equal, in the unit of the problem's size squared.
ROUND_OFF = 1.0e-13
# Excesses that differ by less are equal, in the unit of the largest row.
EQUAL_EXCESS = 1.0e-7


class Budget:
    """Counts the quadratic programs that may still be solved."""

    def __init__(self, most: int, expired: Callable[[], bool]):
        """Start with nothing spent.

        Args:
            most: Programs that may be solved.
            expired: Asked before each; True when time is over.
        """
        self.spent = 0
        self._most = most
        self._expired = expired

    def spend(self) -> bool:
        """Take one; False when nothing is left."""
        if self.is_over:
            return False
        self.spent += 1
        return True

    @property
    def is_over(self) -> bool:
        """Whether nothing is left."""
        return self.spent >= self._most or self._expired()


class Piece(NamedTuple):
    """The optimum of one piece.

    Attributes:
        unknowns: z in the problem's units, shape (n,).
        misfit: The objective over the square of the problem's size, plus a constant that makes
            it zero where nothing binds.
        row_excess: How far rows' bounds are exceeded in all, in rows of unit length.
        force_excess: How far force bounds are exceeded in all, in shares of the largest row.
        whitened: w, shape (n,).
        duals: Of all rows, positive at upper bounds, shape (n + m + contact_count,).
        forces: Contact forces in rows of unit length, shape (contact_count,).
        gaps: Gaps in rows of unit length, shape (contact_count,).
        force_duals: Positive where more force would lower the objective, shape (contact_count,).
        gap_duals: Positive where more gap would lower the objective, shape (contact_count,).
    """

    unknowns: np.ndarray
    misfit: float
    row_excess: float
    force_excess: float
    whitened: np.ndarray
    duals: np.ndarray
    forces: np.ndarray
    gaps: np.ndarray
    force_duals: np.ndarray
    gap_duals: np.ndarray

    def is_better_than(self, other: Piece) -> bool:
        """Whether it is by more than round-off, in the order of importance."""
        for mine, others in (
            (self.row_excess, other.row_excess), (self.force_excess, other.force_excess),
        ):  # fmt: skip
            allowance = EQUAL_EXCESS * (1.0 + others)
            if abs(mine - others) > allowance:
                return mine < others
        return self.misfit < other.misfit - ROUND_OFF * (1.0 + other.misfit)


class PieceSolver:
    """Solves pieces of one problem."""

    def __init__(self, problem: ComplementarityProblem, reference: np.ndarray, budget: Budget):
        """Whiten the problem.

        Args:
            problem: The problem.
            reference: An admissible z, of the answer's order of size, shape (n,).
            budget: What may be spent.

        Raises:
            numpy.linalg.LinAlgError: The Hessian is not positive definite.
        """
        self.problem = problem
        self._budget = budget
        n, contacts = len(problem.g), problem.contact_count
        scale = 1.0 / np.sqrt(problem.P.diagonal())
        factor = np.linalg.cholesky(problem.P * np.outer(scale, scale))
        T = scale[:, None] * np.linalg.inv(factor).T
        q = problem.g @ T
        whitened = (reference / scale) @ factor
        size = max(np.linalg.norm(q), np.linalg.norm(whitened)) or 1.0
        self._T, self._q = T * size, q / size
        rows = np.concatenate([self._T, problem.A @ self._T, problem.C @ self._T])
        self._lengths = np.sqrt(np.einsum("ij,ij->i", rows, rows))
        self._lengths[self._lengths == 0.0] = 1.0
        self._rows = rows / self._lengths[:, None]
        self._force_rows = np.arange(n - contacts, n)
        self._lower = np.concatenate([problem.lower, problem.row_lower, -problem.d])
        self._lower = np.maximum(self._lower / self._lengths, -INFINITY)
        upper = np.concatenate([problem.upper, problem.row_upper, np.full(contacts, np.inf)])
        self._upper = np.minimum(upper / self._lengths, INFINITY)
        self._force_unit = self._lengths[self._force_rows].max(initial=0.0) or 1.0
        self._limited = self._force_rows[np.isfinite(problem.force_max)]
        self._force_max = problem.force_max / self._lengths[self._force_rows]
        self._identity = np.eye(n)
        self._box = (problem.lower, problem.upper)
        self._start = (reference, whitened / size)
        self._model = None

    def start(self) -> Piece:
        """The reference itself, as a piece without duals."""
        z, w = self._start
        return self._piece(z, w, np.zeros(len(self._rows)))

    def solve(self, touching: np.ndarray, open_choice: np.ndarray | None = None) -> Piece | None:
        """Solve one piece, or the convex problem around several.

        Args:
            touching: Contacts in I, shape (contact_count,).
            open_choice: Contacts that may have both a force and a gap, shape (contact_count,).

        Returns:
            Its optimum; None where it is empty or the budget is spent.
        """
        lower, upper = self._bounds(touching, open_choice)
        answer = self._solve_in_order(lower, upper)
        if answer is None and len(self.problem.row_lower):
            answer = self._with_least_row_excess(lower, upper)
        if answer is None:
            return None
        return self._piece(np.clip(self._T @ answer[0], *self._box), *answer)

    def refine(self, piece: Piece, touching: np.ndarray) -> np.ndarray:
        """Meet the equations of a piece's active rows to rounding.

        Args:
            piece: The optimum.
            touching: Contacts in I, shape (contact_count,).

        Returns:
            z, shape (n,).
        """
        lower, upper = self._bounds(touching, None)
        forces, w, duals = self._force_rows, piece.whitened, piece.duals
        upper[forces] = np.minimum(upper[forces], self._force_max)
        missing = np.where(duals > 0.0, upper, lower) - self._rows @ w
        # What a bound gave way by stays.
        active = ((duals != 0.0) | (lower == upper)) & (np.abs(missing) < BELIEVED)
        correction = np.linalg.lstsq(self._rows[active], missing[active], rcond=DEPENDENT)[0]
        z = np.clip(self._T @ (w + correction), *self._box)
        z[forces[~touching]] = 0.0
        return z

    def _bounds(self, touching, open_choice) -> tuple[np.ndarray, np.ndarray]:
        lower, upper = self._lower, self._upper.copy()
        contacts = len(touching)
        closed, apart = touching, ~touching
        if open_choice is not None:
            closed, apart = closed & ~open_choice, apart & ~open_choice
        upper[self._force_rows[apart]] = 0.0
        gaps = upper[len(upper) - contacts :]
        gaps[closed] = lower[len(lower) - contacts :][closed]
        return lower, upper

    def _solve_in_order(self, lower, upper) -> tuple[np.ndarray, np.ndarray] | None:
        """With force bounds where they can be had, else with their least excess."""
        forces, limited = self._force_rows, self._limited
        if not len(limited):
            return self._solve_quadratic(lower, upper)
        limits = upper.copy()
        limits[forces] = np.minimum(upper[forces], self._force_max)
        answer = self._solve_quadratic(lower, limits)
        if answer is None:
            reach = self._force_max[limited - forces[0]]
            answer = self._soften(
                lower, upper, limited, np.full(len(limited), -INFINITY), reach, self._q
            )
        return answer

    def _with_least_row_excess(self, lower, upper) -> tuple[np.ndarray, np.ndarray] | None:
        """Widen the rows' bounds by no more than it takes, then solve."""
        n, m = len(self.problem.g), len(self.problem.row_lower)
        rows = np.arange(n, n + m)
        lowest, highest = lower.copy(), upper.copy()
        lowest[rows], highest[rows] = -INFINITY, INFINITY
        answer = self._soften(
            lowest, highest, rows, lower[rows], upper[rows], np.zeros_like(self._q)
        )
        if answer is None:
            return None
        reached = self._rows[rows] @ answer[0]
        lowest[rows] = np.minimum(lower[rows], reached)
        highest[rows] = np.maximum(upper[rows], reached)
        return self._solve_in_order(lowest, highest)

    def _soften(
        self, lower, upper, soft, soft_lower, soft_upper, q
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """Add bounds on rows that may be exceeded, each by a slack unknown of its own."""
        n, count = len(q), len(soft)
        if not self._budget.spend():
            return None
        # The excess counts in the problem's own unit, not in that of unit rows.
        lengths = self._lengths[soft]
        slack = -np.sqrt(DEARNESS) * lengths.max() / lengths
        hard = np.concatenate([self._rows, np.zeros((len(self._rows), count))], axis=1)
        rows = np.concatenate([hard, np.concatenate([self._rows[soft], np.diag(slack)], axis=1)])
        w, _, exit_flag, info = daqp.solve(
            np.eye(n + count), np.concatenate([q, np.zeros(count)]), rows,
            _apart(np.concatenate([upper, soft_upper]), np.concatenate([lower, soft_lower])),
            np.concatenate([lower, soft_lower]),
            np.zeros(len(rows), dtype=c_int), **SETTINGS,
        )  # fmt: skip
        if exit_flag < 1 or not self._believe(w[:n], lower, upper):
            return None
        return w[:n], info["lam"][: len(self._rows)]

    def _solve_quadratic(self, lower, upper) -> tuple[np.ndarray, np.ndarray] | None:
        if not self._budget.spend():
            return None
        upper = _apart(upper, lower)
        if self._model is None:
            self._model = daqp.Model()
            self._model.settings = SETTINGS
            self._model.setup(
                self._identity, self._q, self._rows, upper, lower,
                np.zeros(len(upper), dtype=c_int),
            )  # fmt: skip
        else:
            self._model.update(bupper=upper, blower=lower)
        w, _, exit_flag, info = self._model.solve()
        if exit_flag == 1 and self._believe(w, lower, upper):
            return w, info["lam"]
        # Seldom, a warm start ends in a dead end; an empty piece is believed only from a cold one.
        w, _, exit_flag, info = daqp.solve(
            self._identity, self._q, self._rows, upper, lower,
            np.zeros(len(upper), dtype=c_int), **SETTINGS,
        )  # fmt: skip
        if exit_flag != 1 or not self._believe(w, lower, upper):
            return None
        return w, info["lam"]

    def _believe(self, w: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> bool:
        values = self._rows @ w
        # Also False where a value is not a number.
        return bool(np.all((values >= lower - BELIEVED) & (values <= upper + BELIEVED)))

    def _piece(self, z: np.ndarray, w: np.ndarray, duals: np.ndarray) -> Piece:
        n, m = len(z), len(self.problem.row_lower)
        force_lengths, gap_lengths = self._lengths[self._force_rows], self._lengths[n + m :]
        row_excess = self.problem.row_excess(z) / self._lengths[n : n + m]
        residual = w + self._q
        return Piece(
            z,
            0.5 * float(residual @ residual),
            float(np.linalg.norm(row_excess)),
            float(np.linalg.norm(self.problem.force_excess(z))) / self._force_unit,
            w,
            duals,
            self.problem.forces(z) / force_lengths,
            self.problem.gaps(z) / gap_lengths,
            duals[self._force_rows],
            duals[n + m :],
        )


def _apart(upper: np.ndarray, lower: np.ndarray) -> np.ndarray:
    """Upper bounds with none nearer to its lower one than WIDTH."""
    return np.maximum(upper, lower + WIDTH)
