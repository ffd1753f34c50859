"""Contacts: rows along the normal and in the plane of touch (Coevoet 2017, eq. 4).

With x_a - x_b = Σ c_k x_k over the nodes that carry both points, and n the unit normal from b to a,

    δ_n = gap - contact distance,     H_n = c_k n
    δ_t = t · (Σ c_k x_k - (Σ c_k x_k) where the step began),     H_t = c_k t

Bodies that overlap are not parted at once, which would throw them: the gap asked for grows by
`push_out_speed` times the step's duration.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from softrobot_twin.compilation import INNER, KERNEL, njit
from softrobot_twin.mechanics.barycentric import writable

FIRST_ROOM = 64
# Within a step, free motion may bring things together that are as far apart as this many times the
# displacement of the fastest point.
LOOK_AHEAD = 2.0
# Tangents are square to the x axis; to the y axis where a normal has a greater x than this.
STEEP = 0.617


@njit(**KERNEL)
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


@njit(**KERNEL)
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
def write_values(
    x, nodes, coefficients, directions, anchors, begins, row_starts, distance, allowed, out
):  # fmt: skip
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


@njit(**KERNEL)
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


class ContactMemory:
    """Forces of the last solution, found again by the contacts' keys, whatever rows they have.

    Attributes:
        known: Pair and key of the contacts recognised last.
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
        self._before: list[tuple[int, int]] = []
        self.known: list[tuple[int, int]] = []
        # λ, λ where the step began, and its change in the step before: a row for each contact of
        # `_before`, and a last one, of zeros, for what is new. Of a contact with fewer rows than
        # others the last columns are zero.
        self._multipliers, self._at_start, self._change = np.zeros((3, 1, self._most_rows))
        self.guess = self.expected = self._start = np.zeros(0)
        self._has_row = np.zeros((0, self._most_rows), bool)

    def begin_step(self) -> None:
        """Note how λ changed in the step that is over."""
        self._change = self._multipliers - self._at_start
        self._at_start = self._multipliers

    def recognise(self, pairs: np.ndarray, keys: np.ndarray, row_counts: np.ndarray) -> None:
        """Look up contacts.

        Args:
            pairs: Pair that each belongs to, shape (count,).
            keys: Its key in the pair, shape (count,).
            row_counts: Its rows, shape (count,).
        """
        self._has_row = np.arange(self._most_rows) < row_counts[:, None]
        self.known = list(zip(pairs.tolist(), keys.tolist(), strict=True))
        places = slice(-1)
        if self.known != self._before:
            before = dict(zip(self._before, range(len(self._before)), strict=True))
            # What is new is given the last row, which is zero.
            places = np.array([before.get(key, -1) for key in self.known], np.int64)
        self.guess = self._multipliers[places][self._has_row]
        self.expected = self.guess + self._change[places][self._has_row]
        self._start = self._at_start[places][self._has_row]

    def remember(self, multipliers: np.ndarray) -> None:
        """Take in λ of the contacts recognised last [N], shape (row_count,)."""
        tables = np.zeros((3, len(self.known) + 1, self._most_rows))
        self._multipliers, self._at_start, self._change = tables
        self._multipliers[:-1][self._has_row] = multipliers
        self._at_start[:-1][self._has_row] = self._start
        self._before = self.known


