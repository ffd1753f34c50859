"""The contract of a constraint term."""

from __future__ import annotations

from typing import Protocol

import numpy as np


class ConstraintTerm(Protocol):
    """Rows of H and values of δ of all constraints of one kind.

    Attributes:
        name: What the term is called in reports.
        row_count: Number of its rows k.
        entry_rows: Row of each entry, from 0, shape (entry_count,).
        entry_nodes: Free node of each entry, shape (entry_count,).
    """

    name: str
    row_count: int
    entry_rows: np.ndarray
    entry_nodes: np.ndarray

    def evaluate(self, positions: np.ndarray, blocks: np.ndarray, values: np.ndarray) -> None:
        """Write H and δ at a state.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            blocks: Entries of H, shape (entry_count, 3); overwritten.
            values: δ [m], shape (row_count,); overwritten.
        """
