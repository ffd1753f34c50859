"""The answer to a problem with complementarity, and what is known of it."""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple

import numpy as np


class Stationarity(Enum):
    """What is known of an answer."""

    STRONG = "strongly stationary: a local minimum"
    BOULIGAND = "B-stationary: a local minimum"
    SINGLE = "no change of a single contact lowers it"
    BUDGET = "the best when the budget ended"
    HELD = "the held actuation"


class ComplementaritySolution(NamedTuple):
    """An admissible answer.

    Attributes:
        unknowns: z, shape (n,).
        touching: Contacts whose gap is zero by choice of the piece, shape (contact_count,).
        solved: False when no program could be solved, and it is the held one for that reason.
        stationarity: What is known of it.
        objective: Objective of z.
        held_objective: Objective of the held z, never less where neither breaks a bound.
        force_excess: Excess over `force_max`, zero unless nothing else was admissible,
            shape (contact_count,).
        row_excess: By how much rows break their bounds, as above, shape (m,).
        programs: Quadratic programs solved.
        pivots: Changes of the piece that were kept.
        binding: Which bounds bind, see `optimum_by_guess`, shape (n - contact_count + m,).
    """

    unknowns: np.ndarray
    touching: np.ndarray
    solved: bool
    stationarity: Stationarity
    objective: float
    held_objective: float
    force_excess: np.ndarray
    row_excess: np.ndarray
    programs: int
    pivots: int
    binding: np.ndarray
