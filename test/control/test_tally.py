"""What happened since it was last told."""

import math
from dataclasses import replace

import pytest

from softrobot_twin.control.tally import Tally
from softrobot_twin.simulation import Status


@pytest.fixture
def outcome(drive):
    return drive().tick()


def changed(outcome, status=Status.OK, residual=0.0, **fields):
    report = replace(outcome.result.report, residual=residual, active_limits=("east.rate",))
    return outcome._replace(result=replace(outcome.result, status=status, report=report), **fields)


def test_the_worst_is_told_and_not_only_the_newest(outcome):
    tally = Tally()
    tally.add(changed(outcome, Status.SATURATED, 1.0))
    tally.add(changed(outcome, Status.UNSOLVED, 3.0, violated=("east.rate",)))
    tally.add(changed(outcome, Status.OK, 2.0))
    assert (tally.worst, tally.residual_max, tally.ticks) == (Status.UNSOLVED, 3.0, 3)
    assert tally.limits == {"east.rate"}
    assert (tally.blocked, tally.violated) == (1, {"east.rate"})
    assert tally.causes == {"no target yet": 3}
    assert tally.newest.result.status is Status.OK


def test_a_residual_that_is_no_number_is_the_worst(outcome):
    tally = Tally()
    tally.add(changed(outcome, residual=math.nan))
    tally.add(changed(outcome, residual=5.0))
    assert math.isnan(tally.residual_max)


def test_after_it_was_told_only_the_newest_tick_is_known(outcome):
    tally = Tally()
    tally.add(changed(outcome, Status.DIVERGED, 1.0, violated=("east.rate",)))
    tally.clear()
    assert (tally.worst, tally.ticks, tally.blocked) == (Status.OK, 0, 0)
    assert not tally.limits and not tally.causes and not tally.stage_maxima
    assert tally.newest is not None


@pytest.mark.parametrize("status", Status)
def test_every_status_can_be_told(outcome, status):
    tally = Tally()
    tally.add(changed(outcome, status))
    assert tally.worst is status


def test_a_linearized_step_is_worse_than_an_exact_one_and_no_worse_than_a_limit(outcome):
    tally = Tally()
    for status in (Status.OK, Status.LINEARIZED, Status.OK):
        tally.add(changed(outcome, status))
    assert tally.worst is Status.LINEARIZED
    tally.add(changed(outcome, Status.RATE_LIMITED))
    assert tally.worst is Status.RATE_LIMITED
    for status in (Status.NOT_CONVERGED, Status.SATURATED):
        tally.add(changed(outcome, status))
    assert tally.worst is Status.NOT_CONVERGED


def test_a_step_that_was_late_by_need_counts_as_overload(outcome):
    tally = Tally()
    for late in (False, True, True):
        report = replace(outcome.result.report, is_late=late)
        tally.add(outcome._replace(result=replace(outcome.result, report=report)))
    assert (tally.overloaded, tally.late, tally.ticks) == (2, 2, 3)


def test_overload_and_the_largest_linearization_error_are_told(outcome):
    tally = Tally()
    for age, error in ((0, 1e-3), (2, math.nan), (3, 5e-4)):
        report = replace(
            outcome.result.report, factor_age=age, linearization_error=error,
            projected_tangent=age == 2, qp_solver="DAQP" if age else "OSQP",
        )
        tally.add(outcome._replace(result=replace(outcome.result, report=report)))
    assert tally.overloaded == 2
    assert tally.linearization_error_max == 1e-3
    assert tally.projected == 1
    assert tally.qp_solvers == {"OSQP", "DAQP"}
