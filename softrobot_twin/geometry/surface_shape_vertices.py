"""Vertices of a surface against a convex shape, and the broad phase before them."""

from __future__ import annotations

import numpy as np
from numba import njit

from softrobot_twin.geometry.shapes.distance_kernels import shape_distance
from softrobot_twin.geometry.surface_shape_found import KEY_STRIDE, SURELY, put


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
def is_cluster_far(kind, extents, x, vertices, margin):
    """Whether a ball about some vertices, given in the shape's frame, is beyond the margin."""
    p = x[vertices[0]]
    low_x, low_y, low_z = p[0], p[1], p[2]
    high_x, high_y, high_z = p[0], p[1], p[2]
    for k in range(1, len(vertices)):
        v = vertices[k]
        low_x, low_y, low_z = min(low_x, x[v, 0]), min(low_y, x[v, 1]), min(low_z, x[v, 2])
        high_x, high_y, high_z = max(high_x, x[v, 0]), max(high_y, x[v, 1]), max(high_z, x[v, 2])
    dx, dy, dz = 0.5 * (high_x - low_x), 0.5 * (high_y - low_y), 0.5 * (high_z - low_z)
    radius = np.sqrt(dx * dx + dy * dy + dz * dz)
    distance = shape_distance(kind, extents, low_x + dx, low_y + dy, low_z + dz)[0]
    return distance > margin + SURELY * radius


@njit(cache=True, nogil=True, error_model="numpy")
def search_vertices(
    kind, extents, points, vertices, clusters, placed, x, distances, gradients, margin, found, count
):
    """All vertices within the margin; writes places of all of them, and distances and gradients.

    Where a vertex lies only in clusters that are beyond the margin its distance is infinite: no
    edge or triangle with such a vertex is near.
    """
    for v in range(len(vertices)):
        n = vertices[v]
        x[v, 0], x[v, 1], x[v, 2] = in_frame(placed, points[n, 0], points[n, 1], points[n, 2])
        distances[v] = np.inf
    begin = 0
    for end in clusters.ends:
        own = clusters.vertices[begin:end]
        begin = end
        if is_cluster_far(kind, extents, x, own, margin):
            continue
        for v in own:
            if distances[v] == np.inf:
                d, gx, gy, gz = shape_distance(kind, extents, x[v, 0], x[v, 1], x[v, 2])
                distances[v] = d
                gradients[v, 0], gradients[v, 1], gradients[v, 2] = gx, gy, gz
    for v in range(len(vertices)):
        if distances[v] < margin:
            gradient = (gradients[v, 0], gradients[v, 1], gradients[v, 2])
            count = put(
                found, count, KEY_STRIDE * v, (v, v, v), (1.0, 0.0, 0.0), distances[v], gradient
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
