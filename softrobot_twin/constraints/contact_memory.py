"""Forces of the last step, found again by their contacts' keys: where the next solution begins."""

from __future__ import annotations

import numpy as np


class ContactMemory:
    """Remembers λ of contacts, whatever row they stand in.

    Attributes:
        known: Pair and key of the contacts recognised last.
        guess: λ that the contacts recognised last had before, 0 for new ones [N],
            shape (row_count,).
    """

    def __init__(self, rows_per_contact: int):
        """Know nothing.

        Args:
            rows_per_contact: Rows of one contact.
        """
        self._rows = rows_per_contact
        self.forget()

    def forget(self) -> None:
        """Know nothing again."""
        self._before: list[tuple[int, int]] = []
        self.known: list[tuple[int, int]] = []
        self._multipliers = np.zeros((1, self._rows))
        self.guess = np.zeros(0)

    def recognise(self, pairs: np.ndarray, keys: np.ndarray) -> None:
        """Look up contacts.

        Args:
            pairs: Pair that each belongs to, shape (count,).
            keys: Its key in the pair, shape (count,).
        """
        self.known = list(zip(pairs.tolist(), keys.tolist(), strict=True))
        if self.known == self._before:
            self.guess = self._multipliers[:-1].flatten()
            return
        before = dict(zip(self._before, range(len(self._before)), strict=True))
        # What is new is given the last row, which is zero.
        places = [before.get(key, -1) for key in self.known]
        self.guess = self._multipliers[np.array(places, np.int64)].ravel()

    def remember(self, multipliers: np.ndarray) -> None:
        """Take in λ of the contacts recognised last [N], shape (row_count,)."""
        self._multipliers = np.zeros((len(self.known) + 1, self._rows))
        self._multipliers[:-1] = multipliers.reshape(-1, self._rows)
        self._before = self.known
