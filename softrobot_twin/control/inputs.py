"""Inputs of the loop: each one checks a message and keeps the newest valid one.

An input refuses a message with a reason, counts the refusals, and never waits. The tick reads the
kept message.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from itertools import product
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from softrobot_twin.control.arrival import (
    Arrival,
    HeaderCheck,
    Input,
    Refusal,
    RefusalCounts,
    latched,
    refusal_of_vector,
)
from softrobot_twin.control.loop_settings import LoopSettings
from softrobot_twin.control.target_lead import TargetStream
from softrobot_twin.simulation import Simulation, Touched
from softrobot_twin.simulation.appearance import Pose
from softrobot_twin.simulation.building.limits import Pulleys
from softrobot_twin.tables.channels import NOT_UNIT, Channel

_SMALLEST_COMPONENT = 1.0e-3
"""A quaternion whose components are all smaller than this is not a rotation. A pose message has
zeros when its sender did not set the rotation."""


UNNAMED = -1
"""Index of an actuator that a message does not name."""
FARTHEST = 1.0 / 3.0
"""A touched point may be measured this far from where it is at rest, as a share of the robot's size."""


PAST = 1024
"""Measurements that are kept, to tell what was measured when a camera saw the robot."""
NEAR = 0.1
"""Values of a moment are known when they were measured within this time of it [s]."""
Past = deque[tuple[float, np.ndarray]]
"""Times of the last measurements on the clock of `Arrival.time` [s], and their values."""


def between(past: Past, time: float) -> np.ndarray | None:
    """Values at a time, between two measurements or next to one; None where none is within `NEAR`.

    Args:
        past: The measurements.
        time: On the clock of `Arrival.time` [s].
    """
    earlier = later = None
    for one in reversed(past):
        if one[0] <= time:
            earlier = one
            break
        later = one
    near = [one for one in (earlier, later) if one is not None and abs(one[0] - time) <= NEAR]
    if len(near) < 2:
        return near[0][1] if near else None
    (start, before), (end, behind) = near
    return before + (time - start) / (end - start) * (behind - before)


# --- targets -------------------------------------------------------------------------------------


class TargetReading(NamedTuple):
    """The targets of one tick.

    Attributes:
        targets: Target of each effector [m], shape (effector_count, 3); a row of NaN without one.
        source: ``none``, ``point``, ``path``, ``pose`` or ``velocity``: which kind of message moved a target last.
        age: Time since the last target or velocity arrived [s]; infinite before the first.
        timed_out: True when that is longer than the timeout allows.
        orientations: Wanted turn of each effector from rest as a quaternion (x, y, z, w), shape
            (effector_count, 4), a row of NaN without one; None where no effector asks for an
            orientation.
    """

    targets: np.ndarray
    source: str
    age: float
    timed_out: bool
    orientations: np.ndarray | None = None

    @classmethod
    def none(cls, oriented: Sequence[bool]) -> TargetReading:
        """No targets.

        Args:
            oriented: Whether each effector asks for an orientation.
        """
        count = len(oriented)
        turns = np.full((count, 4), np.nan) if any(oriented) else None
        return cls(np.full((count, 3), np.nan), "none", math.inf, False, turns)


class _Course(NamedTuple):
    """A path of a target that is known ahead.

    Attributes:
        times: Increasing, on the clock of `Arrival.time` [s], shape (n,).
        places: Where the target is at these times [m], shape (n, 3).
    """

    times: np.ndarray
    places: np.ndarray

    def at(self, times: np.ndarray | float) -> np.ndarray:
        """Places at times [m], shape (..., 3), straight in between; the ends before and after."""
        return np.stack([np.interp(times, self.times, one) for one in self.places.T], axis=-1)


