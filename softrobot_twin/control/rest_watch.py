"""Finds the poses at which a robot rests, sample by sample, with what was measured there.

A robot rests while what is commanded stays the same, once it has for a while. What was measured in the
last half second of a rest is one pose.
"""

from __future__ import annotations

from collections import Counter, deque
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from softrobot_twin.simulation import Simulation
from softrobot_twin.simulation.building.actuator_kinds import column
from softrobot_twin.tables.column_names import force_columns, position_columns

if TYPE_CHECKING:
    from softrobot_twin.control.twin_loop import TwinLoop

REST_TIME, WINDOW = 1.0, 0.5
"""A rest is at least so long, and what is measured in its last time counts [s]."""
SAME = 1.0e-3
"""A command that changes by less than this share of a large one stays the same."""
DRIFT, NOISE_FACTOR = 2.0e-4, 5.0
"""Markers move where the halves of the window differ by more than this share of the robot's size, and by more
than so many standard errors."""
MEDIAN = 1.2533
"""Standard error of a median of normal numbers, in that of their mean."""
SAME_FORCE = 1.0e-3
"""Forces on touches that change by less stay the same [N]."""
MOST_POSES = 200
"""The oldest of more poses is forgotten."""


class RestPose(NamedTuple):
    """What was commanded and measured while a robot rested.

    Attributes:
        setpoints: As measured or else commanded, of cables their lengths [m], of cavities gauge
            pressures [Pa], shape (actuator_count,).
        markers: Measured markers in the frame of the cameras [m], NaN for hidden ones, shape
            (marker_count, 3).
        effectors: Measured effectors [m], NaN where none is, shape (effector_count, 3).
        efforts: Measured efforts, such as tensions [N], NaN where none is, shape (actuator_count,).
        forces: On the touches [N], shape (touch_count, 3).
        origin: Where this is from, such as ``run.csv at 12.3 s``.
    """

    setpoints: np.ndarray
    markers: np.ndarray
    effectors: np.ndarray
    efforts: np.ndarray
    forces: np.ndarray
    origin: str = ""

    @property
    def numbers(self) -> np.ndarray:
        """All that is measured but forces, one after the other; see `places`."""
        return np.concatenate([self.setpoints, self.markers.ravel(), self.effectors.ravel(), self.efforts])

    @property
    def places(self) -> list[slice]:
        """Where setpoints, markers, effectors and efforts are among the numbers."""
        counts = [self.setpoints.size, self.markers.size, self.effectors.size, self.efforts.size]
        return [slice(end - count, end) for count, end in zip(counts, np.cumsum(counts), strict=True)]


class Sample(NamedTuple):
    """What was commanded and measured at one time.

    Attributes:
        time: [s].
        command: Commanded setpoints, NaN without any, shape (actuator_count,).
        seen: The measurements; its setpoints are NaN where none were measured.
    """

    time: float
    command: np.ndarray
    seen: RestPose


