"""Runs a node as a process: start, signals and a clean end.

Signals are handled differently in four phases: while modules are imported the process exits at
once, while the node is built an exception is raised, while it runs the request is recorded, and
after its end they are ignored.
"""

from __future__ import annotations

import os
import re
import signal
import sys
from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING

from softrobot_twin.errors import SceneError, SoftRobotTwinError, one_line, printable_lines

if TYPE_CHECKING:
    from rclpy.executors import Executor

    from softrobot_twin.ros.ticking_node import TickingNode

REFUSED = 2
"""Exit code when a scene, a mesh, a parameter or a command line cannot be used."""
_LONGEST_WAIT = 0.1
"""Longest time until a request to end is noticed [s]."""
_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_SWITCH_INTERVAL = 0.0005
"""How long another thread may hold Python's lock while a tick waits [s]. Python's default of 5 ms
is half a tick at 100 Hz, and the view draws in threads.
"""


_NAMESPACE = "__ns:="
_IS_NAMESPACE = re.compile(r"/|(/[A-Za-z_][A-Za-z0-9_]*)+").fullmatch


class _Interrupted(BaseException):
    """An interrupt while the node is built.

    This is not a KeyboardInterrupt: when one passes through `exec`, for instance while a class is
    created, Python ends the process by a signal even though the exception was caught.
    """


class ArgumentsError(SoftRobotTwinError):
    """The command line cannot be used."""


def run_node(
    name: str, load: Callable[[], type[TickingNode]], arguments: Sequence[str] | None = None,
    about: Callable[[], str] | None = None,
) -> int:
    """Runs a node until a signal ends it.

    Args:
        name: Name of the node, for errors.
        load: Imports the node's class.
        arguments: Command line, or None for the process's own.
        about: Text of ``--help``; None for a node of this package.

    Returns:
        Exit code: 0 after a signal, 2 when the node cannot start.
    """
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    stop = _StopRequest()
    try:
        _run(name, load, arguments, stop, about)
    except SoftRobotTwinError as error:
        words = str(error) if isinstance(error, SceneError) else one_line(error)
        print(f"{name}: {printable_lines(words)}", file=sys.stderr)
        return REFUSED
    except BaseException:
        # A library may turn an interrupt into an error of its own.
        if not stop.received:
            raise
    finally:
        stop.ignore()
    return 0


class _StopRequest:
    """Handles the signals that end the process, from the first import to the last tick.

    While modules are imported, a signal exits the process at once: nothing is open yet, and some
    libraries print exceptions raised inside an import. While the node is built, a signal raises an
    exception, so that it need not wait for meshes and compilers. Once the node runs, a signal is
    only recorded: an exception could interrupt rclpy, which would report an error of its own.

    Attributes:
        received: True after a signal.
    """

    def __init__(self) -> None:
        self.received = self._has_raised = False
        self._react: Callable[[], None] = partial(os._exit, 0)
        # The ROS wheels restart Python when rclpy is imported. Signals blocked here stay blocked in
        # the new process and are delivered in `listen`.
        signal.pthread_sigmask(signal.SIG_BLOCK, _SIGNALS)
        try:
            import rclpy  # noqa: F401
        finally:
            for number in _SIGNALS:
                signal.signal(number, self._handle)
            sys.unraisablehook = self._drop_interrupts

    def listen(self) -> None:
        """Unblocks the signals; from now on they exit the process at once."""
        signal.pthread_sigmask(signal.SIG_UNBLOCK, _SIGNALS)

    def raise_on_signal(self) -> None:
        """From now on a signal raises an exception, so that open resources are closed."""
        self._react = self._interrupt

    def only_record(self) -> None:
        """From now on a signal is only recorded."""
        self._react = lambda: None

    def ignore(self) -> None:
        """From now on signals do nothing: all is closed. While Python ends it would give them back
        their default, and one more, as ``ros2 launch`` sends to a slow process, would look as if
        the node had died.
        """
        for number in _SIGNALS:
            signal.signal(number, signal.SIG_IGN)

    def _handle(self, number: int, frame: object) -> None:
        self.received = True
        self._react()

    def _interrupt(self) -> None:
        self.only_record()
        self._has_raised = True
        raise _Interrupted

    def _drop_interrupts(self, unraisable) -> None:
        """Hides an interrupt that Python could not raise, for instance inside a destructor, and
        what destructors say of objects that it left half made.
        """
        if not self._has_raised:
            sys.__unraisablehook__(unraisable)


