"""Facts of steps under a budget of time, with a clock that ticks when it is looked at."""

from __future__ import annotations

import copy

import numpy as np
import pytest

from softrobot_twin.scene import scene_from_mapping
from softrobot_twin.simulation import CommandSetpoints, FollowTargets, Hold, Simulation, Status
from test.builder import builder
from test.scene_changes import repeat_step


class FakeClock:
    """Every look at it takes a fixed time; a linearization looks six or seven times."""

    def __init__(self, look=1.0e-4):
        self.look = look
        self.time = 0.0

    def __call__(self) -> float:
        self.time += self.look
        return self.time


@builder
def timed(diamond, /) -> tuple[Simulation, FakeClock]:
    """The coarse Diamond on a fake clock; one linearization takes seven looks."""
    model = diamond()
    clock = FakeClock()
    mapping = copy.deepcopy(model.scene.model_dump(mode="json"))
    simulation = Simulation(scene_from_mapping(mapping, model.scene.path), now=clock)
    return simulation, clock


def pull(simulation, wound=0.015):
    return CommandSetpoints(simulation.rest_setpoints - wound, 10.0)


def test_a_step_without_time_still_linearizes_once(timed):
    simulation, _ = timed()
    assert simulation.step(pull(simulation), budget=0.0).report.iterations == 1


def test_remaining_time_is_used_to_reduce_the_residual(timed):
    residuals, iterations = [], []
    for budget in (0.0, 1.5e-3, 3.0e-3, 1.0):
        simulation, _ = timed()
        report = simulation.step(pull(simulation), budget=budget).report
        residuals.append(report.residual)
        iterations.append(report.iterations)
    assert iterations[0] == 1 and iterations[1] == 2 and iterations[2] == 4
    assert residuals[3] <= 1e-4 < residuals[0]
    assert residuals[3] < residuals[0]


def test_the_deadline_is_kept_once_a_linearization_was_timed(timed):
    simulation, _ = timed()
    simulation.step(Hold())
    for budget in (1.0e-3, 2.0e-3, 4.0e-3):
        for wound in np.linspace(0.0, 0.02, 15):
            report = simulation.step(pull(simulation, wound), budget=budget).report
            assert report.compute_time <= budget + 1e-9
            assert not report.is_overloaded


def test_iterations_stop_when_the_residual_is_small(timed):
    simulation, _ = timed()
    report = simulation.step(pull(simulation), budget=1e9).report
    again = simulation.step(Hold(), budget=1e9).report
    assert report.residual <= 1e-4 and again.iterations == 1


def test_overload_starts_is_reported_and_ends(timed):
    simulation, clock = timed()
    budget = 1.0e-3
    simulation.step(Hold(), budget=budget)
    clock.look = 1.0e-3
    ages = [simulation.step(Hold(), budget=budget).report.factor_age for _ in range(12)]
    assert ages[0] == 0, "the first slow step is the one that teaches"
    assert max(ages) > 1
    overloaded = [age > 0 for age in ages]
    assert overloaded[-1]
    clock.look = 1.0e-4
    for _ in range(400):
        report = simulation.step(Hold(), budget=budget).report
        if not report.is_overloaded:
            break
    assert not report.is_overloaded
    assert not simulation.step(Hold(), budget=budget).report.is_overloaded


def test_overload_reuses_the_factor_and_still_follows_targets(timed):
    simulation, clock = timed()
    reference, _ = timed()
    target = np.array([[0.005, 0.0, 0.135]])
    for _ in range(30):
        simulation.step(FollowTargets(target, 0.05))
        reference.step(FollowTargets(target, 0.05))
    clock.look = 1.0
    simulation.step(Hold(), budget=1e-3)
    for shift in np.linspace(0.0, 1e-3, 10):
        moved = target + [[shift, 0.0, 0.0]]
        result = simulation.step(FollowTargets(moved, 0.05), budget=1e-3)
        expected = reference.step(FollowTargets(moved, 0.05))
        assert result.report.is_overloaded and "factor" not in result.report.stage_times
        assert result.status in (Status.OK, Status.LINEARIZED)
        assert np.abs(result.effector_positions - expected.effector_positions).max() < 2e-5


def test_no_stale_factor_is_used_after_a_reset(timed):
    simulation, clock = timed()
    simulation.step(Hold(), budget=1e-3)
    clock.look = 1.0
    simulation.step(Hold(), budget=1e-3)
    assert simulation.step(Hold(), budget=1e-3).report.is_overloaded
    simulation.reset()
    assert simulation.step(Hold(), budget=1e-3).report.factor_age == 0


def test_newton_doubles_its_digits_near_a_solution(diamond):
    # Fixed tensions: no set of taut cables changes, and the tangent is exact.
    simulation = diamond(lambda m: [m.pop(key) for key in ("cables", "effectors", "markers")])
    repeat_step(simulation, Hold(), 8)
    state = simulation.state
    rng = np.random.default_rng(0)
    free = simulation.model.nodes.free_nodes
    shaken = state.positions.copy()
    shaken[free] += 2e-5 * rng.standard_normal((len(free), 3))
    simulation.restore(type(state)(shaken, state.setpoints, state.efforts))
    first, second, third = (simulation.step(Hold()).report.residual for _ in range(3))
    assert second < 100.0 * first**2
    assert third < max(100.0 * second**2, 1e-11)


def test_the_linearization_error_equals_the_correction_of_the_next_steps(diamond, settle):
    simulation = diamond()
    settle(simulation)
    simulation.step(CommandSetpoints(simulation.rest_setpoints - [0.01, 0, 0, 0], 10.0))
    before = simulation.effector_positions()
    report = simulation.step(Hold()).report
    settle(simulation)
    true_error = np.linalg.norm(simulation.effector_positions() - before)
    assert report.linearization_error == pytest.approx(true_error, rel=0.3)
    assert simulation.step(Hold()).report.linearization_error < 1e-9
