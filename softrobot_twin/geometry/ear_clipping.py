"""Triangles of a polygon that may have inward corners, by cutting off its ears."""

from __future__ import annotations

import numpy as np

# A polygon of more corners is not split: the time grows as the cube of their number.
_MOST_CORNERS = 1000
# Least height of an ear relative to its longest side.
_FLAT = 1e-9


def clip_ears(points: np.ndarray) -> np.ndarray | None:
    """Splits a polygon into triangles; of all ears the least flat one is cut off first.

    Args:
        points: Its corners in order, nearly in a plane [m], shape (corner_count, 3).

    Returns:
        Corners of the triangles, in the direction of the polygon, shape (corner_count - 2, 3); None
        of a polygon that crosses itself or has too many corners.
    """
    around = points - points.mean(axis=0)
    normal = np.cross(around, np.roll(around, -1, axis=0)).sum(axis=0)
    if len(points) > _MOST_CORNERS or not np.linalg.norm(normal) > 0.0:
        return None
    normal /= np.linalg.norm(normal)
    first = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    first /= np.linalg.norm(first)
    flat = around @ np.stack([first, np.cross(normal, first)], axis=1)
    left, triangles = np.arange(len(points)), []
    while len(left) > 3:
        before, after = np.roll(left, 1), np.roll(left, -1)
        a, b, c = flat[before], flat[left], flat[after]
        longest = np.max([np.sum((one - other) ** 2, axis=1)
                          for one, other in ((a, b), (b, c), (c, a))], axis=0)  # fmt: skip
        quality = _cross(b - a, c - a) / np.where(longest > 0.0, longest, 1.0)
        for place in np.argsort(-quality):
            corners = before[place], left[place], after[place]
            if quality[place] <= _FLAT:
                return None
            if not _holds_any(flat, left, corners):
                break
        else:
            return None
        triangles.append(corners)
        left = np.delete(left, place)
    a, b, c = flat[left]
    return np.array([*triangles, left]) if _cross(b - a, c - a) > 0.0 else None


def _cross(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    return one[..., 0] * other[..., 1] - one[..., 1] * other[..., 0]


def _holds_any(flat: np.ndarray, left: np.ndarray, corners: tuple) -> bool:
    """Whether a triangle holds another corner of the polygon, on its edges too."""
    others = flat[np.setdiff1d(left, corners)]
    ends = flat[list(corners)]
    sides = [_cross(end - start, others - start)
             for start, end in zip(ends, np.roll(ends, -1, axis=0), strict=True)]  # fmt: skip
    return bool((np.min(sides, axis=0) >= 0.0).any())