def _run(
    name: str, load: Callable[[], type[TickingNode]], arguments: list[str], stop: _StopRequest,
    about: Callable[[], str] | None,
) -> None:
    """Runs the node from the command line to its end.

    Raises:
        SoftRobotTwinError: The node cannot start; everything has been closed.
    """
    import rclpy
    from rclpy._rclpy_pybind11 import RCLError
    from rclpy.exceptions import NameValidationException, ParameterException

    from softrobot_twin.ros.lean_executor import LeanExecutor

    stop.listen()
    if {"-h", "--help"} & set(arguments):
        from softrobot_twin.ros.node_help import help_of

        print(help_of(name) if about is None else about())
        return
    node_class, node = load(), None
    stop.raise_on_signal()
    try:
        _start_ros(arguments)
        try:
            node = node_class()
        except (ParameterException, NameValidationException, RCLError, ValueError) as error:
            # The message is rclpy's own.
            raise ArgumentsError(one_line(error)) from error
        stop.only_record()
        executor = LeanExecutor()
        executor.add_node(node)
        sys.setswitchinterval(_SWITCH_INTERVAL)
        node.take_priority()
        with node.collector:
            spin(node, executor, lambda: stop.received)
    finally:
        stop.only_record()
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()


def _start_ros(arguments: list[str]) -> None:
    """Initializes ROS with the command line.

    Raises:
        ArgumentsError: An argument is unknown to ROS and to this package, or cannot be read.
    """
    import rclpy
    from rclpy.logging import LoggingSeverity, set_logger_level
    from rclpy.signals import SignalHandlerOptions
    from rclpy.utilities import remove_ros_args

    _check_namespace(arguments)
    # rcl would log several lines for what is reported here in one.
    set_logger_level("rcl", LoggingSeverity.FATAL)
    try:
        rclpy.init(args=["", *arguments], signal_handler_options=SignalHandlerOptions.NO)
        strange = remove_ros_args(["", *arguments])[1:]
    except (RuntimeError, ValueError) as error:
        raise ArgumentsError(_rcl_message(error)) from error
    finally:
        set_logger_level("rcl", LoggingSeverity.UNSET)
    if strange:
        raise ArgumentsError(f"unknown arguments {' '.join(strange)}: arguments of ROS must "
                             "follow --ros-args; see --help")


def _check_namespace(arguments: Sequence[str]) -> None:
    """Checks ``-r __ns:=…``, of which rcl tells only at which letter it could not go on.

    Raises:
        ArgumentsError: It is no namespace.
    """
    for word in arguments:
        if word.startswith(_NAMESPACE) and not _IS_NAMESPACE(word.removeprefix(_NAMESPACE)):
            raise ArgumentsError(f"-r {word}: a namespace is made of names of letters, digits and "
                                 "_, each after a / and not beginning with a digit, such as "
                                 "/lab/left")  # fmt: skip


def spin(node: TickingNode, executor: Executor, is_over: Callable[[], bool]) -> None:
    """Runs a node until it ends. A message or request that fails is refused and logged.

    rclpy handles some requests itself and raises an exception for invalid ones, such as a parameter
    of unknown type or a negative time. Without this protection any sender could end the node.

    Args:
        node: The node.
        executor: Executor that contains the node.
        is_over: Called between callbacks; True ends the loop.
    """
    from rclpy.executors import ExternalShutdownException

    while not is_over():
        try:
            executor.spin_once(timeout_sec=_LONGEST_WAIT)
        except ExternalShutdownException:
            return
        except Exception as error:  # noqa: BLE001 - any error caused by a message
            for one in getattr(error, "exceptions", (error,)):
                node.refuse_request(one)


def _rcl_message(error: Exception) -> str:
    """The message of rcl without positions in its source code."""
    if type(error).__name__ == "UnknownROSArgsError":
        return f"unknown arguments of ROS: {one_line(error)}; see --help"
    return one_line(error).split(", at /")[0].removeprefix("failed to initialize rcl: ")


def _twin() -> type:
    from softrobot_twin.ros.twin_node import TwinNode
    return TwinNode


def _device() -> type:
    from softrobot_twin.ros.device_node import DeviceNode
    return DeviceNode


def _target() -> type:
    from softrobot_twin.ros.target_node import TargetNode
    return TargetNode


twin = partial(run_node, "twin", _twin)
"""Entry point of the executable ``twin``, which runs the simulation in real time."""
device = partial(run_node, "device", _device)
"""Entry point of the executable ``device``, which simulates the hardware."""
target = partial(run_node, "target", _target)
"""Entry point of the executable ``target``, which publishes targets along a path."""


if __name__ == "__main__":
    # ``python -m softrobot_twin.ros.process twin``: the demo starts nodes without their scripts.
    sys.exit({"twin": twin, "device": device, "target": target}[sys.argv[1]](sys.argv[2:]))
