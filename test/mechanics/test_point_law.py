"""Laws and elements: those of the package, and those that a user defines outside of it."""

from typing import NamedTuple

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from softrobot_twin.geometry.matrix3 import (
    IDENTITY,
    add_scaled_matrix,
    inner,
    plus_identity,
    product,
    scaled_matrix,
    symmetric,
    trace,
    transposed_product,
)
from softrobot_twin.geometry.quadratic_mesh import add_mid_edge_nodes
from softrobot_twin.kernels.compilation import INLINED, KERNEL, njit
from softrobot_twin.mechanics.element_assembly import assembly_of
from softrobot_twin.mechanics.laws import law_named
from softrobot_twin.mechanics.point_law import register_law, stress
from softrobot_twin.scene import scene_from_mapping
from test.builder import each_of

YOUNG, POISSON = 2.0e5, 0.35


class FromOutside(NamedTuple):
    """A law from outside, as simple as can be, which the package has too: that of St. Venant and
    Kirchhoff, Ψ = µ E:E + λ/2 tr²(E), E = (FᵀF - 1)/2.
    """

    lame_lambda: float
    shear_modulus: float


@njit(**INLINED)
def second_piola(law, strain):
    """S = 2µ E + λ tr(E) 1."""
    pressure = law.lame_lambda * trace(strain)
    return add_scaled_matrix(scaled_matrix(strain, 2.0 * law.shear_modulus), IDENTITY, pressure)


@njit(**INLINED)
def green_strain(F):
    """E = (FᵀF - 1)/2."""
    return scaled_matrix(plus_identity(transposed_product(F, F), -1.0), 0.5)


@njit(**KERNEL, forceinline=True)
def outside_energy(law, F):
    strain = green_strain(F)
    return 0.5 * inner(second_piola(law, strain), strain)


@njit(**KERNEL, forceinline=True)
def outside_stress(law, F):
    return product(F, second_piola(law, green_strain(F)))


@njit(**KERNEL, forceinline=True)
def outside_differential(law, F, dF):
    change = second_piola(law, symmetric(transposed_product(F, dF)))
    turned = product(dF, second_piola(law, green_strain(F)))
    return add_scaled_matrix(turned, product(F, change), 1.0)


register_law("from_outside", FromOutside, outside_energy, outside_stress, outside_differential)

LAWS = (
    "corotational", "linear", "neo_hookean", "saint_venant_kirchhoff", "from_outside",
    "mooney_rivlin", "yeoh", "ogden",
)  # fmt: skip


@pytest.fixture(params=["linear", "quadratic"])
def mesh(request, block):
    linear = block(cells=(1, 1, 1))
    return linear if request.param == "linear" else add_mid_edge_nodes(linear)


law = each_of(LAWS)


@pytest.fixture
def body(mesh, law, bind):
    """A body of every element and every law; its first two nodes are held."""
    return mesh, bind((law, mesh, YOUNG, POISSON), fixed=[0, 1])


def deformed(mesh, amount=0.003, seed=0):
    """Stretched, turned and shaken."""
    turn = Rotation.from_rotvec([0.3, -0.2, 0.4]).as_matrix()
    shaken = amount * np.random.default_rng(seed).standard_normal(mesh.node_positions.shape)
    return (mesh.node_positions * [1.1, 0.95, 1.05]) @ turn.T + shaken


@pytest.mark.sampled
def test_forces_and_stiffness_are_the_slopes_of_the_energy(body):
    mesh, bound = body
    x = deformed(mesh)
    forces, K = bound.assemble(x)
    # First with what the forces left, then without.
    np.testing.assert_array_equal(bound.forces(x)[0], forces)
    np.testing.assert_array_equal(bound.assemble(x)[1].toarray(), K.toarray())
    bound.assert_slopes(x, bar=(1e-7, 1e-7))


def test_the_projected_stiffness_has_no_negative_curvature_and_is_exact_where_none_is(body, law):
    mesh, bound = body
    pressed = mesh.node_positions * [0.5, 1.0, 0.7]
    least = bound.least_curvatures(pressed)
    if law != "linear":
        assert least[0] < -1e-3
    assert least[1] > -1e-12
    x = 1.1 * mesh.node_positions
    exact = bound.assemble(x)[1].toarray()
    projected = bound.assemble(x, projected=True)[1].toarray()
    np.testing.assert_allclose(projected, exact, atol=1e-12 * np.abs(exact).max())


