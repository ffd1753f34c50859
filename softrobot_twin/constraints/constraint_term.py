"""The protocol of all constraint terms, such as cables, effectors and contacts.

A constraint term contributes rows H and values δ to the condensed system (Coevoet 2017, eq. 2-4).
A step treats all terms alike: it stacks their rows (`row_stack.py`), adds their geometric
stiffness, and limits its displacement to the share for which each linearization is valid.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar, Literal, Protocol

import numpy as np

from softrobot_twin.mechanics.force_term import DenseRows
from softrobot_twin.mechanics.kinematics import Nodes

# Entries of a row below this share of it are round-off.
ROUND_OFF = 1.0e-12

Group = Literal["actuators", "effectors", "contacts"]
"""What the rows of a term are for in the condensed problem."""


class ConstraintTerm(Protocol):
    """Rows of H and values of δ of all constraints of one kind.

    Terms inherit from this class. What a term does not define keeps the default below: the same rows
    and entries in all states, for which memory is allocated, and no geometric stiffness.

    Attributes:
        name: Name of the term in reports.
        group: Purpose of its rows.
        varies: Whether its rows differ from state to state: then the term is a `VaryingTerm`.
        is_traceable: Whether `evaluate` and `add_stiffness` do nothing with numbers but by kernels;
            see `traced_stage.py`.
        conserves: Whether equilibria at held values of its rows are minima of an energy.
        loss: What it does that conserves no energy, in words; else empty.
        yields: Whether its rows yield to their efforts, as cables that stretch. Then its values δ(q) are
            those without efforts, with them they are δ(q) + C λ, and its forces are Hᵀ λ as of other
            terms. It has `stretch_ratios`, shape (k,): by how much more the path moves than its winch,
            exactly: where the winch turns by dδ, H dq + C dλ is this many times dδ.
        takes_efforts: Whether its rows depend on its efforts, as of cavities with walls of their own.
            Then a force term holds the forces of its efforts, and its rows only what a change of them
            adds. Where friction makes ∂δ/∂q another matrix than H, it has a method
            `displacement_entries` that gives its entries: their rows, unknowns and blocks.
        shows_contacts: Whether rows of it, of effectors, are sums of contact forces, and no change of the
            unknowns alone changes them. Then `contact_rows` are these rows, a slice, and its method
            `by_contacts` gives their change by λ of the contacts detected last; its values are those of the
            last solution.
        compliance: C = ∂δ/∂λ at held unknowns, at the state evaluated last and the told efforts
            [unit of δ / unit of λ], shape (k, k), symmetric; of terms that yield diagonal, so that C λ
            is exact. Only terms that yield or take efforts have it.
        dense_rows: The part of the geometric stiffness that is not assembled, at the state where it
            was added last; None where there is never any.
        memory_name: Under which name a state holds what it remembers, see `step_part`; else empty.
        row_count: Number of its rows k.
        entry_rows: Row of each entry of H, from 0, shape (entry_count,).
        entry_nodes: Unknown of each entry, shape (entry_count,).
        scales: Natural scale of each row of an actuator: for instance the length of a cable at rest
            [unit of δ], shape (k,).
    """

    name: str
    group: ClassVar[Group]
    varies: ClassVar[bool] = False
    is_traceable: ClassVar[bool] = False
    conserves: ClassVar[bool] = True
    loss: ClassVar[str] = ""
    yields: ClassVar[bool] = False
    takes_efforts: ClassVar[bool] = False
    shows_contacts: bool = False
    contact_rows: slice
    compliance: np.ndarray
    dense_rows: DenseRows | None = None
    memory_name: ClassVar[str] = ""
    row_count: int
    entry_rows: np.ndarray
    entry_nodes: np.ndarray
    scales: np.ndarray

    def __init_subclass__(cls, **options) -> None:
        """Each class says itself whether it is traceable: it may have other methods."""
        super().__init_subclass__(**options)
        cls.is_traceable = vars(cls).get("is_traceable", False)

    @property
    def row_capacity(self) -> int:
        """Number of rows that memory is allocated for, at least k."""
        return self.row_count

    @property
    def entry_capacity(self) -> int:
        """Number of entries of H that memory is allocated for."""
        return len(self.entry_rows)

    @property
    def reached_nodes(self) -> np.ndarray:
        """Unknowns with entries in its rows, in any state, some of them repeated."""
        return self.entry_nodes

    def stencils(self) -> np.ndarray:
        """Unknowns that its geometric stiffness couples, -1 where none.

        Returns:
            One line for each coupled set, shape (stencil_count, width); without lines where the
            term has no stiffness, or none outside the pattern of the force terms.
        """
        return np.empty((0, 1), np.int64)

    def bind(self, elimination_rank: np.ndarray, slots: Callable) -> None:
        """Find the places of the geometric stiffness in the storage; called once, before the first
        evaluation.

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

    def rows_at(self, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """H and the values δ at a state, as `evaluate` writes them.

        Args:
            positions: Node positions [m], shape (node_count, 3).

        Returns:
            Entries of H, shape (entry_count, 3), and δ, shape (row_count,).
        """
        blocks, values = np.empty((len(self.entry_rows), 3)), np.empty(self.row_count)
        self.evaluate(positions, blocks, values)
        return blocks, values

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

    def lacking_stiffness(self, positions: np.ndarray, multipliers: np.ndarray, size: int):
        """What `add_stiffness` leaves out because it is not symmetric, for derivatives at rest.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            multipliers: λ of its rows at this state [N], shape (k,).
            size: Number of coordinates of the unknowns.

        Returns:
            A sparse matrix, shape (size, size); None for nothing.
        """
        return None

    def clear_dense_rows(self) -> None:
        """Have no dense rows until stiffness is added again; see `ForceTerm.clear_dense_rows`."""

    def add_row_stiffness(self, positions: np.ndarray, stiffness: np.ndarray, storage: np.ndarray) -> DenseRows | None:
        """Add Hᵀ ρ H, with as much more as makes it fit into the blocks of the stiffness.

        Only of terms that hold displacements beside which a tangent is augmented.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            stiffness: ρ of its rows, shape (k,).
            storage: The factorization's storage [N/m]; added to.

        Returns:
            What has to be added to what was added; None for nothing.
        """
        raise NotImplementedError

    def tell_efforts(self, efforts: np.ndarray) -> None:
        """Set the efforts at which the rows and the compliance are evaluated from now on.

        Args:
            efforts: λ of its rows, shape (k,).
        """

    def largest_share(self, positions: np.ndarray, move: np.ndarray) -> float:
        """Share of a move for which the linearization of these rows is valid.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            move: Displacement of the unknowns [m], shape (free_node_count, 3).

        Returns:
            A share of the move, at most one.
        """
        return 1.0


class VaryingTerm(ConstraintTerm, Protocol):
    """A constraint term whose rows are detected at every state, such as contacts.

    Attributes:
        last_multipliers: λ of the present rows in the last solution [N], zero for new rows, shape
            (k,).
        presses_from_afar: Whether rows bear load in the last solution that were detected so far away
            that other ones may bear it where the bodies came to.
        may_be_negative: Whether `limit_stiffness` changes the stiffness of the present rows.
    """

    last_multipliers: np.ndarray
    presses_from_afar: bool = False
    may_be_negative: bool

    def begin_step(self, positions: np.ndarray, velocities: np.ndarray, time_step: float) -> None:
        """Read the state at the beginning of a step.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            velocities: Of the unknowns [m/s], shape (free_node_count, 3), or without rows.
            time_step: The step's duration [s].
        """

    def lags(self, positions: np.ndarray) -> bool:
        """Whether rows of before a prescribed move are violated: bodies do not yet follow it.

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        return False

    def asks_again(self, positions: np.ndarray) -> bool:
        """Whether a prescribed move asks for one more linearization; after `remember`.

        Args:
            positions: Node positions after the move [m], shape (node_count, 3).
        """
        return False

    def detect(self, positions: np.ndarray) -> None:
        """Detect the rows at a state; sets row_count, entry_rows and entry_nodes.

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """

    def choose_stiffness(self, is_prescribed: bool) -> None:
        """Choose what the geometric stiffness is to be good for.

        Args:
            is_prescribed: True where the displacements of the actuators are prescribed, and W is
                only to lead to an equilibrium; False where W decides what is best.
        """

    def limit_stiffness(self, is_limited: bool) -> None:
        """Choose how much of the geometric stiffness is added.

        Args:
            is_limited: True for a part of it that is never negative, False for the whole.
        """

    def remember(self, multipliers: np.ndarray) -> None:
        """Store the solution of the present rows as the start of the next one.

        Args:
            multipliers: λ [N], shape (k,).
        """

    def forget(self) -> None:
        """Clear all stored solutions."""


def rows_that_move_nothing(term: ConstraintTerm, nodes: Nodes) -> np.ndarray:
    """Rows that act at rest on nodes that are fixed, or only along axes that are held.

    Args:
        term: The term.
        nodes: The nodes.

    Returns:
        Their indices.
    """
    sizes, (blocks, _) = np.zeros((2, term.row_count)), term.rows_at(nodes.rest_positions)
    np.add.at(sizes[0], term.entry_rows, np.abs(blocks).sum(axis=1))
    if nodes.free_axes is not None:
        own = np.flatnonzero(term.entry_nodes < nodes.free_node_count)
        blocks[own] *= nodes.free_axes[term.entry_nodes[own]]
    np.add.at(sizes[1], term.entry_rows, np.abs(blocks).sum(axis=1))
    idle = sizes[1] <= ROUND_OFF * sizes[0]
    if term.shows_contacts:
        idle[term.contact_rows] = False
    return np.flatnonzero(idle)
