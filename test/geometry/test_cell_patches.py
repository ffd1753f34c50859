"""Patches of tetrahedra: they cover a mesh once, each is connected, and few are small."""

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from softrobot_twin.geometry.cell_patches import grow_patches, neighbours_of


@pytest.fixture(params=["block", "diamond"])
def tets(request, block, kept_mesh):
    if request.param == "block":
        return block((0.2, 0.3, 0.4), (4, 5, 6)).cells
    return kept_mesh("diamond_1600").cells


def pieces_of(behind, cells):
    """Number of connected pieces of some cells."""
    place = np.full(len(behind), -1)
    place[cells] = np.arange(len(cells))
    rows, columns = np.repeat(np.arange(len(cells)), 4), place[behind[cells]].ravel()
    inside = (behind[cells].ravel() >= 0) & (columns >= 0)
    graph = coo_array((np.ones(inside.sum()), (rows[inside], columns[inside])),
                      shape=(len(cells), len(cells)))  # fmt: skip
    return connected_components(graph, directed=False)[0]


@pytest.mark.parametrize("size", [2, 12])
def test_patches_are_connected_and_nearly_all_of_the_size_asked_for(tets, size):
    patch = grow_patches(tets, size)
    behind = neighbours_of(tets)
    sizes = np.bincount(patch)
    assert patch.min() == 0 and sizes.sum() == len(tets)
    assert all(pieces_of(behind, np.flatnonzero(patch == k)) == 1 for k in range(len(sizes)))
    assert sizes.min() > size / 2 and np.median(sizes) == size
    assert sizes.max() <= 2.5 * size


def test_neighbours_share_three_corners(tets):
    behind = neighbours_of(tets)
    cell, face = np.nonzero(behind >= 0)
    for k, f in zip(cell[::97], face[::97], strict=True):
        assert len(set(tets[k]) & set(tets[behind[k, f]])) == 3
        assert k in behind[behind[k, f]]


def test_a_patch_of_linear_tetrahedra_has_few_nodes(tets):
    """Few nodes a patch are few blocks of stiffness: a chain of 12 cells would have 15."""
    patch = grow_patches(tets, 12)
    counts = [len(np.unique(tets[patch == k])) for k in range(patch.max() + 1)]
    assert np.mean(counts) < 13.5


def test_a_single_cell_is_a_patch():
    assert grow_patches(np.array([[0, 1, 2, 3]]), 12).tolist() == [0]
    assert grow_patches(np.array([[0, 1, 2, 3], [4, 5, 6, 7]]), 12).tolist() == [0, 1]
