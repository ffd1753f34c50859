"""No command is faster than its rate by the clock, whatever lies between two commands."""

import itertools
from dataclasses import fields, replace

import numpy as np
import pytest

from softrobot_twin.control.loop_settings import LoopSettings, WhenLost
from softrobot_twin.errors import ParameterError

ROUNDING = 1.0e-9
SMALL, LARGE = (-0.02, -0.02, 0.12), (0.02, 0.02, 0.14)
VALUES = {
    "rate": (0.1, 1.0, 10.0, 100.0, 2000.0),
    "deadline": (0.0, 0.002, 60.0),
    "message_timeout": (0.0, 0.5, 60.0),
    "future_tolerance": (0.0, 60.0),
    "target_timeout": (0.0, 0.05, 3600.0),
    "velocity_timeout": (0.01, 10.0),
    "speed_limit": (1e-6, 0.02, 10.0),
    "approach_speed": (0.0, 0.01, 10.0),
    "workspace_min": (SMALL, (-1.0, -1.0, -1.0)),
    "workspace_max": (LARGE, (1.0, 1.0, 1.0)),
    "closed_loop": (False, True),
    "misfit_rate": (0.0, 20.0, 1000.0),
    "correction_gain": (0.0, 2.0, 1000.0),
    "correction_limit": (0.0, 0.01, 1.0),
    "lead_limit": (0.0, 0.15, 1.0),
    "marker_timeout": (0.001, 0.5, 60.0),
    "on_lost_markers": tuple(WhenLost),
    "device_timeout": (0.001, 0.5, 60.0),
    "on_lost_device": tuple(WhenLost),
    "touch_timeout": (0.001, 60.0),
    "prediction": (False, True),
}


class Watched:
    """A driver whose commands are compared with the time between them."""

    def __init__(self, driver, draw):
        self.driver, self.draw = driver, draw
        self.last = None
        self.furthest = 0.0

    def tick(self, passed):
        """A tick some time [s] after the one before."""
        driver, loop = self.driver, self.driver.loop
        driver.time += passed
        outcome = loop.tick(driver.time, driver.arrival().ros_time)
        if outcome.command is None:
            return outcome
        now, setpoints = driver.time, outcome.command.setpoints
        if self.last is not None:
            time = now - self.last[0]
            moved = np.abs(setpoints - self.last[1])
            self.furthest = max(self.furthest, float(moved.max()))
            assert (moved <= loop.simulation.limits.rate * time + ROUNDING).all()
            for name, pose in outcome.guided_poses.items():
                speed, _ = loop.simulation.model.guides.limits[name]
                way = np.linalg.norm(pose.position - self.last[2][name].position)
                assert way <= speed * time + ROUNDING
        self.last = now, setpoints, dict(outcome.guided_poses)
        return outcome

    def some_time(self):
        """A time after which the next tick may come [s]: by the timer, late, early, or at once."""
        period = self.driver.loop.settings.period
        return float(self.draw.choice((1.0, 0.999, 0.8, 2.5, 0.01, 0.0))) * period


def test_every_setting_is_drawn():
    assert VALUES.keys() == {field.name for field in fields(LoopSettings)}


@pytest.mark.sampled
@pytest.mark.parametrize("use_device", (False, True))
def test_changed_parameters_in_every_order_break_no_rate(drive, use_device, drawn_rng):
    draw = drawn_rng
    driver = drive(use_device=use_device, rate=100.0, message_timeout=0.0, device_timeout=60.0)
    watched, loop = Watched(driver, draw), driver.loop
    place, rest = np.zeros(3), loop.simulation.rest_setpoints
    pairs = list(itertools.permutations(VALUES, 2))
    for chosen in draw.permutation(len(pairs))[:80]:
        for name in pairs[chosen]:
            values = VALUES[name]
            try:
                loop.apply(replace(loop.settings, **{name: values[draw.integers(len(values))]}))
            except ParameterError:
                continue
            for _ in range(draw.integers(1, 4)):
                place = draw.uniform(SMALL, LARGE)
                driver.target(*place)
                if draw.random() < 0.3:
                    loop.targets.accept_velocity(draw.uniform(-1.0, 1.0, 3), driver.time)
                if draw.random() < 0.5:
                    noise = draw.normal(0.0, 1e-3, (len(loop.simulation.marker_ids), 3))
                    driver.see(loop.simulation.marker_positions() + noise)
                driver.measure(rest if watched.last is None else watched.last[1])
                watched.tick(min(watched.some_time(), 0.5))
            if draw.random() < 0.1:
                loop.disable()
            if draw.random() < 0.1 and not use_device:
                loop.reset()
            loop.enable(driver.time)
    assert watched.furthest > 0.0


@pytest.mark.parametrize("before, after", [*itertools.permutations((2000.0, 100.0, 10.0, 0.1), 2)])
def test_a_changed_rate_moves_no_command_faster(drive, before, after):
    driver = drive(rate=before, message_timeout=0.0)
    watched, loop = Watched(driver, None), driver.loop
    driver.target(0.018, 0.0, 0.134)
    for _ in range(3):
        watched.tick(1.0 / before)
    loop.apply(replace(loop.settings, rate=after))
    driver.target(-0.018, 0.0, 0.134)
    watched.tick(1.0 / max(before, after))
    driver.target(-0.018, 0.0, 0.134)
    assert not watched.tick(1.0 / after).violated


def test_a_guided_body_keeps_its_speed_when_the_rate_changes(drive_grasper):
    driver = drive_grasper(message_timeout=0.0)
    watched, loop = Watched(driver, None), driver.loop
    name = loop.simulation.guided_names[0]
    start = watched.tick(0.01).guided_poses[name].position
    for rate in (100.0, 0.1, 100.0, 1.0):
        loop.apply(replace(loop.settings, rate=rate))
        driver.lead(name, *(start + (0.0, 0.0, 0.3)))
        for _ in range(3):
            watched.tick(0.01)


def test_ticks_at_the_same_moment_move_nothing(drive):
    driver = drive(message_timeout=0.0)
    watched = Watched(driver, None)
    driver.target(0.018, 0.0, 0.134)
    watched.tick(0.05)
    first = watched.tick(0.05).command.setpoints
    assert np.array_equal(watched.tick(0.0).command.setpoints, first)
    assert not np.array_equal(watched.tick(0.05).command.setpoints, first)
