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
unless they are vertices. So is the minimum within it, unless the interval is straight to round-off:
else a contact would come and go where an edge is bent or turned to the point at which its slope
stops counting as almost zero, and the body would not come to rest there.

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

Arguments of the kernels here:
    a, b, c: Vertices of a triangle, rows of x.
    across: Sine of the angle between an axis and a normal.
    count: Number of candidates found so far.
    distances: Signed distance of each vertex from the shape [m], shape (vertex_count,).
    edge: One row of `edges`, shape (2 or more,).
    edges, sides: Points, and triangles on both sides, shape (edge_count, 2). Where cones are tested
        there are no sides, and edges have shape (edge_count, 6).
    extents: Of a form of this package [m], shape (3,).
    first_key, key: Key of the first, or of one candidate.
    found: Buffer of candidates, `Candidates`.
    gap, height: Distance from the shape, or from the plane of a triangle [m].
    i: One of `rim_numbers`.
    form: Form of the shape, see `distance_kernels.py`.
    margin: Gap below which there is a candidate [m].
    rows, span, reach: See `proximities.py`.
    source, target: Rows of `found`.
    weights: Three numbers.
    gradients: Gradient of each of the distances, shape (vertex_count, 3).
    normal, p: A unit vector and a point [m], three numbers.
    one, other, triangle: Points of a triangle, shape (3,).
    placed: Origin [m] and axes of the shape in the world, shape (4, 3).
    points: Three points of a candidate; in `_place_candidates` all [m], shape (point_count, 3).
    triangles: Points of all triangles, shape (triangle_count, 3).
    vertices: Points that a triangle uses, ascending, shape (vertex_count,).
    x: Vertices in the frame of the shape [m], shape (vertex_count, 3).
Those of a surface are as in `closed_surface`, those of pairs are as in `proximities`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import types
from numba.extending import overload

from softrobot_twin.geometry.broad_phase import Clusters, bounding_box, cluster_triangles
from softrobot_twin.geometry.closed_surface import is_outside_cone, steepest_descent, triangle_fans
from softrobot_twin.geometry.closest_features import (
    height_above,
    out_of_reach,
    plane_weights,
    squared_distance,
    triangle_normal,
)
from softrobot_twin.geometry.proximities import Proximities
from softrobot_twin.geometry.shapes.distance_kernels import (
    BOX,
    CYLINDER,
    in_frame,
    place_frame,
    shape_distance,
    shape_size,
)
from softrobot_twin.geometry.shapes.shape import Shape
from softrobot_twin.geometry.surface import half_edges
from softrobot_twin.geometry.vector3 import (
    add,
    add_scaled,
    cross,
    divided,
    dot,
    is_zero,
    negated,
    norm,
    row,
    scaled,
    set_row,
    subtract,
    unit,
)
from softrobot_twin.kernels.compilation import GENERIC, INLINED, INNER, KERNEL, ONCE, njit

# The keys of the candidates of one feature start at KEY_STRIDE times the number of the feature.
KEY_STRIDE = 32
# Lengths by which features are ruled out are multiplied by this factor because of round-off.
ROUND_OFF_MARGIN = 1.0 + 1.0e-9

# Edges. Sine of the angle up to which an edge counts as parallel to what it lies on.
PARALLEL_EDGE = 0.05
# An interval of almost zero slope is straight: its slope changes by less than this between its
# quarter points.
STRAIGHT = 0.01
# An interval shorter than this share of the edge, or of the smallest width of the shape, is one
# point.
SHORT = 0.25
# A point nearer to an end than this share of the edge is the vertex there.
AT_VERTEX = 1.0e-6
# Tolerances of the search for a slope: on the slope, and on the bracket (share of the edge).
LEVEL, CLOSED = 1.0e-9, 1.0e-9
# An interval of almost zero slope whose slope changes by more than this has one lowest point,
# which the search finds within a hundredth of it.
CURVED = 100.0 * LEVEL
MOST_STEPS = 100
# If two gradients cancel to less than this, they point to opposite sides of the edge, and no
# direction across the edge leads out of the shape.
OPPOSITE = 0.5
# Numbers of the candidates of an edge.
MINIMUM, LOW_END, HIGH_END = 0, 1, 2

# Triangles. Sine of the angle up to which a triangle counts as parallel to an axis, cap or face.
PARALLEL_FACE = 0.1
# A projection with a weight below this lies on an edge, which has candidates of its own.
ON_EDGE = 1.0e-6
# Number of points on the rim of a cylinder whose cap is parallel to a triangle.
RIM_POINTS = 8
# Numbers of the candidates of a triangle: first of the second cap, and the axis crossing.
CAP_STRIDE, AXIS_CROSSING = 16, 31
# Distance from the axis, as a share of the radius, below which the radial direction is undefined.
ON_AXIS = 1.0e-9
# Distances below this share of the largest extent of a shape are round-off.
ROUND_OFF = 1.0e-9

# Normal cones. Sine by which a direction may lie outside the cone.
CONE = 0.02
# Sine of the angle at which the surface around a vertex or an edge counts as a fold.
FOLD = 0.1
# Cosine between the normal of the surface and a direction that agrees with it.
SAME_SIDE_COSINE = 0.5
# Cosine between the inward normal and a direction out of the box that crosses the surface.
OPPOSED_COSINE = 0.2


