"""What touches what, as a step found it: a value for reports, pictures and messages."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class PairForces(NamedTuple):
    """Forces of each pair of bodies as a whole.

    Attributes:
        names: Names of both bodies of each pair, each pair once.
        resultants: Sum of the forces on the first body [N], shape (pair_count, 3); the second
            bears the opposite. Of a body with itself its two sides' forces cancel in part.
        magnitude_sums: Sum of the forces' magnitudes [N], shape (pair_count,): how hard the two are
            pressed together, also where they hold each other from several sides.
    """

    names: tuple[tuple[str, str], ...]
    resultants: np.ndarray
    magnitude_sums: np.ndarray


class ContactForces(NamedTuple):
    """Contacts that carry force.

    Attributes:
        positions: Where the first body is touched [m], shape (count, 3).
        forces: Force on the first body [N], shape (count, 3); the second bears the opposite.
        gaps: Distance there, negative where they overlap [m], shape (count,).
        pairs: Which pair of the scene each belongs to, an index into `names`, shape (count,).
        names: Names of both bodies of each pair that may touch.
    """

    positions: np.ndarray
    forces: np.ndarray
    gaps: np.ndarray
    pairs: np.ndarray
    names: tuple[tuple[str, str], ...]

    def of_pairs(self) -> PairForces:
        """Resultant and sum of magnitudes of every pair that may touch, zero where none does."""
        names = tuple(dict.fromkeys(self.names))
        place = np.array([names.index(pair) for pair in self.names], dtype=np.int64)[self.pairs]
        resultants, sums = np.zeros((len(names), 3)), np.zeros(len(names))
        np.add.at(resultants, place, self.forces)
        np.add.at(sums, place, np.linalg.norm(self.forces, axis=1))
        return PairForces(names, resultants, sums)
