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

from typing import NamedTuple

import numpy as np

from softrobot_twin.geometry.cell_mesh import SomeCells, node_counts_of, points_of
from softrobot_twin.geometry.smoothed_mesh import EdgeRings
from softrobot_twin.kernels.compilation import INNER, njit
from softrobot_twin.kernels.worker_threads import finish, take, wait_for
from softrobot_twin.mechanics.element_batches import ElementBatches

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
    nodes = np.unique(mesh.cells)
    if len(nodes) < LEAST_NODES:
        return mesh
    places = _along(mesh.node_positions, nodes)
    counts = node_counts_of(mesh)
    order = np.lexsort((places[mesh.cells].mean(axis=1), counts))
    cells, points = mesh.cells[order], points_of(mesh, order)
    if isinstance(mesh, EdgeRings):
        return mesh._replace(cells=cells, node_counts=counts[order], points=points, places=mesh.places[order])
    return SomeCells(mesh.node_positions, cells, mesh.shape_functions, points)


def _along(node_positions: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """Coordinate of all nodes along the longest side of a body [m], of which some are."""
    return node_positions[:, np.ptp(node_positions[nodes], axis=0).argmax()]


def parts_of(batches: ElementBatches, node_positions: np.ndarray) -> AssemblyParts:
    """Cut a large body into parts; a small one is one part.

    Args:
        batches: Its elements, sorted by `sorted_along`.
        node_positions: At rest [m], shape (node_count, 3).
    """
    is_own = batches.cells >= 0
    nodes = np.unique(batches.cells[is_own])
    if len(nodes) < LEAST_NODES:
        return _listed([np.arange(len(batches.cells))], [[]])
    along, sizes = _along(node_positions, nodes), is_own.sum(axis=(1, 2))
    places = np.where(is_own, along[batches.cells], np.nan)
    lengths = np.nanmax(places, axis=(1, 2)) - np.nanmin(places, axis=(1, 2))
    is_long = lengths > _LONG * np.median(lengths)
    order = np.argsort(np.where(is_long, np.inf, np.nanmean(places, axis=(1, 2))), kind="stable")
    work = np.cumsum(np.where(is_long, 0, sizes**2)[order])
    cuts = np.searchsorted(work, work[-1] * np.arange(1, PART_COUNT) / PART_COUNT)
    cuts = np.append(cuts, len(order) - is_long.sum())
    parts = [np.sort(part) for part in np.split(order, cuts) if len(part)]
    touches = np.zeros((len(parts), batches.free.max() + 2), np.float32)
    for part, row in zip(parts, touches, strict=True):
        row[batches.free[part]] = 1.0
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
