"""Newton's method with the exact tangents of hyperelastic laws converges quadratically."""

import numpy as np
import pytest

from softrobot_twin.simulation import Hold

SIZE = (0.03, 0.03, 0.03)
GRAVITY = [40.0, 20.0, -60.0]
FOOT = [{"box": {"minimum": [-1, -1, -1], "maximum": [1, 1, 1e-9]}}]
RATIO = {"poisson_ratio": 0.4}
LAWS = {
    "neo_hookean": {"young_modulus": 2e4, **RATIO},
    "saint_venant_kirchhoff": {"young_modulus": 2e4, **RATIO},
    "mooney_rivlin": {"constants": {"c10": 2.6e3, "c01": 0.9e3}, **RATIO},
    "yeoh": {"constants": {"c1": 3.5e3, "c2": -100.0, "c3": 20.0}, **RATIO},
    "ogden": {"constants": {"shear_moduli": [6e3, -500.0], "exponents": [1.5, -4.0]}, **RATIO},
}


@pytest.mark.parametrize("element", ["linear", "smoothed", "quadratic"])
@pytest.mark.parametrize("law", LAWS)
def test_each_linearization_squares_the_error(law, element, simulate, body_of, block):
    """A soft cube sags under six times its weight, and leans; one linearization in each step.

    The error is the distance from the end, because residuals of stiff directions hide it.
    """
    body = body_of(block(SIZE, (2, 2, 2), shake=0.0), element=element, fixed=FOOT)
    body["material"] = {"density": 1000.0, "law": law, **LAWS[law]}
    simulation = simulate(
        body=body, gravity=GRAVITY, solver={"newton_iterations": 1, "residual_tolerance": 1e-14}
    )
    results = [simulation.step(Hold()) for _ in range(15)]
    load = 1000.0 * np.prod(SIZE) * np.linalg.norm(GRAVITY)
    assert results[-1].report.residual < 1e-12 * load
    end = results[-1].state.positions
    errors = [np.abs(result.state.positions - end).max() / SIZE[2] for result in results]
    assert errors[0] > 0.003
    # Of a tangent that is wrong by a thousandth, errors near 1e-6 would fall by a thousand only.
    pairs = [pair for pair in zip(errors, errors[1:]) if 1e-7 < pair[0] < 1e-2]
    assert pairs and min(pairs)[0] < 1e-3
    for before, after in pairs:
        assert after < 100.0 * before**2, errors
