"""Facts of cavities on bodies that move in a basis."""

from types import SimpleNamespace

import numpy as np
import pytest

from softrobot_twin.constraints.cavity import Cavities
from softrobot_twin.constraints.reduced_cavities import ReducedCavities, ReducedWalls
from softrobot_twin.geometry.point_location import locate_points
from softrobot_twin.geometry.quadratic_mesh import add_mid_edge_nodes
from softrobot_twin.geometry.surface import boundary_triangles
from softrobot_twin.mechanics.barycentric import BarycentricMapping
from softrobot_twin.mechanics.cavity_surfaces import CavitySurface
from test.spheres import cut_on_sphere

SIZE = np.array([0.2, 0.3, 0.4])
# Coordinate nodes among the free nodes of a scene; the others belong to something else.
PLACES, NODE_COUNT = np.array([4, 1, 2]), 6


@pytest.fixture(params=["nodes", "points of a quadratic mesh"])
def carrier(request, block):
    """Nodes of a mesh, and a closed surface: of its own nodes, or of points between them."""
    mesh = block(cells=(3, 3, 3))
    if request.param == "nodes":
        middle = mesh.node_positions[mesh.cells].mean(axis=1) * 3 / SIZE
        inside = ((middle > 1) & (middle < 2)).all(axis=1)
        used, index = np.unique(boundary_triangles(mesh.cells[inside]), return_inverse=True)
        on_nodes = BarycentricMapping(used[:, None], np.ones((len(used), 1)))
        return mesh.node_positions, CavitySurface("air", on_nodes, index.reshape(-1, 3))
    inner = block(size=0.4 * SIZE, cells=(1, 1, 2), shake=0.0)
    points = inner.node_positions + [0.07, 0.08, 0.13]
    mesh = add_mid_edge_nodes(mesh)
    found = locate_points(mesh.corner_mesh, points)
    between = BarycentricMapping(*mesh.carriers(found.cells, found.barycentric_weights))
    surface = CavitySurface("air", between.reduced(), boundary_triangles(inner.cells))
    return mesh.node_positions, surface


@pytest.fixture
def reduced(carrier, drawn_rng, bound_term):
    """A cavity on a body in nine random modes, and the same on all nodes."""
    rest, surface = carrier
    basis = drawn_rng.uniform(-1.0, 1.0, (len(rest), 3, 3 * len(PLACES)))
    term, matrix, free = bound_term(
        lambda entries, free_index, _: ReducedCavities(
            ["air"], [ReducedWalls(entries, rest, basis, PLACES)], free_index
        ),
        (surface,), np.zeros((NODE_COUNT, 3)), fixed=[0],
    )  # fmt: skip
    whole, _, _ = bound_term(Cavities, (surface,), rest)
    return SimpleNamespace(
        rest=rest, surface=surface, basis=basis, term=term, matrix=matrix, free=free, whole=whole
    )


def state(q):
    """Nodes of a scene whose coordinates are q."""
    positions = np.full((NODE_COUNT, 3), 7.0)
    positions[PLACES] = np.reshape(q, (-1, 3))
    return positions


def on_nodes(rest, basis, q):
    return rest + basis @ np.ravel(q)


def by_coordinates(H, free):
    """Columns of dense rows at the coordinates, shape (row_count, mode_count)."""
    return H[:, np.searchsorted(free, PLACES)].reshape(len(H), -1)


def cones(surface, x):
    """Volumes of the triangles' cones with their tip in the middle, all counted as positive.

    Of a star-shaped cavity it is the volume; a crumpled one may enclose nothing by chance.
    """
    points = surface.vertices.positions(x)
    return np.abs(np.linalg.det((points - points.mean(axis=0))[surface.triangles])).sum() / 6.0


