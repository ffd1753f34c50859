"""Contacts: rows along the normal and in the plane of touch (Coevoet 2017, eq. 4).

With x_a - x_b = Σ c_k x_k over the nodes that carry both points, and n the unit normal from b to a,

    δ_n = gap - contact distance,     H_n = c_k n
    δ_t = t · (Σ c_k x_k - (Σ c_k x_k) where the step began),     H_t = c_k t

Bodies that overlap are not parted at once, which would throw them: the gap asked for grows by
`push_out_speed` times the step's duration.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from enum import Enum

import numpy as np

from softrobot_twin.constraints.constraint_term import VaryingTerm
from softrobot_twin.constraints.contact_pairs import NO_NODE, RigidSurface
from softrobot_twin.geometry.proximities import empty_proximities
from softrobot_twin.kernels.compilation import INNER, KERNEL, njit
from softrobot_twin.kernels.traced_stage import TracedStages

FIRST_ROOM = 64
# Within a step, free motion may bring things together that are as far apart as this many times the
# displacement of the fastest point.
LOOK_AHEAD = 2.0
# Bodies have followed a prescribed move where no gap is less than asked for by more than this share
# of the alarm distance.
NOT_FOLLOWED = 1.0e-2
# A prescribed move advances by this share of the distance that is left, as its places may move along
# arcs, so often at most.
ADVANCE, MOST_ADVANCES = 0.8, 100
# A contact with less than this share of the greatest normal force does not press.
PRESSES = 1.0e-9
# A contact with more than this share of the greatest friction slips.
SLIPS = 1.0 - 1.0e-6
# Tangents are square to the x axis; to the y axis where a normal has a greater x than this.
STEEP = 0.617


@njit(**KERNEL, inline="always")
def put_tangents(normals, count, directions):
    """Normal and two tangents of each contact, the same for the same normal.

    Args:
        normals: Unit normals, shape (capacity, 3).
        count: Number of contacts.
        directions: Takes the normal and the tangents of each, shape (capacity, 3, 3).
    """
    for c in range(count):
        n0, n1, n2 = normals[c, 0], normals[c, 1], normals[c, 2]
        # Not by the least of three: of a level floor's normal two are zero but for round-off, and
        # tangents that turn from step to step make last step's friction useless as a guess.
        if abs(n0) < STEEP:
            t0, t1, t2 = 0.0, n2, -n1
        else:
            t0, t1, t2 = -n2, 0.0, n0
        length = np.sqrt(t0 * t0 + t1 * t1 + t2 * t2)
        t0, t1, t2 = t0 / length, t1 / length, t2 / length
        directions[c, 0, 0], directions[c, 0, 1], directions[c, 0, 2] = n0, n1, n2
        directions[c, 1, 0], directions[c, 1, 1], directions[c, 1, 2] = t0, t1, t2
        directions[c, 2, 0] = n1 * t2 - n2 * t1
        directions[c, 2, 1] = n2 * t0 - n0 * t2
        directions[c, 2, 2] = n0 * t1 - n1 * t0


@njit(**INNER)
def apart(x, nodes, coefficients, c):
    """Σ c_k x_k of one contact, standing points left out.

    Args:
        x: Node positions [m], shape (node_count, 3).
        nodes: Nodes of each contact, -1 where there is none, shape (capacity, width).
        coefficients: c of these nodes, same shape.
        c: Index of the contact.

    Returns:
        Three numbers [m].
    """
    r0, r1, r2 = 0.0, 0.0, 0.0
    for k in range(nodes.shape[1]):
        n = nodes[c, k]
        if n >= 0:
            w = coefficients[c, k]
            r0 += w * x[n, 0]
            r1 += w * x[n, 1]
            r2 += w * x[n, 2]
    return r0, r1, r2


@njit(**KERNEL, inline="always")
def anchor(x, start, nodes, coefficients, directions, gaps, count, anchors, begins):
    """Reference of each contact's gap and of its displacement.

    Args:
        x: Node positions [m], shape (node_count, 3).
        start: Node positions where the step began [m], same shape.
        nodes: Nodes of each contact, -1 where there is none, shape (capacity, width).
        coefficients: c of these nodes, same shape.
        directions: Normal and tangents of each contact, shape (capacity, 3, 3).
        gaps: Gap of each contact at `x` [m], shape (capacity,).
        count: Number of contacts.
        anchors: Takes the gap less n · Σ c_k x_k [m], same shape as the gaps.
        begins: Takes Σ c_k x_k at `start` along each direction [m], shape (capacity, 3).
    """
    for c in range(count):
        r0, r1, r2 = apart(x, nodes, coefficients, c)
        s0, s1, s2 = apart(start, nodes, coefficients, c)
        d = directions[c]
        anchors[c] = gaps[c] - (d[0, 0] * r0 + d[0, 1] * r1 + d[0, 2] * r2)
        for i in range(3):
            begins[c, i] = d[i, 0] * s0 + d[i, 1] * s1 + d[i, 2] * s2


@njit(**KERNEL)
def write_gaps(x, nodes, coefficients, directions, anchors, gaps):
    """Gap of every contact along its normal as detected.

    Args:
        x: Node positions [m], shape (node_count, 3).
        nodes: Nodes of each contact, -1 where there is none, shape (capacity, width).
        coefficients: c of these nodes, same shape.
        directions: Normal and tangents of each contact, shape (capacity, 3, 3).
        anchors: See `anchor` [m], shape (capacity,).
        gaps: Takes the gaps [m], shape (count,).
    """
    for c in range(len(gaps)):
        r0, r1, r2 = apart(x, nodes, coefficients, c)
        n = directions[c, 0]
        gaps[c] = anchors[c] + (n[0] * r0 + n[1] * r1 + n[2] * r2)


@njit(**KERNEL)
def write_values(x, nodes, coefficients, directions, anchors, begins, row_starts, distance, allowed, out):
    """δ of every row.

    Args:
        x: Node positions [m], shape (node_count, 3).
        nodes: Nodes of each contact, -1 where there is none, shape (capacity, width).
        coefficients: c of these nodes, same shape.
        directions: Normal and tangents of each contact, shape (capacity, 3, 3).
        anchors: See `anchor` [m], shape (capacity,).
        begins: See `anchor` [m], shape (capacity, 3).
        row_starts: First row of each contact and the number of rows, shape (contact_count + 1,).
        distance: Contact distance [m].
        allowed: Bodies that overlap are parted by no more in this step [m].
        out: Takes δ [m], shape (row_count,).
    """
    for c in range(len(row_starts) - 1):
        r0, r1, r2 = apart(x, nodes, coefficients, c)
        d = directions[c]
        along = d[0, 0] * r0 + d[0, 1] * r1 + d[0, 2] * r2
        parted = along - begins[c, 0]
        row = row_starts[c]
        out[row] = max(anchors[c] + along - distance, min(parted - allowed, 0.0))
        for i in range(1, row_starts[c + 1] - row):
            out[row + i] = d[i, 0] * r0 + d[i, 1] * r1 + d[i, 2] * r2 - begins[c, i]


@njit(**KERNEL, inline="always")
def write_layout(free_index, nodes, row_starts, row_index, node_index):
    """Row and unknown of every entry of H, row by row; returns the number of entries.

    Args:
        free_index: Unknown of each node, -1 where there is none, shape (node_count,).
        nodes: Nodes of each contact, -1 where there is none, shape (capacity, width).
        row_starts: First row of each contact and the number of rows, shape (contact_count + 1,).
        row_index: Takes the row of each entry, shape (entry_capacity,).
        node_index: Takes the unknown of each entry, same shape.
    """
    entry = 0
    for c in range(len(row_starts) - 1):
        for row in range(row_starts[c], row_starts[c + 1]):
            for k in range(nodes.shape[1]):
                n = nodes[c, k]
                if n >= 0 and free_index[n] >= 0:
                    row_index[entry] = row
                    node_index[entry] = free_index[n]
                    entry += 1
    return entry


@njit(**KERNEL)
def write_blocks(free_index, nodes, coefficients, directions, row_starts, blocks):
    """Entries of H, in the order of `write_layout`.

    Args:
        free_index: Unknown of each node, -1 where there is none, shape (node_count,).
        nodes: Nodes of each contact, -1 where there is none, shape (capacity, width).
        coefficients: c of these nodes, same shape.
        directions: Normal and tangents of each contact, shape (capacity, 3, 3).
        row_starts: First row of each contact and the number of rows, shape (contact_count + 1,).
        blocks: Takes the entries, shape (entry_count, 3).
    """
    entry = 0
    for c in range(len(row_starts) - 1):
        for i in range(row_starts[c + 1] - row_starts[c]):
            for k in range(nodes.shape[1]):
                n = nodes[c, k]
                if n >= 0 and free_index[n] >= 0:
                    for axis in range(3):
                        blocks[entry, axis] = coefficients[c, k] * directions[c, i, axis]
                    entry += 1


@njit(**KERNEL)
def begin_pair(index, span, nodes, coefficients, pair):
    """Clear what carries the contacts of a pair, and note the pair.

    Args:
        index: Index of the pair.
        span: Its first contact, and the one behind its last, shape (2,).
        nodes: Takes -1, shape (capacity, width).
        coefficients: Takes zeros, same shape.
        pair: Takes the index, shape (capacity,).
    """
    for c in range(span[0], min(span[1], len(pair))):
        pair[c] = index
        for k in range(nodes.shape[1]):
            nodes[c, k], coefficients[c, k] = NO_NODE, 0.0


@njit(**KERNEL)
def lay_out_contacts(
    x, start, free_index, ends, nodes, coefficients, normals, gaps, pair, rows_of_pair, directions,
    anchors, begins, row_starts, entry_rows, entry_nodes, entry_count,
):  # fmt: skip
    """Directions, references and rows of all contacts; nothing where they do not have room.

    Args:
        x: Node positions [m], shape (node_count, 3).
        start: Node positions where the step began [m], same shape.
        free_index: Unknown of each node, -1 where there is none, shape (node_count,).
        ends: End of the contacts of each pair, shape (pair_count + 1,).
        nodes: Nodes of each contact, -1 where there is none, shape (capacity, width).
        coefficients: c of these nodes, same shape.
        normals: Unit normals, shape (capacity, 3).
        gaps: Gap of each contact at `x` [m], shape (capacity,).
        pair: Pair of each contact, shape (capacity,).
        rows_of_pair: Rows of each contact of a pair, shape (pair_count,).
        directions: See `put_tangents`; written, as all that follow.
        anchors: See `anchor`.
        begins: See `anchor`.
        row_starts: First row of each contact and the number of rows, shape (capacity + 1,).
        entry_rows: See `write_layout`.
        entry_nodes: See `write_layout`.
        entry_count: Number of entries, shape (1,).
    """
    count = ends[-1]
    if count > len(nodes):
        return
    put_tangents(normals, count, directions)
    anchor(x, start, nodes, coefficients, directions, gaps, count, anchors, begins)
    for c in range(count):
        row_starts[c + 1] = row_starts[c] + rows_of_pair[pair[c]]
    entry_count[0] = write_layout(free_index, nodes, row_starts[: count + 1], entry_rows, entry_nodes)


@njit(**KERNEL)
def recall(pairs, keys, row_starts, before, tables, known, values):
    """Find contacts again by their keys.

    Args:
        pairs: Pair that each belongs to, shape (count,).
        keys: Its key in the pair, shape (count,).
        row_starts: First row of each, and the number of rows, shape (count + 1,).
        before: Pair and key of the contacts that are remembered, shape (2, before_count).
        tables: λ of each of their rows, λ where the step began, and its change in the step before
            [N], shape (3, before_count, width).
        known: Takes pairs and keys, shape (2, count).
        values: Takes λ, λ where the step began, and λ with its change, zeros before [N], shape
            (3, row_count).
    """
    are_same = len(pairs) == before.shape[1]
    for c in range(len(pairs)):
        known[0, c], known[1, c] = pairs[c], keys[c]
        are_same = are_same and pairs[c] == before[0, c] and keys[c] == before[1, c]
    for c in range(len(pairs)):
        place = c
        if not are_same:
            place = before.shape[1] - 1
            while place >= 0 and (pairs[c] != before[0, place] or keys[c] != before[1, place]):
                place -= 1
        if place >= 0:
            for row in range(row_starts[c], row_starts[c + 1]):
                i = row - row_starts[c]
                values[0, row], values[1, row] = tables[0, place, i], tables[1, place, i]
                values[2, row] = tables[0, place, i] + tables[2, place, i]


@njit(**KERNEL)
def fill_tables(row_starts, multipliers, at_start, tables):
    """Write the first two tables of `recall`, zeros before, from values of its rows.

    Args:
        row_starts: First row of each contact, and the number of rows, shape (count + 1,).
        multipliers: λ of each row [N], shape (row_count,).
        at_start: λ where the step began [N], same shape.
        tables: Takes both, shape (3, count, width).
    """
    for c in range(len(row_starts) - 1):
        for row in range(row_starts[c], row_starts[c + 1]):
            tables[0, c, row - row_starts[c]] = multipliers[row]
            tables[1, c, row - row_starts[c]] = at_start[row]


@njit(**KERNEL)
def _share_within(longest, reach):
    """Share of a move, whose longest one is of shape (1,), that is no longer than a reach of shape (1,).
    """
    return 1.0 if longest[0] <= reach[0] else reach[0] / longest[0]


class Prescribed(Enum):
    """What contacts know of a prescribed move, such as that of a guided body.

    Attributes:
        NONE: There is none, or the bodies have followed.
        MADE: It is made, and the rows are to be found before it.
        SEARCHED: It is made, and the rows are those before it.
    """

    NONE, MADE, SEARCHED = range(3)


class ContactMemory:
    """Forces of the last solution, found again by the contacts' keys, whatever rows they have.

    Attributes:
        guess: λ that the contacts recognised last had before, 0 for new ones [N],
            shape (row_count,).
        expected: λ that they have if the step changes it as the step before did; within a step,
            after the first linearization, the same as the guess [N], shape (row_count,).
    """

    def __init__(self, most_rows: int):
        """Know nothing.

        Args:
            most_rows: Rows of one contact at most.
        """
        self._most_rows = most_rows
        self.forget()

    def forget(self) -> None:
        """Know nothing again."""
        self._before = self._known = np.zeros((2, 0), np.int64)
        # λ, λ where the step began, and its change in the step before, of each contact of `_before`.
        # Of a contact with fewer rows than others the last columns are zero.
        self._tables = np.zeros((3, 0, self._most_rows))
        self.guess = self.expected = self._start = np.zeros(0)
        self._row_starts, self._is_over = np.zeros(1, np.int64), False

    @property
    def at_start(self) -> np.ndarray:
        """λ of the contacts recognised last where the step began [N], shape (row_count,)."""
        return self._start

    @property
    def forces(self) -> np.ndarray:
        """λ of each contact in the last solution [N], shape (count, most rows)."""
        return self._tables[0]

    @property
    def pairs(self) -> np.ndarray:
        """Pair of each contact in the last solution, shape (count,)."""
        return self._before[0]

    @property
    def known(self) -> list[tuple[int, int]]:
        """Pair and key of the contacts recognised last."""
        return list(zip(*self._known.tolist(), strict=True))

    def begin_step(self) -> None:
        """Note how λ changed in the step that is over, once."""
        if not self._is_over:
            return
        self._is_over = False
        multipliers, at_start, change = self._tables
        np.subtract(multipliers, at_start, out=change)
        at_start[:] = multipliers

    def recognise(self, pairs: np.ndarray, keys: np.ndarray, row_starts: np.ndarray) -> None:
        """Look up contacts.

        Args:
            pairs: Pair that each belongs to, shape (count,).
            keys: Its key in the pair, shape (count,).
            row_starts: First row of each, and the number of rows, shape (count + 1,).
        """
        self._row_starts, self._known = row_starts, np.empty((2, len(pairs)), np.int64)
        values = np.zeros((3, row_starts[-1]))
        recall(pairs, keys, row_starts, self._before, self._tables, self._known, values)
        self.guess, self._start, self.expected = values

    def remember(self, multipliers: np.ndarray) -> None:
        """Take in λ of the contacts recognised last [N], shape (row_count,).

        Args:
            multipliers: λ of the contacts' rows [N], shape (row_count,).
        """
        self._before, self._is_over = self._known, True
        self._tables = np.zeros((3, len(self._row_starts) - 1, self._most_rows))
        fill_tables(self._row_starts, multipliers, self._start, self._tables)


class Contacts(VaryingTerm):
    """Constraint term of all that may touch. Its rows differ from step to step.

    A contact of a pair with friction has three rows, the normal and two tangents; others have one.
    Contacts without friction come first, then those with friction, both in the order of the pairs.

    Attributes:
        pairs: Pairs that may touch.
        pair_names: Names of both bodies of each.
        friction_of_pair: Coefficient µ of each, shape (pair_count,).
        rows_of_pair: Rows of each of its contacts, 3 with friction, else 1, shape (pair_count,).
        rubs: Whether any pair has friction.
        count: Contacts at the state detected last.
        row_starts: First row of each, that of its normal, and the number of rows, shape
            (count + 1,).
        nodes: Nodes that carry both points of each, -1 where none, shape (capacity, width).
        coefficients: Their coefficients c, same shape.
        directions: Normal and two tangents of each, shape (capacity, 3, 3).
        memory: Forces of the last solution.
        time_step: Duration of the step that was begun last [s].
        sums_at_start: `sums_of_pairs` where the step began [N], in scenes that ask for grip margins.
        curvature: Stiffness by the curvature of round shapes that facets press on, or None.
    """

    name = "contacts"
    group = "contacts"
    varies = True
    curvature = None

    def __init__(
        self, pairs: tuple, free_index: np.ndarray, write_largest: Callable,
        alarm_distance: float, contact_distance: float, push_out_speed: float,
    ):  # fmt: skip
        """Take the pairs.

        Args:
            pairs: Pairs that may touch, see `contact_pairs`.
            free_index: Unknown or carried point of each node, -1 where there is none.
            write_largest: Writes the largest of moves [m] or velocities [m/s], see `Nodes`.
            alarm_distance: What is nearer is watched [m].
            contact_distance: What is as near touches [m].
            push_out_speed: Bodies that overlap are parted no faster [m/s].
        """
        self.pairs = pairs
        self.pair_names = tuple(pair.names for pair in pairs)
        self.friction_of_pair = np.array([pair.friction for pair in pairs])
        self.rows_of_pair = np.where(self.friction_of_pair > 0.0, 3, 1)
        self._order = np.argsort(self.rows_of_pair, kind="stable").tolist()
        self._most_rows = int(self.rows_of_pair.max(initial=1))
        self.rubs = self._most_rows > 1
        self.conserves = not self.rubs
        self.count = 0
        self._reach, self._longest_move = np.array([[alarm_distance], [alarm_distance]])
        self._start = np.empty((0, 3))
        self._before, self._move = np.empty((0, 3)), Prescribed.NONE
        self._free_reach = float(alarm_distance)
        is_traceable = all(pair.is_traceable for pair in pairs)
        self.stages = TracedStages(is_traceable, self._detect)
        self._free_index, self._write_largest = free_index, write_largest
        self._largest = np.zeros(1)
        self._alarm, self._distance = alarm_distance, contact_distance
        self._push_out_speed, self._allowed = push_out_speed, np.inf
        self.memory = ContactMemory(self._most_rows)
        self.sums_at_start = np.zeros((2, len(pairs)))
        sides = [side for pair in pairs for side in (pair.first, pair.second)]
        self._rigid = {side for side in sides if isinstance(side, RigidSurface)}
        # Nodes of one side of a contact, at most.
        self._width = max([4, *(side.width for side in sides)])
        nodes = np.unique(np.concatenate([np.empty(0, np.int64), *(s.nodes for s in sides)]))
        reached = free_index[nodes]
        self._reached = reached[reached >= 0]
        self._allocate(FIRST_ROOM)

    def _allocate(self, capacity: int) -> None:
        self._capacity = capacity
        self.nodes = np.full((capacity, 2 * self._width), -1, np.int64)
        self.coefficients = np.zeros((capacity, 2 * self._width))
        self.directions = np.zeros((capacity, 3, 3))
        self.found = empty_proximities(capacity)
        self._ends = np.zeros(len(self.pairs) + 1, np.int64)
        self.positions, self._gaps = self.found.first_positions, self.found.gaps
        self.pair = np.zeros(capacity, np.int64)
        self._row_starts = np.zeros(capacity + 1, np.int64)
        self.row_starts = self._row_starts[:1]
        self._entry_rows = np.zeros(self.entry_capacity, np.int64)
        self._entry_nodes = np.zeros(self.entry_capacity, np.int64)
        self._entry_count = np.zeros(1, np.int64)
        self._anchors, self._begins = np.zeros(capacity), np.zeros((capacity, 3))
        self.stages.forget()

    @property
    def is_traceable(self) -> bool:
        """See `ConstraintTerm`: rows keep their arrays while there are as many contacts."""
        return self.curvature is None

    @property
    def reached_nodes(self) -> np.ndarray:
        """See `ConstraintTerm`; of all sides."""
        return self._reached

    @property
    def entry_capacity(self) -> int:
        """Entries of rows that there may be."""
        return 2 * self._width * self.row_capacity

    @property
    def row_capacity(self) -> int:
        """Greatest number of rows that the memory can hold."""
        return self._most_rows * self._capacity

    @property
    def row_count(self) -> int:
        """Rows at the state detected last."""
        return int(self.row_starts[-1])

    @property
    def entry_rows(self) -> np.ndarray:
        """Row of each entry of H, shape (entry_count,)."""
        return self._entry_rows[: self._entry_count[0]]

    @property
    def entry_nodes(self) -> np.ndarray:
        """Unknown of each entry of H, shape (entry_count,)."""
        return self._entry_nodes[: self._entry_count[0]]

    @property
    def margin(self) -> float:
        """Things nearer than this are contacts [m]."""
        return float(self._reach[0])

    @property
    def friction(self) -> np.ndarray:
        """Coefficient µ of each contact, shape (count,)."""
        return self.friction_of_pair[self.pair[: self.count]]

    def pairs_named(self, names: Sequence[tuple[str, str]]) -> np.ndarray:
        """Which pair has each of some names, shape (name_count, pair_count).

        Args:
            names: Names of both bodies of pairs; one may come several times.
        """
        return np.array([[own == name for own in self.pair_names] for name in names])

    def sums_of_pairs(self, pairs: np.ndarray, forces: np.ndarray) -> np.ndarray:
        """Σ λ_n and Σ |λ_t| of the contacts of each pair [N], shape (2, pair_count).

        Args:
            pairs: Pair of each contact of a solution, shape (count,).
            forces: λ of each contact [N], the columns of those with one row zero but for the first,
                shape (count, 3).
        """
        normal, along = forces[:, 0], np.hypot(forces[:, 1], forces[:, 2])
        return np.array([np.bincount(pairs, of, len(self.pairs)) for of in (normal, along)])

    def friction_used(self, groups: np.ndarray, sums: np.ndarray) -> np.ndarray:
        """Share of its friction that each group of pairs uses, Σ |λ_t| / Σ µ λ_n; NaN if none presses.

        Args:
            groups: Which pairs each has, shape (group_count, pair_count).
            sums: See `sums_of_pairs`.

        Returns:
            Shares, shape (group_count,).
        """
        normal, along = sums
        most = groups @ (self.friction_of_pair * normal)
        return np.divide(groups @ along, most, out=np.full(len(groups), np.nan), where=most > 0.0)

    def touch(self, multipliers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Which contacts press in a solution, and which of these slip.

        Args:
            multipliers: λ of all rows [N], shape (row_count,).

        Returns:
            Whether each presses, and whether it presses with all the friction that it may have;
            both of shape (count,).
        """
        first = self.row_starts[:-1]
        normal = multipliers[first]
        presses = normal > PRESSES * np.abs(normal).max(initial=0.0)
        slips, rub = presses.copy(), np.flatnonzero(np.diff(self.row_starts) == 3)
        along = np.linalg.norm(multipliers[first[rub, None] + [1, 2]], axis=1)
        slips[rub] &= ~(along < SLIPS * self.friction[rub] * normal[rub])
        return presses, slips

    def begin_step(self, positions: np.ndarray, velocities: np.ndarray, time_step: float) -> None:
        """Remember where a step begins, from where sliding is measured.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            velocities: Of the unknowns [m/s], shape (free_node_count, 3), or without rows.
            time_step: The step's duration [s]; without one, overlaps are parted at once.
        """
        if len(self._start) != len(positions):
            self._start = np.empty_like(positions)
        self._start[:] = positions
        self.memory.begin_step()
        self.time_step = time_step
        self._allowed = self._push_out_speed * time_step if time_step > 0.0 else np.inf
        self._largest[0] = 0.0
        if len(velocities):
            self._write_largest(velocities, False, self._largest)
        self._reach[0] = self._alarm + LOOK_AHEAD * float(self._largest[0]) * time_step
        self._longest_move[0] = self._free_reach = float(self._reach[0])
        self._move = Prescribed.NONE

    def begin_prescribed_move(self, positions: np.ndarray) -> None:
        """Read the state before a prescribed move: the next rows are those of what is near there.

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        if len(self._before) != len(positions):
            self._before = np.empty_like(positions)
        self._before[:] = positions
        self._move = Prescribed.MADE

    def lags(self, positions: np.ndarray) -> bool:
        """See `VaryingTerm.lags`: a gap is less than asked for, and than where it was detected."""
        if self._move is Prescribed.NONE:
            return False
        least = np.minimum(self._gaps[: self.count], self._distance) - NOT_FOLLOWED * self._alarm
        return bool((self.gaps(positions) < least).any())

    def asks_again(self, positions: np.ndarray) -> bool:
        """See `VaryingTerm.asks_again`: what a prescribed move came near to may not touch at its end."""
        is_led = self._move is not Prescribed.NONE
        return is_led and (self.presses_from_afar or self.lags(positions))

    @property
    def presses_from_afar(self) -> bool:
        """See `VaryingTerm.presses_from_afar`: further away than is watched."""
        if self._reach[0] == self._alarm:
            return False
        gaps, normal = self._gaps[: self.count], self.memory.forces[:, 0]
        return bool((gaps[normal > PRESSES * normal.max(initial=0.0)] > self._alarm).any())

    def ways(self, start: np.ndarray, end: np.ndarray) -> tuple[float, tuple]:
        """How far a prescribed move carries places of the sides.

        Args:
            start: Node positions before it [m], shape (node_count, 3).
            end: Those after it [m], same shape.

        Returns:
            Longest displacement of a place [m], and the pairs of the sides that move.
        """
        moved, longest = set(), 0.0
        for side in {side for pair in self.pairs for side in (pair.first, pair.second)}:
            if len(side.nodes) and not np.array_equal(start[side.nodes], end[side.nodes]):
                moved.add(side)
                ways = side.outline(end) - side.outline(start)
                longest = max(longest, float(np.sqrt((ways * ways).sum(axis=1).max(initial=0.0))))
        return longest, tuple(pair for pair in self.pairs if {pair.first, pair.second} & moved)

    def share_before_touch(
        self, start: np.ndarray, end: np.ndarray, place: Callable[[np.ndarray, float], None]
    ) -> float:
        """How much of a prescribed move keeps what moves apart from all else.

        It goes on by what is left between them until they are near (conservative advancement, Mirtich
        1996), or nothing is in its way.

        Args:
            start: Node positions before it [m], shape (node_count, 3).
            end: Those after it [m], same shape.
            place: Makes a share of it, of node positions.

        Returns:
            The share: zero for a move no longer than the alarm distance.
        """
        way, pairs = self.ways(start, end)
        share, tried = 0.0, start.copy()
        for _ in range(MOST_ADVANCES):
            left = (1.0 - share) * way
            if left <= self._alarm:
                break
            gap = min((pair.near(tried, left).gaps.min(initial=left) for pair in pairs), default=left)
            if gap <= self._alarm:
                break
            share = min(share + ADVANCE * gap / way, 1.0)
            tried[:] = start
            place(tried, share)
        return share

    def detect(self, positions: np.ndarray) -> None:
        """Find what is near at a state.

        What something prescribed may pass on its way is near before it moves, not behind it. So the
        rows after its move are those of before, and stay until the bodies have followed.

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        if self._move is Prescribed.SEARCHED:
            if self.lags(positions):
                return
            self._reach[0] = self._longest_move[0] = self._free_reach
            self._move = Prescribed.NONE
        elif self._move is Prescribed.MADE:
            # Bodies that follow move as far themselves.
            way, _ = self.ways(self._before, positions)
            self._reach[0], self._longest_move[0] = self._free_reach + 2.0 * way, self._free_reach + way
            positions, self._move = self._before, Prescribed.SEARCHED
        while True:
            # Their points follow by products of matrices, which the driver does not know.
            for surface in self._rigid:
                surface.points(positions)
            self.stages.run(0, positions)
            count = int(self._ends[-1])
            if count <= self._capacity:
                break
            self._allocate(2 * count)
        self.count = count
        if len(self.row_starts) != count + 1:
            self.row_starts = self._row_starts[: count + 1]
        self.memory.recognise(self.pair[:count], self.found.keys[:count], self.row_starts)

    def _detect(self, positions: np.ndarray) -> None:
        """Find what is near, what carries it, and its rows; the driver does so in most steps."""
        found, nodes, coefficients = self.found, self.nodes, self.coefficients
        self._write_near(positions, found, self._ends)
        for place, index in enumerate(self._order):
            pair, span = self.pairs[index], self._ends[place : place + 2]
            begin_pair(index, span, nodes, coefficients, self.pair)
            pair.first.carry(
                positions, found.first_points, found.first_weights, found.first_positions, 1.0, 0,
                span, nodes, coefficients,
            )  # fmt: skip
            pair.second.carry(
                positions, found.second_points, found.second_weights, found.second_positions, -1.0,
                self._width, span, nodes, coefficients,
            )  # fmt: skip
        lay_out_contacts(
            positions, self._start, self._free_index, self._ends, nodes, coefficients,
            found.normals, found.gaps, self.pair, self.rows_of_pair, self.directions,
            self._anchors, self._begins, self._row_starts, self._entry_rows, self._entry_nodes,
            self._entry_count,
        )  # fmt: skip

    def _write_near(self, positions: np.ndarray, found, ends: np.ndarray) -> None:
        """Write what is near, pair after pair in the order of the contacts."""
        for place, index in enumerate(self._order):
            self.pairs[index].write(positions, self._reach, found, ends[place : place + 2])

    @property
    def overlaps(self) -> np.ndarray:
        """How deep each contact detected last overlaps [m], shape (count,)."""
        return np.maximum(self._distance - self._gaps[: self.count], 0.0)

    def deepest_overlaps(self, positions: np.ndarray) -> np.ndarray:
        """Deepest overlap of each pair at a state, detected there [m], shape (pair_count,).

        The contacts detected last stay.

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        ends, overlaps = np.zeros_like(self._ends), np.zeros(len(self.pairs))
        found = empty_proximities(self._capacity)
        self._write_near(positions, found, ends)
        if ends[-1] > self._capacity:
            found = empty_proximities(ends[-1])
            self._write_near(positions, found, ends)
        for place, index in enumerate(self._order):
            gaps = found.gaps[ends[place] : ends[place + 1]]
            overlaps[index] = max(0.0, self._distance - gaps.min(initial=np.inf))
        return overlaps

    def evaluate(self, positions: np.ndarray, blocks: np.ndarray, values: np.ndarray) -> None:
        """Write H and δ [m] of the contacts detected last; see `ConstraintTerm.evaluate`."""
        write_values(
            positions, self.nodes, self.coefficients, self.directions, self._anchors,
            self._begins, self.row_starts, self._distance, self._allowed, values,
        )  # fmt: skip
        write_blocks(
            self._free_index, self.nodes, self.coefficients, self.directions, self.row_starts,
            blocks,
        )  # fmt: skip

    def bind(self, elimination_rank: np.ndarray, slots) -> None:
        """Look up where the stiffness by curvature goes; see `ConstraintTerm.bind`."""
        if self.curvature is not None:
            self.curvature.bind(elimination_rank, slots)

    def choose_stiffness(self, is_prescribed: bool) -> None:
        """See `VaryingTerm.choose_stiffness`: then facets that move across a shape roll too."""
        if self.curvature is not None:
            self.curvature.with_sliding = is_prescribed and not self.rubs

    def limit_stiffness(self, is_limited: bool) -> None:
        """See `VaryingTerm.limit_stiffness`."""
        if self.curvature is not None:
            self.curvature.is_whole = not is_limited

    @property
    def may_be_negative(self) -> bool:
        """See `VaryingTerm.may_be_negative`."""
        return self.curvature is not None and self.count > 0 and self.curvature.with_sliding

    def add_stiffness(
        self, positions: np.ndarray, multipliers: np.ndarray, storage: np.ndarray,
        projected: bool = False,
    ) -> None:
        """Add the stiffness of facets that press on round shapes, which is never negative."""
        if self.curvature is not None:
            self.curvature.add(self, positions, multipliers, storage)

    def largest_share(self, positions: np.ndarray, move: np.ndarray) -> float:
        """No move is longer than the distance that was searched: nothing is passed unseen."""
        self._write_largest(move, False, self._largest)
        return _share_within(self._largest, self._longest_move)

    @property
    def last_multipliers(self) -> np.ndarray:
        """λ that the contacts detected last had before, zero for new ones [N]."""
        return self.memory.guess

    def remember(self, multipliers: np.ndarray) -> None:
        """Keep λ of the contacts detected last [N], shape (row_count,)."""
        self.memory.remember(multipliers)

    def forget(self) -> None:
        """Forget all forces, and what detection did before."""
        self.stages.begin_anew()
        self.memory.forget()

    def gaps(self, positions: np.ndarray) -> np.ndarray:
        """Gap of each contact at a state, its normal as detected [m], shape (count,).

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        gaps = np.empty(self.count)
        write_gaps(
            positions, self.nodes, self.coefficients, self.directions, self._anchors,
            gaps,
        )  # fmt: skip
        return gaps
