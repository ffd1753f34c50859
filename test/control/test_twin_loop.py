"""The loop on the small Diamond: targets in, safe commands out."""

from dataclasses import replace

import numpy as np
import pytest

from softrobot_twin.control.activity import Activity, Mode
from softrobot_twin.control.command_gate import LENGTH_TOLERANCE
from softrobot_twin.control.loop_settings import WhenLost
from softrobot_twin.control.refusal import Refusal
from softrobot_twin.simulation import Status

RATE = 0.05
STEP = 0.05
INSIDE = (0.008, 0.004, 0.134)


def steps_of(driver):
    """Largest change of a length from command to command, the first from rest [m]."""
    rest = driver.loop.simulation.rest_lengths
    return np.abs(np.diff(np.vstack([rest, driver.commands]), axis=0)).max()


def test_without_a_target_the_cables_stay_at_rest(drive):
    driver = drive()
    outcome = driver.tick(5)
    assert outcome.activity is Activity.HOLDING and outcome.cause == "no target yet"
    assert driver.commands == pytest.approx(
        np.tile(driver.loop.simulation.rest_lengths, (5, 1)), abs=1e-9
    )


def test_a_target_inside_the_workspace_is_reached(drive):
    driver = drive()
    driver.target(*INSIDE)
    outcome = driver.tick(30)
    assert outcome.activity is Activity.FOLLOWING
    assert outcome.result.status is Status.OK
    assert outcome.result.effector_positions[0] == pytest.approx(INSIDE, abs=2e-5)
    assert outcome.tracking_errors[0] < 2e-5


@pytest.mark.parametrize("approach_speed", [0.0, 0.03])
def test_a_target_100_mm_away_obeys_all_limits(drive, approach_speed):
    driver = drive(approach_speed=approach_speed)
    driver.target(0.06, 0.08, 0.134)
    outcome = driver.tick(80)
    limits = driver.loop.simulation.limits
    rest = driver.loop.simulation.rest_lengths
    assert all(outcome.violated == () for outcome in driver.outcomes)
    assert steps_of(driver) <= RATE * STEP + LENGTH_TOLERANCE
    assert (driver.commands >= rest - limits.shortening_max - LENGTH_TOLERANCE).all()
    assert (driver.commands <= rest + LENGTH_TOLERANCE).all()
    assert outcome.result.status is Status.SATURATED
    assert outcome.result.report.active_limits
    # Where it ends is as near as it can: holding it longer brings it no nearer.
    ended = outcome.tracking_errors[0]
    assert driver.tick(20).tracking_errors[0] == pytest.approx(ended, abs=1e-5)


@pytest.mark.parametrize("azimuth", [0.0, 0.3, 0.93, 2.5])
def test_a_target_100_mm_away_is_approached_on_a_straight_line(drive, azimuth):
    driver = drive(approach_speed=0.03)
    driver.target(0.0, 0.0, 0.136)
    start = driver.tick(40).result.effector_positions[0]
    direction = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    driver.target(*(start + 0.1 * direction))
    first = len(driver.outcomes)
    while driver.tick().result.status is Status.OK:
        moved = driver.outcomes[-1].result.effector_positions[0] - start
        assert np.linalg.norm(moved - (moved @ direction) * direction) < 1e-4
    assert moved @ direction > 0.01
    assert len(driver.outcomes) > first + 7
    assert steps_of(driver) <= RATE * STEP + LENGTH_TOLERANCE


def test_an_unreachable_target_winds_nothing_up(drive):
    driver = drive(approach_speed=0.03)
    driver.target(0.1, 0.0, 0.136)
    far = driver.tick(80).result.effector_positions[0]
    driver.target(*(far - [0.005, 0.0, 0.0]))
    outcome = driver.tick(8)
    assert outcome.tracking_errors[0] < 1e-3


@pytest.mark.parametrize(
    ("position", "header", "refusal"),
    [
        ((np.nan, 0.0, 0.13), {}, Refusal.NOT_FINITE),
        ((0.0, -np.inf, 0.13), {}, Refusal.NOT_FINITE),
        ((0.0, 0.13), {}, Refusal.WRONG_SIZE),
        ((0.02, 0.0, 0.14), {"age": 1.0}, Refusal.STALE),
        ((0.02, 0.0, 0.14), {"age": -1.0}, Refusal.FROM_THE_FUTURE),
        ((0.02, 0.0, 0.14), {"age": 0.2}, Refusal.OUT_OF_ORDER),
        ((0.02, 0.0, 0.14), {"frame_id": "map"}, Refusal.WRONG_FRAME),
    ],
)
def test_a_bad_target_is_refused_and_the_commands_are_as_without_it(
    drive, position, header, refusal
):
    def run(bad):
        driver = drive()
        driver.loop.simulation.reset()
        driver.target(*INSIDE)
        driver.tick(3)
        if bad:
            assert driver.target(*position, **header) is refusal
        driver.tick(5)
        return driver.commands

    assert np.array_equal(run(bad=True), run(bad=False))


