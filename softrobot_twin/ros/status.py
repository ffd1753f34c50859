"""The twin's ``~/status``: what the loop does now, latched, published when it changes."""

from __future__ import annotations

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.node import Node

from softrobot_twin.control.twin_loop import TickOutcome, TwinLoop
from softrobot_twin.ros.diagnostics import status_message
from softrobot_twin.ros.topics import TWIN_TOPICS, open_publisher
from softrobot_twin.simulation import Status

LEAST_PERIOD = 0.05
"""Least time between two messages [s]: a status that changes at every tick is not sent at every
tick. The last one is always sent."""
_GOOD = (Status.OK, Status.LINEARIZED, Status.RATE_LIMITED)


class StatusOutput:
    """Publishes the activity of a loop, the status of its step and its active limits.

    Args:
        node: The twin.
        loop: Its loop.
    """

    def __init__(self, node: Node, loop: TwinLoop):
        self._loop, self._sent, self._due = loop, None, float("-inf")
        self.publisher = open_publisher(node, TWIN_TOPICS["~/status"])
        self._name = node.get_fully_qualified_name().lstrip("/")

    def offer(self, outcome: TickOutcome, now: float) -> None:
        """Publishes a tick if it differs from the last one published.

        Args:
            outcome: The tick.
            now: Its time on the clock of the ticks [s].
        """
        result = outcome.result
        found = (outcome.activity, outcome.cause, result.status, result.report.active_limits,
                 outcome.violated, self._loop.why_given_up, result.report.is_resting,
                 result.report.is_exploring)  # fmt: skip
        # With simulated time the clock may be set back.
        if found == self._sent or (now < self._due and self._due - now <= LEAST_PERIOD):
            return
        self._due = now + LEAST_PERIOD
        level = DiagnosticStatus.OK if result.status in _GOOD else DiagnosticStatus.WARN
        if result.status.is_failure or outcome.violated or self._loop.why_given_up:
            level = DiagnosticStatus.ERROR
        activity, status = outcome.activity.value, result.status.value
        cause = self._loop.why_given_up or outcome.cause
        if not cause and result.report.is_exploring:
            cause = "looks for a nearer pose"
        message = f"{activity}: {status}" + (f" ({cause})" if cause else "")
        self._publish(found, level, message, {
            "activity": activity,
            "cause": cause,
            "status": status,
            "active_limits": " ".join(result.report.active_limits),
            "resting": str(result.report.is_resting).lower(),
            "exploring": str(result.report.is_exploring).lower(),
            "kept_back": " ".join(outcome.violated),
        })  # fmt: skip

    def tell_failure(self, failure: str) -> None:
        """Publishes that a tick ended with an exception, in one line.

        Args:
            failure: What the exception says, in one line.
        """
        loop = self._loop
        found = (failure, loop.why_given_up)
        if found == self._sent:
            return
        activity, cause = loop.activity.value, loop.why_given_up or failure
        self._publish(found, DiagnosticStatus.ERROR, f"{activity}: a tick failed ({cause})", {
            "activity": activity, "cause": cause, "status": "exception", "active_limits": "",
            "kept_back": "",
        })  # fmt: skip

    def _publish(self, found: tuple, level: bytes, message: str, values: dict[str, object]) -> None:
        """Publishes what was found; see `DiagnosticStatus`."""
        self._sent, loop = found, self._loop
        values |= {"mode": loop.mode.value, "uses_device": str(loop.use_device).lower()}
        self.publisher.publish(status_message(
            f"{self._name}: status", loop.simulation.scene.name, (level, message, values)))
