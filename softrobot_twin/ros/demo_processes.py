"""The processes of a demo: started together, watched, and ended together."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

from softrobot_twin.errors import SoftRobotTwinError

LAST_LINES = 15
"""Lines of a dead process's output that its error shows."""

_NICE = 5
"""Nice value of all but the twin on a single core."""

_PATIENCE = ((signal.SIGINT, 10.0), (signal.SIGTERM, 5.0), (signal.SIGKILL, 5.0))
"""How a process is asked to end, and how long it may take after each [s]."""


class Place(NamedTuple):
    """How a process shares the processor.

    Attributes:
        nice: What is added to its nice value.
        cores: Cores that it may use.
    """

    nice: int
    cores: frozenset[int]

    def give(self, process: int) -> None:
        """Puts a process there, and what it will start; 0 is this one."""
        try:
            os.sched_setaffinity(process, self.cores)
            if self.nice:
                before = os.getpriority(os.PRIO_PROCESS, process)
                os.setpriority(os.PRIO_PROCESS, process, before + self.nice)
        except OSError:
            pass  # It ended already, which is told, or a container forbids it: then it stays.


def places(cores: Iterable[int]) -> tuple[Place, Place]:
    """Places of the twin and of everything else.

    The twin has the first half of the cores and the rest the other half; on a single core the
    rest runs after the twin. A demo's device is a simulation as large as the twin, which a robot
    is not, and the twin's drawing must not slow it down either.

    Args:
        cores: Cores that the demo may use.
    """
    every = sorted(cores)
    if len(every) == 1:
        return Place(0, frozenset(every)), Place(_NICE, frozenset(every))
    half = len(every) // 2
    # Not nice beside: on a busy machine the device would be late, which no robot is.
    return Place(0, frozenset(every[:half])), Place(0, frozenset(every[half:]))


class ProcessDiedError(SoftRobotTwinError):
    """A process of the demo ended while it was still needed.

    Attributes:
        name: Which one.
        exit_code: Its exit code; negative is the signal that ended it.
        last_lines: The end of what it wrote.
    """

    def __init__(self, name: str, exit_code: int, last_lines: Sequence[str]):
        self.name = name
        self.exit_code = exit_code
        self.last_lines = tuple(last_lines)
        super().__init__(f"{name} ended with exit code {exit_code}")


class DemoProcess:
    """One Python module run as a process of its own, its output kept in a file.

    It gets a session of its own, so that Ctrl-C on the terminal reaches only the demo, which then
    ends each process once and in order. It gets the whole environment: the ROS wheels set up
    theirs before Python starts and mark that they did.

    Args:
        name: What the demo calls it.
        command: Module and its arguments, as after ``python -m``.
        log: File for its output.
        place: How it shares the processor.
    """

    def __init__(
        self, name: str, command: Sequence[str], log: Path, place: Place | None = None
    ):
        self.name = name
        self.log = log
        with log.open("wb") as file:
            self._process = subprocess.Popen(
                [sys.executable, "-m", *command], stdin=subprocess.DEVNULL, stdout=file,
                stderr=subprocess.STDOUT, env=dict(os.environ), start_new_session=True)
        if place is not None:
            place.give(self._process.pid)

    @property
    def session(self) -> int:
        """Id of its session, which what it starts is in too."""
        return self._process.pid

    @property
    def exit_code(self) -> int | None:
        """None while it runs."""
        return self._process.poll()

    def refuse_death(self) -> None:
        """Raises:
            ProcessDiedError: It no longer runs.
        """
        if self.exit_code is not None:
            raise ProcessDiedError(self.name, self.exit_code, self.last_lines())

    def last_lines(self) -> list[str]:
        """The end of its output."""
        text = self.log.read_text(encoding="utf-8", errors="replace")
        return text.splitlines()[-LAST_LINES:]

    def send(self, number: signal.Signals) -> None:
        """Signals it and whatever it started; nothing when it has ended."""
        if self.exit_code is None:
            os.killpg(self._process.pid, number)

    def wait(self, seconds: float) -> bool:
        """True when it ended within this time."""
        try:
            self._process.wait(seconds)
        except subprocess.TimeoutExpired:
            return False
        return True


def stop_all(processes: Sequence[DemoProcess]) -> dict[str, int | None]:
    """Ends all processes at the same time, first politely.

    Returns:
        Exit code by name; 0 for one that left cleanly on the first asking.
    """
    for number, patience in _PATIENCE:
        waiting = [process for process in processes if process.exit_code is None]
        for process in waiting:
            process.send(number)
        deadline = time.monotonic() + patience
        for process in waiting:
            process.wait(max(0.0, deadline - time.monotonic()))
    return {process.name: process.exit_code for process in processes}