class Candidates(NamedTuple):
    """Buffer of contact candidates, in the frame of the shape.

    Attributes:
        points: Vertices of the feature, as numbers within the surface, int64, shape (capacity, 3).
        weights: Their barycentric weights, shape (capacity, 3).
        normals: Unit direction out of the shape, shape (capacity, 3).
        gaps: Signed distances [m], shape (capacity,).
        keys: Number of the feature times KEY_STRIDE plus number of the candidate, int64,
            shape (capacity,).
        count: Candidates that were found, in the buffer or not, shape (1,).
    """

    points: np.ndarray
    weights: np.ndarray
    normals: np.ndarray
    gaps: np.ndarray
    keys: np.ndarray
    count: np.ndarray


def _empty_candidates(capacity: int) -> Candidates:
    """Allocates a buffer for a number of candidates."""
    return Candidates(
        np.empty((capacity, 3), np.int64), np.empty((capacity, 3)), np.empty((capacity, 3)),
        np.empty(capacity), np.empty(capacity, np.int64), np.zeros(1, np.int64),
    )  # fmt: skip


@njit(**INNER)
def missing_room(found, count):
    """Note how many candidates there are; returns their number if the buffer is too small, else 0."""
    found.count[0] = count
    return count if count > len(found.gaps) else 0


@njit(**INNER)
def add_candidate(found, count, key, points, weights, gap, normal):
    """Append a candidate if the buffer has capacity left; returns the count in any case."""
    if count < len(found.gaps):
        set_row(found.points, count, points)
        set_row(found.weights, count, weights)
        set_row(found.normals, count, normal)
        found.gaps[count] = gap
        found.keys[count] = key
    return count + 1


@njit(**INNER)
def move_candidate(found, source, target):
    """Copy a candidate to an earlier row."""
    set_row(found.points, target, row(found.points, source))
    set_row(found.weights, target, row(found.weights, source))
    set_row(found.normals, target, row(found.normals, source))
    found.gaps[target], found.keys[target] = found.gaps[source], found.keys[source]

# Vertices


@njit(**INNER)
def _bounding_ball(x, vertices):
    """Centre and radius [m] of the ball around the bounding box of some points of x."""
    box = bounding_box(x, vertices)
    low = (box[0], box[1], box[2])
    half = scaled(subtract((box[3], box[4], box[5]), low), 0.5)
    return add(low, half), norm(half)


@njit(**INNER)
def is_far(form, points, vertices, placed, margin):
    """Whether the bounding ball of all vertices is beyond the margin."""
    centre, radius = _bounding_ball(points, vertices)
    return shape_distance(form, in_frame(placed, centre))[0] - radius >= margin


@njit(**ONCE)
def _is_cluster_far(form, x, vertices, margin):
    """Whether the bounding ball of a cluster, in the frame of the shape, is beyond the margin."""
    centre, radius = _bounding_ball(x, vertices)
    return shape_distance(form, centre)[0] > margin + ROUND_OFF_MARGIN * radius


@njit(**INNER)
def search_vertices(form, points, vertices, clusters, placed, x, distances, gradients, margin, found, count):
    """Find all vertices within the margin.

    The distance of a vertex whose clusters are all beyond the margin is set to infinity: no edge
    or triangle with such a vertex is near.

    Args:
        form: Form of the shape.
        points: Points in the world [m].
        vertices: Points that the surface uses.
        clusters: `Clusters` of the surface.
        placed: Frame of the shape in the world, see `place_frame`.
        x: Output: the vertices in the frame of the shape [m], shape (vertex_count, 3).
        distances: Output: their signed distances [m], shape (vertex_count,).
        gradients: Output: gradients of these, shape (vertex_count, 3).
        margin: Gap below which a vertex is a candidate [m].
        found: Buffer of candidates.
        count: Number of candidates found before.

    Returns:
        Number of candidates.
    """
    for v in range(len(vertices)):
        set_row(x, v, in_frame(placed, row(points, vertices[v])))
        distances[v] = np.inf
    begin = 0
    for end in clusters.ends:
        own = clusters.vertices[begin:end]
        begin = end
        if _is_cluster_far(form, x, own, margin):
            continue
        for v in own:
            if distances[v] == np.inf:
                distance, gradient = shape_distance(form, row(x, v))
                distances[v] = distance
                set_row(gradients, v, gradient)
    for v in range(len(vertices)):
        if distances[v] < margin:
            count = add_candidate(
                found, count, KEY_STRIDE * v, (v, v, v), (1.0, 0.0, 0.0), distances[v],
                row(gradients, v),
            )  # fmt: skip
    return count


# Edges


@njit(**INNER)
def _at_fraction(form, x, a, b, t):
    """Slope of the distance along an edge, distance [m] and gradient at fraction t from a to b."""
    start = row(x, a)
    along = subtract(row(x, b), start)
    distance, gradient = shape_distance(form, add_scaled(start, along, t))
    return dot(gradient, along) / norm(along), distance, gradient


