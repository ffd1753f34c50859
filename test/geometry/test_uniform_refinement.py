from pathlib import Path

import numpy as np
import pytest

from softrobot_twin.geometry.mesh_reading import read_solid_mesh
from softrobot_twin.geometry.quality import radius_ratios
from softrobot_twin.geometry.surface import boundary_triangles
from softrobot_twin.geometry.uniform_refinement import refine

MESH = Path(__file__).resolve().parents[2] / "meshes" / "diamond_400.vtk"


@pytest.fixture(scope="module")
def coarse():
    return read_solid_mesh(MESH).mesh


def test_refining_makes_eight_of_one_and_keeps_the_volume(coarse):
    fine, _ = refine(coarse)
    assert fine.cell_count == 8 * coarse.cell_count
    assert fine.volume == pytest.approx(coarse.volume, rel=1e-12)


def test_refined_neighbours_share_whole_faces(coarse):
    fine, _ = refine(coarse)
    # A face of only one tetrahedron would count as surface.
    assert len(boundary_triangles(fine.cells)) == 4 * len(boundary_triangles(coarse.cells))


def test_old_nodes_keep_their_numbers_and_new_ones_lie_between_two(coarse):
    fine, ends = refine(coarse)
    count = coarse.node_count
    np.testing.assert_array_equal(fine.node_positions[:count], coarse.node_positions)
    middles = coarse.node_positions[ends].mean(axis=1)
    np.testing.assert_allclose(fine.node_positions[count:], middles, atol=1e-15)


def test_quality_is_bounded_under_repeated_refinement(coarse):
    once, _ = refine(coarse)
    twice, _ = refine(once)
    assert radius_ratios(twice).min() > 0.5 * radius_ratios(once).min()
