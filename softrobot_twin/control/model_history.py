"""Where the model was at the last ticks, so that it can be compared with a late measurement."""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

import numpy as np

from softrobot_twin.control.loop_timing import NANOSECONDS

LONGEST_DELAY = 1.0
"""A command is executed within this time [s]."""
APART = 0.03
"""Measured setpoints are those of a tick, or between two ticks, when no more than this share of the
actuators' travels is between them. Sensors of pressure may have a noise of 1 %."""
PREFERENCE = 0.03
"""Of two ticks that are equally near, the newer one is meant: a second counts as this share of
`APART`."""
MOVES = 1.0
"""Setpoints tell a delay while they move by this multiple of `APART` in a second."""


class Moment(NamedTuple):
    """The model at one moment.

    Attributes:
        markers: Positions of the markers [m], shape (marker_count, 3). In a scene with an observer
            further quantities follow, see `ObservedRows`.
        effectors: Positions of the effectors [m], shape (effector_count, 3).
        loads: Numbers of the loads that an observer found and the model bore, shape (load_count,).
        by_loads: Motion of the markers and quantities by each of these, shape (3 count, load_count).
        delay: How late the device was there [s]; NaN where this is not known.
        setpoints: The model's setpoints, in the actuators' units, shape (actuator_count,); None in a
            scene without an observer.
    """

    markers: np.ndarray
    effectors: np.ndarray
    loads: np.ndarray = np.empty(0)
    by_loads: np.ndarray | None = None
    delay: float = math.nan
    setpoints: np.ndarray | None = None


