"""Cables without limits at the last gate: what is not finite is stopped all the same."""

import math

import numpy as np
import pytest

from softrobot_twin.control.command_gate import CommandGate
from softrobot_twin.simulation.limits import ActuatorLimits

REST = np.array([0.1, 0.2])


@pytest.fixture
def gate():
    """A gate of two cables; the first has no limit, the second one of tension only."""
    open_end = np.full(2, math.inf)
    limits = ActuatorLimits(
        ("a", "b"), -open_end, REST, open_end, np.zeros(2), np.array([math.inf, 5.0])
    )
    return CommandGate(limits.names, REST, limits)


def test_what_is_finite_passes_where_there_is_no_limit(gate):
    assert gate.pass_on(np.array([1e3, 0.0]), np.array([1e6, 5.0]), 0.02).violated == ()


@pytest.mark.parametrize("lengths, tensions, violated", [
    ([math.inf, 0.2], [0.0, 0.0], "a.not_finite"),
    ([math.nan, 0.2], [0.0, 0.0], "a.not_finite"),
    ([0.1, 0.2], [math.inf, 0.0], "a.not_finite"),
    ([0.1, 0.2], [0.0, 6.0], "b.tension_max"),
    ([0.1, 0.2], [-1.0, 0.0], "a.tension_min"),
    ([-0.01, 0.2], [0.0, 0.0], "a.shortening_max"),
])  # fmt: skip
def test_what_cannot_be_is_stopped(gate, lengths, tensions, violated):
    passage = gate.pass_on(np.array(lengths), np.array(tensions), 0.02)
    assert violated in passage.violated
    np.testing.assert_array_equal(passage.command.setpoints, REST)