@njit(**INNER)
def slope_crossing(form, x, a, b, level, low, f_low, high, f_high):
    """Bracket the fraction at which the slope passes a level (Illinois method with bisection).

    Args:
        form: Form of the shape.
        x: Vertices [m].
        a: First vertex of the edge.
        b: Second vertex of the edge.
        level: Slope to find.
        low: Fraction at which the slope is too low.
        f_low: Slope minus level there, < 0.
        high: Fraction at which the slope is too high.
        f_high: Slope minus level there, > 0.

    Returns:
        The bracket: a single point where the slope is continuous, else an interval no wider than
        `CLOSED`.
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
        f = _at_fraction(form, x, a, b, t)[0] - level
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


@njit(**ONCE)
def _minimum_in_bracket(form, x, a, b, low, high):
    """Fraction, gap [m] and unit normal at the minimum within a bracket.

    The normal is zero where the gradients at both ends of the bracket are opposite.
    """
    s_low, gap, g_low = _at_fraction(form, x, a, b, low)
    if low == high:
        return low, gap, g_low
    s_high, gap, g_high = _at_fraction(form, x, a, b, high)
    part = s_high / (s_high - s_low)
    g = add_scaled(scaled(g_low, part), g_high, 1.0 - part)
    t = part * low + (1.0 - part) * high
    gap = _at_fraction(form, x, a, b, t)[1]
    size = norm(g)
    if size < OPPOSITE:
        return t, gap, (0.0, 0.0, 0.0)
    return t, gap / size if gap < 0.0 else gap, divided(g, size)


@njit(**ONCE)
def _against_outward_normals(form, x, edge, sides, triangles, t):
    """Normal where the shape determines none: opposite to the normals of the edge's triangles."""
    n = (0.0, 0.0, 0.0)
    for i in range(2):
        if sides[i] >= 0:
            side = triangles[sides[i]]
            n = subtract(n, triangle_normal(x, side[0], side[1], side[2]))
    size = norm(n)
    if size > OPPOSITE:
        return divided(n, size)
    return _at_fraction(form, x, edge[0], edge[1], t)[2]


@njit(**INNER)
def flat_end(form, x, a, b, short, bottom, end, s_end):
    """Other end of the interval of almost zero slope from the minimum towards one end.

    Args:
        form: Form of the shape.
        x: Vertices [m].
        a: First vertex of the edge.
        b: Second vertex of the edge.
        short: Fraction of the edge below which an interval is one point.
        bottom: Fraction of the minimum.
        end: Fraction of the end of the edge, 0 or 1.
        s_end: Slope there.

    Returns:
        The fraction of the other end and the gradient on the interval; the fraction of the minimum
        and zero if there is no such interval.
    """
    sign = 1.0 if end > bottom else -1.0
    no_interval = (bottom, (0.0, 0.0, 0.0))
    probe = bottom + sign * short
    s_probe = 1.0
    if (end - probe) * sign > 0.0:
        s_probe = sign * _at_fraction(form, x, a, b, probe)[0]
    if s_probe > PARALLEL_EDGE:
        return no_interval
    if sign * s_end > PARALLEL_EDGE:
        level = sign * PARALLEL_EDGE
        inner, outer = (probe, sign * s_probe - level - sign * LEVEL), (end, s_end - level)
        low, high = (inner, outer) if sign > 0.0 else (outer, inner)
        ends = slope_crossing(form, x, a, b, level, low[0], low[1], high[0], high[1])
        end = ends[0] if sign > 0.0 else ends[1]
    span = end - bottom
    s_near = _at_fraction(form, x, a, b, bottom + 0.25 * span)[0]
    s_far, _, gradient = _at_fraction(form, x, a, b, bottom + 0.75 * span)
    if abs(s_far - s_near) > STRAIGHT:
        return no_interval
    return end, gradient


@njit(**ONCE)
def _is_curved(form, x, a, b, low, high):
    """Whether the distance on an interval of almost zero slope has its minimum at one point."""
    s_low = _at_fraction(form, x, a, b, 0.75 * low + 0.25 * high)[0]
    return _at_fraction(form, x, a, b, 0.25 * low + 0.75 * high)[0] - s_low > CURVED


@njit(**INNER)
def _add_edge_point(found, count, key, a, b, t, margin, gap, normal):
    """Add a point of an edge if it is within the margin and not a vertex."""
    if gap >= margin or t <= AT_VERTEX or t >= 1.0 - AT_VERTEX:
        return count
    return add_candidate(found, count, key, (a, b, a), (1.0 - t, t, 0.0), gap, normal)


@njit(**ONCE)
def _search_edge(form, x, edge, short, s_a, s_b, sides, triangles, margin, first_key, found, count):
    """Find the candidates of one edge, from the slopes s_a and s_b at its ends."""
    a, b = edge[0], edge[1]
    # If the slope at an end hardly descends into the edge, that end is the lowest point.
    bottom = 0.0 if s_a >= -LEVEL else 1.0
    interior = s_a < -LEVEL and s_b > LEVEL
    gap, normal = 0.0, (0.0, 0.0, 0.0)
    if interior:
        low, high = slope_crossing(form, x, a, b, 0.0, 0.0, s_a, 1.0, s_b)
        bottom, gap, normal = _minimum_in_bracket(form, x, a, b, low, high)
        if is_zero(normal):
            normal = _against_outward_normals(form, x, edge, sides, triangles, bottom)
    high_end, high_normal = bottom, (0.0, 0.0, 0.0)
    low_end, low_normal = bottom, (0.0, 0.0, 0.0)
    if short > 0.0 and bottom < 1.0 - short:
        high_end, high_normal = flat_end(form, x, a, b, short, bottom, 1.0, s_b)
    if short > 0.0 and bottom > short:
        low_end, low_normal = flat_end(form, x, a, b, short, bottom, 0.0, s_a)
    if high_end > bottom:
        distance = _at_fraction(form, x, a, b, high_end)[1]
        count = _add_edge_point(
            found, count, first_key + HIGH_END, a, b, high_end, margin, distance, high_normal
        )
    if low_end < bottom:
        distance = _at_fraction(form, x, a, b, low_end)[1]
        count = _add_edge_point(
            found, count, first_key + LOW_END, a, b, low_end, margin, distance, low_normal
        )
    both = low_end < bottom < high_end
    if interior and (not both or _is_curved(form, x, a, b, low_end, high_end)):
        # Without an interval on one side, the minimum is its end there, and gets its key.
        number = MINIMUM
        if not both:
            number = LOW_END if high_end > bottom else HIGH_END if low_end < bottom else MINIMUM
        count = _add_edge_point(found, count, first_key + number, a, b, bottom, margin, gap, normal)
    return count


