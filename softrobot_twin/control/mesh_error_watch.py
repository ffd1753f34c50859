"""The discretisation error of a running twin, estimated by a process of lowest priority.

The solution of a state with elements of higher order takes longer than a tick. A thread would hold
Python's interpreter lock, which the tick needs; a separate process does not. The tick sends a few
numbers from time to time and reads the results that have arrived: it never waits.

`MeshErrorWatch` runs in the twin; `main` is the program of the other process.
"""

from __future__ import annotations

import os
import pickle
import signal
import struct
import subprocess
import sys
from time import perf_counter
from typing import TYPE_CHECKING, BinaryIO

# `yield_to_all` runs before numpy is imported: threads of its libraries inherit the priority.
if TYPE_CHECKING:
    from softrobot_twin.simulation import Simulation
    from softrobot_twin.simulation.mesh_error import MeshError

LENGTH = struct.Struct("<I")
"""The header of each message: its length in bytes."""
REST, STATE, UNKNOWN = "rest", "state", "unknown"

# Pause before the next request, in durations of the last estimate: a fifth of a processor at most.
_PAUSE = 4.0
_END_TIMEOUT = 2.0
_PROGRAM = "from softrobot_twin.control.mesh_error_watch import main; main({})"


def framed(content: object) -> bytes:
    """A message with its header."""
    body = pickle.dumps(content)
    return LENGTH.pack(len(body)) + body


# --- in the twin ---------------------------------------------------------------------------------


class MeshErrorWatch:
    """Requests estimates and keeps the newest.

    Attributes:
        at_rest: Discretisation error at rest; None until it is known.
        newest: Error of the effectors' positions by the mesh, in the newest estimated state [m];
            NaN before the first estimate, and when there is none.
        estimates: Number of estimated states.
        cause: Why there is no estimate of states; empty when there is one, or will be.
    """

    def __init__(self, simulation: Simulation, yields: bool = True):
        """Starts the process.

        Args:
            simulation: The twin's simulation, whose scene is examined.
            yields: Whether the process has the lowest priority.
        """
        self.at_rest: MeshError | None = None
        self.newest = float("nan")
        self.estimates = 0
        self.cause = ""
        self._received = b""
        self._unsent = framed(simulation.scene)
        self._waiting, self._next = True, 0.0
        paths = os.pathsep.join(path for path in sys.path if path)
        self._process = subprocess.Popen(
            [sys.executable, "-c", _PROGRAM.format(yields)],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
            env={**os.environ, "PYTHONPATH": paths, "OPENBLAS_NUM_THREADS": "1"},
        )  # fmt: skip
        for pipe in (self._process.stdin, self._process.stdout):
            os.set_blocking(pipe.fileno(), False)
        self._send()

    def offer(self, simulation: Simulation, forces_given: bool, now: float) -> None:
        """Takes results that have arrived, and requests the present state when due. Never waits.

        Args:
            simulation: The twin's simulation.
            forces_given: True when its actuators keep efforts, false when they keep setpoints.
            now: Time on a monotonic clock [s].
        """
        from softrobot_twin.simulation.mesh_error import ActuatorLoads

        self._receive(now)
        if not (self._waiting or self.cause) and now >= self._next:
            self._waiting = True
            self._unsent = framed(ActuatorLoads.of(simulation, forces_given))
        self._send()

    def close(self) -> None:
        """Ends the process."""
        self._process.stdin.close()
        self._process.terminate()
        try:
            self._process.wait(_END_TIMEOUT)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._process.stdout.close()

    def _send(self) -> None:
        """Writes as much as the pipe accepts."""
        while self._unsent:
            try:
                count = os.write(self._process.stdin.fileno(), self._unsent)
            except BlockingIOError:
                return
            except OSError:
                self._end("its process has ended")
                return
            self._unsent = self._unsent[count:]

    def _receive(self, now: float) -> None:
        while not self.cause:
            try:
                content = os.read(self._process.stdout.fileno(), 65536)
            except BlockingIOError:
                break
            if not content:
                self._end("its process has ended")
                break
            self._received += content
            self._take_messages(now)

    def _take_messages(self, now: float) -> None:
        """Takes the messages that have arrived completely."""
        while len(self._received) >= LENGTH.size:
            end = LENGTH.size + LENGTH.unpack(self._received[: LENGTH.size])[0]
            if len(self._received) < end:
                return
            self._take(pickle.loads(self._received[LENGTH.size : end]), now)
            self._received = self._received[end:]

    def _take(self, message: tuple, now: float) -> None:
        kind, *content = message
        self._waiting = False
        if kind == REST:
            self.at_rest = content[0]
        elif kind == STATE:
            self.newest, duration = content
            self.estimates += 1
            self._next = now + _PAUSE * duration
        else:
            self._end(content[0])

    def _end(self, cause: str) -> None:
        """Records that there will be no more estimates."""
        self.cause = self.cause or cause
        self.newest = float("nan")
        self._unsent = b""


# --- in the other process ------------------------------------------------------------------------


def yield_to_all() -> None:
    """Sets the lowest priority; an inherited priority has no effect.

    SCHED_IDLE where the system allows it, otherwise SCHED_OTHER, never a real-time policy; with the
    greatest nice value in both cases.
    """
    for policy in (os.SCHED_IDLE, os.SCHED_OTHER):
        try:
            os.sched_setscheduler(0, policy, os.sched_param(0))
            break
        except OSError:
            continue
    os.nice(19)


def serve(requests: BinaryIO, replies: BinaryIO) -> None:
    """Answers until the other end closes: first the mesh at rest, then each requested state.

    Args:
        requests: The scene, then `ActuatorLoads` for each state.
        replies: ``(REST, MeshError)``, then ``(STATE, error [m], duration [s])`` for each state;
            ``(UNKNOWN, reason)`` and the end when there is no estimate or it failed.
    """
    from softrobot_twin.simulation.mesh_error import (
        MeshErrorEstimator,
        MeshErrorUnknown,
        check_judges_states,
    )

    def reply(*content: object) -> None:
        replies.write(framed(content))
        replies.flush()

    scene = _read(requests)
    if scene is None:
        return
    try:
        estimator = MeshErrorEstimator(scene)
        reply(REST, estimator.at_rest())
        check_judges_states(scene)
        while (asked := _read(requests)) is not None:
            begin = perf_counter()
            reply(STATE, estimator.at(asked), perf_counter() - begin)
    except MeshErrorUnknown as unknown:
        reply(UNKNOWN, unknown.reason)
    except BrokenPipeError:
        raise
    except Exception as error:  # noqa: BLE001 - the twin reports it; its stderr is not read
        reply(UNKNOWN, f"it failed: {type(error).__name__}: {error}")


def _read(stream: BinaryIO):
    """The next message; None when the other end has closed."""
    head = stream.read(LENGTH.size)
    if len(head) < LENGTH.size:
        return None
    size = LENGTH.unpack(head)[0]
    body = stream.read(size)
    return pickle.loads(body) if len(body) == size else None


def main(yields: bool = True) -> None:
    """Serves standard input and output. The twin, not this process, handles an interrupt.

    Args:
        yields: Whether to set the lowest priority.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if yields:
        yield_to_all()
    replies = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # print() must not write between replies
    try:
        serve(sys.stdin.buffer, replies)
    except BrokenPipeError:
        pass  # The twin has ended.
