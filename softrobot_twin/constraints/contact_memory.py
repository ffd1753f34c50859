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
        self._keys: dict[tuple[int, int], int] = {}
        self.known: list[tuple[int, int]] = []
        self._multipliers = np.zeros((0, self._rows))
        self.guess = np.zeros(0)

    def recognise(self, pairs: np.ndarray, keys: np.ndarray) -> None:
        """Look up contacts.

        Args:
            pairs: Pair that each belongs to, shape (count,).
            keys: Its key in the pair, shape (count,).
        """
        self.known = list(zip(pairs.tolist(), keys.tolist(), strict=True))
        guess = np.zeros((len(self.known), self._rows))
        known = self._keys
        for row, key in enumerate(self.known):
            before = known.get(key)
            if before is not None:
                guess[row] = self._multipliers[before]
        self.guess = guess.ravel()

    def remember(self, multipliers: np.ndarray) -> None:
        """Take in λ of the contacts recognised last [N], shape (row_count,)."""
        self._multipliers = multipliers.reshape(-1, self._rows).copy()
        self._keys = {key: row for row, key in enumerate(self.known)}
