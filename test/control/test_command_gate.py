"""What may leave."""

import numpy as np
import pytest

from softrobot_twin.control.command_gate import CommandGate
from softrobot_twin.simulation.limits import ActuatorLimits

REST = np.array([0.1, 0.2])
STEP = 0.1
LIMITS = ActuatorLimits(
    names=("a", "b"),
    displacement_min=np.array([0.0, 0.0]),
    displacement_max=np.array([0.05, 0.05]),
    rate=np.array([0.1, np.inf]),
    effort_min=np.zeros(2),
    effort_max=np.array([10.0, 20.0]),
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


@pytest.mark.parametrize(
    ("lengths", "tensions", "violated"),
    [
        (REST - [np.nan, 0.0], TENSIONS, "a.not_finite"),
        (REST, [1.0, np.inf], "b.not_finite"),
        (REST - [0.0, 0.051], TENSIONS, "b.shortening_max"),
        (REST + [0.0, 0.001], TENSIONS, "b.shortening_min"),
        (REST - [0.02, 0.0], TENSIONS, "a.rate"),
        (REST, [10.1, 2.0], "a.tension_max"),
        (REST, [1.0, -0.1], "b.tension_min"),
    ],
)
def test_a_command_outside_a_limit_is_kept_back_and_named(gate, lengths, tensions, violated):
    safe = gate.pass_on(REST - 0.001, TENSIONS, STEP).command
    passage = gate.pass_on(np.array(lengths), np.array(tensions), STEP)
    assert violated in passage.violated
    assert passage.command.setpoints.tolist() == safe.setpoints.tolist()
    assert passage.command.efforts.tolist() == safe.efforts.tolist()


def test_a_command_of_the_wrong_size_is_kept_back(gate):
    assert gate.pass_on(REST[:1], TENSIONS, STEP).violated == ("wrong_size",)


def test_before_the_first_command_the_cables_are_at_rest(gate):
    assert gate.pass_on(REST - [0.02, 0.0], TENSIONS, STEP).violated == ("a.rate",)


def test_the_rate_counts_from_where_the_cables_were_said_to_be(gate):
    gate.start_from(REST - [0.02, 0.0], TENSIONS)
    assert gate.pass_on(REST - [0.025, 0.0], TENSIONS, STEP).violated == ()
    assert gate.pass_on(REST, TENSIONS, STEP).violated == ("a.rate",)


def test_what_passed_cannot_be_changed_from_outside(gate):
    lengths = REST - 0.001
    gate.pass_on(lengths, TENSIONS, STEP)
    lengths[:] = np.nan
    assert np.isfinite(gate.pass_on(lengths, TENSIONS, STEP).command.setpoints).all()
