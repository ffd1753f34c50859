"""Forces of the last step, found again by their contacts' keys: where the next solution begins."""

from __future__ import annotations

import numpy as np


class ContactMemory:
    """Remembers λ of contacts, whatever row they stand in.

    Attributes:
        known: Pair and key of the contacts recognised last.
        guess: λ that the contacts recognised last had before, 0 for new ones [N],
            shape (row_count,).
        expected: λ that they have if the step changes it as the step before did; within a step,
            after the first linearization, the same as the guess [N], shape (row_count,).
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
        # λ, λ where the step began, and its change in the step before: a row for each contact of
        # `_before`, and a last one, of zeros, for what is new.
        self._multipliers, self._at_start, self._change = np.zeros((3, 1, self._rows))
        self.guess = self.expected = self._start = np.zeros(0)

    def begin_step(self) -> None:
        """Note how λ changed in the step that is over."""
        self._change = self._multipliers - self._at_start
        self._at_start = self._multipliers

    def recognise(self, pairs: np.ndarray, keys: np.ndarray) -> None:
        """Look up contacts.

        Args:
            pairs: Pair that each belongs to, shape (count,).
            keys: Its key in the pair, shape (count,).
        """
        self.known = list(zip(pairs.tolist(), keys.tolist(), strict=True))
        places = slice(-1)
        if self.known != self._before:
            before = dict(zip(self._before, range(len(self._before)), strict=True))
            # What is new is given the last row, which is zero.
            places = np.array([before.get(key, -1) for key in self.known], np.int64)
        self.guess = self._multipliers[places].flatten()
        self.expected = self.guess + self._change[places].ravel()
        self._start = self._at_start[places].ravel()

    def remember(self, multipliers: np.ndarray) -> None:
        """Take in λ of the contacts recognised last [N], shape (row_count,)."""
        shape = len(self.known) + 1, self._rows
        self._multipliers, self._at_start, self._change = np.zeros((3, *shape))
        self._multipliers[:-1] = multipliers.reshape(-1, self._rows)
        self._at_start[:-1] = self._start.reshape(-1, self._rows)
        self._before = self.known
