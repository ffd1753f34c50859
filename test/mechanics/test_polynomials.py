"""Polynomials of several variables: monomials, and derivatives against finite differences."""

import numpy as np
import pytest

from softrobot_twin.mechanics.polynomials import Monomials


def test_derivatives_are_finite_differences():
    monomials, seed, h = Monomials(5, 4), 8, 1e-5
    print("seed", seed)
    rng = np.random.default_rng(seed)
    coefficients, point = rng.normal(size=monomials.count), rng.uniform(-1.0, 1.0, 5)

    def gradient(z):
        return monomials.slopes(z[None])[0] @ coefficients

    shifts = h * np.eye(5)
    values = [monomials.values((point + s)[None])[0] @ coefficients for s in (*shifts, *-shifts)]
    slopes = (np.array(values[:5]) - values[5:]) / (2.0 * h)
    assert gradient(point) == pytest.approx(slopes, rel=1e-8, abs=1e-8)
    bends = np.array([(gradient(point + s) - gradient(point - s)) / (2.0 * h) for s in shifts])
    low = monomials.count_up_to(2)
    own = monomials.curvature_coefficients(coefficients) @ monomials.values(point[None])[0, :low]
    assert own == pytest.approx(bends, rel=1e-7, abs=1e-7)
    assert own == pytest.approx(own.T, abs=1e-13)
