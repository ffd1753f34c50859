"""The straight way to a target that is far."""

from __future__ import annotations

import numpy as np


def approach(positions: np.ndarray, aims: np.ndarray, reach: float) -> np.ndarray:
    """The nearest points to the aims that lie within reach.

    A far target would drive every cable at its own rate limit, and the effector beside the line
    to it. Starting from where the effectors are, and not from the last aims, what cannot be
    reached winds nothing up.

    Args:
        positions: Where the effectors are [m], shape (effector_count, 3).
        aims: Where they should go [m], same shape; NaN rows stay NaN.
        reach: How far to go at once [m]; infinite goes all the way.

    Returns:
        Points on the lines to the aims [m], same shape.
    """
    ways = aims - positions
    distances = np.linalg.norm(ways, axis=1, keepdims=True)
    far = distances > reach
    shares = np.divide(reach, distances, out=np.ones_like(distances), where=far)
    return np.where(far, positions + shares * ways, aims)
