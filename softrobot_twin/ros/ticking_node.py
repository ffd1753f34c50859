"""Base of all three nodes: one timer, clocks, priority, and a watch over the ROS graph."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.subscription import Subscription

from softrobot_twin.control.arrival import Arrival, Refusal, RefusalCounts
from softrobot_twin.control.loop_timing import (
    NANOSECONDS,
    ClockWatch,
    ElapsedTime,
    GarbageCollection,
    TickClock,
)
from softrobot_twin.control.voices import PublisherWatch
from softrobot_twin.errors import one_line
from softrobot_twin.ros.message_bytes import read_message, reader_of
from softrobot_twin.ros.messages import arrival_of
from softrobot_twin.ros.one_line_logger import OneLineLogger
from softrobot_twin.ros.parameters import ALL_TABLES, Entry, similar, unknown_parameters
from softrobot_twin.ros.thread_priority import Priority, ThreadPriority
from softrobot_twin.ros.topics import Topic, largest_message, open_subscription

_MOST_NAMES = 4
"""Most names that one sentence lists."""


class Clash(NamedTuple):
    """A name or topic that several nodes use although only one should.

    Attributes:
        key: The topic, or ``name``.
        sentence: The problem and its remedy.
        is_severe: True when it disturbs commands to the hardware or its measurements.
    """

    key: str
    sentence: str
    is_severe: bool


def publishing_nodes(node: Node, topic: str) -> set[tuple[str, str]]:
    """Names and namespaces of the nodes that publish on a topic, as `node` sees them.

    Args:
        node: The node that looks.
        topic: Full name of the topic.
    """
    publishers = node.get_publishers_info_by_topic(topic)
    return {(one.node_name, one.node_namespace) for one in publishers}


def publisher_names(node: Node, topic: str) -> str:
    """Full names of the nodes that publish on a topic, as `node` sees them.

    Args:
        node: The node that looks.
        topic: Full name of the topic.
    """
    publishers = node.get_publishers_info_by_topic(topic)
    names = sorted(f"{info.node_namespace.rstrip('/')}/{info.node_name}" for info in publishers)
    return ", ".join(names[:_MOST_NAMES]) + (", …" if len(names) > _MOST_NAMES else "")


_WARN_EVERY = 2.0
_GRAPH_PERIOD = 0.25
"""Time between two checks of the graph [s]. A clash is reported after two checks in a row, because
the graph may briefly list a node twice while it starts or ends.
"""
_LAST_STAMP = (2**31 - 10_000) * NANOSECONDS
"""Latest time of a tick [ns]: stamps, also of what lies ahead, hold 2³¹ s. On /clock may be later ones."""
_CLOCK_WAIT = 5.0
"""Longest wait for simulated time before a warning [s]."""


class TickingNode(Node):
    """A node that works in one timer; callbacks only store messages. Late ticks are skipped, not
    queued.

    Ticks and message ages use the machine's monotonic clock. With `use_sim_time` they use the time
    of /clock: while it is paused there are no ticks, and when it is set back the ticks continue
    from there.

    Attributes:
        tick_clock: Counts ticks, skips and misses.
        collector: Keeps Python's garbage collector out of the ticks.
        priority: The priority of the thread that ticks; normal until `take_priority`.
        clashes: Clashes found by the last check of the graph.
        clock_steps: How often the clock of the stamps was set.
        last_clock_step: Change of the clock at the last time [s]; positive when forward.
        refused_requests: Messages and requests that failed inside rclpy.
        failed_ticks: Ticks that ended with an exception, since the start.
        stamp: The time of the newest tick on the clock of the stamps [ns].
        has_worked: Whether `work` of the newest tick was done.
        failure: The newest of these exceptions, in one line.
        failures_in_a_row: How many of the newest ticks did.
    """

    tick_clock: TickClock
    collector: GarbageCollection

    def __init__(self, name: str, **arguments):
        super().__init__(name, **arguments)
        self._logger = OneLineLogger(self._logger.name)
        self.priority = ThreadPriority(Priority.NORMAL)
        self.clashes: list[Clash] = []
        self.clock_steps = self.refused_requests = 0
        self.last_clock_step = 0.0
        self.failed_ticks, self.failures_in_a_row, self.failure = 0, 0, ""
        self.stamp, self.has_worked = 0, False
        self.is_simulated_time = bool(self.get_parameter("use_sim_time").value)
        self._time = ElapsedTime(self.ros_time) if self.is_simulated_time else time.monotonic
        self._clock_watch = ClockWatch()
        self._watched: list[tuple[str, bool]] | None = None
        self._last_look: list[Clash] = []
        self.add_on_set_parameters_callback(self._keep_time_source)
        try:
            self.build()
        except BaseException:
            # Otherwise it would stay in the graph as a second node of this name until it is
            # collected.
            self.destroy_node()
            raise

    def build(self) -> None:
        """Declares the parameters, builds the node and calls `start`.

        Raises:
            SoftRobotTwinError: The node cannot be built; it is destroyed.
        """
        raise NotImplementedError

    def start(self, period: float) -> None:
        """Starts the timer; everything must be built and warmed up by now.

        Args:
            period: Time from tick to tick [s].
        """
        self.collector = GarbageCollection()
        self.tick_clock = TickClock(period, self._time, time.monotonic)
        # A steady clock, because the system's clock may be set while the loop runs.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        clock = self.get_clock() if self.is_simulated_time else steady
        self._timer = self.create_timer(period, self.tick, clock=clock)
        if self.is_simulated_time:
            self._last_tick_count = 0
            self.create_timer(_CLOCK_WAIT, self._warn_of_no_clock, clock=steady)

    def change_period(self, period: float) -> None:
        """Changes the period [s].

        The next tick is not later than before: a timer that restarted at every change would never
        fire if the period changes often.

        Args:
            period: Time between two ticks [s].
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
        """Requests the priority of the calling thread, which will run the ticks, and logs the
        result.
        """
        self.priority.take()
        logger, state = self.get_logger(), f"priority of the ticks: {self.priority.state}"
        if self.priority.is_granted:
            logger.info(state)
        else:
            logger.warning(f"{state}; while other programs keep the cores busy a step takes up to "
                           "twice as long and ticks come late: allow real-time priority by the "
                           "limit rtprio 5, see Priority in docs/ros.md")  # fmt: skip

    def tick(self) -> None:
        """Runs one tick and the work that can wait until after it. An exception ends the tick only."""
        until_next, period = self._timer.time_until_next_call(), self.tick_clock.period
        now = self.tick_clock.begin(period if until_next is None else until_next / NANOSECONDS)
        self.stamp = self.ros_time()
        self._watch_clock(now)
        self.has_worked = self._try(self.work, now)
        spare_time = self.tick_clock.end()
        if change := self.priority.offer():
            self.get_logger().warning(change)
        failed = not self._try(self.after_work, now) or not self.has_worked
        self.failed_ticks += failed
        self.failures_in_a_row = self.failures_in_a_row + 1 if failed else 0
        if failed:
            self._try(self.after_failure, now)
        self.collector.offer(spare_time)

    def _try(self, work: Callable[[float], None], now: float) -> bool:
        """Does a part of a tick; False where it raised an exception, which is logged."""
        try:
            work(now)
            return True
        except Exception as error:  # noqa: BLE001 - no error may end the node
            self.failure = f"{type(error).__name__}: {one_line(error)}"
            where = traceback.extract_tb(error.__traceback__)[-1]
            self.get_logger().error(
                f"a tick failed: {self.failure} ({Path(where.filename).name}, line {where.lineno})",
                throttle_duration_sec=_WARN_EVERY,
            )
            return False

    def work(self, now: float) -> None:
        """The work of a tick; `now` is a time on the monotonic clock [s].

        Args:
            now: Time on the monotonic clock [s].
        """
        raise NotImplementedError

    def after_work(self, now: float) -> None:
        """Work that can wait until after a tick.

        Args:
            now: Time on the monotonic clock [s].
        """

    def after_failure(self, now: float) -> None:
        """What is left to do in a tick that ended with an exception.

        Args:
            now: Time on the monotonic clock [s].
        """

    def request_diagnostics(self) -> None:
        """Called when diagnostics should be published at once."""

    def arrival(self, header) -> Arrival:
        """A message's header with the present time as its time of arrival.

        Args:
            header: Header of the message.
        """
        return arrival_of(header, self.ros_time(), self.monotonic())

    def ros_time(self) -> int:
        """The clock of the stamps [ns]."""
        # Without simulated time it is the system's, which rclpy takes much longer to read.
        if self.is_simulated_time:
            return min(self.get_clock().now().nanoseconds, _LAST_STAMP)
        return time.time_ns()

    def monotonic(self) -> float:
        """The clock of the ticks [s]."""
        return self.tick_clock.now()

    def warner(self) -> Callable[[str, Refusal | None], None]:
        """A function that logs refused messages, at most one in two seconds."""
        last = [float("-inf")]

        def warn(topic: str, refusal: Refusal | None) -> None:
            if refusal is None or time.monotonic() - last[0] < _WARN_EVERY:
                return
            last[0] = time.monotonic()
            hint = f": {refusal.hint}" if refusal.hint else ""
            self.get_logger().warning(f"{topic}: refused, {refusal.value}{hint}")

        return warn

    def listen(
        self, topic: Topic, take: Callable, refusals: RefusalCounts, name: str = "",
        twin: str = "", names: Iterable[str] = (),
    ) -> Subscription:
        """Receives a declared topic; counts and logs refused messages.

        A message that is too large is refused unread: reading it would delay the ticks. While two
        publishers send by turns, the messages of both are refused.

        Args:
            topic: The topic.
            take: Takes a message, and returns the reason to refuse it, or None.
            refusals: Counts messages that are too large.
            name: Name of the topic's object; see `Topic.full_name`.
            twin: Name of the twin.
            names: Names of actuators that messages may contain.
        """
        kind, most, warn = topic.kind, largest_message(topic.kind, names), self.warner()
        shown = self.resolve_topic_name(topic.full_name(name, twin))
        note = self.noted(kind, shown)
        reader_of(kind)  # Made before the first tick.
        watch, said = PublisherWatch(), ""

        def receive(content: bytes, about: dict) -> None:
            nonlocal said
            now = time.monotonic()
            if not watch.hear(about["publication_sequence_number"], 1.0e-9 * about["source_timestamp"], now):
                warn(shown, refusals.add(Refusal.TWO_PUBLISHERS))
                if watch.is_contested(now):
                    said = said or (f"two publishers on {shown} ({publisher_names(self, shown)}): "
                                    "end all but one")  # fmt: skip
                    self.contest(topic, shown, said)
                return
            said = ""
            if len(content) > most:
                warn(shown, refusals.add(Refusal.TOO_LARGE))
                return
            try:
                message, size = read_message(content, kind)
            except ValueError:
                warn(shown, refusals.add(Refusal.UNREADABLE))
                return
            note(content[:size])
            warn(shown, take(message))

        return open_subscription(self, topic, receive, name, twin)

    def contest(self, topic: Topic, name: str, sentence: str) -> None:
        """Called at each message while two publishers send on an input.

        Args:
            topic: The input.
            name: Its full name.
            sentence: The problem, the publishers and the remedy.
        """
        self.get_logger().error(sentence, throttle_duration_sec=_WARN_EVERY)

    def noted(self, kind: type, topic: str) -> Callable[[bytes], object]:
        """What takes the bytes of each message of a topic before it is used, to record them.

        Args:
            kind: Class of the messages.
            topic: Name of the topic.
        """
        return lambda content: None

    def refuse_request(self, error: Exception) -> None:
        """Counts and logs a message that rclpy failed to process; the node continues.

        Args:
            error: What rclpy raised.
        """
        self.refused_requests += 1
        words = one_line(error) or type(error).__name__
        self.get_logger().error(f"a message or request was refused: {words}",
                                throttle_duration_sec=_WARN_EVERY)

    def set_parameters_atomically(self, parameters: list[Parameter]) -> SetParametersResult:
        """Sets all parameters or none; a name that the node does not have is refused by name.

        Args:
            parameters: The parameters with their new values.
        """
        known = self.get_parameters_by_prefix("")
        for parameter in parameters:
            if parameter.name not in known:
                return SetParametersResult(successful=False, reason=f"parameter {parameter.name} is "
                                           f"unknown{similar(parameter.name, known)}")  # fmt: skip
        return super().set_parameters_atomically(parameters)

    def warn_about_unknown_parameters(self, more: Sequence[Entry] = ()) -> None:
        """Logs given parameters that no node declares, which rclpy ignores silently.

        Args:
            more: Parameters of this node that are in none of the package's tables.
        """
        for sentence in unknown_parameters(self, (*ALL_TABLES, more)):
            self.get_logger().warning(sentence)

    def watch_topics(self, critical: Iterable, others: Iterable = ()) -> None:
        """Reports other publishers on these topics from now on.

        Args:
            critical: Publishers and subscriptions of commands and measurements of the hardware.
            others: Further ones whose topic should have one publisher.
        """
        self._watched = [
            (end.topic_name, is_severe)
            for ends, is_severe in ((critical, True), (others, False)) for end in ends
        ]  # fmt: skip
        # A separate timer: ticks may be rare, and with simulated time they may pause.
        self.create_timer(_GRAPH_PERIOD, self.watch_graph, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def look_for_clashes(self) -> list[Clash]:
        """The clashes at this moment.

        Publishers are counted in the middleware's graph, which takes some microseconds per topic and
        no network traffic. A node that crashed stays in the graph for about 20 s.
        """
        if self._watched is None:
            return []
        found, own = [], (self.get_name(), self.get_namespace())
        # The names are full: `count_publishers` would check and expand each, in five times the time.
        counts = [self.handle.get_count_publishers(topic) for topic, _ in self._watched]
        count = self.get_node_names_and_namespaces().count(own)
        ghosts = self.ghosts() if max([count, *counts]) > 1 else set()
        if count > 1 and own not in ghosts:
            name = self.get_fully_qualified_name()
            found.append(Clash("name", f"{count} nodes are called {name}: end all but one, or "
                               "rename one with -r __node:=NAME", True))
        for (topic, is_severe), count in zip(self._watched, counts):
            if count > 1:
                if ghosts and publishing_nodes(self, topic) <= ghosts:
                    continue
                names = publisher_names(self, topic)
                sentence = f"{count} publishers on {topic} ({names}): end all but one"
                found.append(Clash(topic, sentence, is_severe))
        return found

    def watch_graph(self) -> None:
        """Checks the graph and logs new clashes."""
        before = {clash.key for clash in self.clashes}
        keys_before = {clash.key for clash in self._last_look}
        self._last_look = self.look_for_clashes()
        self.clashes = [clash for clash in self._last_look if clash.key in keys_before]
        for clash in self.clashes:
            if clash.key not in before:
                self.get_logger().error(clash.sentence)
        if {clash.key for clash in self.clashes} != before:
            self.request_diagnostics()

    def ghosts(self) -> set[tuple[str, str]]:
        """Names and namespaces of nodes that are known to have crashed, where they are not this node.
        """
        return set()

    def _watch_clock(self, now: float) -> None:
        """Logs a change of the clock of the stamps; the inputs detect it independently."""
        step = self._clock_watch.step(self.stamp, now)
        if step:
            self.clock_steps += 1
            self.last_clock_step = step
            direction = "ahead" if step > 0.0 else "back"
            self.get_logger().warning(f"the clock was set {direction} by {abs(step):.3f} s: the "
                                      "check of the order of stamps restarts")
            self.request_diagnostics()

    def _warn_of_no_clock(self) -> None:
        if self.tick_clock.ticks == self._last_tick_count:
            self.get_logger().warning("use_sim_time: no tick, /clock is paused or missing",
                                      throttle_duration_sec=_CLOCK_WAIT)
        self._last_tick_count = self.tick_clock.ticks

    def _keep_time_source(self, parameters: list[Parameter]) -> SetParametersResult:
        """Refuses to change `use_sim_time`, because the timer uses one kind of time."""
        for parameter in parameters:
            if parameter.name == "use_sim_time" and parameter.value != self.is_simulated_time:
                return SetParametersResult(
                    successful=False, reason="parameter use_sim_time can be set only at the start"
                )
        return SetParametersResult(successful=True)
