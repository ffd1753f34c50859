"""Contacts between the faces of two boxes: the corners of the polygon in which they touch.

Two boxes have their largest separation, or their smallest overlap, along one of fifteen axes: the
normals of their faces and the cross products of their edges (Gottschalk, Lin and Manocha 1996). If
it is the normal of a face, the opposing face of the other box is clipped to the sides of that face
(Sutherland and Hodgman 1974). The corners of the clipped polygon, with their heights above the
face, transmit every force and moment between two flat faces. All have the normal of the face.

The normal is computed from the boxes as a whole. If it were computed for each corner, its
direction would change where faces are flush: the shortest displacement that separates a corner
overhanging by a nanometre is sideways.

Where two edges cross or corners meet, no face is in contact, and a general search is necessary.
"""

from __future__ import annotations

import numpy as np

from softrobot_twin.geometry.proximities import Proximities, empty_proximities
from softrobot_twin.geometry.shapes.distance_kernels import place_frame
from softrobot_twin.geometry.shapes.shape import Shape
from softrobot_twin.geometry.vector3 import add_scaled, cross, dot, row, scaled, set_row, subtract
from softrobot_twin.kernels.compilation import INNER, KERNEL, ONCE, njit

# Result of `face_contacts` if no face is near.
NO_FACE = -1
# Capacity for corners: two quadrilaterals have at most 8 in common, and round-off may add some.
MOST_CORNERS = 16
# Shares of the smallest half side: the separation along two edges must exceed that along a face by
# EDGE_BIAS (if it is nearly equal, its axis nearly equals the normal of the face), that along a
# face of the first box must exceed that of the second by FACE_BIAS, and faces that overhang or
# overlap by less than SLIVER are flush.
EDGE_BIAS, FACE_BIAS, SLIVER = 1.0e-2, 1.0e-3, 1.0e-4
# Cosine above which two normals are equal, cosine below which two axes are perpendicular, and sine
# below which two edges are parallel.
SAME_NORMAL, ACROSS, PARALLEL = 0.9, 0.1, 1.0e-3
_LABELS = 16


@njit(**INNER)
def _reach(axes, half, n):
    """Half the width of a box along a direction [m]."""
    reach = 0.0
    for i in range(3):
        reach += half[i] * abs(dot(row(axes, i), n))
    return reach


@njit(**INNER)
def _best_face(axes, half, other_axes, other_half, offset):
    """Largest separation along the axes of a box [m], and its face: 2 i, or 2 i + 1 below."""
    best, face = -np.inf, 0
    for i in range(3):
        n = row(axes, i)
        along = dot(offset, n)
        apart = abs(along) - half[i] - _reach(other_axes, other_half, n)
        if apart > best:
            best, face = apart, 2 * i + (1 if along < 0.0 else 0)
    return best, face


