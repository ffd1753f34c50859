"""Memory layout: panels, updates and the blocks of the matrix, planned once.

    storage    the matrix's lower blocks, nine doubles each, in the order in which fronts read
               them; assembly adds here, and factorizing leaves it unchanged
    panels     the factor L, one panel per front
    updates    what fronts leave to their parents; memory is reused once the parent has added it
    triangles  the diagonal blocks of L, see dense_kernels.py
"""

from __future__ import annotations

from bisect import insort
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from softrobot_twin.solvers.multifrontal.dense_kernels import TRIANGLE, WIDE
from softrobot_twin.solvers.multifrontal.symbolic import Elimination, front_of_rows
from softrobot_twin.solvers.multifrontal.vector_code import STRIP


# One front. Rows and columns count degrees of freedom; offsets and strides count doubles. Ranges
# `x_start` to `x_end` are indices into another array of the layout.
FRONT = np.dtype([
    ("columns", np.int64),         # eliminated here
    ("rows", np.int64),            # all rows, the columns' own first
    ("padding", np.int64),         # unused rows on top, so that columns end on a whole strip
    ("strips", np.int64),          # height of the panel with its padding
    ("first_rank", np.int64),      # rank of the first node
    ("panel", np.int64),           # offset in `panels`
    ("stride", np.int64),
    ("triangles", np.int64),       # offset in `triangles`
    ("update", np.int64),          # offset in `updates`, at the strip with the update's first row
    ("update_padding", np.int64),  # rows of that strip above the first row
    ("update_stride", np.int64),
    ("row_start", np.int64),
    ("row_end", np.int64),
    ("block_start", np.int64),
    ("block_end", np.int64),
    ("child_start", np.int64),
    ("child_end", np.int64),
    ("run_start", np.int64),
    ("run_split", np.int64),       # first run that goes to the parent's update, not its panel
    ("run_end", np.int64),
])  # fmt: skip

# Rows of an update that are contiguous in the parent too.
RUN = np.dtype([("source", np.int64), ("target", np.int64), ("count", np.int64)])


class Layout(NamedTuple):
    """Offsets in memory, and all index arithmetic that depends only on the sparsity pattern.

    Attributes:
        fronts: One `FRONT` each, in elimination order.
        rows: Rank of each node below a front's own columns.
        children: Fronts whose updates a front adds.
        runs: `RUN` by `RUN`, where updates go in their parents.
        block_keys: Column rank × node count + row rank of each block, ascending.
        block_places: Where a block goes in `panels`, at its entry (0, 0).
        panels_size: Doubles in `panels`.
        updates_size: Doubles in `updates`.
        triangles_size: Doubles in `triangles`.
    """

    fronts: np.ndarray
    rows: np.ndarray
    children: np.ndarray
    runs: np.ndarray
    block_keys: np.ndarray
    block_places: np.ndarray
    panels_size: int
    updates_size: int
    triangles_size: int