@njit(**ONCE)
def lowest_on_edge(distance_a, distance_b, s_a, s_b):
    """Lower bound of the distance on an edge [m], from the tangents at its ends.

    Args:
        distance_a: Distance at the first end [m].
        distance_b: Distance at the second end [m].
        s_a: Slope at the first end times the length of the edge [m].
        s_b: Slope at the second end times the length of the edge [m].
    """
    lowest = max(distance_a + min(0.0, s_a), distance_b - max(0.0, s_b))
    if s_a < 0.0 < s_b:
        # Where the tangents at both ends intersect.
        t = (distance_b - s_b - distance_a) / (s_a - s_b)
        lowest = max(lowest, distance_a + s_a * t)
    return lowest


@njit(**INNER)
def search_edges(
    form, width, x, distances, gradients, edges, sides, triangles, margin, first_key, found, count
):
    """Find the candidates of all edges.

    Nearly all edges are ruled out by their ends: first by the distances there, since along a
    segment the distance changes by at most its length, then by the tangents.

    Args:
        width: Smallest width of what is straight on the shape [m], 0 where nothing is.

    Returns:
        Number of candidates, and the length of the longest edge with finite distances [m].
    """
    longest = 0.0
    for e in range(len(edges)):
        a, b = edges[e, 0], edges[e, 1]
        if distances[a] + distances[b] == np.inf:
            continue
        along = subtract(row(x, b), row(x, a))
        square = dot(along, along)
        longest = max(longest, square)
        spare = distances[a] + distances[b] - 2.0 * margin
        if spare > 0.0 and spare * spare > ROUND_OFF_MARGIN * square:
            continue
        s_a, s_b = dot(row(gradients, a), along), dot(row(gradients, b), along)
        if lowest_on_edge(distances[a], distances[b], s_a, s_b) >= margin or square == 0.0:
            continue
        length = np.sqrt(square)
        s_a /= length
        s_b /= length
        falls, rises = s_a <= -PARALLEL_EDGE, s_b >= PARALLEL_EDGE
        if (s_a >= PARALLEL_EDGE or s_b <= -PARALLEL_EDGE or not (falls or rises or s_a < 0.0 < s_b)):
            continue
        short = SHORT * min(1.0, width / length)
        count = _search_edge(
            form, x, edges[e], short, s_a, s_b, sides[e], triangles, margin,
            first_key + KEY_STRIDE * e, found, count,
        )  # fmt: skip
    return count, np.sqrt(longest)


# Triangles


@njit(**KERNEL)
def is_past_shape(form, foot, height):
    """Whether the projection of a point below a plane lies beyond the other side of the shape.

    Args:
        form: Form of the shape.
        foot: Projection of the point of the shape onto the plane [m].
        height: Height of the point of the shape above the plane [m], negative.
    """
    round_off = ROUND_OFF * shape_size(form)
    above = shape_distance(form, foot)[0]
    # Without this tolerance, round-off would end the contact of a shape that touches the plane.
    return above > round_off - 2.0 * PARALLEL_FACE * height


@njit(**INNER)
def meet(one, other):
    """Whether two triangles have a common vertex."""
    for i in range(3):
        if one[i] == other[0] or one[i] == other[1] or one[i] == other[2]:
            return True
    return False


@njit(**KERNEL, inline="always")
def is_nearest_way_out(form, x, triangles, chosen, p, distance):
    """Whether a point p of the shape behind a triangle is behind no nearer one.

    At an edge or a vertex of the surface, a triangle that p is behind too is no way out where the
    shape is not above it: its corner has passed this triangle from the side.

    Args:
        form: Form of the shape.
        x: Vertices [m].
        triangles: Their numbers in each triangle.
        chosen: Number of the triangle.
        p: Corner or rim point of the shape [m].
        distance: Its distance from the triangle [m].

    Returns:
        True or False; a neighbour that is equally near up to round-off does not count as nearer.
    """
    reach = distance * (1.0 - 1.0e-9)
    for t in range(len(triangles)):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        if t == chosen or out_of_reach(x, a, b, c, p, reach):
            continue
        if squared_distance(p, row(x, a), row(x, b), row(x, c)) >= reach * reach:
            continue
        if not meet(triangles[t], triangles[chosen]):
            return False
        normal = triangle_normal(x, a, b, c)
        height = height_above(x, a, normal, p)
        past = is_past_shape(form, add_scaled(p, normal, -height), height)
        if height >= 0.0 or not past:
            return False
    return True


@njit(**INNER)
def _lies_inside(weights):
    """Whether a projection lies inside a triangle, off its edges."""
    return weights[0] > ON_EDGE and weights[1] > ON_EDGE and weights[2] > ON_EDGE


@njit(**INNER)
def is_outside_extent(x, a, b, c, i, foot, n):
    """Whether coordinate i of a projection lies outside the interval of the triangle.

    Args:
        x: Vertices [m].
        a: First vertex of the triangle.
        b: Second vertex.
        c: Third vertex.
        i: Axis.
        foot: Coordinate of the projection onto the plane of the triangle along the axis [m].
        n: Coordinate of the unit normal of the triangle along the axis.

    Returns:
        True or False; always false for triangles nearly perpendicular to the axis.
    """
    if n * n > 0.5:
        return False
    return foot < min(x[a, i], x[b, i], x[c, i]) or foot > max(x[a, i], x[b, i], x[c, i])


