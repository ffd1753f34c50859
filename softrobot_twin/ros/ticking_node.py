"""A node with one timer: what all three nodes have in common."""

from __future__ import annotations

from collections.abc import Callable

from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from softrobot_twin.control.arrival import NANOSECONDS, Arrival
from softrobot_twin.control.refusal import Refusal
from softrobot_twin.control.slack_collector import SlackCollector
from softrobot_twin.control.tick_clock import TickClock
from softrobot_twin.ros.messages import arrival_of
from softrobot_twin.ros.parameter_table import unknown_names
from softrobot_twin.ros.parameters import ALL_TABLES

_WARN_EVERY = 2.0


class TickingNode(Node):
    """Works in one timer and remembers in callbacks; late ticks are skipped, never queued.

    Attributes:
        tick_clock: Counts ticks, skips and misses.
        collector: Keeps Python's garbage collector out of the ticks.
    """

    tick_clock: TickClock
    collector: SlackCollector

    def start(self, period: float) -> None:
        """Starts the timer; everything is built and warm by now.

        Args:
            period: Time from tick to tick [s].
        """
        self.collector = SlackCollector()
        self.tick_clock = TickClock(period)
        # A clock of its own: the system's may be set while the loop runs.
        self._timer = self.create_timer(
            period, self.tick, clock=Clock(clock_type=ClockType.STEADY_TIME)
        )

    def change_period(self, period: float) -> None:
        """Goes on with another period [s]."""
        self._timer.timer_period_ns = round(period * NANOSECONDS)
        self._timer.reset()
        self.tick_clock.restart(period)

    def stop(self) -> None:
        """Stops the timer; `tick` can still be called."""
        self._timer.cancel()

    def tick(self) -> None:
        """One tick, and what can wait until after it."""
        until_next = self._timer.time_until_next_call()
        now = self.tick_clock.begin(
            self.tick_clock.period if until_next is None else until_next / NANOSECONDS
        )
        self.work(now)
        tick = self.tick_clock.end()
        self.afterwards(now)
        self.collector.offer(tick.slack)

    def work(self, now: float) -> None:
        """The work of a tick, at a time on the clock that never jumps [s]."""
        raise NotImplementedError

    def afterwards(self, now: float) -> None:
        """What can wait until the work of a tick is done."""

    def arrival(self, header) -> Arrival:
        """A message's header with this moment."""
        return arrival_of(header, self.get_clock().now().nanoseconds, self.monotonic())

    def monotonic(self) -> float:
        """The clock of the ticks [s]."""
        return self.tick_clock.now()

    def warner(self) -> Callable[[str, Refusal | None], None]:
        """A way to say that a message was refused; each one is silent for a while after."""
        last = [float("-inf")]

        def warn(topic: str, refusal: Refusal | None) -> None:
            if refusal is None or self.monotonic() - last[0] < _WARN_EVERY:
                return
            last[0] = self.monotonic()
            self.get_logger().warning(f"{topic}: refused, {refusal.value}")

        return warn

    def warn_of_unknown_parameters(self) -> None:
        """Says which parameters were given that no node knows: rclpy would stay silent."""
        for name in unknown_names(self, ALL_TABLES):
            self.get_logger().warning(f"parameter {name} is unknown and ignored")