def lay_out(elimination: Elimination, indptr: np.ndarray, indices: np.ndarray) -> Layout:
    """Plan the memory of an elimination.

    Args:
        elimination: Its fronts.
        indptr: The node graph in elimination order.
        indices: Its neighbours, as ranks.
    """
    count = len(elimination.parent)
    fronts = np.zeros(count, dtype=FRONT)
    own = np.diff(elimination.first)
    below = np.diff(elimination.row_start)
    fronts["columns"] = 3 * own
    fronts["rows"] = 3 * (own + below)
    fronts["first_rank"] = elimination.first[:-1]
    fronts["row_start"] = elimination.row_start[:-1]
    fronts["row_end"] = elimination.row_start[1:]
    fronts["strips"] = -(-fronts["rows"] // STRIP)
    fronts["padding"] = STRIP * fronts["strips"] - fronts["rows"]
    fronts["stride"] = _stride(fronts["strips"])
    hidden = fronts["padding"] + fronts["columns"]
    fronts["update_padding"] = hidden % STRIP
    fronts["update_stride"] = _stride(fronts["strips"] - hidden // STRIP)

    panels_size = _stack(fronts, "panel", fronts["stride"] * fronts["columns"])
    bars = -(-fronts["columns"] // WIDE)
    triangles_size = _stack(fronts, "triangles", TRIANGLE * bars)
    children = _children(fronts, elimination.parent)
    sizes = update_sizes(fronts)
    fronts["update"], updates_size = plan_updates(sizes, fronts, children)
    runs = _runs(fronts, elimination)
    keys, places = _blocks(fronts, elimination, indptr, indices)
    return Layout(
        fronts, elimination.rows, children, runs, keys, places,
        panels_size, updates_size, triangles_size,
    )  # fmt: skip


def update_sizes(fronts: np.ndarray) -> np.ndarray:
    """Doubles of each front's update, shape (front_count,).

    Args:
        fronts: One `FRONT` each.
    """
    return fronts["update_stride"] * (fronts["rows"] - fronts["columns"])


def _stride(strips: np.ndarray) -> np.ndarray:
    """Column strides of an odd number of strips: even ones fall into few sets of a cache."""
    return STRIP * (strips | 1)


def _stack(fronts: np.ndarray, field: str, sizes: np.ndarray) -> int:
    """Place the arrays one after the other; returns where they end."""
    ends = np.cumsum(sizes)
    fronts[field] = ends - sizes
    return int(ends[-1]) if len(ends) else 0


def _write_ranges(fronts: np.ndarray, name: str, front_of_entry: np.ndarray) -> None:
    """Write where the entries of each front begin and end in a list that is sorted by fronts."""
    numbers = np.arange(len(fronts))
    fronts[f"{name}_start"] = np.searchsorted(front_of_entry, numbers)
    fronts[f"{name}_end"] = np.searchsorted(front_of_entry, numbers, side="right")


def _children(fronts: np.ndarray, parent: np.ndarray) -> np.ndarray:
    """Children of all fronts, in the order in which they are finished."""
    children = np.argsort(parent, kind="stable")
    sorted_parents = parent[children]
    _write_ranges(fronts, "child", sorted_parents)
    return children.astype(np.int64)


def _runs(fronts: np.ndarray, elimination: Elimination) -> np.ndarray:
    """Where each update's rows go in the parent's front."""
    rows, front_of_row = elimination.rows, front_of_rows(elimination)
    parent = elimination.parent[front_of_row]
    target = _local_rows(elimination, parent, rows)
    source = np.arange(len(rows)) - elimination.row_start[front_of_row]
    in_panel = rows < elimination.first[parent + 1]
    begins = np.ones(len(rows), dtype=bool)
    begins[1:] = ((np.diff(front_of_row) != 0) | (np.diff(target) != 1) | (np.diff(in_panel) != 0))
    at = np.flatnonzero(begins)
    runs = np.zeros(len(at), dtype=RUN)
    runs["source"], runs["target"] = 3 * source[at], 3 * target[at]
    runs["count"] = 3 * np.diff(np.append(at, len(rows)))
    _write_ranges(fronts, "run", front_of_row[at])
    into_panel = np.bincount(front_of_row[at], weights=in_panel[at], minlength=len(fronts))
    fronts["run_split"] = fronts["run_start"] + into_panel.astype(np.int64)
    return runs


def _local_rows(elimination: Elimination, fronts: np.ndarray, ranks: np.ndarray) -> np.ndarray:
    """Position of nodes, given by rank, among all nodes of given fronts."""
    own = np.diff(elimination.first)[fronts]
    # Rows are sorted within fronts: look them up by front and rank together.
    count = len(elimination.order)
    keys = front_of_rows(elimination) * count + elimination.rows
    among_rows = np.searchsorted(keys, fronts * count + ranks) - elimination.row_start[fronts]
    offset = ranks - elimination.first[fronts]
    return np.where(offset < own, offset, own + among_rows)


def _blocks(
    fronts: np.ndarray, elimination: Elimination, indptr: np.ndarray, indices: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Keys of the lower blocks, and their places in the panels."""
    count = len(elimination.order)
    column = np.concatenate([np.repeat(np.arange(count), np.diff(indptr)), np.arange(count)])
    row = np.concatenate([indices, np.arange(count)])
    keys = np.sort((column * count + row)[row >= column])
    column, row = keys // max(count, 1), keys % max(count, 1)
    number = elimination.front[column]
    front = fronts[number]
    places = (
        front["panel"]
        + front["padding"]
        + 3 * _local_rows(elimination, number, row)
        + 3 * (column - front["first_rank"]) * front["stride"]
    )
    _write_ranges(fronts, "block", number)
    return keys, places


class FirstFit:
    """First-fit allocation in unlimited memory: the lowest free interval that is long enough."""

    def __init__(self, free: Sequence[tuple[int, int]] = ((0, 1 << 62),), size: int = 0):
        """Begin.

        Args:
            free: Start and length of what is free, ascending.
            size: Greatest extent in use before.
        """
        self.size = size  # greatest extent ever in use
        self._free = list(free)

    def parts_before(self, end: int) -> list[tuple[int, int]]:
        """Free intervals before a place, as start and length.

        Args:
            end: The place.
        """
        return [(start, min(length, end - start)) for start, length in self._free if start < end]

    def take(self, size: int) -> int:
        """Reserve an interval; returns its start.

        Args:
            size: Its length [doubles].
        """
        for number, (start, length) in enumerate(self._free):
            if length >= size:
                self._free[number] = (start + size, length - size)
                self.size = max(self.size, start + size)
                return start
        raise MemoryError(f"no memory for an update of {size} doubles")

    def give_back(self, start: int, size: int) -> None:
        """Free an interval, and join it with free neighbours.

        Args:
            start: Where it begins.
            size: Its length [doubles].
        """
        insort(self._free, (start, size))
        joined = []
        for start, size in self._free:
            if joined and sum(joined[-1]) == start:
                joined[-1] = (joined[-1][0], joined[-1][1] + size)
            else:
                joined.append((start, size))
        self._free = joined


def plan_updates(
    sizes: np.ndarray, fronts: np.ndarray, children: np.ndarray, begins: np.ndarray | None = None
) -> tuple[np.ndarray, int]:
    """Offsets of all updates: allocated when a front writes its update, freed by its parent.

    Args:
        sizes: Doubles of each front's update, shape (front_count,).
        fronts: The fronts' `child_start` and `child_end` in `children`.
        children: Fronts whose updates a front adds.
        begins: Whether a task begins with a front, shape (front_count,): tasks share no memory with
            those that they do not wait for. None without tasks.

    Returns:
        Offsets, shape (front_count,), and the size of the memory.
    """
    offsets = np.zeros(len(sizes), dtype=np.int64)
    memory = FirstFit()
    unused: list[list[tuple[int, int]]] = []  # of each subtree that is complete
    begins = np.zeros(len(sizes), bool) if begins is None else begins
    for s in range(len(sizes)):
        own = children[fronts[s]["child_start"] : fronts[s]["child_end"]]
        if begins[s]:
            # What the front's own subtrees used, else new memory behind all.
            free, end = [part for child in own for part in unused[child]], memory.size
            memory = FirstFit([*sorted(free), (end, 1 << 62)], end)
        # A front writes its own update while its children's are still being added.
        if sizes[s]:
            offsets[s] = memory.take(int(sizes[s]))
        for child in own:
            if sizes[child]:
                memory.give_back(int(offsets[child]), int(sizes[child]))
        is_last = begins[s + 1 : s + 2].all()
        unused.append(memory.parts_before(memory.size) if is_last else [])
    return offsets, memory.size
