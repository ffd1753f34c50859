"""Closed surfaces as the boundary of solids: which are shells, which cavities, where they cross."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from softrobot_twin.errors import MeshError
from softrobot_twin.geometry.connected_pieces import connected_pieces
from softrobot_twin.geometry.surface import half_edges


def enclosed_volume(points: np.ndarray, triangles: np.ndarray) -> float:
    """Volume inside a closed surface, negative where its normals point inwards [m³].

    Args:
        points: Points [m], shape (point_count, 3).
        triangles: Point indices, shape (triangle_count, 3).
    """
    corners = points[triangles] - points[triangles[0, 0]]
    return float(np.linalg.det(corners).sum() / 6.0)


def is_inside(point: np.ndarray, corners: np.ndarray) -> bool:
    """Whether a closed surface is wound around a point: by the sum of its solid angles.

    Args:
        point: The point [m], shape (3,).
        corners: Corners of the triangles [m], shape (triangle_count, 3, 3).
    """
    a, b, c = np.moveaxis(corners - point, 1, 0)
    p, q, r = (np.linalg.norm(arm, axis=1) for arm in (a, b, c))
    volume = np.einsum("ti,ti->t", a, np.cross(b, c))
    product = p * q * r + r * np.sum(a * b, axis=1) + p * np.sum(b * c, axis=1)
    product += q * np.sum(c * a, axis=1)
    return float(np.arctan2(volume, product).sum()) > np.pi


def at(place: np.ndarray) -> str:
    """A place in words.

    Args:
        place: The place [m], shape (3,).
    """
    return "(" + ", ".join(f"{1e3 * value + 0.0:.3f}" for value in place) + ") mm"


def refuse_open(path: Path, points: np.ndarray, triangles: np.ndarray, remedy: str) -> None:
    """Refuses edges that do not belong to two triangles of opposite direction.

    Args:
        path: The file, for the error.
        points: Points [m], shape (point_count, 3).
        triangles: Point indices, shape (triangle_count, 3).
        remedy: What can be done.

    Raises:
        MeshError: There is one.
    """
    halves, edges, place, counts = half_edges(triangles)
    for wrong, what in (
        (counts == 1, "is open: {} of its edges belong to one triangle only"),
        (counts > 2, "meets itself: {} of its edges belong to more than two triangles"),
    ):
        if wrong.any():
            middle = points[edges[np.argmax(wrong)]].mean(axis=0)
            raise MeshError(path, f"its surface {what.format(int(wrong.sum()))}, the first at "
                            f"{at(middle)}; {remedy}")  # fmt: skip
    balance = np.bincount(place, np.where(halves[:, 0] < halves[:, 1], 1, -1))
    if balance.any():
        middle = points[edges[np.argmax(balance != 0)]].mean(axis=0)
        raise MeshError(path, "its triangles cannot be oriented: the surface has one side only, as "
                        f"a Möbius strip, at {at(middle)}")  # fmt: skip


def connected_shells(triangles: np.ndarray) -> np.ndarray:
    """The connected component of each triangle, shape (triangle_count,).

    Args:
        triangles: Point indices, shape (triangle_count, 3).
    """
    count = int(triangles.max()) + 1
    pieces = connected_pieces(np.repeat(triangles[:, 0], 2), triangles[:, 1:].ravel(), count)
    return np.unique(pieces[triangles[:, 0]], return_inverse=True)[1]


def outward_shells(points: np.ndarray, triangles: np.ndarray, shell_of: np.ndarray) -> np.ndarray:
    """The triangles with the normals of each shell out of the space that the shell encloses.

    Args:
        points: Points [m], shape (point_count, 3).
        triangles: Closed and oriented, shape (triangle_count, 3).
        shell_of: Shell of each triangle, shape (triangle_count,).

    Returns:
        A copy in the same order, shape (triangle_count, 3).
    """
    outward = triangles.copy()
    for shell in range(shell_of.max() + 1):
        own = shell_of == shell
        if enclosed_volume(points, outward[own]) < 0.0:
            outward[own] = outward[own][:, ::-1]
    return outward


def nested(points: np.ndarray, triangles: np.ndarray, shell_of: np.ndarray) -> list[list[int]]:
    """Finds which shells are cavities: one inside one other is, inside two a solid again.

    Args:
        points: Points [m], shape (point_count, 3).
        triangles: Point indices, normals outwards of what each shell encloses, shape (n, 3).
        shell_of: Shell of each triangle, shape (n,).

    Returns:
        Outer shell of each solid, followed by those of its cavities.
    """
    shells = [points[triangles[shell_of == shell]] for shell in range(shell_of.max() + 1)]
    boxes = [(corners.min(axis=(0, 1)), corners.max(axis=(0, 1))) for corners in shells]
    inside = [[other for other, around in enumerate(shells)
               if other != shell and (boxes[other][0] <= own[0, 0]).all()
               and (own[0, 0] <= boxes[other][1]).all() and is_inside(own[0, 0], around)]
              for shell, own in enumerate(shells)]  # fmt: skip
    solids = {shell: [shell] for shell, around in enumerate(inside) if len(around) % 2 == 0}
    for shell, around in enumerate(inside):
        if shell not in solids:
            innermost = max(around, key=lambda other: len(inside[other]))
            solids[innermost].append(shell)
    return list(solids.values())


# Triangles per leaf of the tree that finds pairs of near triangles.
_LEAF = 4
# Shares of an edge and of a triangle that count as its end: files store six or seven digits.
_TOUCH = 1.0e-6
# Least slope of an edge against a triangle that it runs through; flatter ones lie in it.
_LEAST_SLOPE = 1.0e-5


def first_crossing(points: np.ndarray, triangles: np.ndarray) -> np.ndarray | None:
    """A point where an edge of a surface runs through one of its triangles; None without any.

    Args:
        points: Points [m], shape (point_count, 3).
        triangles: Point indices, shape (triangle_count, 3).

    Returns:
        The point [m], shape (3,). Triangles that lie on each other do not cross.
    """
    for first, second in _near_pairs(points[triangles]):
        for edges, faces in ((first, second), (second, first)):
            for corner in range(3):
                ends = triangles[edges][:, [corner, (corner + 1) % 3]]
                apart = ~(ends[:, :, None] == triangles[faces][:, None, :]).any(axis=(1, 2))
                found = _crossings(points[ends[apart]], points[triangles[faces[apart]]])
                if len(found):
                    return found[0]
    return None


def _crossings(ends: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Points where segments run through the inside of triangles, shape (count, 3)."""
    start, along = ends[:, 0], ends[:, 1] - ends[:, 0]
    one, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normal = np.cross(one, other)
    slope = np.einsum("ni,ni->n", along, normal)
    scale = np.linalg.norm(along, axis=1) * np.linalg.norm(normal, axis=1)
    ahead = np.abs(slope) > _LEAST_SLOPE * scale
    slope = np.where(ahead, slope, 1.0)
    share = np.einsum("ni,ni->n", corners[:, 0] - start, normal) / slope
    place = start + share[:, None] * along
    area = np.einsum("ni,ni->n", normal, normal)
    from_corner = place - corners[:, 0]
    u = np.einsum("ni,ni->n", np.cross(from_corner, other), normal) / area
    v = np.einsum("ni,ni->n", np.cross(one, from_corner), normal) / area
    # An end on a triangle touches it; an edge that meets its edge from the side runs through.
    within = (share > _TOUCH) & (share < 1.0 - _TOUCH)
    within &= (u > -_TOUCH) & (v > -_TOUCH) & (u + v < 1.0 + _TOUCH)
    return place[ahead & within]


