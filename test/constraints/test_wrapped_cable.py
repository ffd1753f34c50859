"""Cables around cylinders: the shortest way, and how its length changes with its ends."""

import numpy as np
import pytest

from softrobot_twin.constraints.cable import CablePath, Cables, Wrap
from softrobot_twin.constraints.cable_friction import CableMaterials
from softrobot_twin.constraints.wrapped_cable import RubbingWraps, WrappedCables, course, drawn_path, side_at
from softrobot_twin.mechanics.barycentric import BarycentricMapping
from test.finite_differences import central_slopes, slots_of_dense

AXIS = np.array([1.0, 2.0, -0.5]) / np.linalg.norm([1.0, 2.0, -0.5])
DRUM = Wrap(np.array([0.1, -0.2, 0.3]), AXIS, 0.05)
FREE = np.arange(4)


def length_of(first, second, wrap):
    way = course(first, second, wrap)
    return (np.linalg.norm(way.leaves - first) + way.arc + np.linalg.norm(second - way.joins))


def ends(rng, wrap):
    """Two points whose straight way passes through a cylinder, and the side of it."""
    while True:
        one, other = wrap.centre + rng.uniform(-0.15, 0.15, (2, 3))
        far = [np.linalg.norm(np.cross(point - wrap.centre, wrap.axis)) for point in (one, other)]
        ways = one + np.linspace(0, 1, 50)[:, None] * (other - one)
        nearest = np.linalg.norm(np.cross(ways - wrap.centre, wrap.axis), axis=1).min()
        if min(far) > 1.2 * wrap.radius and nearest < 0.8 * wrap.radius:
            return one, other, wrap._replace(side=side_at(one, other, wrap))


@pytest.mark.parametrize("seed", range(4))
def test_it_is_the_shortest_way_on_the_cylinder(seed):
    one, other, wrap = ends(np.random.default_rng(seed), DRUM)
    basis = np.linalg.svd(wrap.axis[None])[2][1:]
    way = course(one, other, wrap)
    assert way.angle > 0.0

    def place(angle, height):
        across = np.cos(angle) * basis[0] + np.sin(angle) * basis[1]
        return wrap.centre + wrap.radius * across + height * wrap.axis

    def by(leaves, joins):
        turned = np.arctan2(*(np.array([basis[1], basis[0]]) @ (joins - wrap.centre)))
        start = np.arctan2(*(np.array([basis[1], basis[0]]) @ (leaves - wrap.centre)))
        turn = (wrap.side * np.sign(np.cross(*basis) @ wrap.axis) * (turned - start)) % (2 * np.pi)
        return np.hypot(wrap.radius * turn, wrap.axis @ (joins - leaves))

    start = [np.arctan2(basis[1] @ (x - wrap.centre), basis[0] @ (x - wrap.centre))
             for x in (way.leaves, way.joins)]  # fmt: skip
    heights = [wrap.axis @ (x - wrap.centre) for x in (way.leaves, way.joins)]

    def total(q):
        leaves, joins = place(q[0], q[1]), place(q[2], q[3])
        return np.linalg.norm(leaves - one) + by(leaves, joins) + np.linalg.norm(other - joins)

    mine = length_of(one, other, wrap)
    assert total([start[0], heights[0], start[1], heights[1]]) == pytest.approx(mine, rel=1e-12)
    # No other way that stays outside is shorter.
    rng, others = np.random.default_rng(seed), []
    for _ in range(400):
        q = [start[0], heights[0], start[1], heights[1]] + rng.normal(0.0, [0.1, 0.005, 0.1, 0.005])
        leaves, joins = place(q[0], q[1]), place(q[2], q[3])
        shares = np.linspace(0.0, 1.0, 400)[:, None]
        ways = np.concatenate([one + shares * (leaves - one), joins + shares * (other - joins)])
        if np.linalg.norm(np.cross(ways - wrap.centre, wrap.axis), axis=1).min() >= wrap.radius - 1e-9:
            others.append(total(q))
    assert len(others) > 20 and min(others) > mine
    points = np.array([one, other])
    drawn = drawn_path(CablePath("c", None, None, {0: wrap}), points)
    assert np.linalg.norm(np.diff(drawn, axis=0), axis=1).sum() == pytest.approx(mine, rel=2e-5)
    far = np.linalg.norm(np.cross(drawn - wrap.centre, wrap.axis), axis=1)
    assert far.min() == pytest.approx(wrap.radius, rel=1e-9)


