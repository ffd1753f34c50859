"""Facts of actuators that are commanded while the others are optimised around them."""

import numpy as np
import pytest

from softrobot_twin.errors import CommandError
from softrobot_twin.simulation import FollowTargets, Status
from test.builder import builder

WITH_ROD = pytest.mark.parametrize("with_rod", [False, True])


def settled(simulation, target, commanded=None, steps=60, time_step=0.05):
    """The result when nothing moves any more, or after so many steps."""
    before = simulation.state.positions
    for _ in range(steps):
        result = simulation.step(FollowTargets(target, time_step, commanded))
        if np.abs(result.state.positions - before).max() < 1e-12:
            break
        before = result.state.positions
    return result


def only(simulation, actuator, length):
    lengths = np.full(len(simulation.actuator_names), np.nan)
    lengths[actuator] = length
    return lengths


@builder
def reaching(beam, rod, /, with_rod):
    """A beam that has come to its target, the rod beyond it."""
    simulation = beam(lambda m: rod(m) if with_rod else None)
    target = simulation.effector_positions() + [0.004, 0.001, -0.006]
    return simulation, target, settled(simulation, target)


@WITH_ROD
def test_the_commanded_cable_is_at_its_command_in_every_step(reaching, with_rod):
    simulation, target, start = reaching(with_rod)
    for wound in np.linspace(0.0, 0.004, 30):
        length = start.setpoints[0] - wound
        result = settled(simulation, target, only(simulation, 0, length), 1)
        assert result.setpoints[0] == pytest.approx(length, abs=1e-12)
        assert not [name for name in result.report.active_limits if name.startswith("east")]


@WITH_ROD
def test_the_other_cables_are_optimal_given_the_command_in_every_step(reaching, with_rod):
    simulation, target, start = reaching(with_rod)
    for wound in np.linspace(0.0, 0.004, 15):
        commanded = only(simulation, 0, start.setpoints[0] - wound)
        once = settled(simulation, target, commanded, 1, 10.0).effector_errors[0]
        state = simulation.state
        best = settled(simulation, target, commanded, 30, 10.0).effector_errors[0]
        simulation.restore(state)
        assert once == pytest.approx(best, abs=2e-6)


@WITH_ROD
def test_a_command_never_makes_the_error_smaller(reaching, with_rod):
    simulation, _, _ = reaching(with_rod)
    target = simulation.effector_positions() + [0.01, 0.002, -0.002]
    free = settled(simulation, target)
    state = simulation.state
    errors = []
    for change in (-0.003, -0.001, 0.0, 0.001, 0.003):
        simulation.restore(state)
        commanded = only(simulation, 0, free.setpoints[0] + change)
        errors.append(settled(simulation, target, commanded).effector_errors[0])
    assert min(errors) > free.effector_errors[0] - 2e-6
    assert errors[2] == pytest.approx(free.effector_errors[0], abs=2e-6)


def test_a_command_that_fits_the_target_does_not_increase_the_error(reaching):
    """With four cables for three directions, one may be shortened with the others."""
    simulation, target, start = reaching(False)
    commanded = only(simulation, 3, start.setpoints[3])
    assert settled(simulation, target, commanded).effector_errors[0] < 1e-5


@WITH_ROD
def test_a_released_cable_is_slack_and_the_others_continue(reaching, with_rod):
    simulation, _, start = reaching(with_rod)
    # The tip should go away from the cable that is let out.
    target = simulation.effector_positions() + [-0.006, 0.0, 0.0]
    free = settled(simulation, target)
    result = settled(simulation, target, only(simulation, 0, simulation.rest_setpoints[0]))
    assert result.efforts[0] == 0.0
    assert result.setpoints[0] == pytest.approx(simulation.rest_setpoints[0], abs=1e-12)
    assert result.effector_errors[0] < free.effector_errors[0] + 1e-4


@WITH_ROD
def test_a_commanded_length_beyond_its_limit_stops_at_the_limit_and_is_reported(reaching, with_rod):
    simulation, target, start = reaching(with_rod)
    far = only(simulation, 0, simulation.rest_setpoints[0] - 1.0)
    first = settled(simulation, target, far, 1, 0.02)
    assert first.setpoints[0] == pytest.approx(start.setpoints[0] - 0.05 * 0.02, abs=1e-12)
    assert "east.rate" in first.report.active_limits
    last = settled(simulation, target, far)
    assert last.displacements[0] == pytest.approx(0.02, abs=1e-12)
    assert "east.shortening_max" in last.report.active_limits
    assert last.status is Status.SATURATED


@WITH_ROD
def test_with_every_actuator_commanded_the_targets_have_no_effect(reaching, with_rod):
    simulation, target, start = reaching(with_rod)
    wound = np.array([0.005, 0.002, 0.001, 0.0])
    result = settled(simulation, target, simulation.rest_setpoints - wound)
    np.testing.assert_allclose(result.displacements, wound, atol=1e-12)
    assert result.status is not Status.UNSOLVED


def test_commands_of_the_wrong_size_or_infinite_are_refused(reaching):
    simulation, target, _ = reaching(False)
    for wrong in (np.zeros(3), np.full(4, np.inf)):
        with pytest.raises(CommandError, match="commanded"):
            simulation.step(FollowTargets(target, 0.05, wrong))


def test_a_command_of_no_actuator_is_the_same_as_no_command(beam, rod):
    runs = []
    for commanded in (None, np.full(4, np.nan)):
        simulation = beam(rod)
        target = simulation.effector_positions() + [0.012, 0.0, -0.004]
        runs.append(settled(simulation, target, commanded, 20).state.positions)
    np.testing.assert_array_equal(*runs)


@WITH_ROD
def test_a_command_limited_by_its_rate_is_reported_as_not_yet_met(reaching, with_rod):
    simulation, target, start = reaching(with_rod)
    commanded = only(simulation, 0, start.setpoints[0] - 1e-4)
    # The rate is 0.05 m/s: two steps of a millisecond.
    first = settled(simulation, target, commanded, 1, 1e-3)
    assert first.status is Status.RATE_LIMITED and "east.rate" in first.report.active_limits
    second = settled(simulation, target, commanded, 1, 1e-3)
    assert second.status is Status.OK
