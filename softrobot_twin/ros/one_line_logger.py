"""A logger whose messages are one line each: no name in one forges another, or colours a terminal."""

from __future__ import annotations

import os

from rclpy.impl import rcutils_logger
from rclpy.impl.logging_severity import LoggingSeverity
from rclpy.impl.rcutils_logger import RcutilsLogger

from softrobot_twin.errors import printable

# By the place of the call rclpy tells messages apart, for instance to throttle them: not this file.
rcutils_logger._internal_callers.append(os.path.realpath(__file__))


class OneLineLogger(RcutilsLogger):
    """Logs all messages of a node as `printable` makes them.

    Here, and nowhere else, names of nodes, topics, files and parameters are escaped for the log.
    """

    def log(self, message: str, severity: LoggingSeverity, **filters) -> bool:
        """Logs a message; see `rclpy.impl.rcutils_logger.RcutilsLogger.log`.

        Args:
            message: The message.
            severity: Its severity.
            **filters: As there, such as ``throttle_duration_sec``.
        """
        return super().log(printable(message), severity, **filters)
