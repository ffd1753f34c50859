"""Row 5: a body collapsed to a point, a line or a plane, turned over, or with its nodes at random.

It recovers its shape, or the status says that it did not. From a point, or with nodes at random,
where round-off decides the direction, it may also come to another equilibrium: the body turned over
through its own base, which elements without contact do not forbid. That one must be real: upright everywhere, balanced, stable, and of more energy.
"""

from dataclasses import replace

import numpy as np
import pytest

from softrobot_twin.simulation import Hold, Status
from softrobot_twin.simulation.step.actuation import INVERSION
from test.builder import builder
from test.scene_changes import in_balance

SIZE = (0.04, 0.04, 0.12)
FOOT = [{"box": {"minimum": [-1, -1, -1], "maximum": [1, 1, 1e-9]}}]


@builder
def tower(simulate, body_of, block, /, element, integration="quasi_static", cells=(2, 2, 6)):
    """Makes a settled block on its foot, and returns it with its shape."""
    body = body_of(block(SIZE, cells, shake=0.0), element=element, young_modulus=2e5,
                   fixed=FOOT, damping={"mass": 2.0, "stiffness": 0.02})  # fmt: skip
    simulation = simulate(
        body=body, integration=integration,
        solver={"newton_iterations": 30, "residual_tolerance": 1e-7},
    )  # fmt: skip
    return simulation, in_balance(simulation, Hold(0.05), 60, is_at_rest).state.positions


def collapsed(simulation, kind, rng):
    """Node positions [m] that no body has by itself."""
    free = simulation.model.nodes.free_nodes
    positions = simulation.model.nodes.rest_positions.copy()
    x = positions[free]
    if kind == "point":
        x[:] = x.mean(axis=0) + rng.uniform(-0.02, 0.02, 3)
    elif kind == "line":
        x[:, :2] = 0.5 * np.array(SIZE[:2])
    elif kind == "level plane":
        x[:, 2] = rng.uniform(0.0, 0.04)
    elif kind == "oblique plane":
        normal = rng.standard_normal(3)
        normal /= np.linalg.norm(normal)
        x -= np.outer((x - x.mean(axis=0)) @ normal, normal)
    elif kind == "mirrored":
        x[:, 2] *= -1.0
    else:
        x[:] = rng.uniform(-0.06, 0.12, x.shape)
    positions[free] = x
    return positions


def let_go(simulation, positions, steps=60):
    """Its final state; every state before is finite."""
    simulation.reset()
    simulation.restore(replace(simulation.state, positions=positions))
    for _ in range(steps):
        result = simulation.step(Hold(0.05))
        assert np.isfinite(result.state.positions).all()
        if is_at_rest(result):
            break
    return result


def is_at_rest(result):
    still = np.abs(result.state.velocities).max(initial=0) < 1e-6
    return still and result.report.residual < 1e-8


def is_loud(result):
    """The status says that it is not well, and why is true."""
    if result.status is Status.INVERTED:
        return result.report.inverted_count > 0
    if result.status is Status.SATURATED:
        return result.report.active_limits == (INVERSION,)
    return result.status in (Status.NOT_CONVERGED, Status.DIVERGED)


def check_other_equilibrium(simulation, result, energies, least):
    """It is upright everywhere, balanced, stable, and has more energy [J] than the settled one."""
    assert result.report.residual < 1e-7
    assert result.report.inverted_count == 0 and not result.report.projected_tangent
    assert energies(simulation)[0] > least + 0.01


@pytest.mark.sampled
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("element", ["linear", "smoothed", "quadratic"])
@pytest.mark.parametrize("kind", ["point", "line", "level plane", "oblique plane", "mirrored"])
def test_a_collapsed_body_recovers_or_is_reported_as_inverted(tower, kind, element, seed, energies):
    simulation, rest = tower(element)
    least = energies(simulation)[0]
    result = let_go(simulation, collapsed(simulation, kind, np.random.default_rng(seed)))
    if is_loud(result) and "plane" not in kind:
        return
    # A flattened body always recovers.
    assert result.status is Status.OK
    if kind == "point" and np.abs(result.state.positions - rest).max() > 1e-5:
        check_other_equilibrium(simulation, result, energies, least)
    else:
        np.testing.assert_allclose(result.state.positions, rest, atol=1e-5)


@pytest.mark.sampled
@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("element", ["linear", "smoothed", "quadratic"])
@pytest.mark.parametrize("kind", ["point", "line", "oblique plane", "mirrored"])
def test_in_dynamics_a_collapsed_body_recovers_or_is_reported_as_inverted(tower, kind, element, seed):
    simulation, rest = tower(element, "dynamic", cells=(1, 1, 3))
    result = let_go(simulation, collapsed(simulation, kind, np.random.default_rng(seed)), 150)
    if not is_loud(result):
        assert result.status is Status.OK
        np.testing.assert_allclose(result.state.positions, rest, atol=1e-4)


@pytest.mark.sampled
@pytest.mark.parametrize("element", ["linear", "smoothed", "quadratic"])
def test_random_nodes_recover_or_are_reported_or_reach_another_equilibrium(tower, element, energies):
    simulation, rest = tower(element)
    let_go(simulation, rest)
    least = energies(simulation)[0]
    recovered = 0
    for seed in range(12):
        result = let_go(simulation, collapsed(simulation, "random", np.random.default_rng(seed)))
        if is_loud(result):
            continue
        assert result.status is Status.OK
        if np.abs(result.state.positions - rest).max() < 1e-5:
            recovered += 1
            continue
        check_other_equilibrium(simulation, result, energies, least)
    # Some two thirds recover; which ones, round-off decides, and with it the machine. Of twelve
    # fewer than three do so with a probability of 0.0005.
    print(recovered, "recovered")
    assert recovered >= 3
