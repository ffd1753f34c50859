"""The rows of all constraint terms, one below the other, in named groups.

Terms write into memory that the stack allocates once. Rows that vary (contacts) are below the
constant ones; the memory grows when they need more. Terms write their entries at points. Entries at
points without unknowns of their own (on free rigid bodies) are transformed to the unknowns of the
body.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from softrobot_twin.constraints.constraint_term import ConstraintTerm
from softrobot_twin.geometry.vector_arrays import are_same, copy_vectors
from softrobot_twin.kernels.compilation import KERNEL, njit
from softrobot_twin.mechanics.held_axes import leave_free
from softrobot_twin.mechanics.kinematics import CarriedPoints, CarriedRows


class RowGroups(NamedTuple):
    """Rows of each group, which are contiguous; an empty slice for a group without rows.

    Attributes:
        actuators: Rows whose multipliers are efforts of actuators.
        effectors: Rows with targets; their multipliers are zero.
        contacts: Rows of contacts, normal ones and those of friction.
    """

    actuators: slice
    effectors: slice
    contacts: slice


class DisplacementRows(NamedTuple):
    """∂δ/∂q of actuators whose forces are not its transpose, because of friction.

    Attributes:
        actuators: The rows of H that they belong to, shape (n,).
        row_index: Row of each entry, from 0 to n - 1, shape (entry_count,).
        node_index: Unknown of each entry, same shape.
        blocks: The entries, shape (entry_count, 3).
    """

    actuators: np.ndarray
    row_index: np.ndarray
    node_index: np.ndarray
    blocks: np.ndarray


class RowStack:
    """Rows H and values δ of several terms.

    Attributes:
        terms: The terms, in the order of their rows.
        groups: The rows of each group.
        constant_terms: Each term whose rows do not vary, and its rows.
        varies: Whether the rows of a term vary from state to state.
        row_count: Number of rows.
        row_index: Row of each entry of H, shape (entry_count,).
        node_index: Unknown of each entry, shape (entry_count,).
        blocks: Entries of H, shape (entry_count, 3).
        values: δ of every row at the state evaluated last, shape (row_count,).
        told: Efforts of the actuators of terms that take efforts, whose forces are part of the force terms;
            zero for other actuators, shape (actuator_row_count,). None without such a term.
        may_know: Whether rows follow from the positions alone; then `knows` tells of which.
        is_told: Whether each actuator is of a term that takes efforts, shape (actuator_row_count,). None
            without such a term.
        reached_nodes: Unknowns with entries in the rows, in any state.
    """

    def __init__(
        self, terms: Sequence[ConstraintTerm], points: CarriedPoints | None = None,
        free_axes: np.ndarray | None = None,
    ):  # fmt: skip
        """Allocate.

        Args:
            terms: The terms, in the order of their groups; those whose rows vary come last.
            points: The carried points of the scene; None without any.
            free_axes: See `Nodes.free_axes`.

        Raises:
            ValueError: The rows of a term vary that is not in the last group.
        """
        self.terms, self._free_axes = tuple(terms), free_axes
        self._varying = tuple(term for term in self.terms if term.varies)
        self.varies = bool(self._varying)
        last = RowGroups._fields[-1]
        if any(term.group != last for term in self._varying):
            raise ValueError(f"only terms of the last group, {last}, may have rows that vary")
        reached = np.concatenate([np.empty(0, np.int64), *(term.reached_nodes for term in self.terms)])
        self._carried = self._elsewhere = None
        if points is not None and (reached >= points.free_count).any():
            self._carried = CarriedRows(points, self._entry_room)
            own = reached[reached < points.free_count]
            reached = np.concatenate([own, points.unknowns[points.unknowns >= 0]])
        self.reached_nodes = np.unique(reached)
        self._make_room()
        self.constant_terms = constant = [(term, rows) for term, _, rows in self._constant_parts]
        self._told_parts = [(term, rows) for term, rows in constant if term.takes_efforts]
        self._showing = next((one for one in constant if one[0].shows_contacts), None)
        self._yielding = [(term, rows) for term, rows in constant if term.yields]
        self.told = self.is_told = None
        # Rows that follow from the positions alone are evaluated once at a state.
        self._at: np.ndarray | None = None
        self.may_know = self.is_traceable and not (self.varies or self._told_parts or self._yielding)
        if self._told_parts:
            self.told = np.zeros(self.groups.actuators.stop)
            self.is_told = np.zeros(self.groups.actuators.stop, bool)
            for _, rows in self._told_parts:
                self.is_told[rows] = True

    @property
    def is_traceable(self) -> bool:
        """Whether `evaluate` and `add_stiffness` may be traced; see `traced_stage.py`."""
        is_carried = self._carried is not None and not self._carried.points.is_traceable
        return not is_carried and all(getattr(term, "is_traceable", False) for term in self.terms)

    @property
    def reaches_carried_points(self) -> bool:
        """Whether rows act at points of free rigid bodies."""
        return self._carried is not None

    @property
    def _entry_room(self) -> int:
        return sum(term.entry_capacity for term in self.terms)

    @property
    def row_capacity(self) -> int:
        """Greatest number of rows that the memory can hold, with those of `displacement_rows`."""
        more = sum(term.row_count for term in self.terms if hasattr(term, "displacement_entries"))
        return sum(term.row_capacity for term in self.terms) + more

    def _make_room(self) -> None:
        self._room = self._entry_room
        self._rows = np.zeros(self._room, np.int64)
        self._nodes = np.zeros(self._room, np.int64)
        self._blocks = np.zeros((self._room, 3))
        self._constant_parts, groups, row, entry = [], [], 0, 0
        for name in RowGroups._fields:
            first = row
            for term in self.terms:
                if term.group == name and not term.varies:
                    row, entry = self._place(term, row, entry, self._constant_parts)
            groups.append(slice(first, row))
        self._constant_groups, self._constant_entries = RowGroups(*groups), entry
        self._sizes: list[tuple[int, int]] | None = None
        self._lay_out()

    def _place(self, term: ConstraintTerm, row: int, entry: int, parts: list) -> tuple[int, int]:
        """Give a term its rows and entries; gives the first ones behind them."""
        end, rows = self._write_entries(term, row, entry), slice(row, row + term.row_count)
        parts.append((term, self._blocks[entry:end], rows))
        return rows.stop, end

    def _write_entries(self, term: ConstraintTerm, row: int, entry: int) -> int:
        """Write where the entries of a term are; gives the first one behind them."""
        rows = term.entry_rows
        end = entry + len(rows)
        np.add(rows, row, out=self._rows[entry:end])
        self._nodes[entry:end] = term.entry_nodes
        return end

    def _lay_out(self) -> None:
        """Give each term whose rows vary its rows and entries, as many as it has now."""
        sizes = [(term.row_count, len(term.entry_rows)) for term in self._varying]
        if sizes == self._sizes:
            entry = self._constant_entries
            for term, _, rows in self._parts[len(self._constant_parts) :]:
                entry = self._write_entries(term, rows.start, entry)
            return
        self._sizes = sizes
        self.groups, self._parts = self._constant_groups, self._constant_parts.copy()
        first = row = self.groups.contacts.start
        entry = self._constant_entries
        for term in self._varying:
            row, entry = self._place(term, row, entry, self._parts)
        if self._varying:
            self.groups = RowGroups(self.groups.actuators, self.groups.effectors, slice(first, row))
        # Other arrays tell the driver that its traces do not hold any more.
        self.values, self._multipliers, self._exceeding = np.zeros((3, row))
        self.row_count = row
        self._written = self._rows[:entry], self._nodes[:entry], self._blocks[:entry]
        self.row_index, self.node_index, self.blocks = self._written

    def lag(self, positions: np.ndarray) -> bool:
        """Whether bodies do not yet follow a prescribed move; see `VaryingTerm.lags`.

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        return any(term.lags(positions) for term in self._varying)

    def ask_again(self, positions: np.ndarray) -> bool:
        """Whether a prescribed move asks for one more linearization; see `VaryingTerm.asks_again`.

        Args:
            positions: Node positions after the move [m], shape (node_count, 3).
        """
        return any(term.asks_again(positions) for term in self._varying)

    @property
    def press_from_afar(self) -> bool:
        """See `VaryingTerm.presses_from_afar`."""
        return any(term.presses_from_afar for term in self._varying)

    def detect(self, positions: np.ndarray) -> None:
        """Detect the rows of all terms at a state.

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        for term in self._varying:
            term.detect(positions)
        if self._entry_room > self._room:
            self._make_room()
        else:
            self._lay_out()

    def choose_stiffness(self, is_prescribed: bool) -> None:
        """Choose the stiffness of terms whose rows vary; see `VaryingTerm.choose_stiffness`."""
        for term in self._varying:
            term.choose_stiffness(is_prescribed)

    def limit_stiffness(self, is_limited: bool) -> None:
        """Choose how much of it is added; see `VaryingTerm.limit_stiffness`."""
        for term in self._varying:
            term.limit_stiffness(is_limited)

    @property
    def may_be_negative(self) -> bool:
        """Whether `limit_stiffness` changes the stiffness of a term."""
        return any(term.may_be_negative for term in self._varying)

    def evaluate(self, positions: np.ndarray) -> None:
        """Evaluate the rows of all terms at a state.

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        if self.may_know:
            if self._at is None:
                self._at = np.empty_like(positions)
            copy_vectors(positions, self._at)
        for term, blocks, rows in self._parts:
            term.evaluate(positions, blocks, self.values[rows])
        if self._carried is not None:
            carried, count = self._carried, self._carried.reduce(positions, *self._written)
            if len(self.blocks) != count or self.blocks.base is not carried.blocks:
                self.row_index = carried.row_index[:count]
                self.node_index = carried.node_index[:count]
                self.blocks = carried.blocks[:count]
        if self._free_axes is not None:
            leave_free(self.node_index, self._free_axes, self.blocks)

    def knows(self, positions: np.ndarray) -> bool:
        """Whether the rows are those at some node positions [m], shape (node_count, 3).

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        return self._at is not None and are_same(positions, self._at)

    def actuator_blocks_at(self, positions: np.ndarray) -> np.ndarray:
        """Entries of the actuators' rows at another state, which come first in `blocks`.

        Nothing is stored. The carried points of the rows, if any, are those of reduced bodies.

        Args:
            positions: Node positions [m], shape (node_count, 3).

        Returns:
            Shape (actuator_entry_count, 3).
        """
        parts = [part for part in self._parts if part[0].group == "actuators"]
        blocks, values = np.empty((sum(len(own) for _, own, _ in parts), 3)), np.empty(self.row_count)
        entry = 0
        for term, own, rows in parts:
            entries = slice(entry, entry + len(own))
            term.evaluate(positions, blocks[entries], values[rows])
            entry = entries.stop
        if self._carried is None:
            return blocks
        if self._elsewhere is None:
            self._elsewhere = CarriedRows(self._carried.points, self._entry_room)
        written, nodes, _ = self._written
        count = self._elsewhere.reduce(positions, written[:entry], nodes[:entry], blocks)
        return self._elsewhere.blocks[:count].copy()

    @property
    def actuator_entry_count(self) -> int:
        """Entries of the actuators' rows at the state evaluated last, which come first."""
        return int(np.count_nonzero(self.row_index < self.groups.actuators.stop))

    def tell_efforts(self, efforts: np.ndarray) -> None:
        """Set the efforts at which terms that take efforts or yield are evaluated.

        Args:
            efforts: λ of all rows, or of the actuators, each in its unit.
        """
        for term, rows in self._told_parts:
            self.told[rows] = efforts[rows]
            term.tell_efforts(efforts[rows])
        for term, rows in self._yielding:
            term.tell_efforts(efforts[rows])

    def own_compliance(self) -> np.ndarray | None:
        """∂δ/∂λ of the actuators at held unknowns, shape (actuator_row_count, same).

        Returns:
            The compliance at the state evaluated last; None where no term takes efforts or yields.
        """
        parts = (*self._told_parts, *self._yielding)
        if not parts:
            return None
        count = self.groups.actuators.stop
        compliance = np.zeros((count, count))
        for term, rows in parts:
            compliance[rows, rows] = term.compliance
        return compliance

    def by_contacts(self) -> tuple:
        """Rows that show contact forces, and their change by those; see `ConstraintTerm`. Empty without any."""
        if self._showing is None:
            return ()
        term, rows = self._showing
        own = term.contact_rows
        return slice(rows.start + own.start, rows.start + own.stop), term.by_contacts()

    def stretch_compliance(self) -> np.ndarray:
        """Compliance of each actuator row of a term that yields, zero for the others.

        Returns:
            Of the state evaluated last, shape (actuator_row_count,). Where no term yields, all are
            zero, and a path does not depend on its effort.
        """
        compliance = np.zeros(self.groups.actuators.stop)
        for term, rows in self._yielding:
            compliance[rows] = term.compliance.diagonal()
        return compliance

    def actuator_paths(self, efforts: np.ndarray) -> np.ndarray:
        """Displacements of the actuators at the state evaluated last, with what stretches.

        Args:
            efforts: λ of the actuators with rows, in their units, shape (actuator_row_count,).

        Returns:
            Each in its unit, same shape.
        """
        # What does not stretch moves as its path does.
        stretch = self.stretch_compliance()
        return self.values[self.groups.actuators] + stretch * efforts

    def stretch_ratios(self) -> np.ndarray:
        """By how much more the path of each actuator moves than its winch; see `ConstraintTerm.yields`.

        Returns:
            At the told efforts, one without stretch, shape (actuator_row_count,).
        """
        ratios = np.ones(self.groups.actuators.stop)
        for term, rows in self._yielding:
            ratios[rows] = term.stretch_ratios
        return ratios

    def multipliers(self, efforts: np.ndarray) -> np.ndarray:
        """λ of all rows in the last solution [N], shape (row_count,); the next call overwrites it.

        Args:
            efforts: λ of the actuators; those without rows come last [N],
                shape (actuator_count,).
        """
        multipliers, actuators = self._multipliers, self.groups.actuators
        multipliers[:] = 0.0
        multipliers[actuators] = efforts[actuators]
        for term, _, rows in self._parts:
            if term.varies:
                multipliers[rows] = term.last_multipliers
        return multipliers

    def displacement_rows(self) -> DisplacementRows | None:
        """Rows of displacements that are not those of forces, at the state evaluated last.

        Returns:
            They; None without a term that has them, such as cables with friction.
        """
        if not self._told_parts:
            return None
        rows, own, nodes, blocks = [], [], [], []
        for term, part in self._told_parts:
            if hasattr(term, "displacement_entries"):
                own.append(np.arange(part.start, part.stop))
                entries = term.displacement_entries()
                rows.append(entries[0] + sum(len(o) for o in own[:-1]))
                nodes.append(entries[1])
                blocks.append(entries[2])
        if not own:
            return None
        return DisplacementRows(
            np.concatenate(own), np.concatenate(rows), np.concatenate(nodes),
            np.concatenate(blocks),
        )  # fmt: skip

    def add_stiffness(
        self, positions: np.ndarray, multipliers: np.ndarray, storage: np.ndarray,
        projected: bool = False,
    ) -> None:
        """Add the geometric stiffness of all terms; see `ConstraintTerm.add_stiffness`.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            multipliers: λ of all rows [N], shape (row_count,).
            storage: The factorization's storage [N/m]; added to.
            projected: True for a part of it that is never negative.
        """
        for term, _, rows in self._parts:
            term.add_stiffness(positions, multipliers[rows], storage, projected)

    def largest_share(self, positions: np.ndarray, move: np.ndarray) -> float:
        """Least share of a move over all terms; see `ConstraintTerm.largest_share`."""
        share = 1.0
        for term in self.terms:
            share = min(share, term.largest_share(positions, move))
        return share

    def remember(self, multipliers: np.ndarray) -> None:
        """Store the solution of terms whose rows vary.

        Args:
            multipliers: λ of all rows [N], shape (row_count,).
        """
        for term, _, rows in self._parts:
            if term.varies:
                term.remember(multipliers[rows])

    def forget(self) -> None:
        """Clear the stored solutions of all terms."""
        for term in self._varying:
            term.forget()

    def add_forces(self, multipliers: np.ndarray, forces: np.ndarray) -> None:
        """Add Hᵀ λ of the rows evaluated last to the forces on the unknowns.

        Of a term that takes efforts, what its efforts exceed the told ones by.

        Args:
            multipliers: λ of every row [N], shape (row_count,).
            forces: Forces on the free nodes [N], shape (free_node_count, 3); added to.
        """
        if self.told is not None:
            _write_exceeding(multipliers, self.told, self._exceeding)
            multipliers = self._exceeding
        add_row_forces(self.row_index, self.node_index, self.blocks, multipliers, forces)


@njit(**KERNEL)
def _write_exceeding(multipliers, told, exceeding):
    """Write what multipliers, shape (row_count,), exceed the told ones of the first rows by."""
    for r in range(len(multipliers)):
        exceeding[r] = multipliers[r] - told[r] if r < len(told) else multipliers[r]


@njit(**KERNEL)
def add_row_forces(row_index, node_index, blocks, multipliers, forces):
    """Add each entry of H times its row's multiplier to its node's force.

    Args:
        row_index: Row of each entry of H, shape (entry_count,).
        node_index: Unknown of each entry, same shape.
        blocks: Entries of H, shape (entry_count, 3).
        multipliers: λ of every row [N], shape (row_count,).
        forces: Forces on the unknowns [N], shape (free_node_count, 3); added to.
    """
    for entry in range(len(row_index)):
        node, multiplier = node_index[entry], multipliers[row_index[entry]]
        for axis in range(3):
            forces[node, axis] += blocks[entry, axis] * multiplier