class TargetInput(Input):
    """Target points, paths, poses and velocities of the effectors.

    A point or a velocity moves the position alone: the orientation that a pose gave stays wanted. The
    angular part of a twist turns it, of an effector that asks for an orientation.

    Args:
        effector_count: Number of effectors of the simulation.
        velocity_effector: Index of the effector that velocities apply to.
        frame_id: The only frame in which targets are accepted.
        settings: Limits and timeouts.
        lengths: Displacement that counts as much as one radian of each effector's orientation [m/rad];
            0, as by default, where it asks for none.

    Attributes:
        slowed: How often a velocity was limited to `speed_limit`.
    """

    def __init__(
        self, effector_count: int, velocity_effector: int, frame_id: str, settings: LoopSettings,
        lengths: Sequence[float] = (),
    ):  # fmt: skip
        self._lengths = tuple(lengths) or (0.0,) * effector_count
        self._orientations = np.full((effector_count, 4), np.nan) if any(self._lengths) else None
        self.slowed = 0
        self._velocity_effector = velocity_effector
        self._targets = np.full((effector_count, 3), np.nan)
        self._streams = [TargetStream() for _ in range(effector_count)]
        self._courses: dict[int, _Course] = {}
        super().__init__(settings, frame_id, range(effector_count))

    def reset(self) -> None:
        """Forgets all targets and velocities; the counts stay."""
        super().reset()
        self._targets[:] = np.nan
        self._courses.clear()
        for stream in self._streams:
            stream.forget()
        if self._orientations is not None:
            self._orientations[:] = np.nan
        self._velocity, self._turn_rate = np.zeros((2, 3))
        self._velocity_time = -math.inf
        self._source = "none"

    @latched
    def accept_point(self, effector: int, position, arrival: Arrival) -> Refusal | None:
        """Checks a target and keeps it.

        Args:
            effector: Index of the effector.
            position: Target [m], shape (3,); it is limited to the workspace.
            arrival: Header and time of arrival of the message.

        Returns:
            The reason to refuse it, or None.
        """
        if refusal := refusal_of_vector(position):
            return refusal
        self._keep_position(effector, position, "point", arrival)
        return None

    @latched
    def accept_pose(self, effector: int, position, quaternion, arrival: Arrival) -> Refusal | None:
        """Checks a target with orientation and keeps it.

        Args:
            effector: Index of the effector.
            position: Target [m], shape (3,); it is limited to the workspace.
            quaternion: Wanted turn from rest (x, y, z, w), of unit length, shape (4,).
            arrival: Header and time of arrival of the message.

        Returns:
            The reason to refuse it, or None.
        """
        if not self._lengths[effector]:
            return Refusal.WRONG_NAMES
        if refusal := refusal_of_pose(Pose(position, quaternion)):
            return refusal
        if abs(math.hypot(*quaternion) - 1.0) > NOT_UNIT:
            return Refusal.NO_ROTATION
        self._keep_position(effector, position, "pose", arrival)
        self._orientations[effector] = quaternion / math.hypot(*quaternion)
        return None

    @latched
    def accept_path(self, effector: int, times, positions, arrival: Arrival) -> Refusal | None:
        """Checks a path that a target will take, and keeps it; it replaces what is left of another.

        Args:
            effector: Index of the effector.
            times: When the target is where, after the stamp of the message [s], increasing, shape
                (n,).
            positions: Where it is [m], shape (n, 3); limited to the workspace.
            arrival: Header and time of arrival of the message.

        Returns:
            The reason to refuse it, or None.
        """
        if times.ndim != 1 or not len(times) or positions.shape != (len(times), 3):
            return Refusal.WRONG_SIZE
        if not (np.isfinite(times).all() and np.isfinite(positions).all()):
            return Refusal.NOT_FINITE
        if not (np.diff(times) > 0.0).all():
            return Refusal.OUT_OF_ORDER
        inside = self.settings.in_workspace(positions)
        self.clamped += bool((inside != positions).any())
        begin = arrival.time - arrival.age
        self._streams[effector].forget()
        course = self._courses[effector] = _Course(begin + times, inside)
        self._targets[effector] = course.at(arrival.time)
        self._source = "path"
        if effector == self._velocity_effector:
            self._velocity_time = -math.inf
        return None

    def _keep_position(self, effector: int, position: np.ndarray, source: str, arrival: Arrival) -> None:
        """Keeps a valid position [m], shape (3,); it replaces a velocity or a path."""
        self._courses.pop(effector, None)
        self._targets[effector] = self._inside(position)
        self._streams[effector].add(self._targets[effector].copy(), arrival)
        self._source = source
        if effector == self._velocity_effector:
            self._velocity_time = -math.inf

    def accept_velocity(self, velocity, time: float) -> Refusal | None:
        """Checks a velocity that arrived at a time [s], and keeps it.

        Args:
            velocity: The velocity [m/s], and behind it the angular velocity [rad/s] if there is any,
                shape (3,) or (6,).
            time: Time of arrival on the clock of `Arrival.time` [s].

        Returns:
            The reason to refuse it, or None.
        """
        velocity = np.asarray(velocity, dtype=float)
        turn_rate = velocity[3:] if velocity.shape == (6,) else np.zeros(3)
        velocity = velocity[:3] if velocity.shape == (6,) else velocity
        if (refusal := refusal_of_vector(velocity) or refusal_of_vector(turn_rate)) is not None:
            return self.refusals.add(refusal)
        # The square of a very large component is infinite, which is above the limit too.
        with np.errstate(over="ignore"):
            self.slowed += bool(np.linalg.norm(velocity) > self.settings.speed_limit)
        self._velocity, self._turn_rate, self._velocity_time = velocity, turn_rate, time
        self._newest, self._source = time, "velocity"
        self._streams[self._velocity_effector].forget()
        self._courses.pop(self._velocity_effector, None)
        return None

    def stop(self) -> None:
        """Ends the motion of a target by a velocity."""
        self._velocity_time = -math.inf

    def is_moving(self, now: float) -> bool:
        """Whether a velocity is still valid, or a path not at its end.

        Args:
            now: Time on the clock of `Arrival.time` [s].
        """
        return self._has_velocity(now) or any(one.times[-1] >= now for one in self._courses.values())

    def _has_velocity(self, now: float) -> bool:
        return now - self._velocity_time <= self.settings.velocity_timeout

    def read(
        self, now: float, time_step: float, effector_positions: np.ndarray,
        effector_turns: np.ndarray | None = None,
    ) -> TargetReading:  # fmt: skip
        """The targets now, after integrating a velocity that is still valid.

        Args:
            now: Time on the clock of `Arrival.time` [s].
            time_step: Time since the last tick [s].
            effector_positions: Positions of the effectors [m], shape (effector_count, 3): a
                velocity moves the target from there when no target was given before.
            effector_turns: Turns of the effectors from rest (x, y, z, w), shape (effector_count, 4),
                for the same; None where no effector asks for an orientation.
        """
        for effector, course in self._courses.items():
            self._targets[effector] = course.at(now)
            self._newest = max(self._newest, min(now, float(course.times[-1])))
        if self._has_velocity(now):
            self._integrate_velocity(time_step, effector_positions[self._velocity_effector])
            if self._turn_rate.any() and self._lengths[self._velocity_effector]:
                self._turn(time_step, effector_turns[self._velocity_effector])
        age = self.age(now)
        timeout = self.settings.target_timeout
        timed_out = timeout > 0.0 and math.isfinite(age) and age > timeout
        turns = None if self._orientations is None else self._orientations.copy()
        return TargetReading(self._targets.copy(), self._source, age, timed_out, turns)

    def leads(self, now: float, delay: float) -> np.ndarray:
        """From each target to where it will be after a delay, inside the workspace [m].

        Args:
            now: Time on the clock of `Arrival.time` [s].
            delay: The delay [s].

        Returns:
            Shape (effector_count, 3); NaN where the messages show no course.
        """
        leads = np.full_like(self._targets, np.nan)
        for lead, target, stream in zip(leads, self._targets, self._streams, strict=True):
            way = stream.lead(now, delay, self.settings.lead_limit)
            if way is not None:
                lead[:] = self.settings.in_workspace(target + way) - target
        for effector, course in self._courses.items():
            leads[effector] = course.at(now + delay) - self._targets[effector]
        return leads

    def ahead(self, now: float, delays: np.ndarray) -> np.ndarray:
        """Where the targets will be [m], shape (n, effector_count, 3); NaN without a target.

        Of a path it is known. A stream of points is followed on its course as far as `lead_limit`,
        and what is later stays there.

        Args:
            now: Time on the clock of `Arrival.time` [s].
            delays: Times from now [s], increasing, shape (n,).
        """
        places = np.tile(self._targets, (len(delays), 1, 1))
        for effector, stream in enumerate(self._streams):
            if effector in self._courses:
                places[:, effector] = self._courses[effector].at(now + delays)
            elif (ways := stream.lead(now, delays, self.settings.lead_limit)) is not None:
                places[:, effector] = self.settings.in_workspace(places[:, effector] + ways)
        return places

    def _turn(self, time_step: float, start: np.ndarray) -> None:
        """Turns the wanted orientation, as fast as the speed limit allows to turn."""
        place = self._velocity_effector
        turn_rate = _limited(self._turn_rate, self.settings.speed_limit / self._lengths[place])
        wanted = self._orientations[place]
        before = Rotation.from_quat(wanted if np.isfinite(wanted).all() else start)
        wanted[:] = (Rotation.from_rotvec(time_step * turn_rate) * before).as_quat()

    def _integrate_velocity(self, time_step: float, start: np.ndarray) -> None:
        """Moves the target. A target outside the workspace may move inwards but not outwards."""
        if not self._velocity.any():
            return
        velocity = _limited(self._velocity, self.settings.speed_limit)
        target = self._targets[self._velocity_effector]
        if not np.isfinite(target).all():
            target = start
        low = np.minimum(target, self.settings.workspace_min)
        high = np.maximum(target, self.settings.workspace_max)
        moved = target + velocity * time_step
        self._targets[self._velocity_effector] = np.clip(moved, low, high)
        self.clamped += bool((self._targets[self._velocity_effector] != moved).any())


