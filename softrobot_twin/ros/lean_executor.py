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

from softrobot_twin.errors import one_line, printable

EVENTS_PERIOD = 1.0
"""Time between two looks at the events of publishers and subscriptions, such as another node with an
incompatible quality of service [s]."""
REQUESTS_PERIOD = 0.1
"""Time between two looks at the services of parameters [s]."""
_NANOSECONDS = 1_000_000_000


class _Waiting:
    """Some entities, and a wait set for them.

    Args:
        context: Their context.
        subscriptions: Subscriptions.
        guards: Guard conditions, which only end a wait.
        timers: Timers.
        services: Services.
        events: Handlers of events.
    """

    def __init__(self, context, subscriptions=(), guards=(), timers=(), services=(), events=()):
        self.set = WaitSet(len(subscriptions), len(guards), len(timers), 0, len(services),
                           len(events), context.handle)  # fmt: skip
        self._adders = [
            (add, one.handle)
            for add, kind in (
                (self.set.add_subscription, subscriptions), (self.set.add_guard_condition, guards),
                (self.set.add_timer, timers), (self.set.add_service, services))
            for one in kind
        ] + [(event.add_to_wait_set, self.set) for event in events]  # fmt: skip
        self._by_pointer = {one.handle.pointer: one for one in (*subscriptions, *timers, *services)}

    def wait(self, timeout: int) -> None:
        """Waits for this time [ns], or until something is ready."""
        self.set.clear_entities()
        for add, entity in self._adders:
            add(entity)
        self.set.wait(timeout)

    def ready(self, kind: str) -> list:
        """The entities of a kind, such as ``timer``, that are ready after a wait."""
        return [self._by_pointer[pointer] for pointer in self.set.get_ready_entities(kind)]


class _Entities:
    """The entities of an executor's nodes, and wait sets for them.

    Attributes:
        is_known: False where the nodes have entities that only rclpy's executor can handle.
        often: Those at which a wait ends.
        rare: The services of parameters.
    """

    def __init__(self, nodes, guards, context):
        subscriptions, timers, services, self._events = (
            [one for node in nodes for one in getattr(node, kind)]
            for kind in ("subscriptions", "timers", "services", "waitables")
        )
        rare = [one for one in services if _is_of_parameters(one)]
        self.is_known = (
            not any(list(node.clients) or list(node.guards) for node in nodes)
            and all(type(event) is EventHandler for event in self._events)
            and not any(inspect.iscoroutinefunction(one.callback)
                        for one in (*subscriptions, *timers, *services))
        )  # fmt: skip
        often = [one for one in services if one not in rare]
        self.often = _Waiting(context, subscriptions, guards, timers, often)
        self.rare = _Waiting(context, services=rare)
        self._of_events = _Waiting(context, events=self._events)

    def take_events(self) -> None:
        """Calls the handlers of events that have happened."""
        self._of_events.wait(0)
        for event in self._events:
            if event.is_ready(self._of_events.set) and (data := event.take_data()):
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
        """Adds a node; see `rclpy.executors.Executor.add_node`.

        Args:
            node: The node.
        """
        self._entities = None
        return super().add_node(node)

    def remove_node(self, node) -> None:
        """Removes a node; see `rclpy.executors.Executor.remove_node`.

        Args:
            node: The node.
        """
        self._entities = None
        super().remove_node(node)

    def spin_once(self, timeout_sec: float | None = None) -> None:
        """Runs the callbacks that are ready, or that get ready within a timeout [s]. It may return
        earlier, when an entity was created or destroyed.

        Args:
            timeout_sec: None waits without limit.

        Raises:
            ExternalShutdownException: The context was shut down.
            Exception: That of a callback, or an ExceptionGroup of those of several. All that were
                ready have been called: what always fails keeps no timer from its turn.
        """
        if self._entities is None:
            guards = (self._guard, self._sigint_gc)
            self._entities = _Entities(self.get_nodes(), guards, self._context)
        entities = self._entities
        if not entities.is_known or self._tasks:
            super().spin_once(timeout_sec)
            return
        timeout = -1 if timeout_sec is None else max(0, int(timeout_sec * _NANOSECONDS))
        often = entities.often
        often.wait(timeout)
        services = often.ready("service")
        if time.monotonic() >= self._requests_due:
            self._requests_due = time.monotonic() + REQUESTS_PERIOD
            entities.rare.wait(0)
            services += entities.rare.ready("service")
        if not self._context.ok():
            raise ExternalShutdownException()
        failures: list[Exception] = []
        for take, ready in (
            (_take_message, often.ready("subscription")), (_call_timer, often.ready("timer")),
            (_answer, services),
        ):  # fmt: skip
            for entity in ready:
                try:
                    take(entity)
                except InvalidHandle:
                    continue  # Another callback has destroyed it.
                except Exception as failure:  # noqa: BLE001 - the others have their turn
                    failures.append(failure)
        if time.monotonic() >= self._events_due:
            self._events_due = time.monotonic() + EVENTS_PERIOD
            entities.take_events()
        if failures:
            raise failures[0] if len(failures) == 1 else ExceptionGroup("callbacks", failures)


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
    if header is None:
        return
    response = service.srv_type.Response()
    try:
        response = service.callback(request, response)
    except Exception as failure:
        # Who asked would wait for ever.
        if hasattr(response, "message"):
            response.message = printable(f"failed: {type(failure).__name__}: {one_line(failure)}")
            service.send_response(response, header)
        raise
    service.send_response(response, header)