def test_no_target_for_its_timeout_holds_and_a_new_one_goes_on(drive):
    driver = drive(target_timeout=0.3)
    driver.target(*INSIDE)
    driver.tick(7)
    held = driver.tick(3)
    assert held.activity is Activity.HOLDING and held.cause == "no target for target_timeout"
    assert np.array_equal(driver.commands[-1], driver.commands[-2])
    driver.target(*INSIDE)
    assert driver.tick().activity is Activity.FOLLOWING


def run_once(driver):
    """Commands and last positions of one run from rest."""
    driver.outcomes.clear()
    for x in (0.004, -0.006, 0.008):
        driver.target(x, 0.002, 0.134)
        driver.tick(4)
    return driver.commands, driver.loop.simulation.state.positions.copy()


def return_to_rest(driver):
    """Resets, and lets the cables come back; largest change of a length on the way [m]."""
    driver.outcomes.clear()
    assert driver.loop.reset() == "returning to rest"
    while driver.loop.simulation.state.step_count:
        assert driver.tick().activity is Activity.RETURNING
    return np.abs(np.diff(driver.commands, axis=0)).max()


def test_reset_gives_the_same_run_to_the_bit(drive):
    driver = drive()
    first = run_once(driver)
    for _ in range(2):
        assert return_to_rest(driver) <= RATE * STEP + LENGTH_TOLERANCE
        again = run_once(driver)
        assert np.array_equal(first[0], again[0])
        assert np.array_equal(first[1], again[1])


def test_reset_after_a_failure_gives_the_same_run_to_the_bit(drive, monkeypatch):
    driver = drive()
    first = run_once(driver)
    spoil(monkeypatch, driver.loop.simulation, lengths=np.full(4, np.nan))
    assert driver.tick(3).result.status.is_failure
    monkeypatch.undo()
    return_to_rest(driver)
    again = run_once(driver)
    assert np.array_equal(first[0], again[0])
    assert np.array_equal(first[1], again[1])


def test_a_return_that_fails_ends_disabled_and_at_rest(drive, monkeypatch):
    driver = drive()
    driver.target(*INSIDE)
    driver.tick(4)
    spoil(monkeypatch, driver.loop.simulation, status=Status.DIVERGED)
    driver.loop.reset()
    driver.tick()
    assert not driver.loop.is_enabled
    assert driver.loop.simulation.state.step_count == 0


def spoil(monkeypatch, simulation, **fields):
    """Makes every step give back something else."""
    honest = simulation.step
    monkeypatch.setattr(simulation, "step", lambda command: replace(honest(command), **fields))


@pytest.mark.parametrize(
    ("fields", "word"),
    [
        ({"lengths": np.full(4, np.nan)}, "north.not_finite"),
        ({"tensions": np.array([1.0, np.inf, 1.0, 1.0])}, "west.not_finite"),
        ({"tensions": np.full(4, 25.0)}, "north.tension_max"),
        ({"lengths": np.full(4, 0.04)}, "east.shortening_max"),
        ({"lengths": np.full(4, 0.06)}, "south.rate"),
    ],
)
def test_what_a_step_should_never_give_is_not_published(drive, monkeypatch, fields, word):
    driver = drive()
    driver.target(*INSIDE)
    safe = driver.tick(4).command
    spoil(monkeypatch, driver.loop.simulation, **fields)
    before = driver.loop.simulation.state
    outcome = driver.tick()
    assert word in outcome.violated
    assert outcome.result.status.is_failure
    assert np.array_equal(outcome.command.lengths, safe.lengths)
    assert np.array_equal(outcome.command.tensions, safe.tensions)
    # The model stays with what was published, and goes on from there.
    assert driver.loop.simulation.state is before
    monkeypatch.undo()
    assert driver.tick().violated == ()
    assert steps_of(driver) <= RATE * STEP + LENGTH_TOLERANCE


def test_a_device_is_not_moved_before_it_is_enabled(drive):
    driver = drive(use_device=True)
    driver.target(*INSIDE)
    driver.measure(driver.loop.simulation.rest_lengths)
    outcome = driver.tick(5)
    assert outcome.activity is Activity.DISABLED
    assert len(driver.commands) == 0


def test_a_device_that_is_not_heard_cannot_be_enabled(drive):
    driver = drive(use_device=True)
    done, why = driver.loop.enable(driver.time)
    assert not done and "measured lengths" in why
    driver.measure(driver.loop.simulation.rest_lengths)
    driver.time += 1.0
    assert not driver.loop.enable(driver.time)[0]