class Contacts:
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
        margin: Things nearer than this are contacts [m].
        memory: Forces of the last solution.
        curvature: Stiffness by the curvature of round shapes that facets press on, or None.
    """

    name = "contacts"
    group = "contacts"
    varies = True
    curvature = None
    dense_rows = None

    def __init__(
        self, pairs: tuple, free_index: np.ndarray, longest: Callable,
        alarm_distance: float, contact_distance: float, push_out_speed: float,
    ):  # fmt: skip
        """Take the pairs.

        Args:
            pairs: Pairs that may touch, see `contact_pairs`.
            free_index: Unknown or carried point of each node, -1 where there is none.
            longest: Gives the largest of velocities [m/s], turning counted at the rim.
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
        self.row_starts = np.zeros(1, np.int64)
        self.count, self.margin = 0, alarm_distance
        self._taken: set[int] = set()
        self._free_index, self._longest = free_index, longest
        self._alarm, self._distance = alarm_distance, contact_distance
        self._push_out_speed, self._allowed = push_out_speed, np.inf
        self._start = None
        self.memory = ContactMemory(self._most_rows)
        sides = [side for pair in pairs for side in (pair.first, pair.second)]
        # Nodes of one side of a contact, at most.
        self._width = max([4, *(side.width for side in sides)])
        nodes = np.unique(np.concatenate([np.empty(0, np.int64), *(s.nodes for s in sides)]))
        reached = free_index[nodes]
        self.reached_nodes = reached[reached >= 0]
        self._allocate(FIRST_ROOM)

    def _allocate(self, capacity: int) -> None:
        self._capacity = capacity
        self.nodes = np.full((capacity, 2 * self._width), -1, np.int64)
        self.coefficients = np.zeros((capacity, 2 * self._width))
        self.directions = np.zeros((capacity, 3, 3))
        self.positions = np.zeros((capacity, 3))
        self._normals = np.zeros((capacity, 3))
        self._gaps = np.zeros(capacity)
        self.pair = np.zeros(capacity, np.int64)
        self._keys = np.zeros(capacity, np.int64)
        self._entry_rows = np.zeros(self.entry_capacity, np.int64)
        self._entry_nodes = np.zeros(self.entry_capacity, np.int64)
        self._entry_count = 0
        self._anchors, self._begins = np.zeros(capacity), np.zeros((capacity, 3))

    @property
    def is_traceable(self) -> bool:
        """See `ConstraintTerm`: rows keep their arrays while there are as many contacts."""
        return self.curvature is None

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
        return self._entry_rows[: self._entry_count]

    @property
    def entry_nodes(self) -> np.ndarray:
        """Unknown of each entry of H, shape (entry_count,)."""
        return self._entry_nodes[: self._entry_count]

    @property
    def scales(self) -> np.ndarray:
        """The distance from which contacts are watched, for every row [m], shape (row_count,)."""
        return np.full(self.row_count, self._alarm)

    @property
    def friction(self) -> np.ndarray:
        """Coefficient µ of each contact, shape (count,)."""
        return self.friction_of_pair[self.pair[: self.count]]

    def begin_step(self, positions: np.ndarray, velocities: np.ndarray, time_step: float) -> None:
        """Remember where a step begins, from where sliding is measured.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            velocities: Of the unknowns [m/s], shape (free_node_count, 3), or without rows.
            time_step: The step's duration [s]; without one, overlaps are parted at once.
        """
        self._start = positions.copy()
        self.memory.begin_step()
        self._allowed = self._push_out_speed * time_step if time_step > 0.0 else np.inf
        fastest = self._longest(velocities) if len(velocities) else 0.0
        self.margin = self._alarm + LOOK_AHEAD * fastest * time_step

    def detect(self, positions: np.ndarray) -> None:
        """Find what is near at a state.

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        found = [pair.near(positions, self.margin) for pair in self.pairs]
        self.count = sum(len(near.gaps) for near in found)
        if self.count > self._capacity:
            self._allocate(2 * self.count)
        first = 0
        for index in self._order:
            near = found[index]
            last = first + len(near.gaps)
            # What is empty is taken once: so nothing is left to be compiled at the first touch.
            if last > first or index not in self._taken:
                self._take(index, near, slice(first, last), positions)
                self._taken.add(index)
            first = last
        put_tangents(self._normals, self.count, self.directions)
        anchor(
            positions, self._start, self.nodes, self.coefficients, self.directions, self._gaps,
            self.count, self._anchors, self._begins,
        )  # fmt: skip
        pair = self.pair[: self.count]
        row_counts = self.rows_of_pair[pair]
        if len(self.row_starts) != self.count + 1:
            self.row_starts = np.zeros(self.count + 1, np.int64)
        np.cumsum(row_counts, out=self.row_starts[1:])
        self._entry_count = write_layout(
            self._free_index, self.nodes, self.row_starts, self._entry_rows, self._entry_nodes
        )
        self.memory.recognise(pair, self._keys[: self.count], row_counts)

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
        gaps = [pair.near(positions, self.margin).gaps for pair in self.pairs]
        return np.array([max(0.0, self._distance - gap.min(initial=np.inf)) for gap in gaps])

    def _take(self, index: int, near, place: slice, positions: np.ndarray) -> None:
        pair = self.pairs[index]
        nodes, coefficients = self.nodes[place], self.coefficients[place]
        if self._width > 4:
            nodes[:], coefficients[:] = -1, 0.0
        pair.first.carry(
            positions, near.first_points, near.first_weights, near.first_positions, 1.0, 0,
            nodes, coefficients,
        )  # fmt: skip
        pair.second.carry(
            positions, near.second_points, near.second_weights, near.second_positions, -1.0,
            self._width, nodes, coefficients,
        )  # fmt: skip
        self.positions[place] = near.first_positions
        self._normals[place], self._gaps[place] = near.normals, near.gaps
        self.pair[place], self._keys[place] = index, near.keys

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

    def stencils(self) -> np.ndarray:
        """Without lines: the elastic terms couple the nodes of a facet already."""
        return np.empty((0, 1), np.int64)

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
        longest = self._longest(move)
        return 1.0 if longest <= self.margin else self.margin / longest

    @property
    def last_multipliers(self) -> np.ndarray:
        """λ that the contacts detected last had before, zero for new ones [N]."""
        return self.memory.guess

    def remember(self, multipliers: np.ndarray) -> None:
        """Keep λ of the contacts detected last [N], shape (row_count,)."""
        self.memory.remember(multipliers)

    def forget(self) -> None:
        """Forget all forces."""
        self.memory.forget()

    def gaps(self, positions: np.ndarray) -> np.ndarray:
        """Gap of each contact at a state, its normal as detected [m], shape (count,)."""
        gaps = np.empty(self.count)
        write_gaps(
            writable(positions), self.nodes, self.coefficients, self.directions, self._anchors,
            gaps,
        )  # fmt: skip
        return gaps