def term_of(points, wrap, kind=WrappedCables, pull=None):
    """A cable from node to node, the first one around a cylinder."""
    count = len(points)
    mapping = BarycentricMapping(np.arange(count)[:, None], np.ones((count, 1)))
    path = CablePath("c", mapping, pull, {0: wrap} if wrap is not None else {})
    return kind((path,), FREE[:count], points)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("from_world", [False, True])
def test_rows_are_finite_differences_of_the_length(seed, from_world):
    rng = np.random.default_rng(10 + seed)
    one, other, wrap = ends(rng, DRUM)
    x = np.array([other, other + [0.02, 0.1, 0.0]]) if from_world else np.array(
        [one, other, other + [0.02, 0.1, 0.0]])  # fmt: skip
    term = term_of(x, wrap, pull=one if from_world else None)
    x = x + rng.normal(0.0, 0.003, x.shape)
    blocks, values, rows = np.empty((len(term.entry_rows), 3)), np.empty(1), np.zeros_like(x)
    term.evaluate(x, blocks, values)
    np.add.at(rows, term.entry_nodes, blocks)
    slopes = -central_slopes(lambda at: term.lengths(at)[0], x, range(len(x)), 1e-7)
    np.testing.assert_allclose(rows.ravel(), slopes, rtol=1e-6, atol=1e-8)
    # A straight line across the axis in the plane: the stiffness of its segments is exact.
    assert values[0] == pytest.approx(term.rest_lengths[0] - term.lengths(x)[0], abs=1e-15)


def test_across_the_axis_the_stiffness_is_the_derivative_of_the_pulls():
    wrap = Wrap(np.zeros(3), np.array([0.0, 0.0, 1.0]), 0.03)
    x = np.array([[-0.1, 0.01, 0.0], [0.09, 0.02, 0.0]])
    term = term_of(x, wrap._replace(side=side_at(*x, wrap)))
    term.bind(np.arange(2), slots_of_dense(2))
    storage = np.zeros(36)
    term.add_stiffness(x, np.array([2.0]), storage)
    lower = storage.reshape(6, 6).T
    found = np.where(lower != 0.0, lower, lower.T)

    def pulls(at):
        blocks, values, rows = np.empty((len(term.entry_rows), 3)), np.empty(1), np.zeros_like(at)
        term.evaluate(at, blocks, values)
        np.add.at(rows, term.entry_nodes, 2.0 * blocks)
        return rows.ravel()

    expected = -central_slopes(pulls, x, range(2), 1e-7)
    in_plane = [0, 1, 3, 4]
    np.testing.assert_allclose(found[np.ix_(in_plane, in_plane)], expected[np.ix_(in_plane, in_plane)],
                               rtol=1e-6, atol=1e-6)  # fmt: skip
    assert np.linalg.eigvalsh(found).min() > -1e-9


def test_clear_of_the_cylinder_it_is_a_straight_cable():
    wrap = DRUM._replace(centre=np.array([5.0, 5.0, 5.0]))
    x = np.random.default_rng(1).uniform(-0.1, 0.1, (3, 3))
    around, straight = term_of(x, wrap), term_of(x, None, Cables)
    moved = x + np.random.default_rng(2).normal(0.0, 0.02, x.shape)
    for term in (around, straight):
        term.blocks, term.values, term.rows = np.empty((len(term.entry_rows), 3)), np.empty(1), np.zeros((3, 3))
        term.evaluate(moved, term.blocks, term.values)
        np.add.at(term.rows, term.entry_nodes, term.blocks)
    np.testing.assert_allclose(around.values, straight.values, atol=1e-14)
    np.testing.assert_allclose(around.rows, straight.rows, atol=1e-12)


