"""A node as a process: in and out cleanly, whatever ends it."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from softrobot_twin.errors import SoftRobotTwinError

if TYPE_CHECKING:
    from softrobot_twin.ros.ticking_node import TickingNode

REFUSED = 2
"""Exit code when a scene, a mesh, a parameter or a command line cannot be used."""
_LONGEST_WAIT = 0.1
"""How long a request to end may have to wait [s]."""


def run_node(
    name: str, load: Callable[[], type[TickingNode]], arguments: Sequence[str] | None = None
) -> int:
    """Runs a node until it is told to end.

    Args:
        name: Name of the node, for errors.
        load: Imports the node's class; an interrupt during imports ends cleanly too.
        arguments: Command line, or None for the process's own.

    Returns:
        Exit code: 0 when it was told to end, 2 when it was refused to begin.
    """
    try:
        return _run(name, load(), arguments)
    except KeyboardInterrupt:
        return 0
    except SoftRobotTwinError as error:
        print(f"{name}: {_one_line(error)}", file=sys.stderr)
        return REFUSED


class _StopRequest:
    """Remembers that the process was told to end.

    Raised as an exception the signal could strike inside rclpy, which then reports it as an error
    of its own.
    """

    def __init__(self):
        self.came = False
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._note)

    def _note(self, number: int, frame: object) -> None:
        self.came = True


def _run(name: str, node_class: type[TickingNode], arguments: Sequence[str] | None) -> int:
    import rclpy
    from rclpy._rclpy_pybind11 import RCLError
    from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
    from rclpy.signals import SignalHandlerOptions

    stop = _StopRequest()
    node = None
    try:
        rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
        node = node_class()
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        with node.collector:
            while rclpy.ok() and not stop.came:
                executor.spin_once(timeout_sec=_LONGEST_WAIT)
    except ExternalShutdownException:
        pass
    except (RCLError, ValueError) as error:
        if node is not None:
            raise
        print(f"{name}: {_one_line(error)}", file=sys.stderr)
        return REFUSED
    finally:
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
    return 0


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())
