"""Reset, failures, and what must never leave."""

from dataclasses import replace

import numpy as np
import pytest

from softrobot_twin.control.engagement import Activity
from softrobot_twin.control.loop_settings import Mode
from softrobot_twin.errors import ParameterError
from softrobot_twin.simulation import Hold, Status

RATE = 0.05
STEP = 0.05
INSIDE = (0.008, 0.004, 0.134)
ROUNDING = 1.0e-9


@pytest.fixture
def inside(drive):
    """A driver whose robot is at a target."""
    driver = drive()
    driver.target(*INSIDE)
    driver.tick(20)
    return driver


def run_once(driver):
    """Commands and last positions of one run from rest."""
    driver.outcomes.clear()
    for x in (0.004, -0.006, 0.008):
        driver.target(x, 0.002, 0.134)
        driver.tick(4)
    return driver.commands, driver.loop.simulation.state.positions.copy()


def return_to_rest(driver):
    """Resets, and runs until the cables are back; largest change of a length in a tick [m]."""
    driver.outcomes.clear()
    assert driver.loop.reset() == "returning to rest"
    while driver.loop.simulation.state.step_count:
        assert driver.tick().activity is Activity.RETURNING
    return np.abs(np.diff(driver.commands, axis=0)).max()


def spoil(monkeypatch, simulation, **fields):
    """Makes every step give back something else."""
    honest = simulation.step

    def step(command, budget=None):
        return replace(honest(command, budget), **fields)

    monkeypatch.setattr(simulation, "step", step)


def assert_same_runs(*runs):
    for one in runs[1:]:
        assert np.array_equal(one[0], runs[0][0]) and np.array_equal(one[1], runs[0][1])


def test_reset_gives_the_same_run_to_the_bit(drive):
    driver = drive()
    runs = [run_once(driver)]
    for _ in range(2):
        assert return_to_rest(driver) <= RATE * STEP + ROUNDING
        runs.append(run_once(driver))
    assert_same_runs(*runs)


def test_reset_after_a_failure_gives_the_same_run_to_the_bit(drive, monkeypatch):
    driver = drive()
    first = run_once(driver)
    spoil(monkeypatch, driver.loop.simulation, setpoints=np.full(4, np.nan))
    assert driver.tick(3).result.status.is_failure
    monkeypatch.undo()
    return_to_rest(driver)
    assert_same_runs(first, run_once(driver))


def test_a_reset_while_disabled_returns_within_the_limits_once_enabled(drive):
    driver = drive()
    driver.target(*INSIDE)
    driver.tick(10)
    driver.loop.disable()
    assert driver.loop.reset() == "returning to rest when enabled"
    driver.tick(2)
    driver.loop.enable(driver.time)
    while driver.loop.simulation.state.step_count:
        assert driver.tick().activity is Activity.RETURNING
    assert driver.largest_step <= RATE * STEP + ROUNDING
    assert driver.commands[-1] == pytest.approx(driver.loop.simulation.rest_setpoints, abs=1e-6)


def test_a_return_continues_to_rest_when_the_model_fails(inside, monkeypatch):
    driver, wound = inside, inside.commands[-1]
    rest = driver.loop.simulation.rest_setpoints
    assert np.abs(wound - rest).max() > 4 * RATE * STEP
    simulation = driver.loop.simulation
    failing = simulation.step(Hold())
    monkeypatch.setattr(
        simulation, "step",
        lambda command, budget=None: replace(failing, status=Status.DIVERGED),
    )  # fmt: skip
    driver.outcomes.clear()
    driver.loop.reset()
    while driver.tick().activity is Activity.RETURNING:
        assert len(driver.outcomes) < 60
    causes = [outcome.cause for outcome in driver.outcomes]
    assert causes[0] == "reset" and "without" in causes[-2]
    assert np.array_equal(driver.commands[-2], rest)
    steps = np.abs(np.diff(np.vstack([wound, driver.commands[:-1]]), axis=0))
    assert steps.max() <= RATE * STEP + 1e-9
    monkeypatch.undo()
    # The tick after the return still failed: it was taken back, and took its time.
    assert simulation.state.step_count == 1
    assert np.array_equal(simulation.state.positions, simulation.model.nodes.rest_positions)
    assert driver.loop.is_enabled
    assert np.array_equal(driver.tick().command.setpoints, rest)