@njit(**INNER)
def misses(x, a, b, c, normal, p, height, margin):
    """Whether p is too high above the plane of a triangle, or clearly beside the triangle."""
    return (
        height >= margin
        or is_outside_extent(x, a, b, c, 2, p[2] - height * normal[2], normal[2])
        or is_outside_extent(x, a, b, c, 0, p[0] - height * normal[0], normal[0])
        or is_outside_extent(x, a, b, c, 1, p[1] - height * normal[1], normal[1])
    )


@njit(**INNER)
def _add_shape_corner(form, x, triangles, t, normal, p, margin, key, found, count):
    """Add a corner or rim point p of the shape that points towards triangle t.

    A point behind the triangle has penetrated the body if there is no nearer way out and its
    projection has not left the shape on the other side.
    """
    a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
    height = height_above(x, a, normal, p)
    if height >= margin:
        return count
    weights = plane_weights(x, a, b, c, p)
    if not _lies_inside(weights):
        return count
    if height < 0.0:
        if is_past_shape(form, add_scaled(p, normal, -height), height):
            return count
        if not is_nearest_way_out(form, x, triangles, t, p, -height):
            return count
    return add_candidate(found, count, key, (a, b, c), weights, height, negated(normal))


@njit(**INNER)
def _add_axis_point(form, x, triangle, normal, z, margin, key, found, count):
    """Add the point of a triangle opposite the axis point z of a capsule, with its distance."""
    a, b, c = triangle[0], triangle[1], triangle[2]
    weights = plane_weights(x, a, b, c, (0.0, 0.0, z))
    if not _lies_inside(weights):
        return count
    height = (z - x[a, 2]) * normal[2] - x[a, 0] * normal[0] - x[a, 1] * normal[1]
    foot = add_scaled((0.0, 0.0, z), normal, -height)
    distance, gradient = shape_distance(form, foot)
    if distance >= margin:
        return count
    if abs(height) <= ON_AXIS * form[1][0]:
        gradient = negated(normal)
    return add_candidate(found, count, key, (a, b, c), weights, distance, gradient)


@njit(**INNER)
def _add_axis_crossing(extents, half, x, triangle, normal, margin, key, found, count):
    """Add the point where the axis crosses a triangle, nearer than `half` [m] to its middle."""
    a, b, c = triangle[0], triangle[1], triangle[2]
    if normal[2] == 0.0:
        return count
    z = x[a, 2] + (x[a, 0] * normal[0] + x[a, 1] * normal[1]) / normal[2]
    radius = extents[0]
    if not abs(z) < half:
        return count
    weights = plane_weights(x, a, b, c, (0.0, 0.0, z))
    if -radius >= margin or not _lies_inside(weights):
        return count
    # All radial directions lead out equally fast: take the one most opposed to the normal.
    size = np.sqrt(normal[0] * normal[0] + normal[1] * normal[1])
    across = (1.0, 0.0, 0.0)
    if size > ON_AXIS:
        across = (-normal[0] / size, -normal[1] / size, 0.0)
    return add_candidate(found, count, key, (a, b, c), weights, -radius, across)


@njit(**ONCE)
def _search_capsule(form, x, triangle, normal, margin, key, found, count):
    """Find the candidates of a triangle against a capsule or a sphere.

    These are the nearer end of the axis, or both ends if the triangle is parallel to the axis. If
    the axis crosses the plane of the triangle, the crossing is nearest, not an end.
    """
    extents = form[1]
    half = extents[1]
    if half == 0.0:
        return _add_axis_point(form, x, triangle, normal, 0.0, margin, key, found, count)
    middle = -dot(row(x, triangle[0]), normal)
    low, high = middle - half * normal[2], middle + half * normal[2]
    parallel = abs(normal[2]) <= PARALLEL_FACE
    one_side = low * high >= 0.0
    if parallel or one_side and abs(low) <= abs(high):
        count = _add_axis_point(form, x, triangle, normal, -half, margin, key, found, count)
    if parallel or one_side and abs(high) < abs(low):
        count = _add_axis_point(form, x, triangle, normal, half, margin, key + 1, found, count)
    return _add_axis_crossing(extents, half, x, triangle, normal, margin, key + AXIS_CROSSING, found, count)


@njit(**INLINED)
def rim_numbers(across):
    """Numbers of the points of a rim that may touch a plane: 0 for one point, or those all around.

    Args:
        across: Sine of the angle between the axis and the normal of the plane.
    """
    return range(0, 1) if across > PARALLEL_FACE else range(1, 1 + RIM_POINTS)


@njit(**INLINED)
def rim_point(extents, normal, across, up, i):
    """A point of the rim of a cap, see `rim_numbers` [m]; `up` is 1 for the upper cap, else -1."""
    radius, height = extents[0], up * extents[1]
    if i == 0:
        return (-radius * normal[0] / across, -radius * normal[1] / across, height)
    angle = 2.0 * np.pi * (i - 1) / RIM_POINTS
    return (radius * np.cos(angle), radius * np.sin(angle), height)


