"""The summary of the ticks since the last diagnostics message."""

from dataclasses import replace

import pytest

from softrobot_twin.control.diagnostics_window import DiagnosticsWindow
from softrobot_twin.simulation import Status


@pytest.fixture
def outcome(drive):
    return drive().tick()


def changed(outcome, status=Status.OK, residual=0.0, **fields):
    report = replace(outcome.result.report, residual=residual, active_limits=("east.rate",))
    return outcome._replace(result=replace(outcome.result, status=status, report=report), **fields)


def test_the_worst_status_is_reported_and_not_only_the_newest(outcome):
    window = DiagnosticsWindow()
    window.add(changed(outcome, Status.SATURATED, 1.0))
    window.add(changed(outcome, Status.UNSOLVED, 3.0, violated=("east.rate",)))
    window.add(changed(outcome, Status.OK, 2.0))
    assert (window.worst, window.largest["residual"], window.ticks) == (Status.UNSOLVED, 3.0, 3)
    assert window.limits == {"east.rate"}
    assert (window.blocked, window.violated) == (1, {"east.rate"})
    assert window.causes == {"no target yet": 3}
    assert window.newest.result.status is Status.OK


def test_steps_are_counted_by_their_status_until_clear(outcome):
    window = DiagnosticsWindow()
    for status in (Status.OK, Status.LINEARIZED, Status.OK):
        window.add(changed(outcome, status))
    assert window.statuses == {"ok": 2, "linearized": 1}
    window.clear()
    assert window.statuses == {}


@pytest.mark.parametrize("status", Status)
def test_every_status_can_be_reported(outcome, status):
    window = DiagnosticsWindow()
    window.add(changed(outcome, status))
    assert window.worst is status


def test_a_step_that_had_to_be_late_counts_as_overload(outcome):
    window = DiagnosticsWindow()
    for late in (False, True, True):
        report = replace(outcome.result.report, is_late=late)
        window.add(outcome._replace(result=replace(outcome.result, report=report)))
    assert (window.overloaded, window.late, window.ticks) == (2, 2, 3)
