"""Contacts between a triangle surface and a convex analytic shape, by local minimal distance.

Every vertex within the margin is a candidate. The inside of an edge or of a triangle is a
candidate where the distance to the shape has its minimum there and not on its border. Features
that are parallel to the shape yield enough points to transmit a moment.

Edges. Along an edge the signed distance is convex, so its slope increases monotonically: the one
zero crossing is the minimum. Where the slope jumps there (inside an edge of a box or the rim of a
cylinder two directions out are equally short) the shortest direction out for the whole edge is
perpendicular to it: the convex combination g of the two gradients that is perpendicular to the
edge. The overlap along g/|g| is the distance divided by |g|. So an edge against an edge keeps its
normal from separation through touch into overlap. An edge that lies along a cylinder or across a
face of a box has an interval of almost zero slope; both ends of this interval are candidates,
unless they are vertices.

Triangles. The signed distance is convex on a triangle. It has a minimum inside the triangle only
opposite a characteristic point of the shape: the centre of a sphere, an end of the axis of a
capsule, or the point of a cylinder rim or the corner of a box that reaches farthest towards the
triangle. Corners and rim points are measured along the outward normal of the triangle, from
separation through touch into overlap; all others by the distance of the shape at their projection.

Normal cones against a box. Where the nearest point of a box lies on one of its edges or corners,
the contact direction is the vector between the two points. Beside a flat part of the surface this
vector would point along the surface and block sliding: there the edge of the box is in contact
with edges and triangles of the surface, and not with that vertex. A candidate of a deforming
surface against a box is therefore kept only if its direction lies within the normal cone of its
own feature. A fold of the surface around the edge of the box has no cone; it keeps its direction
as long as this agrees with the normal.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numba import njit

from softrobot_twin.errors import MeshError
from softrobot_twin.geometry.broad_phase import Clusters, cluster_triangles
from softrobot_twin.geometry.closed_surface import is_outside_cone, steepest_descent, triangle_fans
from softrobot_twin.geometry.closest_features import (
    is_nearest_triangle,
    plane_weights,
    triangle_normal,
)
from softrobot_twin.geometry.proximities import Proximities
from softrobot_twin.geometry.shapes.distance_kernels import (
    BOX,
    CAPSULE,
    CYLINDER,
    HALF_SPACE,
    in_frame,
    place_frame,
    shape_distance,
)
from softrobot_twin.geometry.shapes.shape import Shape
from softrobot_twin.geometry.vector3 import cross, dot, minus, plus, row, times, unit

# Keys of one feature's candidates run from KEY_STRIDE times the feature's number on.
KEY_STRIDE = 32
# What lengths rule out is ruled out with this factor to spare, for round-off.
SURELY = 1.0 + 1.0e-9


class Found(NamedTuple):
    """Room for candidates. Points are the surface's vertices, vectors are in the shape's frame.

    Attributes:
        points: Vertices of the triangle touched, int64, shape (room, 3).
        weights: Their barycentric weights, shape (room, 3).
        normals: Unit, the way out of the shape, shape (room, 3).
        gaps: Signed distances [m], shape (room,).
        keys: Which feature, and which of its candidates, int64, shape (room,).
    """

    points: np.ndarray
    weights: np.ndarray
    normals: np.ndarray
    gaps: np.ndarray
    keys: np.ndarray


def make_room(size: int) -> Found:
    """Room for a number of candidates."""
    return Found(
        np.empty((size, 3), np.int64), np.empty((size, 3)), np.empty((size, 3)),
        np.empty(size), np.empty(size, np.int64),
    )  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy")
def put(found, count, key, points, weights, gap, normal):
    """Write a candidate where there is room for it, and count it in any case."""
    if count < len(found.gaps):
        for i in range(3):
            found.points[count, i] = points[i]
            found.weights[count, i] = weights[i]
            found.normals[count, i] = normal[i]
        found.gaps[count] = gap
        found.keys[count] = key
    return count + 1


@njit(cache=True, nogil=True, error_model="numpy")
def move(found, i, to):
    """Move a candidate up to an earlier row."""
    for k in range(3):
        found.points[to, k] = found.points[i, k]
        found.weights[to, k] = found.weights[i, k]
        found.normals[to, k] = found.normals[i, k]
    found.gaps[to], found.keys[to] = found.gaps[i], found.keys[i]


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


# Sine of the angle up to which an edge counts as parallel to what it lies on.
PARALLEL_EDGE = 0.05
# A flat stretch is straight: its slope changes less than this between its quarters.
STRAIGHT = 0.01
# A stretch shorter than this part of the edge, or of the shape's least width, is one point.
SHORT = 0.25
# Points nearer to an end than this part of the edge are the vertex there.
AT_VERTEX = 1.0e-6
# A slope as good as reached, and a bracket as good as closed (parts of the edge).
LEVEL, CLOSED = 1.0e-9, 1.0e-9
MOST_STEPS = 100
# Gradients that cancel to less than this come from opposite sides: no way out is across.
OPPOSITE = 0.5
MINIMUM, LOW_END, HIGH_END = 0, 1, 2


@njit(cache=True, nogil=True, error_model="numpy")
def at_fraction(kind, extents, x, a, b, t):
    """Distance and gradient at a fraction of an edge from a to b, and the slope along it."""
    ex, ey, ez = x[b, 0] - x[a, 0], x[b, 1] - x[a, 1], x[b, 2] - x[a, 2]
    d, gx, gy, gz = shape_distance(
        kind, extents, x[a, 0] + t * ex, x[a, 1] + t * ey, x[a, 2] + t * ez
    )
    length = np.sqrt(ex * ex + ey * ey + ez * ez)
    return (gx * ex + gy * ey + gz * ez) / length, d, gx, gy, gz


@njit(cache=True, nogil=True, error_model="numpy")
def slope_crossing(kind, extents, x, a, b, level, low, f_low, high, f_high):
    """Bracket where the slope passes a level: Illinois' method, guarded by bisection.

    f_low < 0 < f_high are the slopes less the level at the ends. The bracket returned is a point
    where the slope is continuous, else as narrow as `CLOSED`.
    """
    last = 0
    for step in range(MOST_STEPS):
        if high - low <= CLOSED:
            break
        t = 0.5 * (low + high)
        if step % 3 != 2:
            secant = (low * f_high - high * f_low) / (f_high - f_low)
            if low < secant < high:
                t = secant
        f = at_fraction(kind, extents, x, a, b, t)[0] - level
        if abs(f) <= LEVEL:
            return t, t
        if f < 0.0:
            low, f_low = t, f
            if last < 0:
                f_high *= 0.5
            last = -1
        else:
            high, f_high = t, f
            if last > 0:
                f_low *= 0.5
            last = 1
    return low, high


@njit(cache=True, nogil=True, error_model="numpy")
def way_across(kind, extents, x, a, b, low, high):
    """Fraction, gap and unit normal at the minimum within a bracket; no normal if opposite."""
    s_low, d, gx, gy, gz = at_fraction(kind, extents, x, a, b, low)
    if low == high:
        return low, d, gx, gy, gz
    s_high, d, hx, hy, hz = at_fraction(kind, extents, x, a, b, high)
    part = s_high / (s_high - s_low)
    gx, gy, gz = part * gx, part * gy, part * gz
    gx, gy, gz = gx + (1.0 - part) * hx, gy + (1.0 - part) * hy, gz + (1.0 - part) * hz
    t = part * low + (1.0 - part) * high
    d = at_fraction(kind, extents, x, a, b, t)[1]
    size = np.sqrt(gx * gx + gy * gy + gz * gz)
    if size < OPPOSITE:
        return t, d, 0.0, 0.0, 0.0
    return t, d / size if d < 0.0 else d, gx / size, gy / size, gz / size


@njit(cache=True, nogil=True, error_model="numpy")
def against_outward(kind, extents, x, edge, sides, triangles, t):
    """Normal where the shape offers none: against the outward normals of the edge's triangles."""
    nx, ny, nz = 0.0, 0.0, 0.0
    for i in range(2):
        if sides[i] >= 0:
            side = triangles[sides[i]]
            mx, my, mz = triangle_normal(x, side[0], side[1], side[2])
            nx, ny, nz = nx - mx, ny - my, nz - mz
    size = np.sqrt(nx * nx + ny * ny + nz * nz)
    if size > OPPOSITE:
        return nx / size, ny / size, nz / size
    found = at_fraction(kind, extents, x, edge[0], edge[1], t)
    return found[2], found[3], found[4]


