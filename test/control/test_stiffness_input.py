"""Wanted stiffnesses as messages, and the loop that follows them."""

import numpy as np
import pytest
import yaml

from softrobot_twin.control.arrival import Arrival, Refusal
from softrobot_twin.control.inputs import StiffnessInput
from softrobot_twin.control.loop_settings import LoopSettings, Mode
from softrobot_twin.control.loop_timing import NANOSECONDS
from softrobot_twin.control.twin_loop import Activity, TwinLoop
from softrobot_twin.scene import scene_from_mapping
from softrobot_twin.simulation import Simulation

FRAME, START = "base_link", 1000 * NANOSECONDS
SCENE = np.array([[np.nan, np.nan, 470.0], [np.nan] * 3])


def arrival(seconds=0.0, frame=FRAME, now=0.0):
    ros_time = START + round(now * NANOSECONDS)
    return Arrival(frame, START + round(seconds * NANOSECONDS), ros_time, now)


@pytest.fixture
def wanted():
    return StiffnessInput(SCENE, (True, False), FRAME, LoopSettings())


def test_that_of_the_scene_is_wanted_until_a_message_replaces_it(wanted):
    np.testing.assert_array_equal(wanted.wanted, SCENE)
    assert not wanted.is_given
    assert wanted.accept(0, (100.0, np.nan, 300.0), arrival()) is None
    np.testing.assert_array_equal(wanted.wanted[0], [100.0, np.nan, 300.0])
    assert wanted.is_given
    wanted.reset()
    np.testing.assert_array_equal(wanted.wanted, SCENE)
    assert not wanted.is_given


def test_a_message_without_any_number_asks_for_none(wanted):
    assert wanted.accept(0, (np.nan,) * 3, arrival()) is None
    assert np.isnan(wanted.wanted).all() and not wanted.is_given


@pytest.mark.parametrize("effector, stiffness, header, refusal", [
    (0, (np.nan, np.nan, 0.0), {}, Refusal.NOT_POSITIVE),
    (0, (-1.0, np.nan, 300.0), {}, Refusal.NOT_POSITIVE),
    (0, (np.nan, np.inf, 300.0), {}, Refusal.NOT_FINITE),
    (0, (300.0, 300.0), {}, Refusal.WRONG_SIZE),
    (0, (300.0, 300.0, 300.0), {"frame": "map"}, Refusal.WRONG_FRAME),
    (0, (300.0, 300.0, 300.0), {"seconds": -60.0}, Refusal.STALE),
    (1, (300.0, 300.0, 300.0), {}, Refusal.WRONG_NAMES),
])  # fmt: skip
def test_a_bad_message_is_refused_and_the_last_good_one_kept(wanted, effector, stiffness, header, refusal):
    assert wanted.accept(0, (np.nan, np.nan, 333.0), arrival(-0.01)) is None
    assert wanted.accept(effector, stiffness, arrival(**header)) is refusal
    assert wanted.wanted[0, 2] == 333.0 and wanted.refusals.of(refusal) == 1


@pytest.fixture(scope="module")
def loop(small_scene_mapping):
    mapping = yaml.safe_load(yaml.safe_dump(small_scene_mapping))
    mapping["effectors"][0]["stiffness"] = {"weight": 1.0}
    return TwinLoop(Simulation(scene_from_mapping(mapping)), LoopSettings(), Mode.INVERSE)


def ticks(loop, count, first=0):
    return [loop.tick(0.02 * k, START + k * 20_000_000) for k in range(first, first + count)]


def test_the_loop_follows_a_stiffness_alone(loop):
    loop.reset()
    (outcome,) = ticks(loop, 1)
    assert outcome.activity is not Activity.FOLLOWING
    loop.simulation.reset()
    loop.enable(0.0)
    assert loop.stiffness.accept(0, (np.nan, np.nan, 540.0), arrival(now=0.02)) is None
    outcomes = ticks(loop, 60, 1)
    assert outcomes[-1].activity is Activity.FOLLOWING
    assert outcomes[-1].result.effector_stiffness[0, 2] == pytest.approx(540.0, rel=0.01)
