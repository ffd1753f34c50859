"""How a time grows with size: the exponent p of t = c nᵖ."""

from __future__ import annotations

import numpy as np


def growth_exponent(sizes, times) -> float:
    """Slope of a straight line through (log size, log time), by least squares.

    Args:
        sizes: Sizes, above zero, shape (count,).
        times: Times, same shape; points without a positive time are left out.

    Returns:
        The exponent; NaN when fewer than two different sizes are left.
    """
    sizes, times = np.asarray(sizes, dtype=float), np.asarray(times, dtype=float)
    known = np.isfinite(times) & (times > 0.0)
    x, y = np.log(sizes[known]), np.log(times[known])
    if len(np.unique(x)) < 2:
        return float("nan")
    x = x - x.mean()
    return float(x @ (y - y.mean()) / (x @ x))
