"""Forms of shapes: signed distances to them, their gradients, and points that reach farthest.

A form says what a shape looks like in its own frame; all search kernels take one. It is convex, so
its signed distance is a convex function of space, inside as well: the tangent plane at any point is
a lower bound everywhere.

A new form is a NamedTuple of its sizes that holds two kernels (`KERNEL`), which numba compiles into
the searches:

    distance(form, p)   signed distance of a point p [m], negative inside, and its unit gradient
    farthest(form, n)   the point that reaches farthest along a unit vector n [m]

The shapes of this package share one form, so that the searches are compiled once for all of them: a
tuple of a number and of sizes (`extents`, shape (3,)) [m].

    HALF_SPACE  z ≤ 0
    CAPSULE     within extents[0] of the segment |z| ≤ extents[1] of the z axis; a sphere has
                extents[1] = 0
    CYLINDER    ρ ≤ extents[0], |z| ≤ extents[1]
    BOX         |x| ≤ extents[0], |y| ≤ extents[1], |z| ≤ extents[2]

Arguments of the kernels here:
    form: The form.
    half: Half sides of a box [m], three numbers.
    p: A point, three numbers [m].
    placed: Origin [m] in row 0 and axes in rows 1 to 3, shape (4, 3).
"""

from __future__ import annotations

import numpy as np
from numba import types
from numba.extending import overload

from softrobot_twin.geometry.vector3 import divided, dot, norm, row, set_row, subtract
from softrobot_twin.kernels.compilation import INNER, KERNEL, ONCE, njit

HALF_SPACE, CAPSULE, CYLINDER, BOX = range(4)


@njit(**ONCE)
def _capsule_distance(radius, half_length, p):
    """Signed distance [m] of a point to a capsule, and its unit gradient."""
    x, y, z = p
    if z > half_length:
        z -= half_length
    elif z < -half_length:
        z += half_length
    else:
        z = 0.0
    away = (x, y, z)
    length = norm(away)
    if length == 0.0:
        # On the axis all radial directions are equivalent; this choice is arbitrary.
        return -radius, (1.0, 0.0, 0.0)
    return length - radius, divided(away, length)


@njit(**ONCE)
def _cylinder_distance(radius, half_length, p):
    """Signed distance [m] of a point to a cylinder with flat caps, and its unit gradient."""
    x, y, z = p
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
            return length, (side * x, side * y, cap / length * up)
    if side >= cap:
        return side, (x, y, 0.0)
    return cap, (0.0, 0.0, up)


@njit(**ONCE)
def _box_distance(half, p):
    """Signed distance [m] of a point to a box of given half sides, and its unit gradient."""
    sign_x = 1.0 if p[0] >= 0.0 else -1.0
    sign_y = 1.0 if p[1] >= 0.0 else -1.0
    sign_z = 1.0 if p[2] >= 0.0 else -1.0
    beyond = (abs(p[0]) - half[0], abs(p[1]) - half[1], abs(p[2]) - half[2])
    if beyond[0] > 0.0 or beyond[1] > 0.0 or beyond[2] > 0.0:
        outside = (max(beyond[0], 0.0), max(beyond[1], 0.0), max(beyond[2], 0.0))
        length = norm(outside)
        if length > 0.0:
            g = divided(outside, length)
            return length, (g[0] * sign_x, g[1] * sign_y, g[2] * sign_z)
    if beyond[0] >= beyond[1] and beyond[0] >= beyond[2]:
        return beyond[0], (sign_x, 0.0, 0.0)
    if beyond[1] >= beyond[2]:
        return beyond[1], (0.0, sign_y, 0.0)
    return beyond[2], (0.0, 0.0, sign_z)


@njit(**KERNEL)
def canonical_distance(form, p):
    """Signed distance [m] of a point to a form of this package, and its unit gradient."""
    kind, extents = form
    if kind == HALF_SPACE:
        return p[2], (0.0, 0.0, 1.0)
    if kind == CAPSULE:
        return _capsule_distance(extents[0], extents[1], p)
    if kind == CYLINDER:
        return _cylinder_distance(extents[0], extents[1], p)
    return _box_distance(extents, p)


def shape_distance(form, p):
    """Signed distance [m] of a point to any form, and its unit gradient; inside kernels.

    Args:
        form: The form.
        p: Point in the frame of the shape [m].
    """
    raise NotImplementedError("only inside compiled kernels")


def shape_size(form):
    """Largest extent of any form along an axis [m], inside kernels.

    Args:
        form: The form.
    """
    raise NotImplementedError("only inside compiled kernels")


@overload(shape_distance, jit_options={"forceinline": True})
def _shape_distance(form, p):
    if not isinstance(form, types.BaseNamedTuple):
        return lambda form, p: canonical_distance(form, p)
    distance = form.instance_class.distance
    return lambda form, p: distance(form, p)


@overload(shape_size, jit_options={"forceinline": True})
def _shape_size(form):
    if not isinstance(form, types.BaseNamedTuple):
        return lambda form: max(form[1][0], form[1][1], form[1][2])
    reach = form.instance_class.farthest
    return lambda form: max(
        reach(form, (1.0, 0.0, 0.0))[0], reach(form, (0.0, 1.0, 0.0))[1],
        reach(form, (0.0, 0.0, 1.0))[2],
    )  # fmt: skip


@njit(**KERNEL)
def measure_points(form, points, distances, gradients):
    """Signed distances of points to a form.

    Args:
        form: The form.
        points: In the frame of the shape [m], shape (count, 3).
        distances: Takes the distances [m], shape (count,).
        gradients: Takes their unit gradients, shape (count, 3).
    """
    for i in range(len(points)):
        distances[i], gradient = shape_distance(form, row(points, i))
        set_row(gradients, i, gradient)


@njit(**KERNEL)
def place_frame(frame_origin, frame_axes, origin, rotation, placed):
    """Compute the frame of a shape in the world.

    Args:
        frame_origin: Origin of the shape in the frame of its carrier [m], shape (3,).
        frame_axes: Axes of the shape in that frame, as columns, shape (3, 3).
        origin: Origin of the carrier in the world [m], shape (3,).
        rotation: Axes of the carrier in the world, as columns, shape (3, 3).
        placed: Output: the origin [m] in row 0, the axes in rows 1 to 3, shape (4, 3).
    """
    for i in range(3):
        placed[0, i] = origin[i]
        for j in range(3):
            placed[0, i] += rotation[i, j] * frame_origin[j]
            placed[1 + j, i] = 0.0
            for k in range(3):
                placed[1 + j, i] += rotation[i, k] * frame_axes[k, j]


@njit(**INNER)
def in_frame(placed, p):
    """Coordinates of a world point in a frame written by `place_frame` [m]."""
    away = subtract(p, row(placed, 0))
    return (dot(row(placed, 1), away), dot(row(placed, 2), away), dot(row(placed, 3), away))
