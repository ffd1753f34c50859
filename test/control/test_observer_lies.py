"""Markers that lie, and honest ones: an observer never makes a robot worse, and it lets go."""

import numpy as np
import pytest
from numpy.linalg import norm

from softrobot_twin.analysis.marker_compliance import MarkerCompliance
from softrobot_twin.control import force_observer
from softrobot_twin.control.force_observer import BALANCES, LOOKS, estimate, square_by_deviations
from softrobot_twin.control.target_correction import TargetCorrection
from softrobot_twin.scene import scene_from_mapping
from softrobot_twin.simulation import CommandSetpoints, Simulation, Touched
from softrobot_twin.simulation.effects.observed_forces import ObservedRows

from .conftest import Driver, warmed_up

RATE, TARGET, NOISE = 40.0, (0.008, 0.004, 0.134), 1e-4
WORSE, SMALL = 1.2, 4.0 * NOISE
"""What an observer may make of an error, and the greatest of a hundred errors by noise alone [m]."""
TIP = [0.0, 0.0, 0.125]


@pytest.fixture(scope="module")
def observing(small_scene_mapping):
    return warmed_up(Simulation(scene_from_mapping({**small_scene_mapping, "observer": {}})))


@pytest.fixture(scope="module")
def real(small_scene_mapping):
    """Softer by 15 %, its cables 1 mm beside where they should be; a touch pushes its tip."""
    mapping = {**small_scene_mapping, "touches": [
        {"name": "tip", "points": [TIP], "while_touched": "follow_targets"}]}  # fmt: skip
    body = mapping["body"]
    mapping["body"] = {**body, "material": {**body["material"], "young_modulus": 0.85 * 180e3}}
    mapping["cables"] = [
        {**cable, "points": (np.array(cable["points"]) + 1e-3 * np.array([off])).tolist()}
        for cable, off in zip(mapping["cables"], ([1, 0, 0], [0, 0, 1], [0, 0, -1], [0, -1, 0]))]
    return warmed_up(Simulation(scene_from_mapping(mapping)))


class Robot:
    """A loop and a robot that executes its commands a tick late."""

    def __init__(self, twin, real, seed, **settings):
        twin.reset()
        real.reset()
        self.driver = Driver(twin, rate=RATE, closed_loop=True, use_device=True, **settings)
        self.real, self.rng = real, np.random.default_rng(seed)
        self.rest, self.sent = real.marker_positions(), real.rest_setpoints
        self.lie = lambda markers: markers
        self.force, self.moves = np.zeros(3), []
        self.tick(TARGET)
        assert self.driver.loop.enable(self.driver.time)[0]

    def tick(self, target, count=1):
        """The errors of its tip [m], shape (count,)."""
        driver, errors = self.driver, []
        for _ in range(count):
            noise = self.rng.normal(0.0, NOISE, self.rest.shape)
            markers = self.lie(self.real.marker_positions() + noise)
            assert driver.measure(self.real.state.setpoints) is None
            driver.see(markers[np.isfinite(markers).all(axis=1)],
                       driver.loop.simulation.marker_ids[np.isfinite(markers).all(axis=1)])  # fmt: skip
            driver.target(*target)
            command = driver.tick().command
            touched = Touched(self.force[None], np.full((1, 3), np.nan))
            self.real.step(CommandSetpoints(self.sent, 1.0 / RATE), None, touched)
            if command is not None:
                self.moves.append(np.abs(command.setpoints - self.sent).max())
                self.sent = np.array(command.setpoints)
            errors.append(norm(self.real.effector_positions()[0] - target))
        return np.array(errors)


def late(count):
    """Frames of some ticks ago, the first one until then."""

    def make(robot):
        frames = []

        def lie(markers):
            frames.append(markers)
            return frames[-min(count, len(frames))]

        return lie

    return make


def moved(by):
    return lambda robot: lambda markers: markers + np.asarray(by)


def mapped(matrix):
    """About the origin."""
    return lambda robot: lambda markers: markers @ np.asarray(matrix).T


def about_rest(matrix):
    return lambda robot: lambda markers: robot.rest + (markers - robot.rest) @ np.asarray(matrix).T


def ordered(*ids):
    return lambda robot: lambda markers: markers[list(ids)]


def turned(degrees):
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


