"""Floating-point operations of a step's factorization and solves, counted on the fronts."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softrobot_twin.solvers.factorization import Factorization
from softrobot_twin.solvers.multifrontal import Multifrontal
from softrobot_twin.solvers.multifrontal.symbolic import NONE, reach_from


class FlopCount(NamedTuple):
    """Operations, an addition or a multiplication each.

    Attributes:
        factor: Of the numeric factorization.
        solves: Of Y = L⁻¹Hᵀ, y = L⁻¹b, W = YᵀY, and the solve back.
    """

    factor: float
    solves: float

    @property
    def total(self) -> float:
        """All of them."""
        return self.factor + self.solves


def flop_count(
    factorization: Factorization, row_nodes: np.ndarray, row_count: int
) -> FlopCount | None:
    """Counts, zeros inside fronts included, as they are computed with too.

    Args:
        factorization: The factorization.
        row_nodes: Free nodes that rows H touch.
        row_count: Rows of H.

    Returns:
        The counts; None for a factorization that has no fronts to count on.
    """
    if not isinstance(factorization, Multifrontal):
        return None
    fronts = factorization.layout.fronts
    rows, columns = fronts["rows"].astype(float), fronts["columns"].astype(float)
    # A column of height h costs h²: a root, h - 1 quotients, and h (h - 1) for the rest.
    factor = float(np.sum(_squares(rows) - _squares(rows - columns)))
    entries = _heights(rows) - _heights(rows - columns)
    ranks = factorization.elimination_rank[row_nodes]
    reach = reach_from(factorization.elimination, ranks)
    reached = reach.places[fronts["first_rank"]] != NONE
    # An entry of L is a multiplication and an addition for every right-hand side.
    forward = 2.0 * (row_count * entries[reached].sum() + entries.sum())
    gram = (row_count + 1) * (row_count + 2) * reach.dof_count
    return FlopCount(factor, float(forward + gram + 2.0 * entries.sum()))


def _squares(n: np.ndarray) -> np.ndarray:
    """1² + 2² + … + n²."""
    return n * (n + 1.0) * (2.0 * n + 1.0) / 6.0


def _heights(n: np.ndarray) -> np.ndarray:
    """1 + 2 + … + n."""
    return 0.5 * n * (n + 1.0)