@njit(**INNER)
def _normal(axes, face):
    """Outward normal of a face."""
    return scaled(row(axes, face // 2), 1.0 - 2.0 * (face % 2))


@njit(**ONCE)
def _best_edges(first_axes, first_half, second_axes, second_half, offset):
    """Largest separation along the cross products of the edges of both boxes [m]."""
    best = -np.inf
    for i in range(3):
        for j in range(3):
            n = cross(row(first_axes, i), row(second_axes, j))
            length = np.sqrt(dot(n, n))
            if length > PARALLEL:
                apart = abs(dot(offset, n)) - _reach(first_axes, first_half, n)
                best = max(best, (apart - _reach(second_axes, second_half, n)) / length)
    return best


@njit(**INNER)
def _across(axes, half, other_axes, other_half, offset, normal):
    """Largest separation along those axes of a box that are perpendicular to a normal [m]."""
    best = -np.inf
    for i in range(3):
        if abs(dot(row(axes, i), normal)) <= ACROSS:
            apart = abs(dot(offset, row(axes, i))) - half[i]
            best = max(best, apart - _reach(other_axes, other_half, row(axes, i)))
    return best


@njit(**ONCE)
def _facing(axes, normal):
    """Face whose outward normal is most opposed to a normal."""
    best, face = -np.inf, 0
    for i in range(3):
        along = dot(row(axes, i), normal)
        if abs(along) > best:
            best, face = abs(along), 2 * i + (1 if along > 0.0 else 0)
    return face


@njit(**INNER)
def _corners(centre, axes, half, face, polygon, labels):
    """Write the corners of a face in cyclic order, with the labels of their two sides."""
    i = face // 2
    j, k = (i + 1) % 3, (i + 2) % 3
    middle = add_scaled(centre, _normal(axes, face), half[i])
    signs = ((1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0))
    for c in range(4):
        a, b = signs[c]
        p = add_scaled(add_scaled(middle, row(axes, j), a * half[j]), row(axes, k), b * half[k])
        set_row(polygon, c, p)
        labels[c, 0], labels[c, 1] = (c + 3) % 4, c
    return 4


@njit(**ONCE)
def _clip(polygon, labels, count, n, limit, label, clipped, clipped_labels):
    """Clip a polygon at a plane; returns the number of corners left.

    Each corner is written with the labels of the sides before and after it.
    """
    left = 0
    for c in range(count):
        if left + 2 > len(clipped):
            break
        following = (c + 1) % count
        p, q = row(polygon, c), row(polygon, following)
        p_over, q_over = dot(p, n) - limit, dot(q, n) - limit
        if p_over <= 0.0:
            set_row(clipped, left, p)
            clipped_labels[left, 0], clipped_labels[left, 1] = labels[c, 0], labels[c, 1]
            left += 1
        if (p_over <= 0.0) != (q_over <= 0.0):
            share = p_over / (p_over - q_over)
            set_row(clipped, left, add_scaled(p, subtract(q, p), share))
            # The side from p to q crosses the plane.
            into = q_over <= 0.0
            clipped_labels[left, 0] = label if into else labels[c, 1]
            clipped_labels[left, 1] = labels[c, 1] if into else label
            left += 1
    return left


@njit(**KERNEL)
def face_contacts(first, first_half, second, second_half, margin, corners, labels, found):
    """Find where a face of one box is near the other box.

    Args:
        first: The first box: its centre [m], then its axes, shape (4, 3).
        first_half: Half its sides [m], shape (3,).
        second: As for the first.
        second_half: As for the first.
        margin: Gap below which corners are returned [m].
        corners: Work array for two polygons [m], shape (2, MOST_CORNERS, 3).
        labels: Work array for the sides before and after each corner, shape (2, MOST_CORNERS, 2).
        found: Output: `Proximities` for MOST_CORNERS pairs. A key tells of the two faces and of the
            sides that meet.

    Returns:
        Number of contacts; NO_FACE if the boxes are near each other but no face is.
    """
    first_axes, second_axes = first[1:], second[1:]
    offset = subtract(row(first, 0), row(second, 0))
    by_second, second_face = _best_face(second_axes, second_half, first_axes, first_half, offset)
    by_first, first_face = _best_face(first_axes, first_half, second_axes, second_half, scaled(offset, -1.0))
    by_edges = _best_edges(first_axes, first_half, second_axes, second_half, offset)
    if max(by_first, by_second, by_edges) >= margin:
        return 0
    size = min(first_half.min(), second_half.min())
    sliver = SLIVER * size
    normal, other = _normal(second_axes, second_face), _normal(first_axes, first_face)
    swap = by_first > by_second
    if swap and -dot(normal, other) > SAME_NORMAL:
        swap = by_first > by_second + FACE_BIAS * size
    apart = by_first if swap else by_second
    if swap:
        normal = other
    if by_edges > apart + EDGE_BIAS * size:
        return NO_FACE
    across = max(
        _across(first_axes, first_half, second_axes, second_half, offset, normal),
        _across(second_axes, second_half, first_axes, first_half, offset, normal),
    )
    if across > sliver:
        return NO_FACE
    if across >= -sliver:
        # Two parallel edges side by side at the same height pass each other without contact.
        return 0
    at, axes, half, face = row(second, 0), second_axes, second_half, second_face
    facing_at, facing_axes, facing_half = row(first, 0), first_axes, first_half
    if swap:
        at, axes, half, face = row(first, 0), first_axes, first_half, first_face
        facing_at, facing_axes, facing_half = row(second, 0), second_axes, second_half
    facing = _facing(facing_axes, normal)
    polygon, clipped = corners[0], corners[1]
    labels, clipped_labels = labels[0], labels[1]
    count = _corners(facing_at, facing_axes, facing_half, facing, polygon, labels)
    for side in range(6):
        if side // 2 == face // 2:
            continue
        n = _normal(axes, side)
        limit = dot(at, n) + half[side // 2] + sliver
        count = _clip(polygon, labels, count, n, limit, 4 + side, clipped, clipped_labels)
        polygon, clipped = clipped, polygon
        labels, clipped_labels = clipped_labels, labels
    if count == 0:
        return NO_FACE
    top = dot(at, normal) + half[face // 2]
    pair = (2 * face + (1 if swap else 0)) * 6 + facing
    kept = 0
    for c in range(count):
        p = row(polygon, c)
        gap = dot(p, normal) - top
        if gap >= margin:
            continue
        q, sign = add_scaled(p, normal, -gap), (-1.0 if swap else 1.0)
        set_row(found.first_positions, kept, q if swap else p)
        set_row(found.second_positions, kept, p if swap else q)
        set_row(found.normals, kept, scaled(normal, sign))
        found.gaps[kept] = gap
        # Negative: the keys of a general search are positive.
        found.keys[kept] = -1 - ((pair * _LABELS + labels[c, 0]) * _LABELS + labels[c, 1])
        kept += 1
    return kept


class BoxPairDetector:
    """Detects contacts between the faces of two boxes."""

    def __init__(self, first: Shape, second: Shape):
        """Takes the boxes, each in the frame of its carrier."""
        self._boxes = [
            (np.array(box.frame()[0], float), np.array(box.frame()[1], float, order="C"),
             np.array(box.extents(), float), np.empty((4, 3)))
            for box in (first, second)
        ]  # fmt: skip
        self._pose = np.empty(3), np.empty((3, 3))
        self._corners = np.empty((2, MOST_CORNERS, 3))
        self._labels = np.empty((2, MOST_CORNERS, 2), np.int64)
        self._found = empty_proximities(MOST_CORNERS)
        self._found.first_points[:] = self._found.second_points[:] = -1

    def detect(self, first_pose, second_pose, margin: float) -> Proximities | None:
        """Finds the pairs of nearest points whose gap is below a margin.

        Args:
            first_pose: Origin [m] and axes as columns of the carrier of the first box, shapes (3,)
                and (3, 3).
            second_pose: The same for the second box.
            margin: Gap below which pairs are returned [m].

        Returns:
            The pairs, without points of a surface; None if edges or corners of the boxes are near
            each other, but no face is.
        """
        poses = (first_pose, second_pose)
        for (at, axes, _, placed), pose in zip(self._boxes, poses, strict=True):
            self._pose[0][:], self._pose[1][:] = pose
            place_frame(at, axes, *self._pose, placed)
        (_, _, first_half, first), (_, _, second_half, second) = self._boxes
        count = face_contacts(
            first, first_half, second, second_half, float(margin), self._corners, self._labels,
            self._found,
        )  # fmt: skip
        if count == NO_FACE:
            return None
        return Proximities(*(part[:count].copy() for part in self._found))
