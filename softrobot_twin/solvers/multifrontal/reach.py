"""Which fronts the constraints reach: those of their nodes, and all ancestors of these."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softrobot_twin.solvers.multifrontal.elimination_tree import NONE
from softrobot_twin.solvers.multifrontal.symbolic import Elimination


class Reach(NamedTuple):
    """The part of the tree in which L⁻¹Hᵀ is not zero.

    Attributes:
        places: Row of Y at which each node of a reached front begins, -1 in other fronts, by
            rank, shape (node_count,).
        dof_count: Rows of Y.
    """

    places: np.ndarray
    dof_count: int


def reach_from(elimination: Elimination, ranks: np.ndarray) -> Reach:
    """Follow the tree from some nodes, given by rank, to the roots."""
    reached = np.zeros(len(elimination.parent), dtype=bool)
    for front in np.unique(elimination.front[ranks]):
        while front != NONE and not reached[front]:
            reached[front] = True
            front = elimination.parent[front]
    in_reach = reached[elimination.front]
    count = int(np.count_nonzero(in_reach))
    places = np.full(len(in_reach), NONE)
    places[in_reach] = 3 * np.arange(count)
    return Reach(places, 3 * count)