@njit(**ONCE)
def _search_cylinder(form, x, triangles, t, normal, margin, key, found, count):
    """Find the candidates of a triangle against a cylinder.

    These are the points of both rims nearest to the triangle, or points all around the rim of a
    cap that is parallel to it.
    """
    a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
    start, extents = row(x, a), form[1]
    across = np.sqrt(normal[0] ** 2 + normal[1] ** 2)
    for cap in range(2):
        up = 2.0 * cap - 1.0
        if -up * normal[2] < -PARALLEL_FACE:
            continue
        for i in rim_numbers(across):
            rim = rim_point(extents, normal, across, up, i)
            # `misses` is called here because a call with more arrays costs more than the test.
            if not misses(x, a, b, c, normal, rim, dot(subtract(rim, start), normal), margin):
                count = _add_shape_corner(
                    form, x, triangles, t, normal, rim, margin,
                    key + CAP_STRIDE * cap + i, found, count,
                )  # fmt: skip
    for i in range(2):
        # Rules out most triangles: their bounding box does not contain the axis.
        if min(x[a, i], x[b, i], x[c, i]) > 0.0 or max(x[a, i], x[b, i], x[c, i]) < 0.0:
            return count
    half = extents[1] - extents[0]
    return _add_axis_crossing(
        extents, half, x, triangles[t], normal, margin, key + AXIS_CROSSING, found, count
    )


@njit(**ONCE)
def _search_box(form, x, triangles, t, normal, margin, key, found, count):
    """Find the corners of a box that face a triangle: several if an edge or face is parallel."""
    a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
    offset, extents = dot(normal, row(x, a)), form[1]
    for corner in range(8):
        sign_x = 1.0 if corner & 1 else -1.0
        sign_y = 1.0 if corner & 2 else -1.0
        sign_z = 1.0 if corner & 4 else -1.0
        if max(sign_x * normal[0], sign_y * normal[1], sign_z * normal[2]) > PARALLEL_FACE:
            continue
        p = (sign_x * extents[0], sign_y * extents[1], sign_z * extents[2])
        if misses(x, a, b, c, normal, p, dot(p, normal) - offset, margin):
            continue
        count = _add_shape_corner(form, x, triangles, t, normal, p, margin, key + corner, found, count)
    return count


def _search_canonical(form, x, triangles, t, normal, margin, key, found, count):
    """Find the candidates of a triangle against a form of this package."""
    if form[0] == BOX:
        return _search_box(form, x, triangles, t, normal, margin, key, found, count)
    if form[0] == CYLINDER:
        return _search_cylinder(form, x, triangles, t, normal, margin, key, found, count)
    return _search_capsule(form, x, triangles[t], normal, margin, key, found, count)


@njit(**GENERIC)
def _search_farthest(reach, form, x, triangles, t, normal, margin, key, found, count):
    """Find the candidate of a triangle against a form from outside: its point opposite to it."""
    a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
    p = reach(form, negated(normal))
    if misses(x, a, b, c, normal, p, height_above(x, a, normal, p), margin):
        return count
    return _add_shape_corner(form, x, triangles, t, normal, p, margin, key, found, count)


def search_triangle(form, x, triangles, t, normal, margin, key, found, count):
    """Find the candidates inside a triangle, inside kernels; returns their number.

    Args:
        form: The form.
        x: Vertices [m].
        triangles: Their numbers in each triangle.
        t: Number of the triangle.
        normal: Its unit normal.
        margin: Gap below which there is a candidate [m].
        key: First key of the triangle.
        found: Buffer of candidates.
        count: Number of candidates found before.
    """
    raise NotImplementedError("only inside compiled kernels")


@overload(search_triangle, jit_options={"forceinline": True})
def _search_triangle(form, x, triangles, t, normal, margin, key, found, count):
    if not isinstance(form, types.BaseNamedTuple):
        return _search_canonical
    reach = form.instance_class.farthest
    return lambda form, x, triangles, t, normal, margin, key, found, count: _search_farthest(
        reach, form, x, triangles, t, normal, margin, key, found, count
    )


@njit(**INNER)
def _lower_bound(x, distances, gradients, a, b, c):
    """Lower bound of the distance of a triangle [m], from the tangent plane at its vertex a."""
    start, gradient = row(x, a), row(gradients, a)
    to_b = dot(gradient, subtract(row(x, b), start))
    to_c = dot(gradient, subtract(row(x, c), start))
    return distances[a] + min(0.0, to_b, to_c)


@njit(**ONCE)
def _search_triangles(form, x, distances, gradients, triangles, margin, longest, first_key, found, count):
    """Find the candidates inside all triangles, none of whose edges is longer than `longest`."""
    # No point of a triangle is farther than `longest` from any of its vertices.
    surely_apart = margin + ROUND_OFF_MARGIN * longest
    for t in range(len(triangles)):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        if max(distances[a], distances[b], distances[c]) > surely_apart:
            continue
        if (
            _lower_bound(x, distances, gradients, a, b, c) >= margin
            or _lower_bound(x, distances, gradients, b, c, a) >= margin
            or _lower_bound(x, distances, gradients, c, a, b) >= margin
        ):
            continue
        normal = triangle_normal(x, a, b, c)
        if is_zero(normal):
            continue
        key = first_key + KEY_STRIDE * t
        count = search_triangle(form, x, triangles, t, normal, margin, key, found, count)
    return count


# Normal cones against a box


@njit(**ONCE)
def _area_normal(x, fans, v):
    """Area-weighted unit normal at a vertex."""
    total, p = (0.0, 0.0, 0.0), row(x, v)
    for k in range(fans[v, 0]):
        a = subtract(row(x, fans[v, 2 + 3 * k]), p)
        b = subtract(row(x, fans[v, 3 + 3 * k]), p)
        total = add_scaled(total, cross(a, b), 1.0)
    return unit(total)


@njit(**ONCE)
def _axes_outside(half, x, v):
    """Number of axes along which a vertex lies outside the box."""
    count = 0
    for i in range(3):
        count += abs(x[v, i]) > half[i]
    return count


