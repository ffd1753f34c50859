import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from softrobot_twin.geometry.regions import nodes_in_box, nodes_in_sphere

GRID = np.stack(np.meshgrid(*[np.linspace(0, 0.2, 5)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)


def test_a_box_holds_the_nodes_inside_and_on_its_faces():
    nodes = nodes_in_box(GRID, (0.05, 0.05, -1), (0.1, 0.1, 0.0))
    np.testing.assert_allclose(
        GRID[nodes], [[x, y, 0] for x in (0.05, 0.1) for y in (0.05, 0.1)], atol=1e-15
    )
    assert nodes.dtype == np.int64
    assert (np.diff(nodes) > 0).all()


def test_a_face_met_only_in_single_precision_still_holds_its_nodes():
    rounded = GRID.astype(np.float32).astype(np.float64)
    assert len(nodes_in_box(rounded, (0, 0, 0), (0.1, 0.15, 0.2))) == 3 * 4 * 5
    assert len(nodes_in_box(GRID, (0, 0, 0), (0.1 - 1e-5, 0.15, 0.2))) == 2 * 4 * 5


def test_a_sphere_holds_the_nodes_inside_and_on_its_surface():
    nodes = nodes_in_sphere(GRID, (0.1, 0.1, 0.1), 0.05)
    np.testing.assert_allclose(np.linalg.norm(GRID[nodes] - 0.1, axis=1).max(), 0.05)
    assert len(nodes) == 7


def test_a_region_beside_the_body_holds_no_nodes():
    assert len(nodes_in_box(GRID, (1, 1, 1), (2, 2, 2))) == 0
    assert len(nodes_in_sphere(GRID, (1, 1, 1), 0.1)) == 0


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("size", [1e-3, 0.2, 10.0])
def test_a_box_holds_the_same_nodes_however_its_body_was_turned_and_moved(size, seed):
    random = np.random.default_rng(seed)
    mesh = size * GRID / 0.2
    low, high = (0.0, 0.0, 0.0), (0.5 * size, 0.75 * size, 0.25 * size)
    turn = Rotation.random(random_state=seed)
    shift = random.uniform(-10.0, 10.0, 3) * size
    there = turn.apply(mesh) + shift
    back = turn.inv().apply(there - shift)
    assert np.abs(back - mesh).max() > 0.0
    asked = nodes_in_box(mesh, low, high)
    assert len(asked) == 3 * 4 * 2
    np.testing.assert_array_equal(nodes_in_box(back, low, high), asked)
    np.testing.assert_array_equal(nodes_in_box(mesh + shift, low + shift, high + shift), asked)


def test_a_node_just_outside_a_face_is_not_in_the_box():
    beside = GRID.copy()
    beside[np.isclose(beside[:, 2], 0.2), 2] += 2e-7  # a body of 0.35 m, written in seven digits
    assert len(nodes_in_box(beside, (0, 0, 0.2), (1, 1, 0.2))) == 0
    assert len(nodes_in_box(GRID, (0, 0, 0.2), (1, 1, 0.2))) == 25
