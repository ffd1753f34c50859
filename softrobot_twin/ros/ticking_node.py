"""A node with one timer: what all three nodes have in common."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.parameter import Parameter

from softrobot_twin.control.arrival import Arrival, Refusal
from softrobot_twin.control.loop_timing import (
    NANOSECONDS,
    ClockWatch,
    ElapsedTime,
    SlackCollector,
    TickClock,
)
from softrobot_twin.ros.messages import arrival_of
from softrobot_twin.ros.parameters import ALL_TABLES, unknown_parameters
from softrobot_twin.ros.thread_priority import Priority, ThreadPriority

_MOST_TOLD = 4
"""Names that one sentence lists at most."""


class Clash(NamedTuple):
    """Something that there should be one of and is not.

    Attributes:
        key: What it is about: a topic, or ``name``.
        sentence: What is so, and what to do.
        is_grave: True when it disturbs what goes to the hardware or comes from it.
    """

    key: str
    sentence: str
    is_grave: bool


class GraphWatch:
    """Counts, in the graph that the middleware keeps, who publishes on a node's topics.

    A query costs some microseconds a topic and no network. A node that died without leaving stays
    in the graph for some 20 s.

    Args:
        node: The node.
        grave: Full names of topics whose second publisher disturbs the hardware: those of commands
            to it and of what it measures.
        others: Full names of further topics that have one publisher.
    """

    def __init__(self, node: Node, grave: Sequence[str], others: Sequence[str] = ()):
        self._node = node
        self._topics = [(topic, True) for topic in grave] + [(topic, False) for topic in others]

    def clashes(self) -> list[Clash]:
        """What there is more than one of, now."""
        found = []
        own = (self._node.get_name(), self._node.get_namespace())
        names = self._node.get_node_names_and_namespaces()
        if (count := names.count(own)) > 1:
            name = self._node.get_fully_qualified_name()
            found.append(Clash("name", f"{count} nodes are called {name}: end all but one, or "
                               "rename one with -r __node:=NAME", True))
        for topic, is_grave in self._topics:
            if (count := self._node.count_publishers(topic)) > 1:
                found.append(Clash(topic, self._sentence(topic, count), is_grave))
        return found

    def _sentence(self, topic: str, count: int) -> str:
        publishers = self._node.get_publishers_info_by_topic(topic)
        names = sorted(
            f"{info.node_namespace.rstrip('/')}/{info.node_name}" for info in publishers
        )
        told = ", ".join(names[:_MOST_TOLD]) + (", …" if len(names) > _MOST_TOLD else "")
        return f"{count} publishers on {topic} ({told}): end all but one"


_WARN_EVERY = 2.0
_GRAPH_PERIOD = 0.25
"""Time between two looks at who else is there [s]. What two in a row show is told: while a node
comes or goes, the graph may show it twice for a moment."""
_CLOCK_PATIENCE = 5.0
"""Longest wait for simulated time before it is told [s]."""


class TickingNode(Node):
    """Works in one timer and remembers in callbacks; late ticks are skipped, never queued.

    Ticks and ages are counted on a clock of the machine that is never set. With `use_sim_time`
    they are counted on the time of /clock: while it is paused there are no ticks, and where it is
    set back they go on from there.

    Attributes:
        tick_clock: Counts ticks, skips and misses.
        collector: Keeps Python's garbage collector out of the ticks.
        priority: The priority of the thread that ticks; normal until `take_priority`.
        clashes: What there is more than one of, as of the last look.
        clock_steps: How often the clock of the stamps was set.
        last_clock_step: How far, the last time [s]; positive when ahead.
        refused_requests: Messages and requests that failed inside rclpy.
        is_ticking: True during a tick, and after one that failed.
    """

    tick_clock: TickClock
    collector: SlackCollector

    def __init__(self, name: str, **arguments):
        super().__init__(name, **arguments)
        self.priority = ThreadPriority(Priority.NORMAL)
        self.clashes: list[Clash] = []
        self.clock_steps = self.refused_requests = 0
        self.last_clock_step = 0.0
        self.is_ticking = False
        self.is_simulated_time = bool(self.get_parameter("use_sim_time").value)
        self._time = (ElapsedTime(lambda: self.get_clock().now().nanoseconds)
                      if self.is_simulated_time else time.monotonic)
        self._clock_watch = ClockWatch()
        self._graph: GraphWatch | None = None
        self._seen: list[Clash] = []
        self.add_on_set_parameters_callback(self._keep_time_source)
        try:
            self.build()
        except BaseException:
            # Else it would stay in the graph, as a second one of its name, until Python forgets it.
            self.destroy_node()
            raise

    def build(self) -> None:
        """Declares the parameters, makes what they ask for and calls `start`.

        Raises:
            SoftRobotTwinError: What is asked for cannot be; the node is destroyed.
        """
        raise NotImplementedError

    def start(self, period: float) -> None:
        """Starts the timer; everything is built and warm by now.

        Args:
            period: Time from tick to tick [s].
        """
        self.collector = SlackCollector()
        self.tick_clock = TickClock(period, self._time, time.monotonic)
        # A clock of its own: the system's may be set while the loop runs.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        clock = self.get_clock() if self.is_simulated_time else steady
        self._timer = self.create_timer(period, self.tick, clock=clock)
        if self.is_simulated_time:
            self._tell_of_no_clock = self.create_timer(
                _CLOCK_PATIENCE, self._warn_of_no_clock, clock=steady
            )
            self._ticks_told = 0

    def change_period(self, period: float) -> None:
        """Goes on with another period [s].

        The next tick comes no later than it would have: changed again and again, a timer that
        begins anew each time would never be due.
        """
        until_next = self._timer.time_until_next_call()
        self._timer.timer_period_ns = round(period * NANOSECONDS)
        if until_next is None or until_next > self._timer.timer_period_ns:
            self._timer.reset()
        self.tick_clock.restart(period)

    def stop(self) -> None:
        """Stops the timer; `tick` can still be called."""
        self._timer.cancel()

    def take_priority(self) -> None:
        """Asks for the priority of the thread that calls and will tick, and says what came."""
        self.priority.take()
        self.get_logger().info(f"priority of the ticks: {self.priority.state}")

    def tick(self) -> None:
        """One tick, and what can wait until after it."""
        self.is_ticking = True
        until_next = self._timer.time_until_next_call()
        now = self.tick_clock.begin(
            self.tick_clock.period if until_next is None else until_next / NANOSECONDS
        )
        self.work(now)
        tick = self.tick_clock.end()
        self._watch_clock()
        if change := self.priority.offer():
            self.get_logger().warning(change)
        self.afterwards(now)
        self.is_ticking = False
        self.collector.offer(tick.slack)

    def work(self, now: float) -> None:
        """The work of a tick, at a time on the clock that never jumps [s]."""
        raise NotImplementedError

    def afterwards(self, now: float) -> None:
        """What can wait until the work of a tick is done."""

    def something_changed(self) -> None:
        """Called when there is something that diagnostics should say at once."""

    def arrival(self, header) -> Arrival:
        """A message's header with this moment."""
        return arrival_of(header, self.get_clock().now().nanoseconds, self.monotonic())

    def monotonic(self) -> float:
        """The clock of the ticks [s]."""
        return self.tick_clock.now()

    def warner(self) -> Callable[[str, Refusal | None], None]:
        """A function that warns of a refused message, at most once in `_WARN_EVERY` seconds."""
        last = [float("-inf")]

        def warn(topic: str, refusal: Refusal | None) -> None:
            if refusal is None or time.monotonic() - last[0] < _WARN_EVERY:
                return
            last[0] = time.monotonic()
            self.get_logger().warning(f"{topic}: refused, {refusal.value}")

        return warn

    def refuse_request(self, error: Exception) -> None:
        """Counts and tells a message that rclpy took and failed at; the node goes on."""
        self.refused_requests += 1
        words = " ".join(str(error).split()) or type(error).__name__
        self.get_logger().error(
            f"a message or request was refused: {words}", throttle_duration_sec=_WARN_EVERY
        )

    def warn_of_unknown_parameters(self) -> None:
        """Says which parameters were given that no node knows: rclpy would stay silent."""
        for sentence in unknown_parameters(self, ALL_TABLES):
            self.get_logger().warning(sentence)

    def watch_topics(self, grave: Iterable, others: Iterable = ()) -> None:
        """Has it told when somebody else publishes on these topics too.

        Args:
            grave: Publishers and subscriptions of commands to the hardware and of what it measures.
            others: Further ones whose topic has one publisher.
        """
        self._graph = GraphWatch(self, _names(grave), _names(others))
        # A timer of its own: ticks may be rare, and with simulated time they may pause.
        self.create_timer(_GRAPH_PERIOD, self._watch_graph,
                          clock=Clock(clock_type=ClockType.STEADY_TIME))

    def look_for_clashes(self) -> list[Clash]:
        """What there is more than one of at this moment."""
        return [] if self._graph is None else self._graph.clashes()

    def _watch_graph(self) -> None:
        """Looks at who else is there, and tells what is new."""
        before = {clash.key for clash in self.clashes}
        seen_before, self._seen = {clash.key for clash in self._seen}, self.look_for_clashes()
        self.clashes = [clash for clash in self._seen if clash.key in seen_before]
        for clash in self.clashes:
            if clash.key not in before:
                self.get_logger().error(clash.sentence)
        if {clash.key for clash in self.clashes} != before:
            self.something_changed()

    def _watch_clock(self) -> None:
        """Tells when the clock of the stamps was set; the inputs see it by themselves."""
        before = self._time()
        stamp = self.get_clock().now().nanoseconds
        after = self._time()
        step = self._clock_watch.step(stamp, 0.5 * (before + after))
        if step:
            self.clock_steps += 1
            self.last_clock_step = step
            way = "ahead" if step > 0.0 else "back"
            self.get_logger().warning(f"the clock was set {way} by {abs(step):.3f} s: the order "
                                      "of stamps begins anew")
            self.something_changed()

    def _warn_of_no_clock(self) -> None:
        if self.tick_clock.ticks == self._ticks_told:
            self.get_logger().warning("use_sim_time: no tick, /clock stands still or is not there",
                                      throttle_duration_sec=_CLOCK_PATIENCE)
        self._ticks_told = self.tick_clock.ticks

    def _keep_time_source(self, parameters: list[Parameter]) -> SetParametersResult:
        """The timer is made for one kind of time."""
        for parameter in parameters:
            if parameter.name == "use_sim_time" and parameter.value != self.is_simulated_time:
                return SetParametersResult(
                    successful=False, reason="parameter use_sim_time can be given at the start only"
                )
        return SetParametersResult(successful=True)


def _names(ends: Iterable) -> Sequence[str]:
    return [end.topic_name for end in ends]
