"""The mesh's error of a running twin, estimated by another process in time that nobody wants.

Solving a state with elements of higher order takes longer than a tick may be late. A thread would
hold Python's lock, which the tick needs; another process, of the lowest priority, holds nothing.
The tick only hands over a few numbers, once in a while, and takes what has arrived: it never waits.
"""

from __future__ import annotations

import os
import pickle
import subprocess
import sys

from softrobot_twin.control.mesh_error_process import LENGTH, REST, STATE, framed
from softrobot_twin.simulation import Simulation
from softrobot_twin.simulation.mesh_error import ActuatorLoads, MeshError

# Times that an estimate took until the next is asked for: it takes a fifth of a processor at most.
_PAUSE = 4.0
_PATIENCE = 2.0
_PROGRAM = "from softrobot_twin.control.mesh_error_process import main; main({})"


class MeshErrorWatch:
    """Asks for estimates and keeps the newest.

    Attributes:
        at_rest: What the mesh leaves out at rest; None until it is known.
        newest: How far the mesh puts the effectors off in the newest state estimated [m]; NaN
            before the first, and where there is none.
        estimates: States estimated.
        cause: Why there is no estimate of states; empty where there is, or will be.
    """

    def __init__(self, simulation: Simulation, yields: bool = True):
        """Start the process.

        Args:
            simulation: The twin's, whose scene is judged.
            yields: Whether it runs only where nobody else wants the processor.
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
        """Takes what has arrived, and asks for the present state where it is time to. Never waits.

        Args:
            simulation: The twin's.
            forces_given: Whether its actuators keep tensions, or lengths.
            now: Time on a clock that never jumps [s].
        """
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
            self._process.wait(_PATIENCE)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._process.stdout.close()

    def _send(self) -> None:
        """Hands over as much as the pipe takes."""
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
        """Takes the messages that have arrived whole."""
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
        """There will be no more estimates."""
        self.cause = self.cause or cause
        self.newest = float("nan")
        self._unsent = b""
