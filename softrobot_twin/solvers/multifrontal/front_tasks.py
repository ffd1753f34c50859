"""A factorization as tasks, of which several threads run those that do not wait for each other.

Subtrees never meet, so small ones are a task each. Above them, a front that costs little is a task.
The large fronts near the root hold most of the arithmetic, one after the other; they are cut into
tiles. Block column j of a panel is filled, its triangle is factorized, and the tiles below follow:

        ┌ D₁            ┐
        │ T₂₁ D₂        │        D_j waits for T_j,j-1, T_ij for D_j and T_i,j-1;
        │ T₃₁ T₃₂ U₁    │        block columns U of the update wait for the last tiles
        └ T₄₁ T₄₂ U₁ U₂ ┘

Every entry loses the same products in the same order as when one thread runs the fronts one by one,
so the bits are the same for any number of threads, and the same as without tasks.

The order of the list, and what the threads gain, are estimated by the costs of symbolic.py: a list
schedule takes the ready task with the longest way to the root first. A factorization that would
gain little has no tasks.

Arguments of the kernels here:
    front: Layout of one front.
    first, end: Its columns.
    strip, end_strip: Its rows, in strips of eight.
    panels_at, triangles_at: Addresses of the panels and of the triangles.
"""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from softrobot_twin.kernels.compilation import KERNEL, ONCE, njit
from softrobot_twin.kernels.worker_threads import NOTED, finish, take, wait_for
from softrobot_twin.solvers.multifrontal.dense_kernels import TRIANGLE, WIDE, solve_product
from softrobot_twin.solvers.multifrontal.memory_layout import Layout
from softrobot_twin.solvers.multifrontal.numeric_factorization import (
    SUCCESS,
    add_to_panel,
    bar_width,
    factor_fronts,
    factor_panel,
    fill_columns,
    make_update_columns,
)
from softrobot_twin.solvers.multifrontal.symbolic import (
    BAR,
    FRONT,
    HAND_OVER,
    MULTIPLY,
    NONE,
    STORE,
    Elimination,
    front_cost,
)
from softrobot_twin.solvers.multifrontal.vector_code import STRIP, STRIP_BYTES, address

# Cycles until a helper that waits in Python works, and those that a task costs besides its work.
WAKE, OVERHEAD = 1.2e5, 1.0e3
# Share of the time by one thread that threads must save, and fewest cycles of it.
LEAST_GAIN, LEAST_COST = 0.2, 1.0e6
# A task of subtrees costs at most one of so many parts of what a thread does, or so many cycles;
# fronts that cost more are cut. Coarse tasks keep what they compute in their own cache, but where the
# large fronts stand one above the other, only fine ones let threads share them.
PARTS, GRAIN = (6, 12), 1.5e5
# Columns of a block column: a multiple of a bar and of a strip.
BLOCK = 48
FRONTS, FILL, DIAGONAL, TILE, UPDATE = range(5)

# One task. `first` and `end` are fronts, or columns of one front. `strip` and `end_strip` are rows of
# a tile, and where a block column is filled, the matrix's blocks in it.
TASK = np.dtype([
    (name, np.int64)
    for name in ("kind", "front", "first", "end", "strip", "end_strip", "wait_start", "wait_end")
])  # fmt: skip


class TaskList(NamedTuple):
    """Tasks in the order in which threads take them.

    Attributes:
        tasks: `TASK` by `TASK`.
        waits: Tasks that a task waits for, by place in the list.
        thread_count: Threads for which it is ordered.
        cost: Estimated cycles by so many threads.
    """

    tasks: np.ndarray
    waits: np.ndarray
    thread_count: int
    cost: float


