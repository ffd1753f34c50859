"""Facts of cables."""

import numpy as np
import pytest

from softrobot_twin.constraints.cable import CablePath, Cables, folds
from softrobot_twin.geometry.point_location import locate_points
from softrobot_twin.geometry.quadratic_mesh import add_mid_edge_nodes
from softrobot_twin.mechanics.barycentric import BarycentricMapping
from test.builder import builder
from test.finite_differences import central_slopes


@pytest.fixture(params=["linear", "quadratic"])
def body(request, block):
    mesh = block(cells=(2, 2, 2))
    return mesh if request.param == "linear" else add_mid_edge_nodes(mesh)


def carried(mesh, points):
    found = locate_points(mesh.corner_mesh, np.array(points, float))
    return BarycentricMapping(*mesh.carriers(found.cells, found.barycentric_weights))


@builder
def make(bound_term, /, mesh, *paths, fixed=()):
    return bound_term(Cables, tuple(paths), mesh.node_positions, fixed)


def shaken(mesh, amount=0.01):
    return mesh.node_positions + amount * np.random.default_rng(0).standard_normal(mesh.node_positions.shape)


def collapsed(mesh):
    """So small that stretches between points of the body are rounded."""
    return 0.06 * mesh.node_positions + 0.02 * (shaken(mesh) - mesh.node_positions)


POINTS = [(0.03, 0.05, 0.07), (0.11, 0.12, 0.2), (0.15, 0.24, 0.31), (0.18, 0.1, 0.33)]


def two_cables(mesh):
    return (
        CablePath("through", carried(mesh, POINTS), np.array([-0.1, 0.0, 0.05])),
        CablePath("inside", carried(mesh, POINTS[::-1]), None),
    )


def test_shortening_is_zero_at_rest_and_minus_the_change_of_length(body, dense_rows, make):
    term, _, free = make(body, *two_cables(body))
    assert dense_rows(term, body.node_positions, free)[1] == pytest.approx(0.0, abs=1e-15)
    stretched = 1.5 * body.node_positions
    inside = np.array(POINTS)
    length = np.linalg.norm(np.diff(inside, axis=0), axis=1).sum()
    assert dense_rows(term, stretched, free)[1][1] == pytest.approx(-0.5 * length)


@pytest.mark.parametrize("deform", [shaken, collapsed])
def test_rows_are_the_derivative_of_the_shortening(body, deform, dense_rows, make):
    term, _, free = make(body, *two_cables(body), fixed=[0, 1, 2, 3])
    x = deform(body)
    H, _ = dense_rows(term, x, free)
    slopes = central_slopes(lambda at: dense_rows(term, at, free)[1], x, free, 1e-6)
    np.testing.assert_allclose(H.reshape(len(H), -1), slopes, atol=1e-8)


@pytest.mark.parametrize("deform", [shaken, collapsed])
def test_geometric_stiffness_is_the_derivative_of_the_pull(body, deform, dense_rows, make):
    term, matrix, free = make(body, *two_cables(body), fixed=[0, 5])
    x, tensions = deform(body), np.array([3.0, 1.7])
    matrix.clear()
    term.add_stiffness(x, tensions, matrix.storage)
    K = matrix.matrix().toarray()

    def pull(at):
        return np.einsum("k,kni->ni", tensions, dense_rows(term, at, free)[0]).ravel()

    np.testing.assert_allclose(K, -central_slopes(pull, x, free, 1e-6), atol=1e-6 * K.max())


def test_a_cable_segment_of_zero_length_has_zero_rows_and_bounded_stiffness(body, dense_rows, make):
    term, matrix, free = make(body, CablePath("c", carried(body, POINTS[:2]), None))
    x = 1e-12 * body.node_positions
    H, values = dense_rows(term, x, free)
    rounding = 0.1 * np.linalg.norm(np.subtract(*POINTS[:2]))
    assert np.abs(H).max() < 1e-9
    assert values == pytest.approx(10.0 * rounding - 0.5 * rounding)
    matrix.clear()
    term.add_stiffness(x, np.ones(1), matrix.storage)
    # Stretched along itself, where a straight one has no geometric stiffness.
    field = body.node_positions.ravel()
    apart = np.linalg.norm(np.subtract(*POINTS[:2]))
    assert field @ (matrix.matrix() @ field) == pytest.approx(apart**2 / rounding)


def test_a_step_may_shorten_a_cable_segment_to_zero_but_not_reverse_it(body, make):
    term, _, free = make(body, CablePath("c", carried(body, POINTS[:2]), None), fixed=[0])
    x = body.node_positions
    assert term.largest_share(x, -0.9 * x[free]) == 1.0
    assert term.largest_share(x, 4.0 * x[free]) == 1.0
    assert term.largest_share(x, -4.0 * x[free]) == pytest.approx(0.25)
    # One that is rounded may pass: its pull is smooth there.
    assert term.largest_share(0.05 * x, -4.0 * x[free]) == 1.0


def test_a_slack_cable_has_no_stiffness(body, make):
    term, matrix, _ = make(body, *two_cables(body))
    matrix.clear()
    term.add_stiffness(body.node_positions, np.zeros(2), matrix.storage)
    assert not matrix.storage.any()


def test_tension_has_no_resultant_on_a_free_body_that_holds_the_pull_point(body, dense_rows, make):
    term, _, free = make(body, *two_cables(body))
    H, _ = dense_rows(term, shaken(body), free)
    assert np.abs(H[1].sum(axis=0)).max() < 1e-14
    assert np.abs(H[0].sum(axis=0)).max() > 0.1


def test_a_point_given_twice_is_the_same_as_once(body, dense_rows, make):
    pull = np.array([-0.1, 0.0, 0.05])
    once, _, free = make(body, CablePath("c", carried(body, POINTS), pull))
    twice, _, _ = make(body, CablePath("c", carried(body, [POINTS[0]] + POINTS + POINTS[-1:]), pull))
    x = shaken(body)
    for a, b in zip(dense_rows(once, x, free), dense_rows(twice, x, free), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-14)


def test_a_pull_point_at_the_attach_point_gives_zero_rows(body, dense_rows, make):
    term, matrix, free = make(body, CablePath("c", carried(body, POINTS[:1]), np.array(POINTS[0])))
    H, values = dense_rows(term, body.node_positions, free)
    assert np.all(np.isfinite(H)) and not H.any() and values == pytest.approx(0.0)
    matrix.clear()
    term.add_stiffness(body.node_positions, np.ones(1), matrix.storage)
    assert not matrix.storage.any()


def test_a_swapped_pair_of_points_is_reported_as_a_fold():
    straight = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0.0]])
    assert folds(straight) == []
    assert folds(straight[[0, 2, 1, 3]]) == [1, 2]


def test_a_loop_with_round_corners_is_not_reported_as_a_fold():
    angle = np.linspace(0, np.pi, 5)
    loop = np.column_stack([np.sin(angle), -np.cos(angle), 0 * angle])
    assert folds(loop) == []


def test_a_repeated_point_is_not_reported_as_a_fold():
    assert folds(np.array([[0, 0, 0], [1, 0, 0], [1, 0, 0], [2, 0, 0.0]])) == []
