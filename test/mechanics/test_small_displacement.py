"""Facts of the linear law."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from softrobot_twin.geometry.quadratic_mesh import add_mid_edge_nodes

YOUNG, POISSON = 2.0e5, 0.4


@pytest.fixture(params=["linear", "quadratic"])
def body(request, block, bind):
    """A box under the linear law and one under the corotational, some nodes fixed."""
    mesh = block(cells=(1, 2, 2))
    mesh = mesh if request.param == "linear" else add_mid_edge_nodes(mesh)
    laws = ("linear", "corotational")
    return mesh, *(bind((law, mesh, YOUNG, POISSON), fixed=[0, 3, 4, 9]) for law in laws)


def displaced(mesh, amount=0.02):
    rng = np.random.default_rng(0)
    return mesh.node_positions + amount * rng.standard_normal((mesh.node_count, 3))


def test_the_stiffness_is_the_corotational_one_at_rest_in_every_shape(body):
    mesh, linear, corotational = body
    expected = corotational.assemble(mesh.node_positions)[1].toarray()
    for x in (mesh.node_positions, displaced(mesh)):
        K = linear.assemble(x)[1].toarray()
        np.testing.assert_allclose(K, expected, atol=1e-12 * np.abs(expected).max())


def test_force_is_the_stiffness_times_the_displacement(body):
    mesh, linear, _ = body
    x = displaced(mesh)
    fixed = np.setdiff1d(np.arange(mesh.node_count), linear.free)
    x[fixed] = mesh.node_positions[fixed]
    forces, K = linear.assemble(x)
    u = (x - mesh.node_positions)[linear.free].ravel()
    np.testing.assert_allclose(forces.ravel(), -(K @ u), atol=1e-12 * np.abs(forces).max())
    assert linear.terms[0].energy(x) == pytest.approx(0.5 * u @ K @ u)


def test_the_force_depends_on_the_displacement_of_fixed_nodes(body):
    mesh, linear, _ = body
    moved = mesh.node_positions + [0.3, -0.1, 0.2]
    scale = YOUNG * 0.1
    assert np.abs(linear.forces(moved)[0]).max() < 1e-12 * scale


def test_a_rotated_body_has_the_strain_cosine_minus_one(body):
    mesh, linear, _ = body
    angle = np.radians(30.0)
    turned = Rotation.from_rotvec([0.0, 0.0, angle]).apply(mesh.node_positions)
    lame, shear = linear.terms[0].law
    shrink = np.cos(angle) - 1.0
    density = shear * 2 * shrink**2 + 0.5 * lame * (2 * shrink) ** 2
    assert linear.terms[0].energy(turned) == pytest.approx(density * mesh.volume)


def test_inverted_elements_are_counted(body):
    mesh, linear, _ = body
    assert linear.forces(mesh.node_positions)[1] == 0
    assert linear.forces(mesh.node_positions * [1.0, -0.1, 1.0])[1] == mesh.cell_count
