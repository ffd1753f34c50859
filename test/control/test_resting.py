"""A loop at rest: no step, the same bits, awake with the first message."""

import copy
from dataclasses import fields

import numpy as np
import pytest

from softrobot_twin.control.arrival import Arrival
from softrobot_twin.control.engagement import Activity
from softrobot_twin.control.loop_settings import LoopSettings, Mode
from softrobot_twin.control.twin_loop import TickOutcome, TwinLoop, owner_of
from softrobot_twin.scene import scene_from_mapping
from softrobot_twin.simulation import Simulation
from test.builder import builder

RATE = 100.0


class Clocked:
    """A loop and its time.

    Args:
        scene: Its scene.
        rests: False for a loop that makes all of each tick.
        arguments: What `TwinLoop` takes.
    """

    def __init__(self, scene, rests=True, mode=Mode.INVERSE, use_device=False, **settings):
        self.simulation = Simulation(scene)
        settings = {"message_timeout": 0.0, **settings}
        self.loop = TwinLoop(self.simulation, LoopSettings(rate=RATE, **settings), mode, use_device)
        self.now, self._rests = 100.0, rests

    def arrival(self):
        stamp = round(1e9 * self.now)
        return Arrival("base_link", stamp, stamp, self.now)

    def tick(self, period=1.0 / RATE):
        self.now += period
        if not self._rests:
            self.loop.wake()
        outcome = self.loop.tick(self.now, round(1e9 * self.now))
        self.simulation.plan()
        return outcome

    def until_repeating(self, most=400):
        for _ in range(most):
            outcome = self.tick()
            if self.loop.is_repeating:
                return outcome
        raise AssertionError("it does not rest")


@builder
def clocked(small_scene_mapping, /, explores=False, **options):
    mapping = copy.deepcopy(small_scene_mapping)
    mapping.setdefault("solver", {})["exploration"] = explores
    return Clocked(scene_from_mapping(mapping), **options)


def equal(one, other):
    """Whether two values are the same to the bit, at any depth."""
    if isinstance(one, np.ndarray):
        return one.shape == other.shape and one.tobytes() == other.tobytes()
    if isinstance(one, tuple):
        return len(one) == len(other) and all(map(equal, one, other))
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(equal(one[key], other[key]) for key in one)
    if hasattr(one, "__dataclass_fields__"):
        # How a result was found is another matter.
        return all(equal(getattr(one, field.name), getattr(other, field.name))
                   for field in fields(one) if field.name != "report")  # fmt: skip
    return one == other or (one != one and other != other)


@pytest.mark.parametrize("mode, use_device", [
    (Mode.INVERSE, False), (Mode.INVERSE, True), (Mode.DIRECT, False),
])  # fmt: skip
def test_a_loop_that_rests_and_one_that_steps_give_the_same_to_the_bit(clocked, mode, use_device, drawn_rng):
    draw = drawn_rng
    settings = {"target_timeout": 1.0, "device_timeout": 0.3, "marker_timeout": 0.2}
    pair = [clocked(rests=rests, mode=mode, use_device=use_device, **settings)
            for rests in (True, False)]  # fmt: skip
    repeats = 0

    def both(call):
        answers = [call(one) for one in pair]
        assert equal(*answers)

    simulation = pair[0].simulation
    rest, names = simulation.rest_setpoints, simulation.actuator_names
    tip = simulation.effector_positions()[0]
    for _ in range(12):
        values = rest - draw.uniform(0.0, 0.006, len(rest))
        place = tip + draw.uniform(-0.004, 0.004, 3)
        seen = simulation.marker_positions() + draw.normal(0.0, 1e-4, (len(simulation.marker_ids), 3))
        targets = ["target", "velocity"] if mode is Mode.INVERSE else []
        event = draw.choice(["none", *targets, "device", "markers", "command", "enable", "disable",
                             "reset"])  # fmt: skip
        if event == "target":
            both(lambda one: one.loop.targets.accept_point(0, place, one.arrival()))
        elif event == "velocity":
            both(lambda one: one.loop.targets.accept_velocity((0.01, 0.0, 0.0), one.now))
        elif event == "device":
            both(lambda one: one.loop.device.accept(names, values, [], one.arrival()))
        elif event == "markers":
            both(lambda one: one.loop.markers.accept(simulation.marker_ids, seen, one.arrival()))
        elif event == "command":
            both(lambda one: one.loop.commands.accept(names, values, [], one.arrival()))
        elif event == "enable":
            both(lambda one: one.loop.enable(one.now))
        elif event == "disable":
            both(lambda one: one.loop.disable())
        elif event == "reset":
            both(lambda one: one.loop.reset())
        for _ in range(draw.integers(1, 80)):
            period = draw.choice([1.0, 0.99, 1.01, 0.3, 1.7]) / RATE
            outcomes = [one.tick(period) for one in pair]
            repeats += pair[0].loop.is_repeating
            assert not pair[1].loop.is_repeating
            differ = [name for name in TickOutcome._fields
                      if not equal(*(getattr(outcome, name) for outcome in outcomes))]  # fmt: skip
            assert not differ
    pair[0].loop.reset()
    pair[0].loop.disable()
    pair[0].until_repeating()