@njit(**INNER)
def _crosses_surface(x, fans, v, normal, direction):
    """Whether a direction out of the box is opposed to the normal at v, or in the cone of v."""
    return (dot(direction, normal) <= -OPPOSED_COSINE or steepest_descent(x, fans, v, direction) <= CONE)


@njit(**ONCE)
def _redirect_inside(half, x, fans, v, normal, margin, i, found):
    """Give a vertex inside the box the shortest direction out that crosses the surface.

    Near an edge of the box the overall shortest direction out may point along the surface.
    """
    if _crosses_surface(x, fans, v, normal, row(found.normals, i)):
        return
    best, axis = margin, -1
    for k in range(3):
        depth = half[k] - abs(x[v, k])
        sign = 1.0 if x[v, k] >= 0.0 else -1.0
        direction = (sign if k == 0 else 0.0, sign if k == 1 else 0.0, sign if k == 2 else 0.0)
        if depth < best and _crosses_surface(x, fans, v, normal, direction):
            best, axis = depth, k
    if axis < 0:
        return
    set_row(found.normals, i, (0.0, 0.0, 0.0))
    found.normals[i, axis] = 1.0 if x[v, axis] >= 0.0 else -1.0
    found.gaps[i] = -best


@njit(**ONCE)
def _vertex_fits(half, x, fans, v, margin, i, found):
    """Whether the direction at a vertex fits its cone; inside the box it is corrected instead."""
    outside = _axes_outside(half, x, v)
    if outside == 1:
        return True
    normal = _area_normal(x, fans, v)
    if outside == 0:
        _redirect_inside(half, x, fans, v, normal, margin, i, found)
        return True
    direction = row(found.normals, i)
    if steepest_descent(x, fans, v, direction) <= CONE:
        return True
    # A fold of the surface rises around the vertex.
    rise = steepest_descent(x, fans, v, scaled(normal, -1.0))
    return rise > FOLD and dot(direction, normal) <= -SAME_SIDE_COSINE


@njit(**ONCE)
def _edge_fits(x, edges, triangles, e, i, found):
    """Whether the direction at an edge fits its cone."""
    n = row(found.normals, i)
    if max(abs(n[0]), abs(n[1]), abs(n[2])) >= 1.0 - 1.0e-12 or edges[e, 3] < 0:
        return True
    outward = scaled(n, -1.0)
    if not is_outside_cone(x, edges, e, outward, CONE):
        return True
    normal, start = (0.0, 0.0, 0.0), row(x, edges[e, 0])
    fold = False
    for side in range(2):
        t = edges[e, 2 + side]
        a = row(x, triangles[t, 0])
        own = unit(cross(subtract(row(x, triangles[t, 1]), a), subtract(row(x, triangles[t, 2]), a)))
        normal = add_scaled(normal, own, 1.0)
        other = subtract(row(x, edges[e, 5 - side]), start)
        height = dot(other, own)
        fold = fold or (height > 0.0 and height * height > FOLD * FOLD * dot(other, other))
    return fold and dot(outward, unit(normal)) >= SAME_SIDE_COSINE


@njit(**ONCE)
def keep_within_cones(half, x, fans, edges, triangles, margin, count, found):
    """Keep of the vertices and edges found against a box those whose direction fits their cone.

    Args:
        half: Half the sides of the box [m].
        x: Vertices in the frame of the box [m].
        fans: See `ClosedSurface`.
        edges: See `ClosedSurface`; -1 where there is no second triangle.
        triangles: Triangles of the surface.
        margin: Overlap up to which another direction out is considered [m].
        count: Number of candidates found.
        found: The candidates; those that are kept move to the front.

    Returns:
        Number of candidates kept.
    """
    kept = 0
    for i in range(count):
        feature = found.keys[i] // KEY_STRIDE
        if feature < len(x):
            fits = _vertex_fits(half, x, fans, feature, margin, i, found)
        else:
            fits = _edge_fits(x, edges, triangles, feature - len(x), i, found)
        if not fits:
            continue
        move_candidate(found, i, kept)
        kept += 1
    return kept


# Detector


@njit(**KERNEL)
def _search_surface(
    form, width, half, frame_origin, frame_axes, origin, rotation, points, vertices, clusters,
    edges, sides, triangles, fans, apexes, reach, placed, x, distances, gradients, found,
):  # fmt: skip
    """Find all candidates of a surface; returns what `missing_room` does.

    `clusters` and `found` come as plain tuples: numba finds the type of a named one more slowly.
    """
    clusters, found, margin = Clusters(*clusters), Candidates(*found), reach[0]
    place_frame(frame_origin, frame_axes, origin, rotation, placed)
    if is_far(form, points, vertices, placed, margin):
        return missing_room(found, 0)
    count = search_vertices(
        form, points, vertices, clusters, placed, x, distances, gradients, margin, found, 0
    )
    first_key = KEY_STRIDE * len(vertices)
    count, longest = search_edges(
        form, width, x, distances, gradients, edges, sides, triangles, margin, first_key,
        found, count,
    )  # fmt: skip
    if len(fans) > 0 and count <= len(found.gaps):
        count = keep_within_cones(half, x, fans, apexes, triangles, margin, count, found)
    first_key += KEY_STRIDE * len(edges)
    count = _search_triangles(
        form, x, distances, gradients, triangles, margin, longest, first_key, found, count
    )
    return missing_room(found, count)


