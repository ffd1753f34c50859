"""Parts of a large body that several threads assemble.

The elements of a large body are sorted along its longest side and cut into parts of the same work.
Parts that share no node are assembled at once. Those that share some are assembled in the order of
one list, so that the sums at their nodes have one order for any number of threads. In the list
every other part comes first: few parts then wait for each other.

A kernel that works on parts begins each by `next_part`, which ends the one before. See
`worker_threads.py` for the list of tasks that parts are.

Arguments of the kernels here, and of those that work on parts:
    waits_for_all: Whether to return when all parts are done, or when none is left to begin.
    state, done: Of the list of tasks; empty without threads.
    parts: The parts.
    part: Place of a part among them.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np

from softrobot_twin.geometry.cell_mesh import SomeCells, node_counts_of, points_of
from softrobot_twin.geometry.smoothed_mesh import EdgeRings
from softrobot_twin.kernels.compilation import INNER, njit
from softrobot_twin.kernels.worker_threads import Team, WatchedTeam, finish, run_alone, take, wait_for

LEAST_NODES = 700
"""Nodes of a body that is cut into parts: the factors of smaller ones, too, run on one thread."""
PART_COUNT = 16
"""Parts of a body: with four threads the last ones to end leave few idle for long."""
# A batch so many times as long as others, of rings with so many nodes that there are few, would touch
# nearly all parts: such batches are one part, the last.
_LONG = 3.0


class AssemblyParts(NamedTuple):
    """Parts of a body in the order in which they add to the same node.

    Attributes:
        batches: Batches of elements, part after part, shape (batch_count,).
        begins: Place of the first one of each part, and the number of all, shape (part_count + 1,).
        waits: Earlier parts that share a node with each, part after part.
        wait_begins: Place of the first one of each part, and of all, shape (part_count + 1,).
    """

    batches: np.ndarray
    begins: np.ndarray
    waits: np.ndarray
    wait_begins: np.ndarray


class InParts:
    """What assembles the parts of a body, by threads where that gains time.

    Attributes:
        parts: The parts; a small body is one part.
    """

    parts: AssemblyParts
    _run_list = staticmethod(run_alone)

    def use_threads(self, team: Team) -> None:
        """See `ForceTerm.use_threads`; an assembly in threads is not traced."""
        part_count = len(self.parts.begins) - 1
        if part_count > 1:
            self._run_list, self.is_traceable = partial(WatchedTeam(team).run, part_count), False

    def run_parts(self, kernel: Callable, *arguments):
        """Run a kernel for all parts of the body."""
        return self._run_list(kernel, self.parts, *arguments)


@njit(**INNER)
def next_part(part, parts, waits_for_all, state, done):
    """End a part, -1 for none, and begin the next one of this thread.

    Returns:
        Its place; at the end the number of parts, when all are done where that is wanted.
    """
    if len(done) == 0:
        return part + 1
    if part >= 0:
        finish(part, done)
    part = take(state)
    if part < len(done):
        for k in range(parts.wait_begins[part], parts.wait_begins[part + 1]):
            if not wait_for(parts.waits[k], state, done):
                return len(done)
    elif waits_for_all:
        for other in range(len(done)):
            wait_for(other, state, done)
    return part


def sorted_along(mesh):
    """The cells of a large body sorted along its longest side; a small mesh as it is.

    Args:
        mesh: The cells at rest, as far as elements need them.
    """
    places = _along(mesh.node_positions, mesh.cells)
    if places is None:
        return mesh
    counts = node_counts_of(mesh)
    order = np.lexsort((places[mesh.cells].mean(axis=1), counts))
    cells, points = mesh.cells[order], points_of(mesh, order)
    if isinstance(mesh, EdgeRings):
        return mesh._replace(cells=cells, node_counts=counts[order], points=points, places=mesh.places[order])
    return SomeCells(mesh.node_positions, cells, mesh.shape_functions, points)


def _along(node_positions: np.ndarray, cells: np.ndarray) -> np.ndarray | None:
    """Coordinate of all nodes along the longest side of a large body [m]; None for a small one."""
    nodes = np.unique(cells[cells >= 0])
    if len(nodes) < LEAST_NODES:
        return None
    return node_positions[:, np.ptp(node_positions[nodes], axis=0).argmax()]


def groups_along(mesh, groups: np.ndarray) -> np.ndarray:
    """Groups of the cells of a large body numbered along its longest side; those of a small one as they are.

    Args:
        mesh: The cells at rest, as far as elements need them.
        groups: Number of each cell's group, from 0, shape (cell_count,).
    """
    along = _along(mesh.node_positions, mesh.cells)
    if along is None:
        return groups
    sums = np.bincount(groups, along[mesh.cells].mean(axis=1))
    order = np.argsort(sums / np.bincount(groups), kind="stable")
    return np.argsort(order)[groups]


def parts_of(cells: np.ndarray, free: np.ndarray, node_positions: np.ndarray) -> AssemblyParts:
    """Cut a large body into parts; a small one is one part.

    Args:
        cells: Nodes of its batches of elements, sorted by `sorted_along`, or of groups of them by
            `groups_along`; -1 for none, shape (batch_count, width, BATCH).
        free: Their unknowns, -1 where there are none, same shape.
        node_positions: At rest [m], shape (node_count, 3).
    """
    along, is_own = _along(node_positions, cells), cells >= 0
    if along is None:
        return _listed([np.arange(len(cells))], [[]])
    sizes = is_own.sum(axis=(1, 2))
    places = np.where(is_own, along[cells], np.nan)
    lengths = np.nanmax(places, axis=(1, 2)) - np.nanmin(places, axis=(1, 2))
    is_long = lengths > _LONG * np.median(lengths)
    order = np.argsort(np.where(is_long, np.inf, np.nanmean(places, axis=(1, 2))), kind="stable")
    work = np.cumsum(np.where(is_long, 0, sizes**2)[order])
    cuts = np.searchsorted(work, work[-1] * np.arange(1, PART_COUNT) / PART_COUNT)
    cuts = np.append(cuts, len(order) - is_long.sum())
    parts = [np.sort(part) for part in np.split(order, cuts) if len(part)]
    touches = np.zeros((len(parts), free.max() + 2), np.float32)
    for part, row in zip(parts, touches, strict=True):
        row[free[part]] = 1.0
    touches[:, -1] = 0.0  # Where there is no unknown.
    meets = touches @ touches.T > 0.0
    turns: list[int] = []
    for part in range(len(parts)):
        taken = {turns[other] for other in np.flatnonzero(meets[part, :part])}
        turns.append(min(set(range(part + 1)) - taken))
    order = np.argsort(turns, kind="stable")
    meets = np.tril(meets[np.ix_(order, order)], -1)
    return _listed([parts[part] for part in order], [np.flatnonzero(earlier) for earlier in meets])


def _listed(parts: list[np.ndarray], waits: list) -> AssemblyParts:
    """Lay out parts as arrays."""
    begins, wait_begins = (np.cumsum([0, *map(len, each)]) for each in (parts, waits))
    return AssemblyParts(np.concatenate(parts), begins, np.concatenate(waits).astype(int), wait_begins)
