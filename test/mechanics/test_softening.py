"""Softening by the first stretch: cycles of a material at one point."""

import math

import numpy as np
import pytest

from softrobot_twin.mechanics.laws import law_named
from softrobot_twin.mechanics.softening import SofteningConstants

LAW = law_named("neo_hookean").of_moduli(2.0e5, 0.45)
MU = LAW.shear_modulus
CONSTANTS = SofteningConstants(1.6, 9000.0, 0.2)


def uniaxial(stretch):
    return np.diag([stretch, stretch**-0.5, stretch**-0.5])


def along(P, stretch):
    """Engineering stress of a uniaxial stretch at constant volume [Pa]: without the pressure."""
    return P[0, 0] - P[1, 1] * stretch**-1.5


def energy(stretch):
    return 0.5 * MU * (stretch**2 + 2.0 / stretch - 3.0)


def expected(stretch, greatest):
    """Stress by Ogden and Roxburgh [Pa]; `greatest` is the greatest stretch before."""
    own, top = energy(stretch), energy(greatest)
    eta = 1.0
    if own < top:
        eta -= math.erf((top - own) / (CONSTANTS.m + CONSTANTS.beta * top)) / CONSTANTS.r
    return eta * MU * (stretch - stretch**-2)


def lost_energy(greatest):
    """Energy that softening has turned into heat, where Ψ was at most `greatest` [J/m³]."""
    span = CONSTANTS.m + CONSTANTS.beta * greatest
    x = greatest / span
    return span / CONSTANTS.r * (x * math.erf(x) + math.expm1(-(x**2)) / math.sqrt(math.pi))


def test_cycles_of_a_stretch_follow_the_closed_form(material_point):
    point, greatest = material_point(LAW, softening=CONSTANTS), 1.0
    # New material, unloading, loading again on the same curve, new material beyond.
    for stretch in (1.2, 1.6, 2.0, 1.5, 1.1, 1.5, 1.9, 2.4, 1.3, 0.8):
        found = along(point.step(uniaxial(stretch)), stretch)
        assert found == pytest.approx(expected(stretch, greatest), rel=1e-9)
        greatest = max(greatest, stretch)
    assert expected(1.5, 2.0) < 0.9 * expected(1.5, 1.5)


def test_there_is_no_permanent_set(material_point):
    point = material_point(LAW, softening=CONSTANTS)
    point.step(uniaxial(2.0))
    np.testing.assert_allclose(point.step(np.eye(3)), 0.0, atol=1e-9 * MU)
    assert point.elements.energy(point.corners) == pytest.approx(0.0, abs=1e-9 * MU)


def test_the_work_of_a_cycle_is_what_the_material_lost(material_point):
    point = material_point(LAW, softening=CONSTANTS)
    work, before, P = 0.0, np.eye(3), np.zeros((3, 3))
    lost = [0.0]
    for stretch in (*np.linspace(1.0, 2.0, 400), *np.linspace(2.0, 1.0, 400)):
        F = uniaxial(stretch)
        found = point.step(F)
        work += 0.5 * np.sum((P + found) * (F - before))
        before, P = F, found
        lost.append(lost_energy(point.memory["greatest"][0, 0, 0]))
    assert work == pytest.approx(lost[-1], rel=1e-4)
    assert (np.diff(lost) >= 0.0).all() and lost[-1] > 0.0


def test_the_volume_does_not_soften(material_point):
    point = material_point(LAW, softening=CONSTANTS)
    point.step(uniaxial(2.0))
    swollen = 1.1 * np.eye(3)
    np.testing.assert_allclose(
        point.step(swollen), material_point(LAW).step(swollen), atol=1e-9 * MU
    )