def _limited(vector: np.ndarray, most: float) -> np.ndarray:
    """A vector that is not zero, shortened to at most a length."""
    # Scaled first: the square of a very large component would overflow.
    largest = float(np.abs(vector).max())
    direction = vector / largest
    length = float(np.linalg.norm(direction))
    return direction / length * min(most, largest * length)


class StiffnessInput(Input):
    """Wanted stiffnesses of the effectors, those of the scene until a message gives others.

    Args:
        scene_stiffness: Those of the scene [N/m], NaN where free, shape (effector_count, 3).
        are_asked: Whether each effector asks for a stiffness in the scene.
        frame_id: The only frame in which they are accepted.
        settings: Timeouts.

    Attributes:
        wanted: Stiffness of each effector along x, y and z [N/m], NaN where free, shape
            (effector_count, 3); None where no effector asks for one.
        is_given: True when a message has given one.
    """

    def __init__(
        self, scene_stiffness: np.ndarray, are_asked: Sequence[bool], frame_id: str,
        settings: LoopSettings,
    ):  # fmt: skip
        self._scene_stiffness, self._are_asked = scene_stiffness, tuple(are_asked)
        super().__init__(settings, frame_id, range(len(self._are_asked)))

    def reset(self) -> None:
        """Forgets all messages; the counts stay."""
        super().reset()
        self.wanted = self._scene_stiffness.copy() if any(self._are_asked) else None
        self.is_given = False

    @latched
    def accept(self, effector: int, stiffness, arrival: Arrival) -> Refusal | None:
        """Checks a wanted stiffness and keeps it.

        Args:
            effector: Index of the effector.
            stiffness: Along x, y and z [N/m], positive, NaN where free, shape (3,).
            arrival: Header and time of arrival of the message.

        Returns:
            The reason to refuse it, or None.
        """
        if not self._are_asked[effector]:
            return Refusal.WRONG_NAMES
        if refusal := refusal_of_vector(stiffness, may_be_nan=True):
            return refusal
        if (stiffness <= 0.0).any():
            return Refusal.NOT_POSITIVE
        self.wanted[effector] = stiffness
        self.is_given = bool(np.isfinite(self.wanted).any())
        return None


class SensorTargetInput(Input):
    """Wanted values of sensors with a weight, which stay until a message gives others.

    Args:
        are_wanted: Whether each sensor has a weight, by its name.
        frame_id: The only frame in which they are accepted.
        settings: Timeouts.

    Attributes:
        wanted: Value of each sensor in its unit, NaN where free, shape (sensor_count,).
    """

    def __init__(self, are_wanted: Mapping[str, bool], frame_id: str, settings: LoopSettings):
        self._are_wanted, self._names = are_wanted, list(are_wanted)
        super().__init__(settings, frame_id)

    def reset(self) -> None:
        """Forgets all messages; the counts stay."""
        super().reset()
        self.wanted = np.full(len(self._names), np.nan)

    @property
    def is_given(self) -> bool:
        """Whether anything is wanted."""
        return bool(np.isfinite(self.wanted).any())

    @latched
    def accept(self, names: Sequence[str], values, others, arrival: Arrival) -> Refusal | None:
        """Checks wanted values and keeps them; sensors that are not named keep theirs.

        Args:
            names: Names of sensors with a weight.
            values: Value of each, NaN to leave it free, shape (name_count,).
            others: Numbers of another meaning, of which there must be none.
            arrival: Header and time of arrival of the message.

        Returns:
            The reason to refuse it, or None.
        """
        if len(others):
            return Refusal.WRONG_FIELDS
        if not all(self._are_wanted.get(name) for name in names) or len(set(names)) < len(names):
            return Refusal.WRONG_NAMES
        if len(values) != len(names):
            return Refusal.WRONG_SIZE
        if np.isinf(values).any():
            return Refusal.NOT_FINITE
        wanted = self.wanted.copy()
        wanted[[self._names.index(name) for name in names]] = values
        self.wanted = wanted
        return None


