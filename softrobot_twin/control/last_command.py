"""The last command of a twin without a device, in a file that outlives its process.

Without a device nobody measures where the robot is. A twin that is started again continues from the
command that the hardware got last, whatever ended the twin before. The file also tells the setpoints
at rest, by which a file of another robot is known. A thread writes the file, and
the loop never waits. It is not forced to the disk: a loss of power may cost the last seconds.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import threading
import time
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from softrobot_twin.control.device import zero_errors
from softrobot_twin.simulation import Simulation
from softrobot_twin.simulation.appearance import Pose

LONGEST_WRITE = 1.0
"""A write that takes longer [s] counts as failed for who reads."""
WRITE_PAUSE = 0.005
"""Time from write to write [s], and to the next command; a process that is killed loses what it sent
within it. So the thread wakes where a tick ends: in a tick it would take the interpreter from it."""
LONGEST_PAUSE = 0.05
"""A command that no other one follows is written after this time [s]."""


class StoredCommand(NamedTuple):
    """What was sent last.

    Attributes:
        setpoints: In the unit of each actuator's kind, shape (actuator_count,).
        efforts: In the unit of each actuator's kind, shape (actuator_count,).
        poses: Poses of the guided bodies, by name.
    """

    setpoints: np.ndarray
    efforts: np.ndarray
    poses: dict[str, Pose]


class LastCommand:
    """Keeps the last command of the twins that send to one topic.

    Args:
        simulation: The model.
        topic: What tells the robot from others: domain and full name of the topic of its commands.

    Attributes:
        path: The file, below ``$XDG_STATE_HOME/softrobot_twin`` or
            ``~/.local/state/softrobot_twin``. Its name holds a digest of topic and actuators.
        failure: Why nothing is kept; empty while it is.
        refusal: Why the file was not used when it was read last; empty where it was, or is none.
    """

    def __init__(self, simulation: Simulation, topic: str):
        self._names, self._guided = simulation.actuator_names, tuple(simulation.guided_names)
        units = [kind.setpoint.unit for kind in simulation.actuators.kind_of.values()]
        told = json.dumps([topic, self._names, units, self._guided])
        home = os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state"
        digest = hashlib.sha256(told.encode()).hexdigest()[:16]
        self.path = Path(home) / "softrobot_twin" / f"last_command_{digest}.json"
        self.failure = self.refusal = ""
        self._rest = simulation.rest_setpoints
        self._zero_errors = zero_errors(simulation.limits, self._rest)
        self._newest: tuple | None = None
        self._due = -math.inf
        self._changed, self._is_pending, self._ends = threading.Condition(), False, False
        self._thread: threading.Thread | None = None

    def read(self) -> StoredCommand | None:
        """What was sent last, by this twin or another one; see also `refusal`.

        A file of another robot, whose setpoints at rest differ by more than the zero of a sensor may,
        is not used. Whether the model allows the setpoints themselves, the loop judges.

        Returns:
            None where nothing is known, what is there cannot be used, or an own command could not
            be written: the file holds an older one then, and the twin itself knows the last one.
        """
        self.refusal = ""
        with self._changed:
            is_written = self._changed.wait_for(lambda: self.failure or not self._is_pending, LONGEST_WRITE)
        if self.failure or not is_written:
            return None
        try:
            with self.path.open("rb") as file:
                values = json.loads(file.readline(100_000))
            setpoints, efforts, rest = (
                np.array(values[key], float) for key in ("setpoints", "efforts", "rest"))
            poses = {name: Pose(*(np.array(part, float) for part in values["poses"][name]))
                     for name in self._guided}  # fmt: skip
        except FileNotFoundError:
            return None
        except OSError as error:
            self.refusal = f"{self.path}: {error.strerror}"
            return None
        except (ValueError, TypeError, KeyError, OverflowError, RecursionError):
            self.refusal = f"{self.path}: damaged, or of another version"
            return None
        if not setpoints.shape == efforts.shape == rest.shape == self._rest.shape:
            self.refusal = f"{self.path}: its commands have another number of actuators"
            return None
        # A comparison with NaN is false, so what is not a number is not alike.
        apart = np.flatnonzero(~(np.abs(rest - self._rest) <= self._zero_errors))
        if len(apart):
            first = apart[0]
            self.refusal = (f"{self.path}: of another robot: {self._names[first]} is at "
                            f"{rest[first]:.6g} at rest there, and at {self._rest[first]:.6g} here")
            return None
        return StoredCommand(setpoints, efforts, poses)

    def keep(self, setpoints: np.ndarray, efforts: np.ndarray, poses: Mapping[str, Pose]) -> None:
        """Keeps a command that was sent; see `StoredCommand`. Returns at once.

        Args:
            setpoints: Setpoints in the actuators' units, shape (actuator_count,).
            efforts: Efforts in the actuators' units, shape (actuator_count,).
            poses: Pose of each guided body, by its name.
        """
        if self._thread is None:
            self._thread = threading.Thread(target=self._run, name="last command", daemon=True)
            self._thread.start()
        with self._changed:
            self._newest, self._is_pending = (setpoints, efforts, dict(poses)), True
            if (now := time.monotonic()) >= self._due:
                self._due = now + WRITE_PAUSE
                self._changed.notify_all()

    def close(self) -> None:
        """Writes the newest command, and ends."""
        with self._changed:
            self._ends = True
            self._changed.notify_all()
        if self._thread is not None:
            self._thread.join()

    def _run(self) -> None:
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            file = os.open(self.path, os.O_WRONLY | os.O_CREAT, 0o600)
        except OSError as error:
            self._fail(error)
            return
        try:
            while (newest := self._take()) is not None:
                # One call writes the whole line: a process that dies leaves the old or the new.
                os.pwrite(file, self._line(*newest), 0)
        except OSError as error:
            self._fail(error)
        finally:
            os.close(file)

    def _take(self) -> tuple | None:
        """Waits for a command to write after the one before; None when none will come."""
        with self._changed:
            self._is_pending = self._newest is not None
            self._changed.notify_all()
            while self._newest is None and not self._ends:
                self._changed.wait(LONGEST_PAUSE)
            newest, self._newest = self._newest, None
        return newest

    def _fail(self, error: OSError) -> None:
        with self._changed:
            self.failure = f"{self.path}: {error.strerror}"
            self._changed.notify_all()

    def _line(self, setpoints, efforts, poses) -> bytes:
        """A command as one line of JSON."""
        values = {
            "setpoints": setpoints.tolist(), "efforts": efforts.tolist(), "rest": self._rest.tolist(),
            "poses": {name: [part.tolist() for part in pose] for name, pose in poses.items()},
        }  # fmt: skip
        return json.dumps(values).encode() + b"\n"
