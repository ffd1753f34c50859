"""Facts of direct steps: cables by length and by tension."""

import numpy as np
import pytest

from softrobot_twin.errors import CommandError
from softrobot_twin.simulation import CommandEfforts, CommandSetpoints, Hold, Status
from test.scene_changes import LEFT_OUT, changed, repeat_step

PULL = np.array([0.012, 0.004, 0.0, 0.009])


def test_newton_converges_faster_than_linearly(diamond):
    simulation = diamond()
    simulation.step(CommandSetpoints(simulation.rest_setpoints - PULL, 1.0))
    repeat_step(simulation, Hold(), 2)
    residuals = [simulation.step(Hold()).report.residual for _ in range(3)]
    assert residuals[1] < 5e-2 * residuals[0]
    assert residuals[2] < 1e-4 * residuals[1]


def test_prescribed_lengths_are_met(diamond, settle):
    simulation = diamond()
    command = CommandSetpoints(simulation.rest_setpoints - PULL, 10.0)
    result = settle(simulation, command)
    assert result.status is Status.OK
    lines = simulation.actuator_paths().values()
    paths = [np.linalg.norm(np.diff(line, axis=0), axis=1).sum() for line in lines]
    taut = result.efforts > 1e-6
    np.testing.assert_allclose(np.array(paths)[taut], command.setpoints[taut], atol=1e-10)
    assert np.all(np.array(paths)[~taut] <= command.setpoints[~taut] + 1e-10)


def test_length_and_tension_control_reach_the_same_state(diamond, settle):
    by_length, by_tension = diamond(), diamond()
    first = settle(by_length, CommandSetpoints(by_length.rest_setpoints - PULL, 10.0))
    second = settle(by_tension, CommandEfforts(first.efforts, 10.0), steps=80)
    np.testing.assert_allclose(second.state.positions, first.state.positions, atol=1e-7)
    taut = first.efforts > 1e-6
    np.testing.assert_allclose(second.setpoints[taut], first.setpoints[taut], atol=1e-7)


def test_a_ramp_through_zero_tension_does_not_chatter(diamond, settle):
    simulation = diamond(lambda m: [c.update(shortening=[-0.03, 0.04]) for c in m["cables"]])
    settle(simulation)
    slack_ramp = np.concatenate([np.linspace(0, -0.015, 40), np.linspace(-0.015, 0, 40)])
    tensions = []
    for wound in slack_ramp:
        lengths = simulation.rest_setpoints - [wound, 0, 0, 0]
        simulation.step(CommandSetpoints(lengths, 10.0))
        tensions.append(simulation.step(Hold()).efforts[0])
    tensions = np.array(tensions)
    assert np.all(tensions >= 0.0)
    assert tensions[0] > 0.5 and tensions[39] == 0.0
    # Down once, up once: no step back and forth.
    signs = np.sign(np.diff(tensions))
    signs = signs[np.abs(np.diff(tensions)) > 1e-6]
    assert np.count_nonzero(np.diff(signs)) == 1


def test_a_slack_cable_keeps_its_prescribed_length(diamond, settle):
    simulation = diamond(lambda m: [c.update(shortening=[-0.03, 0.04]) for c in m["cables"]])
    lengths = simulation.rest_setpoints + [0.02, 0.0, 0.0, 0.0]
    result = settle(simulation, CommandSetpoints(lengths, 10.0))
    assert result.efforts[0] == 0.0
    assert result.setpoints[0] == pytest.approx(lengths[0])


@pytest.mark.parametrize("asked", [0.5, -0.5])
def test_a_demand_outside_its_limits_is_reported_and_not_carried_out(diamond, asked):
    simulation = diamond()
    command = CommandSetpoints(simulation.rest_setpoints - [asked, 0, 0, 0], 100.0)
    result = simulation.step(command)
    name = "north.shortening_max" if asked > 0 else "north.shortening_min"
    assert name in result.report.active_limits
    # All at once is too far for one linearization, which the limit must not hide.
    assert result.status is (Status.NOT_CONVERGED if asked > 0 else Status.SATURATED)
    result = repeat_step(simulation, command, 5)
    assert result.status is Status.SATURATED
    assert name in result.report.active_limits
    low, high = simulation.limits.displacement_min[0], simulation.limits.displacement_max[0]
    assert low <= result.displacements[0] <= high


def test_rate_limits_hold_in_every_step(diamond):
    simulation = diamond()
    before = simulation.state.setpoints
    for _ in range(10):
        result = simulation.step(CommandSetpoints(simulation.rest_setpoints - 0.03, 0.02))
        assert np.all(np.abs(result.setpoints - before) <= 0.05 * 0.02 + 1e-12)
        assert result.status is Status.RATE_LIMITED
        assert "north.rate" in result.report.active_limits
        before = result.setpoints


def test_a_greatest_tension_is_never_exceeded(diamond, settle):
    simulation = diamond(lambda m: m["cables"][0].update(tension=[0.0, 2.0]))
    result = settle(simulation, CommandSetpoints(simulation.rest_setpoints - [0.03, 0, 0, 0], 10.0))
    assert result.efforts[0] <= 2.0 + 1e-9
    assert "north.tension_max" in result.report.active_limits


def test_tension_control_stops_at_the_length_limits(diamond, settle):
    simulation = diamond()
    result = settle(simulation, CommandEfforts(np.array([15.0, 0, 0, 0]), 100.0), steps=80)
    assert result.displacements[0] <= 0.040 + 1e-9
    assert result.status is Status.SATURATED


@pytest.mark.parametrize("time_step", [1e-4, 1e-2, 1.0])
def test_the_same_equilibrium_at_any_time_step(diamond, settle, time_step):
    without_rates = changed({"cables.*.rate": LEFT_OUT})
    simulation, reference = diamond(without_rates), diamond(without_rates)
    lengths = simulation.rest_setpoints - PULL
    found = settle(simulation, CommandSetpoints(lengths, time_step))
    expected = settle(reference, CommandSetpoints(lengths, 0.05))
    np.testing.assert_allclose(found.state.positions, expected.state.positions, atol=1e-10)
    np.testing.assert_allclose(found.efforts, expected.efforts, atol=1e-6)


@pytest.mark.parametrize("command", [
    lambda s: CommandSetpoints(np.zeros(3), 0.1),
    lambda s: CommandSetpoints(np.full(4, np.nan), 0.1),
    lambda s: CommandEfforts(np.full(4, np.inf), 0.1),
    lambda s: CommandEfforts(np.full(4, np.nan), 0.1),
    lambda s: CommandSetpoints(s.rest_setpoints, float("nan")),
    lambda s: CommandSetpoints(s.rest_setpoints, -1.0),
    lambda s: "pull",
])  # fmt: skip
def test_an_invalid_command_is_refused_and_changes_nothing(diamond, command):
    simulation = diamond()
    before = simulation.state
    with pytest.raises((CommandError)):
        simulation.step(command(simulation))
    assert simulation.state is before


def test_holding_keeps_lengths_also_without_a_rate_limit(diamond, recwarn):
    simulation = diamond(lambda m: [cable.pop("rate") for cable in m["cables"]])
    simulation.step(CommandSetpoints(simulation.rest_setpoints - PULL, 0.1))
    before = simulation.state.setpoints
    np.testing.assert_array_equal(simulation.step(Hold()).setpoints, before)
    assert not recwarn.list