@njit(cache=True, nogil=True, error_model="numpy")
def flat_end(kind, extents, x, a, b, short, bottom, end, s_end):
    """Other end of a flat stretch from the minimum towards one end of the edge.

    Returns:
        The fraction there and the gradient on the stretch; the fraction is the minimum's own
        where nothing is flat.
    """
    way = 1.0 if end > bottom else -1.0
    probe = bottom + way * short
    s_probe = 1.0
    if (end - probe) * way > 0.0:
        s_probe = way * at_fraction(kind, extents, x, a, b, probe)[0]
    if s_probe > PARALLEL_EDGE:
        return bottom, 0.0, 0.0, 0.0
    if way * s_end > PARALLEL_EDGE:
        s_probe *= way
        if way > 0.0:
            low, high = slope_crossing(
                kind, extents, x, a, b, PARALLEL_EDGE, probe, s_probe - PARALLEL_EDGE - LEVEL,
                end, s_end - PARALLEL_EDGE,
            )  # fmt: skip
            end = low
        else:
            low, high = slope_crossing(
                kind, extents, x, a, b, -PARALLEL_EDGE, end, s_end + PARALLEL_EDGE,
                probe, s_probe + PARALLEL_EDGE + LEVEL,
            )  # fmt: skip
            end = high
    span = end - bottom
    near = at_fraction(kind, extents, x, a, b, bottom + 0.25 * span)
    far = at_fraction(kind, extents, x, a, b, bottom + 0.75 * span)
    if abs(far[0] - near[0]) > STRAIGHT:
        return bottom, 0.0, 0.0, 0.0
    return end, far[2], far[3], far[4]


