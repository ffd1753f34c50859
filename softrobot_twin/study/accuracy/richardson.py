"""What a sequence of ever finer meshes tends to, and how sure that is (Richardson, Roache)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq, minimize_scalar

LOWEST_ORDER, HIGHEST_ORDER = 0.25, 6.0
"""An observed order outside is no order: the meshes are too coarse or too unlike each other."""
ASSUMED_ORDER = 1.0
"""Taken where none is observed: about what the edges and corners of a body leave, whatever the
element, and so on the safe side for elements that promise more."""


class Extrapolation(NamedTuple):
    """The limit of a sequence.

    Attributes:
        value: Best estimate of the limit, shape of the values.
        order: Observed order p of the error c hᵖ; NaN where none could be observed:
            `ASSUMED_ORDER` was taken, or, of two values, the finer for the limit.
        uncertainty: Norm of what the estimate may be wrong by, in the unit of the values.
    """

    value: np.ndarray
    order: float
    uncertainty: float


def observed_order(sizes: Sequence[float], values: Sequence[np.ndarray]) -> float:
    """Order p with which three values v = v∞ + c hᵖ approach their limit.

    With vectors, the norms of the two differences are compared.

    Args:
        sizes: Element sizes h of three meshes, falling.
        values: The values on them, each of the same shape.

    Returns:
        p; NaN when the differences fit none between `LOWEST_ORDER` and `HIGHEST_ORDER`.
    """
    coarse, middle, fine = (float(size) for size in sizes)
    far = float(np.linalg.norm(np.subtract(values[1], values[0])))
    near = float(np.linalg.norm(np.subtract(values[2], values[1])))
    if not (coarse > middle > fine > 0.0 and far > 0.0 and near > 0.0):
        return float("nan")

    def mismatch(order: float) -> float:
        a, b = (coarse / middle) ** order, (fine / middle) ** order
        return near * (a - 1.0) - far * (1.0 - b)

    if mismatch(LOWEST_ORDER) * mismatch(HIGHEST_ORDER) > 0.0:
        return float("nan")
    return float(brentq(mismatch, LOWEST_ORDER, HIGHEST_ORDER, xtol=1e-12))


def extrapolate(sizes: Sequence[float], values: Sequence[np.ndarray]) -> Extrapolation:
    """The limit of values on ever finer meshes.

    Order and limit are those of v∞ + c hᵖ that comes nearest to all values (least squares, a mesh
    weighing 1/h): meshes that are not cut from each other scatter about their trend, and three of
    them alone would often show no order. The uncertainty is the correction that was added to the
    finest value, or the scatter where that is larger; where no order was observed, no less than
    the last two values differ by.

    Args:
        sizes: Element sizes, falling, at least one.
        values: The values on them.
    """
    stacked = np.array([np.asarray(value, dtype=float).ravel() for value in values])
    shape, finest = np.shape(values[-1]), stacked[-1]
    if len(stacked) < 3:
        gap = np.linalg.norm(finest - stacked[-2]) if len(stacked) == 2 else np.nan
        return Extrapolation(finest.reshape(shape), float("nan"), float(gap))
    scaled = np.asarray(sizes, dtype=float) / sizes[-1]
    found = minimize_scalar(lambda order: _fit(scaled, stacked, order)[1], method="bounded",
                            bounds=(LOWEST_ORDER, HIGHEST_ORDER), options={"xatol": 1e-10})
    order = float(found.x)
    gap = 0.0
    if min(order - LOWEST_ORDER, HIGHEST_ORDER - order) < 1e-3:
        order, gap = float("nan"), float(np.linalg.norm(finest - stacked[-2]))
    limit, scatter = _fit(scaled, stacked, order if np.isfinite(order) else ASSUMED_ORDER)
    uncertainty = max(float(np.linalg.norm(limit - finest)), scatter, gap)
    return Extrapolation(limit.reshape(shape), order, uncertainty)


def _fit(sizes: np.ndarray, values: np.ndarray, order: float) -> tuple[np.ndarray, float]:
    """Limit for a given order, and the weighted scatter about the fit."""
    weights = (1.0 / sizes) / np.mean(1.0 / sizes)
    terms = np.column_stack([np.ones_like(sizes), sizes**order])
    root = np.sqrt(weights)[:, None]
    coefficients = np.linalg.lstsq(root * terms, root * values, rcond=None)[0]
    left = root * (values - terms @ coefficients)
    return coefficients[0], float(np.linalg.norm(left) / np.sqrt(len(sizes)))
