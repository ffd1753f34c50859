"""Laws of rubber at one point: symmetries, closed forms, equal stretches, points inside out."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from softrobot_twin.mechanics.laws import law_named
from softrobot_twin.mechanics.material import bulk_modulus, shear_modulus
from softrobot_twin.mechanics.principal_axes import (
    positive_part,
    principal_axes,
    symmetric_eigenvalues,
)
from test.builder import each_of

YOUNG, POISSON = 1.0e5, 0.45
SHEAR, BULK = shear_modulus(YOUNG, POISSON), bulk_modulus(YOUNG, POISSON)
C10, C01 = 0.35 * SHEAR, 0.15 * SHEAR
C1, C2, C3 = 0.5 * SHEAR, -0.02 * SHEAR, 0.01 * SHEAR
# Three terms everywhere, other tests have two: each number of terms is compiled anew.
MODULI, EXPONENTS = (0.8 * SHEAR, -0.2 * SHEAR, 0.02 * SHEAR), (1.5, -3.6, 4.0)
OGDEN_SHEAR = 0.5 * sum(modulus * exponent for modulus, exponent in zip(MODULI, EXPONENTS))
PARAMETERS = {
    "neo_hookean": law_named("neo_hookean").of_moduli(YOUNG, POISSON),
    "mooney_rivlin": law_named("mooney_rivlin").own.parameters({"c10": C10, "c01": C01}, BULK),
    "yeoh": law_named("yeoh").own.parameters({"c1": C1, "c2": C2, "c3": C3}, BULK),
    "ogden": law_named("ogden").own.parameters(
        {"shear_moduli": MODULI, "exponents": EXPONENTS}, BULK
    ),
    "saint_venant_kirchhoff": law_named("saint_venant_kirchhoff").of_moduli(YOUNG, POISSON),
}
RUBBER = ("neo_hookean", "mooney_rivlin", "yeoh", "ogden")


law = each_of(PARAMETERS)


def rows(matrix):
    return tuple(tuple(float(entry) for entry in row) for row in matrix)


def energy(law, F):
    return law_named(law).energy_density(PARAMETERS[law], rows(F))


def stress(law, F):
    return np.array(law_named(law).stress(PARAMETERS[law], rows(F)))


def differential(law, F, dF, projected=False):
    kernels, parameters = law_named(law), PARAMETERS[law]
    at_point = kernels.linearize(parameters, rows(F), True, projected)
    return np.array(kernels.differential(parameters, at_point, rows(dF)))


def turned(drawn_rng):
    return Rotation.from_quat(drawn_rng.standard_normal(4)).as_matrix()


def strained(drawn_rng):
    """A deformation gradient with det F > 0."""
    stretches = drawn_rng.uniform(0.6, 1.6, 3)
    return turned(drawn_rng) @ np.diag(stretches) @ turned(drawn_rng)


def test_at_rest_a_law_is_hookes(law, drawn_rng):
    identity = np.eye(3)
    assert energy(law, identity) == pytest.approx(0.0, abs=1e-10 * YOUNG)
    np.testing.assert_allclose(stress(law, identity), 0.0, atol=1e-10 * YOUNG)
    dF = drawn_rng.standard_normal((3, 3))
    strain = 0.5 * (dF + dF.T)
    mu = OGDEN_SHEAR if law == "ogden" else SHEAR
    hooke = 2.0 * mu * strain + (BULK - 2.0 * mu / 3.0) * np.trace(strain) * identity
    np.testing.assert_allclose(differential(law, identity, dF), hooke, atol=1e-10 * YOUNG)


def test_a_law_is_objective_and_isotropic(law, drawn_rng):
    F, Q = strained(drawn_rng), turned(drawn_rng)
    P = stress(law, F)
    size = np.abs(P).max() + YOUNG
    assert energy(law, Q @ F) == pytest.approx(energy(law, F), abs=1e-10 * size)
    assert energy(law, F @ Q) == pytest.approx(energy(law, F), abs=1e-10 * size)
    np.testing.assert_allclose(stress(law, Q @ F), Q @ P, atol=1e-10 * size)
    np.testing.assert_allclose(stress(law, F @ Q), P @ Q, atol=1e-10 * size)


def test_stress_and_differential_are_derivatives_of_the_energy(law, drawn_rng):
    F, dF, step = strained(drawn_rng), drawn_rng.standard_normal((3, 3)), 1e-5
    slope = (energy(law, F + step * dF) - energy(law, F - step * dF)) / (2.0 * step)
    size = np.abs(stress(law, F)).max() + YOUNG
    assert np.sum(stress(law, F) * dF) == pytest.approx(slope, abs=1e-6 * size)
    change = (stress(law, F + step * dF) - stress(law, F - step * dF)) / (2.0 * step)
    np.testing.assert_allclose(differential(law, F, dF), change, atol=1e-6 * np.abs(change).max())


def nominal(law, x, kind):
    """The closed form of an incompressible material [Pa]."""
    side = x ** (-2.0 if kind == "uniaxial" else -5.0)
    first = x * x + 2.0 / x if kind == "uniaxial" else 2.0 * x * x + x**-4.0
    if law == "neo_hookean":
        return SHEAR * (x - side)
    if law == "mooney_rivlin":
        return 2.0 * (x - side) * (C10 + C01 * (1.0 / x if kind == "uniaxial" else x * x))
    if law == "yeoh":
        return 2.0 * (x - side) * (C1 + 2.0 * C2 * (first - 3.0) + 3.0 * C3 * (first - 3.0) ** 2)
    across = -0.5 if kind == "uniaxial" else -2.0
    return sum(m * (x ** (a - 1.0) - x ** (across * a - 1.0)) for m, a in zip(MODULI, EXPONENTS))


@pytest.mark.parametrize("kind", ["uniaxial", "equibiaxial"])
@pytest.mark.parametrize("stretch", [0.4, 0.9, 1.3, 3.0])
@pytest.mark.parametrize("law", RUBBER)
def test_nominal_stress_is_that_of_the_closed_form(law, stretch, kind):
    """No volume changes, so a pressure that makes the free faces free is all that is added."""
    across = stretch**-0.5 if kind == "uniaxial" else stretch
    free = across if kind == "uniaxial" else stretch**-2.0
    F = np.diag([stretch, across, free])
    P = stress(law, F)
    pulled = P[0, 0] - P[2, 2] * free / stretch
    assert pulled == pytest.approx(nominal(law, stretch, kind), rel=1e-10)


def test_a_bar_of_st_venant_and_kirchhoff_bears_most_when_pressed_to_its_length_over_root_three():
    def load(stretch):
        along = 0.5 * (stretch**2 - 1.0)
        across = np.sqrt(1.0 - 2.0 * POISSON * along)
        P = stress("saint_venant_kirchhoff", np.diag([stretch, across, across]))
        assert P[1, 1] == pytest.approx(0.0, abs=1e-9 * YOUNG)
        return P[0, 0]

    assert load(1.2) == pytest.approx(0.5 * YOUNG * (1.2**3 - 1.2))
    softest = 1.0 / np.sqrt(3.0)
    assert load(softest) < min(load(softest + 0.02), load(softest - 0.02)) < 0.0


@pytest.mark.parametrize("apart", [0.0, 1e-16, 1e-12, 1e-8, 1e-4])
@pytest.mark.parametrize("stretches", [(1.3, 1.3, 0.7), (0.8, 0.8, 0.8), (1.0, 1.0, 1.0)])
def test_ogdens_law_is_exact_where_stretches_are_equal_or_nearly_so(stretches, apart, drawn_rng):
    """α = 2 is the Neo-Hookean law, and α = ±2 that of Mooney and Rivlin, written by invariants."""
    F = turned(drawn_rng) @ np.diag(np.array(stretches) * [1.0 + apart, 1.0, 1.0]) @ turned(drawn_rng)
    dF, ogden = drawn_rng.standard_normal((3, 3)), law_named("ogden")
    for other, constants in (
        ("neo_hookean", {"shear_moduli": (SHEAR, 0.0, 0.0), "exponents": (2.0, 1.0, 1.0)}),
        ("mooney_rivlin", {"shear_moduli": (2.0 * C10, -2.0 * C01, 0.0),
                           "exponents": (2.0, -2.0, 1.0)}),
    ):
        parameters = ogden.own.parameters(constants, BULK)
        at_point = ogden.linearize(parameters, rows(F), True, False)
        changes = ogden.differential(parameters, at_point, rows(dF))
        expected = differential(other, F, dF)
        np.testing.assert_allclose(changes, expected, atol=1e-12 * BULK)
        np.testing.assert_allclose(
            ogden.stress(parameters, rows(F)), stress(other, F), atol=1e-12 * BULK
        )


@pytest.mark.parametrize("law", RUBBER)
def test_points_that_are_flat_or_inside_out_are_pushed_back_by_finite_forces(law, drawn_rng):
    Q, R = turned(drawn_rng), turned(drawn_rng)
    heights = np.array([-1.0, -0.5, -0.1, 0.0, 1e-12, 0.04, 0.2, 0.5, 0.8])
    states = [Q @ np.diag([1.1, 0.9, height]) @ R for height in heights]
    energies = np.array([energy(law, F) for F in states])
    assert np.isfinite(energies).all() and (np.diff(energies) < 0.0).all()
    outward = Q @ np.diag([0.0, 0.0, 1.0]) @ R
    for F in states:
        assert np.sum(stress(law, F) * outward) < 0.0
        assert np.isfinite(differential(law, F, drawn_rng.standard_normal((3, 3)))).all()
    for F in (np.zeros((3, 3)), np.diag([1.0, 0.0, 0.0]), np.diag([-2.0, 1.0, 1.0])):
        assert np.isfinite(energy(law, F)) and np.isfinite(stress(law, F)).all()
        assert np.isfinite(differential(law, F, np.ones((3, 3)))).all()


@pytest.mark.parametrize("law", RUBBER)
def test_without_a_bulk_modulus_stress_does_not_change_with_volume(law, drawn_rng):
    """The isochoric part does no work in a change of volume alone: P : F = 0."""
    parameters, F = PARAMETERS[law]._replace(bulk_modulus=0.0), strained(drawn_rng)
    P = np.array(law_named(law).stress(parameters, rows(F)))
    assert np.abs(P).max() > 1e-3 * YOUNG
    assert np.sum(P * F) == pytest.approx(0.0, abs=1e-10 * YOUNG)


def test_ogdens_projected_differential_is_the_nearest_positive_one(drawn_rng):
    F = turned(drawn_rng) @ np.diag([0.4, 0.6, 1.1]) @ turned(drawn_rng)
    exact, projected = (
        np.array([differential("ogden", F, unit.reshape(3, 3), is_projected).ravel()
                  for unit in np.eye(9)])
        for is_projected in (False, True)
    )  # fmt: skip
    values, vectors = np.linalg.eigh(exact)
    assert values[0] < -1e-3 * values[-1]
    nearest = (vectors * np.maximum(values, 0.0)) @ vectors.T
    np.testing.assert_allclose(projected, nearest, atol=1e-11 * values[-1])


@pytest.mark.parametrize("kind", ["any", "equal", "flat", "inside out", "line", "zero"])
def test_principal_axes_are_rotations_with_signed_stretches_in_order(kind, drawn_rng):
    for _ in range(50):
        stretches = drawn_rng.uniform(0.2, 2.0, 3)
        if kind == "equal":
            stretches[1:] = stretches[0] * (1.0 + 10.0 ** drawn_rng.uniform(-18.0, -2.0, 2))
        stretches[1:] *= kind not in ("line", "zero")
        stretches[0] *= kind != "zero"
        stretches[2] *= {"flat": 0.0, "inside out": -1.0}.get(kind, 1.0)
        F = turned(drawn_rng) @ np.diag(stretches) @ turned(drawn_rng)
        U, found, V = (np.array(part) for part in principal_axes(rows(F)))
        np.testing.assert_allclose((U.T * found) @ V, F, atol=1e-13 * (np.abs(F).max() + 1e-300))
        for axes in (U, V):
            np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-13)
            assert np.linalg.det(axes) > 0.0
        expected = np.linalg.svd(F, compute_uv=False) * [1.0, 1.0, np.sign(np.linalg.det(F)) or 1.0]
        np.testing.assert_allclose(np.abs(found), np.abs(expected), atol=1e-12)
        assert found[2] * expected[2] >= -1e-24


def test_eigenvalues_of_a_symmetric_matrix_and_its_positive_part(drawn_rng):
    A = drawn_rng.standard_normal((3, 3))
    A = A + A.T
    entries = (A[0, 0], A[1, 1], A[2, 2], A[1, 2], A[0, 2], A[0, 1])
    values, axes = (np.array(part) for part in symmetric_eigenvalues(entries))
    np.testing.assert_allclose((axes.T * values) @ axes, A, atol=1e-13)
    found = positive_part(entries)
    values, vectors = np.linalg.eigh(A)
    B = (vectors * np.maximum(values, 0.0)) @ vectors.T
    expected = (B[0, 0], B[1, 1], B[2, 2], B[1, 2], B[0, 2], B[0, 1])
    np.testing.assert_allclose(found, expected, atol=1e-13)