@njit(cache=True, nogil=True, error_model="numpy")
def put_on_edge(found, count, key, a, b, t, margin, gap, nx, ny, nz):
    """Keep a point of an edge that is near enough and no vertex."""
    if gap >= margin or t <= AT_VERTEX or t >= 1.0 - AT_VERTEX:
        return count
    return put(found, count, key, (a, b, a), (1.0 - t, t, 0.0), gap, (nx, ny, nz))


@njit(cache=True, nogil=True, error_model="numpy")
def search_edge(
    kind, extents, x, edge, short, s_a, s_b, sides, triangles, margin, first_key, found, count
):
    """Candidates of one edge whose slopes at its ends are not both up or both down."""
    a, b = edge[0], edge[1]
    # Where hardly any slope leads down from an end the edge is level there: that end is the lowest.
    bottom = 0.0 if s_a >= -LEVEL else 1.0
    interior = s_a < -LEVEL and s_b > LEVEL
    gap, nx, ny, nz = 0.0, 0.0, 0.0, 0.0
    if interior:
        low, high = slope_crossing(kind, extents, x, a, b, 0.0, 0.0, s_a, 1.0, s_b)
        bottom, gap, nx, ny, nz = way_across(kind, extents, x, a, b, low, high)
        if nx == 0.0 and ny == 0.0 and nz == 0.0:
            nx, ny, nz = against_outward(kind, extents, x, edge, sides, triangles, bottom)
    high_t, hx, hy, hz = bottom, 0.0, 0.0, 0.0
    low_t, lx, ly, lz = bottom, 0.0, 0.0, 0.0
    if short > 0.0 and bottom < 1.0 - short:
        high_t, hx, hy, hz = flat_end(kind, extents, x, a, b, short, bottom, 1.0, s_b)
    if short > 0.0 and bottom > short:
        low_t, lx, ly, lz = flat_end(kind, extents, x, a, b, short, bottom, 0.0, s_a)
    if high_t > bottom:
        d = at_fraction(kind, extents, x, a, b, high_t)[1]
        count = put_on_edge(found, count, first_key + HIGH_END, a, b, high_t, margin, d,
                            hx, hy, hz)  # fmt: skip
    if low_t < bottom:
        d = at_fraction(kind, extents, x, a, b, low_t)[1]
        count = put_on_edge(found, count, first_key + LOW_END, a, b, low_t, margin, d,
                            lx, ly, lz)  # fmt: skip
    if interior and not low_t < bottom < high_t:
        # The minimum is the other end of a flat stretch, and keeps that end's key.
        slot = LOW_END if high_t > bottom else HIGH_END if low_t < bottom else MINIMUM
        count = put_on_edge(found, count, first_key + slot, a, b, bottom, margin, gap,
                            nx, ny, nz)  # fmt: skip
    return count


@njit(cache=True, nogil=True, error_model="numpy")
def search_edges(
    kind, extents, x, distances, gradients, edges, sides, triangles, margin, first_key, found, count
):
    """Candidates of all edges, whose ends rule out nearly all of them.

    By the distances at its ends an edge is ruled out soonest, as on a way no distance changes by
    more than the way's length; by their tangents most surely.

    Returns:
        Number of candidates, and the length of the longest edge whose ends' distances are known.
    """
    longest = 0.0
    # A ball has no width along which anything could be flat.
    width = 2.0 * min(extents[0], extents[1])
    if kind == BOX:
        width = min(width, 2.0 * extents[2])
    for e in range(len(edges)):
        a, b = edges[e, 0], edges[e, 1]
        if distances[a] + distances[b] == np.inf:
            continue
        s_a, s_b, square = 0.0, 0.0, 0.0
        for i in range(3):
            step = x[b, i] - x[a, i]
            square += step * step
        longest = max(longest, square)
        spare = distances[a] + distances[b] - 2.0 * margin
        if spare > 0.0 and spare * spare > SURELY * square:
            continue
        for i in range(3):
            step = x[b, i] - x[a, i]
            s_a += gradients[a, i] * step
            s_b += gradients[b, i] * step
        lowest = max(distances[a] + min(0.0, s_a), distances[b] - max(0.0, s_b))
        if s_a < 0.0 < s_b:
            # Where the tangents at both vertices meet.
            t = (distances[b] - s_b - distances[a]) / (s_a - s_b)
            lowest = max(lowest, distances[a] + s_a * t)
        if lowest >= margin or square == 0.0:
            continue
        length = np.sqrt(square)
        s_a /= length
        s_b /= length
        falls, rises = s_a <= -PARALLEL_EDGE, s_b >= PARALLEL_EDGE
        if s_a >= PARALLEL_EDGE or s_b <= -PARALLEL_EDGE or not (falls or rises or s_a < 0.0 < s_b):
            continue
        short = SHORT * min(1.0, width / length)
        count = search_edge(
            kind, extents, x, edges[e], short, s_a, s_b, sides[e], triangles, margin,
            first_key + KEY_STRIDE * e, found, count,
        )  # fmt: skip
    return count, np.sqrt(longest)


