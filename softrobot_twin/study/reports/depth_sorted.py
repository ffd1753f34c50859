"""Small solids as triangles, so that a picture sorts them by depth together with a body.

matplotlib orders whole objects, not what they are made of: a cable drawn as a line lies before the
body or behind it, never through it. Drawn as triangles in the body's own collection it does.
"""

from __future__ import annotations

import numpy as np

_SIDES = 8


def tube(path: np.ndarray, radius: float, segment_length: float) -> np.ndarray:
    """Triangles of a tube along a polyline.

    Args:
        path: Points of the polyline [m], shape (point_count, 3).
        radius: Radius of the tube [m].
        segment_length: Longest piece along the path [m]; short pieces sort well by depth.

    Returns:
        Corners of the triangles [m], shape (triangle_count, 3, 3).
    """
    pieces = [_straight_tube(start, end, radius, segment_length)
              for start, end in zip(path[:-1], path[1:]) if np.linalg.norm(end - start) > 0.0]
    return np.concatenate(pieces) if pieces else np.empty((0, 3, 3))


def _straight_tube(start: np.ndarray, end: np.ndarray, radius: float,
                   segment_length: float) -> np.ndarray:
    direction = (end - start) / np.linalg.norm(end - start)
    across = np.cross(direction, np.eye(3)[np.argmin(np.abs(direction))])
    across /= np.linalg.norm(across)
    angles = np.linspace(0.0, 2.0 * np.pi, _SIDES, endpoint=False)
    ring = radius * (np.outer(np.cos(angles), across)
                     + np.outer(np.sin(angles), np.cross(direction, across)))
    count = max(1, int(np.ceil(np.linalg.norm(end - start) / segment_length)))
    centres = start + np.linspace(0.0, 1.0, count + 1)[:, None] * (end - start)
    rings = centres[:, None, :] + ring[None, :, :]
    return _grid_triangles(rings)


def sphere(centre: np.ndarray, radius: float) -> np.ndarray:
    """Triangles of a sphere, corners [m], shape (triangle_count, 3, 3)."""
    polar = np.linspace(0.0, np.pi, _SIDES + 1)
    turn = np.linspace(0.0, 2.0 * np.pi, 2 * _SIDES, endpoint=False)
    rings = np.stack([np.outer(np.sin(polar), np.cos(turn)),
                      np.outer(np.sin(polar), np.sin(turn)),
                      np.broadcast_to(np.cos(polar)[:, None], (len(polar), len(turn)))], axis=2)
    # The poles' rings have no width, so half of their triangles have no area.
    triangles = _grid_triangles(centre + radius * rings)
    areas = np.linalg.norm(np.cross(triangles[:, 1] - triangles[:, 0],
                                    triangles[:, 2] - triangles[:, 0]), axis=1)
    return triangles[areas > 1e-9 * radius**2]


def cross(centre: np.ndarray, length: float, radius: float) -> np.ndarray:
    """Triangles of three crossed bars along the axes, corners [m], (triangle_count, 3, 3)."""
    half = 0.5 * length * np.eye(3)
    return np.concatenate([tube(np.array([centre - arm, centre + arm]), radius, 0.25 * length)
                           for arm in half])


def cut(triangles: np.ndarray, longest: float) -> np.ndarray:
    """Cuts triangles into four until no edge is longer than asked [m].

    Args:
        triangles: Corners [m], shape (triangle_count, 3, 3).
        longest: Longest edge to leave [m].

    Returns:
        Corners of the pieces [m], shape (piece_count, 3, 3); they face as the triangles did.
    """
    done = []
    while len(triangles):
        edges = np.linalg.norm(triangles - np.roll(triangles, -1, axis=1), axis=2)
        is_long = edges.max(axis=1) > longest
        done.append(triangles[~is_long])
        a, b, c = np.moveaxis(triangles[is_long], 1, 0)
        ab, bc, ca = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
        triangles = np.concatenate([
            np.stack(piece, axis=1)
            for piece in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))])
    return np.concatenate(done) if done else np.empty((0, 3, 3))


def creases(points: np.ndarray, triangles: np.ndarray, angle: float) -> np.ndarray:
    """Edges at which a surface turns sharply.

    Args:
        points: Of a closed surface [m], shape (point_count, 3).
        triangles: Indices of them, shape (triangle_count, 3).
        angle: Least angle between the normals on both sides [rad].

    Returns:
        Ends of the edges [m], shape (crease_count, 2, 3).
    """
    corners = points[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    edges = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    of = np.repeat(np.arange(len(triangles)), 3)
    order = np.lexsort(edges.T)
    edges, of = edges[order], of[order]
    twin = np.flatnonzero((edges[:-1] == edges[1:]).all(axis=1))
    cosines = np.einsum("ei,ei->e", normals[of[twin]], normals[of[twin + 1]])
    return points[edges[twin[cosines < np.cos(angle)]]]


def _grid_triangles(rings: np.ndarray) -> np.ndarray:
    """Two triangles for every cell between neighbouring rings."""
    here, there = rings[:-1], rings[1:]
    here_next, there_next = np.roll(here, -1, axis=1), np.roll(there, -1, axis=1)
    lower = np.stack([here, here_next, there_next], axis=2)
    upper = np.stack([here, there_next, there], axis=2)
    return np.concatenate([lower.reshape(-1, 3, 3), upper.reshape(-1, 3, 3)])