LIES = {
    "mirrored in x": mapped(np.diag([-1.0, 1.0, 1.0])),
    "mirrored about rest": about_rest(-np.eye(3)),
    "collapsed": lambda robot: lambda markers: np.tile(markers.mean(axis=0), (len(markers), 1)),
    "swapped": ordered(3, 6, 0, 5, 1, 7, 2, 4),
    "frozen": late(1000),
    "at rest": about_rest(np.zeros((3, 3))),
    "twice as far": about_rest(2.0 * np.eye(3)),
    "half as far": about_rest(0.5 * np.eye(3)),
    "larger": mapped(1.05 * np.eye(3)),
    "6 mm aside": moved([0.006, 0.0, 0.0]),
    "15 mm aside": moved([0.015, 0.0, 0.0]),
    "10 mm down": moved([0.0, 0.0, -0.01]),
    "turned by 5 deg": mapped(turned(5.0)),
    "turned by 90 deg": mapped(turned(90.0)),
    "two swapped": ordered(0, 1, 2, 3, 5, 4, 6, 7),
    "a second late": late(40),
    "noise of 20 mm": lambda robot: lambda m: m + robot.rng.normal(0.0, 0.02, m.shape),
}


def lied_to(twin, real, lie, seed):
    """Errors of the tip while markers lie, and from a second of honest ones on [m]; greatest move [m]."""
    robot = Robot(twin, real, seed)
    robot.tick(TARGET, 40)
    robot.lie = lie(robot)
    errors = robot.tick(TARGET, 120)
    robot.lie = lambda markers: markers
    robot.tick(TARGET, 40)
    return errors, robot.tick(TARGET, 20), max(robot.moves[1:])


@pytest.fixture
def seed(drawn_seed):
    return drawn_seed


@pytest.mark.parametrize("lie", [
    pytest.param(lie, marks=[pytest.mark.exhaustive] if index > 0 else []) for index, lie in enumerate(LIES)])
def test_a_lie_leads_a_robot_no_further_with_an_observer(simulation, observing, real, seed, lie):
    without, back, _ = lied_to(simulation, real, LIES[lie], seed)
    errors, after, move = lied_to(observing, real, LIES[lie], seed)
    print(f"{lie}: {1e3 * without.max():.1f} mm without an observer, {1e3 * errors.max():.1f} with; "
          f"a second later {1e3 * after.max():.2f} mm")
    assert errors.max() <= WORSE * without.max() + SMALL
    assert after.max() <= WORSE * max(back.max(), 1.0e-3)
    assert move <= observing.limits.rate.max() / RATE + 1e-9


def followed(twin, real, seed):
    """Errors of the tip at targets that jump, with noise, outliers, hidden markers and a push [m]."""
    robot = Robot(twin, real, seed)
    rng, errors = np.random.default_rng(seed), []
    for _ in range(5):
        target = rng.uniform([-0.015, -0.015, 0.125], [0.015, 0.015, 0.145])
        marred, hidden = rng.integers(8, size=2)
        shift, is_pushed = rng.normal(0.0, 0.02, 3), rng.random() < 0.4

        def mar(markers, marred=marred, hidden=hidden, shift=shift):
            markers[marred] += shift
            markers[hidden] = np.nan
            return markers

        robot.lie = mar
        robot.force = is_pushed * rng.normal(0.0, 0.3, 3)
        errors.append(robot.tick(target, 40))
    return np.concatenate(errors), max(robot.moves[1:])


@pytest.mark.parametrize("run", [
    pytest.param(run, marks=[pytest.mark.exhaustive] if run else []) for run in range(10)])
def test_honest_markers_are_followed_no_worse_with_an_observer(simulation, observing, real, seed, run):
    without, _ = followed(simulation, real, seed)
    errors, move = followed(observing, real, seed)
    print(f"{1e3 * without.mean():.2f} mm without an observer (mean), {1e3 * errors.mean():.2f} with")
    assert errors.mean() <= WORSE * without.mean() + SMALL
    assert move <= observing.limits.rate.max() / RATE + 1e-9


# --- one tick --------------------------------------------------------------------------------------


def test_no_measurement_makes_the_estimate_singular(seed):
    """Markers anywhere, of any noise, by any compliance."""
    rng = np.random.default_rng(seed)
    for _ in range(200):
        n, count = rng.integers(1, 7), rng.integers(3, 10)
        G = rng.normal(size=(3 * count, n)) * 10.0 ** rng.uniform(-9, 3)
        G *= rng.random(n) < 0.8
        root = rng.normal(size=(n, n)) * 10.0 ** rng.uniform(-9, 3, n)
        y = rng.normal(size=3 * count) * 10.0 ** rng.uniform(-9, 3)
        R = 10.0 ** rng.uniform(-14, 0)
        found, spread, weights = estimate(
            np.zeros(n), root @ root.T, y, G, R, (rng.random(count) < 0.8).astype(float))
        assert np.isfinite(found).all() and np.isfinite(spread).all() and np.isfinite(weights).all()
        assert np.isfinite(square_by_deviations(found, spread))