def test_the_first_target_moves_the_robot_in_the_same_tick(clocked):
    twin = clocked()
    twin.until_repeating()
    place = twin.simulation.effector_positions()[0] + [0.003, 0.0, 0.0]
    twin.loop.targets.accept_point(0, place, twin.arrival())
    outcome = twin.tick()
    assert outcome.activity is Activity.FOLLOWING and not twin.loop.is_repeating
    assert outcome.result.effector_errors[0] < 0.003


def test_a_loop_rests_on_its_target_and_follows_the_next_in_the_same_tick(clocked):
    twin = clocked(target_timeout=0.0)
    place = twin.simulation.effector_positions()[0]
    twin.loop.targets.accept_point(0, place + [0.003, 0.0, 0.0], twin.arrival())
    outcome = twin.until_repeating()
    assert outcome.activity is Activity.FOLLOWING and outcome.result.status.is_success
    for share in (0.98, 1.02, 0.99):
        # Timers are never exact.
        assert twin.tick(share / RATE).result.report.is_resting and twin.loop.is_repeating
    twin.loop.targets.accept_point(0, place, twin.arrival())
    assert not twin.tick().result.report.is_resting and not twin.loop.is_repeating


def test_every_call_that_reaches_a_loop_ends_its_rest(clocked):
    for name in clocked().loop.calls:
        twin = clocked()
        twin.until_repeating()
        owner, method = owner_of(twin.loop, name)
        try:
            getattr(owner, method)(*[twin.loop.settings] if name == "apply" else ())
        except TypeError:
            pass  # Without its arguments: it was reached.
        twin.tick()
        assert not twin.loop.is_repeating, name


FAR = [0.5, 0.0, 0.0]


def states_of(twin, far, most=4000):
    """What a loop says of a target out of reach until it repeats its ticks, without repetitions."""
    twin.loop.targets.accept_point(0, far, twin.arrival())
    said, before = [], None
    for _ in range(most):
        outcome = twin.tick()
        report, setpoints = outcome.result.report, outcome.command.setpoints
        state = "rests" if report.is_resting else "explores" if report.is_exploring else "steps"
        assert state == "steps" or np.array_equal(setpoints, before)
        said += [state] if said[-1:] != [state] else []
        before = setpoints
        if twin.loop.is_repeating:
            break
    return said


@pytest.mark.exhaustive
def test_a_loop_looks_for_nearer_poses_before_it_rests_away_from_its_target(clocked):
    said = states_of(clocked(explores=True, target_timeout=0.0), FAR)
    assert said[:2] == ["steps", "explores"] and said[-1] == "rests"


@pytest.mark.exhaustive
def test_a_target_that_is_approached_at_a_speed_is_rested_before_without_looking(clocked):
    twin = clocked(explores=True, target_timeout=0.0, approach_speed=0.05)
    assert states_of(twin, FAR) == ["steps", "rests"]
    for share in (0.9, 1.3, 0.4, 1.0):
        # What lies on the way is the same, however late or early a tick comes.
        assert twin.tick(share / RATE).result.report.is_resting
