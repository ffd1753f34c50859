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
REQUESTS_PERIOD = 0.1
"""Time between two looks at the services of parameters [s]."""
_NANOSECONDS = 1_000_000_000


class _Entities:
    """The entities of an executor's nodes, and a wait set for them.

    Attributes:
        is_known: False where the nodes have entities that only rclpy's executor can handle.
    """

    def __init__(self, nodes, guards, context):
        subscriptions = [one for node in nodes for one in node.subscriptions]
        timers = [one for node in nodes for one in node.timers]
        every = [one for node in nodes for one in node.services]
        services = [one for one in every if not _is_of_parameters(one)]
        self._rare = [one.handle for one in every if _is_of_parameters(one)]
        self.events: list[EventHandler] = [one for node in nodes for one in node.waitables]
        self._handles = [
            [one.handle for one in kind] for kind in (subscriptions, guards, timers, services)
        ]
        self._by_pointer = {one.handle.pointer: one for one in (*subscriptions, *timers, *every)}
        callbacks = [one.callback for one in (*subscriptions, *timers, *every)]
        self.is_known = (
            not any(list(node.clients) or list(node.guards) for node in nodes)
            and all(type(event) is EventHandler for event in self.events)
            and not any(inspect.iscoroutinefunction(callback) for callback in callbacks)
        )
        self._wait_set = WaitSet(
            len(subscriptions), len(guards), len(timers), 0, len(services), 0,
            context.handle,
        )  # fmt: skip
        self._rare_set = WaitSet(0, 0, 0, 0, len(self._rare), 0, context.handle)
        self._event_set = WaitSet(0, 0, 0, 0, 0, len(self.events), context.handle)

    def wait(self, timeout: int) -> tuple[list[Subscription], list[Timer], list[Service]]:
        """Waits for this time [ns], or until something is ready; returns that."""
        wait_set = self._wait_set
        subscriptions, guards, timers, services = self._handles
        wait_set.clear_entities()
        for handle in subscriptions:
            wait_set.add_subscription(handle)
        for handle in guards:
            wait_set.add_guard_condition(handle)
        for handle in timers:
            wait_set.add_timer(handle)
        for handle in services:
            wait_set.add_service(handle)
        wait_set.wait(timeout)
        return (
            self._ready(wait_set, "subscription"), self._ready(wait_set, "timer"),
            self._ready(wait_set, "service"),
        )

    def requests(self) -> list[Service]:
        """The services of parameters that have a request."""
        self._rare_set.clear_entities()
        for handle in self._rare:
            self._rare_set.add_service(handle)
        self._rare_set.wait(0)
        return self._ready(self._rare_set, "service")

    def _ready(self, wait_set: WaitSet, kind: str) -> list:
        """The entities of a kind that are ready in a wait set."""
        return [self._by_pointer[pointer] for pointer in wait_set.get_ready_entities(kind)]

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


def _is_of_parameters(service: Service) -> bool:
    """Whether a service is one that each node has, as those of its parameters."""
    return service.srv_type.__module__.split(".")[0] in ("rcl_interfaces", "type_description_interfaces")


class LeanExecutor(SingleThreadedExecutor):
    """Runs the callbacks of its nodes in the thread that calls `spin_once`.

    Messages that have arrived are taken before a timer fires. Nodes with clients, guard conditions,
    coroutines or tasks are left to rclpy's executor.
    """

    def __init__(self, **arguments):
        super().__init__(**arguments)
        self._entities: _Entities | None = None
        self._events_due = self._requests_due = 0.0

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
        if time.monotonic() >= self._requests_due:
            self._requests_due = time.monotonic() + REQUESTS_PERIOD
            services += entities.requests()
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
