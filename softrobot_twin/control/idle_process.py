"""A process of the lowest priority beside a running twin, which answers requests of its tick.

What takes longer than a tick cannot be done in a thread: it would hold Python's interpreter lock,
which the tick needs; a separate process does not. The tick sends a few numbers from time to time
and reads the answers that have arrived: it never waits.

`IdleWatch` runs in the twin; `run` is the program of the other process.
"""

from __future__ import annotations

import os
import pickle
import select
import signal
import struct
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from typing import TYPE_CHECKING, BinaryIO

# `yield_to_all` runs before numpy is imported: threads of its libraries inherit the priority.
if TYPE_CHECKING:
    from softrobot_twin.simulation import Simulation

LENGTH = struct.Struct("<I")
"""The header of each message: its length in bytes."""
STATE, UNKNOWN = "state", "unknown"
"""Kinds of replies: one to a requested state, and the last one, with the reason."""

# Pause before the next request, in durations of the last answer: a fifth of a processor at most.
_PAUSE = 4.0
_END_TIMEOUT = 2.0
LINGER = 10.0
"""A process without a new state to judge gives its memory back after this time [s]: some 270 MB."""
PROGRAM = ("from softrobot_twin.control.idle_process import run; from {module} import serve; "
           "run(serve, {yields})")  # fmt: skip
"""Source of a process that answers by `serve` of the module of a watch."""
_FIRST = "SOFTROBOT_TWIN_FIRST_MESSAGE"
"""Variable of the environment: file that holds the first message for the program that follows."""


def framed(content: object) -> bytes:
    """A message with its header.

    Args:
        content: What is sent; it can be pickled.
    """
    body = pickle.dumps(content)
    return LENGTH.pack(len(body)) + body


# --- in the twin ---------------------------------------------------------------------------------


class IdleWatch:
    """Requests answers and takes the newest; a kind of watch says what is asked and answered.

    The process runs `serve` of the module in which the kind of watch is defined.

    Attributes:
        answers: Number of answered requests.
        cause: Why there are no more answers; empty when there are, or will be.
        process: The other process.
    """

    def __init__(self, simulation: Simulation, yields: bool = True):
        """Starts the process.

        Args:
            simulation: The twin's simulation.
            yields: Whether the process has the lowest priority.
        """
        program = PROGRAM.format(module=type(self).__module__, yields=yields)
        self.answers = 0
        self.cause = ""
        self._received = b""
        self._unsent, self._asked = framed(self.first_message(simulation)), b""
        self._waiting, self._next = True, 0.0
        paths = os.pathsep.join(path for path in sys.path if path)
        self.process = subprocess.Popen(
            [sys.executable, "-c", program],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
            env={**os.environ, "PYTHONPATH": paths, "OPENBLAS_NUM_THREADS": "1"},
        )  # fmt: skip
        for pipe in (self.process.stdin, self.process.stdout):
            os.set_blocking(pipe.fileno(), False)
        self._send()

    def first_message(self, simulation: Simulation) -> object:
        """What the process is told before it is asked anything: the scene.

        Args:
            simulation: The twin's simulation.
        """
        return simulation.scene

    def request_of(self, simulation: Simulation, forces_given: bool) -> object:
        """What is asked about the present state; see `offer`."""
        raise NotImplementedError

    def take(self, kind: str, content: list) -> None:
        """Keeps what was answered.

        Args:
            kind: Kind of the reply.
            content: What it holds, without the duration.
        """
        raise NotImplementedError

    def offer(self, simulation: Simulation, forces_given: bool, now: float) -> None:
        """Takes answers that have arrived, and asks about the present state when due. Never waits.

        A state is asked about once.

        Args:
            simulation: The twin's simulation.
            forces_given: True when its actuators keep efforts, false when they keep setpoints.
            now: Time on a monotonic clock [s].
        """
        self._receive(now)
        if self.cause:
            self.process.poll()  # It ends, and must not stay as a zombie.
        elif not self._waiting and now >= self._next:
            request = framed(self.request_of(simulation, forces_given))
            if request != self._asked:
                self._waiting, self._asked, self._unsent = True, request, request
        self._send()

    def close(self) -> None:
        """Ends the process."""
        self.process.stdin.close()
        self.process.terminate()
        try:
            self.process.wait(_END_TIMEOUT)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        self.process.stdout.close()

    def _send(self) -> None:
        """Writes as much as the pipe accepts."""
        while self._unsent:
            try:
                count = os.write(self.process.stdin.fileno(), self._unsent)
            except BlockingIOError:
                return
            except OSError:
                self.end("its process has ended")
                return
            self._unsent = self._unsent[count:]

    def _receive(self, now: float) -> None:
        while not self.cause:
            try:
                content = os.read(self.process.stdout.fileno(), 65536)
            except BlockingIOError:
                break
            if not content:
                self.end("its process has ended")
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
        if kind == UNKNOWN:
            self.end(content[0])
        elif kind == STATE:
            *content, duration = content
            self.take(kind, content)
            self.answers += 1
            self._next = now + _PAUSE * duration
        else:
            self.take(kind, content)

    def end(self, cause: str) -> None:
        """Records that there will be no more answers.

        Args:
            cause: Why, for messages; the first one is kept.
        """
        self.cause = self.cause or cause
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