# --- markers -------------------------------------------------------------------------------------


class Misfit(NamedTuple):
    """Difference of measured and predicted markers.

    Attributes:
        vectors: Measured minus predicted positions [m], shape (marker_count, 3); NaN for hidden
            markers.
        rms: Root mean square of the distances of the visible markers [m]; NaN without any.
        visible: Number of visible markers.
    """

    vectors: np.ndarray
    rms: float
    visible: int


class MarkerInput(Input):
    """The newest measured position of each marker of the scene.

    Args:
        marker_ids: Ids of the scene's markers, shape (marker_count,).
        frame_id: The only frame in which markers are accepted.
        settings: Timeouts.
        of_robot: Gives measured points in the frame of the robot.

    Attributes:
        unknown: Number of points with an id that the scene does not have; they are ignored.
        positions: Measured positions in the frame of the robot [m], shape (marker_count, 3); NaN for
            hidden markers.
        hidden: The array that `measured` gives when they are too old, all NaN.
        stamp: Time of the measurement [ns].
        time: The same on the clock of `Arrival.time` [s].
    """

    def __init__(
        self, marker_ids: np.ndarray, frame_id: str, settings: LoopSettings,
        of_robot: Callable[[np.ndarray], np.ndarray] = np.asarray,
    ):  # fmt: skip
        self.unknown, self._of_robot = 0, of_robot
        self._order = np.argsort(marker_ids, kind="stable")
        self._sorted_ids = np.asarray(marker_ids, dtype=np.uint32)[self._order]
        self.hidden = np.full((len(marker_ids), 3), np.nan)
        super().__init__(settings, frame_id)

    def reset(self) -> None:
        """Forgets the measurements; the counts stay."""
        super().reset()
        self.positions, self.stamp, self.time = self.hidden, 0, -math.inf

    @latched
    def accept(self, ids: np.ndarray, positions: np.ndarray, arrival: Arrival) -> Refusal | None:
        """Checks the markers of one message and keeps them.

        Args:
            ids: Marker ids, shape (n,).
            positions: Their positions [m], shape (n, 3); a row with a NaN is a hidden marker.
            arrival: Header and time of arrival of the message.

        Returns:
            The reason to refuse it, or None.
        """
        if positions.shape != (len(ids), 3):
            return Refusal.WRONG_SIZE
        if np.isinf(positions).any():
            return Refusal.NOT_FINITE
        if len(np.unique(ids)) != len(ids):
            return Refusal.DUPLICATE_ID
        self.stamp, self.time = arrival.stamp or arrival.ros_time, arrival.time - arrival.age
        measured = np.full_like(self.positions, np.nan)
        known = np.isin(ids, self._sorted_ids)
        places = self._order[np.searchsorted(self._sorted_ids, ids[known])]
        measured[places] = self._of_robot(positions[known])
        self.unknown += int((~known).sum())
        measured[np.isnan(measured).any(axis=1)] = np.nan
        self.positions = measured
        return None

    def measured(self, now: float) -> np.ndarray:
        """Valid positions [m], shape (marker_count, 3): all NaN when they are too old.

        Args:
            now: Time on the clock of `Arrival.time` [s].
        """
        return self.hidden if self.age(now) > self.settings.marker_timeout else self.positions

    @staticmethod
    def misfit(measured: np.ndarray, predicted: np.ndarray) -> Misfit:
        """Compares measured with predicted positions of the same moment [m], (marker_count, 3).

        Args:
            measured: Measured positions [m], shape (marker_count, 3), NaN where a marker is hidden.
            predicted: Those of the model [m], same shape.
        """
        vectors = measured - predicted
        visible = np.isfinite(vectors).all(axis=1)
        count = int(np.count_nonzero(visible))
        if not count:
            return Misfit(vectors, math.nan, 0)
        squares = np.einsum("ij,ij->i", vectors[visible], vectors[visible])
        return Misfit(vectors, float(np.sqrt(squares.mean())), count)


# --- actuators -----------------------------------------------------------------------------------


class NameOrder(NamedTuple):
    """How the values of a message become the values of actuators.

    Attributes:
        places: Index in the message of the value for each actuator, shape (actuator_count,); -1
            where the message has none.
        offsets: What to add to the message's setpoint, in the unit of each actuator's kind, shape
            (actuator_count,): for cables of a motor, the rest length minus that of its first cable.
    """

    places: np.ndarray
    offsets: np.ndarray

    @property
    def named(self) -> np.ndarray:
        """True for actuators that the message names, shape (actuator_count,)."""
        return self.places != UNNAMED

    def values(self, message: np.ndarray) -> np.ndarray:
        """Values of the actuators, NaN for those without a name, shape (actuator_count,).

        Args:
            message: A value for each name of the message.
        """
        if not len(message):
            return np.full(len(self.places), np.nan)
        return np.where(self.named, message[self.places], np.nan)


