"""Which commands pass the gate."""

import math

import numpy as np
import pytest

from softrobot_twin.control.command_gate import EFFORT_SHARE, SETPOINT_SHARE, CommandGate
from softrobot_twin.simulation.building.limits import ActuatorLimits

REST = np.array([0.1, 0.2])
CABLES = {"slopes": -np.ones(2), "is_effort_driven": np.zeros(2, bool),
          "limit_names": (("shortening_min", "shortening_max"),) * 2,
          "effort_words": ("tension",) * 2}  # fmt: skip
STEP = 0.1
LIMITS = ActuatorLimits(
    names=("a", "b"),
    displacement_min=np.array([0.0, 0.0]),
    displacement_max=np.array([0.05, 0.05]),
    rate=np.array([0.1, np.inf]),
    effort_min=np.zeros(2),
    effort_max=np.array([10.0, 20.0]),
    displacement_scale=REST, effort_scale=np.array([10.0, 20.0]), **CABLES,
)
TENSIONS = np.array([1.0, 2.0])


@pytest.fixture
def gate():
    return CommandGate(LIMITS.names, REST, LIMITS)


def test_a_command_within_all_limits_passes_unchanged(gate):
    passage = gate.pass_on(REST - [0.01, 0.05], TENSIONS, STEP)
    assert passage.violated == ()
    assert passage.command.setpoints.tolist() == (REST - [0.01, 0.05]).tolist()
    assert passage.command.efforts.tolist() == TENSIONS.tolist()


@pytest.mark.parametrize("lengths, tensions, violated", [
    (REST - [np.nan, 0.0], TENSIONS, "a.not_finite"),
    (REST, [1.0, np.inf], "b.not_finite"),
    (REST - [0.0, 0.051], TENSIONS, "b.shortening_max"),
    (REST + [0.0, 0.001], TENSIONS, "b.shortening_min"),
    (REST - [0.02, 0.0], TENSIONS, "a.rate"),
    (REST, [10.1, 2.0], "a.tension_max"),
    (REST, [1.0, -0.1], "b.tension_min"),
])  # fmt: skip
def test_a_command_outside_a_limit_is_blocked_and_named(gate, lengths, tensions, violated):
    safe = gate.pass_on(REST - 0.001, TENSIONS, STEP).command
    passage = gate.pass_on(np.array(lengths), np.array(tensions), STEP)
    assert violated in passage.violated
    assert passage.command.setpoints.tolist() == safe.setpoints.tolist()
    assert passage.command.efforts.tolist() == safe.efforts.tolist()


def test_a_command_of_the_wrong_size_is_blocked(gate):
    assert gate.pass_on(REST[:1], TENSIONS, STEP).violated == ("wrong_size",)


def test_before_the_first_command_the_cables_are_at_rest(gate):
    assert gate.pass_on(REST - [0.02, 0.0], TENSIONS, STEP).violated == ("a.rate",)


def test_the_rate_counts_from_the_measured_cable_lengths(gate):
    gate.start_from(REST - [0.02, 0.0], TENSIONS)
    assert gate.pass_on(REST - [0.025, 0.0], TENSIONS, STEP).violated == ()
    assert gate.pass_on(REST, TENSIONS, STEP).violated == ("a.rate",)


def test_a_passed_command_cannot_be_changed_from_outside(gate):
    lengths = REST - 0.001
    gate.pass_on(lengths, TENSIONS, STEP)
    lengths[:] = np.nan
    assert np.isfinite(gate.pass_on(lengths, TENSIONS, STEP).command.setpoints).all()


OPEN_REST = np.array([0.1, 0.2])


@pytest.fixture
def open_gate():
    """A gate of two cables; the first has no limit, the second one of tension only."""
    open_end = np.full(2, math.inf)
    limits = ActuatorLimits(
        ("a", "b"), -open_end, OPEN_REST, open_end, np.zeros(2), np.array([math.inf, 5.0]),
        OPEN_REST, np.array([5.0, 5.0]), **CABLES,
    )
    return CommandGate(limits.names, OPEN_REST, limits)


def test_any_finite_command_passes_where_there_is_no_limit(open_gate):
    assert open_gate.pass_on(np.array([1e3, 0.0]), np.array([1e6, 5.0]), 0.02).violated == ()


@pytest.mark.parametrize("lengths, tensions, violated", [
    ([math.inf, 0.2], [0.0, 0.0], "a.not_finite"),
    ([math.nan, 0.2], [0.0, 0.0], "a.not_finite"),
    ([0.1, 0.2], [math.inf, 0.0], "a.not_finite"),
    ([0.1, 0.2], [0.0, 6.0], "b.tension_max"),
    ([0.1, 0.2], [-1.0, 0.0], "a.tension_min"),
    ([-0.01, 0.2], [0.0, 0.0], "a.shortening_max"),
])  # fmt: skip
def test_impossible_commands_are_blocked(open_gate, lengths, tensions, violated):
    passage = open_gate.pass_on(np.array(lengths), np.array(tensions), 0.02)
    assert violated in passage.violated
    np.testing.assert_array_equal(passage.command.setpoints, OPEN_REST)