@pytest.mark.parametrize("amplitude", [1e-4, 1e-2, 0.1, 1.0])
def test_volumes_and_rows_are_those_of_the_triangles(reduced, dense_rows, drawn_rng, amplitude):
    for _ in range(5):
        q = amplitude * drawn_rng.standard_normal(3 * len(PLACES))
        x = on_nodes(reduced.rest, reduced.basis, q)
        volume = reduced.whole.volumes(x)
        scale = cones(reduced.surface, x)
        assert abs(reduced.term.volumes(state(q)) - volume)[0] < 1e-12 * scale
        h, growth = dense_rows(reduced.whole, x, np.arange(len(x)))
        H, own = dense_rows(reduced.term, state(q), reduced.free)
        assert abs(own - growth)[0] < 1e-12 * scale
        projected = np.einsum("kni,nim->km", h, reduced.basis)
        found = by_coordinates(H, reduced.free)
        assert np.abs(found - projected).max() < 1e-12 * np.abs(h).sum()
        # What is no coordinate has no entry.
        assert np.count_nonzero(H) == found.size


def test_rows_are_the_derivative_of_the_volume(reduced, dense_rows, drawn_rng):
    q, step = 0.02 * drawn_rng.standard_normal(9), 1e-5
    H = by_coordinates(dense_rows(reduced.term, state(q), reduced.free)[0], reduced.free)
    for m, change in enumerate(step * np.eye(9)):
        ahead, behind = (reduced.term.volumes(state(q + s * change)) for s in (1.0, -1.0))
        np.testing.assert_allclose(H[:, m], (ahead - behind) / (2 * step), atol=1e-7 * np.abs(H).max())


def test_stiffness_is_minus_the_derivative_of_the_forces_of_pressure(reduced, dense_rows, drawn_rng):
    q, step, pressure = 0.02 * drawn_rng.standard_normal(9), 1e-5, np.array([-1700.0])
    forces = [
        [pressure @ by_coordinates(dense_rows(reduced.term, state(q + s * change), reduced.free)[0],
                                   reduced.free)
         for s in (1.0, -1.0)]
        for change in step * np.eye(9)
    ]  # fmt: skip
    # The state evaluated last is another one.
    reduced.matrix.clear()
    reduced.term.add_stiffness(state(q), pressure, reduced.matrix.storage)
    K = reduced.matrix.matrix().toarray()
    np.testing.assert_array_equal(K, K.T)
    places = (3 * np.searchsorted(reduced.free, PLACES)[:, None] + np.arange(3)).ravel()
    own = K[np.ix_(places, places)]
    assert np.count_nonzero(K) == np.count_nonzero(own) == 81
    slopes = np.array([(ahead - behind) / (2 * step) for ahead, behind in forces])
    np.testing.assert_allclose(own, -slopes, atol=1e-6 * np.abs(own).max())


def test_a_move_is_valid_as_far_as_that_of_the_triangles(reduced, drawn_rng):
    shares = []
    for amplitude in (1e-4, 0.1, 100.0):
        q, move = 1e-4 * drawn_rng.standard_normal(9), np.full((len(reduced.free), 3), 3.0)
        dq = amplitude * drawn_rng.standard_normal(9)
        move[np.searchsorted(reduced.free, PLACES)] = dq.reshape(-1, 3)
        x = on_nodes(reduced.rest, reduced.basis, q)
        expected = reduced.whole.largest_share(x, reduced.basis @ dq)
        shares.append(reduced.term.largest_share(state(q), move))
        assert shares[-1] == expected
    assert shares[0] == 1.0 and shares[-1] < 1.0


def sphere(cuts):
    """An octahedron, cut and blown up to the unit sphere: points and outward triangles."""
    points = np.vstack([np.eye(3), -np.eye(3)])
    triangles = np.array([[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2],
                          [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]])  # fmt: skip
    return cut_on_sphere(points, triangles, cuts)


def balloon(modes, name="air", centre=(0.3, -0.2, 0.5), nodes=(0,)):
    """A sphere of 5 cm whose nodes move in given modes, functions of their place around its
    centre."""
    points, triangles = sphere(2)
    on_points = BarycentricMapping(np.arange(len(points))[:, None], np.ones((len(points), 1)))
    rest = centre + 0.05 * points
    basis = np.stack([mode(points) for mode in modes], axis=2)
    return ReducedWalls((CavitySurface(name, on_points, triangles),), rest, basis, np.array(nodes))


def along(axis):
    return lambda points: np.tile(np.eye(3)[axis], (len(points), 1))