# Sine of the angle up to which a triangle counts as parallel to an axis, a cap or a face.
PARALLEL_FACE = 0.1
# Weights below this mean a point on an edge, which has its own candidates.
ON_EDGE = 1.0e-6
# Points of a cylinder's rim that stand on a triangle parallel to the cap.
RIM_POINTS = 8
CAP_STRIDE = 16
THROUGH = 31
# Nearer to the axis than this part of the radius there is no way out to tell from others.
ON_AXIS = 1.0e-9
# Distances below this share of a shape's largest extent are round-off.
ROUND_OFF = 1.0e-9


@njit(cache=True, nogil=True, error_model="numpy")
def has_left_shape(kind, extents, foot, height):
    """Whether the foot of a point below a plane lies outside the shape, on its other side.

    Args:
        kind: Kind of the shape.
        extents: Its extents [m].
        foot: Projection of the shape's point onto the plane [m].
        height: Height of the shape's point above the plane [m], negative.
    """
    round_off = ROUND_OFF * max(extents[0], extents[1], extents[2])
    above = shape_distance(kind, extents, foot[0], foot[1], foot[2])[0]
    # Round-off alone would end the contact of a shape that touches the plane exactly.
    return above > round_off - 2.0 * PARALLEL_FACE * height


@njit(cache=True, nogil=True, error_model="numpy")
def lies_inside(weights):
    """Whether a projection falls inside a triangle, off its edges."""
    return weights[0] > ON_EDGE and weights[1] > ON_EDGE and weights[2] > ON_EDGE


@njit(cache=True, nogil=True, error_model="numpy")
def beside(x, a, b, c, i, p, n):
    """Whether a projection's coordinate i misses that of a triangle not nearly square to i."""
    if n * n > 0.5:
        return False
    return p < min(x[a, i], x[b, i], x[c, i]) or p > max(x[a, i], x[b, i], x[c, i])


@njit(cache=True, nogil=True, error_model="numpy")
def misses(x, a, b, c, normal, corner, margin):
    """Whether a corner is too high above a triangle's plane, or surely beside the triangle."""
    px, py, pz = corner
    nx, ny, nz = normal
    height = (px - x[a, 0]) * nx + (py - x[a, 1]) * ny + (pz - x[a, 2]) * nz
    return (
        height >= margin
        or beside(x, a, b, c, 2, pz - height * nz, nz)
        or beside(x, a, b, c, 0, px - height * nx, nx)
        or beside(x, a, b, c, 1, py - height * ny, ny)
    )


@njit(cache=True, nogil=True, error_model="numpy")
def against_corner(kind, extents, x, triangles, t, normal, corner, margin, key, found, count):
    """A corner or rim point of the shape that points towards a triangle.

    Behind the triangle it has run into the body if no other triangle is nearer, and if its
    projection has not left the shape on the other side.
    """
    a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
    px, py, pz = corner
    nx, ny, nz = normal
    height = (px - x[a, 0]) * nx + (py - x[a, 1]) * ny + (pz - x[a, 2]) * nz
    if height >= margin:
        return count
    weights = plane_weights(x, a, b, c, px, py, pz)
    if not lies_inside(weights):
        return count
    if height < 0.0:
        foot = (px - height * nx, py - height * ny, pz - height * nz)
        if has_left_shape(kind, extents, foot, height):
            return count
        if not is_nearest_triangle(x, triangles, t, px, py, pz, -height):
            return count
    return put(found, count, key, (a, b, c), weights, height, (-nx, -ny, -nz))


@njit(cache=True, nogil=True, error_model="numpy")
def against_axis_point(kind, extents, x, triangle, normal, z, margin, key, found, count):
    """The triangle's point opposite a point of the axis, at the shape's distance from it."""
    a, b, c = triangle[0], triangle[1], triangle[2]
    weights = plane_weights(x, a, b, c, 0.0, 0.0, z)
    if not lies_inside(weights):
        return count
    nx, ny, nz = normal
    height = (z - x[a, 2]) * nz - x[a, 0] * nx - x[a, 1] * ny
    px, py, pz = -height * nx, -height * ny, z - height * nz
    d, gx, gy, gz = shape_distance(kind, extents, px, py, pz)
    if d >= margin:
        return count
    if abs(height) <= ON_AXIS * extents[0]:
        gx, gy, gz = -nx, -ny, -nz
    return put(found, count, key, (a, b, c), weights, d, (gx, gy, gz))


