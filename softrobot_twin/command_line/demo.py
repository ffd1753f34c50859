"""``demo``: a simulated robot driven live."""

from __future__ import annotations

import argparse
import signal
from pathlib import Path

from softrobot_twin.command_line.arguments import add_command, seconds
from softrobot_twin.errors import SoftRobotTwinError


class NoRosError(SoftRobotTwinError):
    """rclpy cannot be imported."""

    def __init__(self, reason: str):
        super().__init__(f"ROS 2 is not here ({reason}): source ROS 2 Jazzy, or run 'make demo'")


def add_demo(commands) -> None:
    """Declares ``demo``."""
    parser = add_command(
        commands, "demo", _demo, "drive a simulated robot live over ROS 2",
        "Start twin, device and target as three processes, follow a path open loop "
        "and again closed loop, and report how well that went.")
    parser.add_argument("--robot", default="diamond", metavar="NAME",
                        help="config/NAME.yaml says which (default diamond)")
    parser.add_argument("--output", default=Path("out/demo"), metavar="FOLDER", type=Path,
                        help="where report.json, run.rrd and tracking.png go (default out/demo)")
    parser.add_argument("--seconds", default=30.0, type=seconds, metavar="S",
                        help="length of each of the two runs [s] (default 30)")
    parser.add_argument("--no-view", dest="view", action="store_false",
                        help="serve no live view and open none; run.rrd is recorded all the same")


def hear_interrupts() -> None:
    """A shell starts a background job with Ctrl-C ignored; this one, and what it starts, hear it."""
    signal.signal(signal.SIGINT, signal.default_int_handler)


def _demo(chosen: argparse.Namespace) -> int:
    hear_interrupts()
    # Before all else: the wheels of ROS start this process anew when rclpy is imported.
    try:
        import softrobot_twin.ros.demo  # noqa: F401
    except ImportError as error:
        raise NoRosError(str(error)) from error
    from softrobot_twin.demo_command import demo
    return demo(chosen.robot, chosen.output, chosen.seconds, chosen.view)
