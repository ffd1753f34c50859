"""Constants of cross-sections against tables and closed forms."""

import numpy as np
import pytest

from softrobot_twin.mechanics.beam_sections import rectangle, tube


@pytest.mark.parametrize(("ratio", "factor"), [(1.0, 0.1406), (2.0, 0.229), (5.0, 0.291),
                                                (10.0, 0.312)])  # fmt: skip
def test_torsion_of_a_rectangle_is_that_of_timoshenkos_table(ratio, factor):
    # J = factor · a b³, Timoshenko and Goodier, Theory of Elasticity, section 109.
    for a, b in ((ratio, 1.0), (1.0, ratio)):
        assert rectangle(a, b, 0.3).torsion == pytest.approx(factor * ratio, rel=3e-3)


def test_a_rectangle_bends_more_easily_along_its_thickness():
    section = rectangle(0.005, 0.010, 0.45)
    assert section.inertia_z == pytest.approx(0.010 * 0.005**3 / 12.0)
    assert section.inertia_y == pytest.approx(0.005 * 0.010**3 / 12.0)
    assert section.area == pytest.approx(5e-5)
    assert section.shear_area_y == pytest.approx(5e-5 * 10 * 1.45 / (12 + 11 * 0.45))


def test_a_tube_without_a_hole_is_a_circle():
    circle = tube(0.01, 0.0, 0.3)
    assert circle.area == pytest.approx(np.pi * 1e-4)
    assert circle.inertia_y == pytest.approx(np.pi * 1e-8 / 4)
    assert circle.torsion == pytest.approx(2.0 * circle.inertia_y)
    assert circle.shear_area_y / circle.area == pytest.approx(6 * 1.3 / (7 + 6 * 0.3))


def test_the_shear_factor_of_a_thin_tube_is_one_half():
    thin = tube(0.01, 0.00999, 0.0)
    assert thin.shear_area_y / thin.area == pytest.approx(0.5, rel=1e-2)
