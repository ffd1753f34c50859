"""Row 7 of the hard cases: one to a million in one body."""

from dataclasses import replace

import numpy as np
import pytest

from softrobot_twin.geometry.quadratic_mesh import add_mid_edge_nodes
from softrobot_twin.geometry.tet_mesh import TetMesh
from softrobot_twin.mechanics.inertia import borne_masses

SOFT, STIFF = 1.0e4, 1.0e10


def part(mesh, chosen):
    """Some of a mesh's tetrahedra, over all its nodes."""
    corner_mesh = TetMesh(mesh.corner_mesh.node_positions, mesh.corner_mesh.cells[chosen])
    if isinstance(mesh, TetMesh):
        return corner_mesh
    return replace(mesh, corner_mesh=corner_mesh, cells=mesh.cells[chosen])


def settle(bound, mesh, load):
    """Newton's method; gives the positions and the last residual."""
    x = mesh.node_positions.copy()
    for _ in range(30):
        forces, _ = bound.assemble(x)
        forces += load[bound.free]
        residual = np.abs(forces).max()
        if residual < 1e-9:
            break
        assert bound.matrix.factor()
        x[bound.free] += bound.matrix.solve(forces)
    return x, residual


@pytest.mark.parametrize("element", ["linear", "quadratic"])
def test_a_part_a_million_times_stiffer_acts_like_a_fixed_part(block, bind, element):
    linear = block(size=(0.1, 0.02, 0.02), cells=(6, 2, 2), shake=0)
    mesh = linear if element == "linear" else add_mid_edge_nodes(linear)
    x = mesh.node_positions
    stiff = x[mesh.cells[:, :4], 0].max(axis=1) < 0.0501
    assert 0 < stiff.sum() < mesh.cell_count
    load = np.outer(borne_masses(mesh, 1000.0), [0.0, 0.0, -9.81])
    both = bind(
        ("corotational", part(mesh, ~stiff), SOFT, 0.4),
        ("corotational", part(mesh, stiff), STIFF, 0.4),
        fixed=np.flatnonzero(x[:, 0] < 1e-9),
    )
    reached, residual = settle(both, mesh, load)
    assert residual < 1e-6 * np.abs(load).sum()
    held = bind(("corotational", part(mesh, ~stiff), SOFT, 0.4), fixed=np.unique(mesh.cells[stiff]))
    expected, _ = settle(held, mesh, load)
    sag = np.abs(expected - x).max()
    assert sag > 1e-3
    assert np.abs(reached - expected).max() < 1e-4 * sag
