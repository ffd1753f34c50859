import numpy as np
import pytest
from numpy.linalg import norm

from softrobot_twin.geometry.box_tree import box_tree, near_items, nearest_distances
from softrobot_twin.geometry.hexahedral_mesh import HexahedralMesh
from softrobot_twin.geometry.point_location import closest_on_triangles, locate_points
from softrobot_twin.geometry.tet_mesh import TetMesh


def uneven(random, count):
    """Triangles whose sizes differ by a factor of ten thousand, some as thin as a needle."""
    sizes = 10.0 ** random.uniform(-4, 0, (count, 1, 1))
    corners = random.normal(size=(count, 1, 3)) + sizes * random.normal(size=(count, 3, 3))
    corners[::5, 2] = corners[::5, 1] + 1e-3 * (corners[::5, 2] - corners[::5, 1])
    return corners


def distances_from_all(corners, points):
    """Distance of each point from each triangle, shape (point_count, triangle_count)."""
    found = np.empty((len(points), len(corners)))
    for index, point in enumerate(points):
        asked = np.broadcast_to(point, (len(corners), 3))
        nearest = np.einsum("tc,tci->ti", closest_on_triangles(asked, corners), corners)
        found[index] = np.linalg.norm(nearest - point, axis=1)
    return found


@pytest.mark.parametrize("count", [1, 2, 3, 300])
def test_the_nearest_of_large_and_small_triangles_is_that_of_all(drawn_rng, count):
    corners = uneven(drawn_rng, count)
    points = np.concatenate([3.0 * drawn_rng.normal(size=(50, 3)), corners[:5].mean(axis=1)])
    found = nearest_distances(box_tree(corners), corners, points)
    nearest = distances_from_all(corners, points).min(axis=1)
    np.testing.assert_allclose(found, nearest, rtol=1e-9, atol=1e-9)


def test_a_point_in_a_needle_is_in_it_up_to_round_off_by_length_over_width(drawn_rng):
    """The weights of a triangle's corners are off by eps times that ratio, not by its square."""
    for aspect in 10.0 ** drawn_rng.uniform(0, 7, 100):
        corners = uneven(drawn_rng, 2)[1:]
        corners[0, 2] = corners[0, 1] + (corners[0, 2] - corners[0, 1]) / aspect
        u, v = corners[0, 1:] - corners[0, 0]
        size, doubled_area = norm(u) + norm(v), norm(np.cross(u, v))
        points = drawn_rng.dirichlet(np.ones(3), 20) @ corners[0]
        away = nearest_distances(box_tree(corners), corners, points)
        furthest = norm(corners[0], axis=1).max()
        assert (away <= 4.0 * np.finfo(float).eps * (furthest + size**3 / doubled_area)).all(), aspect


def test_every_item_whose_box_is_within_reach_is_found_once(drawn_rng):
    corners, points = uneven(drawn_rng, 200), 2.0 * drawn_rng.normal(size=(60, 3))
    reaches = np.where(drawn_rng.random(60) < 0.5, 0.0, drawn_rng.random(60))
    owner, items = near_items(box_tree(corners), points, reaches)
    low, high = corners.min(axis=1), corners.max(axis=1)
    away = np.maximum(np.maximum(low - points[:, None], points[:, None] - high), 0.0)
    least = np.linalg.norm(away, axis=2)
    found = np.zeros(least.shape, int)
    np.add.at(found, (owner, items), 1)
    assert (np.diff(owner) >= 0).all()
    assert found.max() == 1
    assert found[least < reaches[:, None]].all()
    # Boxes are a little larger than their items.
    assert (least[found == 1] <= reaches[owner[np.lexsort([items, owner])]] + 1e-5).all()


def test_items_at_one_place_are_all_found():
    corners = np.ones((7, 3, 3))
    owner, items = near_items(box_tree(corners), np.ones((2, 3)), np.zeros(2))
    assert owner.tolist() == [0] * 7 + [1] * 7
    assert sorted(items[:7].tolist()) == sorted(items[7:].tolist()) == list(range(7))


def needles(random, hexahedra):
    """A grid whose layers are 1 µm to 1 m thick, as tetrahedra or hexahedra."""
    lines = [np.cumsum([0.0, *(10.0 ** random.uniform(-6, 0, 5))]) for _ in range(3)]
    nodes = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 3)
    i, j, k = (index.ravel() for index in np.meshgrid(*[np.arange(5)] * 3, indexing="ij"))
    low = (i * 6 + j) * 6 + k
    corner = {(a, b, c): low + (a * 6 + b) * 6 + c for a in (0, 1) for b in (0, 1) for c in (0, 1)}
    if hexahedra:
        order = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)]
        cells = np.stack([corner[key] for key in order], axis=1)
        return HexahedralMesh(nodes, np.empty((0, 4), np.int64), cells)
    tets = []
    for path in ((0, 1, 2), (1, 2, 0), (2, 0, 1), (0, 2, 1), (2, 1, 0), (1, 0, 2)):
        place, own = [0, 0, 0], [corner[0, 0, 0]]
        for axis in path:
            place[axis] = 1
            own.append(corner[tuple(place)])
        if path in ((0, 2, 1), (2, 1, 0), (1, 0, 2)):
            own[2], own[3] = own[3], own[2]
        tets.append(np.stack(own, axis=1))
    return TetMesh(nodes, np.concatenate(tets))


@pytest.mark.parametrize("hexahedra", [False, True])
def test_points_are_located_in_a_mesh_of_large_and_small_cells(drawn_rng, hexahedra):
    mesh = needles(drawn_rng, hexahedra)
    low, high = mesh.node_positions.min(axis=0), mesh.node_positions.max(axis=0)
    points = low + drawn_rng.uniform(-0.3, 1.3, (200, 3)) * (high - low)
    found = locate_points(mesh, points)
    nearest = np.clip(points, low, high)
    away = np.linalg.norm(points - nearest, axis=1)
    np.testing.assert_allclose(found.distances, away, atol=1e-9)
    on_mesh = np.einsum("pn,pni->pi", found.barycentric_weights, mesh.node_positions[found.nodes])
    np.testing.assert_allclose(on_mesh, nearest, atol=1e-6 * (high - low).max())