class RestWatch:
    """Finds the poses at which a robot rests, sample by sample.

    Attributes:
        found: The poses, the oldest first.
        dropped: How many rests were dropped, by the reason.
        moving_time: Time in which the robot moved [s].
    """

    def __init__(self, simulation: Simulation, source: str = ""):
        """Watches a robot.

        Args:
            simulation: Its model.
            source: Where the samples are from, for `RestPose.origin`.
        """
        self._simulation = simulation
        actuators = simulation.actuators
        scale = np.where(actuators.is_effort_driven, actuators.effort_scale, actuators.displacement_scale)
        self._same, self._size = SAME * scale, simulation.model.nodes.finite_size
        self._source = source
        self.found: deque[RestPose] = deque(maxlen=MOST_POSES)
        self.dropped: Counter[str] = Counter()
        self.moving_time = 0.0
        self._window: deque[Sample] = deque()
        self._begin: Sample | None = None

    def add(self, sample: Sample) -> None:
        """Takes the next sample.

        Args:
            sample: The sample.
        """
        command = sample.command
        begin = self._begin
        if begin is not None and not np.all(np.abs(command - begin.command) <= self._same):
            self.end(sample.time)
        if not np.isfinite(command).all():
            return
        if self._begin is None:
            self._begin = sample
        self._window.append(sample)
        while self._window[0].time < sample.time - WINDOW:
            self._window.popleft()

    def end(self, time: float = np.nan) -> None:
        """Ends the present rest.

        Args:
            time: When the command changed [s]; NaN where nothing follows.
        """
        begin, window = self._begin, list(self._window)
        self._begin = None
        self._window.clear()
        if begin is None:
            return
        duration = window[-1].time - begin.time
        if duration < REST_TIME:
            self.moving_time += np.nan_to_num(time - begin.time, nan=duration)
            return
        pose = self._pose(window)
        if isinstance(pose, str):
            self.dropped[pose] += 1
        else:
            self.found.append(pose)

    def _pose(self, window: list[Sample]) -> RestPose | str:
        """The pose of a rest, or why it is none."""
        last = window[-1]
        seen = np.array([one.seen.numbers for one in window])
        middle, places = _middle(seen), last.seen.places
        is_open = ~np.isfinite(middle[places[0]])
        middle[places[0]][is_open] = last.command[is_open]
        if not np.isfinite(middle[places[0].stop :]).any():
            return "nothing was measured"
        setpoints, markers, effectors, efforts = (middle[one] for one in places)
        pose = RestPose(setpoints, markers.reshape(-1, 3), effectors.reshape(-1, 3), efforts,
                        np.array(last.seen.forces), f"{self._source} at {last.time:.2f} s")  # fmt: skip
        known = np.array([one.setpoints for one in self.found]).reshape(-1, setpoints.size)
        for index in np.flatnonzero(np.all(np.abs(known - setpoints) <= self._same, axis=1)):
            if np.all(np.abs(self.found[index].forces - pose.forces) <= SAME_FORCE):
                return "it repeats an earlier pose"
        points, half = seen[:, places[1].start : places[2].stop], len(window) // 2
        drift = np.abs(_middle(points[half:]) - _middle(points[:half])) if half else np.zeros(1)
        if np.any(drift > np.maximum(DRIFT * self._size, NOISE_FACTOR * _error_of_drift(points))):
            return "the markers still moved"
        return pose

    def table(self) -> str:
        """The poses as the text of a CSV file, which `poses_of_table` reads."""
        simulation = self._simulation
        kinds = simulation.actuators.kind_of.items()
        follow = [place for place, (_, kind) in enumerate(kinds) if not kind.is_effort_driven]
        header = [column(name, kind.setpoint) for name, kind in kinds]
        for marker in simulation.marker_ids:
            header += position_columns(f"marker_{marker}")
        header += [column(name, kind.effort) for name, kind in kinds if not kind.is_effort_driven]
        for touch in simulation.touch_names:
            header += force_columns(touch)
        form = ",".join(["%.9g"] * len(header))
        rows = [form % (*one.setpoints, *one.markers.ravel(), *one.efforts[follow], *one.forces.ravel())
                for one in self.found]  # fmt: skip
        return "\n".join([",".join(header), *rows, ""])

    def in_words(self) -> str:
        """How many poses were found, and why others were dropped."""
        words = [f"{self._source}: {len(self.found)} poses at rest"]
        words += [f"{count} dropped because {reason}" for reason, count in self.dropped.items()]
        if self.moving_time:
            words.append(f"rests shorter than {REST_TIME:g} s, and motion, of {self.moving_time:.1f} s in "
                         "all are left out")
        return "; ".join(words)


def _error_of_drift(points: np.ndarray) -> np.ndarray:
    """Standard error of the difference of the medians of two halves of samples, of each number.

    A few samples of one number may be alike by chance: no number has less noise than all together.
    """
    changes = np.diff(points, axis=0)
    seen = changes[np.isfinite(changes)]
    spread = np.maximum(np.std(changes, axis=0), np.sqrt(np.mean(seen**2)) if seen.size else 0.0)
    return MEDIAN * spread / np.sqrt(max(len(points) // 2, 1))


def _middle(values: np.ndarray) -> np.ndarray:
    """Medians over samples; NaN where half of them or more are hidden."""
    is_seen = np.isfinite(values)
    found, all_seen = np.full(values.shape[1], np.nan), is_seen.all(axis=0)
    found[all_seen] = np.median(values[:, all_seen], axis=0)
    some = ~all_seen & (is_seen.mean(axis=0) > 0.5)
    if some.any():
        found[some] = np.nanmedian(values[:, some], axis=0)
    return found


# --- what a loop measures ------------------------------------------------------------------------


def sample_of(
    loop: TwinLoop, now: float, time: float, command: np.ndarray | None, forces: np.ndarray | None
) -> Sample:
    """What a loop commands, and measures as far as it is plausible.

    Args:
        loop: The loop.
        now: Time on its clock [s].
        time: Time of the sample [s].
        command: Setpoints that left the loop, shape (actuator_count,); None for none.
        forces: On the touches [N], shape (touch_count, 3), NaN where none is told; None for none.
    """
    simulation, device = loop.simulation, loop.device
    none = np.full(simulation.actuators.count, np.nan)
    is_fresh = device.setpoints is not None and device.age(now) <= loop.settings.device_timeout
    setpoints = np.array(device.setpoints) if is_fresh else none
    efforts = np.array(device.efforts) if is_fresh and device.efforts is not None else none
    commanded = setpoints if command is None else command
    markers = simulation.scene.marker_frame.of_cameras(np.array(loop.plausible_markers(now)))
    effectors = np.full((len(simulation.effector_names), 3), np.nan)
    felt = np.zeros((len(simulation.touch_names), 3)) if forces is None else np.nan_to_num(forces)
    return Sample(time, np.array(commanded), RestPose(setpoints, markers, effectors, efforts, felt))
