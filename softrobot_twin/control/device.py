"""The hardware in the loop: its interface, its measurements, and whether it follows commands.

A driver of real hardware implements `Device`. `MeasuredSetpoints` keeps what a device reports, and
`DeviceWatch` detects that a device is not where it was sent.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np

from softrobot_twin.control.arrival import Refusal
from softrobot_twin.control.inputs import PAST, ActuatorInput, ActuatorNames, NameOrder, Past, between, replaced
from softrobot_twin.control.loop_settings import LoopSettings
from softrobot_twin.control.voices import LAG_RATE, LAG_SHARE, LAG_TIME, PlaceWatch
from softrobot_twin.simulation.building.limits import ActuatorLimits, Pulleys
from softrobot_twin.simulation.effects.touches import TouchState

OUTSIDE_SHARE = 0.1
"""A measured setpoint may be outside the limits by this share of the travel."""
OUTSIDE_SHARE_OF_REST = 0.01
"""It may be outside them by this share of the setpoint at rest, if that is more."""
OUTSIDE_SCALES = 1.0e6
"""An actuator without a limit is measured this many of its scales from where it is at rest at most."""

_OF_ALL = ""
"""Key of the message that measures all actuators, beside the names of cavities."""


class DeviceReading(NamedTuple):
    """What a robot measures at one moment.

    Attributes:
        setpoints: Measured setpoints in the unit of each actuator's kind, shape (actuator_count,).
        efforts: Measured efforts in the unit of each actuator's kind, shape (actuator_count,).
        marker_ids: Ids of the markers, uint32, shape (marker_count,).
        marker_positions: Their measured positions [m], shape (marker_count, 3); NaN for hidden
            markers.
        effector_positions: Positions of the effectors [m], shape (effector_count, 3); NaN where the
            robot cannot measure them.
    """

    setpoints: np.ndarray
    efforts: np.ndarray
    marker_ids: np.ndarray
    marker_positions: np.ndarray
    effector_positions: np.ndarray


class Device(Protocol):
    """A robot with actuators. A driver of real hardware has these two methods too."""

    actuator_names: tuple[str, ...]
    effector_names: tuple[str, ...]

    def apply(self, setpoints: np.ndarray, now: float) -> None:
        """Takes the newest command.

        Args:
            setpoints: Setpoints in the unit of each actuator's kind, shape (actuator_count,); efforts
                where the device's node has ``device_follows: efforts``.
            now: Time of the command [s].
        """

    def read(self, now: float) -> DeviceReading:
        """Measures at a time [s] that never decreases.

        Args:
            now: Time on the monotonic clock [s].
        """


@runtime_checkable
class CarriedDevice(Protocol):
    """A robot whose guided bodies are moved by something else, such as an arm that carries it.

    A device that accepts poses implements this in addition to `Device`.
    """

    guided_names: tuple[str, ...]
    rigid_names: tuple[str, ...]

    def apply_pose(self, name: str, position: np.ndarray, quaternion: np.ndarray, now: float) -> None:
        """Takes the newest pose of a guided body at a time [s]: position [m], (x, y, z, w).

        Args:
            name: Name of the body.
            position: Where its origin goes [m], shape (3,).
            quaternion: How it is turned (x, y, z, w), shape (4,).
            now: Time on the monotonic clock [s].
        """

    def rigid_poses(self) -> tuple[np.ndarray, np.ndarray]:
        """Poses of the rigid bodies.

        Returns:
            Positions [m], shape (rigid_body_count, 3), and quaternions (x, y, z, w), shape
            (rigid_body_count, 4); NaN where the robot cannot measure them.
        """


@runtime_checkable
class PressurisedDevice(Protocol):
    """A robot whose sensors measure pressures of cavities, as efforts of these actuators.

    Attributes:
        cavity_names: Names of the cavities that have sensors.
        pressure_variance: Variance of what they measure [Pa²]; 0 where it is unknown.
    """

    cavity_names: tuple[str, ...]
    pressure_variance: float


@runtime_checkable
class WoundDevice(Protocol):
    """A robot whose servos measure angles of pulleys that wind its cables.

    Attributes:
        pulleys: The pulleys; the device measures the lengths of their cables as setpoints.
    """

    pulleys: Pulleys


@runtime_checkable
class TouchedDevice(Protocol):
    """A robot that measures touches by sensors of its own.

    Attributes:
        touch_names: Names of the touches that are measured.
    """

    touch_names: tuple[str, ...]

    def touches(self) -> TouchState:
        """What was measured of them last, in the order of `touch_names`."""


class ImplausibleSetpoint(NamedTuple):
    """A measured setpoint that an actuator of the scene cannot have.

    Attributes:
        name: The actuator.
        value: The measured setpoint, in its unit.
        low: Least accepted setpoint.
        high: Greatest accepted setpoint.
        unit: Their unit.
    """

    name: str
    value: float
    low: float
    high: float
    unit: str = "m"

    def __str__(self) -> str:
        return self.in_words("measures")

    def in_words(self, verb: str) -> str:
        """The setpoint and what is accepted.

        Args:
            verb: Stands between the actuator and its value.
        """
        return (
            f"{self.name} {verb} {self.value:.6g} {self.unit}, accepted are {self.low:.6g} to "
            f"{self.high:.6g} {self.unit}"
        )


class MeasuredSetpoints(ActuatorInput):
    """Keeps the newest setpoints of a device; refuses those that no actuator of the scene can have.

    Accepted is the range of the limits, extended by a tenth of the travel or a hundredth of the
    setpoint at rest, of a pressure of its scale, because the zero of a sensor is never exact; where
    there is no limit, `OUTSIDE_SCALES` of the actuator's scale. The
    length of a cable and the volume of a cavity cannot be negative, nor a pressure below vacuum.

    All actuators come in one message, or the cavities whose pressure is commanded in messages of
    their own; the newest measurement of each counts.

    Args:
        names: The names of the actuators.
        rest_setpoints: Setpoints at rest, in the unit of each actuator's kind, shape
            (actuator_count,).
        limits: Limits of the displacements.
        settings: Timeouts.
        units: Unit of the setpoint of each actuator; metres by default.
        vacuum: The gauge pressure of a vacuum [Pa].

    Attributes:
        setpoints: Newest setpoints in the unit of each actuator's kind, shape (actuator_count,);
            None until each was measured.
        arrived: Time of arrival of the newest setpoint of each actuator [s], same shape; minus
            infinity before the first.
        places: Whether they are measured at two places by turns; the newer place is not used then.
        past: Times of the last measurements on the clock of `Arrival.time` [s], and their setpoints.
    """

    def __init__(
        self, names: ActuatorNames, rest_setpoints: np.ndarray, limits: ActuatorLimits,
        settings: LoopSettings, units: Sequence[str] = (), vacuum: float = -np.inf,
    ):
        by_effort = limits.is_effort_driven
        beyond = zero_errors(limits, rest_setpoints)
        low, high = limits.setpoint_range(rest_setpoints)
        far = OUTSIDE_SCALES * limits.drive_scale
        low = np.where(np.isfinite(low), low, rest_setpoints - far)
        high = np.where(np.isfinite(high), high, rest_setpoints + far)
        # Positions of slides and angles may be negative, lengths and volumes not.
        is_angle = np.array([unit == "rad" for unit in units] or [False] * len(low), bool)
        least = np.where(names.by_position | is_angle, -np.inf, 0.0)
        least = np.where(by_effort, rest_setpoints + limits.slopes * vacuum, least)
        self._low, self._high = np.maximum(low - beyond, least), high + beyond
        self._moves = limits.rate, _noise(limits)
        self._actuator_names = tuple(limits.names)
        self._units = tuple(units) or ("m",) * len(self._actuator_names)
        super().__init__(names, settings)

    def reset(self) -> None:
        """Forgets what was received; the counts stay."""
        super().reset()
        self.arrived = np.full(len(self._low), -np.inf)
        self.places = PlaceWatch(*self._moves)
        self.past: Past = deque(maxlen=PAST)
        self._measured = np.full(len(self._low), np.nan)
        self._implausible: dict[str, ImplausibleSetpoint] = {}

    @property
    def implausible(self) -> ImplausibleSetpoint | None:
        """A setpoint for which the newest message of its kind was refused; else None."""
        return next(iter(self._implausible.values()), None)

    def accept(self, names: Sequence[str], setpoints, efforts, arrival) -> Refusal | None:
        """Checks one message and keeps it; see `ActuatorInput.accept`."""
        self._implausible.pop(_OF_ALL, None)
        refusal = super().accept(names, setpoints, efforts, arrival)
        if refusal is None and self.setpoints is not None:
            self.past.append((arrival.time - arrival.age, self.setpoints))
        return refusal

    def put(self, places: np.ndarray, setpoints: np.ndarray, time: float) -> Refusal | None:
        """Keeps measured setpoints of some actuators; see `ActuatorInput.put`."""
        name = self._actuator_names[places[0]]
        self._implausible.pop(name, None)
        measured = replaced(None, places, setpoints, len(self._low))
        if self._find_implausible(measured, name):
            return Refusal.OUT_OF_RANGE
        self._take(~np.isnan(measured), measured, time)
        if self.setpoints is not None:
            self.past.append((time, self.setpoints))
        return None

    def at(self, time: float) -> np.ndarray | None:
        """Setpoints at a time, between two measurements or next to one.

        Args:
            time: On the clock of `Arrival.time` [s].

        Returns:
            In the unit of each actuator's kind, shape (actuator_count,); None where nothing was
            measured within `NEAR` of it.
        """
        return between(self.past, time)

    def put_efforts(self, places: np.ndarray, efforts: np.ndarray) -> None:
        """Keeps measured efforts of some actuators; the others stay.

        Args:
            places: Indices of the actuators.
            efforts: In the unit of each actuator's kind, same shape.
        """
        self.efforts = replaced(self.efforts, places, efforts, len(self._low))

    def age(self, now: float) -> float:
        """Time since each actuator was measured [s]: the greatest; infinite before the first.

        Args:
            now: Time on the clock of `Arrival.time` [s].
        """
        return now - float(self.arrived.min(initial=self._newest))

    def unheard(self, now: float, timeout: float) -> tuple[str, ...]:
        """Names of the actuators that were not measured for longer than a timeout [s].

        Args:
            now: Time on the clock of `Arrival.time` [s].
            timeout: The timeout [s].
        """
        return tuple(
            name for name, arrived in zip(self._actuator_names, self.arrived, strict=True)
            if now - arrived > timeout
        )  # fmt: skip

    def _keep(self, order: NameOrder, setpoints: np.ndarray, efforts: np.ndarray, time: float) -> None:
        self.efforts = order.values(efforts) if len(efforts) else None
        self._take(order.named, order.values(setpoints) + order.offsets, time)

    def _take(self, named: np.ndarray, measured: np.ndarray, time: float) -> None:
        """Keeps the setpoints of some actuators that arrived at a time [s]."""
        self._newest = time
        for name in [name for name in self._implausible if name != _OF_ALL]:
            if named[self._actuator_names.index(name)]:
                del self._implausible[name]
        self.arrived = np.where(named, time, self.arrived)
        if not self.places.hear(named, measured, time):
            return
        self._measured = np.where(named, measured, self._measured)
        self.setpoints = None if np.isnan(self._measured).any() else self._measured

    def implausible_of(self, setpoints: np.ndarray) -> ImplausibleSetpoint | None:
        """The first of some setpoints that its actuator cannot have; NaN is none.

        Args:
            setpoints: In the unit of each actuator's kind, shape (actuator_count,).
        """
        wrong = np.flatnonzero((setpoints < self._low) | (setpoints > self._high))
        if not len(wrong):
            return None
        place = int(wrong[0])
        return ImplausibleSetpoint(
            self._actuator_names[place], float(setpoints[place]), float(self._low[place]),
            float(self._high[place]), self._units[place],
        )  # fmt: skip

    def _find_implausible(self, measured: np.ndarray, source: str) -> bool:
        """Whether a setpoint is not accepted, which is kept; see `implausible_of`.

        Args:
            measured: Setpoints, shape (actuator_count,).
            source: What the message is about, by which the next one is recognised.
        """
        found = self.implausible_of(measured)
        if found is not None:
            self._implausible[source] = found
        return found is not None

    def _refusal_of_values(
        self, order: NameOrder, count: int, setpoints: np.ndarray, efforts: np.ndarray
    ) -> Refusal | None:
        if not len(setpoints):
            return Refusal.WRONG_SIZE
        if refusal := super()._refusal_of_values(order, count, setpoints, efforts):
            return refusal
        measured = order.values(setpoints) + order.offsets
        return Refusal.OUT_OF_RANGE if self._find_implausible(measured, _OF_ALL) else None


def zero_errors(limits: ActuatorLimits, rest_setpoints: np.ndarray) -> np.ndarray:
    """How far the zeros of sensors may be off, in the unit of each kind, shape (actuator_count,).

    Args:
        limits: Limits of the actuators.
        rest_setpoints: Setpoints at rest, in the unit of each actuator's kind, same shape.
    """
    whole = np.where(limits.is_effort_driven, limits.effort_scale, np.abs(rest_setpoints))
    return np.maximum(OUTSIDE_SHARE * limits.travel(0.0), OUTSIDE_SHARE_OF_REST * whole)


def _noise(limits: ActuatorLimits) -> np.ndarray:
    """What noise may change of a setpoint, shape (actuator_count,)."""
    # A cable may be allowed to lengthen without limit; its shortening always has a limit.
    least = np.where(np.isfinite(limits.drive_min), limits.drive_min, 0.0)
    travel = np.abs(limits.slopes) * (limits.drive_max - least)
    return LAG_SHARE * np.where(np.isfinite(travel), travel, np.inf)


class DeviceWatch:
    """Detects that a device is not where the commands sent it, so that it is not driven further.

    When the messages of a lost device arrive again, its setpoints are compared with the last
    command. A device that was restarted within the timeout is detected by a jump: the distance from
    its command increases faster than that of any device that follows, even with delay.

    Args:
        limits: Rates and travels of the actuators.

    Attributes:
        is_on_the_way: True when the device, for which `has_moved` is true, is between its last
            measurement and its command, so that only its messages were lost.
    """

    def __init__(self, limits: ActuatorLimits):
        self._rate = limits.rate
        self.forget()

    def forget(self) -> None:
        """Forgets all measurements, as before a resynchronisation."""
        self._was_lost = False
        self._arrived = np.full(len(self._rate), -np.inf)
        self._lag: np.ndarray | None = None
        self._measured: np.ndarray | None = None
        self.is_on_the_way = False

    def has_moved(
        self, device: MeasuredSetpoints, lost: bool, commanded: np.ndarray, reach: np.ndarray
    ) -> bool:
        """Whether the device is not where it was sent. Called once per tick.

        Args:
            device: The setpoints that the device measures.
            lost: True while its messages do not arrive.
            commanded: Its last command in the unit of each actuator's kind, shape
                (actuator_count,).
            reach: Greatest move of each actuator in a tick, same shape.
        """
        if lost or device.setpoints is None:
            self._was_lost, self._lag = True, None
            return False
        lag, noise = np.abs(device.setpoints - commanded), device.places.noise.bound
        before, since = self._lag, device.arrived - self._arrived
        is_new = since > 0.0
        if self._was_lost:
            self._was_lost = False
            self.is_on_the_way = self._is_between(device.setpoints, commanded, noise)
            self._lag, self._arrived = lag, device.arrived
            self._measured = device.setpoints
            return bool((lag > np.minimum(reach, noise)).any())
        if not is_new.any():
            return False
        self._lag = lag if before is None else np.where(is_new, lag, before)
        self._arrived = device.arrived
        self._measured, self.is_on_the_way = device.setpoints, False
        if before is None:
            return False
        # Without a rate limit, the product with a time of 0 would be NaN.
        time = np.where(is_new, np.maximum(LAG_RATE * np.minimum(since, LAG_TIME), since), LAG_TIME)
        return bool((is_new & (lag - before > self._rate * time + noise)).any())

    def _is_between(self, setpoints: np.ndarray, commanded: np.ndarray, noise: np.ndarray) -> bool:
        """True for setpoints between the last measured ones and the command."""
        if self._measured is None:
            return False
        low = np.minimum(self._measured, commanded) - noise
        high = np.maximum(self._measured, commanded) + noise
        return bool(((setpoints >= low) & (setpoints <= high)).all())
