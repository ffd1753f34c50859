"""A node as a process: in and out cleanly, whatever ends it."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from softrobot_twin.errors import SoftRobotTwinError

if TYPE_CHECKING:
    from rclpy.executors import Executor

    from softrobot_twin.ros.ticking_node import TickingNode

REFUSED = 2
"""Exit code when a scene, a mesh, a parameter or a command line cannot be used."""
_LONGEST_WAIT = 0.1
"""How long a request to end may have to wait [s]."""
_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_SWITCH_INTERVAL = 0.0005
"""How long another thread may keep Python from the tick [s]; Python's own choice, 5 ms, is half a
tick at 100 Hz, and the view draws in threads."""


class _Interrupted(BaseException):
    """An interrupt while the node is built.

    No KeyboardInterrupt: Python remembers one that passed through `exec`, as in making a class,
    and ends the process by a signal though it was caught.
    """


class ArgumentsError(SoftRobotTwinError):
    """The command line cannot be used."""


def run_node(
    name: str, load: Callable[[], type[TickingNode]], arguments: Sequence[str] | None = None
) -> int:
    """Runs a node until it is told to end.

    Args:
        name: Name of the node, for errors.
        load: Imports the node's class.
        arguments: Command line, or None for the process's own.

    Returns:
        Exit code: 0 when it was told to end, 2 when it was refused to begin.
    """
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    stop = _StopRequest()
    try:
        _run(name, load, arguments, stop)
    except SoftRobotTwinError as error:
        print(f"{name}: {_one_line(error)}", file=sys.stderr)
        return REFUSED
    except BaseException:
        # An interrupt that struck inside a library may come out as an error of its own.
        if not stop.came:
            raise
    return 0


class _StopRequest:
    """Hears that the process is told to end, from its first import to its last tick.

    While modules are imported the process ends at once: nothing is open yet, and what is raised
    inside an import is printed by some libraries. While the node is built an interrupt is raised,
    so that it need not wait for meshes and compilers. Once the node runs it is only remembered:
    raised, it could strike inside rclpy, which then reports it as an error of its own.

    Attributes:
        came: True once it did.
    """

    def __init__(self) -> None:
        self.came = False
        self._leaves_at_once = True
        self._raises = False
        # The wheels of ROS start Python anew when rclpy is imported. What is blocked now stays so
        # in the new process and is delivered when that is ready to hear it, here.
        signal.pthread_sigmask(signal.SIG_BLOCK, _SIGNALS)
        try:
            import rclpy  # noqa: F401
        finally:
            for number in _SIGNALS:
                signal.signal(number, self._note)
            sys.unraisablehook = self._drop_interrupts

    def listen(self) -> None:
        """Lets interrupts through; from here on they end the process at once."""
        signal.pthread_sigmask(signal.SIG_UNBLOCK, _SIGNALS)

    def end_by_raising(self) -> None:
        """Raises from now on: there is something to close."""
        self._leaves_at_once, self._raises = False, True

    def only_remember(self) -> None:
        """Raises no more."""
        self._leaves_at_once = self._raises = False

    def _note(self, number: int, frame: object) -> None:
        self.came = True
        if self._leaves_at_once:
            os._exit(0)
        if self._raises:
            self._raises = False
            raise _Interrupted

    def _drop_interrupts(self, unraisable) -> None:
        """Python tells on its own what it cannot raise, such as an interrupt in a destructor."""
        if not (self.came and unraisable.exc_type is _Interrupted):
            sys.__unraisablehook__(unraisable)


def _run(
    name: str, load: Callable[[], type[TickingNode]], arguments: list[str], stop: _StopRequest
) -> None:
    """From the command line to the end.

    Raises:
        SoftRobotTwinError: The node cannot begin; nothing runs any more.
    """
    import rclpy
    from rclpy._rclpy_pybind11 import RCLError
    from rclpy.exceptions import NameValidationException, ParameterException
    from rclpy.executors import SingleThreadedExecutor

    stop.listen()
    if _asks_for_help(arguments):
        from softrobot_twin.ros.node_help import help_of

        print(help_of(name))
        return
    node_class, node = load(), None
    stop.end_by_raising()
    try:
        _start_ros(arguments)
        try:
            node = node_class()
        except (ParameterException, NameValidationException, RCLError, ValueError) as error:
            # rclpy's own words for a name or a value that it cannot use.
            raise ArgumentsError(_one_line(error)) from error
        stop.only_remember()
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        sys.setswitchinterval(_SWITCH_INTERVAL)
        node.take_priority()
        with node.collector:
            spin(node, executor, lambda: stop.came or not rclpy.ok())
    finally:
        stop.only_remember()
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()


def _start_ros(arguments: list[str]) -> None:
    """Hands the command line to ROS.

    Raises:
        ArgumentsError: An argument is not known to ROS or to us, or cannot be read.
    """
    import rclpy
    from rclpy.logging import LoggingSeverity, set_logger_level
    from rclpy.signals import SignalHandlerOptions
    from rclpy.utilities import remove_ros_args

    # rcl tells in lines of its own what is told here in one.
    set_logger_level("rcl", LoggingSeverity.FATAL)
    try:
        rclpy.init(args=["", *arguments], signal_handler_options=SignalHandlerOptions.NO)
        strange = remove_ros_args(["", *arguments])[1:]
    except (RuntimeError, ValueError) as error:
        raise ArgumentsError(_words_of_rcl(error)) from error
    finally:
        set_logger_level("rcl", LoggingSeverity.UNSET)
    if strange:
        raise ArgumentsError(f"unknown arguments {' '.join(strange)}: arguments of ROS follow "
                             "--ros-args; --help says more")


def spin(node: TickingNode, executor: Executor, is_over: Callable[[], bool]) -> None:
    """Runs a node until it is over. A message or a request that fails is refused and told.

    rclpy answers some requests itself and raises what is wrong with them, such as a parameter of
    an unknown type or a time below zero: a message from anybody would end the node.

    Args:
        node: The node; what fails in its ticks is raised.
        executor: Has the node.
        is_over: Asked between callbacks.
    """
    from rclpy.executors import ExternalShutdownException

    while not is_over():
        try:
            executor.spin_once(timeout_sec=_LONGEST_WAIT)
        except ExternalShutdownException:
            return
        except Exception as error:  # noqa: BLE001 - whatever a message brought about.
            if node.is_ticking:
                raise
            node.refuse_request(error)


def _asks_for_help(arguments: Sequence[str]) -> bool:
    return any(word in ("-h", "--help") for word in arguments)


def _words_of_rcl(error: Exception) -> str:
    """What rcl says, without the places in its source."""
    if type(error).__name__ == "UnknownROSArgsError":
        return f"unknown arguments of ROS: {_one_line(error)}; --help says more"
    return _one_line(error).split(", at /")[0].removeprefix("failed to initialize rcl: ")


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())


def twin(arguments: Sequence[str] | None = None) -> int:
    """Entry point of the executable ``twin``, which runs the simulation against the clock.

    Args:
        arguments: Command line, or None for the process's own.

    Returns:
        Exit code.
    """

    def load() -> type:
        from softrobot_twin.ros.twin_node import TwinNode
        return TwinNode

    return run_node("twin", load, arguments)


def device(arguments: Sequence[str] | None = None) -> int:
    """Entry point of the executable ``device``, which stands in for the hardware; see `twin`."""

    def load() -> type:
        from softrobot_twin.ros.device_node import DeviceNode
        return DeviceNode

    return run_node("device", load, arguments)


def target(arguments: Sequence[str] | None = None) -> int:
    """Entry point of the executable ``target``, which leads an effector on a path; see `twin`."""

    def load() -> type:
        from softrobot_twin.ros.target_node import TargetNode
        return TargetNode

    return run_node("target", load, arguments)


if __name__ == "__main__":
    # ``python -m softrobot_twin.ros.process twin``: the demo starts nodes without their scripts.
    sys.exit({"twin": twin, "device": device, "target": target}[sys.argv[1]](sys.argv[2:]))