def plan_tasks(elimination: Elimination, layout: Layout, thread_count: int) -> TaskList | None:
    """Cut a factorization into tasks for the number of threads that gains most.

    Args:
        elimination: Its fronts.
        layout: Where they lie in memory.
        thread_count: Most threads.

    Returns:
        The tasks; None where one thread is as good.
    """
    if thread_count < 2 or elimination.cost < LEAST_COST:
        return None
    fronts = layout.fronts
    own = np.array([
        front_cost(columns // 3, (rows - columns) // 3)
        for columns, rows in zip(fronts["columns"], fronts["rows"])
    ])  # fmt: skip
    lists = (
        _scheduled(own, elimination, layout, count, parts)
        for count in range(2, thread_count + 1) for parts in PARTS
    )
    best = min(lists, key=lambda one: one.cost)
    return best if best.cost < (1.0 - LEAST_GAIN) * elimination.cost else None


def task_begins(tasks: TaskList, front_count: int) -> np.ndarray:
    """Whether a front is not the one behind another of the same task, shape (front_count,)."""
    begins = np.ones(front_count, bool)
    for task in tasks.tasks[tasks.tasks["kind"] == FRONTS]:
        begins[task["first"] + 1 : task["end"]] = False
    return begins


def _scheduled(
    own: np.ndarray, elimination: Elimination, layout: Layout, count: int, parts: int
) -> TaskList:
    """Tasks in the order in which so many threads take them, and what they cost."""
    tasks, waits, costs = _cut(own, elimination, layout, parts * count)
    order, length = list_schedule(costs, waits, count)
    place = np.empty(len(order), np.int64)
    place[order] = np.arange(len(order))
    found = np.zeros(len(order), TASK)
    for number, task in enumerate(order):
        found[number] = (*tasks[task], 0, 0)
    lengths = [len(waits[task]) for task in order]
    found["wait_end"] = np.cumsum(lengths)
    found["wait_start"] = found["wait_end"] - lengths
    flat = np.array([place[one] for task in order for one in waits[task]], np.int64)
    return TaskList(found, flat, count, length + WAKE)


def list_schedule(
    costs: Sequence[float], waits: Sequence[Sequence[int]], thread_count: int
) -> tuple[list[int], float]:
    """The order in which threads begin tasks, the one with the longest way to the end first.

    Args:
        costs: Of each task [cycles].
        waits: Tasks that each waits for, all before it.
        thread_count: How many threads.

    Returns:
        The tasks in the order in which they begin, and when the last one ends [cycles].
    """
    count = len(costs)
    ways, left = [0.0] * count, [len(one) for one in waits]
    followers: list[list[int]] = [[] for _ in range(count)]
    for task in reversed(range(count)):
        ways[task] += costs[task]
        for one in waits[task]:
            ways[one] = max(ways[one], ways[task])
            followers[one].append(task)
    ready = [(-ways[task], task) for task in range(count) if not left[task]]
    heapq.heapify(ready)
    running: list[tuple[float, int]] = []
    order, now = [], 0.0
    while ready or running:
        while ready and len(running) < thread_count:
            task = heapq.heappop(ready)[1]
            order.append(task)
            heapq.heappush(running, (now + costs[task], task))
        now, ended = heapq.heappop(running)
        for task in followers[ended]:
            left[task] -= 1
            if not left[task]:
                heapq.heappush(ready, (-ways[task], task))
    return order, now


def _cut(
    own: np.ndarray, elimination: Elimination, layout: Layout, part_count: int
) -> tuple[list[tuple], list[list[int]], list[float]]:
    """Tasks, which earlier ones each waits for, and their costs."""
    fronts, parent, children = layout.fronts, elimination.parent, layout.children
    whole, sizes = list(own), [1] * len(own)
    for s, above in enumerate(parent):
        if above != NONE:
            whole[above] += whole[s]
            sizes[above] += sizes[s]
    grain = max(GRAIN, own.sum() / part_count)
    tasks: list[tuple] = []
    waits: list[list[int]] = []
    costs: list[float] = []
    # Tasks after which a front's update is complete.
    ends: list[list[int]] = [[] for _ in own]

    def add(kind: int, front: int, first: int, end: int, cost: float, waited: Sequence[int],
            strip: int = 0, end_strip: int = 0) -> int:  # fmt: skip
        tasks.append((kind, front, first, end, strip, end_strip))
        waits.append(list(waited))
        costs.append(float(cost) + OVERHEAD)
        return len(tasks) - 1

    def gather(first: int, end: int, cost: float) -> None:
        """Make complete subtrees one task."""
        if first < end:
            ends[first:end] = [[add(FRONTS, first, first, end, cost, ())]] * (end - first)

    begin, gathered = 0, 0.0  # subtrees that become one task
    is_small = [cost <= grain for cost in whole]
    for s in range(len(own)):
        if is_small[s]:
            if parent[s] != NONE and is_small[parent[s]]:
                continue
            if gathered + whole[s] > grain:
                gather(begin, s - sizes[s] + 1, gathered)
                begin, gathered = s - sizes[s] + 1, 0.0
            gathered += whole[s]
            continue
        gather(begin, s, gathered)
        begin, gathered = s + 1, 0.0
        below = children[fronts[s]["child_start"] : fronts[s]["child_end"]]
        waited = sorted({task for child in below for task in ends[child]})
        if own[s] <= grain:
            ends[s] = [add(FRONTS, s, s, s + 1, own[s], waited)]
        else:
            ends[s] = _cut_front(s, fronts[s], layout.block_places, waited, add)
    gather(begin, len(own), gathered)
    return tasks, waits, costs


def _cut_front(s: int, front: np.void, block_places: np.ndarray, waited: Sequence[int], add) -> list[int]:
    """Add the tasks of one front; the ones after which its update is complete."""
    columns, rows, padding, strips = (
        int(front[name]) for name in ("columns", "rows", "padding", "strips")
    )
    firsts = list(range(0, columns, BLOCK))
    bounds = [-(-(padding + min(first + BLOCK, columns)) // STRIP) for first in firsts]
    while bounds[-1] < strips:
        bounds.append(min(bounds[-1] + BLOCK // STRIP, strips))
    # The matrix's blocks are sorted by columns.
    places = block_places[front["block_start"] : front["block_end"]]
    column_of_block = (places - front["panel"]) // front["stride"]
    left: list[int] = []  # the tiles of the block column before, by rows
    last = NONE
    for j, first in enumerate(firsts):
        end = min(first + BLOCK, columns)
        size = end - first
        blocks = int(front["block_start"]) + np.searchsorted(column_of_block, [first, end])
        fill = add(
            FILL, s, first, end, FRONT + STORE * size * (strips - (padding + first) // STRIP),
            waited, *blocks,
        )  # fmt: skip
        height = bounds[j] - (padding + first) // STRIP
        depth = 0.5 * (first + end)
        cost = BAR * size / WIDE + size * height * (STORE + MULTIPLY * depth)
        last = add(
            DIAGONAL, s, first, end, cost, [fill, *left[:1]], 0, bounds[j]
        )
        left = [
            add(
                TILE, s, first, end, size * (upper - lower) * (STORE + MULTIPLY * depth),
                [last, *left[i + 1 : i + 2]], lower, upper,
            )
            for i, (lower, upper) in enumerate(zip(bounds[j:], bounds[j + 1 :]))
        ]  # fmt: skip
    if rows == columns:
        return [last, *left]
    return [
        add(
            UPDATE, s, first, end,
            FRONT + (end - first) * (strips - (padding + first) // STRIP)
            * (STORE + HAND_OVER + MULTIPLY * columns), [last, *left],
        )
        for first in range(columns, rows, BLOCK) for end in (min(first + BLOCK, rows),)
    ]  # fmt: skip


@njit(**ONCE)
def _factor_tile(front, first, end, strip, end_strip, panels_at, triangles_at):
    """Rows below the diagonal of some columns of a panel."""
    panel = panels_at + 8 * front.panel
    start = first
    while start < end:
        width = bar_width(start, end)
        column = panel + 8 * start * front.stride
        solve_product(
            width, end_strip - strip, start, panel + STRIP_BYTES * strip, front.stride,
            panel + 8 * (front.padding + start), front.stride, column + STRIP_BYTES * strip,
            front.stride, triangles_at + 8 * (front.triangles + TRIANGLE * (start // WIDE)),
        )  # fmt: skip
        start += width


@njit(**KERNEL)
def factorize_by_tasks(
    waits_for_all, state, done, tasks, waits, fronts, children, runs, block_places, storage,
    panels, updates, triangles,
):  # fmt: skip
    """A = L Lᵀ, by all threads that call this.

    Args:
        waits_for_all: Whether to return when all tasks are done, or when none is left to begin.
        state: State of the list; notes one more than a front that is not positive definite.
        done: Whether each task is done, shape (task_count,).
        tasks: `TASK` by `TASK`, shape (task_count,).
        waits: Tasks that a task waits for.
        fronts, children, runs, block_places, storage, panels, updates, triangles: See `factorize`.

    Returns:
        -1, or a front that is not positive definite.
    """
    panels_at, updates_at, triangles_at = address(panels), address(updates), address(triangles)
    number = take(state)
    while number < len(tasks):
        task = tasks[number]
        for k in range(task.wait_start, task.wait_end):
            if not wait_for(waits[k], state, done):
                return SUCCESS
        front = fronts[task.front]
        if state[NOTED] != 0:
            pass
        elif task.kind == FRONTS:
            failed_at = factor_fronts(
                task.first, task.end, fronts, children, runs, block_places, storage, panels,
                updates, triangles,
            )  # fmt: skip
            if failed_at != SUCCESS:
                state[NOTED] = failed_at + 1
        elif task.kind == FILL:
            fill_columns(
                front, task.first, task.end, task.strip, task.end_strip, panels_at, storage,
                block_places,
            )  # fmt: skip
            add_to_panel(
                front, True, task.first, task.end, fronts, children, runs, panels_at, updates_at
            )
        elif task.kind == DIAGONAL:
            if not factor_panel(
                panels_at + 8 * front.panel, front.stride, front.padding, task.first, task.end,
                task.end_strip,
                triangles_at + 8 * (front.triangles + TRIANGLE * (task.first // WIDE)),
            ):  # fmt: skip
                state[NOTED] = task.front + 1
        elif task.kind == TILE:
            _factor_tile(
                front, task.first, task.end, task.strip, task.end_strip, panels_at, triangles_at
            )
        else:
            make_update_columns(
                front, True, task.first, task.end, fronts, children, runs, panels_at, updates_at
            )
        finish(number, done)
        number = take(state)
    if waits_for_all:
        for number in range(len(tasks)):
            if not wait_for(number, state, done):
                return SUCCESS
    return state[NOTED] - 1
