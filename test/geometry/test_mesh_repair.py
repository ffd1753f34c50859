import numpy as np
import pytest

from softrobot_twin.geometry.mesh_repair import (
    coincident_pairs,
    component_labels,
    drop_unused_nodes,
    enclose_volume,
    first_of_duplicates,
    orient_tets,
)
from softrobot_twin.geometry.tet_mesh import tet_volumes

pytestmark = pytest.mark.libraries

CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0]], float)


def test_inverted_tets_are_reoriented_and_listed(block):
    mesh = block()
    tets = mesh.cells.copy()
    tets[[3, 17]] = tets[[3, 17]][:, [1, 0, 2, 3]]
    mended, inverted = orient_tets(mesh.node_positions, tets)
    assert inverted.tolist() == [3, 17]
    np.testing.assert_allclose(tet_volumes(mesh.node_positions, mended), mesh.volumes)
    assert tets[3].tolist() != mended[3].tolist()


def test_flat_and_collapsed_tets_enclose_no_volume():
    tets = np.array([[0, 1, 2, 4], [0, 1, 2, 3], [0, 1, 1, 3], [0, 2, 1, 3]])
    assert enclose_volume(CORNERS, tets).tolist() == [False, True, False, True]


def test_flatness_does_not_depend_on_size():
    thin = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0.3, 0.3, 1e-6]])
    for scale in (1e-6, 1.0, 1e6):
        assert enclose_volume(scale * thin, np.array([[0, 1, 2, 3]])).all()


def test_unused_nodes_are_dropped_and_both_translations_kept():
    positions = np.vstack([[9.0, 9, 9], CORNERS[:2], [8.0, 8, 8], CORNERS[2:4]])
    renumbered = drop_unused_nodes(positions, np.array([[1, 2, 4, 5]]))
    assert renumbered.old_indices.tolist() == [1, 2, 4, 5]
    assert renumbered.new_indices.tolist() == [-1, 0, 1, -1, 2, 3]
    assert renumbered.tets.tolist() == [[0, 1, 2, 3]]
    np.testing.assert_array_equal(renumbered.node_positions, CORNERS[:4])


def test_coincident_nodes_are_found_and_replaced_by_the_first():
    positions = np.vstack([CORNERS, CORNERS[1] + 1e-9, CORNERS[1] - 1e-9])
    assert first_of_duplicates(positions, 1e-8).tolist() == [0, 1, 2, 3, 4, 1, 1]
    assert first_of_duplicates(positions, 0.0).tolist() == list(range(7))
    pairs = coincident_pairs(positions, 2e-9)
    assert {tuple(sorted(pair)) for pair in pairs.tolist()} == {(1, 5), (1, 6)}


def test_connected_components_are_labelled():
    labels = component_labels(np.array([[0, 1, 2, 3], [4, 5, 6, 7], [6, 7, 8, 9]]), 10)
    assert labels.tolist() == [0] * 4 + [1] * 6