def _near_pairs(corners: np.ndarray):
    """Yields pairs of triangles whose bounding boxes meet, as two arrays of their numbers.

    The triangles are sorted along a curve through space; boxes around 4, 8, 16... neighbours on it
    form a tree, whose levels are compared with themselves from the top.
    """
    low, high = corners.min(axis=1), corners.max(axis=1)
    order = _along_a_curve(0.5 * (low + high))
    depth = max(0, int(np.ceil(np.log2(max(1.0, len(order) / _LEAF)))))
    count = _LEAF * 2**depth
    padded = np.full((2, count, 3), np.nan)
    padded[0, : len(order)], padded[1, : len(order)] = low[order], high[order]
    levels = [padded]
    while levels[-1].shape[1] > 1:
        lows, highs = levels[-1].reshape(2, -1, 2, 3)
        bounds = np.fmin(lows[:, 0], lows[:, 1]), np.fmax(highs[:, 0], highs[:, 1])
        levels.append(np.stack(bounds))
    stack = [(len(levels) - 1, np.zeros((1, 2), np.int64))]
    while stack:
        level, pairs = stack.pop()
        (low_a, high_a), (low_b, high_b) = (levels[level][:, pairs[:, side]] for side in (0, 1))
        pairs = pairs[((low_a <= high_b) & (low_b <= high_a)).all(axis=1)]
        if level == 0:
            pairs = order[pairs[pairs[:, 0] < pairs[:, 1]]]
            if len(pairs):
                yield pairs[:, 0], pairs[:, 1]
            continue
        halves = np.array([[0, 0], [0, 1], [1, 0], [1, 1]])
        children = (2 * pairs[:, None, :] + halves).reshape(-1, 2)
        children = children[children[:, 0] <= children[:, 1]]
        # Many pairs at once are compared in portions, so that memory does not grow with the file.
        for first in range(0, len(children), 200_000):
            stack.append((level - 1, children[first : first + 200_000]))


def _along_a_curve(centres: np.ndarray) -> np.ndarray:
    """Order of points along Morton's curve, on which neighbours are near to each other."""
    span = np.ptp(centres, axis=0)
    steps = ((centres - centres.min(axis=0)) / np.where(span > 0.0, span, 1.0) * 1023.0)
    steps = steps.astype(np.int64)
    code = np.zeros(len(centres), np.int64)
    for bit in range(10):
        for axis in range(3):
            code |= ((steps[:, axis] >> bit) & 1) << (3 * bit + axis)
    return np.argsort(code, kind="stable")
