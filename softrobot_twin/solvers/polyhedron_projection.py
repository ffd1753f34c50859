"""Projection onto a polyhedron, min ½‖w‖² + qᵀw with bounds on rows, by DAQP.

The callers read the signs of the duals, therefore the duals must be exact. Those of an active-set
method are. Those of OSQP, on branches with four and ten contacts, were not at the tolerances that
it reached; at tight enough tolerances it did not finish within 4000 iterations on half of them.

Equal bounds are equations. Redundant contacts make linearly dependent equations, which older
versions of DAQP refuse and newer ones resolve by rounding. Independent equations are selected
first.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg.lapack import dgeqp3

from softrobot_twin.solvers.daqp_program import solve_program

# Feasibility tolerances of DAQP, on rows of unit length, tried in this order.
TOLERANCES = (1.0e-11, 1.0e-9)
# DAQP eliminates the equations, and takes what is left of a unit row to be zero where its square is less. By its
# own ways it says of gaps that actuators hardly close that no point meets them.
ELIMINATION = {"eq_reduction": 1, "zero_tol": 1.0e-14}
# Several times what the largest problems took; DAQP's own limit is far too long for a step.
MOST_ITERATIONS = 1000
# A solution that exceeds its bounds by more is rejected.
ACCEPTED = 1.0e-8
# Rounding error of unit rows.
ROUNDED = 1.0e-15
# A row depends on others if less than this share of it is independent of them.
DEPENDENT = 1.0e-9
# Square of the slack, in the problem's unit, that costs as much as moving w by one.
SLACK_COST = 1.0e-8


class Projection(NamedTuple):
    """A solution.

    Attributes:
        w: The point, shape (n,).
        duals: Of all rows, then of soft bounds; positive where a greater bound would lower the
            objective, shape (m + soft,).
    """

    w: np.ndarray
    duals: np.ndarray


class SoftBounds(NamedTuple):
    """Bounds that may be exceeded.

    Attributes:
        rows: Row numbers, shape (k,).
        lower: Lower bounds, shape (k,).
        upper: Upper bounds, shape (k,).
    """

    rows: np.ndarray
    lower: np.ndarray
    upper: np.ndarray


class PolyhedronProjection:
    """Solves a sequence of projections that differ only in their bounds."""

    def __init__(self, rows: np.ndarray, q: np.ndarray, units: np.ndarray | None = None):
        """Scale the rows to unit length.

        Args:
            rows: Rows by w, in any unit, shape (m, n).
            q: Gradient at zero, shape (n,).
            units: Unit of each row in which `ACCEPTED` counts; its length unless given,
                shape (m,).
        """
        lengths = np.sqrt(np.einsum("ij,ij->i", rows, rows))
        lengths[lengths == 0.0] = 1.0
        self.lengths = lengths
        self.rows = rows / lengths[:, None]
        self._accepted = ACCEPTED * (lengths if units is None else units)
        self.q = q
        self._identity = np.eye(len(q))

    def independent(self, equations: np.ndarray) -> np.ndarray:
        """Independent equations from which the others follow.

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

    def solve(self, lower: np.ndarray, upper: np.ndarray, fixed: np.ndarray) -> Projection | None:
        """Solve with these bounds.

        Args:
            lower: Lower bounds of the rows, in their own unit, shape (m,).
            upper: Upper bounds; rows with equal bounds that are not in `fixed` follow from those
                that are, shape (m,).
            fixed: Independent rows with equal bounds, shape (k,).

        Returns:
            The solution, or None where there is none.
        """
        unit = self._unit(lower, upper, fixed)
        return self._solve(self._identity, self.q, self.rows, *unit, fixed, lower, upper)

    def solve_softly(self, lower, upper, fixed, soft: SoftBounds) -> Projection | None:
        """Solve with further bounds whose excess is least in the sense of least squares.

        Args:
            lower: As above.
            upper: As above.
            fixed: As above.
            soft: Rows and their further bounds.
        """
        n, count = len(self.q), len(soft.rows)
        lengths = self.lengths[soft.rows]
        # The excess counts in the rows' own unit, the same for all.
        slack = np.diag(-np.sqrt(SLACK_COST) * lengths.max() / lengths)
        hard = np.concatenate([self.rows, np.zeros((len(self.rows), count))], axis=1)
        added = np.concatenate([self.rows[soft.rows], slack], axis=1)
        low, high = self._unit(lower, upper, fixed)
        return self._solve(
            np.eye(n + count), np.concatenate([self.q, np.zeros(count)]),
            np.concatenate([hard, added]), np.concatenate([low, soft.lower / lengths]),
            np.concatenate([high, soft.upper / lengths]), fixed, lower, upper,
        )  # fmt: skip

    def refined(self, projection: Projection, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        """Meet to rounding the bounds of all rows that are active, or exceeded.

        Args:
            projection: A solution.
            lower: The bounds that it was found with, shape (m,).
            upper: Likewise.

        Returns:
            w, shape (n,).
        """
        duals = projection.duals[: len(self.rows)]
        values = (self.rows @ projection.w) * self.lengths
        above, below = values > upper, values < lower
        active = (duals != 0.0) | (lower == upper) | above | below
        reached = np.where(above | (~below & (duals > 0.0)), upper, lower)
        missing = ((reached - values) / self.lengths)[active]
        if np.abs(missing).max(initial=0.0) <= ROUNDED:
            return projection.w
        return projection.w + np.linalg.lstsq(self.rows[active], missing, rcond=DEPENDENT)[0]

    def _unit(self, lower, upper, fixed) -> tuple[np.ndarray, np.ndarray]:
        """Bounds of the unit rows; those that follow from others have none."""
        follows = lower == upper
        follows[fixed] = False
        return (np.where(follows, -np.inf, lower / self.lengths),
                np.where(follows, np.inf, upper / self.lengths))

    def _solve(self, H, q, rows, low, high, fixed, lower, upper) -> Projection | None:
        for tolerance in TOLERANCES:
            optimum = solve_program(H, q, rows, low, high, fixed, primal_tol=tolerance,
                                    iter_limit=MOST_ITERATIONS, **ELIMINATION)
            if not optimum.is_found:
                continue
            found = Projection(optimum.x[: len(self.q)], optimum.duals)
            if self._is_accepted(found.w, lower, upper):
                return found
            # The factors that DAQP updates row by row lose digits where rows nearly depend.
            found = found._replace(w=self.refined(found, lower, upper))
            if self._is_accepted(found.w, lower, upper):
                return found
        return None

    def _is_accepted(self, w: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> bool:
        values = (self.rows @ w) * self.lengths
        is_met = (values >= lower - self._accepted) & (values <= upper + self._accepted)
        return bool(is_met.all())
