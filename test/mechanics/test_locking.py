"""Row 1 of the hard cases: a cantilever of nearly incompressible stuff against beam theory."""

import numpy as np
import pytest

from softrobot_twin.geometry.quadratic_mesh import add_mid_edge_nodes
from test.builder import builder

LENGTH, DEPTH, YOUNG, LOAD = 1.0, 0.05, 1.0e6, 1.0e-4
POISSONS = (0.3, 0.45, 0.49, 0.499)


def timoshenko(poisson):
    """PL³/3EI + PL/κGA of a square section, κ after Cowper."""
    shear = YOUNG / (2 * (1 + poisson))
    kappa = 10 * (1 + poisson) / (12 + 11 * poisson)
    bending = LOAD * LENGTH**3 / (3 * YOUNG * DEPTH**4 / 12)
    return bending + LOAD * LENGTH / (kappa * shear * DEPTH**2)


def end_load(mesh):
    """A uniform shear traction on the free end: forces on the nodes, shape (node_count, 3)."""
    triangles = mesh.surface_triangles
    on_end = np.all(mesh.node_positions[triangles, 0] > LENGTH - 1e-9, axis=1)
    a, b, c = mesh.node_positions[triangles[on_end]].transpose(1, 0, 2)
    areas = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
    if mesh.mid_edge_ends.size:
        # A six-node face carries its load at the middle of its edges, a third each; the last of
        # its four triangles is the one between them.
        triangles, areas = triangles[on_end].reshape(-1, 4, 3)[:, 3], 4 * areas[::4]
    else:
        triangles = triangles[on_end]
    forces = np.zeros((mesh.node_count, 3))
    np.add.at(forces[:, 2], triangles, np.repeat(areas[:, None] / 3, 3, axis=1))
    return LOAD / DEPTH**2 * forces


@builder
def deflection(block, bind, /, element, poisson, cells):
    """Deflection of the end under the load, over beam theory's."""
    linear = block(size=(LENGTH, DEPTH, DEPTH), cells=cells, shake=0)
    mesh = linear if element == "linear" else add_mid_edge_nodes(linear)
    fixed = np.flatnonzero(mesh.node_positions[:, 0] < 1e-9)
    bound = bind(("corotational", mesh, YOUNG, poisson), fixed=fixed)
    forces = end_load(mesh)
    assert forces[:, 2].sum() == pytest.approx(LOAD)
    bound.assemble(mesh.node_positions)
    assert bound.matrix.factor()
    u = bound.matrix.solve(forces[bound.free])
    # The work of the load is that of its mean displacement.
    return np.sum(u * forces[bound.free]) / LOAD / timoshenko(poisson)


def test_quadratic_tets_do_not_lock_on_a_coarse_mesh(deflection):
    for poisson in (*POISSONS, 0.49999):
        assert deflection("quadratic", poisson, (40, 2, 2)) == pytest.approx(1.0, abs=0.03)


def test_linear_tets_lock_more_the_nearer_poissons_ratio_is_to_a_half(deflection):
    reached = [deflection("linear", poisson, (40, 2, 2)) for poisson in POISSONS]
    assert np.all(np.diff(reached) < 0.0)
    assert reached[0] < 0.9 and reached[-1] < 0.1


def test_refining_brings_both_elements_to_beam_theory(deflection):
    for element, first, second in (
        ("linear", (20, 1, 1), (40, 2, 2)),
        ("quadratic", (10, 1, 1), (20, 1, 1)),
    ):
        coarse, fine = (1.0 - deflection(element, 0.3, cells) for cells in (first, second))
        assert 0.0 < fine < 0.7 * coarse
