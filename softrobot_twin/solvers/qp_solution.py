"""What a QP solver answers."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class QPSolution(NamedTuple):
    """Answer of a QP.

    Attributes:
        multipliers: λ [N], shape (n,); NaN when unsolved.
        duals: Multipliers of the rows of C, positive at upper bounds, shape (2 n,).
        solved: False when the problem has no answer or the solver found none.
        iterations: Iterations done.
        reason: The solver's own word.
        solver: Its name.
    """

    multipliers: np.ndarray
    duals: np.ndarray
    solved: bool
    iterations: int
    reason: str
    solver: str
