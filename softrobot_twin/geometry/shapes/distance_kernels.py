"""Signed distance to a shape in its own frame, and which way it grows.

Every shape is brought to one of four canonical forms, told apart by a number:

    HALF_SPACE  z ≤ 0
    CAPSULE     within extents[0] of the z axis' stretch |z| ≤ extents[1]; a sphere has none
    CYLINDER    ρ ≤ extents[0], |z| ≤ extents[1]
    BOX         |x| ≤ extents[0], |y| ≤ extents[1], |z| ≤ extents[2]

All are convex, so their signed distance is a convex function of space, inside as well: what
holds at a point's tangent holds as a lower bound everywhere.
"""

from __future__ import annotations

import numpy as np
from numba import njit

HALF_SPACE, CAPSULE, CYLINDER, BOX = range(4)


@njit(cache=True, nogil=True, error_model="numpy")
def capsule_distance(radius, half_length, x, y, z):
    """Signed distance to a capsule, and its unit gradient."""
    if z > half_length:
        z -= half_length
    elif z < -half_length:
        z += half_length
    else:
        z = 0.0
    length = np.sqrt(x * x + y * y + z * z)
    if length == 0.0:
        # On the axis all ways out are equally long: any will do.
        return -radius, 1.0, 0.0, 0.0
    return length - radius, x / length, y / length, z / length


@njit(cache=True, nogil=True, error_model="numpy")
def cylinder_distance(radius, half_length, x, y, z):
    """Signed distance to a cylinder with flat caps, and its unit gradient."""
    from_axis = np.sqrt(x * x + y * y)
    if from_axis > 0.0:
        x, y = x / from_axis, y / from_axis
    else:
        x, y = 1.0, 0.0
    side, cap = from_axis - radius, abs(z) - half_length
    up = 1.0 if z >= 0.0 else -1.0
    if side > 0.0 and cap > 0.0:
        length = np.sqrt(side * side + cap * cap)
        if length > 0.0:
            side /= length
            return length, side * x, side * y, cap / length * up
    if side >= cap:
        return side, x, y, 0.0
    return cap, 0.0, 0.0, up


@njit(cache=True, nogil=True, error_model="numpy")
def box_distance(half_x, half_y, half_z, x, y, z):
    """Signed distance to a box, and its unit gradient."""
    sign_x = 1.0 if x >= 0.0 else -1.0
    sign_y = 1.0 if y >= 0.0 else -1.0
    sign_z = 1.0 if z >= 0.0 else -1.0
    dx, dy, dz = abs(x) - half_x, abs(y) - half_y, abs(z) - half_z
    if dx > 0.0 or dy > 0.0 or dz > 0.0:
        ox, oy, oz = max(dx, 0.0), max(dy, 0.0), max(dz, 0.0)
        length = np.sqrt(ox * ox + oy * oy + oz * oz)
        if length > 0.0:
            return length, ox / length * sign_x, oy / length * sign_y, oz / length * sign_z
    if dx >= dy and dx >= dz:
        return dx, sign_x, 0.0, 0.0
    if dy >= dz:
        return dy, 0.0, sign_y, 0.0
    return dz, 0.0, 0.0, sign_z


@njit(cache=True, nogil=True, error_model="numpy")
def shape_distance(kind, extents, x, y, z):
    """Signed distance [m] of a point to a canonical shape, and its unit gradient."""
    if kind == HALF_SPACE:
        return z, 0.0, 0.0, 1.0
    if kind == CAPSULE:
        return capsule_distance(extents[0], extents[1], x, y, z)
    if kind == CYLINDER:
        return cylinder_distance(extents[0], extents[1], x, y, z)
    return box_distance(extents[0], extents[1], extents[2], x, y, z)


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