class Requests:
    """Reads messages from standard input.

    When none has come for `LINGER`, the process becomes that of a new program, which waits for one
    in a few megabytes, before it loads anything, and goes on from the first message of this one. The
    twin knows nothing of it, and must not start a process: it would wait for a thread of ordinary
    priority.

    Attributes:
        is_again: Whether this program follows another one, which has answered the first message.
    """

    def __init__(self, stdout: int):
        """Waits for the message with which a following program begins.

        Args:
            stdout: The standard output of the process, for the program that follows.
        """
        self._stdout, self._first, self._read_first = stdout, b"", False
        held = os.environ.pop(_FIRST, "")
        self.is_again = bool(held)
        if self.is_again:
            file = int(held)
            self._first = os.pread(file, os.fstat(file).st_size, 0)
            os.close(file)
            select.select([sys.stdin.fileno()], [], [])

    def read(self) -> object | None:
        """The next message; None when the other end has closed."""
        if self._read_first and not select.select([sys.stdin.fileno()], [], [], LINGER)[0]:
            self._follow()
        if self.is_again and not self._read_first:
            self._read_first = True
            return pickle.loads(self._first[LENGTH.size :])
        head = self._take(LENGTH.size)
        body = self._take(LENGTH.unpack(head)[0]) if len(head) == LENGTH.size else b""
        if not body or len(body) < LENGTH.unpack(head)[0]:
            return None
        if not self._read_first:
            self._first, self._read_first = head + body, True
        return pickle.loads(body)

    @staticmethod
    def _take(size: int) -> bytes:
        """So many bytes, or fewer where the other end has closed."""
        content = b""
        while len(content) < size and (more := os.read(sys.stdin.fileno(), size - len(content))):
            content += more
        return content

    def _follow(self) -> None:
        """Becomes the process of the same program, which begins anew."""
        file = os.memfd_create("first message")
        with os.fdopen(os.dup(file), "wb") as stream:
            stream.write(self._first)
        os.set_inheritable(file, True)
        os.dup2(self._stdout, sys.stdout.fileno())
        os.environ[_FIRST] = str(file)
        os.execv(sys.executable, [sys.executable, *sys.orig_argv[1:]])


class Replies:
    """Writes replies.

    Args:
        stream: Where to.
        is_again: Whether replies but those to states have been written before.
    """

    def __init__(self, stream: BinaryIO, is_again: bool = False):
        self._stream, self._is_again = stream, is_again

    def __call__(self, *content: object) -> None:
        """Writes one: its kind, then what it holds; of a `STATE` the duration [s] comes last."""
        if self._is_again and content[0] not in (STATE, UNKNOWN):
            return
        self._stream.write(framed(content))
        self._stream.flush()


def run(serve: Callable[[Requests, Replies], None], yields: bool = True) -> None:
    """Serves standard input and output. The twin, not this process, handles an interrupt.

    Args:
        serve: Answers requests until the other end closes; see `MeshErrorWatch`.
        yields: Whether to set the lowest priority.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if yields:
        yield_to_all()
    stdout = os.dup(sys.stdout.fileno())
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # print() must not write between replies
    requests = Requests(stdout)
    reply = Replies(os.fdopen(stdout, "wb"), requests.is_again)
    with suppress(BrokenPipeError):  # The twin has ended.
        try:
            serve(requests, reply)
        except BrokenPipeError:
            raise
        except Exception as error:  # noqa: BLE001 - the twin reports it; its stderr is not read
            reply(UNKNOWN, f"it failed: {type(error).__name__}: {error}")