def test_enabling_starts_from_where_the_device_is_without_a_jump(drive):
    driver = drive(use_device=True)
    wound = driver.loop.simulation.rest_lengths - [0.010, 0.003, 0.0, 0.006]
    driver.target(*INSIDE)
    driver.measure(wound)
    assert driver.loop.enable(driver.time)[0]
    while driver.tick().activity is Activity.RESYNCHRONISING:
        driver.measure(wound)
    assert len(driver.outcomes) < 10
    assert driver.commands[0] == pytest.approx(wound, abs=1e-6)
    # What was wanted before it was enabled is no longer.
    assert driver.tick().cause == "no target yet"
    driver.measure(wound)
    driver.target(*INSIDE)
    driver.tick(20)
    assert np.abs(np.diff(driver.commands, axis=0)).max() <= RATE * STEP + LENGTH_TOLERANCE


def test_a_device_wound_out_of_its_limits_is_taken_up_at_the_limit(drive):
    driver = drive(use_device=True)
    rest = driver.loop.simulation.rest_lengths
    driver.measure(rest + 0.001)
    driver.loop.enable(driver.time)
    while driver.tick().activity is Activity.RESYNCHRONISING:
        driver.measure(rest + 0.001)
    assert driver.commands[0] == pytest.approx(rest, abs=1e-6)


def test_a_disabled_device_is_left_alone_and_enabled_again_where_it_is(drive):
    driver = drive(use_device=True)
    rest = driver.loop.simulation.rest_lengths
    driver.measure(rest)
    driver.loop.enable(driver.time)
    driver.tick(2)
    driver.loop.disable()
    before = len(driver.commands)
    driver.tick(3)
    assert len(driver.commands) == before
    driver.measure(rest - 0.004)
    driver.loop.enable(driver.time)
    while driver.tick().activity is Activity.RESYNCHRONISING:
        driver.measure(rest - 0.004)
    assert driver.commands[before] == pytest.approx(rest - 0.004, abs=1e-6)


def test_reset_does_not_pull_a_device_along(drive):
    driver = drive(use_device=True)
    driver.measure(driver.loop.simulation.rest_lengths)
    driver.loop.enable(driver.time)
    driver.tick(2)
    driver.measure(driver.loop.simulation.rest_lengths)
    driver.target(*INSIDE)
    driver.tick(4)
    published = len(driver.commands)
    assert "disabled" in driver.loop.reset()
    assert driver.tick().activity is Activity.DISABLED
    assert len(driver.commands) == published


@pytest.mark.parametrize(
    ("policy", "activity"), [("hold", Activity.HOLDING), ("open_loop", Activity.FOLLOWING)]
)
def test_a_lost_device_is_answered_as_the_parameter_says(drive, policy, activity):
    driver = drive(use_device=True, on_lost_device=WhenLost(policy), device_timeout=0.2)
    driver.measure(driver.loop.simulation.rest_lengths)
    driver.loop.enable(driver.time)
    driver.tick(2)
    driver.target(*INSIDE)
    driver.measure(driver.loop.simulation.rest_lengths)
    assert driver.tick().activity is Activity.FOLLOWING
    outcome = driver.tick(6)
    assert driver.loop.device_is_lost(driver.time)
    assert outcome.activity is activity
    assert outcome.cause == ("device lost" if policy == "hold" else "")


@pytest.mark.parametrize("lengths", [True, False])
def test_direct_mode_takes_lengths_or_tensions(drive, lengths):
    driver = drive(mode=Mode.DIRECT)
    names = driver.loop.simulation.actuator_names
    rest = driver.loop.simulation.rest_lengths
    assert driver.tick().cause == "no command yet"
    wanted = rest - [0.004, 0.001, 0.002, 0.003] if lengths else np.array([3.0, 2.0, 2.5, 2.2])
    values = (wanted, []) if lengths else ([], wanted)
    assert driver.loop.direct.accept(names, *values, driver.arrival()) is None
    outcome = driver.tick(40)
    assert outcome.activity is Activity.COMMANDED
    reached = outcome.command.lengths if lengths else outcome.command.tensions
    assert reached == pytest.approx(wanted, abs=1e-5 if lengths else 1e-2)
    assert steps_of(driver) <= RATE * STEP + LENGTH_TOLERANCE


def test_a_direct_command_outside_the_limits_is_met_as_far_as_they_go(drive):
    driver = drive(mode=Mode.DIRECT)
    names = driver.loop.simulation.actuator_names
    rest = driver.loop.simulation.rest_lengths
    driver.loop.direct.accept(names, rest + 0.5, [], driver.arrival())
    outcome = driver.tick(5)
    assert outcome.violated == ()
    assert outcome.result.status is Status.SATURATED
    assert outcome.command.lengths == pytest.approx(rest, abs=1e-6)
