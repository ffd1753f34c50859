"""Edges of a surface against a convex shape.

Along an edge the signed distance is convex, so its slope only grows: one crossing of zero is the
minimum. Where the slope jumps there (inside a box's edge or a cylinder's rim two ways out are
equally short) the nearest way out of the whole edge is across it: that convex combination g of
the two gradients which is square to the edge. The overlap along g/|g| is the distance over |g|,
and so an edge against an edge keeps its normal from outside through contact into overlap.

An edge that lies along a cylinder or across a box's face has a stretch of hardly any slope; it
gets both ends of the stretch, as far as they are not vertices.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from softrobot_twin.geometry.closest_features import triangle_normal
from softrobot_twin.geometry.shapes.distance_kernels import BOX, shape_distance
from softrobot_twin.geometry.surface_shape_found import KEY_STRIDE, SURELY, put

# Sine of the angle up to which an edge counts as parallel to what it lies on.
PARALLEL = 0.05
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
    if s_probe > PARALLEL:
        return bottom, 0.0, 0.0, 0.0
    if way * s_end > PARALLEL:
        s_probe *= way
        if way > 0.0:
            low, high = slope_crossing(
                kind, extents, x, a, b, PARALLEL, probe, s_probe - PARALLEL - LEVEL,
                end, s_end - PARALLEL,
            )  # fmt: skip
            end = low
        else:
            low, high = slope_crossing(
                kind, extents, x, a, b, -PARALLEL, end, s_end + PARALLEL,
                probe, s_probe + PARALLEL + LEVEL,
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
        falls, rises = s_a <= -PARALLEL, s_b >= PARALLEL
        if s_a >= PARALLEL or s_b <= -PARALLEL or not (falls or rises or s_a < 0.0 < s_b):
            continue
        short = SHORT * min(1.0, width / length)
        count = search_edge(
            kind, extents, x, edges[e], short, s_a, s_b, sides[e], triangles, margin,
            first_key + KEY_STRIDE * e, found, count,
        )  # fmt: skip
    return count, np.sqrt(longest)