def test_the_length_is_continuous_where_it_leaves_the_cylinder():
    wrap = Wrap(np.zeros(3), np.array([0.0, 0.0, 1.0]), 0.03, 1.0)
    heights = np.linspace(0.0305, 0.0295, 21)
    lengths = [length_of(np.array([0.1, -h, 0.0]), np.array([-0.1, -h, 0.0]), wrap._replace(side=-1.0))
               for h in heights]  # fmt: skip
    assert np.abs(np.diff(lengths)).max() < 1e-5
    assert lengths[0] == pytest.approx(0.2, abs=1e-12) and lengths[-1] > 0.2


def rubbing(points, wrap, friction=0.3, presliding=1e-7):
    materials = CableMaterials(np.array([np.inf]), np.array([friction]), np.array([presliding]))
    return term_of(points, wrap, lambda paths, free, rest: RubbingWraps(paths, free, rest, materials))


def slipped(term, x, tension):
    """Shortening where the winch has wound in so much that the cable slips everywhere."""
    term.tell_efforts(np.array([tension]))
    term.begin_beyond[1:] = term.beyond[1:] + 1.0
    return term.rows_at(x)[1][0]


@pytest.mark.parametrize("seed", range(3))
def test_a_cable_that_slips_over_a_cylinder_has_the_tensions_of_the_capstan_equation(seed):
    one, other, wrap = ends(np.random.default_rng(20 + seed), DRUM)
    x = np.array([one, other])
    term = rubbing(x, wrap)
    slipped(term, x, 2.0)
    drawn = np.diff(drawn_path(CablePath("c", None, None, {0: wrap}), x), axis=0)
    drawn /= np.linalg.norm(drawn, axis=1, keepdims=True)
    turned = np.arccos(np.clip((drawn[:-1] * drawn[1:]).sum(axis=1), -1.0, 1.0)).sum()
    assert turned > 0.1
    assert term.tensions == pytest.approx([2.0, 2.0 * np.exp(-0.3 * turned)], rel=1e-4)


def test_more_than_half_a_turn_counts_whole_and_none_where_it_runs_clear():
    flat = Wrap(np.zeros(3), np.array([0.0, 0.0, 1.0]), 0.03)
    for between, turns in ((5.0, True), (0.6, False)):
        x = 0.032 * np.array([[1.0, 0.0, 0.0], [np.cos(between), np.sin(between), 0.0]])
        way = course(*x, flat._replace(side=1.0))
        term = rubbing(x, flat._replace(side=1.0))
        slipped(term, x, 2.0)
        assert (way.angle > np.pi) == turns and (way.angle > 0.0) == turns
        assert term.tensions[1] == pytest.approx(2.0 * np.exp(-0.3 * way.angle), rel=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_with_friction_rows_are_finite_differences_of_the_shortening(seed):
    rng = np.random.default_rng(30 + seed)
    one, other, wrap = ends(rng, DRUM)
    x = np.array([one, other, other + [0.02, 0.1, 0.0]])
    term = rubbing(x, wrap, presliding=0.1)
    x = x + rng.normal(0.0, 0.003, x.shape)

    def shortening(at):
        term.tell_efforts(np.array([2.0]))
        return term.rows_at(at)[1][0]

    slopes = central_slopes(shortening, x, range(len(x)), 1e-7)
    shortening(x)
    _, nodes, blocks = term.displacement_entries()
    rows = np.zeros_like(x)
    np.add.at(rows, nodes, blocks)
    np.testing.assert_allclose(rows.ravel(), slopes, rtol=1e-6, atol=1e-8)
    assert 0.0 < np.abs(term.shares[1:]).max() < 1.0
    forces, pulls = np.zeros((2, len(x), 3)), np.zeros_like(x)
    for side, tension in enumerate((2.0 + 1e-5, 2.0 - 1e-5)):
        term.tell_efforts(np.array([tension]))
        term.held_forces.add_forces(x, forces[side])
    shortening(x)
    np.add.at(pulls, term.entry_nodes, term.rows_at(x)[0])
    np.testing.assert_allclose(pulls, (forces[0] - forces[1]) / 2e-5, atol=1e-6)