@njit(cache=True, nogil=True, error_model="numpy")
def pierced_by_axis(kind, extents, x, triangle, normal, margin, key, found, count):
    """Where the axis runs through a triangle deeper than the radius: out to the side."""
    a, b, c = triangle[0], triangle[1], triangle[2]
    nx, ny, nz = normal
    if nz == 0.0:
        return count
    z = x[a, 2] + (x[a, 0] * nx + x[a, 1] * ny) / nz
    radius, half = extents[0], extents[1]
    if not abs(z) < (half if kind == CAPSULE else half - radius):
        return count
    weights = plane_weights(x, a, b, c, 0.0, 0.0, z)
    if -radius >= margin or not lies_inside(weights):
        return count
    # Of all ways out, which are square to the axis, the one most against the outward normal.
    size = np.sqrt(nx * nx + ny * ny)
    across = (-nx / size, -ny / size, 0.0) if size > ON_AXIS else (1.0, 0.0, 0.0)
    return put(found, count, key, (a, b, c), weights, -radius, across)


@njit(cache=True, nogil=True, error_model="numpy")
def search_capsule(extents, x, triangle, normal, margin, key, found, count):
    """The ends of the axis: the nearer one, both where the triangle is parallel to the axis.

    An axis that runs through the triangle's plane is nearest there, not at an end.
    """
    half = extents[1]
    if half == 0.0:
        return against_axis_point(
            CAPSULE, extents, x, triangle, normal, 0.0, margin, key, found, count
        )
    a = triangle[0]
    middle = -(x[a, 0] * normal[0] + x[a, 1] * normal[1] + x[a, 2] * normal[2])
    low, high = middle - half * normal[2], middle + half * normal[2]
    parallel = abs(normal[2]) <= PARALLEL_FACE
    one_side = low * high >= 0.0
    if parallel or one_side and abs(low) <= abs(high):
        count = against_axis_point(
            CAPSULE, extents, x, triangle, normal, -half, margin, key, found, count
        )
    if parallel or one_side and abs(high) < abs(low):
        count = against_axis_point(
            CAPSULE, extents, x, triangle, normal, half, margin, key + 1, found, count
        )
    return pierced_by_axis(
        CAPSULE, extents, x, triangle, normal, margin, key + THROUGH, found, count
    )


@njit(cache=True, nogil=True, error_model="numpy")
def search_cylinder(extents, x, triangles, t, normal, margin, key, found, count):
    """The rims' points nearest the triangle; points all round a cap parallel to it."""
    radius, half = extents[0], extents[1]
    a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
    across = np.sqrt(normal[0] ** 2 + normal[1] ** 2)
    for cap in range(2):
        up = 2.0 * cap - 1.0
        if -up * normal[2] < -PARALLEL_FACE:
            continue
        k = key + CAP_STRIDE * cap
        if across > PARALLEL_FACE:
            rim = (-radius * normal[0] / across, -radius * normal[1] / across, up * half)
            if not misses(x, a, b, c, normal, rim, margin):
                count = against_corner(
                    CYLINDER, extents, x, triangles, t, normal, rim, margin, k, found, count
                )
            continue
        for i in range(RIM_POINTS):
            angle = 2.0 * np.pi * i / RIM_POINTS
            rim = (radius * np.cos(angle), radius * np.sin(angle), up * half)
            if not misses(x, a, b, c, normal, rim, margin):
                count = against_corner(
                    CYLINDER, extents, x, triangles, t, normal, rim, margin, k + 1 + i, found, count
                )
    for i in range(2):
        # The axis is far from most triangles.
        if min(x[a, i], x[b, i], x[c, i]) > 0.0 or max(x[a, i], x[b, i], x[c, i]) < 0.0:
            return count
    return pierced_by_axis(
        CYLINDER, extents, x, triangles[t], normal, margin, key + THROUGH, found, count
    )


@njit(cache=True, nogil=True, error_model="numpy")
def search_box(extents, x, triangles, t, normal, margin, key, found, count):
    """The corner nearest the triangle; more where an edge or a face is parallel to it."""
    a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
    nx, ny, nz = normal
    offset = nx * x[a, 0] + ny * x[a, 1] + nz * x[a, 2]
    for corner in range(8):
        px = extents[0] if corner & 1 else -extents[0]
        py = extents[1] if corner & 2 else -extents[1]
        pz = extents[2] if corner & 4 else -extents[2]
        if max(
            nx if corner & 1 else -nx, ny if corner & 2 else -ny, nz if corner & 4 else -nz
        ) > PARALLEL_FACE:
            continue
        height = px * nx + py * ny + pz * nz - offset
        if (
            height >= margin
            or beside(x, a, b, c, 0, px - height * nx, nx)
            or beside(x, a, b, c, 1, py - height * ny, ny)
            or beside(x, a, b, c, 2, pz - height * nz, nz)
        ):
            continue
        count = against_corner(
            BOX, extents, x, triangles, t, normal, (px, py, pz), margin, key + corner, found, count
        )
    return count


