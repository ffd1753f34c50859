"""A tree of boxes around items: which are near a point, with bounded work whatever their sizes.

A grid or a tree of centres looks as far as the largest item reaches, so that one large triangle
among thousands of small ones makes each search look everywhere. Here an item that is large widens
the boxes of its own branch only. Leaves are the items in Morton order, the last level of a full
binary tree whose root is node 1 and whose node k has the children 2k and 2k + 1.

Arguments of the kernels here:
    points: Places that are asked for [m], shape (point_count, 3).
    boxes: Lower and upper corner of the box of each node [m], shape (2 leaf_count, 6).
    order: Item of each leaf, shape (item_count,).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softrobot_twin.geometry.closest_features import squared_distance
from softrobot_twin.geometry.vector3 import row
from softrobot_twin.kernels.compilation import INLINED, KERNEL, njit

# Bits of each coordinate in a Morton number, and places on the stack of a search.
_BITS, _DEPTH = 20, 128
# Boxes are enlarged by this share of their diagonal: what lies on a face is inside.
_ENLARGED = 1.0e-6


class BoxTree(NamedTuple):
    """Boxes of items, and of ever larger groups of neighbouring items.

    Attributes:
        boxes: Lower and upper corner of the box of each node [m], shape (2 leaf_count, 6).
        order: Item of each leaf, shape (item_count,).
    """

    boxes: np.ndarray
    order: np.ndarray


def box_tree(corners: np.ndarray) -> BoxTree:
    """Lays out the tree of items such as triangles or cells.

    Args:
        corners: Corners of each item [m], shape (item_count, corner_count, 3).
    """
    lows, highs = corners.min(axis=1), corners.max(axis=1)
    margin = _ENLARGED * np.linalg.norm(highs - lows, axis=1, keepdims=True)
    order = np.argsort(_morton_numbers(0.5 * (lows + highs)), kind="stable")
    first = 1
    while first < len(order):
        first *= 2
    boxes = np.empty((2 * first, 6))
    boxes[:, :3], boxes[:, 3:] = np.inf, -np.inf
    boxes[first : first + len(order), :3] = (lows - margin)[order]
    boxes[first : first + len(order), 3:] = (highs + margin)[order]
    while first > 1:
        pairs = boxes[first : 2 * first].reshape(-1, 2, 6)
        first //= 2
        boxes[first : 2 * first, :3] = pairs[:, :, :3].min(axis=1)
        boxes[first : 2 * first, 3:] = pairs[:, :, 3:].max(axis=1)
    return BoxTree(boxes, order)


def _morton_numbers(centres: np.ndarray) -> np.ndarray:
    """The bits of the three coordinates in turn, so that neighbours have similar numbers."""
    low, extent = centres.min(axis=0), float(np.ptp(centres, axis=0).max())
    steps = (2**_BITS - 1) * (centres - low) / (extent if extent > 0.0 else 1.0)
    places, numbers = steps.astype(np.int64), np.zeros(len(centres), np.int64)
    for bit in range(_BITS):
        for axis in range(3):
            numbers |= ((places[:, axis] >> bit) & 1) << (3 * bit + axis)
    return numbers


def nearest_distances(tree: BoxTree, corners: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Distance of each point from the nearest of some triangles [m], shape (point_count,).

    Args:
        tree: The tree of the triangles.
        corners: Corners of each [m], shape (triangle_count, 3, 3).
        points: The points [m], shape (point_count, 3).
    """
    least = np.empty(len(points))
    _write_nearest(np.ascontiguousarray(points), tree.boxes, tree.order, corners.reshape(-1, 3), least)
    return np.sqrt(least)


def near_items(tree: BoxTree, points: np.ndarray, reaches: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of a point and an item whose box is within the point's reach.

    Args:
        tree: The tree of the items.
        points: The points [m], shape (point_count, 3).
        reaches: Distance of each, zero for items whose boxes hold it [m], shape (point_count,).

    Returns:
        Points, ascending, and items of the pairs, each of shape (pair_count,).
    """
    points, ends = np.ascontiguousarray(points), np.zeros(len(points), np.int64)
    taken = points, reaches, tree.boxes, tree.order
    _find_near(*taken, ends, np.empty(0, np.int64))
    counts = ends.copy()
    np.cumsum(counts, out=ends)
    items = np.empty(ends[-1] if len(ends) else 0, np.int64)
    if len(items):
        _find_near(*taken, ends, items)
    return np.repeat(np.arange(len(points)), counts), items


@njit(**INLINED)
def _squared_distance_from_box(p, boxes, node):
    square = 0.0
    for axis in range(3):
        away = max(boxes[node, axis] - p[axis], p[axis] - boxes[node, 3 + axis], 0.0)
        square += away * away
    return square


@njit(**KERNEL)
def _write_nearest(points, boxes, order, corners, least):
    """Squared distance of the nearest triangle of each point [m²], nearer branches first."""
    stack = np.empty(_DEPTH, np.int64)
    leaf_count = len(boxes) // 2
    for i in range(len(points)):
        p = row(points, i)
        best = np.inf
        stack[0], count = 1, 1
        while count:
            count -= 1
            node = stack[count]
            if _squared_distance_from_box(p, boxes, node) >= best:
                continue
            if node >= leaf_count:
                t = 3 * order[node - leaf_count]
                own = squared_distance(p, row(corners, t), row(corners, t + 1), row(corners, t + 2))
                best = min(best, own)
                continue
            near, far = 2 * node, 2 * node + 1
            if _squared_distance_from_box(p, boxes, far) < _squared_distance_from_box(p, boxes, near):
                near, far = far, near
            stack[count], stack[count + 1] = far, near
            count += 2
        least[i] = best


@njit(**KERNEL)
def _find_near(points, reaches, boxes, order, ends, items):
    """Count the items near each point or, where `items` has room, write them before its end."""
    stack = np.empty(_DEPTH, np.int64)
    leaf_count = len(boxes) // 2
    for i in range(len(points)):
        p = row(points, i)
        place = ends[i]
        stack[0], count = 1, 1
        while count:
            count -= 1
            node = stack[count]
            if _squared_distance_from_box(p, boxes, node) > reaches[i] * reaches[i]:
                continue
            if node < leaf_count:
                stack[count], stack[count + 1] = 2 * node, 2 * node + 1
                count += 2
            elif len(items):
                place -= 1
                items[place] = order[node - leaf_count]
            else:
                ends[i] += 1
