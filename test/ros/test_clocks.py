"""Clocks that are set, and simulated time."""

import time

import pytest
from builtin_interfaces.msg import Time as TimeMessage
from geometry_msgs.msg import PointStamped
from rosgraph_msgs.msg import Clock
from std_srvs.srv import SetBool

from softrobot_twin.control.arrival import Refusal
from softrobot_twin.ros.device_node import DeviceNode
from softrobot_twin.ros.process import spin
from softrobot_twin.ros.target_node import TargetNode

INSIDE = (0.008, 0.004, 0.134)
START = 1_000_000.0


@pytest.mark.parametrize("seconds", [-30.0, -5.0, 60.0])
def test_a_clock_that_was_set_is_reported_and_its_stamps_are_accepted_at_once(
    world, make_twin, diagnostics, monkeypatch, seconds
):
    twin = make_twin(message_timeout=5.0)
    targets = world.speaker(PointStamped, "/twin/target/tip")
    targets.publish(world.target_message((0.0, 0.0, 0.134)))
    world.until(lambda: twin.loop.targets.age(twin.monotonic()) < 60.0)
    diagnostics("loop")
    monkeypatch.setattr(twin, "ros_time", lambda: time.time_ns() + round(1e9 * seconds))
    loop = diagnostics("loop", lambda status: "clock set" in status.message)
    # Ticks that a busy machine misses make it an error.
    assert loop.level in (b"\x01", b"\x02")
    way = "ahead" if seconds > 0.0 else "back"
    # The two clocks are read one after the other, and a busy machine may wait between.
    assert twin.last_clock_step == pytest.approx(seconds, abs=0.1)
    assert f"clock set {way} by {abs(twin.last_clock_step):.3f} s" in loop.message
    before = twin.loop.targets.refusals.total
    targets.publish(world.target_message(INSIDE, seconds_ago=-seconds))
    target = diagnostics("target", lambda status: float(status.values["error_mm"]) < 0.1)
    assert float(target.values["age_s"]) < 60.0
    assert twin.loop.targets.refusals.total == before
    # It is reported only once.
    diagnostics("loop", lambda status: "clock set" not in status.message)
    assert twin.clock_steps == 1


class SimulatedTime:
    """Publishes a clock that a test controls."""

    def __init__(self, world):
        self._world, self.now = world, START
        self._publisher = world.probe.create_publisher(Clock, "/clock", 1)

    def reaches(self, count):
        self._world.until(lambda: self._publisher.get_subscription_count() == count)

    def tell(self):
        seconds, rest = divmod(round(self.now * 1e9), 10**9)
        self._publisher.publish(Clock(clock=TimeMessage(sec=seconds, nanosec=rest)))

    def turn(self, seconds, step=0.01):
        """Advances simulated time step by step; none is lost on a busy machine."""
        for _ in range(round(seconds / step)):
            self.now += step
            self.tell()
            self._world.until(self._has_come)
            self._world.run(0.004)

    def _has_come(self):
        """True when all nodes on simulated time have the present time."""
        nodes = [node for node in self._world.nodes if node.get_parameter("use_sim_time").value]
        return all(node.get_clock().now().nanoseconds == round(self.now * 1e9) for node in nodes)


@pytest.fixture
def simulated_time(world):
    return SimulatedTime(world)


@pytest.mark.exhaustive
def test_ticks_are_counted_on_simulated_time(world, make_twin, simulated_time):
    twin = make_twin(use_sim_time=True, rate=50.0)
    simulated_time.reaches(1)
    world.run(0.3)
    assert twin.tick_clock.ticks == 0
    simulated_time.turn(1.0)
    assert 10 < twin.tick_clock.ticks <= 51
    before = twin.tick_clock.ticks
    world.run(0.5)
    assert twin.tick_clock.ticks <= before + 1  # paused
    simulated_time.turn(1.0)
    assert 10 < twin.tick_clock.ticks - before <= 52


