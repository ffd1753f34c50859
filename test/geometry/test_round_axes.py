"""Nearest places on axes of round bodies, against a search over all of them."""

from functools import partial

import numpy as np
import pytest

from softrobot_twin.geometry.proximities import found_by
from softrobot_twin.geometry.round_axes import (
    RoundAxis,
    axis_point,
    axis_slope,
    nearest_share,
    nearest_shares,
    pair_axes,
    pair_axis_with_shape,
)
from test.shapes import Box, Capsule, Cylinder, Plane, Sphere

AT_WORLD = np.vstack([np.zeros(3), np.eye(3)])
FINE = np.linspace(0.0, 1.0, 401)


def chain(random, count=4, length=0.05, radius=0.002, bend=0.4):
    """A random smooth axis: ends of elements share place and tangent."""
    turns = bend * random.standard_normal((count + 1, 3))
    tangents = np.cumsum(turns, axis=0) + [1.0, 0.0, 0.0]
    tangents *= length / np.linalg.norm(tangents, axis=1, keepdims=True)
    steps = 0.5 * (tangents[:-1] + tangents[1:])
    places = np.vstack([np.zeros(3), np.cumsum(steps, axis=0)]) + random.standard_normal(3) * 0.03

    def at_ends(x):
        return np.stack([x[:-1], x[1:]], axis=1)

    return RoundAxis(at_ends(places), at_ends(tangents), radius)


def points_of(axis, e):
    return np.array([axis_point(axis, e, s) for s in FINE])


def test_slope_is_the_derivative_of_the_place():
    axis = chain(np.random.default_rng(1))
    for s in (0.0, 0.3, 1.0):
        found = (np.array(axis_point(axis, 1, s + 1e-6)) - axis_point(axis, 1, s - 1e-6)) / 2e-6
        np.testing.assert_allclose(found, axis_slope(axis, 1, s), atol=1e-8)


@pytest.mark.parametrize("shape", [
    Plane([0.0, 0.0, -0.02], [0.1, 0.2, 1.0]), Sphere([0.1, 0.05, 0.0], 0.02),
    Capsule([[0.05, -0.1, 0.05], [0.1, 0.1, 0.04]], 0.01),
    Cylinder([[0.05, -0.1, 0.05], [0.1, 0.1, 0.04]], 0.01),
    Box([0.1, 0.0, 0.06], [0.05, 0.02, 0.03]),
], ids=lambda shape: type(shape).__name__)  # fmt: skip
def test_place_nearest_to_a_shape_is_that_of_a_search(shape, drawn_rng):
    origin, axes = shape.frame()
    placed = np.vstack([origin, np.array(axes).T])
    one_dip_count = 0
    for _ in range(20):
        axis = chain(drawn_rng)
        for e in range(4):
            distances, _ = shape.signed_distances(points_of(axis, e))
            s = nearest_share(axis, e, shape.form(), placed)
            found, _ = shape.signed_distances([axis_point(axis, e, s)])
            # An axis that is bent around an edge may be near at two places: either may be found.
            falls = np.diff(distances) < 0.0
            if (falls[1:] & ~falls[:-1]).any():
                continue
            # What makes flat minima unique moves the place by no more than this.
            assert found[0] < distances.min() + 2e-5 * 0.05
            one_dip_count += 1
    assert one_dip_count >= 40


def test_places_of_two_elements_nearest_to_each_other_are_those_of_a_search(drawn_rng):
    one_dip_count = 0
    for _ in range(30):
        first, second = chain(drawn_rng, bend=0.05), chain(drawn_rng, bend=0.05)
        # As near as what touches is: farther apart, bent elements have several equal minima.
        shift = points_of(first, 1)[200] - points_of(second, 2)[200]
        second = second._replace(places=second.places + shift + 0.005 * drawn_rng.standard_normal(3))
        x, y = points_of(first, 1), points_of(second, 2)
        apart = np.linalg.norm(x[:, None] - y, axis=2)
        # Bent elements side by side may be near at two places: either may be found.
        falls = np.diff(apart.min(axis=1)) < -1e-9
        if (falls[1:] & ~falls[:-1]).any():
            continue
        one_dip_count += 1
        least = apart.min()
        s, t = nearest_shares(first, 1, second, 2)
        away = np.array(axis_point(first, 1, s)) - axis_point(second, 2, t)
        # What makes flat minima unique adds no more than 1e-4 L² to the square; in long valleys the
        # search stops a little before their lowest place.
        assert np.linalg.norm(away) < 1.02 * np.sqrt(least**2 + 1e-4 * 0.05**2)
    assert one_dip_count >= 10


def test_a_straight_axis_above_a_plane_touches_with_its_nodes():
    places = np.array([[0.1 * k, 0.0, 0.005] for k in range(4)])
    tangents = np.tile([0.1, 0.0, 0.0], (3, 1))
    axis = RoundAxis(np.stack([places[:-1], places[1:]], axis=1),
                     np.stack([tangents, tangents], axis=1), 0.004)  # fmt: skip
    found = found_by(partial(
        pair_axis_with_shape, axis, np.zeros(7, bool), Plane([0, 0, 0], [0, 0, 1]).form(),
        np.inf, AT_WORLD,
    ), margin=0.003)  # fmt: skip
    np.testing.assert_array_equal(found.keys, [0, 2, 4, 6])
    np.testing.assert_allclose(found.gaps, 0.001)
    np.testing.assert_allclose(found.normals, np.tile([0.0, 0.0, 1.0], (4, 1)))
    np.testing.assert_allclose(found.first_positions[:, 2], 0.001)


def test_an_axis_across_a_wire_touches_between_its_nodes():
    axis = RoundAxis(np.array([[[-0.02, 0.0, 0.006], [0.03, 0.0, 0.006]]]),
                     np.tile([0.05, 0.0, 0.0], (1, 2, 1)), 0.004)  # fmt: skip
    wire = Capsule([[0.0, -0.1, 0.0], [0.0, 0.1, 0.0]], 0.001)
    origin, axes = wire.frame()
    found = found_by(partial(
        pair_axis_with_shape, axis, np.zeros(3, bool), wire.form(), wire.radius,
        np.vstack([origin, np.array(axes).T]),
    ), margin=0.003)  # fmt: skip
    np.testing.assert_array_equal(found.keys, [1])
    assert found.first_weights[0, 0] == pytest.approx(0.4, abs=1e-3)
    assert found.gaps[0] == pytest.approx(0.001, abs=1e-9)


def test_axes_that_cross_are_parted_along_the_direction_across_both():
    def straight(direction):
        along = np.array(direction, float)
        return RoundAxis(np.array([[-0.5 * along, 0.5 * along]]), np.tile(along, (1, 2, 1)), 0.004)

    found = found_by(partial(
        pair_axes, straight([0.1, 0, 0]), straight([0, 0.1, 0]), False, np.zeros((1, 1), bool),
    ), margin=0.003)  # fmt: skip
    assert len(found.gaps) == 1
    np.testing.assert_allclose(np.abs(found.normals[0]), [0.0, 0.0, 1.0])
    assert found.gaps[0] == pytest.approx(-0.008)
