"""Which lanes of Y the rows of H take: body by body, as many as there are rows.

Bodies that touch each other only through constraints are separate trees of the forest of fronts,
*pieces*. L⁻¹Hᵀ of a piece has entries in the rows that touch it, no others. So each piece has its
own part of Y, as wide as its rows: a finger does not pay for the contacts of another one, and W
is put together from what the pieces give.

Within a piece a row is zero until the elimination comes to its first node. Where rows fill more
than one strip they take lanes in that order, so that those which meet in a subtree lie together,
and each front works on a range of strips only: that of its rows.

All follows from the rows of the step, of which there may be none or hundreds; the memory is one
buffer that only grows.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from softrobot_twin.solvers.multifrontal.elimination_tree import NONE
from softrobot_twin.solvers.multifrontal.symbolic import Elimination
from softrobot_twin.solvers.multifrontal.tiles import WIDE
from softrobot_twin.solvers.multifrontal.vector_code import KERNEL, STRIP

_NO_STRIP = 2**62

# One piece. A piece that no row touches has no lanes.
PIECE = np.dtype([
    ("first_front", np.int64),
    ("end_front", np.int64),
    ("dof_count", np.int64),  # of its reached fronts: rows of its part of Y
    ("row_count", np.int64),  # rows of H that touch it, one lane each; b is in the lane after
    ("row_start", np.int64),  # where they are listed in `rows`
    ("lanes", np.int64),      # whole strips
    ("start", np.int64),      # offset of its part of Y
    ("entry_end", np.int64),  # in the list of entries by piece
])  # fmt: skip


class RowLanes:
    """Where each row of H goes in Y.

    Attributes:
        pieces: One `PIECE` each, in elimination order.
        piece: Piece of each front, shape (front_count,).
        places: Row of its piece's part of Y at which each node begins, by rank; -1 at the first
            node of a front that is not reached, shape (node_count,).
        rows: Row of H in each lane, piece by piece.
        arrival: Lanes in the order in which their rows came, piece by piece.
        lane: Lane of each entry of H.
        strips: First strip and end of the strips with rows of each front, shape (front_count, 2).
        chosen: Room for as many lanes as a piece may have.
        size: Doubles in Y.
        work_size: Most lanes of a piece.
        gram_size: Most doubles of a piece's product YᵀY.
    """

    def __init__(self, elimination: Elimination):
        """Find the pieces of a forest."""
        self._elimination = elimination
        parent, first = elimination.parent, elimination.first
        ends = np.flatnonzero(parent == NONE) + 1  # postorder: a root ends its tree
        self.pieces = np.zeros(len(ends), dtype=PIECE)
        self.pieces["first_front"] = np.concatenate([[0], ends])[: len(ends)]
        self.pieces["end_front"] = ends
        self.piece = np.repeat(np.arange(len(ends)), ends - self.pieces["first_front"])
        self.places = np.full(int(first[-1]), NONE)
        self.strips = np.zeros((len(parent), 2), dtype=np.int64)
        self._bucket = np.full(len(parent), NONE)
        self._room_for(0, 0)
        self._measure()

    def _room_for(self, entry_count: int, row_count: int) -> None:
        """Index arrays large enough."""
        room = np.zeros((8, entry_count), dtype=np.int64)
        self.rows, self.arrival, self.lane, self.chosen, self._order = room[:5]
        self._sorting = room[5:]
        self._placed = np.zeros((2, entry_count), dtype=np.int64)
        self._placed_count = NONE
        self._lane_of_row = np.zeros(row_count, dtype=np.int64)

    def place(self, row_index: np.ndarray, ranks: np.ndarray, row_count: int) -> None:
        """Give the rows of H their lanes.

        Args:
            row_index: Row of each entry, shape (entry_count,).
            ranks: Rank of the node of each entry, shape (entry_count,).
            row_count: Number of rows.
        """
        if _same(row_index, ranks, self._placed, self._placed_count):
            return
        if len(row_index) > len(self.lane) or row_count > len(self._lane_of_row):
            entries = max(len(row_index), 2 * len(self.lane))
            self._room_for(entries, max(row_count, 2 * len(self._lane_of_row)))
        tree = self._elimination
        _reach_fronts(tree.front, tree.parent, ranks, self.places, tree.first)
        _place_fronts(tree.first, self.places, self.pieces)
        _give_lanes(
            tree.front, self.piece, row_index, ranks, self.pieces, self._order,
            self._lane_of_row, self.rows, self.lane,
        )  # fmt: skip
        _sort_lanes(
            tree.front, ranks, self.pieces, self._order, self.rows, self.arrival, self.lane,
            self._bucket, self._sorting,
        )  # fmt: skip
        _find_strips(tree.front, tree.parent, ranks, self.lane, self.strips)
        self._measure()
        self._placed_count = len(row_index)
        self._placed[0, : len(row_index)] = row_index
        self._placed[1, : len(row_index)] = ranks

    def _measure(self) -> None:
        self.size, self.work_size, self.gram_size = _stack_pieces(self.pieces)

    @property
    def rank(self) -> int:
        """Rows of Y that are not zero, of the pieces that rows touch."""
        return int(self.pieces["dof_count"][self.pieces["row_count"] > 0].sum())

    def most_sizes(self, ranks: np.ndarray, row_count: int) -> tuple[int, int, int]:
        """Size, work size and gram size that rows on some nodes may need, given by rank."""
        if len(ranks) > len(self.lane) or row_count > len(self._lane_of_row):
            self._room_for(len(ranks), row_count)
        tree = self._elimination
        _reach_fronts(tree.front, tree.parent, ranks, self.places, tree.first)
        _place_fronts(tree.first, self.places, self.pieces)
        self.pieces["row_count"] = row_count
        self._placed_count = NONE
        return _stack_pieces(self.pieces)


@njit(**KERNEL)
def _same(row_index, ranks, placed, placed_count):
    """True if these are the entries placed last."""
    if len(ranks) != placed_count:
        return False
    for e in range(len(ranks)):
        if row_index[e] != placed[0, e] or ranks[e] != placed[1, e]:
            return False
    return True


@njit(**KERNEL)
def _reach_fronts(front, parent, ranks, places, first):
    """Mark the fronts of some nodes and all their ancestors, at their first node: 0, else -1."""
    for s in range(len(parent)):
        places[first[s]] = NONE
    for rank in ranks:
        s = front[rank]
        while s != NONE and places[first[s]] == NONE:
            places[first[s]] = 0
            s = parent[s]


@njit(**KERNEL)
def _place_fronts(first, places, pieces):
    """Stack the nodes of the reached fronts, piece by piece."""
    for p in range(len(pieces)):
        place = 0
        for s in range(pieces[p].first_front, pieces[p].end_front):
            if places[first[s]] != NONE:
                for rank in range(first[s], first[s + 1]):
                    places[rank] = place
                    place += 3
        pieces[p].dof_count = place


@njit(**KERNEL)
def _give_lanes(front, piece, row_index, ranks, pieces, order, lane_of_row, rows, lane):
    """List the rows that touch each piece, in the order in which they come."""
    for p in range(len(pieces)):
        pieces[p].entry_end = 0
        pieces[p].row_count = 0
    for e in range(len(ranks)):
        pieces[piece[front[ranks[e]]]].entry_end += 1
    start = 0
    for p in range(len(pieces)):
        count = pieces[p].entry_end
        pieces[p].entry_end = start
        start += count
    for e in range(len(ranks)):
        p = piece[front[ranks[e]]]
        order[pieces[p].entry_end] = e
        pieces[p].entry_end += 1
    # Each piece's entries now end where its counter stands. A row has its lane in a piece if the
    # list of that piece names it there; what is left over from other pieces does not.
    lane_of_row[:] = 0
    begin = start = 0
    for p in range(len(pieces)):
        pieces[p].row_start = start
        count = 0
        for o in range(begin, pieces[p].entry_end):
            e = order[o]
            row = row_index[e]
            known = lane_of_row[row]
            if known >= count or rows[start + known] != row:
                known = lane_of_row[row] = count
                rows[start + count] = row
                count += 1
            lane[e] = known
        begin = pieces[p].entry_end
        start += count
        pieces[p].row_count = count


@njit(**KERNEL)
def _sort_lanes(front, ranks, pieces, order, rows, arrival, lane, bucket, sorting):
    """Sort the lanes of pieces with several strips by the first front of their rows."""
    first, following, sorted_rows = sorting[0], sorting[1], sorting[2]
    begin = 0
    for p in range(len(pieces)):
        start, count, end = pieces[p].row_start, pieces[p].row_count, pieces[p].entry_end
        for k in range(count):
            arrival[start + k] = k
        if count >= STRIP:
            for k in range(count):
                first[start + k] = pieces[p].end_front
            for o in range(begin, end):
                k = start + lane[order[o]]
                first[k] = min(first[k], front[ranks[order[o]]])
            for k in range(start + count - 1, start - 1, -1):
                following[k] = bucket[first[k]]
                bucket[first[k]] = k
            place = start
            for s in range(pieces[p].first_front, pieces[p].end_front):
                k = bucket[s]
                bucket[s] = NONE
                while k != NONE:
                    sorted_rows[place] = rows[k]
                    arrival[k] = place - start
                    place += 1
                    k = following[k]
            rows[start : start + count] = sorted_rows[start : start + count]
            for o in range(begin, end):
                lane[order[o]] = arrival[start + lane[order[o]]]
        begin = end


@njit(**KERNEL)
def _find_strips(front, parent, ranks, lane, strips):
    """Range of strips with rows of each front; what a front has, its ancestors have too."""
    for s in range(len(parent)):
        strips[s, 0], strips[s, 1] = _NO_STRIP, 0
    for e in range(len(ranks)):
        s, strip = front[ranks[e]], lane[e] // STRIP
        strips[s, 0] = min(strips[s, 0], strip)
        strips[s, 1] = max(strips[s, 1], strip + 1)
    for s in range(len(parent)):
        if parent[s] != NONE:
            strips[parent[s], 0] = min(strips[parent[s], 0], strips[s, 0])
            strips[parent[s], 1] = max(strips[parent[s], 1], strips[s, 1])


@njit(**KERNEL)
def _stack_pieces(pieces):
    """Give each piece its part of Y; the size of all, the most lanes, the largest product."""
    size = most_lanes = most_gram = 0
    for p in range(len(pieces)):
        lanes = STRIP * (pieces[p].row_count // STRIP + 1) if pieces[p].dof_count > 0 else 0
        pieces[p].lanes = lanes
        pieces[p].start = size
        size += lanes * pieces[p].dof_count
        most_lanes = max(most_lanes, lanes)
        most_gram = max(most_gram, (lanes + WIDE) * lanes)
    return size, max(most_lanes, STRIP), most_gram
