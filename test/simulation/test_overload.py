"""Facts of steps that have no time for a linearization, with a clock that makes each one late."""


import copy
import math

import numpy as np
import pytest

from softrobot_twin.scene import scene_from_mapping
from softrobot_twin.simulation import CommandSetpoints, FollowTargets, Hold, Simulation, Status
from softrobot_twin.simulation.step.step_report import NEAR_BALANCE
from test.builder import builder

BUDGET = 1.0e-6
PERIOD = 0.01


class SlowClock:
    """Every look at it takes a second."""

    def __init__(self):
        self.time = 0.0

    def __call__(self) -> float:
        self.time += 1.0
        return self.time


@builder
def overloaded(model) -> Simulation:
    """Builds the scene of a simulation again, where not even one linearization is on time."""
    mapping = copy.deepcopy(model.scene.model_dump(mode="json"))
    simulation = Simulation(scene_from_mapping(mapping, model.scene.path), now=SlowClock())
    simulation.step(Hold(PERIOD), budget=BUDGET)
    return simulation


def on_the_path(time: float) -> np.ndarray:
    """A circle and a lemniscate, by turns of four seconds and without a jump [m]."""
    angle = 2.0 * math.pi * time / 4.0
    if (time // 4.0) % 2 == 0:
        return np.array([[0.02 * math.cos(angle), 0.02 * math.sin(angle), 0.136]])
    return np.array([[0.02 * math.cos(angle), -0.01 * math.sin(2.0 * angle), 0.136]])


def test_in_overload_the_tip_stays_on_a_circle_and_a_lemniscate(diamond, overloaded):
    simulation = overloaded(diamond())
    late, worst = 0, 0.0
    for _ in range(60):
        simulation.step(FollowTargets(on_the_path(0.0), PERIOD), budget=BUDGET)
    for tick in range(800):
        target = on_the_path(tick * PERIOD)
        result = simulation.step(FollowTargets(target, PERIOD), budget=BUDGET)
        assert result.report.is_overloaded
        assert result.status in (Status.OK, Status.LINEARIZED)
        late += result.report.is_late
        worst = max(worst, result.effector_errors[0])
    # The paper's bar is 5 mm.
    assert worst < 5e-5
    assert late < 400


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("robot", ["diamond", "beam"])
def test_noisy_and_jumping_targets_invert_no_element(request, overloaded, robot, seed):
    simulation = overloaded(request.getfixturevalue(robot)())
    rng, size = np.random.default_rng(seed), simulation.model.nodes.size
    home = simulation.effector_positions()
    for tick in range(200):
        if tick % 50 == 0:
            goal = home + 0.1 * size * rng.uniform(-1.0, 1.0, home.shape)
        target = goal + rng.normal(0.0, 0.01 * size, home.shape)
        result = simulation.step(FollowTargets(target, PERIOD), budget=BUDGET)
        report = result.report
        assert not result.status.is_failure and result.status is not Status.INVERTED
        assert report.is_overloaded and report.is_late == (report.factor_age == 0)
        if report.factor_age:
            near = NEAR_BALANCE * (simulation.newton.balance.constant_load + result.efforts.sum())
            # Slack cables load nothing: then it is in balance as exactly as the scene asks for.
            assert report.residual <= max(near, simulation.model.scene.solver.residual_tolerance)


@pytest.mark.parametrize("seed", range(4))
def test_a_stale_factor_without_progress_leads_to_a_full_step_that_is_late(diamond, overloaded, seed):
    """Commanded far enough, a step with a stale factor is given up, and nothing is left of it."""
    rng = np.random.default_rng(seed)
    whole, hurried = diamond(), overloaded(diamond())
    whole.step(Hold(PERIOD))
    given_up = 0
    for share in (0.001, 0.01, 1.0):
        wound = 0.02 * share * rng.uniform(size=4)
        command = CommandSetpoints(whole.rest_setpoints - wound, 100.0)
        state = hurried.state
        expected, result = whole.step(command), hurried.step(command, budget=BUDGET)
        if result.report.is_late:
            given_up += 1
            np.testing.assert_array_equal(result.state.positions, expected.state.positions)
        else:
            way = np.abs(expected.state.positions - state.positions).max()
            off = np.abs(result.state.positions - expected.state.positions).max()
            assert off <= 0.5 * way
        whole.restore(hurried.state)
    assert given_up


def test_in_overload_a_state_at_rest_costs_one_late_step_and_then_none(diamond, overloaded):
    """The factor is made once more, at the state that is kept; then no step is made, nor late."""
    simulation, reports = overloaded(diamond()), []
    for _ in range(80):
        result = simulation.stay(Hold(PERIOD)) or simulation.step(Hold(PERIOD), budget=BUDGET)
        reports.append(result.report)
    first = [report.is_resting for report in reports].index(True)
    assert first <= 30 and all(report.is_resting for report in reports[first:])
    assert not any(report.is_overloaded or report.is_late for report in reports[first:])
    assert sum(report.is_late for report in reports[1:]) == 1


def test_in_contact_a_step_without_time_is_reported_as_late(coarse_trunk, overloaded):
    simulation = overloaded(coarse_trunk())
    target = simulation.effector_positions()
    for _ in range(3):
        report = simulation.step(FollowTargets(target, PERIOD), budget=BUDGET).report
        assert report.is_overloaded and report.is_late and report.factor_age == 0


def test_a_step_on_time_is_not_reported_as_late(diamond):
    simulation = diamond()
    for budget in (None, 1e9):
        report = simulation.step(Hold(PERIOD), budget=budget).report
        assert not report.is_overloaded and not report.is_late
