"""Viscosity: relaxation, hysteresis and dissipation of a material at one point."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from softrobot_twin.mechanics.laws import law_named
from softrobot_twin.mechanics.remembering_elements import RememberingElements
from softrobot_twin.mechanics.softening import SofteningConstants
from softrobot_twin.mechanics.viscosity import ViscousTerm, instant_shares, step_factors

from .test_softening import along, uniaxial

LAW = law_named("neo_hookean").of_moduli(2.0e5, 0.45)
MU = LAW.shear_modulus
SERIES = (ViscousTerm(0.2, 0.5), ViscousTerm(0.1, 4.0))
MEMORIES = {
    "viscous": {"viscosity": SERIES},
    "softening": {"softening": SofteningConstants(1.5, 2000.0, 0.1)},
    "both": {"viscosity": SERIES, "softening": SofteningConstants(1.5, 2000.0, 0.1)},
}


def sheared(amount):
    return np.eye(3) + amount * np.outer([1, 0, 0], [0, 1, 0])


@pytest.mark.parametrize("steps", [[0.1] * 5, [0.01, 0.7, 2.0, 0.3, 30.0]])
def test_the_stress_of_a_held_stretch_relaxes_by_the_series(material_point, steps):
    point, stretch = material_point(LAW, viscosity=SERIES), 1.8
    long_term = MU * (stretch - stretch**-2)
    shares = np.array([term.share for term in SERIES])
    times = np.array([term.time for term in SERIES])
    for step in [0.0, *steps]:
        found = along(point.step(uniaxial(stretch), step), stretch)
        left = 1.0 - shares @ (1.0 - np.exp(-point.time / times))
        expected = long_term / (1.0 - shares.sum()) * left
        assert found == pytest.approx(expected, rel=1e-9)


def test_a_long_step_leaves_the_law_alone_and_a_step_without_time_the_modulus_at_once(material_point):
    F = uniaxial(1.4) @ sheared(0.2)
    own = material_point(LAW).step(F)
    np.testing.assert_allclose(
        material_point(LAW, viscosity=SERIES).step(F, np.inf), own, atol=1e-9 * abs(own).max()
    )
    fast = material_point(LAW._replace(bulk_modulus=0.0), viscosity=SERIES).step(F, 0.0)
    shape = material_point(LAW._replace(bulk_modulus=0.0)).step(F)
    np.testing.assert_allclose(fast, shape / 0.7, atol=1e-9 * abs(shape).max())


def test_a_steady_slow_stretch_feels_the_viscosity_at_any_step(material_point):
    # Q = γ τ dS/dt where the stretch changes much more slowly than Q relaxes.
    term, rate = ViscousTerm(0.2, 0.01), 1.0e-4
    own = along(material_point(LAW).step(uniaxial(1.002)), 1.002)
    slow = [
        along(runs[-1], 1.002) - own
        for step in (0.05, 2.0)
        for runs in [[
            point.step(uniaxial(1.0 + rate * t), step)
            for point in [material_point(LAW, viscosity=(term,))]
            for t in np.arange(step, 20.0 + 0.5 * step, step)
        ]]
    ]  # fmt: skip
    expected = 0.25 * term.time * 3.0 * MU * rate
    np.testing.assert_allclose(slow, expected, rtol=0.02)


@pytest.mark.parametrize("ratio", [0.3, 1.0, 3.0])
def test_the_loop_of_a_small_shear_has_the_area_of_the_loss_modulus(material_point, ratio):
    g, tau, amount, count = 0.3, 0.4, 1e-3, 160
    omega, point = ratio / tau, material_point(LAW, viscosity=(ViscousTerm(g, tau),))
    step = 2.0 * np.pi / omega / count
    shears = amount * np.sin(2.0 * np.pi * np.arange(1, 6 * count + 1) / count)
    stresses = np.array([point.step(sheared(shear), step)[0, 1] for shear in shears])
    last = slice(-count - 1, None)
    loop, around = stresses[last], shears[last]
    area = np.sum(0.5 * (loop[1:] + loop[:-1]) * np.diff(around))
    modulus = MU / (1.0 - g) * ((1.0 - g) + g * 1j * ratio / (1.0 + 1j * ratio))
    assert area == pytest.approx(np.pi * modulus.imag * amount**2, rel=0.01)
    phases = np.exp(-2j * np.pi * np.arange(1, count + 1) / count)
    response = 2j * np.mean(stresses[-count:] * phases) / amount
    loss_tangent = response.imag / response.real
    assert loss_tangent == pytest.approx(modulus.imag / modulus.real, rel=0.01)


def test_a_rotation_of_a_relaxing_point_changes_nothing_but_the_direction(material_point):
    still, turning = (material_point(LAW, viscosity=SERIES) for _ in range(2))
    F = uniaxial(1.5) @ sheared(0.3)
    for k in range(6):
        R = Rotation.from_rotvec(k * np.array([0.7, -0.4, 0.9])).as_matrix()
        expected = R @ still.step(F, 0.2)
        np.testing.assert_allclose(
            turning.step(R @ F, 0.2), expected, atol=1e-9 * abs(expected).max()
        )


@pytest.mark.parametrize("memory", MEMORIES)
def test_work_around_a_random_cycle_is_never_negative(material_point, memory, drawn_rng):
    for _ in range(3):
        point = material_point(LAW, **MEMORIES[memory])
        corners = [np.eye(3), *(np.eye(3) + drawn_rng.uniform(-0.25, 0.25, (4, 3, 3))), np.eye(3)]
        work, F, P = 0.0, np.eye(3), np.zeros((3, 3))
        for begin, end in zip(corners[:-1], corners[1:], strict=True):
            step = 10.0 ** drawn_rng.uniform(-3, 0)
            for share in np.linspace(0.0, 1.0, 61)[1:]:
                G = begin + share * (end - begin)
                found = point.step(G, step)
                work += 0.5 * np.sum((P + found) * (G - F))
                F, P = G, found
        assert work > 0.0


def test_ten_thousand_steps_do_not_drift(material_point):
    point, stretch = material_point(LAW, viscosity=SERIES), 1.6
    point.step(uniaxial(stretch))
    steps = np.full(10_000, 1.0e-3)
    for step in steps:
        P = point.step(uniaxial(stretch), step)
    shares = instant_shares(SERIES)
    left = 1.0 + shares @ np.exp(-10.0 / np.array([term.time for term in SERIES]))
    expected = MU * (stretch - stretch**-2) * left
    assert along(P, stretch) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("time_step", [0.0, 1e-12, 0.3, np.inf])
def test_factors_of_a_step_are_finite_and_add_up(time_step):
    factors = step_factors(SERIES, time_step)
    assert np.isfinite(factors.kept).all() and np.isfinite(factors.gained).all()
    assert 1.0 <= factors.scale <= 1.0 / 0.7 + 1e-12


@pytest.mark.parametrize("memory", MEMORIES)
def test_forces_and_stiffness_are_exact_derivatives_within_a_step(memory, block, bind, slopes):
    mesh = block(cells=(1, 1, 1))
    bound = bind(
        (lambda part, free, _: RememberingElements(part, free, LAW, **MEMORIES[memory]),
         mesh, 1.0, 0.0),
        fixed=[0, 1, 2],
    )  # fmt: skip
    term, rng = bound.terms[0], np.random.default_rng(1)
    rest = mesh.node_positions
    size = np.ptp(rest)
    first = rest * [1.4, 0.85, 0.9] + 0.02 * size * rng.standard_normal(rest.shape)
    term.begin_step(rest, None, 0.1)
    term.recall(term.memory_after(first, None), None, None)
    term.begin_step(first, None, 0.3)
    x = rest * [1.15, 0.95, 0.95] + 0.01 * size * rng.standard_normal(rest.shape)
    forces, K = bound.assemble(x)
    gradient = slopes(term.energy, x, bound.free, 1e-5 * size)
    np.testing.assert_allclose(forces.ravel(), -gradient, atol=1e-7 * np.abs(forces).max())
    columns = slopes(lambda at: bound.forces(at)[0].ravel(), x, bound.free, 1e-5 * size)
    np.testing.assert_allclose(K.toarray(), -columns, atol=1e-7 * np.abs(K).max())
    projected = bound.assemble(x, True)[1].toarray()
    assert np.linalg.eigvalsh(projected)[0] > -1e-9 * np.abs(projected).max()


def test_a_point_that_was_turned_inside_out_keeps_finite_overstresses(material_point):
    point = material_point(LAW, **MEMORIES["both"])
    for F in (np.diag([-0.2, 1.0, 1.0]), np.diag([0.0, 1.0, 1.0]), np.eye(3)):
        assert np.isfinite(point.step(F, 0.1)).all()