@njit(**KERNEL)
def _place_candidates(found, points, vertices, placed, rows, span):
    """Write the candidates as `Proximities`: in the world, with the point numbers of the body."""
    found = Candidates(*found)
    first, normals, gaps = rows.first_positions, rows.normals, rows.gaps
    span[1] = span[0] + found.count[0]
    if span[1] > len(gaps):
        return
    for c in range(found.count[0]):
        i = span[0] + c
        gaps[i], rows.keys[i] = found.gaps[c], found.keys[c]
        for j in range(3):
            rows.first_points[i, j] = vertices[found.points[c, j]]
            rows.first_weights[i, j] = found.weights[c, j]
            rows.second_points[i, j], rows.second_weights[i, j] = -1, 0.0
        for k in range(3):
            normals[i, k] = 0.0
            first[i, k] = 0.0
            for j in range(3):
                normals[i, k] += placed[1 + j, k] * found.normals[c, j]
                first[i, k] += found.weights[c, j] * points[rows.first_points[i, j], k]
            rows.second_positions[i, k] = first[i, k] - gaps[i] * normals[i, k]


class SurfaceShapeDetector:
    """Detects contacts between a triangle surface, deforming or rigid, and a shape.

    A detector owns its work arrays; only one thread at a time may use it.
    """

    def __init__(self, triangles: np.ndarray, shape: Shape, deforms: bool = False):
        """Finds the vertices and edges of the surface.

        Args:
            triangles: Point indices, counter-clockwise from outside, shape (triangle_count, 3).
            shape: The shape, in the frame of its carrier.
            deforms: Whether the surface belongs to a deforming body.
        """
        self.shape = shape
        self._vertices, own = np.unique(triangles, return_inverse=True)
        self._triangles = own.reshape(-1, 3).astype(np.int64)
        self._edges, self._sides = edges_and_sides(self._triangles)
        self._fans, self._apexes = np.empty((0, 1), np.int64), np.empty((0, 6), np.int64)
        self._form, self._half = shape.form(), np.zeros(3)
        if deforms and shape.has_edges:
            self._half = np.array(shape.extents(), float)
            self._fans = triangle_fans(self._triangles, len(self._vertices))
            self._apexes = edges_with_apexes(self._edges, self._sides, self._triangles)
        # Writable copies: for read-only arrays numba would compile the kernels a second time.
        self._frame = tuple(np.array(array, float, order="C") for array in shape.frame())
        self._searched = self._edges, self._sides, self._triangles
        if shape.is_half_space:
            # The distance is linear: its minimum is at vertices, also for parallel features.
            self._searched = tuple(part[:0].copy() for part in self._searched)
        count = len(self._vertices)
        self._placed = np.empty((4, 3))
        self._work = (np.empty((count, 3)), np.empty(count), np.empty((count, 3)))
        self._found = _empty_candidates(2 * count + 64)
        # Computed from the positions in the first call; neighbours stay neighbours.
        self.clusters: Clusters | None = None

    def write(self, points, origin, rotation, reach, rows: Proximities, span: np.ndarray) -> None:
        """Write the pairs that are near: of vertices, then edges, then triangles; may be traced.

        The gap of a vertex is its signed distance, and so is that of an edge or a triangle outside
        the shape. In overlap, the gap of an edge or a triangle is minus the shortest displacement
        that separates the two features.

        Args:
            points: Points of the surface [m], shape (point_count, 3).
            origin: Origin of the shape's carrier in the world [m], shape (3,).
            rotation: Its axes as columns, shape (3, 3).
            reach: See `proximities.py`.
            rows: See there.
            span: See there.
        """
        if self.clusters is None:
            self.clusters = cluster_triangles(points[self._vertices], self._triangles)
        while missing := self._search(points, origin, rotation, reach):
            self._found = _empty_candidates(2 * missing)
        _place_candidates(tuple(self._found), points, self._vertices, self._placed, rows, span)

    def _search(self, points, origin, rotation, reach) -> int:
        return _search_surface(
            self._form, self.shape.width, self._half, *self._frame, origin, rotation, points,
            self._vertices, tuple(self.clusters), *self._searched, self._fans, self._apexes, reach,
            self._placed, *self._work, tuple(self._found),
        )  # fmt: skip


def edges_and_sides(triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Finds each edge of a surface once, and the triangles on both sides of it.

    Args:
        triangles: Point indices, shape (triangle_count, 3).

    Returns:
        Point indices, lower first, int64, shape (edge_count, 2), and two of the triangles that
        share the edge, -1 where there is only one, int64, shape (edge_count, 2).
    """
    _, edges, place, counts = half_edges(triangles)
    halves, first = np.argsort(place, kind="stable"), np.cumsum(counts) - counts
    sides = np.full((len(edges), 2), -1, np.int64)
    sides[:, 0] = halves[first] // 3
    sides[counts > 1, 1] = halves[first[counts > 1] + 1] // 3
    return edges.astype(np.int64), sides


def edges_with_apexes(edges: np.ndarray, sides: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Computes `ClosedSurface.edges` for a surface that need not be closed.

    Args:
        edges: Point indices, shape (edge_count, 2).
        sides: Triangles on both sides, -1 where there is none, shape (edge_count, 2).
        triangles: Point indices, shape (triangle_count, 3).

    Returns:
        Shape (edge_count, 6).
    """
    corners = triangles[sides]
    off = (corners != edges[:, None, :1]) & (corners != edges[:, None, 1:])
    apexes = np.take_along_axis(corners, off.argmax(axis=2)[..., None], axis=2)[..., 0]
    apexes[sides < 0] = -1
    return np.ascontiguousarray(np.hstack([edges, sides, apexes]))