class ActuatorNames:
    """Maps the names in a message to actuators, and to motors that drive several cables.

    All cables of a motor have the same displacement against rest. A motor's position in a message is
    the length of its first cable; its effort is the effort of each of its cables.

    Args:
        actuator_names: Names of the actuators, in the order of the simulation.
        motors: Names of the cables of each motor, by the motor's name.
        rest_setpoints: Setpoints at rest, in the unit of each actuator's kind, shape
            (actuator_count,); needed with motors.
        by_position: Names of the actuators that take no efforts, such as slides.
        by_pressure: Names of the cavities whose pressure is commanded.
        by_angle: Names of the cables that pulleys wind.

    Attributes:
        by_position: True for actuators that take no efforts, shape (actuator_count,).
        by_pressure: True for cavities whose pressure is commanded, same shape. They have messages
            of their own, so that a message to all actuators may omit them.
        by_angle: True for cables that pulleys wind, same shape. Angles have messages of their own,
            so that a message of setpoints may omit them.
    """

    def __init__(
        self, actuator_names: Sequence[str], motors: Mapping[str, Sequence[str]] | None = None,
        rest_setpoints: np.ndarray | None = None, by_position: Sequence[str] = (),
        by_pressure: Sequence[str] = (), by_angle: Sequence[str] = (),
    ):  # fmt: skip
        names = tuple(actuator_names)
        self._count = len(names)
        self._indices = {name: [index] for index, name in enumerate(names)}
        for motor, cables in (motors or {}).items():
            self._indices[motor] = [names.index(cable) for cable in cables]
        self._rest = np.zeros(self._count) if rest_setpoints is None else np.array(rest_setpoints)
        self.by_position, self.by_pressure, self.by_angle = (
            np.array([name in own for name in names], bool) for own in (by_position, by_pressure, by_angle))

    def order_of(self, names: Sequence[str]) -> NameOrder | None:
        """Reads the names of a message.

        Args:
            names: Names of actuators and motors.

        Returns:
            The order, or None when a name is unknown or an actuator is named twice.
        """
        places = np.full(self._count, UNNAMED)
        offsets = np.zeros(self._count)
        for place, name in enumerate(names):
            indices = self._indices.get(name)
            if indices is None or (places[indices] != UNNAMED).any():
                return None
            places[indices] = place
            offsets[indices] = self._rest[indices] - self._rest[indices[0]]
        return NameOrder(places, offsets)


class ActuatorInput(Input):
    """The newest setpoint or effort of every actuator; a message must name each of them once.

    It is used for measurements of a device. Slides accept setpoints but no
    efforts: a message with efforts only may omit them or give NaN for them, and they keep their
    position. A message may omit cavities whose pressure is commanded: these keep the pressure that
    was last given, by a message or by `put`. A message with setpoints may likewise omit cables that
    pulleys wind, whose lengths `put` gives.

    Args:
        names: The names of actuators and motors.
        settings: Timeouts.

    Attributes:
        setpoints: Newest setpoints in the unit of each actuator's kind, shape (actuator_count,), or
            None; NaN where none was given, because only pressures of cavities were.
        efforts: Newest efforts in the unit of each actuator's kind, shape (actuator_count,), or
            None; NaN for slides without one, and for cavities whose pressure was never given.
    """

    def __init__(self, names: ActuatorNames, settings: LoopSettings):
        self._names = names
        # The names of the last message and their order: they seldom change.
        self._known: tuple[tuple[str, ...], NameOrder | None] = ((), names.order_of(()))
        super().__init__(settings, None)

    def reset(self) -> None:
        """Forgets what was received; the counts stay."""
        super().reset()
        self.setpoints: np.ndarray | None = None
        self.efforts: np.ndarray | None = None
        # Pressures [Pa] of cavities and lengths [m] of wound cables that a message may omit; NaN
        # without one.
        self._pressures = np.full(len(self._names.by_pressure), np.nan)

    @latched
    def accept(self, names: Sequence[str], setpoints, efforts, arrival: Arrival) -> Refusal | None:
        """Checks one message and keeps it.

        Args:
            names: Names of actuators or motors, in the message's own order.
            setpoints: A setpoint for each name, in the unit of the actuator's kind, or empty.
            efforts: An effort for each name, in the unit of the actuator's kind, or empty; one of
                both must be given.
            arrival: Header and time of arrival of the message.

        Returns:
            The reason to refuse it, or None.
        """
        order = self._order_of(tuple(names))
        if order is None or not self._names_fit(order, setpoints, efforts):
            return Refusal.WRONG_NAMES
        if refusal := self._refusal_of_values(order, len(names), setpoints, efforts):
            return refusal
        self._keep(order, setpoints, efforts, arrival.time)
        return None

    def put(self, places: np.ndarray, setpoints: np.ndarray, time: float) -> Refusal | None:
        """Keeps setpoints of some actuators; the others keep what they were given.

        After a message of efforts, a length leaves the others where they are.

        Args:
            places: Indices of a cavity whose pressure is commanded, or of the cables of a pulley.
            setpoints: Its gauge pressure [Pa], or their lengths [m], finite, same shape.
            time: Time of arrival [s].

        Returns:
            The reason to refuse them, or None.
        """
        count = len(self._pressures)
        self._pressures[places] = setpoints
        if self.efforts is not None and self._names.by_angle[places].any():
            if self.setpoints is None:
                self.setpoints = np.where(self._names.by_pressure, self._pressures, np.nan)
            self.efforts = None
        if self.setpoints is not None or self.efforts is None:
            self.setpoints = replaced(self.setpoints, places, setpoints, count)
        if self.efforts is not None:
            self.efforts = replaced(self.efforts, places, setpoints)
        self._newest = time
        return None

    def _keep(self, order: NameOrder, setpoints: np.ndarray, efforts: np.ndarray, time: float) -> None:
        """Keeps the values of a valid message that arrived at a time [s]."""
        apart = self._names.by_pressure | self._names.by_angle
        omitted = apart & ~order.named
        values = order.values(setpoints) + order.offsets
        given = order.values(efforts)
        newest = values if len(setpoints) else given
        self._pressures = np.where(apart & order.named, newest, self._pressures)
        if not len(setpoints):
            self._pressures[self._names.by_angle] = np.nan
        self.setpoints = np.where(omitted, self._pressures, values) if len(setpoints) else None
        self.efforts = np.where(omitted, self._pressures, given) if len(efforts) else None

    def _names_fit(self, order: NameOrder, setpoints: np.ndarray, efforts: np.ndarray) -> bool:
        """Whether a message names all actuators that it must name."""
        missing = ~order.named & ~self._names.by_pressure
        if len(setpoints):
            missing &= ~self._names.by_angle
        elif len(efforts):
            missing &= ~self._names.by_position
        return not missing.any()

    def _refusal_of_values(
        self, order: NameOrder, count: int, setpoints: np.ndarray, efforts: np.ndarray
    ) -> Refusal | None:
        """The reason to refuse the values of a message whose names are valid, or None."""
        sizes = len(setpoints), len(efforts)
        if not set(sizes) <= {0, count} or not any(sizes):
            return Refusal.WRONG_SIZE
        by_position = self._names.by_position
        given = order.values(efforts)
        needed = order.named & ~by_position if len(efforts) else np.zeros_like(by_position)
        if not np.isfinite(setpoints).all() or np.isinf(given).any() or np.isnan(given[needed]).any():
            return Refusal.NOT_FINITE
        positioned = np.isfinite(given[by_position]).any() and not len(setpoints)
        return Refusal.WRONG_FIELDS if positioned else None

    def _order_of(self, names: tuple[str, ...]) -> NameOrder | None:
        """The order of a message's names; None when they are not valid."""
        if names != self._known[0]:
            self._known = (names, self._names.order_of(names))
        return self._known[1]


