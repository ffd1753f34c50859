"""An executor that costs a tick little.

Before each callback rclpy's executor collects all entities of its nodes, enters and leaves the handle
of each, and makes a new wait set; then its own guard condition wakes it once more. A node of the twin
has about 30 entities and 60 handlers of events, which then cost a millisecond a tick. This executor
keeps its list of entities and its wait set until an entity is created or destroyed.
"""

from __future__ import annotations

import inspect
import time

from rclpy._rclpy_pybind11 import InvalidHandle, WaitSet
from rclpy.event_handler import EventHandler
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.service import Service
from rclpy.subscription import Subscription
from rclpy.timer import Timer

EVENTS_PERIOD = 1.0
"""Time between two looks at the events of publishers and subscriptions, such as another node with an
incompatible quality of service [s]."""
_NANOSECONDS = 1_000_000_000


class _Entities:
    """The entities of an executor's nodes, and a wait set for them.

    Attributes:
        is_known: False where the nodes have entities that only rclpy's executor can handle.
    """

    def __init__(self, nodes, guards, context):
        self.subscriptions: list[Subscription] = [one for node in nodes for one in node.subscriptions]
        self.timers: list[Timer] = [one for node in nodes for one in node.timers]
        self.services: list[Service] = [one for node in nodes for one in node.services]
        self.events: list[EventHandler] = [one for node in nodes for one in node.waitables]
        self._guards = guards
        callbacks = [one.callback for one in (*self.subscriptions, *self.timers, *self.services)]
        self.is_known = (
            not any(list(node.clients) or list(node.guards) for node in nodes)
            and all(type(event) is EventHandler for event in self.events)
            and not any(inspect.iscoroutinefunction(callback) for callback in callbacks)
        )
        self._wait_set = WaitSet(
            len(self.subscriptions), len(guards), len(self.timers), 0, len(self.services), 0,
            context.handle,
        )  # fmt: skip
        self._event_set = WaitSet(0, 0, 0, 0, 0, len(self.events), context.handle)

    def wait(self, timeout: int) -> tuple[list[Subscription], list[Timer], list[Service]]:
        """Waits for this time [ns], or until something is ready; returns that."""
        wait_set = self._wait_set
        wait_set.clear_entities()
        for subscription in self.subscriptions:
            wait_set.add_subscription(subscription.handle)
        for guard in self._guards:
            wait_set.add_guard_condition(guard.handle)
        for timer in self.timers:
            wait_set.add_timer(timer.handle)
        for service in self.services:
            wait_set.add_service(service.handle)
        wait_set.wait(timeout)
        return (
            _ready(self.subscriptions, wait_set.get_ready_entities("subscription")),
            _ready(self.timers, wait_set.get_ready_entities("timer")),
            _ready(self.services, wait_set.get_ready_entities("service")),
        )

    def take_events(self) -> None:
        """Calls the handlers of events that have happened."""
        event_set = self._event_set
        event_set.clear_entities()
        for event in self.events:
            event.add_to_wait_set(event_set)
        event_set.wait(0)
        for event in self.events:
            if event.is_ready(event_set) and (data := event.take_data()):
                event.callback(data)


def _ready(entities: list, pointers: list[int]) -> list:
    """The entities whose handles are among the ready ones."""
    return [one for one in entities if one.handle.pointer in pointers] if pointers else []


class LeanExecutor(SingleThreadedExecutor):
    """Runs the callbacks of its nodes in the thread that calls `spin_once`.

    Messages that have arrived are taken before a timer fires. Nodes with clients, guard conditions,
    coroutines or tasks are left to rclpy's executor.
    """

    def __init__(self, **arguments):
        super().__init__(**arguments)
        self._entities: _Entities | None = None
        self._events_due = 0.0

    def wake(self) -> None:
        """Called when an entity of a node is created or destroyed."""
        self._entities = None
        super().wake()

    def add_node(self, node) -> bool:
        """Adds a node; see `rclpy.executors.Executor.add_node`."""
        self._entities = None
        return super().add_node(node)

    def remove_node(self, node) -> None:
        """Removes a node; see `rclpy.executors.Executor.remove_node`."""
        self._entities = None
        super().remove_node(node)

    def spin_once(self, timeout_sec: float | None = None) -> None:
        """Runs the callbacks that are ready, or that get ready within a timeout [s]. It may return
        earlier, when an entity was created or destroyed.

        Args:
            timeout_sec: None waits without limit.

        Raises:
            ExternalShutdownException: The context was shut down.
        """
        if self._entities is None:
            guards = (self._guard, self._sigint_gc)
            self._entities = _Entities(self.get_nodes(), guards, self._context)
        entities = self._entities
        if not entities.is_known or self._tasks:
            super().spin_once(timeout_sec)
            return
        timeout = -1 if timeout_sec is None else max(0, int(timeout_sec * _NANOSECONDS))
        subscriptions, timers, services = entities.wait(timeout)
        if not self._context.ok():
            raise ExternalShutdownException()
        for take, ready in (
            (_take_message, subscriptions), (_call_timer, timers), (_answer, services)
        ):  # fmt: skip
            for entity in ready:
                try:
                    take(entity)
                except InvalidHandle:
                    continue  # Another callback has destroyed it.
        if time.monotonic() >= self._events_due:
            self._events_due = time.monotonic() + EVENTS_PERIOD
            entities.take_events()


def _take_message(subscription: Subscription) -> None:
    taken = subscription.handle.take_message(subscription.msg_type, subscription.raw)
    if taken is None:
        return
    if subscription._callback_type is Subscription.CallbackType.MessageOnly:
        taken = taken[:1]
    subscription.callback(*taken)


def _call_timer(timer: Timer) -> None:
    # A timer that was cancelled meanwhile is ready for rcl, and is not to be called.
    if timer.handle.is_timer_ready():
        timer.handle.call_timer()
        timer.callback()


def _answer(service: Service) -> None:
    request, header = service.handle.service_take_request(service.srv_type.Request)
    if header is not None:
        service.send_response(service.callback(request, service.srv_type.Response()), header)