def test_a_tick_with_an_observer_takes_a_fixed_number_of_steps(observing, real, seed, monkeypatch):
    robot, steps = Robot(observing, real, seed), []
    robot.lie = lambda markers: markers + robot.rng.normal(0.0, 0.02, markers.shape)
    step = Simulation.step
    monkeypatch.setattr(Simulation, "step", lambda self, *rest, **more: (
        steps.append(1) if self is observing else None, step(self, *rest, **more))[1])  # fmt: skip
    for k in range(40):
        robot.force = np.array([1.0, 0.0, 0.0]) * (k > 20)
        steps.clear()
        robot.tick(TARGET)
        assert len(steps) <= 1 + LOOKS + BALANCES


def test_where_the_compliance_has_no_finite_solution_the_observer_is_blind(observing, monkeypatch):
    observer = force_observer.ForceObserver(observing)
    basis = ObservedRows.basis
    monkeypatch.setattr(ObservedRows, "basis", lambda self, positions: np.nan * basis(self, positions))
    observer.look()
    assert observer.is_blind


def test_of_a_tick_that_fails_after_its_step_nothing_is_kept(observing, real, seed, monkeypatch):
    robot = Robot(observing, real, seed)
    robot.tick(TARGET, 20)
    loop, sent = robot.driver.loop, robot.sent
    look = force_observer.ForceObserver.look
    fails = [True]
    monkeypatch.setattr(force_observer.ForceObserver, "look",
                        lambda self: 1 / 0 if fails[0] else look(self))  # fmt: skip
    far = (-0.02, -0.02, 0.145)
    for _ in range(2):
        with pytest.raises(ZeroDivisionError):
            robot.tick(far)
        assert loop.after_failure("ZeroDivisionError", 1).setpoints == pytest.approx(sent, abs=0.0)
        robot.driver.time += 1.0 / RATE
    fails[0] = False
    robot.tick(far, 3)
    assert max(robot.moves[-3:]) <= observing.limits.rate.max() / RATE + 1e-9
    assert norm(robot.sent - sent) > 0.0


# --- limits ----------------------------------------------------------------------------------------


def test_correction_and_force_together_keep_the_limit(seed):
    rng, limit = np.random.default_rng(seed), 0.01
    for _ in range(200):
        correction = TargetCorrection(1)
        correction.offsets[0] = before = limit * rng.uniform() * _direction(rng)
        loaded = 1.5 * limit * rng.uniform() * _direction(rng)
        correction.share_limit(loaded[None], limit)
        together = norm(correction.offsets[0] - loaded)
        assert together <= max(limit, norm(loaded)) * (1.0 + 1e-9)
        assert norm(correction.offsets[0]) <= norm(before) * (1.0 + 1e-9)
        if norm(before - loaded) <= max(limit, norm(loaded)):
            assert correction.offsets[0] == pytest.approx(before)


def _direction(rng):
    direction = rng.normal(size=3)
    return direction / norm(direction)


def test_motion_by_the_actuators_is_the_slope_of_their_displacements(observing):
    """Up to a factor, of each actuator that holds."""
    setpoints = observing.rest_setpoints + np.array([0.004, 0.003, 0.002, 0.003]) * _pulls(observing)
    observing.reset()
    for _ in range(60):
        observing.step(CommandSetpoints(setpoints, 1.0))
    by_actuators, state = MarkerCompliance(observing).at_state(np.zeros(1, int)).by_actuators, observing.state
    held = np.flatnonzero(observing.model.actuators.limits.can_hold(state.efforts))
    assert by_actuators.shape[1] == len(held) > 0
    before = observing.marker_positions()
    for column, cable in zip(by_actuators.T, held, strict=True):
        observing.restore(state)
        for _ in range(40):
            observing.step(CommandSetpoints(setpoints + 1e-5 * np.eye(4)[cable], 1.0))
        moved = (observing.marker_positions() - before).ravel()
        assert abs(column @ moved) == pytest.approx(norm(column) * norm(moved), rel=1e-3)


def _pulls(simulation):
    """The direction in which setpoints shorten cables."""
    low, high = simulation.limits.setpoint_range(simulation.rest_setpoints)
    return np.where(high - simulation.rest_setpoints > simulation.rest_setpoints - low, 1.0, -1.0)


def test_an_outvoted_force_decays_and_the_correction_takes_over(observing, real, seed):
    robot = Robot(observing, real, seed)
    robot.force = np.array([0.5, 0.0, 0.0])
    robot.tick(TARGET, 60)
    observer = robot.driver.loop.observer
    assert norm(observer.found.wrenches) > 0.3
    robot.lie = lambda markers: np.full_like(markers, np.nan)
    robot.tick(TARGET, 120)
    assert not observer.found.is_any
    assert robot.tick(TARGET).max() < 2.0e-3
