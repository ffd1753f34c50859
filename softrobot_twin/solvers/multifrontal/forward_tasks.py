"""Forward elimination of a step's right-hand sides as tasks, see front_tasks.py.

One thread adds what a front takes from its rows below as soon as it is known. Here each front keeps
it, and a front that is begun gathers it from its descendants, in their order: entries are sums of
the same numbers in the same order, and the bits are the same.

Arguments of the kernels here:
    s, front: One front, by number and by its layout.
    fronts, rows, panels, triangles, places, tree, trees, ranges, y, Y: See `condensation.forward`.
    segments, segment_start: See `ForwardTasks`.
    kept: What fronts take from y, by their rows.
    kept_rows: What they take from Y, rows of `widest` doubles.
    work: Memory for one front.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softrobot_twin.kernels.compilation import KERNEL, ONCE, njit
from softrobot_twin.kernels.worker_threads import finish, take, wait_for
from softrobot_twin.solvers.multifrontal.condensation import (
    NODE_BYTES,
    solve_columns,
    solve_single,
    take_over,
)
from softrobot_twin.solvers.multifrontal.dense_kernels import (
    NARROW,
    add_node,
    add_strips,
    copy_node,
)
from softrobot_twin.solvers.multifrontal.front_tasks import TaskList, plan_whole_fronts
from softrobot_twin.solvers.multifrontal.memory_layout import Layout
from softrobot_twin.solvers.multifrontal.symbolic import Elimination, front_of_rows
from softrobot_twin.solvers.multifrontal.vector_code import STRIP, STRIP_BYTES, address

# Rows of one front that are nodes of another one: that other front's `first` to `end` of `Layout.rows`.
SEGMENT = np.dtype([("front", np.int64), ("first", np.int64), ("end", np.int64)])


class ForwardTasks(NamedTuple):
    """What forward elimination by several threads needs.

    Attributes:
        tasks: The tasks, ranges of fronts.
        segments: `SEGMENT` by `SEGMENT`, where fronts find what they lose, descendants ascending.
        segment_start: Where those of each front begin, shape (front_count + 1,).
    """

    tasks: TaskList
    segments: np.ndarray
    segment_start: np.ndarray


def plan_forward(
    elimination: Elimination, layout: Layout, thread_count: int
) -> ForwardTasks | None:
    """Cut forward elimination into tasks.

    Args:
        elimination: Its fronts.
        layout: Where they lie in memory.
        thread_count: How many threads.

    Returns:
        The tasks; None where one thread is as good.
    """
    fronts = layout.fronts
    # A solve reads each entry of L once, about one a cycle.
    tasks = plan_whole_fronts(fronts["stride"] * fronts["columns"], elimination, layout, thread_count)
    if tasks is None:
        return None
    sender, receiver = front_of_rows(elimination), elimination.front[elimination.rows]
    begins = np.ones(len(sender), bool)
    begins[1:] = (np.diff(sender) != 0) | (np.diff(receiver) != 0)
    first = np.flatnonzero(begins)
    segments = np.zeros(len(first), SEGMENT)
    segments["front"], segments["first"] = sender[first], first
    segments["end"] = np.append(first[1:], len(sender))
    order = np.argsort(receiver[first], kind="stable")
    starts = np.searchsorted(receiver[first][order], np.arange(len(fronts) + 1))
    return ForwardTasks(tasks, segments[order], starts.astype(np.int64))


@njit(**ONCE)
def _add_kept(
    s, fronts, rows, segments, segment_start, places, tree, trees, ranges, y_at, Y_at, kept_at,
    kept_rows_at, widest,
):  # fmt: skip
    """Add to a front's own rows what its descendants take from them."""
    part = trees[tree[s]]
    stride, last = part.stride, part.row_count // STRIP
    for k in range(segment_start[s], segment_start[s + 1]):
        sender, first, end = segments[k].front, segments[k].first, segments[k].end
        if places[fronts[sender].first_rank] < 0:
            for p in range(first, end):
                add_node(y_at + NODE_BYTES * rows[p], kept_at + NODE_BYTES * p)
            continue
        strip, end_strip = ranges[sender, 0], ranges[sender, 1]
        is_apart = end_strip < last
        if not is_apart:
            end_strip = last + 1
        for p in range(first, end):
            target = Y_at + 8 * (part.start + stride * places[rows[p]])
            source = kept_rows_at + 8 * NARROW * widest * p
            for _ in range(NARROW):
                add_strips(
                    target + STRIP_BYTES * strip, source + STRIP_BYTES * strip, end_strip - strip
                )
                if is_apart:
                    add_strips(target + STRIP_BYTES * last, source + STRIP_BYTES * last, 1)
                target += 8 * stride
                source += 8 * widest


@njit(**KERNEL)
def forward_by_tasks(
    waits_for_all, state, done, tasks, waits, fronts, rows, segments, segment_start, panels,
    triangles, places, tree, trees, ranges, y, Y, kept, kept_rows, widest, work_size,
):  # fmt: skip
    """y ← L⁻¹ y and Y ← L⁻¹ Y, in place, by all threads that call this.

    Args:
        waits_for_all: Whether to return when all tasks are done, or when none is left to begin.
        state: State of the list.
        done: Whether each task is done, shape (task_count,).
        tasks: `TASK` by `TASK`, shape (task_count,).
        waits: Tasks that a task waits for.
        widest: Doubles in a row of `kept_rows`, those of the widest tree.
        work_size: Most padded rows of a front.
    """
    y_at, Y_at, kept_at, kept_rows_at = address(y), address(Y), address(kept), address(kept_rows)
    work = np.empty(work_size)
    number = take(state)
    while number < len(tasks):
        task = tasks[number]
        for k in range(task.wait_start, task.wait_end):
            if not wait_for(waits[k], state, done):
                return
        for s in range(task.first, task.end):
            _add_kept(
                s, fronts, rows, segments, segment_start, places, tree, trees, ranges, y_at, Y_at,
                kept_at, kept_rows_at, widest,
            )  # fmt: skip
            front = fronts[s]
            panel = address(panels) + 8 * front.panel
            triangle = address(triangles) + 8 * front.triangles
            place = places[front.first_rank]
            if place < 0:
                solve_single(front, panel, triangle, y_at, work)
                entry = address(work) + 8 * (front.padding + front.columns)
                for p in range(front.row_start, front.row_end):
                    copy_node(kept_at + NODE_BYTES * p, entry)
                    entry += NODE_BYTES
                continue
            part = trees[tree[s]]
            take_over(front, part, place, y, Y)
            stride = part.stride
            at, target = Y_at + 8 * part.start, kept_rows_at + 8 * NARROW * widest * front.row_start
            strip, end, last = ranges[s, 0], ranges[s, 1], part.row_count // STRIP
            if end >= last:
                end = last + 1
            else:  # b stands apart
                solve_columns(
                    front, panel, triangle, at, stride, place, last, last + 1,
                    target + STRIP_BYTES * last, widest,
                )  # fmt: skip
            solve_columns(
                front, panel, triangle, at, stride, place, strip, end,
                target + STRIP_BYTES * strip, widest,
            )  # fmt: skip
        finish(number, done)
        number = take(state)
    if waits_for_all:
        for number in range(len(tasks)):
            if not wait_for(number, state, done):
                return
