"""Facts of inverse steps: targets in, lengths and tensions out."""

import numpy as np
import pytest

from softrobot_twin.simulation import CommandSetpoints, FollowTargets, Status
from test.scene_changes import repeat_step


def reached(simulation, targets, time_step=10.0, steps=30):
    return repeat_step(simulation, FollowTargets(targets, time_step), steps)


def test_targets_in_the_workspace_are_met(diamond, circle):
    simulation = diamond()
    for targets in circle(12):
        result = reached(simulation, targets, steps=5)
        assert result.status.is_success
        assert result.effector_errors[0] < 1e-5


def test_the_energy_term_costs_less_than_a_hundredth_of_a_millimetre(diamond, circle):
    simulation = diamond()
    assert simulation.scene.solver.energy_weight == 1e-6
    worst = 0.0
    for radius, height in ((0.0, 0.130), (0.010, 0.135), (0.020, 0.135), (0.015, 0.145)):
        for targets in circle(6, radius, height):
            result = reached(simulation, targets, steps=8)
            assert result.status is Status.OK
            worst = max(worst, result.effector_errors[0])
    assert worst < 1e-5


def test_ten_times_the_energy_weight_costs_ten_times_the_error(diamond, circle):
    errors = []
    for weight in (1e-5, 1e-4):
        simulation = diamond(lambda m, w=weight: m.update(solver={"energy_weight": w}))
        errors.append(reached(simulation, circle(1)[0]).effector_errors[0])
    assert errors[1] / errors[0] == pytest.approx(10.0, rel=0.1)


def test_direct_steps_with_the_inverse_solution_give_the_same_state(diamond, circle, settle):
    inverse, direct = diamond(), diamond()
    result = reached(inverse, circle(1)[0], steps=40)
    same = settle(direct, CommandSetpoints(result.setpoints, 10.0))
    np.testing.assert_allclose(same.state.positions, result.state.positions, atol=1e-9)
    np.testing.assert_allclose(same.efforts, result.efforts, atol=1e-5)


@pytest.mark.exhaustive
def test_a_target_out_of_reach_is_approached_to_the_nearest_point_and_held(diamond):
    simulation = diamond()
    target = np.array([[0.6, 0.3, 0.125]])
    result = repeat_step(simulation, FollowTargets(target, 0.04), 100)
    there = result.effector_positions.copy()
    lengths = result.setpoints.copy()
    assert result.status is Status.SATURATED
    assert result.report.active_limits
    result = repeat_step(simulation, FollowTargets(target, 0.04), 1000)
    assert np.abs(result.effector_positions - there).max() < 1e-6
    assert np.abs(result.setpoints - lengths).max() < 1e-6
    # No admissible small change of a length comes nearer.
    state, limits = simulation.state, simulation.limits
    for cable in range(4):
        for change in (-5e-4, 5e-4):
            wanted = lengths.copy()
            wanted[cable] += change
            shortening = simulation.rest_setpoints - wanted
            if np.any(shortening < limits.displacement_min - 1e-9) or np.any(
                shortening > limits.displacement_max + 1e-9
            ):
                continue
            simulation.restore(state)
            moved = repeat_step(simulation, CommandSetpoints(wanted, 1.0), 10)
            distance = np.linalg.norm(moved.effector_positions - target)
            assert distance > result.effector_errors[0] - 2e-6


def test_ten_times_the_workspace_in_any_direction_is_a_status(diamond):
    for direction in np.vstack([np.eye(3), -np.eye(3), np.ones((1, 3))]):
        simulation = diamond()
        target = simulation.effector_positions() + 1.25 * direction
        for _ in range(60):
            result = simulation.step(FollowTargets(target, 0.04))
            assert np.all(np.isfinite(result.setpoints))
        assert result.status in (Status.SATURATED, Status.UNREACHABLE)


def test_a_jump_of_the_target_obeys_the_rates_and_keeps_its_direction(diamond, settle):
    simulation = diamond()
    start = repeat_step(simulation, FollowTargets(np.array([[0.0, 0.0, 0.140]]), 0.05), 20)
    jump = np.array([0.08, 0.06, 0.0])
    target = start.effector_positions + jump
    before = start.setpoints
    for _ in range(4):
        result = simulation.step(FollowTargets(target, 0.01))
        assert np.all(np.abs(result.setpoints - before) <= 0.05 * 0.01 + 1e-12)
        assert result.status is Status.RATE_LIMITED
        before = result.setpoints
    moved = (result.effector_positions - start.effector_positions)[0]
    cosine = moved @ jump / np.linalg.norm(moved) / np.linalg.norm(jump)
    assert cosine > 0.9


def test_the_same_cable_twice_shares_its_load(diamond, circle):
    def double(mapping):
        mapping["cables"].append({**mapping["cables"][0], "name": "north_again"})

    single, twice = diamond(), diamond(double)
    for targets in circle(6):
        one = reached(single, targets, steps=6)
        two = reached(twice, targets, steps=6)
        assert np.all(np.isfinite(two.efforts))
        np.testing.assert_allclose(two.effector_positions, one.effector_positions, atol=1e-5)
        assert two.efforts[0] == pytest.approx(two.efforts[4], abs=0.05)
        assert two.efforts[[0, 4]].sum() == pytest.approx(one.efforts[0], abs=0.05)


def test_more_actuators_than_directions_move_smoothly(diamond):
    simulation = diamond(lambda m: m["effectors"][0].update(directions=["x"]))
    lengths = []
    for x in np.linspace(0.0, 0.01, 60):
        targets = np.array([[x, np.nan, np.nan]])
        targets[0, 1:] = 0.0
        lengths.append(simulation.step(FollowTargets(targets, 0.1)).setpoints)
    steps = np.diff(np.array(lengths)[10:], axis=0)
    assert np.abs(np.diff(steps, axis=0)).max() < 1e-4
    assert simulation.step(FollowTargets(targets, 0.1)).effector_errors[0] < 1e-5


def test_an_effector_without_a_target_is_left_free(diamond):
    simulation = diamond()
    result = reached(simulation, np.full((1, 3), np.nan))
    assert result.status is Status.OK
    assert np.isnan(result.effector_errors[0])
    assert result.efforts == pytest.approx(result.efforts[0], abs=1e-3)


@pytest.mark.parametrize("seed", range(3))
def test_limits_hold_for_any_targets(diamond, seed):
    rng = np.random.default_rng(seed)
    simulation = diamond()
    before = simulation.state.setpoints
    limits = simulation.limits
    for _ in range(60):
        target = simulation.effector_positions() + rng.choice([0.01, 0.1, 10.0]) * (
            rng.standard_normal((1, 3))
        )
        time_step = rng.choice([0.005, 0.02])
        result = simulation.step(FollowTargets(target, time_step))
        assert np.all(np.abs(result.setpoints - before) <= limits.rate * time_step + 1e-9)
        assert np.all(result.displacements >= limits.displacement_min - 1e-9)
        assert np.all(result.displacements <= limits.displacement_max + 1e-9)
        assert np.all((result.efforts >= 0.0) & (result.efforts <= limits.effort_max + 1e-9))
        before = result.setpoints
