"""Facts of equilibria in contact at held cables: repeated steps find them (row 32)."""

import numpy as np
import pytest

from softrobot_twin.simulation import CommandSetpoints

# Steps of three linearizations, and the residual that counts as rest [N].
MOST_STEPS, AT_REST = 80, 1e-4
# Shortenings [m] at which Newton's method cycles where it makes whole moves, at residuals up to 0.3 N; with
# the last four it did so while level edges were detected at their ends alone.
CYCLING = [
    [0.015523375982870643, 0.0, 0.0, 0.014918967603526453],
    [0.01715319267495725, 0.014404235573198977, 0.0, 0.0],
    [0.01573839831455171, 0.0, 0.0, 0.015676287639901313],
    [0.013528326948750849, 0.01528111458829895, 0.0, 0.0],
    [0.014419916176972497, 0.0, 0.0, 0.0],
    [0.014242888338716946, 0.00043009058400469204, 0.0, 0.0],
    [0.014268660839136403, 0.0, 0.002173285401348879, 0.0],
    [0.014441465725136908, 0.0, 0.0, 0.006141469123038641],
]


@pytest.fixture(params=["linear", "smoothed", "quadratic"])
def beside_a_rod(request, beam, rod):
    return beam(rod, {"body.element": request.param})


def wind_to_rest(simulation, wound):
    """Wind cables by lengths [m] from the rest shape; the residual when steps change no more [N]."""
    simulation.reset()
    settled = 0
    for _ in range(MOST_STEPS):
        wanted = simulation.rest_setpoints - wound
        result = simulation.step(CommandSetpoints(wanted, 0.02))
        residual = result.report.residual
        is_wound = np.abs(result.state.setpoints - wanted).max() < 1e-9
        settled = settled + 1 if is_wound and residual < 1e-6 else 0
        if settled == 2:
            break
    return residual


@pytest.mark.sampled
@pytest.mark.parametrize("wound", CYCLING)
def test_a_beam_that_would_cycle_on_a_rod_comes_to_rest(beside_a_rod, wound):
    assert wind_to_rest(beside_a_rod, np.array(wound)) < AT_REST


@pytest.mark.exhaustive
@pytest.mark.parametrize("seed", [1, 2, 11])
def test_a_beam_beside_a_rod_comes_to_rest_with_ten_drawn_shortenings(beside_a_rod, seed):
    random = np.random.default_rng(seed)
    for _ in range(10):
        wound = random.uniform(0.0, 0.02, 4) * (random.random(4) < 0.5)
        wound[0] = random.uniform(0.008, 0.02)
        residual = wind_to_rest(beside_a_rod, wound)
        assert residual < AT_REST, f"seed {seed}, wound {wound.tolist()} m"
