"""Mass-spring bodies: chains hang, masses swing, at closed-form tensions and frequencies."""

from dataclasses import replace

import numpy as np
import pytest

from softrobot_twin.simulation import Hold
from test.scene_changes import solved

G = 9.81


def chain(count, spacing=0.05):
    """A hanging chain of equal links, fixed at its top."""
    points = [[0.0, 0.0, -spacing * k] for k in range(count)]
    return points, [[k, k + 1] for k in range(count - 1)]


@pytest.mark.parametrize("integration", ["quasi_static", "dynamic"])
def test_each_spring_of_a_hanging_chain_carries_the_weight_below_it(simulate, integration):
    points, springs = chain(6)
    masses = [0.1, 0.01, 0.02, 0.03, 0.04, 0.05]
    scene = simulate(
        mass_springs=[{
            "name": "chain", "points": points, "masses": masses, "springs": springs,
            "stiffness": 400.0, "damping": 4.0, "fixed": [0],
        }],
        integration=integration,
    )  # fmt: skip
    solved(scene, Hold(0.1), 60)
    term = next(term for term in scene.model.forces if term.name == "springs")
    tensions = 400.0 * (term.lengths(scene.state.positions) - 0.05)
    below = G * np.cumsum(masses[::-1])[::-1][1:]
    np.testing.assert_allclose(tensions, below, rtol=1e-6)


def test_two_masses_oscillate_at_the_frequency_of_their_reduced_mass(simulate):
    """ω² = k (1/m + 1/M)."""
    scene = simulate(
        mass_springs=[{
            "name": "two", "points": [[0, 0, 0], [0.1, 0, 0]], "masses": [0.02, 0.06],
            "springs": [[0, 1]], "stiffness": 60.0,
        }],
        integration="dynamic", gravity=[0, 0, 0],
    )  # fmt: skip
    scene.restore(_moving(scene, [[0.3, 0, 0], [-0.1, 0, 0]]))
    omega, h = np.sqrt(60.0 * (1 / 0.02 + 1 / 0.06)), 0.0005
    stretch = []
    for _ in range(400):
        x = scene.step(Hold(h)).state.positions
        stretch.append(x[1, 0] - x[0, 0] - 0.1)
    # Backward Euler of a linear spring in closed form: e^{±i atan(ωh)} / √(1 + ω²h²) a step.
    n = np.arange(1, 401)
    shrunk = (1.0 + (omega * h) ** 2) ** (-n / 2)
    expected = -(0.4 / omega) * shrunk * np.sin(n * np.arctan(omega * h))
    np.testing.assert_allclose(stretch, expected, atol=1e-9)
    np.testing.assert_allclose(0.02 * x[0] + 0.06 * x[1], [0.006, 0, 0], atol=1e-12)


def _moving(scene, velocities):
    return replace(scene.state, velocities=np.array(velocities, float))


def test_a_damped_spring_settles_at_the_rate_of_its_damper(simulate):
    """Overdamped and slow: x decays by k/c."""
    scene = simulate(
        mass_springs=[{
            "name": "two", "points": [[0, 0, 0], [0.1, 0, 0]], "masses": [1e-6],
            "springs": [[0, 1]], "stiffness": 5.0, "damping": 2.0, "fixed": [0],
        }],
        integration="dynamic", gravity=[0, 0, 0],
    )  # fmt: skip
    positions = scene.state.positions.copy()
    positions[1, 0] = 0.11
    scene.restore(replace(scene.state, positions=positions))
    stretch = [scene.step(Hold(0.002)).state.positions[1, 0] - 0.1 for _ in range(200)]
    expected = 0.01 * (1.0 + 0.002 * 5.0 / 2.0) ** -np.arange(1, 201.0)
    np.testing.assert_allclose(stretch, expected, rtol=1e-4)
