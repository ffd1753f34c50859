"""A process of one thread beside this one, which answers one question after the other."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Any

from softrobot_twin.errors import SoftRobotTwinError, one_line
from softrobot_twin.kernels.worker_threads import use_one_thread


class WorkerError(SoftRobotTwinError):
    """A process of this machine has ended, or could not answer."""


class WorkerProcess:
    """A process that ends when its pipe is closed, or this process ends.

    Attributes:
        pipe: Where an answer arrives.
    """

    def __init__(self, make: Callable[..., Callable[..., Any]], *arguments: Any):
        """Start the process.

        Args:
            make: Makes what answers; the process calls it once, at the first question. If that has a
                method `prepare`, the process calls it before each question, with a function that tells
                whether the question is there.
            *arguments: What `make` is called with.
        """
        context = multiprocessing.get_context("spawn")
        self.pipe, other = context.Pipe()
        self._process = context.Process(target=_serve, args=(other, make, arguments), daemon=True)
        self._process.start()
        other.close()

    def ask(self, *question: Any) -> WorkerProcess:
        """Ask something; the answer is its `result`.

        Args:
            *question: What the function that answers is called with.
        """
        with suppress(OSError):  # It has ended, which is noticed when its answer is read.
            self.pipe.send(question)
        return self

    def result(self) -> Any:
        """The answer to what was asked last.

        Raises:
            WorkerError: The process has ended, or raised an error.
        """
        try:
            answer, error = self.pipe.recv()
        except (EOFError, OSError):
            self._process.join()
            raise WorkerError(f"its process ended with code {self._process.exitcode}") from None
        if error:
            raise WorkerError(error)
        return answer

    def close(self) -> None:
        """End the process."""
        self._process.terminate()
        self._process.join()
        self.pipe.close()


def _serve(pipe: Connection, make: Callable[..., Any], arguments: tuple[Any, ...]) -> None:
    """Answers what comes through a pipe, until it is closed."""
    # Ctrl-C reaches the parent too, which ends this process.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    use_one_thread()
    made: Any = None
    with suppress(EOFError, BrokenPipeError, ConnectionResetError):
        while True:
            if hasattr(made, "prepare"):
                made.prepare(pipe.poll)
            question = pipe.recv()
            try:
                made = made or make(*arguments)
                answer = made(*question), ""
            except Exception as error:  # not all errors can be sent as they are
                answer = None, f"{type(error).__name__}: {one_line(error)}"
            pipe.send(answer)
