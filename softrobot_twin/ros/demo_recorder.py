"""What a demo hears: targets, effectors of twin and device, cables, diagnostics."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Point, PointStamped
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from sensor_msgs.msg import JointState

from softrobot_twin.control.clock_steps import NANOSECONDS

_ALL = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE)


class Samples:
    """Values with their times, as they come.

    Attributes:
        times: Time of each [s], growing.
        values: Each a list of floats, all of one length.
    """

    def __init__(self) -> None:
        self.times: list[float] = []
        self.values: list[list[float]] = []

    def add(self, time: float, value: list[float]) -> None:
        """Adds one; what is not newer than the last one is left out."""
        if not self.times or time > self.times[-1]:
            self.times.append(time)
            self.values.append(value)

    def between(self, start: float, end: float) -> tuple[np.ndarray, np.ndarray]:
        """Times [s], shape (n,), and values, shape (n, width), of ``start <= time < end``."""
        times = np.array(self.times)
        first, last = np.searchsorted(times, (start, end)) if len(times) else (0, 0)
        width = len(self.values[0]) if self.values else 0
        return times[first:last], np.array(self.values[first:last]).reshape(last - first, width)


class LoopAccount(NamedTuple):
    """What the twin said of its loop in one diagnostics message.

    Attributes:
        compute_p50: Median time of its last ticks [s].
        compute_p99: 99th percentile [s].
        compute_max: Longest [s].
        ticks: Ticks since its start.
        missed: Ticks that were not done in time.
        skipped: Ticks that were left out.
    """

    compute_p50: float
    compute_p99: float
    compute_max: float
    ticks: int
    missed: int
    skipped: int


class DemoRecorder(Node):
    """Listens to a twin, its device and its targets.

    Args:
        twin: Name of the twin, such as ``/twin``.
        device: Name of the device, such as ``/device``.
        effector: Effector that is driven.
        start_topic: Where the target listens for its start.

    Attributes:
        target: Where the effector should be [m].
        twin_effector: Where the twin believes it is [m].
        device_effector: Where it is [m]: the device tells, a real one could not.
        lengths: Commanded cable lengths [m].
        tensions: Cable tensions of the twin [N].
        cable_names: Cables in the order of these; empty before the first command.
        accounts: The twin's accounts of its loop, the newest last.
        priority: What priority the twin says that its ticks have; empty before it does.
        cause: Why the twin is far from its target, as it says; empty when it is not.
    """

    def __init__(self, twin: str, device: str, effector: str, start_topic: str):
        super().__init__("demo")
        self.target, self.twin_effector, self.device_effector = Samples(), Samples(), Samples()
        self.lengths, self.tensions = Samples(), Samples()
        self.cable_names: tuple[str, ...] = ()
        self.accounts: list[LoopAccount] = []
        self.priority = self.cause = ""
        self._twin = twin.lstrip("/")
        self._targets = self._record(f"{twin}/target/{effector}", self.target)
        self._record(f"{twin}/effectors/{effector}", self.twin_effector)
        self._record(f"{device}/effectors/{effector}", self.device_effector)
        self._start = self.create_publisher(PointStamped, start_topic, _ALL)
        self.create_subscription(JointState, f"{twin}/cables", self._take_cables, _ALL)
        self.create_subscription(DiagnosticArray, "/diagnostics", self._take_diagnostics, 10)

    def _record(self, topic: str, samples: Samples) -> Subscription:
        def take(message: PointStamped) -> None:
            point = message.point
            samples.add(_seconds(message.header), [point.x, point.y, point.z])

        return self.create_subscription(PointStamped, topic, take, _ALL)

    def error(self) -> float:
        """Newest distance of the device from the target [m]; NaN before both are known."""
        if not self.target.times or not self.device_effector.times:
            return math.nan
        time, position = self.device_effector.times[-1], self.device_effector.values[-1]
        times, values = self.target.between(time - 1.0, math.inf)
        if not len(times):
            return math.nan
        target = [float(np.interp(time, times, column)) for column in values.T]
        return math.dist(target, position)

    def target_is_found(self) -> bool:
        """True when the target listens for its start, and will be heard."""
        return (self._start.get_subscription_count() > 0
                and self._targets.get_publisher_count() > 0)

    def start_target(self) -> None:
        """Lets the path begin where the twin's effector is now."""
        x, y, z = self.twin_effector.values[-1]
        message = PointStamped(point=Point(x=x, y=y, z=z))
        message.header.stamp = self.get_clock().now().to_msg()
        self._start.publish(message)

    def _take_cables(self, message: JointState) -> None:
        if not self.cable_names:
            self.cable_names = tuple(message.name)
        time = _seconds(message.header)
        self.lengths.add(time, list(message.position))
        self.tensions.add(time, list(message.effort))

    def _take_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            told = {pair.key: pair.value for pair in status.values}
            if status.name == f"{self._twin}: loop":
                self.priority = told["priority"]
                self.accounts.append(LoopAccount(
                    *(1e-3 * float(told[f"compute_{key}_ms"]) for key in ("p50", "p99", "max")),
                    *(int(told[key]) for key in ("ticks", "missed", "skipped"))))
            elif status.name == f"{self._twin}: target":
                self.cause = told.get("error_cause", "")


def _seconds(header) -> float:
    return header.stamp.sec + header.stamp.nanosec / NANOSECONDS
