"""Small convex quadratic programs, solved by DAQP, a dual active-set method with exact multipliers."""

from __future__ import annotations

from ctypes import c_int
from typing import NamedTuple

import daqp
import numpy as np

# A bound beyond is none.
INFINITY = 1.0e30
_EQUATION = 5


class ProgramOptimum(NamedTuple):
    """What DAQP found.

    Attributes:
        x: The unknowns, shape (n,).
        duals: Multipliers of the bounds of unknowns, then of rows, positive at upper bounds.
        is_found: Whether x is the optimum, and finite.
        iterations: How many iterations it took.
        flag: DAQP's exit flag.
    """

    x: np.ndarray
    duals: np.ndarray
    is_found: bool
    iterations: int
    flag: int


def solve_program(
    P: np.ndarray, q: np.ndarray, rows: np.ndarray, lower: np.ndarray, upper: np.ndarray,
    equations: np.ndarray | None = None, **settings: float,
) -> ProgramOptimum:  # fmt: skip
    """min ½ xᵀPx + qᵀx with lower ≤ (x, rows x) ≤ upper.

    Args:
        P: Positive definite, shape (n, n).
        q: Gradient at zero, shape (n,).
        rows: Shape (m, n).
        lower: Lower bounds: of the first unknowns, where there are more than rows, then of the rows.
        upper: Upper bounds, same shape.
        equations: Numbers of bounds that are equal on both sides and bind; None for none.
        **settings: Of DAQP, such as ``primal_tol``.
    """
    kinds = np.zeros(len(upper), dtype=c_int)
    if equations is not None:
        kinds[equations] = _EQUATION
    x, _, flag, info = daqp.solve(
        P, q, rows, np.minimum(upper, INFINITY), np.maximum(lower, -INFINITY), kinds, **settings)
    is_found = flag >= 1 and bool(np.isfinite(x).all())
    return ProgramOptimum(np.array(x), np.array(info["lam"]), is_found, info["iterations"], flag)