class ModelHistory:
    """A ring of the model's markers, effectors and setpoints at the last ticks.

    Camera, network and device delay the measured markers. Their difference from the model's markers
    of the same moment is what the robot is away from the model. The device follows its commands
    late; the difference from the model's markers where its actuators were as they are measured is
    the model's error alone. A difference from the present markers would consist mostly of the
    robot's motion, and a correction by it would make the loop oscillate.

    Args:
        travels: Range of the setpoint of each actuator, in its unit, shape (actuator_count,).
        marker_count: Number of markers and further quantities.
        effector_count: Number of effectors.
        capacity: Number of ticks to keep.
        load_count: Numbers of the loads that an observer finds.
    """

    def __init__(
        self, travels: np.ndarray, marker_count: int, effector_count: int, capacity: int = 256,
        load_count: int = 0,
    ):  # fmt: skip
        self._scales, self._markers = APART * np.asarray(travels, float), marker_count
        self._loads = np.zeros((2 * capacity, load_count))
        self._by_loads = np.zeros((2 * capacity, 3 * marker_count, load_count)) if load_count else None
        self._capacity, self._count = capacity, 0
        # Ticks that nothing was compared with yet: most wait for no measurement.
        self._newest = deque[tuple[int, np.ndarray, Moment]](maxlen=capacity)
        self._last = 0
        # Twice the capacity: so the ticks are always in one piece, and are seldom moved.
        self._times = np.zeros(2 * capacity, np.int64)
        self._setpoints = np.zeros((2 * capacity, len(self._scales)))
        self._values = np.zeros((2 * capacity, marker_count + effector_count, 3))

    def add(self, time: int, setpoints: np.ndarray, moment: Moment) -> None:
        """Adds a tick in place of the oldest.

        Args:
            time: Time of the tick [ns]; when the clock was set back, a new history starts.
            setpoints: The model's setpoints, in the actuators' units, shape (actuator_count,). Its
                numbers, as those of the moment, do not change later.
            moment: The model.
        """
        if time < self._last:
            self.forget()
        self._last = time
        self._newest.append((time, setpoints, moment))

    def _store(self) -> None:
        """Writes the newest ticks into the ring."""
        if not self._newest:
            return
        times, setpoints, moments = zip(*self._newest, strict=True)
        self._newest.clear()
        if self._count + len(times) > len(self._times):
            kept, self._count = slice(self._count - self._capacity, self._count), self._capacity
            for array in (self._times, self._setpoints, self._values, self._loads, self._by_loads):
                if array is not None:
                    array[: self._capacity] = array[kept]
        at = slice(self._count, self._count + len(times))
        self._count = at.stop
        self._times[at], self._setpoints[at] = times, setpoints / self._scales
        self._values[at, : self._markers] = [one.markers for one in moments]
        self._values[at, self._markers :] = [one.effectors for one in moments]
        if self._by_loads is not None:
            self._loads[at] = [one.loads for one in moments]
            self._by_loads[at] = [one.by_loads for one in moments]

    @property
    def is_any(self) -> bool:
        """Whether there is a tick."""
        return self._count > 0 or bool(self._newest)

    def at(self, time: int) -> Moment:
        """The model at a time [ns], interpolated linearly between two ticks; there is one tick at least.

        Before the oldest tick it is that of the oldest, after the newest that of the newest.

        Args:
            time: The time on the clock of stamps [ns].
        """
        self._store()
        first = max(0, self._count - self._capacity)
        times = self._times[first : self._count]
        after = int(np.searchsorted(times, time))
        if after in (0, len(times)):
            return self._moment(first + min(after, len(times) - 1), 0.0)
        share = (time - times[after - 1]) / (times[after] - times[after - 1])
        return self._moment(first + after - 1, float(share))

    def executed(self, setpoints: np.ndarray, time: int) -> Moment | None:
        """The model where its actuators were as those of the device are measured.

        It is looked for on the way of the setpoints from tick to tick.

        Args:
            setpoints: Measured setpoints, in the actuators' units, shape (actuator_count,).
            time: When they were measured [ns].

        Returns:
            The model; None where it was not near these setpoints.
        """
        self._store()
        oldest = time - round(LONGEST_DELAY * NANOSECONDS)
        first = max(int(np.searchsorted(self._times[: self._count], oldest)), self._count - self._capacity, 0)
        first = min(first, self._count - 1)
        if first < 0:
            return None
        places = self._setpoints[first : self._count] - setpoints / self._scales
        ways = np.diff(places, axis=0, append=places[-1:])
        lengths = np.einsum("ij,ij->i", ways, ways)
        shares = -np.einsum("ij,ij->i", places, ways) / np.where(lengths > 0.0, lengths, 1.0)
        shares = np.clip(shares, 0.0, 1.0)
        apart = np.abs(places + shares[:, None] * ways).max(axis=1, initial=0.0)
        ages = (time - self._times[first : self._count]) / NANOSECONDS
        best = int(np.argmin(apart + PREFERENCE * np.maximum(ages, 0.0)))
        if apart[best] > 1.0:
            return None
        # While they rest, each of the ticks may be meant.
        near = slice(max(best - 1, 0), best + 2)
        passed, share = -np.diff(ages, append=ages[-1]), shares[best]
        moves = np.sqrt(lengths[near].max()) > MOVES * passed[near].max()
        delay = max(ages[best] - share * passed[best], 0.0) if moves else math.nan
        return self._moment(first + best, share)._replace(delay=delay)

    def _moment(self, tick: int, share: float) -> Moment:
        """The model at a share of the way from a tick to the next one."""

        def between(array: np.ndarray) -> np.ndarray:
            here = (1.0 - share) * array[tick]
            return here + share * array[tick + 1] if share else here

        values = between(self._values)
        found = Moment(values[: self._markers], values[self._markers :])
        if self._by_loads is None:
            return found
        return found._replace(loads=between(self._loads), by_loads=between(self._by_loads),
                              setpoints=self._scales * between(self._setpoints))  # fmt: skip

    def load_otherwise(self, before: Moment, after: Moment) -> None:
        """Takes all ticks as if they had been under other loads.

        Args:
            before: One of them.
            after: The same, under the other loads.
        """
        self._store()
        moved = (after.markers - before.markers).ravel() - np.einsum(
            "tml,tl->tm", self._by_loads, self._loads - before.loads)
        self._values[:, : self._markers] += moved.reshape(len(moved), -1, 3)
        self._loads[:], self._by_loads[:] = after.loads, after.by_loads

    def forget(self) -> None:
        """Starts a new history."""
        self._count = self._last = 0
        self._newest.clear()
