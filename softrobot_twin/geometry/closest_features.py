"""Points against single triangles, in kernels for inner loops."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, error_model="numpy")
def triangle_normal(x, a, b, c):
    """Unit normal of a triangle of points x, zero where it is flat."""
    ux, uy, uz = x[b, 0] - x[a, 0], x[b, 1] - x[a, 1], x[b, 2] - x[a, 2]
    vx, vy, vz = x[c, 0] - x[a, 0], x[c, 1] - x[a, 1], x[c, 2] - x[a, 2]
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    size = np.sqrt(nx * nx + ny * ny + nz * nz)
    if size == 0.0:
        return 0.0, 0.0, 0.0
    return nx / size, ny / size, nz / size


@njit(cache=True, nogil=True, error_model="numpy")
def plane_weights(x, a, b, c, px, py, pz):
    """Barycentric weights of a point's projection onto the plane of a triangle that is not flat."""
    ux, uy, uz = x[b, 0] - x[a, 0], x[b, 1] - x[a, 1], x[b, 2] - x[a, 2]
    vx, vy, vz = x[c, 0] - x[a, 0], x[c, 1] - x[a, 1], x[c, 2] - x[a, 2]
    wx, wy, wz = px - x[a, 0], py - x[a, 1], pz - x[a, 2]
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    square = nx * nx + ny * ny + nz * nz
    second = (wy * vz - wz * vy) * nx + (wz * vx - wx * vz) * ny + (wx * vy - wy * vx) * nz
    third = (uy * wz - uz * wy) * nx + (uz * wx - ux * wz) * ny + (ux * wy - uy * wx) * nz
    second /= square
    third /= square
    return 1.0 - second - third, second, third


@njit(cache=True, nogil=True, error_model="numpy")
def squared_distance_to_edge(x, a, b, px, py, pz):
    """Squared distance of a point to the stretch between two points of x."""
    ux, uy, uz = x[b, 0] - x[a, 0], x[b, 1] - x[a, 1], x[b, 2] - x[a, 2]
    wx, wy, wz = px - x[a, 0], py - x[a, 1], pz - x[a, 2]
    square = ux * ux + uy * uy + uz * uz
    along = (wx * ux + wy * uy + wz * uz) / square if square > 0.0 else 0.0
    along = min(max(along, 0.0), 1.0)
    wx, wy, wz = wx - along * ux, wy - along * uy, wz - along * uz
    return wx * wx + wy * wy + wz * wz


@njit(cache=True, nogil=True, error_model="numpy")
def squared_distance_to_triangle(x, a, b, c, px, py, pz):
    """Squared distance of a point to a triangle of points x; a flat one is its edges."""
    nx, ny, nz = triangle_normal(x, a, b, c)
    if nx != 0.0 or ny != 0.0 or nz != 0.0:
        first, second, third = plane_weights(x, a, b, c, px, py, pz)
        if first >= 0.0 and second >= 0.0 and third >= 0.0:
            height = (px - x[a, 0]) * nx + (py - x[a, 1]) * ny + (pz - x[a, 2]) * nz
            return height * height
    return min(
        squared_distance_to_edge(x, a, b, px, py, pz),
        squared_distance_to_edge(x, b, c, px, py, pz),
        squared_distance_to_edge(x, c, a, px, py, pz),
    )


@njit(cache=True, nogil=True, error_model="numpy")
def out_of_reach(x, a, b, c, px, py, pz, reach):
    """Whether a triangle's bounding box is farther than a reach from a point along some axis."""
    p = (px, py, pz)
    for i in range(3):
        low = min(x[a, i], x[b, i], x[c, i])
        high = max(x[a, i], x[b, i], x[c, i])
        if low > p[i] + reach or high < p[i] - reach:
            return True
    return False


@njit(cache=True, nogil=True, error_model="numpy")
def is_nearest_triangle(x, triangles, chosen, px, py, pz, distance):
    """Whether no other triangle is nearer to a point than the chosen one is.

    Args:
        x: Points [m], shape (point_count, 3).
        triangles: Point indices, shape (triangle_count, 3).
        chosen: Index of the chosen triangle.
        px: Point [m], likewise py and pz.
        distance: Its distance from the chosen triangle [m].

    Returns:
        True or False; neighbours equally near to rounding do not count as nearer.
    """
    reach = distance * (1.0 - 1.0e-9)
    for t in range(len(triangles)):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        if t == chosen or out_of_reach(x, a, b, c, px, py, pz, reach):
            continue
        if squared_distance_to_triangle(x, a, b, c, px, py, pz) < reach * reach:
            return False
    return True
