"""The barrier against flat elements: derivatives, reach, and the share of a move that it allows."""

import numpy as np
import pytest
from numpy.linalg import det

from softrobot_twin.geometry.quadratic_mesh import add_mid_edge_nodes
from softrobot_twin.geometry.tet_mesh import TetMesh
from softrobot_twin.mechanics.fold_barrier import KEPT_SHARE
from softrobot_twin.mechanics.element_batches import BATCH
from softrobot_twin.mechanics.polar import find_upright
from softrobot_twin.mechanics.volume_barrier import (
    BARRIER_VOLUME,
    KEPT_VOLUME,
    barrier,
    no_volumes_yet,
    take_least_volumes,
)

FLAT = np.diag([0.5, 0.4, 0.2])  # det F is 0.04.


@pytest.fixture(params=["linear", "quadratic"])
def mesh(request, block):
    linear = block(cells=(1, 1, 1))
    return linear if request.param == "linear" else add_mid_edge_nodes(linear)


@pytest.fixture
def body(mesh, bind):
    """A corotational body; its first two nodes are held."""
    return mesh, bind(("corotational", mesh, 2.0e5, 0.35), fixed=[0, 1])


def pressed(mesh, seed=3):
    """Nearly flat, and shaken."""
    size = np.ptp(mesh.node_positions, axis=0).max()
    shaken = 0.004 * size * np.random.default_rng(seed).standard_normal(mesh.node_positions.shape)
    return mesh.node_positions @ FLAT + shaken


def test_forces_and_stiffness_of_nearly_flat_elements_are_slopes_of_their_energy(body):
    mesh, bound = body
    x = pressed(mesh)
    bound.assert_slopes(x, step=1e-6 * np.ptp(x))


def test_their_projected_stiffness_has_no_negative_curvature(body):
    mesh, bound = body
    assert bound.least_curvatures(pressed(mesh))[1] > -1e-12


@pytest.mark.parametrize("volume", [0.9999999 * BARRIER_VOLUME, BARRIER_VOLUME, 0.5, 1.0, 3.0])
def test_the_barrier_begins_with_two_continuous_derivatives(volume):
    energy, slope, curvature = barrier(volume)
    assert abs(energy) < 1e-19 and abs(slope) < 1e-11 and abs(curvature) < 1e-3


def test_the_barrier_grows_without_bound_towards_flatness():
    energies = [barrier(BARRIER_VOLUME * share)[0] for share in (1e-1, 1e-2, 1e-4, 1e-8)]
    assert (np.diff(energies) > 1.0).all()


def test_a_law_of_small_displacements_has_no_barrier(mesh, bind):
    bound = bind(("linear", mesh, 2.0e5, 0.35), fixed=[0, 1])
    x = pressed(mesh)
    half = 0.5 * (x + mesh.node_positions)
    np.testing.assert_allclose(bound.forces(x)[0], 2.0 * bound.forces(half)[0], rtol=1e-9, atol=1e-9)
    assert bound.terms[0].largest_share(mesh.node_positions, -x) == 1.0


def test_a_move_through_flatness_is_allowed_only_until_most_volume_is_lost(body):
    mesh, bound = body
    x, term = mesh.node_positions, bound.terms[0]
    share = term.largest_share(x, -x)
    # det F is (1 - 2 t)³; between points more of it is kept.
    kept = KEPT_VOLUME if isinstance(mesh, TetMesh) else KEPT_SHARE
    most = 0.5 * (1.0 - kept ** (1.0 / 3.0))
    assert 0.8 * most < share <= most
    assert term.largest_share(x, 0.8 * x) == 1.0
    # det F is (1 - 3 t)² here: it is positive at the end, but not on the path.
    through = x @ np.diag([-2.0, -2.0, 1.0])
    assert det(np.diag([-2.0, -2.0, 1.0])) > 0.0
    assert term.largest_share(x, through) < 1.0 / 3.0


def test_an_element_that_is_inside_out_does_not_hold_up_a_move(body):
    mesh, bound = body
    x = mesh.node_positions
    assert bound.terms[0].largest_share(x * [1.0, 1.0, -0.5], x) == 1.0


@pytest.mark.parametrize("scales, acts", [
    ((1.0, 1.0), False), ((1.0, 0.05), True), ((0.05, -0.5), False), ((np.nan, 0.05), False),
])  # fmt: skip
def test_the_barrier_acts_where_a_point_is_nearly_flat_and_none_is_inside_out(scales, acts):
    least, upright = no_volumes_yet(), np.empty(BATCH)
    for place, scale in enumerate(scales):
        F = np.zeros((9, BATCH))
        F[[0, 4, 8]] = 1.0
        F[8, 3 + place] = scale
        find_upright(F.ravel(), upright)
        take_least_volumes(F.ravel(), upright, least)
    assert (BARRIER_VOLUME > least.min() > -np.inf) == acts


def test_a_body_with_one_point_inside_out_has_no_barrier(body, mesh):
    mesh, bound = body
    term, x = bound.terms[0], pressed(mesh)
    bound.forces(x)
    assert term.nearly_flat_count > 0
    bound.forces(x * [1.0, 1.0, -1.0])
    assert term.nearly_flat_count == 0
