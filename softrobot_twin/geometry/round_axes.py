"""Nearest places on the axes of round bodies: against a convex shape, and against each other.

An axis is a chain of elements. Between both ends of an element it is Hermite's cubic,

    x(s) = h_0 p_0 + h_1 p_1 + g_0 t_0 + g_1 t_1,   0 ≤ s ≤ 1

with the places p and the tangents t times the length. The body is all that is nearer to its axis
than its radius, so distances, normals and rolling are those of a round body, not of facets.

Where a range of an axis is equally near, its middle counts: a term ε L (s - ½)², which no other
place notices, makes the minimum unique, and keeps it where it is as the bodies move.

Arguments of the kernels here:
    axis, first, second: A `RoundAxis`.
    balls, others: Centre and radius of the ball of each element [m], shape (element_count, 4).
    e, f: An element of the first, and of the second axis.
    bend: Radius of curvature of the shape [m], infinite where it is flat.
    form: Of the convex shape, see `shape_distance`.
    least: A distance [m].
    out: The same in `_write_balls`; in `axis_distances` the distance of each element of the
        first axis from each of the second [m], shape (first_count, second_count).
    placed: Origin [m] and axes of the shape in the world, shape (4, 3).
    s: Share of an element, 0 to 1.
    x: Vectors at both ends of each element, shape (element_count, 2, 3).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softrobot_twin.geometry.proximities import write_row
from softrobot_twin.geometry.shapes.distance_kernels import (
    in_frame,
    shape_distance,
)
from softrobot_twin.geometry.vector3 import (
    add,
    add_scaled,
    cross,
    dot,
    norm,
    row,
    scaled,
    subtract,
    unit,
)
from softrobot_twin.kernels.compilation import INLINED, INNER, KERNEL, ONCE, njit

# ε: the nearest place moves by ε R/L elements where the distance has the radius of curvature R.
EVENNESS = 1.0e-4
# Places of an element at which distances are compared before the search.
PLACES = 5
# Halvings, by the golden ratio, of the range in which the nearest place lies: 1e-5 of an element.
HALVINGS = 22
# Shares above one less this are at the end of an element: the distance there is the same to 1e-6 L.
AT_END = 1.0e-3
# Newton steps to the nearest places of two elements.
STEPS = 8
# A place between the ends of an element touches a shape where it is nearer to it than both ends, by
# more than this share of the radius.
DIP = 0.02
# Elements shorter than this share of the radius of curvature of a round shape follow it: there the
# nodes alone touch, unless a place between them is nearer by a whole radius than on a straight
# element. Several contacts of one element would share a force in a way that changes with the
# slightest bend.
FOLLOWS = 0.3
GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)


class RoundAxis(NamedTuple):
    """A chain of elements.

    Attributes:
        places: Both ends of each element [m], shape (element_count, 2, 3).
        tangents: Tangents there times the element's length [m], shape (element_count, 2, 3).
        radius: Radius of the body [m].
    """

    places: np.ndarray
    tangents: np.ndarray
    radius: float


@njit(**INLINED)
def hermite(s):
    """Weights of places and tangents at share s."""
    late = s * s * (3.0 - 2.0 * s)
    return 1.0 - late, late, s * (1.0 - s) * (1.0 - s), -s * s * (1.0 - s)


@njit(**INLINED)
def at_end(x, e, end):
    """Row of one end of element e, of an array of shape (element_count, 2, 3)."""
    return (x[e, end, 0], x[e, end, 1], x[e, end, 2])


@njit(**KERNEL, forceinline=True)
def axis_point(axis, e, s):
    """x(s) of element e [m]."""
    h0, h1, g0, g1 = hermite(s)
    p, t = axis.places, axis.tangents
    x = add_scaled(scaled(at_end(p, e, 0), h0), at_end(p, e, 1), h1)
    return add_scaled(add_scaled(x, at_end(t, e, 0), g0), at_end(t, e, 1), g1)


@njit(**KERNEL, forceinline=True)
def axis_slope(axis, e, s):
    """dx/ds of element e [m]."""
    rise = 6.0 * s * (1.0 - s)
    p, t = axis.places, axis.tangents
    along = scaled(subtract(at_end(p, e, 1), at_end(p, e, 0)), rise)
    along = add_scaled(along, at_end(t, e, 0), (1.0 - s) * (1.0 - 3.0 * s))
    return add_scaled(along, at_end(t, e, 1), s * (3.0 * s - 2.0))


@njit(**INLINED)
def _ball_around(axis, e):
    """Centre and radius of a ball that holds the axis of element e, by its control points."""
    start, end = at_end(axis.places, e, 0), at_end(axis.places, e, 1)
    centre = scaled(add(start, end), 0.5)
    reach = norm(subtract(start, centre))
    third = 1.0 / 3.0
    start = add_scaled(start, at_end(axis.tangents, e, 0), third)
    end = add_scaled(end, at_end(axis.tangents, e, 1), -third)
    return centre, max(reach, max(norm(subtract(start, centre)), norm(subtract(end, centre))))


@njit(**INNER)
def _write_balls(axis, out):
    """Centre and radius of the ball of every element."""
    for e in range(len(axis.places)):
        centre, out[e, 3] = _ball_around(axis, e)
        out[e, 0], out[e, 1], out[e, 2] = centre


@njit(**INLINED)
def are_apart(balls, e, others, f, least):
    """Whether two balls are farther apart than a distance [m]."""
    x, y, z = balls[e, 0] - others[f, 0], balls[e, 1] - others[f, 1], balls[e, 2] - others[f, 2]
    reach = balls[e, 3] + others[f, 3] + least
    return x * x + y * y + z * z >= reach * reach

# --- against a shape ------------------------------------------------------------------------------


@njit(**INLINED)
def _shape_gap(axis, e, s, form, placed):
    """Distance of x(s) from a shape [m]."""
    distance, _ = shape_distance(form, in_frame(placed, axis_point(axis, e, s)))
    return distance


@njit(**ONCE)
def _least_dip(axis, e, bend):
    """By how much a place of element e is nearer to a shape than both ends where it touches [m]."""
    dip = DIP * axis.radius
    if bend < np.inf:
        length = norm(subtract(at_end(axis.places, e, 1), at_end(axis.places, e, 0)))
        bend += axis.radius
        if length < FOLLOWS * bend:
            # On a straight element it is L²/8R; near a rim or where the element buckles, more.
            dip = axis.radius + length * length / (8.0 * bend)
    return dip


@njit(**KERNEL, inline="always")
def nearest_share(axis, e, form, placed):
    """Share of element e that is nearest to a convex shape."""
    evenness = EVENNESS * norm(subtract(at_end(axis.places, e, 1), at_end(axis.places, e, 0)))
    best, least = 0, np.inf
    for k in range(PLACES):
        s = k / (PLACES - 1.0)
        gap = _shape_gap(axis, e, s, form, placed) + evenness * (s - 0.5) ** 2
        if gap < least:
            best, least = k, gap
    low = max(best - 1, 0) / (PLACES - 1.0)
    high = min(best + 1, PLACES - 1) / (PLACES - 1.0)
    a, b = high - GOLDEN * (high - low), low + GOLDEN * (high - low)
    at_a = _shape_gap(axis, e, a, form, placed) + evenness * (a - 0.5) ** 2
    at_b = _shape_gap(axis, e, b, form, placed) + evenness * (b - 0.5) ** 2
    for _ in range(HALVINGS):
        if at_a <= at_b:
            high, b, at_b = b, a, at_a
            a = high - GOLDEN * (high - low)
            at_a = _shape_gap(axis, e, a, form, placed) + evenness * (a - 0.5) ** 2
        else:
            low, a, at_a = a, b, at_b
            b = low + GOLDEN * (high - low)
            at_b = _shape_gap(axis, e, b, form, placed) + evenness * (b - 0.5) ** 2
    return 0.5 * (low + high)


@njit(**INNER)
def _write_shape_pair(axis, e, s, form, placed, margin, key, rows, count):
    """Write the pair of x(s) and a shape if it is nearer than the margin; the count after."""
    x = axis_point(axis, e, s)
    distance, g = shape_distance(form, in_frame(placed, x))
    gap = distance - axis.radius
    if gap >= margin:
        return count
    n = add_scaled(scaled(row(placed, 1), g[0]), row(placed, 2), g[1])
    n = add_scaled(n, row(placed, 3), g[2])
    first = ((e, e, e), (s, 0.0, 0.0), add_scaled(x, n, -axis.radius))
    second = ((-1, -1, -1), (0.0, 0.0, 0.0), add_scaled(x, n, -distance))
    write_row(rows, count, False, first, second, n, gap, key)
    return count + 1


@njit(**KERNEL)
def pair_axis_with_shape(axis, excluded, form, bend, placed, reach, rows, span):
    """Write what is nearer to a shape than the margin: nodes, and places of elements; see `DIP`.

    Args:
        axis: A `RoundAxis`.
        excluded: Keys that never count, shape (2 element_count + 1,).
        form: See above.
        bend: See above.
        placed: Frame of the shape; see `place_frame`.
        reach: See `proximities.py`.
        rows: See there.
        span: See there.
    """
    count, last, margin = span[0], len(axis.places) - 1, reach[0]
    for e in range(last + 1):
        centre, radius = _ball_around(axis, e)
        away, _ = shape_distance(form, in_frame(placed, centre))
        if away - radius - axis.radius >= margin:
            continue
        if not excluded[2 * e]:
            count = _write_shape_pair(axis, e, 0.0, form, placed, margin, 2 * e, rows, count)
        if not excluded[2 * e + 1]:
            s = nearest_share(axis, e, form, placed)
            dip = _least_dip(axis, e, bend)
            ends = min(_shape_gap(axis, e, 0.0, form, placed), _shape_gap(axis, e, 1.0, form, placed))
            if _shape_gap(axis, e, s, form, placed) < ends - dip:
                count = _write_shape_pair(axis, e, s, form, placed, margin, 2 * e + 1, rows, count)
        # The end of an element is a node of the next one, which may be too far to be looked at.
        if not excluded[2 * e + 2]:
            next_is_far = True
            if e < last:
                centre, radius = _ball_around(axis, e + 1)
                away, _ = shape_distance(form, in_frame(placed, centre))
                next_is_far = away - radius - axis.radius >= margin
            if next_is_far:
                count = _write_shape_pair(axis, e, 1.0, form, placed, margin, 2 * e + 2, rows, count)
    span[1] = count


# --- against each other ---------------------------------------------------------------------------


@njit(**INLINED)
def _along_edge(h, g, low, high):
    """Where h u²/2 + g u is least between two bounds."""
    return min(max(-g / h, low), high)


@njit(**ONCE)
def _step_in_square(h, m, k, a, b, s, t):
    """Step (u, v) that minimises (h u² + 2m uv + k v²)/2 + a u + b v, within 0 to 1 of s and t."""
    det = h * k - m * m
    u, v = (m * b - k * a) / det, (m * a - h * b) / det
    if 0.0 <= s + u <= 1.0 and 0.0 <= t + v <= 1.0:
        return u, v
    least, best_u, best_v = np.inf, 0.0, 0.0
    for edge in range(4):
        if edge < 2:
            u = edge - s
            v = _along_edge(k, b + m * u, -t, 1.0 - t)
        else:
            v = edge - 2 - t
            u = _along_edge(h, a + m * v, -s, 1.0 - s)
        value = 0.5 * (h * u * u + k * v * v) + m * u * v + a * u + b * v
        if value < least:
            least, best_u, best_v = value, u, v
    return best_u, best_v


@njit(**KERNEL)
def nearest_shares(first, e, second, f):
    """Shares of element e of one axis and f of another that are nearest to each other."""
    # Elements that lie along each other may have several minima: begin at the best of some places.
    s, t, least = 0.5, 0.5, np.inf
    for i in range(PLACES):
        x = axis_point(first, e, i / (PLACES - 1.0))
        for j in range(PLACES):
            away = subtract(x, axis_point(second, f, j / (PLACES - 1.0)))
            if dot(away, away) < least:
                s, t, least = i / (PLACES - 1.0), j / (PLACES - 1.0), dot(away, away)
    for _ in range(STEPS):
        away = subtract(axis_point(first, e, s), axis_point(second, f, t))
        x, y = axis_slope(first, e, s), axis_slope(second, f, t)
        xx, yy = dot(x, x), dot(y, y)
        # The square of what `nearest_share` adds to a distance.
        even = EVENNESS * (xx + yy)
        u, v = _step_in_square(
            xx + even, -dot(x, y), yy + even, dot(away, x) + even * (s - 0.5),
            -dot(away, y) + even * (t - 0.5), s, t,
        )  # fmt: skip
        # Where bends matter, a whole step may lead farther apart.
        now = dot(away, away) + even * ((s - 0.5) ** 2 + (t - 0.5) ** 2)
        for _ in range(STEPS):
            a, b = min(max(s + u, 0.0), 1.0), min(max(t + v, 0.0), 1.0)
            away = subtract(axis_point(first, e, a), axis_point(second, f, b))
            if dot(away, away) + even * ((a - 0.5) ** 2 + (b - 0.5) ** 2) <= now:
                break
            u, v = 0.5 * u, 0.5 * v
        s, t = a, b
        if abs(u) + abs(v) < 1.0e-12:
            break
    return s, t


@njit(**KERNEL)
def pair_axes(first, second, is_same, excluded, reach, rows, span):
    """Write what is nearer than the margin between the elements of two axes, or of one.

    Each pair of elements has one place, at their ends too: where beams lie along each other, what
    is pushed apart at one place must not come together at the next.

    Args:
        first: A `RoundAxis`.
        second: Another, or the same.
        is_same: Whether it is the same.
        excluded: Pairs of elements that never count, shape (first_count, second_count).
        reach: See `proximities.py`.
        rows: See there.
        span: See there.
    """
    count, last, others = span[0], len(first.places) - 1, len(second.places)
    thick, margin = first.radius + second.radius, reach[0]
    balls, other_balls = np.empty((last + 1, 4)), np.empty((others, 4))
    _write_balls(first, balls)
    _write_balls(second, other_balls)
    for e in range(last + 1):
        for f in range(e + 1 if is_same else 0, others):
            if are_apart(balls, e, other_balls, f, thick + margin) or excluded[e, f]:
                continue
            s, t = nearest_shares(first, e, second, f)
            x, y = axis_point(first, e, s), axis_point(second, f, t)
            away = subtract(x, y)
            distance = norm(away)
            if distance - thick >= margin:
                continue
            # The end of an element is the start of the next one, with which it is found again.
            if (s > 1.0 - AT_END and e < last) or (t > 1.0 - AT_END and f < others - 1):
                continue
            n = unit(away)
            if distance == 0.0:
                # Axes that cross: all directions across both are equally short.
                n = unit(cross(axis_slope(first, e, s), axis_slope(second, f, t)))
            on_first = ((e, e, e), (s, 0.0, 0.0), add_scaled(x, n, -first.radius))
            on_second = ((f, f, f), (t, 0.0, 0.0), add_scaled(y, n, second.radius))
            key = e * others + f
            write_row(rows, count, False, on_first, on_second, n, distance - thick, key)
            count += 1
    span[1] = count


@njit(**KERNEL)
def axis_distances(first, second, out):
    """Distance between the axes of every two elements [m]."""
    for e in range(len(first.places)):
        for f in range(len(second.places)):
            s, t = nearest_shares(first, e, second, f)
            out[e, f] = norm(subtract(axis_point(first, e, s), axis_point(second, f, t)))