def test_a_mode_that_scales_a_sphere_scales_its_volume_by_the_cube():
    modes = [lambda points: 0.05 * points, along(0), along(2)]
    term = ReducedCavities(["air"], [balloon(modes)], np.array([0]))
    for s in (-0.9, -0.1, 1e-9, 0.5, 10.0):
        volume, exact = term.volumes(np.array([[s, 0.0, 0.0]])), term.rest_volumes * (1.0 + s) ** 3
        # Of a nearly empty one, round-off is that of the volume at rest.
        np.testing.assert_allclose(volume, exact, rtol=1e-13, atol=1e-14 * term.rest_volumes[0])
        blocks, growth = np.empty((1, 3)), np.empty(1)
        term.evaluate(np.array([[s, 0.0, 0.0]]), blocks, growth)
        # No digits of a small growth are lost.
        exact = term.rest_volumes * (3.0 * s + 3.0 * s**2 + s**3)
        np.testing.assert_allclose(growth, exact, rtol=1e-13)


def test_walls_behind_one_valve_sum_up_also_on_several_bodies(dense_rows, drawn_rng):
    first = balloon([along(0), lambda points: points, lambda points: points**3], nodes=[2])
    others = [balloon([lambda points, k=k: points**k for k in range(1, 7)], name, nodes=[1, 4])
              for name in ("air", "oil")]  # fmt: skip
    second = others[0]._replace(surfaces=tuple(own.surfaces[0] for own in others))
    free_index, free = np.array([-1, 0, 1, -1, 2]), np.array([1, 2, 4])
    both = ReducedCavities(["oil", "air"], [first, second], free_index)
    parts = [ReducedCavities([name], [walls], free_index) for name, walls in
             (("oil", others[1]), ("air", first), ("air", others[0]))]  # fmt: skip
    x = 0.02 * drawn_rng.standard_normal((5, 3))
    assert both.row_count == 2 and sorted(map(tuple, both.stencils())) == [(0, 2), (1, -1)]
    H, values = dense_rows(both, x, free)
    (oil, of_oil), (one, of_one), (two, of_two) = (dense_rows(part, x, free) for part in parts)
    np.testing.assert_allclose(H, np.vstack([oil, one + two]), rtol=1e-13, atol=1e-18)
    np.testing.assert_allclose(values, [*of_oil, *(of_one + of_two)], rtol=1e-13)
    # A volume may end near zero: round-off is a share of what was added.
    missed = both.volumes(x) - (both.rest_volumes + values)
    assert (np.abs(missed) <= 1e-14 * (both.rest_volumes + np.abs(values))).all()


def test_walls_that_are_fixed_have_a_volume_and_no_entries():
    still = balloon([lambda points: 0.0 * points] * 3, "still")
    moving = balloon([along(0), lambda points: points, along(1)])
    half = balloon([lambda points: points * (points[:, 2:] > 0.0)] * 3, "half")
    for walls in (still, half):
        np.testing.assert_array_equal(walls.rest_positions, moving.rest_positions)
    names = ["still", "air"]
    joined = ReducedCavities(names, [still, moving._replace(coordinate_nodes=np.array([1]))],
                             np.array([0, 1]))  # fmt: skip
    np.testing.assert_allclose(joined.rest_volumes[0], joined.rest_volumes[1], rtol=1e-15)
    assert joined.entry_rows.tolist() == [1] and joined.entry_nodes.tolist() == [1]
    x = np.array([[3.0, 0.0, 0.0], [0.0, 0.1, 0.0]])
    assert joined.volumes(x)[0] == joined.rest_volumes[0] < joined.volumes(x)[1]
    # Where the lower half is fixed, the volume is that of what the upper one adds.
    term = ReducedCavities(["half"], [half], np.array([0]))
    rest, surface = half.rest_positions, half.surfaces
    full = Cavities(surface, np.arange(len(rest)), rest)
    q = np.array([[0.01, 0.02, -0.005]])
    np.testing.assert_allclose(term.volumes(q), full.volumes(on_nodes(rest, half.basis, q)), rtol=1e-13)