def test_simulated_time_that_jumps_back_continues_within_a_second(world, make_twin, simulated_time):
    twin = make_twin(use_sim_time=True, rate=50.0)
    targets = world.speaker(PointStamped, "/twin/target/tip")

    def send(position):
        message = world.target_message(position)
        seconds, rest = divmod(round(simulated_time.now * 1e9), 10**9)
        message.header.stamp = TimeMessage(sec=seconds, nanosec=rest)
        targets.publish(message)

    simulated_time.reaches(1)
    simulated_time.turn(0.5)
    send((0.0, 0.0, 0.134))
    simulated_time.turn(0.5)
    age = twin.loop.targets.age(twin.monotonic())
    assert 0.0 <= age < 1.0
    simulated_time.now -= 600.0
    simulated_time.tell()
    world.run(0.1)
    before = twin.tick_clock.ticks
    send(INSIDE)
    simulated_time.turn(1.0)
    assert twin.tick_clock.ticks - before > 10
    assert twin.loop.targets.refusals.of(Refusal.OUT_OF_ORDER) == 0
    assert 0.0 <= twin.loop.targets.age(twin.monotonic()) < 1.5
    assert twin.clock_steps == 1


@pytest.mark.exhaustive
def test_twin_device_and_target_work_together_on_simulated_time(
    world, make_twin, simulated_time, small_scene_file
):
    twin = make_twin(use_sim_time=True, use_device=True, approach_speed=0.05, device_timeout=2.0)
    device = world.add(DeviceNode, use_sim_time=True, device_rate=50.0,
                       device_scene_file=str(small_scene_file))
    world.add(TargetNode, use_sim_time=True, target_center=[0.0, 0.0, 0.134], target_rate=50.0,
              target_radius=0.005, target_ramp_time=0.2)
    simulated_time.reaches(3)
    simulated_time.turn(0.3)
    assert twin.loop.device.setpoints is not None
    answer = world.ask(SetBool, "/twin/enable", SetBool.Request(data=True))
    assert answer.success, answer.message
    simulated_time.turn(1.2)
    assert twin.loop.device.refusals.total == 0
    away = device.device.simulation.effector_positions()[0]
    assert abs(float((away[0] ** 2 + away[1] ** 2) ** 0.5) - 0.005) < 0.003


def test_a_clock_below_zero_is_refused_and_time_advances(world, make_twin, simulated_time):
    """rclpy raises it inside its own subscription."""
    twin = make_twin(use_sim_time=True, rate=50.0)
    simulated_time.reaches(1)
    simulated_time.turn(0.2)
    for _ in range(5):
        simulated_time._publisher.publish(Clock(clock=TimeMessage(sec=-5)))
        world.executor.remove_node(twin)
        world.run(0.02)
        world.executor.add_node(twin)
        spin(twin, world.executor, lambda: twin.refused_requests > 0)
    assert twin.refused_requests > 0
    before = twin.tick_clock.ticks
    spin(twin, world.executor, _turning(simulated_time, lambda: twin.tick_clock.ticks > before + 5))


def test_a_clock_beyond_what_stamps_hold_fails_no_tick(world, make_twin, simulated_time):
    twin = make_twin(use_sim_time=True, rate=50.0)
    simulated_time.reaches(1)
    simulated_time.turn(0.1)
    # Its nanoseconds are four seconds more.
    late = Clock(clock=TimeMessage(sec=2**31 - 1, nanosec=2**32 - 1))
    before = twin.tick_clock.ticks

    def is_over():
        simulated_time._publisher.publish(late)
        return twin.tick_clock.ticks > before

    spin(twin, world.executor, is_over)
    before = twin.tick_clock.ticks
    spin(twin, world.executor, _turning(simulated_time, lambda: twin.tick_clock.ticks > before + 5))
    assert twin.failed_ticks == 0, twin.failure


def _turning(simulated_time, is_over):
    def turn():
        simulated_time.now += 0.01
        simulated_time.tell()
        return is_over()

    return turn