# --- tolerances are relative ------------------------------------------------------------------


def scaled_gate(length, force):
    """The gate of `gate`, with lengths and forces multiplied."""
    limits = ActuatorLimits(
        LIMITS.names, length * LIMITS.displacement_min, length * LIMITS.displacement_max,
        length * LIMITS.rate, force * LIMITS.effort_min, force * LIMITS.effort_max,
        length * LIMITS.displacement_scale, force * LIMITS.effort_scale, **CABLES,
    )  # fmt: skip
    return CommandGate(limits.names, length * REST, limits)


@pytest.mark.parametrize("length", [1e-3, 1.0, 1e2])
@pytest.mark.parametrize("force", [1e-6, 1.0, 1e4])
@pytest.mark.parametrize("beyond, stronger, violated", [
    (0.9 * SETPOINT_SHARE, 0.9 * EFFORT_SHARE, ()),
    (1.1 * SETPOINT_SHARE, 0.0, ("b.shortening_min",)),
    (0.0, 1.1 * EFFORT_SHARE, ("b.tension_max",)),
])  # fmt: skip
def test_a_robot_of_another_scale_has_the_same_limits(length, force, beyond, stronger, violated):
    travel, greatest = LIMITS.displacement_max[1], LIMITS.effort_max[1]
    setpoints = length * (REST + [0.0, beyond * travel])
    efforts = force * (np.array([1.0, greatest]) + [0.0, stronger * greatest])
    passage = scaled_gate(length, force).pass_on(setpoints, efforts, STEP)
    assert passage.violated == violated
    # A command that exceeds a limit by less than the tolerance is cut to it.
    if not violated:
        assert passage.command.setpoints == pytest.approx(length * REST, rel=1e-12)
        assert passage.command.efforts[1] == force * greatest


def test_without_an_effort_limit_only_non_finite_efforts_are_blocked():
    limits = ActuatorLimits(
        LIMITS.names, LIMITS.displacement_min, LIMITS.displacement_max, LIMITS.rate,
        np.zeros(2), np.full(2, math.inf), REST, np.full(2, 20.0), **CABLES,
    )  # fmt: skip
    gate = CommandGate(limits.names, REST, limits)
    passage = gate.pass_on(REST, np.array([-1e-12, 1e6]), STEP)
    assert passage.violated == () and passage.command.efforts.tolist() == [0.0, 1e6]
    assert gate.pass_on(REST, np.array([math.inf, 0.0]), STEP).violated == ("a.not_finite",)


# --- measured outside the limits --------------------------------------------------------------


def test_an_actuator_measured_far_outside_returns_as_fast_as_its_rate_allows(gate):
    # It is asked to be at its limit at once, which is further than its rate allows.
    gate.start_from(REST + [0.035, 0.0], TENSIONS)
    assert gate.is_outside
    returned = []
    while gate.is_outside and len(returned) < 9:
        passage = gate.pass_on(REST, TENSIONS, STEP)
        assert passage.violated == ()
        returned.append(passage.command.setpoints[0] - REST[0])
    assert returned == pytest.approx([0.025, 0.015, 0.005, 0.0], abs=1e-12)
    assert gate.pass_on(REST - [0.02, 0.0], TENSIONS, STEP).violated == ("a.rate",)


@pytest.mark.parametrize("seed", range(8))
def test_every_command_passes_or_is_named_and_never_leaves_too_fast(gate, seed):
    """Whatever was measured and is commanded: within the limits, or returning to them."""
    random = np.random.default_rng(seed)
    low, high, reach = REST - LIMITS.displacement_max, REST, LIMITS.reach(STEP)
    for _ in range(200):
        before = REST + random.normal(0.0, 0.03, 2)
        gate.start_from(before, TENSIONS)
        wanted = np.clip(REST + random.normal(-0.02, 0.05, 2), low, high)
        wanted += random.choice([0.0, 1e-6, 0.01]) * random.normal(size=2)
        passage = gate.pass_on(wanted, TENSIONS, STEP)
        beyond = gate.tolerances.setpoints
        was_outside = (before < low - beyond) | (before > high + beyond)
        is_kept = (wanted >= low - beyond) & (wanted <= high + beyond)
        is_slow = (np.abs(wanted - before) <= reach + beyond) | was_outside
        assert (passage.violated == ()) == bool((is_kept & is_slow).all())
        if passage.violated and not was_outside.any():
            expected = before
        else:
            aim = before if passage.violated else wanted
            expected = np.clip(np.clip(aim, low, high), before - reach, before + reach)
        assert passage.command.setpoints == pytest.approx(expected, abs=1e-12)
        outside = np.abs(np.clip(expected, low, high) - expected) > beyond
        assert gate.is_outside == outside.any()