def density_of(law, parameters, F):
    """The energy per volume, written with numpy."""
    J, C = np.linalg.det(F), F.T @ F
    volumetric = 0.25 * (J**2 - 1.0 - 2.0 * np.log(J))
    first = J ** (-2.0 / 3.0) * np.trace(C) - 3.0
    second = J ** (-4.0 / 3.0) * 0.5 * (np.trace(C) ** 2 - np.trace(C @ C)) - 3.0
    if law == "neo_hookean":
        return 0.5 * parameters.shear_modulus * first + parameters.bulk_modulus * volumetric
    if law == "yeoh":
        c1, c2, c3, bulk = parameters
        return c1 * first + c2 * first**2 + c3 * first**3 + bulk * volumetric
    if law == "mooney_rivlin":
        c10, c01, bulk = parameters
        return c10 * first + c01 * second + bulk * volumetric
    if law == "ogden":
        stretches = np.linalg.svd(F, compute_uv=False) * J ** (-1.0 / 3.0)
        shape = sum(
            shear / exponent * (np.sum(stretches**exponent) - 3.0)
            for shear, exponent in zip(parameters.shear_moduli, parameters.exponents)
        )
        return shape + parameters.bulk_modulus * volumetric
    lame, shear = parameters
    is_green = law in ("saint_venant_kirchhoff", "from_outside")
    strain = 0.5 * (C - np.eye(3)) if is_green else F - np.eye(3)
    return shear * np.sum(strain**2) + 0.5 * lame * np.trace(strain) ** 2


def test_uniform_strain_stores_the_energy_of_its_law(mesh, law, bind, parameters_of):
    parameters = parameters_of(law, YOUNG, POISSON)
    bound = bind((law, mesh, YOUNG, POISSON))
    F = np.array([[1.02, 0.01, 0.0], [0.01, 0.97, 0.02], [0.0, 0.02, 1.01]])
    volume = bound.terms[0].energy(mesh.node_positions @ F.T) / density_of(law, parameters, F)
    assert volume == pytest.approx(mesh.volume)


def test_inverted_elements_are_counted_for_every_law_and_element(body):
    mesh, bound = body
    assert bound.forces(deformed(mesh))[1] == 0
    assert bound.forces(mesh.node_positions * [1.0, 1.0, -0.5])[1] == len(mesh.cells)


def point_answers(law, parameters, F, dF):
    """All kernels of a law at a point."""
    kernels = law_named(law)
    own = kernels.linearize
    at_point = F if own is None else own(parameters, F, True, False)
    return (kernels.energy_density(parameters, F), kernels.stress(parameters, F),
            kernels.differential(parameters, at_point, dF))  # fmt: skip


def rows(matrix):
    return tuple(tuple(float(entry) for entry in row) for row in matrix)


def test_at_a_point_stress_and_differential_are_the_derivatives_of_the_energy(law, parameters_of):
    parameters = parameters_of(law, YOUNG, POISSON)
    rng = np.random.default_rng(1)
    # A law that turns sees a symmetric stretch, and changes of it.
    shake = 0.1 * rng.standard_normal((2, 3, 3))
    if law_named(law).turns:
        shake = shake + shake.transpose(0, 2, 1)
    F, dF, step = np.eye(3) + shake[0], shake[1], 1e-5
    _, P, dP = point_answers(law, parameters, rows(F), rows(dF))
    ahead, behind = (
        point_answers(law, parameters, rows(F + sign * step * dF), rows(dF)) for sign in (1.0, -1.0)
    )
    slope = (ahead[0] - behind[0]) / (2.0 * step)
    assert np.sum(np.array(P) * dF) == pytest.approx(slope, rel=1e-7)
    change = (np.array(ahead[1]) - np.array(behind[1])) / (2.0 * step)
    np.testing.assert_allclose(np.array(dP), change, atol=1e-6 * np.abs(change).max())


def test_a_scene_may_name_a_law_from_outside(tmp_path):
    mapping = {
        "name": "outside",
        "body": {
            "mesh": {"file": "body.vtk"},
            "material": {
                "law": "from_outside", "young_modulus": 1e5, "poisson_ratio": 0.3,
                "density": 1000.0,
            },
        }
    }  # fmt: skip
    scene = scene_from_mapping(mapping, tmp_path / "scene.yaml")
    assert scene.body.material.law == "from_outside"


def test_only_laws_of_the_package_are_kept_on_disk():
    """numba would not notice a change in the file of a law from outside."""
    assert assembly_of(FromOutside).add_forces.stats.cache_path is None
    assert assembly_of(law_named("corotational").parameters).add_forces.stats.cache_path


def test_a_law_is_registered_only_once():
    with pytest.raises(ValueError, match="registered already"):
        register_law("linear", tuple, stress, stress, stress)
    with pytest.raises(KeyError, match="rubber.*corotational"):
        law_named("rubber")