def replaced(values: np.ndarray | None, place: np.ndarray, value: np.ndarray, count: int = 0) -> np.ndarray:
    """A copy with values replaced at some places; of NaN, shape (count,), where there are none yet.

    Args:
        values: The values, shape (count,); None for none yet.
        place: Numbers of the places.
        value: The new values, as many.
        count: How many values there are in all, where there are none yet.
    """
    values = np.full(count, np.nan) if values is None else values.copy()
    values[place] = value
    return values


class DirectActuatorInput(ActuatorInput):
    """Setpoints or efforts of direct commands; a message names one actuator or more.

    Actuators that it does not name keep what earlier messages of the same kind gave them, or hold.

    Attributes:
        setpoints: See `ActuatorInput`; NaN where none was given.
        efforts: See `ActuatorInput`; NaN where none was given.
    """

    def _keep(self, order: NameOrder, setpoints: np.ndarray, efforts: np.ndarray, time: float) -> None:
        before = self.setpoints, self.efforts
        super()._keep(order, setpoints, efforts, time)
        self.setpoints, self.efforts = (
            newest if newest is None or kept is None
            else np.where(order.named | ~np.isnan(newest), newest, kept)
            for newest, kept in zip((self.setpoints, self.efforts), before, strict=True)
        )  # fmt: skip

    def _names_fit(self, order: NameOrder, setpoints: np.ndarray, efforts: np.ndarray) -> bool:
        return bool(order.named.any())


class SelectedActuatorInput(ActuatorInput):
    """Setpoints of the actuators that are commanded while the others follow targets.

    Each message replaces the selection by the actuators that it names, possibly none. Only cavities
    that `put` selected stay selected until a message names them, or nothing.

    Attributes:
        setpoints: Commanded setpoints in the unit of each actuator's kind, shape (actuator_count,),
            NaN where not selected; None when no actuator is selected.
    """

    def _keep(self, order: NameOrder, setpoints: np.ndarray, efforts: np.ndarray, time: float) -> None:
        if not len(setpoints):
            self.setpoints, self._pressures[:] = None, np.nan
            return
        self._pressures[order.named] = np.nan
        values = order.values(setpoints) + order.offsets
        self.setpoints = np.where(np.isnan(self._pressures), values, self._pressures)

    def _names_fit(self, order: NameOrder, setpoints: np.ndarray, efforts: np.ndarray) -> bool:
        return True

    def _refusal_of_values(
        self, order: NameOrder, count: int, setpoints: np.ndarray, efforts: np.ndarray
    ) -> Refusal | None:
        if not count and not len(setpoints) and not len(efforts):
            return None
        if len(efforts) and not len(setpoints):
            # The inverse problem can hold an actuator at a setpoint, not at an effort.
            return Refusal.WRONG_FIELDS
        return super()._refusal_of_values(order, count, setpoints, efforts)

    def is_too_old(self, now: float, timeout: float) -> bool:
        """True when no message arrived for longer than a timeout [s]; never with 0.

        Args:
            now: Time on the clock of `Arrival.time` [s].
            timeout: The timeout [s]; 0 for none.
        """
        return self.setpoints is not None and 0.0 < timeout < self.age(now)


# --- poses of guided bodies ----------------------------------------------------------------------


def refusal_of_pose(pose: Pose) -> Refusal | None:
    """The reason to refuse the numbers of a pose, or None.

    Args:
        pose: The pose as it came.
    """
    if (pose.position.shape, pose.quaternion.shape) != ((3,), (4,)):
        return Refusal.WRONG_SIZE
    if not (np.isfinite(pose.position).all() and np.isfinite(pose.quaternion).all()):
        return Refusal.NOT_FINITE
    is_rotation = np.abs(pose.quaternion).max() >= _SMALLEST_COMPONENT
    return None if is_rotation else Refusal.NO_ROTATION


