"""Triangles cut at the middles of their edges, so that a surface stays without gaps."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from softrobot_twin.geometry.surface import half_edges

# Rounds of cutting: an edge has up to two to the power of this many parts.
MOST_ROUNDS = 24


def split_triangles(
    points: np.ndarray, triangles: np.ndarray, chosen: Callable[[np.ndarray], np.ndarray],
    rounds: int = MOST_ROUNDS,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Cuts edges in halves, and their triangles with them, round by round.

    Args:
        points: Points [m], shape (point_count, 3).
        triangles: Indices of them, shape (triangle_count, 3).
        chosen: Whether each edge is cut, by its ends [m], shape (edge_count, 2, 3). It is asked
            once for each edge.
        rounds: How often parts are cut again, at most.

    Returns:
        The points, those given first, and triangles of the same orientation. An edge is cut for all
        of its triangles, so what was closed stays closed.
    """
    kept = np.empty((0, 2), np.int64)
    for _ in range(rounds):
        halves = half_edges(triangles)
        edges, count = halves.edges, len(points)
        is_new = ~np.isin(edges[:, 0] * count + edges[:, 1], kept[:, 0] * count + kept[:, 1])
        is_cut = is_new.copy()
        is_cut[is_new] = chosen(points[edges[is_new]])
        if not is_cut.any():
            break
        middles = np.full(len(edges), -1)
        middles[is_cut] = count + np.arange(is_cut.sum())
        points = np.vstack([points, points[edges[is_cut]].mean(axis=1)])
        triangles = _cut(points, triangles, middles[halves.place].reshape(-1, 3))
        kept = edges[~is_cut]
    return points, triangles


def _cut(points: np.ndarray, triangles: np.ndarray, middles: np.ndarray) -> np.ndarray:
    """The parts of triangles; `middles` has the point on each edge, -1 where it is whole."""
    cut_count = (middles >= 0).sum(axis=1)
    parts = [triangles[cut_count == 0]]
    for count in (1, 2, 3):
        own = cut_count == count
        # The whole edge comes last where two are cut, the cut one first where one is.
        first = np.argmax(middles[own] >= 0, axis=1)
        if count == 2:
            first = (np.argmax(middles[own] < 0, axis=1) + 1) % 3
        turn = (first[:, None] + np.arange(3)) % 3
        a, b, c = np.take_along_axis(triangles[own], turn, axis=1).T
        ab, bc, ca = np.take_along_axis(middles[own], turn, axis=1).T
        if count == 1:
            parts += _rows((a, ab, c), (ab, b, c))
        elif count == 3:
            parts += _rows((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))
        else:
            parts += _rows((ab, b, bc))
            across = [np.linalg.norm(points[i] - points[j], axis=1) for i, j in ((a, bc), (ab, c))]
            by_a = across[0] <= across[1]
            for is_own, rows in (
                (by_a, _rows((a, ab, bc), (a, bc, c))), (~by_a, _rows((a, ab, c), (ab, bc, c))),
            ):  # fmt: skip
                parts += [row[is_own] for row in rows]
    return np.concatenate(parts)


def _rows(*corners: tuple[np.ndarray, np.ndarray, np.ndarray]) -> list[np.ndarray]:
    return [np.stack(own, axis=1) for own in corners]
