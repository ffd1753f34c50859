"""Broad phase of contact detection: a uniform grid of boxes, and clusters of triangles.

The grid answers which triangles or edges may be near a point. It is filled anew in each step.
Clusters of neighbouring triangles let a search against a single shape rule out many vertices at
once.

The grid with the kernels of `triangle_pairs` was compared with coal 3.0 and python-fcl 0.7.
Medians in microseconds on a shared machine, for a notched finger against a cube of 12 triangles
(1 mm apart, margin 2 mm) and against itself at rest (margin 2 mm, neighbours within 4 mm):

                                     252 triangles      4032 triangles
    this grid, all pairs found              45                 350
    coal, refit + collide             166 + 74         7300 + 620
    fcl, rebuild + collide            331 + 18        15600 + 26
    this grid, with itself                 200                6400
    coal, with itself                     9900      over 190 000
    fcl, with itself                      9500      over 420 000
    this grid, boxes apart                   5                   6

The refit of coal was timed with one call for all points. For self-contact both libraries report
every pair of neighbouring triangles as a collision. They return pairs of triangles, in which the
features with a local minimum of distance must still be found, and fcl has no contact margin.

Arguments of the kernels here:
    a, b, box, region: A box, lower and upper corner, six numbers [m].
    corners: Points of each item in its first columns, shape (item_count, ≥ width).
    counts: Cells along each axis, shape (3,).
    frame: Lower corner [m], upper corner [m] and cells per length [1/m], shape (3, 3).
    keep: Items to use, shape (item_count,), or (0,) for all.
    p: A point, three numbers [m].
    value: A coordinate of a point [m].
    vertices: Some rows of x, shape (count,).
    x: Points [m], shape (point_count, 3).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softrobot_twin.geometry.vector3 import lower, row, upper
from softrobot_twin.kernels.compilation import INLINED, INNER, ONCE, njit

# Largest number of cells along one axis: clearing more costs more time than they save.
_MOST_CELLS = 24


class CellGrid(NamedTuple):
    """Work arrays of one grid.

    Attributes:
        frame: Lower corner [m], upper corner [m] and cells per length [1/m], shape (3, 3).
        counts: Cells along each axis, shape (3,).
        starts: Start of the item list of each cell, shape (cell_capacity + 1,).
        items: The item lists of all cells, concatenated, shape (item_capacity,).
        boxes: Lower and upper corner of the box of each item [m], shape (item_count, 6).
        chosen: Items whose box meets the region of the grid, shape (item_count,).
        near: Items near a point that is looked at, shape (item_count,).
    """

    frame: np.ndarray
    counts: np.ndarray
    starts: np.ndarray
    items: np.ndarray
    boxes: np.ndarray
    chosen: np.ndarray
    near: np.ndarray


def empty_grid(item_count: int) -> CellGrid:
    """Allocates a grid for a number of items.

    Args:
        item_count: How many items, such as triangles, are sorted into cells.
    """
    return CellGrid(
        frame=np.zeros((3, 3)),
        counts=np.ones(3, dtype=np.int64),
        starts=np.zeros(_MOST_CELLS**3 + 1, dtype=np.int64),
        items=np.zeros(8 * item_count + 64, dtype=np.int64),
        boxes=np.zeros((item_count, 6)),
        chosen=np.zeros(item_count, dtype=np.int64),
        near=np.zeros(item_count, dtype=np.int64),
    )


@njit(**INNER)
def bounding_box(x, vertices):
    """Lower and upper corner of the box around some points of x, as six numbers [m]."""
    low, high = (np.inf, np.inf, np.inf), (-np.inf, -np.inf, -np.inf)
    for v in vertices:
        p = row(x, v)
        low, high = lower(low, p), upper(high, p)
    return (low[0], low[1], low[2], high[0], high[1], high[2])


@njit(**INLINED)
def shared_box(a, b, margin):
    """Intersection of box b with box a enlarged by a margin; empty where low > high."""
    return (
        max(a[0] - margin, b[0]), max(a[1] - margin, b[1]), max(a[2] - margin, b[2]),
        min(a[3] + margin, b[3]), min(a[4] + margin, b[4]), min(a[5] + margin, b[5]),
    )  # fmt: skip


@njit(**INLINED)
def is_empty(box):
    """Whether a box contains no point."""
    return box[0] > box[3] or box[1] > box[4] or box[2] > box[5]


@njit(**INLINED)
def holds(box, p):
    """Whether a box contains point p."""
    if p[0] < box[0] or p[0] > box[3]:
        return False
    if p[1] < box[1] or p[1] > box[4]:
        return False
    return p[2] >= box[2] and p[2] <= box[5]


@njit(**INLINED)
def cell_of(frame, counts, axis, value):
    """Index of the cell along one axis that contains a coordinate, clamped to the grid."""
    c = int((value - frame[0, axis]) * frame[2, axis])
    return min(max(c, 0), counts[axis] - 1)


@njit(**INLINED)
def cell_at(frame, counts, p):
    """Number of the cell that contains point p."""
    return (
        cell_of(frame, counts, 0, p[0]) * counts[1] + cell_of(frame, counts, 1, p[1])
    ) * counts[2] + cell_of(frame, counts, 2, p[2])


@njit(**ONCE)
def fill_boxes(x, corners, width, reach, region, keep, grid):
    """Compute the boxes of all items, and choose those that meet the region.

    Args:
        x: Points [m].
        corners: Points of each item in its first columns.
        width: Number of these columns.
        reach: Distance by which the boxes are enlarged [m].
        region: Box that contains all query points.
        keep: Mask of the items to use, or of length 0 to use all.
        grid: Output: `boxes` and `chosen`.

    Returns:
        Number of chosen items.
    """
    boxes, chosen = grid.boxes, grid.chosen
    count = 0
    for i in range(len(corners)):
        if len(keep) > 0 and not keep[i]:
            continue
        inside = True
        for axis in range(3):
            low = x[corners[i, 0], axis]
            high = low
            for c in range(1, width):
                low = min(low, x[corners[i, c], axis])
                high = max(high, x[corners[i, c], axis])
            low -= reach
            high += reach
            boxes[i, axis] = low
            boxes[i, axis + 3] = high
            if low > region[axis + 3] or high < region[axis]:
                inside = False
        if inside:
            chosen[count] = i
            count += 1
    return count


@njit(**ONCE)
def _divide_into_cells(grid, chosen_count, region):
    """Divide the region into cells of about the mean size of the boxes; returns their number."""
    cells = 1
    for axis in range(3):
        mean = 0.0
        for k in range(chosen_count):
            i = grid.chosen[k]
            mean += grid.boxes[i, axis + 3] - grid.boxes[i, axis]
        mean /= max(chosen_count, 1)
        extent = region[axis + 3] - region[axis]
        count = 1
        if mean > 0.0 and extent > mean:
            count = min(int(extent / mean), _MOST_CELLS)
        grid.counts[axis] = count
        grid.frame[0, axis] = region[axis]
        grid.frame[1, axis] = region[axis + 3]
        grid.frame[2, axis] = count / extent if extent > 0.0 else 0.0
        cells *= count
    return cells


@njit(**INNER)
def _sort_into_cells(grid, chosen_count, fill):
    """Count the items of each cell or, with `fill`, write them from the end of its list down."""
    frame, counts, starts, items = grid.frame, grid.counts, grid.starts, grid.items
    boxes, chosen = grid.boxes, grid.chosen
    for k in range(chosen_count):
        i = chosen[chosen_count - 1 - k]
        x0, x1 = cell_of(frame, counts, 0, boxes[i, 0]), cell_of(frame, counts, 0, boxes[i, 3])
        y0, y1 = cell_of(frame, counts, 1, boxes[i, 1]), cell_of(frame, counts, 1, boxes[i, 4])
        z0, z1 = cell_of(frame, counts, 2, boxes[i, 2]), cell_of(frame, counts, 2, boxes[i, 5])
        for a in range(x0, x1 + 1):
            for b in range(y0, y1 + 1):
                for c in range(z0, z1 + 1):
                    cell = (a * counts[1] + b) * counts[2] + c
                    if fill:
                        starts[cell] -= 1
                        items[starts[cell]] = i
                    else:
                        starts[cell] += 1


@njit(**INNER)
def fill_grid(x, corners, width, reach, region, keep, grid):
    """Fill a grid with the items that may lie within `reach` of a point of the region.

    Args:
        x: Points [m].
        corners: Points of each item in its first columns, shape (item_count, ≥ width).
        width: Number of these columns.
        reach: Distance [m].
        region: Box that contains all query points.
        keep: See `fill_boxes`.
        grid: Output. The item lists are ascending, so that results do not depend on the cells.

    Returns:
        Total length of the item lists; if it exceeds the capacity of the grid, the lists are not
        written.
    """
    chosen_count = fill_boxes(x, corners, width, reach, region, keep, grid)
    cells = _divide_into_cells(grid, chosen_count, region)
    starts = grid.starts
    for c in range(cells + 1):
        starts[c] = 0
    _sort_into_cells(grid, chosen_count, False)
    total = 0
    for c in range(cells):
        total += starts[c]
        starts[c] = total
    starts[cells] = total
    if total <= len(grid.items):
        _sort_into_cells(grid, chosen_count, True)
    return total


def have_room(grids: list[CellGrid], needed: tuple[int, ...]) -> bool:
    """Whether the item lists of grids are long enough; those that are not become longer.

    Args:
        grids: The grids of a search; one whose list was too short is replaced.
        needed: Entries that the list of each grid needs, as the search counted them.
    """
    short = [place for place, grid in enumerate(grids) if needed[place] > len(grid.items)]
    for place in short:
        items = np.zeros(2 * needed[place], dtype=np.int64)
        grids[place] = grids[place]._replace(items=items)
    return not short

# Largest number of triangles in a cluster.
CLUSTER_SIZE = 40


class Clusters(NamedTuple):
    """Vertices of clusters of neighbouring triangles; clusters share those on their borders.

    Attributes:
        vertices: Vertices of all clusters, concatenated, int64, shape (sum of vertex counts,).
        ends: End of the vertices of each cluster, int64, shape (cluster_count,).
    """

    vertices: np.ndarray
    ends: np.ndarray


def cluster_triangles(points: np.ndarray, triangles: np.ndarray) -> Clusters:
    """Bisects a surface across its longest direction until the clusters are small enough.

    Args:
        points: Points [m], shape (point_count, 3).
        triangles: Point indices, shape (triangle_count, 3).

    Returns:
        The clusters; all vertices of a triangle are in one cluster.
    """
    centres = points[triangles].mean(axis=1)
    parts, found = [np.arange(len(triangles))], []
    while parts:
        part = parts.pop()
        if len(part) <= CLUSTER_SIZE:
            found.append(np.unique(triangles[part]))
            continue
        axis = np.argmax(np.ptp(centres[part], axis=0))
        order = part[np.argsort(centres[part, axis], kind="stable")]
        parts += np.array_split(order, 2)
    ends = np.cumsum([len(vertices) for vertices in found])
    return Clusters(np.concatenate(found).astype(np.int64), ends.astype(np.int64))