@njit(cache=True, nogil=True, error_model="numpy")
def lower_bound(x, distances, gradients, a, b, c):
    """Lowest distance that a triangle can have, by the tangent at its vertex a."""
    to_b, to_c = 0.0, 0.0
    for j in range(3):
        to_b += gradients[a, j] * (x[b, j] - x[a, j])
        to_c += gradients[a, j] * (x[c, j] - x[a, j])
    return distances[a] + min(0.0, to_b, to_c)


@njit(cache=True, nogil=True, error_model="numpy")
def search_triangles(
    kind, extents, x, distances, gradients, triangles, margin, longest, first_key, found, count
):
    """Candidates inside all triangles, none of whose edges is longer than `longest`."""
    # No point of a triangle is farther from a vertex of it, so its distance is no smaller.
    surely_apart = margin + SURELY * longest
    for t in range(len(triangles)):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        if max(distances[a], distances[b], distances[c]) > surely_apart:
            continue
        if (
            lower_bound(x, distances, gradients, a, b, c) >= margin
            or lower_bound(x, distances, gradients, b, c, a) >= margin
            or lower_bound(x, distances, gradients, c, a, b) >= margin
        ):
            continue
        normal = triangle_normal(x, a, b, c)
        if normal[0] == 0.0 and normal[1] == 0.0 and normal[2] == 0.0:
            continue
        key = first_key + KEY_STRIDE * t
        if kind == BOX:
            count = search_box(extents, x, triangles, t, normal, margin, key, found, count)
        elif kind == CYLINDER:
            count = search_cylinder(extents, x, triangles, t, normal, margin, key, found, count)
        else:
            count = search_capsule(
                extents, x, triangles[t], normal, margin, key, found, count
            )
    return count


# Sine by which a direction may lie outside the cone.
CONE = 0.02
# Sine of the angle at which the surface around a vertex or an edge counts as a fold.
FOLD = 0.1
# Cosine between the surface's normal and a direction it looks in.
LOOKS_THERE = 0.5
# The same for a way out of the box that does not lead along the surface.
LOOKS_AGAINST = 0.2


@njit(cache=True, nogil=True, error_model="numpy")
def area_normal(x, fans, v):
    """Unit area-weighted normal at a vertex."""
    total, p = (0.0, 0.0, 0.0), row(x, v)
    for k in range(fans[v, 0]):
        a, b = minus(row(x, fans[v, 2 + 3 * k]), p), minus(row(x, fans[v, 3 + 3 * k]), p)
        total = plus(total, cross(a, b), 1.0)
    return unit(total)


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def faces_beyond(extents, x, v):
    """How many pairs of a box's faces a vertex lies outside of."""
    count = 0
    for i in range(3):
        count += abs(x[v, i]) > extents[i]
    return count


@njit(cache=True, nogil=True, error_model="numpy")
def faces(x, fans, v, normal, way_out):
    """Whether a vertex looks against a way out: it lies in the vertex's cone, or nearly so."""
    return (
        dot(way_out, normal) <= -LOOKS_AGAINST
        or steepest_descent(x, fans, v, way_out) <= CONE
    )


@njit(cache=True, nogil=True, error_model="numpy")
def turn_inside(extents, x, fans, v, normal, margin, i, found):
    """Give a vertex inside a box the nearest way out that is against the surface's own normal.

    Near an edge of the box the nearest way of all may lead along the surface.
    """
    if faces(x, fans, v, normal, row(found.normals, i)):
        return
    best, axis = margin, -1
    for k in range(3):
        depth = extents[k] - abs(x[v, k])
        out = 1.0 if x[v, k] >= 0.0 else -1.0
        way_out = (out if k == 0 else 0.0, out if k == 1 else 0.0, out if k == 2 else 0.0)
        if depth < best and faces(x, fans, v, normal, way_out):
            best, axis = depth, k
    if axis < 0:
        return
    for k in range(3):
        found.normals[i, k] = 0.0
    found.normals[i, axis] = 1.0 if x[v, axis] >= 0.0 else -1.0
    found.gaps[i] = -best


@njit(cache=True, nogil=True, error_model="numpy")
def vertex_fits(extents, x, fans, v, margin, i, found):
    """Whether the direction at a vertex fits; inside the box it is made to fit."""
    beyond = faces_beyond(extents, x, v)
    if beyond == 1:
        return True
    normal = area_normal(x, fans, v)
    if beyond == 0:
        turn_inside(extents, x, fans, v, normal, margin, i, found)
        return True
    way_out = row(found.normals, i)
    if steepest_descent(x, fans, v, way_out) <= CONE:
        return True
    # A fold rises around the vertex.
    rise = steepest_descent(x, fans, v, times(normal, -1.0))
    return rise > FOLD and dot(way_out, normal) <= -LOOKS_THERE


