"""Patches of neighbouring tetrahedra: a partition of a mesh into small connected groups.

Patches grow one after another over shared faces. A new one begins beside those that are there, at a
cell with few neighbours left, so that few cells remain alone; it takes the cell that brings the
fewest new nodes, which keeps it round. What remains of half a patch or less joins a neighbour. The
result depends on the order of the cells only where all else is equal, and never on chance.
"""

from __future__ import annotations

import heapq
from functools import lru_cache

import numpy as np

# Corners of each face of a tetrahedron.
FACES = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])


def neighbours_of(tets: np.ndarray) -> np.ndarray:
    """The tetrahedron behind each face, -1 at the surface.

    Args:
        tets: Corners, shape (tet_count, 4).

    Returns:
        Shape (tet_count, 4).
    """
    faces = np.sort(tets[:, FACES], axis=2).reshape(-1, 3)
    order = np.lexsort(faces.T[::-1])
    same = (faces[order[1:]] == faces[order[:-1]]).all(axis=1)
    first, second = order[:-1][same], order[1:][same]
    behind = np.full(4 * len(tets), -1, np.int64)
    behind[first], behind[second] = second // 4, first // 4
    return behind.reshape(-1, 4)


def grow_patches(tets: np.ndarray, size: int) -> np.ndarray:
    """Divide tetrahedra into patches that do not overlap.

    Args:
        tets: Corners, shape (tet_count, 4).
        size: Tetrahedra of a patch. Where patches meet some have less, but more than half as many if
            they have a neighbour at all, and some more.

    Returns:
        Number of each tetrahedron's patch, counted from 0, shape (tet_count,); read-only.
    """
    tets = np.ascontiguousarray(tets, np.int64)
    return _patches(tets.tobytes(), size)


# A scene is built anew for each other number, by the same meshes.
@lru_cache(maxsize=16)
def _patches(cells: bytes, size: int) -> np.ndarray:
    """The same, of the corners in memory."""
    tets = np.frombuffer(cells, np.int64).reshape(-1, 4)
    behind = neighbours_of(tets)
    patch = np.full(len(tets), -1, np.int64)
    free = (behind >= 0).sum(axis=1)
    # Cells beside the patches by their number of neighbours left; old entries are passed over.
    beside: list[tuple[int, int]] = []
    count = 0
    for begin in range(len(tets)):
        if patch[begin] >= 0:
            continue
        heapq.heappush(beside, (int(free[begin]), begin))
        while beside:
            left, seed = heapq.heappop(beside)
            if patch[seed] >= 0 or left != free[seed]:
                continue
            _grow(seed, size, count, tets, behind, patch, free, beside)
            count += 1
    joined = _join_small(behind, patch, count, size)
    joined.setflags(write=False)
    return joined


def _grow(seed, size, number, tets, behind, patch, free, beside) -> None:
    """Grow one patch from a cell."""
    nodes: set[int] = set()
    rim = {seed}
    for _ in range(size):
        if not rim:
            break
        cell = min(rim, key=lambda k: (sum(int(n) not in nodes for n in tets[k]), int(free[k]), k))
        rim.discard(cell)
        patch[cell] = number
        nodes.update(map(int, tets[cell]))
        for other in behind[cell]:
            if other >= 0:
                free[other] -= 1
                if patch[other] < 0:
                    rim.add(int(other))
    for cell in rim:
        heapq.heappush(beside, (int(free[cell]), cell))
    # What a patch enclosed, or left with fewer neighbours, is at its rim: nothing else changed.


def _join_small(behind, patch, count, size) -> np.ndarray:
    """Join each patch of half the size or less to the neighbour with most faces in common."""
    sizes = np.bincount(patch, minlength=count)
    members = [list(cells) for cells in np.split(
        np.argsort(patch, kind="stable"), np.cumsum(sizes)[:-1])] if count else []  # fmt: skip
    for number in range(count):
        if 2 * len(members[number]) > size or not members[number]:
            continue
        shared: dict[int, int] = {}
        for cell in members[number]:
            for other in behind[cell]:
                if other >= 0 and patch[other] != number:
                    shared[int(patch[other])] = shared.get(int(patch[other]), 0) + 1
        if shared:
            into = min(shared, key=lambda k: (-shared[k], len(members[k]), k))
            patch[members[number]] = into
            members[into] += members[number]
            members[number] = []
    return np.unique(patch, return_inverse=True)[1].reshape(-1)
