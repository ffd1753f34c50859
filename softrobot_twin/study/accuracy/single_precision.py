"""SuperLU in single precision: what a factor of half the digits costs, for the study only."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from softrobot_twin.solvers.superlu import OPTIONS, SuperLU


class _RoundedSolve:
    """Solves in single precision and answers in double."""

    def __init__(self, factor):
        self._factor = factor

    def solve(self, right: np.ndarray) -> np.ndarray:
        return self._factor.solve(right.astype(np.float32)).astype(np.float64)


class SingleSuperLU(SuperLU):
    """The factor and its solves in float32; all else stays in double."""

    name = "SuperLU, single precision"

    def factor(self) -> bool:
        """See `Factorization.factor`; the signs of the pivots tell definiteness."""
        if not np.all(np.isfinite(self.storage)):
            return False
        try:
            lu = splu(sp.csc_matrix(self.matrix().astype(np.float32)), **OPTIONS)
        except RuntimeError:  # exactly singular
            return False
        self._lu = _RoundedSolve(lu)
        return np.array_equal(lu.perm_r, lu.perm_c) and bool(np.all(lu.U.diagonal() > 0.0))
