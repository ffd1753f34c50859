"""Why an effector is far from its target."""

import numpy as np
import pytest

from softrobot_twin.control.diagnostics_window import DiagnosticsWindow
from softrobot_twin.control.tracking_cause import (
    REPORTED_SHARE,
    TrackingSigns,
    tracking_cause,
    tracking_signs,
)
from softrobot_twin.simulation import Status


FAR = TrackingSigns(error=0.023, reported_above=0.006, ticks=50)


@pytest.mark.parametrize("error", [0.0, 0.006, float("nan")])
def test_a_small_error_has_no_cause(error):
    assert tracking_cause(FAR._replace(error=error, late=50, worst=Status.DIVERGED)) == ""


@pytest.mark.parametrize("signs, cause", [
    ({"holding": "device lost"}, "device lost"),
    ({"kept_back": ("north.rate",)}, "commands kept back: north.rate"),
    ({"worst": Status.DIVERGED}, "step diverged"),
    ({"late": 30, "worst": Status.UNREACHABLE}, "step unreachable"),
    ({"late": 30, "worst": Status.SATURATED, "limits": ("a.reach",)}, "limit: a.reach"),
    ({"late": 30}, "late: 30 of 80 ticks"),
    ({"overloaded": 20}, "overload: 20 of 50 ticks with a stale factor"),
    ({"limits": ("a.rate", "contact.force_limit"), "worst": Status.SATURATED},
     "limit: contact.force_limit"),
    ({"limits": ("a.shortening_min", "b.rate")}, "rate limit: b.rate"),
    ({"limits": ("a.rate",)}, "rate limit: a.rate"),
    ({"approaching": True}, "approaching at approach_speed"),
    ({"approaching": True, "worst": Status.RATE_LIMITED}, "approaching at approach_speed"),
    ({"approaching": True, "worst": Status.UNREACHABLE}, "step unreachable"),
    ({"approaching": True, "worst": Status.NOT_CONVERGED}, "step not_converged"),
    ({"device_lag": 0.02}, "the device differs from its command by 20.0 mm"),
    ({"device_off": "a by 3e+03 Pa"}, "the device differs from its command: a by 3e+03 Pa"),
    ({"closed_loop": True, "left_out": (4, 6)}, "markers left out: 4, 6"),
    ({"closed_loop": True, "markers_lost": True}, "markers lost"),
    ({"closed_loop": True, "correction_at_limit": True}, "the correction is at"),
    ({"misfit": 0.02}, "the model differs from the markers by 20.0 mm, and closed_loop is off"),
    ({"worst": Status.UNREACHABLE}, "step unreachable"),
    ({}, "not settled yet"),
])  # fmt: skip
def test_each_cause_is_named(signs, cause):
    assert tracking_cause(FAR._replace(**signs)).startswith(cause)


@pytest.mark.parametrize("late", [0, 3])
def test_a_rare_event_is_not_named_as_a_cause(late):
    assert "rate limit" in tracking_cause(FAR._replace(late=late, limits=("a.rate",)))


def test_a_cause_that_stops_the_loop_is_named_before_one_that_slows_it():
    signs = FAR._replace(late=40, limits=("a.rate",), holding="markers lost")
    assert tracking_cause(signs) == "markers lost"
    assert tracking_cause(signs._replace(holding="")).startswith("late")


def account(driver, late=0):
    """The cause that the last ticks show."""
    window = DiagnosticsWindow()
    for outcome in driver.outcomes:
        window.add(outcome)
    return tracking_cause(tracking_signs(driver.loop, window, late))


def test_a_target_out_of_reach_is_approached_and_then_its_limits_are_the_cause(drive):
    driver = drive(approach_speed=0.01)
    driver.target(0.0, 0.0, 0.25)
    driver.tick(2)
    assert account(driver) == "approaching at approach_speed"
    driver.tick(600)
    driver.outcomes.clear()
    driver.tick(50)
    # Each step aims at a point on the line, and the tip stands still: nothing is approached.
    assert all(outcome.is_approaching for outcome in driver.outcomes)
    assert {outcome.result.status for outcome in driver.outcomes} == {Status.SATURATED}
    for late in (0, 40):
        cause = account(driver, late)
        assert cause.startswith("limit: ") and "north.shortening_max" in cause


def test_a_wrong_model_and_an_approach_have_different_causes(drive):
    driver = drive(approach_speed=0.02)
    size = driver.loop.simulation.model.nodes.size
    driver.target(0.0, 0.0, 0.134)
    driver.tick(40)
    driver.outcomes.clear()
    wrong = np.array([2.0 * REPORTED_SHARE * size, 0.0, 0.0])
    driver.see(driver.tick().predicted_markers + wrong)
    driver.outcomes.clear()
    driver.tick(5)
    assert account(driver).startswith("the model differs")
    driver.target(-0.02, 0.0, 0.134)
    driver.outcomes.clear()
    driver.tick(1)
    assert account(driver) == "approaching at approach_speed"


def test_before_the_first_tick_there_is_no_cause(drive):
    assert tracking_cause(tracking_signs(drive().loop, DiagnosticsWindow(), 0)) == ""


def test_a_holding_loop_names_its_reason_and_a_disabled_one_has_no_error(drive):
    driver = drive(target_timeout=0.2)
    driver.target(0.02, 0.0, 0.134)
    driver.tick(1)
    driver.time += 1.0
    driver.outcomes.clear()
    driver.tick(3)
    assert account(driver) == "no target for target_timeout"
    driver.loop.disable()
    driver.outcomes.clear()
    driver.tick(3)
    assert account(driver) == ""