class PoseInput(Input):
    """The newest commanded pose of every guided body.

    Args:
        names: Names of the guided bodies.
        frame_id: The only accepted frame.
        settings: Timeouts and workspace.

    Attributes:
        newest: The newest pose of each body that received one since the last reset, by name.
    """

    def __init__(self, names: Sequence[str], frame_id: str, settings: LoopSettings):
        super().__init__(settings, frame_id, names)

    def reset(self) -> None:
        """Forgets what was received; the counts stay."""
        super().reset()
        self.newest: dict[str, Pose] = {}

    @latched
    def accept(self, name: str, position, quaternion, arrival: Arrival) -> Refusal | None:
        """Checks one message and keeps it.

        Args:
            name: A guided body.
            position: Its commanded position [m], shape (3,); it is limited to the workspace.
            quaternion: Its commanded rotation (x, y, z, w), shape (4,).
            arrival: Header and time of arrival of the message.

        Returns:
            The reason to refuse it, or None.
        """
        if refusal := refusal_of_pose(Pose(position, quaternion)):
            return refusal
        self.newest[name] = Pose(self._inside(position), quaternion)
        return None


class BaseInput(Input):
    """Where a moving base is, in a frame of the world that the sender chooses.

    Args:
        settings: Timeouts.

    Attributes:
        pose: The newest pose; None before the first.
        frame: The frame of the world.
        time: When the base was there, on the clock of `Arrival.time` [s].
    """

    def __init__(self, settings: LoopSettings):
        super().__init__(settings, None)

    def reset(self) -> None:
        """Forgets what was received; the counts stay."""
        super().reset()
        self.pose: Pose | None = None
        self.time, self.frame = -math.inf, ""

    @latched
    def accept(self, position, quaternion, arrival: Arrival) -> Refusal | None:
        """Checks one message and keeps it.

        Args:
            position: Origin of the base [m], shape (3,).
            quaternion: Its rotation (x, y, z, w), shape (4,).
            arrival: Header and time of arrival of the message.

        Returns:
            The reason to refuse it, or None.
        """
        pose = Pose(np.array(position, dtype=float), quaternion)
        if refusal := refusal_of_pose(pose):
            return refusal
        self.pose, self.time, self.frame = pose, arrival.time - arrival.age, arrival.frame_id
        return None


# --- angles of pulleys ---------------------------------------------------------------------------


class AngleInput(Input):
    """Angles of any pulleys, as commands or as measurements; elsewhere cables have lengths.

    A message concerns the pulleys that it names; everything else stays as it is.

    Args:
        pulleys: The pulleys.
        keeper: Keeps the lengths of their cables beside the setpoints of the other actuators, and
            counts the refusals.
        settings: Timeouts.
        takes_torques: Whether torques beside the angles are kept, as of measurements; a command by
            torques is refused.
    """

    def __init__(self, pulleys: Pulleys, keeper: ActuatorInput, settings: LoopSettings, takes_torques: bool):
        self._pulleys, self._keeper = pulleys, keeper
        self._takes_torques = takes_torques
        super().__init__(settings, None, refusals=keeper.refusals)

    @latched
    def accept(self, names: Sequence[str], angles, torques, arrival: Arrival) -> Refusal | None:
        """Checks one message and keeps its angles; all of them, or none.

        Args:
            names: Names of pulleys, each at most once.
            angles: Angle of each [rad].
            torques: Torque of each about its axis [N m], or empty.
            arrival: Header and time of arrival of the message.

        Returns:
            The reason to refuse it, or None.
        """
        if refusal := self._fault_of(names, angles, torques):
            return refusal
        pulleys = self._pulleys
        places = [pulleys.names.index(name) for name in names]
        driven = np.concatenate([pulleys.driven[place] for place in places])
        lengths = np.concatenate(list(map(pulleys.lengths, places, angles)))
        refusal = self._keeper.put(driven, lengths, arrival.time)
        if refusal is None and len(torques):
            tensions = np.concatenate(list(map(pulleys.tensions, places, torques)))
            self._keeper.put_efforts(driven, tensions)
        return refusal

    def _fault_of(self, names: Sequence[str], angles: np.ndarray, torques: np.ndarray) -> Refusal | None:
        unknown = any(name not in self._pulleys.names for name in names)
        if not len(names) or unknown or len(set(names)) != len(names):
            return Refusal.WRONG_NAMES
        if len(torques) and (not self._takes_torques or not len(angles)):
            return Refusal.WRONG_FIELDS
        if len(angles) != len(names) or len(torques) not in (0, len(names)):
            return Refusal.WRONG_SIZE
        if not (np.isfinite(angles).all() and np.isfinite(torques).all()):
            return Refusal.NOT_FINITE
        return None


# --- touches -------------------------------------------------------------------------------------


