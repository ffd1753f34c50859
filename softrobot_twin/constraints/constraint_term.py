"""What every constraint term declares: cables, effectors and contacts today, cavities next.

A constraint term contributes rows H and values δ to the condensed system (Coevoet 2017, eq. 2-4).
A step treats all terms alike: it stacks their rows (`row_stack.py`), adds their geometric
stiffness, and asks each of them how far a linearization of it holds.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar, Literal, Protocol

import numpy as np

Group = Literal["actuators", "effectors", "contacts"]
"""What the rows of a term are for in the condensed problem."""


class ConstraintTerm(Protocol):
    """Rows of H and values of δ of all constraints of one kind.

    Attributes:
        name: What the term is called in reports.
        group: What its rows are for.
        varies: Whether its rows differ from state to state: then the term is a `VaryingTerm`.
        row_count: Number of its rows k.
        row_capacity: Rows that there is memory for, at least k.
        entry_capacity: Entries of H that there is memory for.
        entry_rows: Row of each entry of H, from 0, shape (entry_count,).
        entry_nodes: Unknown of each entry, shape (entry_count,).
        reached_nodes: Unknowns that its rows may touch, in any state.
        scales: Natural scale of each row, by which its violation is judged: for instance the
            length of a cable at rest [unit of δ], shape (k,).
    """

    name: str
    group: ClassVar[Group]
    varies: ClassVar[bool]
    row_count: int
    row_capacity: int
    entry_capacity: int
    entry_rows: np.ndarray
    entry_nodes: np.ndarray
    reached_nodes: np.ndarray
    scales: np.ndarray

    def stencils(self) -> np.ndarray:
        """Unknowns that its geometric stiffness couples, -1 where none.

        Returns:
            One line for each coupled set, shape (stencil_count, width); without lines where the
            term has no stiffness, or none outside the pattern of the force terms.
        """

    def bind(self, elimination_rank: np.ndarray, slots: Callable) -> None:
        """Look up where the geometric stiffness goes; called once, before the first evaluation.

        Args:
            elimination_rank: Place of each unknown in the elimination order.
            slots: The factorization's `slots`.
        """

    def evaluate(self, positions: np.ndarray, blocks: np.ndarray, values: np.ndarray) -> None:
        """Write H and δ at a state.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            blocks: Entries of H, shape (entry_count, 3); overwritten.
            values: δ [unit of δ], shape (k,); overwritten.
        """

    def add_stiffness(
        self, positions: np.ndarray, multipliers: np.ndarray, storage: np.ndarray,
        projected: bool = False,
    ) -> None:
        """Add the geometric stiffness -λ ∂H/∂q of rows that carry load.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            multipliers: λ of its rows at this state [N], shape (k,).
            storage: The factorization's storage [N/m]; added to.
            projected: True for a part of it that is never negative.
        """

    def largest_share(self, positions: np.ndarray, move: np.ndarray) -> float:
        """How much of a move may be made before the linearization of these rows fails.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            move: Displacement of the unknowns [m], shape (free_node_count, 3).

        Returns:
            A share of the move, at most one.
        """


class VaryingTerm(ConstraintTerm, Protocol):
    """A constraint term whose rows are found anew at every state, as those of contacts are.

    Attributes:
        last_multipliers: λ that the rows detected last had in the last solution [N], zero for new
            ones, shape (k,).
    """

    last_multipliers: np.ndarray

    def begin_step(self, positions: np.ndarray, velocities: np.ndarray, time_step: float) -> None:
        """Look at the state where a step begins.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            velocities: Of the unknowns [m/s], shape (free_node_count, 3), or without rows.
            time_step: The step's duration [s].
        """

    def detect(self, positions: np.ndarray) -> None:
        """Find which rows there are at a state; row_count, entry_rows and entry_nodes change.

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """

    def remember(self, multipliers: np.ndarray) -> None:
        """Keep the solution of the rows detected last, where the next solution begins.

        Args:
            multipliers: λ [N], shape (k,).
        """

    def forget(self) -> None:
        """Forget all solutions, as if nothing had been solved before."""
