"""Nearest point of a polyhedron in a chosen metric, by DAQP: min ½‖w‖² + qᵀw, bounds on unit rows.

Whoever asks reads the duals' signs, so they have to be exact. Those of an active-set method are;
OSQP's, on pieces with four and ten contacts, were not at tolerances it reached, and at those where
they were it did not end within 4000 iterations on half of them.

Equal bounds are equations. Redundant contacts make equations that follow from each other, which
older DAQP refuses and newer ones resolve by rounding; so independent ones are chosen first.
"""

from __future__ import annotations

from ctypes import c_int
from typing import NamedTuple

import daqp
import numpy as np
from scipy.linalg.lapack import dgeqp3

INFINITY = 1.0e30
EQUATION = 5
# What DAQP may miss bounds by, on rows of unit length: where it fails, it is asked once more.
TOLERANCES = (1.0e-11, 1.0e-9)
# Several times what the largest problems took; DAQP's own limit is no limit in time.
MOST_ITERATIONS = 1000
# An answer that breaks its bounds by more is not believed.
BELIEVED = 1.0e-8
# What unit rows may be off by from rounding alone.
ROUNDED = 1.0e-15
# A row that is a combination of others but for this share follows from them.
DEPENDENT = 1.0e-9
# Square of the slack, in the problem's unit, that costs as much as moving w by one.
DEARNESS = 1.0e-8


class Nearest(NamedTuple):
    """An answer.

    Attributes:
        w: The point, shape (n,).
        duals: Of all rows, then of soft bounds; positive where a greater bound would lower the
            objective, shape (m + soft,).
    """

    w: np.ndarray
    duals: np.ndarray


class RowProgram:
    """Solves one program after another that differ in their bounds."""

    def __init__(self, rows: np.ndarray, q: np.ndarray, units: np.ndarray | None = None):
        """Bring rows to unit length.

        Args:
            rows: Rows by w, in any unit, shape (m, n).
            q: Gradient at zero, shape (n,).
            units: By a small share of what a row may miss its bounds; its length unless given,
                shape (m,).
        """
        lengths = np.sqrt(np.einsum("ij,ij->i", rows, rows))
        lengths[lengths == 0.0] = 1.0
        self.lengths = lengths
        self.rows = rows / lengths[:, None]
        self._allowed = BELIEVED * (lengths if units is None else units)
        self.q = q
        self._identity = np.eye(len(q))

    def independent(self, equations: np.ndarray) -> np.ndarray:
        """Equations that the others follow from.

        Args:
            equations: Row numbers, shape (k,).

        Returns:
            Some of them.
        """
        if len(equations) < 2:
            return equations
        triangle, order, *_ = dgeqp3(self.rows[equations].T)
        diagonal = np.abs(triangle.diagonal())
        return equations[order[: len(diagonal)][diagonal > DEPENDENT] - 1]

    def solve(self, lower: np.ndarray, upper: np.ndarray, fixed: np.ndarray) -> Nearest | None:
        """Solve with these bounds.

        Args:
            lower: Least values of the rows, in their own unit, shape (m,).
            upper: Greatest values; where equal, and not in `fixed`, they follow, shape (m,).
            fixed: Independent rows with equal bounds, shape (k,).

        Returns:
            The answer, or None where there is none.
        """
        bounds = self._unit(lower, upper, fixed)
        return self._solve(self._identity, self.q, self.rows, *bounds, lower, upper)

    def solve_softly(self, lower, upper, fixed, soft: Soft) -> Nearest | None:
        """Solve with further bounds that are exceeded as little as can be, in least squares.

        Args:
            lower: As above.
            upper: As above.
            fixed: As above.
            soft: Rows and their further bounds.
        """
        n, count = len(self.q), len(soft.rows)
        lengths = self.lengths[soft.rows]
        # The excess counts in the rows' own unit, the same for all.
        slack = np.diag(-np.sqrt(DEARNESS) * lengths.max() / lengths)
        hard = np.concatenate([self.rows, np.zeros((len(self.rows), count))], axis=1)
        added = np.concatenate([self.rows[soft.rows], slack], axis=1)
        low, high, sense = self._unit(lower, upper, fixed)
        low = np.concatenate([low, np.maximum(soft.lower / lengths, -INFINITY)])
        high = np.concatenate([high, np.minimum(soft.upper / lengths, INFINITY)])
        return self._solve(
            np.eye(n + count), np.concatenate([self.q, np.zeros(count)]),
            np.concatenate([hard, added]), low, high,
            np.concatenate([sense, np.zeros(count, dtype=c_int)]), lower, upper,
        )  # fmt: skip

    def refined(self, nearest: Nearest, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        """Meet the bounds of the rows that are active, or missed within the tolerance, to rounding.

        Args:
            nearest: An answer.
            lower: The bounds that it was found with, shape (m,).
            upper: Likewise.

        Returns:
            w, shape (n,).
        """
        duals = nearest.duals[: len(self.rows)]
        values = (self.rows @ nearest.w) * self.lengths
        above, below = values > upper, values < lower
        active = (duals != 0.0) | (lower == upper) | above | below
        reached = np.where(above | (~below & (duals > 0.0)), upper, lower)
        missing = ((reached - values) / self.lengths)[active]
        if np.abs(missing).max(initial=0.0) <= ROUNDED:
            return nearest.w
        return nearest.w + np.linalg.lstsq(self.rows[active], missing, rcond=DEPENDENT)[0]

    def _unit(self, lower, upper, fixed) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        low = np.maximum(lower / self.lengths, -INFINITY)
        high = np.minimum(upper / self.lengths, INFINITY)
        follows = lower == upper
        follows[fixed] = False
        low[follows], high[follows] = -INFINITY, INFINITY
        sense = np.zeros(len(low), dtype=c_int)
        sense[fixed] = EQUATION
        return low, high, sense

    def _solve(self, H, q, rows, low, high, sense, lower, upper) -> Nearest | None:
        n = len(self.q)
        for tolerance in TOLERANCES:
            w, _, exit_flag, info = daqp.solve(
                H, q, rows, high, low, sense.copy(),
                primal_tol=tolerance, iter_limit=MOST_ITERATIONS,
            )  # fmt: skip
            if exit_flag != 1 or not np.all(np.isfinite(w)):
                continue
            found = Nearest(w[:n], info["lam"])
            if self._believe(found.w, lower, upper):
                return found
            # The factors that DAQP updates row by row lose digits where rows nearly depend.
            found = found._replace(w=self.refined(found, lower, upper))
            if self._believe(found.w, lower, upper):
                return found
        return None

    def _believe(self, w: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> bool:
        values = (self.rows @ w) * self.lengths
        return bool(
            np.all((values >= lower - self._allowed) & (values <= upper + self._allowed))
        )


class Soft(NamedTuple):
    """Bounds that may be exceeded.

    Attributes:
        rows: Row numbers, shape (k,).
        lower: Least values, shape (k,).
        upper: Greatest values, shape (k,).
    """

    rows: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