@njit(cache=True, nogil=True, error_model="numpy")
def edge_fits(x, edges, triangles, e, i, found):
    """Whether the direction at an edge fits."""
    n = row(found.normals, i)
    if max(abs(n[0]), abs(n[1]), abs(n[2])) >= 1.0 - 1.0e-12 or edges[e, 3] < 0:
        return True
    out = times(n, -1.0)
    if not is_outside_cone(x, edges, e, out, CONE):
        return True
    normal, start = (0.0, 0.0, 0.0), row(x, edges[e, 0])
    fold = False
    for side in range(2):
        t = edges[e, 2 + side]
        a = row(x, triangles[t, 0])
        own = unit(cross(minus(row(x, triangles[t, 1]), a), minus(row(x, triangles[t, 2]), a)))
        normal = plus(normal, own, 1.0)
        other = minus(row(x, edges[e, 5 - side]), start)
        height = dot(other, own)
        fold = fold or (height > 0.0 and height * height > FOLD * FOLD * dot(other, other))
    return fold and dot(out, unit(normal)) >= LOOKS_THERE


@njit(cache=True, nogil=True, error_model="numpy")
def keep_fitting(extents, x, fans, edges, triangles, margin, count, found):
    """Keep of the vertices and edges found against a box those whose direction fits.

    Args:
        extents: Half the box's sides [m].
        x: Points of the surface in the box's frame [m].
        fans: See `ClosedSurface`.
        edges: See `ClosedSurface`; -1 where there is no second triangle.
        triangles: The surface.
        margin: Overlap up to which another way out is looked for [m].
        count: Rows found.
        found: The rows; those that are kept move up.

    Returns:
        Number of rows kept.
    """
    kept = 0
    for i in range(count):
        feature = found.keys[i] // KEY_STRIDE
        if feature < len(x):
            fits = vertex_fits(extents, x, fans, feature, margin, i, found)
        else:
            fits = edge_fits(x, edges, triangles, feature - len(x), i, found)
        if not fits:
            continue
        move(found, i, kept)
        kept += 1
    return kept


def edges_with_apexes(
    edges: np.ndarray, sides: np.ndarray, triangles: np.ndarray
) -> np.ndarray:
    """Columns of `ClosedSurface.edges` for a surface that need not be closed.

    Args:
        edges: Point indices, shape (edge_count, 2).
        sides: Triangles on both sides, -1 for none, shape (edge_count, 2).
        triangles: Point indices, shape (triangle_count, 3).

    Returns:
        Shape (edge_count, 6).
    """
    corners = triangles[sides]
    off = (corners != edges[:, None, :1]) & (corners != edges[:, None, 1:])
    apexes = np.take_along_axis(corners, off.argmax(axis=2)[..., None], axis=2)[..., 0]
    apexes[sides < 0] = -1
    return np.ascontiguousarray(np.hstack([edges, sides, apexes]))


@njit(cache=True, nogil=True, error_model="numpy")
def search_surface(
    kind, extents, frame_origin, frame_axes, origin, rotation, points, vertices, clusters, edges,
    sides, triangles, fans, apexes, margin, placed, x, distances, gradients, found,
):  # fmt: skip
    """Count, and as far as there is room write, all candidates of a surface."""
    place_frame(frame_origin, frame_axes, origin, rotation, placed)
    if is_far(kind, extents, points, vertices, placed, margin):
        return 0
    count = search_vertices(
        kind, extents, points, vertices, clusters, placed, x, distances, gradients, margin, found, 0
    )
    if kind == HALF_SPACE:
        # Its distance is linear: lowest at vertices, and where it is level they are enough.
        return count
    first_key = KEY_STRIDE * len(vertices)
    count, longest = search_edges(
        kind, extents, x, distances, gradients, edges, sides, triangles, margin, first_key,
        found, count,
    )  # fmt: skip
    if len(fans) > 0 and kind == BOX and count <= len(found.gaps):
        count = keep_fitting(extents, x, fans, apexes, triangles, margin, count, found)
    first_key += KEY_STRIDE * len(edges)
    return search_triangles(
        kind, extents, x, distances, gradients, triangles, margin, longest, first_key, found, count
    )


def room_for_shape(count: int) -> Proximities:
    """Room for a number of pairs whose second is a shape: it has no points of its own."""
    return Proximities(
        np.empty((count, 3), np.int64), np.empty((count, 3)), *_no_points(count),
        np.empty((count, 3)), np.empty((count, 3)), np.empty((count, 3)),
        np.empty(count), np.empty(count, np.int64),
    )  # fmt: skip


