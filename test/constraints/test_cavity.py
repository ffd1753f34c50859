"""Facts of cavities."""

import numpy as np
import pytest

from softrobot_twin.constraints.cavity import Cavities
from softrobot_twin.geometry.point_location import locate_points
from softrobot_twin.geometry.quadratic_mesh import add_mid_edge_nodes
from softrobot_twin.geometry.surface import boundary_triangles
from softrobot_twin.mechanics.barycentric import BarycentricMapping
from softrobot_twin.mechanics.cavity_surfaces import CavitySurface
from test.finite_differences import central_slopes

SIZE = np.array([0.2, 0.3, 0.4])


@pytest.fixture(params=["nodes", "points", "points of a quadratic mesh"])
def cavity(request, block):
    """A mesh, and a closed surface in it: of its own nodes, or of points between them."""
    mesh = block(cells=(3, 3, 3))
    if request.param == "nodes":
        middle = mesh.node_positions[mesh.cells].mean(axis=1) * 3 / SIZE
        inside = ((middle > 1) & (middle < 2)).all(axis=1)
        triangles = boundary_triangles(mesh.cells[inside])
        used, index = np.unique(triangles, return_inverse=True)
        carriers = BarycentricMapping(used[:, None], np.ones((len(used), 1)))
        return mesh, CavitySurface("air", carriers, index.reshape(-1, 3))
    inner = block(size=0.4 * SIZE, cells=(1, 1, 2), shake=0.0)
    points = inner.node_positions + [0.07, 0.08, 0.13]
    if "quadratic" in request.param:
        mesh = add_mid_edge_nodes(mesh)
    found = locate_points(mesh.corner_mesh, points)
    carriers = BarycentricMapping(*mesh.carriers(found.cells, found.barycentric_weights))
    return mesh, CavitySurface("air", carriers.reduced(), boundary_triangles(inner.cells))


def shaken(mesh, amount=0.01):
    noise = np.random.default_rng(0).standard_normal(mesh.node_positions.shape)
    return mesh.node_positions + amount * noise


def test_growth_is_zero_at_rest_and_follows_a_stretch(cavity, bound_term, dense_rows):
    mesh, surface = cavity
    term, _, free = bound_term(Cavities, (surface,), mesh.node_positions)
    assert term.rest_volumes[0] > 0.0
    _, values = dense_rows(term, mesh.node_positions, free)
    assert values == pytest.approx(0.0, abs=1e-15)
    _, values = dense_rows(term, mesh.node_positions * [1.1, 1.2, 1.3], free)
    assert values[0] == pytest.approx((1.1 * 1.2 * 1.3 - 1.0) * term.rest_volumes[0], rel=1e-12)


def test_rows_are_the_derivative_of_the_volume(cavity, bound_term, dense_rows):
    mesh, surface = cavity
    term, _, free = bound_term(Cavities, (surface,), mesh.node_positions, fixed=range(5))
    x, step = shaken(mesh), 1e-5
    H, _ = dense_rows(term, x, free)
    scale = np.abs(H).max()
    assert scale > 0.0
    slopes = central_slopes(term.volumes, x, free, step)
    np.testing.assert_allclose(H.reshape(len(H), -1), slopes, atol=1e-8 * scale)


def test_stiffness_is_minus_the_derivative_of_the_forces_of_pressure(cavity, bound_term, dense_rows):
    mesh, surface = cavity
    term, matrix, free = bound_term(Cavities, (surface, surface), mesh.node_positions, fixed=[0, 5])
    x, pressures, step = shaken(mesh), np.array([300.0, -1700.0]), 1e-5
    matrix.clear()
    term.add_stiffness(x, pressures, matrix.storage)
    K = matrix.matrix().toarray()
    np.testing.assert_array_equal(K, K.T)
    assert np.abs(K).max() > 1.0

    def forces(at):
        return np.einsum("k,kni->ni", pressures, dense_rows(term, at, free)[0]).ravel()

    slopes = central_slopes(forces, x, free, step)
    np.testing.assert_allclose(K, -slopes, atol=1e-7 * np.abs(K).max())


def test_pressure_in_a_closed_surface_has_neither_force_nor_moment(cavity, bound_term, dense_rows):
    mesh, surface = cavity
    term, _, free = bound_term(Cavities, (surface,), mesh.node_positions)
    x = shaken(mesh)
    H, _ = dense_rows(term, x, free)
    scale = np.abs(H).sum()
    assert np.abs(H[0].sum(axis=0)).max() < 1e-14 * scale
    assert np.abs(np.cross(x, H[0]).sum(axis=0)).max() < 1e-14 * scale


def test_volume_is_exact_far_from_the_origin(cavity, bound_term):
    mesh, surface = cavity
    near, _, _ = bound_term(Cavities, (surface,), mesh.node_positions)
    far, _, _ = bound_term(Cavities, (surface,), mesh.node_positions + 1e3)
    assert far.rest_volumes == pytest.approx(near.rest_volumes, rel=1e-10)


def test_volumes_of_walls_behind_one_valve_sum_up(cavity, bound_term, dense_rows):
    mesh, surface = cavity
    both = CavitySurface(
        "both", surface.vertices.followed_by(surface.vertices),
        np.vstack([surface.triangles, surface.triangles + surface.vertices.point_count]),
    )  # fmt: skip
    one, _, free = bound_term(Cavities, (surface,), mesh.node_positions)
    two, _, _ = bound_term(Cavities, (both,), mesh.node_positions)
    x = shaken(mesh)
    for a, b in zip(dense_rows(one, x, free), dense_rows(two, x, free), strict=True):
        np.testing.assert_allclose(2.0 * a, b, rtol=1e-13, atol=1e-18)


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e2])
def test_no_step_turns_a_cavity_inside_out(cavity, bound_term, scale):
    mesh, surface = cavity
    rest = scale * mesh.node_positions
    term, _, free = bound_term(Cavities, (surface,), rest)
    assert term.largest_share(rest, 0.1 * rest[free]) == 1.0
    assert term.largest_share(rest, -0.1 * rest[free]) == 1.0
    flattened = np.zeros_like(rest)
    flattened[:, 2] = -2.0 * rest[:, 2]
    share = term.largest_share(rest, flattened[free])
    assert 0.0 < share < 0.5
    assert term.volumes(rest + share * flattened)[0] > 0.0