def test_a_return_continues_while_elements_are_inverted(inside, monkeypatch):
    """The Trunk was at rest one tick after a reset whose first step ended inverted."""
    driver, wound = inside, inside.commands[-1]
    spoil(monkeypatch, driver.loop.simulation, status=Status.INVERTED)
    driver.loop.reset()
    driver.outcomes.clear()
    while driver.tick().activity is Activity.RETURNING:
        pass
    monkeypatch.undo()
    steps = np.abs(np.diff(np.vstack([wound, driver.commands]), axis=0))
    assert steps.max() <= RATE * STEP + 1e-9
    assert driver.commands[-1] == pytest.approx(driver.loop.simulation.rest_setpoints, abs=1e-9)


def test_a_return_continues_when_a_step_does_not_converge(drive, monkeypatch):
    """A graver status hides that the rates bind; the return is not over for that."""
    driver = drive()
    driver.target(*INSIDE)
    driver.tick(6)
    spoil(monkeypatch, driver.loop.simulation, status=Status.NOT_CONVERGED)
    assert return_to_rest(driver) <= RATE * STEP + ROUNDING
    assert len(driver.outcomes) > 3


@pytest.mark.parametrize("fields, word", [
    ({"setpoints": np.full(4, np.nan)}, "north.not_finite"),
    ({"efforts": np.array([1.0, np.inf, 1.0, 1.0])}, "west.not_finite"),
    ({"efforts": np.full(4, 25.0)}, "north.tension_max"),
    ({"setpoints": np.full(4, 0.04)}, "east.shortening_max"),
    ({"setpoints": np.full(4, 0.06)}, "south.rate"),
])  # fmt: skip
def test_an_invalid_result_of_a_step_is_not_published(drive, monkeypatch, fields, word):
    driver = drive()
    driver.target(*INSIDE)
    safe = driver.tick(4).command
    spoil(monkeypatch, driver.loop.simulation, **fields)
    before = driver.loop.simulation.state
    outcome = driver.tick()
    assert word in outcome.violated
    assert outcome.result.status.is_failure
    assert np.array_equal(outcome.command.setpoints, safe.setpoints)
    assert np.array_equal(outcome.command.efforts, safe.efforts)
    # The model stays with what was published, and goes on from there; its time passes.
    after = driver.loop.simulation.state
    assert after.positions is before.positions and outcome.result.state is after
    assert after.step_count == before.step_count + 1
    assert after.time == before.time + STEP
    monkeypatch.undo()
    assert driver.tick().violated == ()
    assert driver.largest_step <= RATE * STEP + ROUNDING


def test_a_model_moved_from_outside_is_brought_back_before_a_command_is_released(inside):
    driver, wound = inside, inside.commands[-1]
    driver.loop.simulation.reset()
    outcome = driver.tick()
    assert outcome.activity is Activity.RESYNCHRONISING and outcome.command is None
    assert outcome.cause == "the model was not where the robot was sent"
    while driver.tick().activity is Activity.RESYNCHRONISING:
        pass
    after = driver.commands[20:]
    assert np.abs(np.diff(np.vstack([wound, after]), axis=0)).max() <= RATE * STEP + 1e-9
    assert driver.tick(30).tracking_errors[0] < 2e-5


@pytest.mark.parametrize("settings, corner", [
    ({"workspace_max": (1.0, 1.0, 0.1)}, "workspace_max"),
    ({"workspace_min": (0.001, -1.0, -1.0)}, "workspace_min"),
])  # fmt: skip
def test_a_workspace_that_excludes_the_robot_at_rest_is_refused(drive, settings, corner):
    with pytest.raises(ParameterError, match="tip is outside the workspace at rest") as raised:
        drive(**settings)
    assert raised.value.name == corner
    driver = drive()
    with pytest.raises(ParameterError):
        driver.loop.apply(replace(driver.loop.settings, **settings))
    # Without targets nothing is sent there.
    assert drive(mode=Mode.DIRECT, **settings)