@lru_cache(maxsize=256)
def _no_points(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Points and weights of a side that has none; shared, so not to be written."""
    return np.full((count, 3), -1, np.int64), np.zeros((count, 3))


NOTHING = room_for_shape(0)


class SurfaceShapeDetector:
    """Detects where a triangle surface, of a deforming or a rigid body, is near a shape.

    A detector keeps room for its work: use one by one thread at a time.
    """

    def __init__(
        self, triangles: np.ndarray, point_count: int, shape: Shape, deforms: bool = False
    ):
        """Find the surface's vertices and edges.

        Args:
            triangles: Point indices, counter-clockwise from outside, shape (triangle_count, 3).
            point_count: Number of points that will be given.
            shape: The shape, in the frame of its carrier.
            deforms: Whether it is the surface of a deforming body.

        Raises:
            MeshError: There are no triangles, or one names a point that will not be given.
        """
        triangles = np.array(triangles, np.int64)
        if triangles.ndim != 2 or triangles.shape[1] != 3 or len(triangles) == 0:
            raise MeshError(None, f"triangles have shape {triangles.shape}, not (n, 3) with n > 0")
        if triangles.min() < 0 or triangles.max() >= point_count:
            raise MeshError(
                None,
                f"triangles name points {triangles.min()} to {triangles.max()}, "
                f"but there are {point_count} points",
            )
        self.shape = shape
        self.point_count = point_count
        self._vertices, own = np.unique(triangles, return_inverse=True)
        self._triangles = own.reshape(-1, 3).astype(np.int64)
        self._edges, self._sides = edges_and_sides(self._triangles)
        self._fans, self._apexes = np.empty((0, 1), np.int64), np.empty((0, 6), np.int64)
        if deforms and shape.kind == BOX:
            self._fans = triangle_fans(self._triangles, len(self._vertices))
            self._apexes = edges_with_apexes(self._edges, self._sides, self._triangles)
        # Copies that may be written: for read-only arrays the kernels would be compiled anew.
        self._frame = tuple(np.array(array, float, order="C") for array in shape.frame())
        self._origin, self._rotation = np.empty(3), np.empty((3, 3))
        self._extents = np.array(shape.extents(), float)
        count = len(self._vertices)
        self._placed = np.empty((4, 3))
        self._work = (np.empty((count, 3)), np.empty(count), np.empty((count, 3)))
        self._found = make_room(2 * count + 64)
        self._has_placed = False
        # Neighbours are told by where they are at the first look, and stay neighbours.
        self._clusters: Clusters | None = None

    def detect(
        self, points: np.ndarray, origin: np.ndarray, rotation: np.ndarray, margin: float
    ) -> Proximities:
        """Finds the pairs of nearest points whose gap is below a margin.

        The gap of a vertex is its signed distance. So is that of an edge or a triangle outside
        the shape; in overlap it is the shortest way apart of the features that meet.

        Args:
            points: Points of the surface [m], shape (point_count, 3).
            origin: Origin of the shape's carrier in the world [m], shape (3,).
            rotation: Its axes as columns, shape (3, 3).
            margin: Pairs with a gap below it are given [m].

        Returns:
            The pairs: first the vertices, then the edges, then the triangles, each in the order
            of the surface.

        Raises:
            MeshError: The points are not as many as was said.
        """
        points = np.ascontiguousarray(points, float)
        if not points.flags.writeable:
            points = points.copy()
        if points.shape != (self.point_count, 3):
            raise MeshError(
                None, f"points have shape {points.shape}, not ({self.point_count}, 3)"
            )
        if self._clusters is None:
            self._clusters = cluster_triangles(points[self._vertices], self._triangles)
        self._origin[:], self._rotation[:] = origin, rotation
        count = self._search(points, float(margin))
        if count == 0 and self._has_placed:
            return NOTHING
        # The first time there may be nothing to place: it is compiled then, not at a touch.
        self._has_placed = True
        if count > len(self._found.gaps):
            self._found = make_room(2 * count)
            self._search(points, float(margin))
        found = room_for_shape(count)
        place_found(
            self._found, points, self._vertices, self._placed, found.first_points,
            found.first_weights, found.first_positions, found.second_positions,
            found.normals, found.gaps, found.keys,
        )  # fmt: skip
        return found

    def _search(self, points, margin) -> int:
        return search_surface(
            self.shape.kind, self._extents, *self._frame, self._origin, self._rotation, points,
            self._vertices, self._clusters, self._edges, self._sides, self._triangles,
            self._fans, self._apexes, margin, self._placed, *self._work, self._found,
        )  # fmt: skip


def edges_and_sides(triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Each edge of a surface once, and the triangles on its sides.

    Args:
        triangles: Point indices, shape (triangle_count, 3).

    Returns:
        Point indices, lower first, int64, shape (edge_count, 2), and two of the triangles that
        share the edge, -1 where there is but one, int64, shape (edge_count, 2).
    """
    both = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    edges, index = np.unique(np.sort(both, axis=1), axis=0, return_inverse=True)
    sides = np.full((len(edges), 2), -1, np.int64)
    for place, edge in enumerate(index.ravel()):
        free = np.flatnonzero(sides[edge] < 0)
        if len(free):
            sides[edge, free[0]] = place % len(triangles)
    return edges.astype(np.int64), sides
