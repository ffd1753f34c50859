"""Vectors that are no longer than may be."""

from __future__ import annotations

import numpy as np

# Vectors below count as this long: a limit divided by it is finite.
_TINY = 1.0e-200


def shortened(vectors: np.ndarray, longest: float, per_unit: np.ndarray | float = 1.0) -> np.ndarray:
    """Vectors, those that are longer made as long as a limit.

    Args:
        vectors: The vectors, NaN rows stay NaN, shape (..., 3).
        longest: Greatest length.
        per_unit: What a unit of the vectors counts in that of the limit, shape (...).
    """
    lengths = np.maximum(np.linalg.norm(vectors, axis=-1) * per_unit, _TINY)
    return vectors * np.minimum(1.0, longest / lengths)[..., np.newaxis]
