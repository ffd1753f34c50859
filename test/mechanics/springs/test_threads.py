"""Threads: springs that carry tension only, with a continuous stiffness."""

import numpy as np
import pytest

from softrobot_twin.mechanics.springs import TAKE_UP, spring_law

STIFFNESS, LENGTH = 60.0, 2.0


def law(length):
    return spring_law(length, 0.0, STIFFNESS, LENGTH, 0.0, 0.0, TAKE_UP * LENGTH)


@pytest.mark.parametrize("stretch", [-0.5, 0.3 * TAKE_UP, 0.9 * TAKE_UP, 0.2])
def test_forces_are_minus_the_energys_slope(world, stretch):
    """Slack, being taken up, and taut."""
    x = world.shaken()
    first, second = world.soft(0, 1, 2, 3, 2, 3, 4, 5), world.soft(4, 5, 6, 7, 4, 5, 6, 7)
    lengths = np.linalg.norm(second.positions(x) - first.positions(x), axis=1)
    term, matrix = world.springs(
        first, second, STIFFNESS, lengths / (1.0 + stretch), is_thread=True
    )
    slope = world.slopes(x, term.energy).reshape(-1, 3)
    forces = world.forces(term, x)
    scale = STIFFNESS * abs(stretch)
    np.testing.assert_allclose(forces, -slope, atol=2e-5 * scale)
    K = world.stiffness(term, matrix, x)
    expected = -world.slopes(x, lambda y: world.forces(term, y))
    np.testing.assert_allclose(K, 0.5 * (expected + expected.T), atol=1e-4 * STIFFNESS)
    assert np.linalg.eigvalsh(K).min() > -1e-12 * STIFFNESS
    assert (np.abs(forces).max() > 0.0) == (stretch > 0.0)
    assert term.energy(x) == 0.0 or stretch > 0.0


def test_tension_and_stiffness_are_continuous():
    w = TAKE_UP * LENGTH
    for place in (LENGTH, LENGTH + w):
        below, above = law(place - 1e-9 * w), law(place + 1e-9 * w)
        assert below == pytest.approx(above, abs=1e-7 * STIFFNESS)
    pull, along, _ = law(LENGTH + 10.0 * w)
    assert along == STIFFNESS
    assert pull * (LENGTH + 10.0 * w) == pytest.approx(STIFFNESS * 9.5 * w)


def test_the_tension_is_the_slope_of_the_energy_across_the_whole_range(world):
    at, w = world.positions, TAKE_UP * LENGTH
    offsets = at[[1]] + [0.0, 0.0, LENGTH]
    term, _ = world.springs(world.nodes(1), None, STIFFNESS, LENGTH, offsets=offsets,
                            is_thread=True)  # fmt: skip
    stretches = np.linspace(-0.5 * w, 3.0 * w, 15)
    moved = []
    for stretch in stretches:
        x = at.copy()
        x[1, 2] -= stretch
        pull, _, _ = law(LENGTH + stretch)
        assert world.forces(term, x)[0, 2] == pytest.approx(
            pull * (LENGTH + stretch), abs=1e-9 * STIFFNESS * w
        )
        moved.append(term.energy(x))
    assert (np.diff(moved) >= 0.0).all() and moved[0] == 0.0
    taut = 0.5 * STIFFNESS * (9.0 * w**2 - 3.0 * w**2 + w**2 / 3.0)
    assert moved[-1] == pytest.approx(taut)
