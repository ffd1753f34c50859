"""Where commands rest: at reached targets of redundant cables, and at the nearest place."""

import numpy as np
import pytest
from scipy.optimize import least_squares

import softrobot_twin as st
from test.cable_bar import LENGTH, WIDTH, cable_bar

# Steps of a run, and those at its end in which commands rest.
STEPS, LATE = 300, 60
RESTED = 1.0e-6


def cable(name, y, z, end=1.0, **limits):
    points = [[share * end * LENGTH, y, z] for share in (1 / 3, 2 / 3, 1.0)]
    return dict(name=name, pull_point=[0, y, z], points=points, **limits)


def beam(rng, cables):
    """A bent beam whose cables lift its tip."""
    radius, young = rng.uniform(0.002, 0.004), 10 ** rng.uniform(6, 7)
    angles = rng.uniform(0, 6.28) + 2 * np.pi * np.arange(cables) / cables
    scale = young * np.pi * radius**4 / 4 / LENGTH / (2 * radius)
    return st.build(
        name="beam", gravity=[0, 0, 0],
        beams=[dict(
            name="b", points=[[0, 0, 0], [LENGTH, 0, 0]], elements=8,
            section=dict(circle=dict(radius=float(radius))), fixed=["start"],
            material=dict(young_modulus=float(young), poisson_ratio=0.4, density=1100.0),
        )],
        cables=[
            dict(cable(f"c{i}", 2 * radius * np.cos(a), 2 * radius * np.sin(a)), body="b")
            for i, a in enumerate(angles)
        ],
        effectors=[dict(name="tip", points=[[LENGTH, 0, 0]], directions=["z"], body="b")],
        solver=dict(newton_iterations=3, residual_tolerance=1e-4 * max(float(scale), 1e-2)),
    )  # fmt: skip


def lengths(result, names):
    return np.array([result[f"{name}_length_m"] for name in names])


@pytest.mark.parametrize("case", range(3))
def test_commands_of_redundant_cables_rest(case, drawn_rng):
    rng = drawn_rng
    robot = beam(rng, int(rng.integers(2, 5)))
    goal = np.array([LENGTH * (1 - rng.uniform(0.02, 0.3)), 0.0, LENGTH * rng.uniform(-0.4, 0.4)])
    names, late = robot.simulation.actuators.names, []
    for step in range(STEPS):
        result = robot.step(st.targets(tip=goal.tolist()))
        if step >= STEPS - LATE:
            late.append(lengths(result, names))
            assert result.status.value in ("ok", "saturated", "unreachable"), step
    assert np.abs(np.diff(late, axis=0)).max() <= RESTED * LENGTH


def test_several_effectors_out_of_reach_rest_where_their_squared_distances_are_least():
    cables = [
        cable("up", WIDTH / 2, 0.9 * WIDTH), cable("down", WIDTH / 2, 0.1 * WIDTH),
        cable("short_up", WIDTH / 2, 0.9 * WIDTH, 0.6),
        cable("short_down", WIDTH / 2, 0.1 * WIDTH, 0.6),
    ]  # fmt: skip
    effectors = [
        dict(name="tip", points=[[LENGTH, WIDTH / 2, WIDTH / 2]], weight=1.0),
        dict(name="mid", points=[[0.6 * LENGTH, WIDTH / 2, WIDTH / 2]], weight=2.0),
    ]
    robot = cable_bar(cables, effectors, 5, 2e5, newton_iterations=30, residual_tolerance=1e-8)
    targets = dict(tip=[1.4 * LENGTH, 0.01, 2.0 * LENGTH], mid=[0.6 * LENGTH, 0.01, -0.3 * LENGTH])
    weights = np.repeat(np.sqrt([1.0, 2.0]), 3)
    result = robot.settle(st.targets(targets))
    assert result.status.value == "unreachable"

    def missed(found):
        apart = [np.array(found.effectors[name]) - place for name, place in targets.items()]
        return weights * np.concatenate(apart)

    names = [one["name"] for one in cables]
    begin, state = np.array([result[f"{name}_tension_N"] for name in names]), robot.state

    def at(tensions):
        robot.state = state
        given = {f"{name}_tension_N": float(t) for name, t in zip(names, tensions)}
        for _ in range(4):
            found = robot.step(st.efforts(given))
        return missed(found)

    best = least_squares(
        at, np.maximum(begin, 1e-6), bounds=(0.0, np.inf), diff_step=1e-4, x_scale=0.3, max_nfev=30
    )
    assert np.linalg.norm(missed(result)) <= 1.001 * np.linalg.norm(best.fun)
