"""The compliance of constraint rows, W = H A⁻¹ Hᵀ, as a matrix or by its factor.

With A = LLᵀ it is W = Yᵀ Y with Y = L⁻¹ Hᵀ. A rigid body has six unknowns, however many of its
points touch something. Where the rows act only on such bodies, Y has a few rows while W has as many
as there are constraint rows. Then Y is kept, and W is formed only when it is needed.
"""

from __future__ import annotations

import numpy as np

from softrobot_twin.kernels.compilation import KERNEL, njit


class Compliance:
    """W of some rows.

    Attributes:
        Yt: Yᵀ, one row for each constraint row, with W = Yᵀ Y, shape (n, rank); None where W is not of low
            rank.
    """

    def __init__(self, W: np.ndarray | None = None, Yt: np.ndarray | None = None):
        """Store W or its factor.

        Args:
            W: The matrix [m/N], shape (n, n), or None where Yt is given.
            Yt: Yᵀ, or None where W is given.
        """
        self._W, self.Yt = W, Yt

    @property
    def W(self) -> np.ndarray:
        """The matrix [m/N], shape (n, n); formed at the first call."""
        if self._W is None:
            self._W = self.Yt @ self.Yt.T
        return self._W

    def motion(self, rows: slice, multipliers: np.ndarray) -> np.ndarray:
        """W λ of some rows [m].

        Args:
            rows: Which rows.
            multipliers: λ of all rows [N], shape (n,).
        """
        if self.Yt is None:
            return self._W[rows] @ multipliers
        return self.Yt[rows] @ (multipliers @ self.Yt)

    def without(self, first: int, stop: int) -> Compliance:
        """Without the rows from `first` to before `stop`.

        Args:
            first: First row that is left out.
            stop: The row after the last one that is left out.
        """
        if first == stop:
            return self
        if self.Yt is None:
            return Compliance(without_rows(self._W, first, stop))
        return Compliance(Yt=np.concatenate([self.Yt[:first], self.Yt[stop:]]))


@njit(**KERNEL)
def without_rows(W, first, stop):
    """W without the rows and columns from `first` to before `stop`.

    Args:
        W: Compliance [m/N], shape (n, n).
        first: The first row that is left out.
        stop: The first one after it that is not.
    """
    gone = stop - first
    kept = np.empty((len(W) - gone, len(W) - gone))
    for i in range(len(kept)):
        row = i if i < first else i + gone
        for j in range(len(kept)):
            kept[i, j] = W[row, j if j < first else j + gone]
    return kept
