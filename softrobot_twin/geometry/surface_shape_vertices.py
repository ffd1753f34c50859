"""Vertices of a surface against a convex shape, and the broad phase before them."""

from __future__ import annotations

import numpy as np
from numba import njit

from softrobot_twin.geometry.shapes.distance_kernels import shape_distance
from softrobot_twin.geometry.surface_shape_found import KEY_STRIDE, put


@njit(cache=True, nogil=True, error_model="numpy")
def place_frame(frame_origin, frame_axes, origin, rotation, placed):
    """Write the shape's frame in the world: the origin in row 0, the axes in rows 1 to 3."""
    for i in range(3):
        placed[0, i] = origin[i]
        for j in range(3):
            placed[0, i] += rotation[i, j] * frame_origin[j]
            placed[1 + j, i] = 0.0
            for k in range(3):
                placed[1 + j, i] += rotation[i, k] * frame_axes[k, j]


@njit(cache=True, nogil=True, error_model="numpy")
def in_frame(placed, px, py, pz):
    """A point of the world in the shape's frame."""
    px, py, pz = px - placed[0, 0], py - placed[0, 1], pz - placed[0, 2]
    return (
        placed[1, 0] * px + placed[1, 1] * py + placed[1, 2] * pz,
        placed[2, 0] * px + placed[2, 1] * py + placed[2, 2] * pz,
        placed[3, 0] * px + placed[3, 1] * py + placed[3, 2] * pz,
    )


@njit(cache=True, nogil=True, error_model="numpy")
def is_far(kind, extents, points, vertices, placed, margin):
    """Whether a ball about all vertices is beyond the margin."""
    p = points[vertices[0]]
    low_x, low_y, low_z = p[0], p[1], p[2]
    high_x, high_y, high_z = p[0], p[1], p[2]
    for v in range(1, len(vertices)):
        n = vertices[v]
        px, py, pz = points[n, 0], points[n, 1], points[n, 2]
        low_x, low_y, low_z = min(low_x, px), min(low_y, py), min(low_z, pz)
        high_x, high_y, high_z = max(high_x, px), max(high_y, py), max(high_z, pz)
    dx, dy, dz = 0.5 * (high_x - low_x), 0.5 * (high_y - low_y), 0.5 * (high_z - low_z)
    x, y, z = in_frame(placed, low_x + dx, low_y + dy, low_z + dz)
    radius = np.sqrt(dx * dx + dy * dy + dz * dz)
    return shape_distance(kind, extents, x, y, z)[0] - radius >= margin


@njit(cache=True, nogil=True, error_model="numpy")
def search_vertices(
    kind, extents, points, vertices, placed, x, distances, gradients, margin, found, count
):
    """All vertices within the margin; writes places, distances and gradients of all of them."""
    for v in range(len(vertices)):
        n = vertices[v]
        px, py, pz = in_frame(placed, points[n, 0], points[n, 1], points[n, 2])
        x[v, 0], x[v, 1], x[v, 2] = px, py, pz
        d, gx, gy, gz = shape_distance(kind, extents, px, py, pz)
        distances[v] = d
        gradients[v, 0], gradients[v, 1], gradients[v, 2] = gx, gy, gz
        if d < margin:
            count = put(
                found, count, KEY_STRIDE * v, (v, v, v), (1.0, 0.0, 0.0), d, (gx, gy, gz)
            )
    return count


@njit(cache=True, nogil=True, error_model="numpy")
def place_found(
    found, points, vertices, placed, first_points, weights, first, second, normals, gaps, keys
):
    """Hand on what was found, in the world and with the surface's own point numbers."""
    for i in range(len(gaps)):
        gaps[i], keys[i] = found.gaps[i], found.keys[i]
        for j in range(3):
            first_points[i, j] = vertices[found.points[i, j]]
            weights[i, j] = found.weights[i, j]
        for k in range(3):
            normals[i, k] = 0.0
            first[i, k] = 0.0
            for j in range(3):
                normals[i, k] += placed[1 + j, k] * found.normals[i, j]
                first[i, k] += weights[i, j] * points[first_points[i, j], k]
            second[i, k] = first[i, k] - gaps[i] * normals[i, k]