class TouchInput(Input):
    """The newest measured force or place of each touch; whichever came last counts.

    A touch ends by a force of zero, by a NaN in either message, or without a message for
    `touch_timeout`.

    Args:
        simulation: The model, at rest.
        frame_id: The only frame in which touches are accepted.
        settings: Timeouts.

    Attributes:
        timed_out: How many touches ended because no message came.
    """

    def __init__(self, simulation: Simulation, frame_id: str, settings: LoopSettings):
        self.timed_out = 0
        self.names = simulation.touch_names
        self._limits = np.array([touch.force_limit for touch in simulation.scene.touches])
        touches = simulation.touches
        self._rest = np.empty((0, 3)) if touches is None else np.array(touches.points)
        self._farthest = FARTHEST * simulation.model.nodes.size
        # A touch has two senders with clocks of their own.
        methods = "accept_force", "accept_place"
        super().__init__(settings, frame_id, product(range(len(self.names)), methods))

    def _header_of(self, key: object, method: str) -> HeaderCheck | None:
        return super()._header_of((key, method), method)

    def reset(self) -> None:
        """Ends all touches; the counts stay."""
        super().reset()
        self._forces, self._places = Touched.none(len(self.names))
        self._heard = np.full(len(self.names), -math.inf)

    @latched
    def accept_force(self, touch: int, force, arrival: Arrival) -> Refusal | None:
        """Checks a measured force and keeps it.

        Args:
            touch: Index of the touch.
            force: Force on the robot [N], shape (3,); zero or NaN without a touch.
            arrival: Header and time of arrival of the message.

        Returns:
            The reason to refuse it, or None. A refused force leaves the touch as it was.
        """
        if refusal := _fault_of_touch(force, 0.0, self._limits[touch]):
            return refusal
        self._keep(touch, force if np.linalg.norm(force) > 0.0 else np.nan, np.nan, arrival.time)
        return None

    @latched
    def accept_place(self, touch: int, place, arrival: Arrival) -> Refusal | None:
        """Checks a measured place of a touched point and keeps it.

        Args:
            touch: Index of the touch.
            place: Place of the point [m], shape (3,); NaN without a touch.
            arrival: Header and time of arrival of the message.

        Returns:
            The reason to refuse it, or None. A refused place leaves the touch as it was.
        """
        if refusal := _fault_of_touch(place, self._rest[touch], self._farthest):
            return refusal
        self._keep(touch, np.nan, np.nan if np.isnan(place).any() else place, arrival.time)
        return None

    def _keep(self, touch: int, force, place, time: float) -> None:
        self._forces[touch], self._places[touch] = force, place
        self._heard[touch] = time

    def read(self, now: float) -> Touched | None:
        """The touches at a time on the clock of `Arrival.time` [s]; None where nothing touches.

        Args:
            now: Time on the clock of `Arrival.time` [s].
        """
        if not self.names:
            return None
        touching = ~np.isnan(self._forces).all(axis=1) | ~np.isnan(self._places).all(axis=1)
        late = touching & (now - self._heard > self.settings.touch_timeout)
        if late.any():
            self.timed_out += int(late.sum())
            self._forces[late], self._places[late] = np.nan, np.nan
        if not (touching & ~late).any():
            return None
        return Touched(self._forces.copy(), self._places.copy())


# --- channels from outside -----------------------------------------------------------------------


class ChannelInput(Input):
    """The newest measured numbers of each object of a channel that was added from outside.

    Args:
        channel: The channel.
        count: Number of its objects.
        frame_id: The only accepted frame.
        settings: Timeouts.
        refusals: Counts refused messages.

    Attributes:
        stamp: Time of the newest measurement [ns].
        time: The same on the clock of `Arrival.time` [s].
    """

    def __init__(
        self, channel: Channel, count: int, frame_id: str, settings: LoopSettings,
        refusals: RefusalCounts,
    ):  # fmt: skip
        self._channel, self._shape = channel, (count, channel.width)
        super().__init__(settings, frame_id, range(count), refusals)

    def reset(self) -> None:
        """Forgets the measurements; the counts stay."""
        super().reset()
        self._values, self._heard = np.full(self._shape, np.nan), np.full(self._shape[0], -math.inf)
        self._past: list[Past] = [deque(maxlen=PAST) for _ in self._values]
        self.stamp, self.time = 0, -math.inf

    def accept(self, index: int, names: Sequence[str], values, others, arrival: Arrival) -> Refusal | None:
        """Checks the measured numbers of an object and keeps them.

        Args:
            index: The object.
            names: Names of the numbers, those of the channel in any order.
            values: The number of each, finite.
            others: Numbers of another meaning, of which there must be none.
            arrival: Header and time of arrival of the message.

        Returns:
            The reason to refuse it, or None.
        """
        parts = self._channel.parts
        if len(others) or sorted(names) != sorted(parts):
            return self.refusals.add(Refusal.WRONG_FIELDS if len(others) else Refusal.WRONG_NAMES)
        if len(values) != len(names):
            return self.refusals.add(Refusal.WRONG_SIZE)
        return self._take(index, [values[list(names).index(part)] for part in parts], arrival)

    @latched
    def _take(self, index: int, values: np.ndarray, arrival: Arrival) -> Refusal | None:
        """Keeps numbers in the order of the channel; the reason to refuse them, or None."""
        if not np.isfinite(values).all():
            return Refusal.NOT_FINITE
        if np.abs(values).max() > self._channel.most:
            return Refusal.OUT_OF_RANGE
        self._values[index], self._heard[index] = values, arrival.time
        self.stamp, self.time = arrival.stamp or arrival.ros_time, arrival.time - arrival.age
        self._past[index].append((self.time, values))
        return None

    def read(self, now: float, since: float = -math.inf) -> np.ndarray:
        """The newest numbers, shape (object_count, width): NaN where older than `device_timeout`.

        Args:
            now: Time on the clock of `Arrival.time` [s].
            since: NaN too where nothing was heard after this time [s].
        """
        # Each tick reads all channels, of which most are never heard.
        if self.time == -math.inf:
            return self._values.copy()
        is_late = (now - self._heard > self.settings.device_timeout) | (self._heard <= since)
        return np.where(is_late[:, None], np.nan, self._values)

    def at(self, time: float) -> np.ndarray:
        """The numbers at a time, of the same shape: NaN where none are known; see `between`.

        Args:
            time: On the clock of `Arrival.time` [s].
        """
        found = [between(past, time) for past in self._past]
        nowhere = np.full(self._shape[1], np.nan)
        return np.array([nowhere if one is None else one for one in found]).reshape(self._shape)


def _fault_of_touch(vector: np.ndarray, start, most: float) -> Refusal | None:
    """The reason to refuse a vector, or None: it may be NaN, and ends so far from a start at most."""
    if refusal := refusal_of_vector(vector, may_be_nan=True):
        return refusal
    return Refusal.OUT_OF_RANGE if np.linalg.norm(vector - start) > most else None
