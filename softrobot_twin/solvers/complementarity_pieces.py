"""One piece of a program with complementarity, QP_I: which contacts touch is given, and exact.

    i in I: gap_i = 0, force_i ≥ 0        else: force_i = 0, gap_i ≥ 0

The problem is whitened once: unknowns w with z = T w in which the Hessian is the identity, of size
one. Pieces differ by bounds alone.

Where a piece is empty, bounds give way in the order of `complementarity_problem`: the least excess
of force bounds is found first, then the objective is minimised with just that excess allowed. Both
are convex, and so the answer moves continuously with every bound.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softrobot_twin.solvers.complementarity_problem import ComplementarityProblem
from softrobot_twin.solvers.program_budget import Budget
from softrobot_twin.solvers.row_program import Nearest, RowProgram, Soft

# Objectives that differ by less are equal, in the unit of the problem's size squared.
ROUND_OFF = 1.0e-13
# A start that is worse than the held state by less is as good: that is as exact as it comes.
AS_GOOD = 1.0e-9
# Excesses that differ by less are equal, in shares of the held one or of the size of the problem.
EQUAL_EXCESS = 1.0e-7
# What is no excess, in shares of the largest row or force.
ROUNDING = 1.0e-12
# What an excess is widened by, that the next program is not empty by rounding.
ROOM = 1.0e-9
# Moving by the problem's own size costs one, so that duals of few, or of a small share of the
# largest, are not those of an excess, which go before those of the objective.
LOUD, QUIET, FIRST = 10.0, 1.0e-5, 1.0e6


class Found(NamedTuple):
    """The optimum in whitened unknowns, between the bounds that it was found with.

    Attributes:
        nearest: w, and the duals of the objective.
        calls: Duals of the excess, if there is one, and then of the objective, shape (rows,).
        lower: Least values of all rows, in the problem's units, shape (rows,).
        upper: Greatest values, shape (rows,).
    """

    nearest: Nearest
    calls: np.ndarray
    lower: np.ndarray
    upper: np.ndarray


class Piece(NamedTuple):
    """The optimum of one piece.

    Attributes:
        unknowns: z in the problem's units, shape (n,).
        misfit: The objective over the square of the problem's size, plus a constant that makes
            it zero where nothing binds.
        row_excess: How far rows' bounds are exceeded in all, in shares of the largest row.
        force_excess: How far force bounds are exceeded in all, in shares of the largest force.
        found: What it was computed from.
        forces: Contact forces in shares of the problem's size, shape (contact_count,).
        gaps: Gaps in shares of the problem's size, shape (contact_count,).
        force_duals: Positive where more force would lower the objective, shape (contact_count,).
        gap_duals: Positive where more gap would lower the objective, shape (contact_count,).
    """

    unknowns: np.ndarray
    misfit: float
    row_excess: float
    force_excess: float
    found: Found
    forces: np.ndarray
    gaps: np.ndarray
    force_duals: np.ndarray
    gap_duals: np.ndarray

    def is_better_than(self, other: Piece, by: float = ROUND_OFF) -> bool:
        """Whether it is by more than round-off, in the order of importance."""
        for mine, others in (
            (self.row_excess, other.row_excess), (self.force_excess, other.force_excess),
        ):  # fmt: skip
            if abs(mine - others) > EQUAL_EXCESS:
                return mine < others
        return self.misfit < other.misfit - by * (1.0 + other.misfit)


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
        n, m, contacts = len(problem.g), len(problem.row_lower), problem.contact_count
        self._forces = np.arange(n - contacts, n)
        self._rows = np.arange(n, n + m)
        self._gaps = np.arange(n + m, n + m + contacts)
        self._lower = np.concatenate([problem.lower, problem.row_lower, -problem.d])
        self._upper = np.concatenate([problem.upper, problem.row_upper, np.full(contacts, np.inf)])
        self._limited = np.flatnonzero(np.isfinite(problem.force_max))
        scale = 1.0 / np.sqrt(problem.P.diagonal())
        factor = np.linalg.cholesky(problem.P * np.outer(scale, scale))
        T = scale[:, None] * np.linalg.inv(factor).T
        q, whitened = problem.g @ T, (reference / scale) @ factor
        size = problem.size_of(max(np.linalg.norm(q), np.linalg.norm(whitened)), T)
        self._T = T * size
        self._plain = self._plain_program(reference)
        self._program = RowProgram(self._stack(self._T), q / size, self._plain.lengths)
        self._start = Nearest(whitened / size, np.zeros(n + m + contacts))
        self._reference = reference
        self._row_unit = np.abs(problem.A @ reference).max(initial=0.0) or 1.0
        usual = (problem.forces(reference), problem.force_max[self._limited])
        self._force_unit = np.concatenate(usual).max(initial=0.0) or 1.0

    def start(self) -> Piece:
        """The reference itself, as a piece without duals."""
        return self._piece(
            self._reference, Found(self._start, self._start.duals, self._lower, self._upper)
        )

    def solve(self, touching: np.ndarray, open_choice: np.ndarray | None = None) -> Piece | None:
        """Solve one piece, or the convex problem around several.

        Args:
            touching: Contacts in I, shape (contact_count,).
            open_choice: Contacts that may have both a force and a gap, shape (contact_count,).

        Returns:
            Its optimum; None where it is empty or the budget is spent.
        """
        lower, upper = self._bounds(touching, open_choice)
        found = self._with_least_force_excess(lower, upper)
        if found is None and len(self._rows):
            found = self._with_least_row_excess(lower, upper)
        if found is None:
            return None
        return self._piece(self._in_the_box(found.nearest.w), found)

    def refine(self, piece: Piece, touching: np.ndarray) -> np.ndarray:
        """Meet the equations of a piece's active rows to rounding.

        Args:
            piece: The optimum.
            touching: Contacts in I, shape (contact_count,).

        Returns:
            z, shape (n,).
        """
        found = piece.found
        z = self._in_the_box(self._program.refined(found.nearest, found.lower, found.upper))
        forces = self.problem.forces(z)
        forces[~touching] = 0.0
        # A force at its bound is its bound, not the rounding beside it.
        over = forces - self.problem.force_max
        at_bound = (over > 0.0) & (over < ROUNDING * self._force_unit)
        forces[at_bound] = self.problem.force_max[at_bound]
        return z

    def binding(self, piece: Piece) -> np.ndarray:
        """Which bounds bind, of unknowns besides contact forces, then of rows: -1 where it is the
        lower one, 1 the upper, shape (n - contact_count + m,)."""
        duals = np.sign(piece.found.nearest.duals).astype(np.int64)
        own = len(self.problem.g) - self.problem.contact_count
        return np.concatenate([duals[:own], duals[self._rows]])

    def row_excess(self, z: np.ndarray) -> np.ndarray:
        """By how much rows break their bounds, but for rounding, shape (m,)."""
        excess = self.problem.row_excess(z)
        return np.where(excess > ROUNDING * self._row_unit, excess, 0.0)

    def _stack(self, T: np.ndarray) -> np.ndarray:
        return np.concatenate([T, self.problem.A @ T, self.problem.C @ T])

    def _plain_program(self, reference: np.ndarray) -> RowProgram:
        """The point nearest to the reference, in unknowns that move all rows alike.

        The rows are better conditioned than by the Hessian, in which directions that only spend
        energy are long: what must hold, and what cannot, is told apart here.
        """
        reach = np.sqrt((self.problem.A**2).sum(axis=0) + (self.problem.C**2).sum(axis=0))
        scale = 1.0 / np.where(reach > 0.0, reach, 1.0)
        start = reference / scale
        size = max(np.linalg.norm(start), np.abs(self.problem.d).max(initial=0.0))
        size = self.problem.size_of(size, np.diag(scale))
        unit = scale * size
        rows = [np.diag(unit), self.problem.A * unit, self.problem.C * unit]
        return RowProgram(np.concatenate(rows), -start / size)

    def _bounds(self, touching, open_choice) -> tuple[np.ndarray, np.ndarray]:
        lower, upper = self._lower.copy(), self._upper.copy()
        closed, apart = touching, ~touching
        if open_choice is not None:
            closed, apart = closed & ~open_choice, apart & ~open_choice
        upper[self._forces[apart]] = 0.0
        upper[self._gaps[closed]] = lower[self._gaps[closed]]
        return lower, upper

    def _with_least_force_excess(self, lower, upper) -> Found | None:
        """With force bounds where they can be had; also the duals by which contacts call."""
        limited = self._limited
        if not len(limited):
            return self._solve(lower, upper)
        force_max, rows = self.problem.force_max[limited], self._forces[limited]
        limits = upper.copy()
        limits[rows] = np.minimum(upper[rows], force_max)
        found = self._solve(lower, limits)
        if found is not None:
            return found
        nearest = self._soften(
            lower, upper, Soft(rows, np.full(len(rows), -np.inf), force_max)
        )
        if nearest is None:
            return None
        forces = self._values(nearest, rows)
        allowed = np.maximum(force_max, forces) + ROOM * self._force_unit
        limits[rows] = np.minimum(upper[rows], allowed)
        lower, limits, calls = self._keep_excess(nearest, rows, lower, limits)
        found = self._solve(lower, limits)
        return None if found is None else found._replace(calls=calls + found.calls)

    def _with_least_row_excess(self, lower, upper) -> Found | None:
        """Widen the rows' bounds by no more than it takes."""
        rows = self._rows
        lowest, highest = lower.copy(), upper.copy()
        lowest[rows], highest[rows] = -np.inf, np.inf
        nearest = self._soften(lowest, highest, Soft(rows, lower[rows], upper[rows]))
        if nearest is None:
            return None
        reached, room = self._values(nearest, rows), ROOM * self._row_unit
        lowest[rows] = np.minimum(lower[rows], reached - room)
        highest[rows] = np.maximum(upper[rows], reached + room)
        lowest, highest, calls = self._keep_excess(nearest, rows, lowest, highest)
        found = self._with_least_force_excess(lowest, highest)
        return None if found is None else found._replace(calls=calls + found.calls)

    def _keep_excess(
        self, nearest: Nearest, soft: np.ndarray, lower: np.ndarray, upper: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Bounds in which the excess stays the least.

        Wherever it is the least, the rows whose duals are not zero are at their bounds: they become
        equations. Left as bounds they would enclose next to nothing.

        Returns:
            Lower and upper bounds, and the duals, to go before those of the objective.
        """
        lower, upper, count = lower.copy(), upper.copy(), len(self._lower)
        loud = np.abs(nearest.duals) > max(LOUD, QUIET * np.abs(nearest.duals).max())
        duals = np.where(loud, nearest.duals, 0.0)[:count]
        at_upper, at_lower = np.flatnonzero(duals > 0.0), np.flatnonzero(duals < 0.0)
        lower[at_upper], upper[at_lower] = upper[at_upper], lower[at_lower]
        exceeded = soft[loud[count:]]
        lower[exceeded] = upper[exceeded] = self._values(nearest, exceeded)
        return lower, upper, FIRST * duals

    def _solve(self, lower, upper) -> Found | None:
        if not self._budget.spend():
            return None
        nearest = self._program.solve(lower, upper, self._independent(lower, upper))
        return None if nearest is None else Found(nearest, nearest.duals, lower, upper)

    def _soften(self, lower, upper, soft: Soft) -> Nearest | None:
        if not self._budget.spend():
            return None
        return self._plain.solve_softly(lower, upper, self._independent(lower, upper), soft)

    def _independent(self, lower, upper) -> np.ndarray:
        return self._plain.independent(np.flatnonzero(lower == upper))

    def _values(self, nearest: Nearest, rows: np.ndarray) -> np.ndarray:
        return (self._plain.rows[rows] @ nearest.w) * self._plain.lengths[rows]

    def _in_the_box(self, w: np.ndarray) -> np.ndarray:
        return np.clip(self._T @ w, self.problem.lower, self.problem.upper)

    def _piece(self, z: np.ndarray, found: Found) -> Piece:
        lengths, residual = self._plain.lengths, found.nearest.w + self._program.q
        return Piece(
            z,
            0.5 * float(residual @ residual),
            float(np.linalg.norm(self.problem.row_excess(z))) / self._row_unit,
            float(np.linalg.norm(self.problem.force_excess(z))) / self._force_unit,
            found,
            self.problem.forces(z) / lengths[self._forces],
            self.problem.gaps(z) / lengths[self._gaps],
            found.calls[self._forces],
            found.calls[self._gaps],
        )
