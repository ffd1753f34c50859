"""Statics from rest finds the balance that small steps lead to, upright, where bodies nearly fold."""

import numpy as np
import pytest

from softrobot_twin.simulation import CommandEfforts, FollowTargets, Hold, Status
from test.builder import builder

LAWS = ["corotational", "neo_hookean"]
ELEMENTS = ["linear", "quadratic", "hexahedral"]


def held_at_its_root(size, cells, element, law, young_modulus):
    """The entry of a bar along x."""
    return {
        "mesh": {"box": {"size": size, "cells": cells}}, "element": element,
        "material": {"law": law, "young_modulus": young_modulus, "poisson_ratio": 0.36,
                     "density": 1000.0},
        "fixed": [{"box": {"minimum": [-1e-6, -1.0, -1.0], "maximum": [1e-6, 1.0, 1.0]}}],
    }  # fmt: skip


def balanced(simulation, command, most_steps):
    """Positions after steps with a command until they are in balance, which is asserted, and that
    all elements are upright.
    """
    for _ in range(most_steps):
        result = simulation.step(command)
        assert result.report.inverted_count == 0
        if result.status in (Status.OK, Status.SATURATED):
            assert result.report.residual <= simulation.scene.solver.residual_tolerance
            return result.state.positions.copy()
    raise AssertionError(f"{result.status} after {most_steps} steps")


@pytest.mark.sampled
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("element", ELEMENTS)
def test_one_tension_at_a_point_leads_where_small_steps_lead(element, law, simulate, drawn_rng):
    point = [0.025, 0.025]
    simulation = simulate(
        gravity=[0.0, 0.0, 0.0],
        body=held_at_its_root([0.06, 0.03, 0.03], [4, 2, 2], element, law, 4e4),
        cables=[{"name": "cable", "pull_point": [0.0, *point], "points": [[0.03, *point], [0.06, *point]]}],
        solver={"newton_iterations": 50, "residual_tolerance": 1e-8},
    )  # fmt: skip
    for tension in (drawn_rng.uniform(0.1, 2.0), drawn_rng.uniform(2.1, 3.0)):
        simulation.reset()
        for part in np.arange(0.05, tension, 0.05):
            balanced(simulation, CommandEfforts(np.array([part]), 0.05), 4)
        command = CommandEfforts(np.array([tension]), 0.05)
        expected = balanced(simulation, command, 4)
        simulation.reset()
        np.testing.assert_allclose(balanced(simulation, command, 1), expected, atol=1e-7)
    # Let go, it is as it was.
    back = balanced(simulation, CommandEfforts(np.zeros(1), 0.05), 4)
    np.testing.assert_allclose(back, simulation.model.nodes.rest_positions, atol=1e-7)


@builder
def bar(simulate, /, element, law, young_modulus, cable_count):
    """Makes a bar of 200 mm under its weight, with four cables or without."""
    size = 0.03
    corners = [(0.0, 0.0), (size, 0.0), (0.0, size), (size, size)][:cable_count]
    entries = {
        "cables": [
            {"name": f"cable_{k}", "pull_point": [-0.01, y, z],
             "points": [[0.1, y, z], [0.2, y, z]]}
            for k, (y, z) in enumerate(corners)
        ],
        "effectors": [{"name": "tip", "points": [[0.2, size / 2, size / 2]]}],
    } if cable_count else {}  # fmt: skip
    return simulate(
        gravity=[0.0, 0.0, -9.81],
        body=held_at_its_root([0.2, size, size], [8, 2, 2], element, law, young_modulus),
        solver={"newton_iterations": 10, "residual_tolerance": 1e-8}, **entries,
    )  # fmt: skip


@pytest.mark.sampled
@pytest.mark.parametrize("cable_count", [0, 4])
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("element", ELEMENTS)
def test_a_bar_that_was_straight_comes_to_balance_where_it_sags_most(
    element, law, cable_count, bar, drawn_rng
):
    # Below 3 kPa there may be several balances.
    softest = np.exp(drawn_rng.uniform(np.log(1500.0), np.log(3000.0)))
    assert balanced(bar(element, law, softest, cable_count), Hold(0.05), 25)[:, 2].min() < -0.15


@pytest.mark.sampled
@pytest.mark.parametrize("cable_count", [0, 4])
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("element", ELEMENTS)
def test_a_soft_bar_that_was_straight_sags_to_where_a_stiff_one_sags_as_it_softens(
    element, law, cable_count, bar, drawn_rng
):
    softest = np.exp(drawn_rng.uniform(np.log(3000.0), np.log(6000.0)))
    found, state = balanced(bar(element, law, softest, cable_count), Hold(0.05), 25), None
    for young_modulus in softest * np.geomspace(8.0, 1.0, 8):
        softening = bar(element, law, young_modulus, cable_count)
        if state is not None:
            softening.restore(state)
        # On its way a bar with cables may be nearly indifferent to its side.
        expected = balanced(softening, Hold(0.05), 100)
        state = softening.state
    np.testing.assert_allclose(found, expected, atol=1e-6)


@pytest.mark.sampled
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("element", ["linear", "smoothed", "quadratic"])
def test_a_column_that_just_buckles_comes_to_rest_within_ten_steps(element, law, simulate, drawn_rng):
    def column(young_modulus, lean):
        return simulate(
            gravity=[-9.81, lean * 9.81, 0.0],
            body=held_at_its_root([0.2, 0.02, 0.03], [10, 2, 2], element, law, young_modulus),
            solver={"newton_iterations": 10, "residual_tolerance": 1e-7},
        )

    buckling, standing = 1e5, 4e5
    for _ in range(14):
        middle = np.sqrt(buckling * standing)
        upright = column(middle, 0.0)
        upright.step(Hold(0.05))
        if upright.newton.tangent.is_projected:
            buckling = middle
        else:
            standing = middle
    for weaker in np.exp(drawn_rng.uniform(np.log(2e-4), np.log(0.1), 5)):
        leaning = column(buckling * (1.0 - weaker), 1e-4)
        aside = balanced(leaning, Hold(0.05), 10)[:, 1] - leaning.model.nodes.rest_positions[:, 1]
        assert 0.01 < aside.max() < 0.15 and not leaning.newton.tangent.is_projected


@pytest.mark.sampled
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("element", ["quadratic", "hexahedral"])
def test_no_step_of_a_sagging_bar_towards_a_target_is_refused_or_folds(element, law, bar, drawn_rng):
    simulation = bar(element, law, np.exp(drawn_rng.uniform(np.log(1500.0), np.log(3000.0))), 4)
    target = drawn_rng.uniform([0.0, 0.0, -0.2], [0.15, 0.03, -0.02])
    for _ in range(30):
        result = simulation.step(FollowTargets(target[None], 0.05))
        assert not result.status.is_failure and result.status is not Status.INVERTED
