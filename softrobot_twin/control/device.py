"""The hardware in the loop: its interface, its measurements, and whether it follows commands.

A driver of real hardware implements `Device`. `MeasuredSetpoints` keeps what a device reports, and
`DeviceWatch` detects that a device is not where it was sent.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np

from softrobot_twin.control.actuator_names import ActuatorNames, NameOrder
from softrobot_twin.control.arrival import Refusal
from softrobot_twin.control.inputs import ActuatorInput
from softrobot_twin.control.loop_settings import LoopSettings
from softrobot_twin.simulation.limits import ActuatorLimits

OUTSIDE_SHARE = 0.1
"""A measured setpoint may be outside the limits by this share of the travel."""
OUTSIDE_SHARE_OF_REST = 0.01
"""It may be outside them by this share of the setpoint at rest, if that is more."""
LAG_RATE = 3.0
"""As long as a device follows its commands, its distance from them increases at most at this
multiple of the rates."""
LAG_TIME = 0.05
"""The distance increases that fast for at most this time [s]. After that the worst case is a device
that does not move, while its command moves at the actuators' rates."""
LAG_SHARE = 0.02
"""Share of the travel that is allowed for noise. A device that is nearer than this to its command
counts as being at its command."""


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
            setpoints: Setpoints in the unit of each actuator's kind, shape (actuator_count,).
            now: Time of the command [s].
        """

    def read(self, now: float) -> DeviceReading:
        """Measures at a time [s] that never decreases."""


@runtime_checkable
class CarriedDevice(Protocol):
    """A robot whose guided bodies are moved by something else, such as an arm that carries it.

    A device that accepts poses implements this in addition to `Device`.
    """

    guided_names: tuple[str, ...]
    rigid_names: tuple[str, ...]

    def apply_pose(
        self, name: str, position: np.ndarray, quaternion: np.ndarray, now: float
    ) -> None:
        """Takes the newest pose of a guided body at a time [s]: position [m], (x, y, z, w)."""

    def rigid_poses(self) -> tuple[np.ndarray, np.ndarray]:
        """Poses of the rigid bodies.

        Returns:
            Positions [m], shape (rigid_body_count, 3), and quaternions (x, y, z, w), shape
            (rigid_body_count, 4); NaN where the robot cannot measure them.
        """


class ImplausibleSetpoint(NamedTuple):
    """A measured setpoint that an actuator of the scene cannot have.

    Attributes:
        name: The actuator.
        value: The measured setpoint [m].
        low: Least accepted setpoint [m].
        high: Greatest accepted setpoint [m].
    """

    name: str
    value: float
    low: float
    high: float

    def __str__(self) -> str:
        return (
            f"{self.name} measures {self.value:.6g} m, accepted are {self.low:.6g} to "
            f"{self.high:.6g} m"
        )


class MeasuredSetpoints(ActuatorInput):
    """Keeps the newest setpoints of a device; refuses those that no actuator of the scene can have.

    Accepted is the range of the limits, extended by a tenth of the travel or a hundredth of the
    setpoint at rest, because the zero of an encoder is never exact. The length of a cable cannot be
    negative.

    Args:
        actuator_names: Names of the actuators.
        rest_setpoints: Setpoints at rest, in the unit of each actuator's kind, shape
            (actuator_count,).
        limits: Limits of the displacements.
        by_position: Names of the actuators that take no efforts, such as slides.
        settings: Timeouts.

    Attributes:
        implausible: The setpoint for which the newest message was refused; else None.
    """

    def __init__(
        self, actuator_names: Sequence[str], rest_setpoints: np.ndarray, limits: ActuatorLimits,
        by_position: Sequence[str], settings: LoopSettings,
    ):
        names = ActuatorNames(actuator_names, by_position=by_position)
        travel = limits.displacement_max - limits.displacement_min
        known = np.where(np.isfinite(travel), travel, 0.0)
        beyond = np.maximum(OUTSIDE_SHARE * known, OUTSIDE_SHARE_OF_REST * np.abs(rest_setpoints))
        low, high = limits.setpoint_range(rest_setpoints)
        self._low = np.where(names.by_position, low - beyond, np.maximum(low - beyond, 0.0))
        self._high = high + beyond
        self._actuator_names = tuple(actuator_names)
        super().__init__(names, settings)

    def reset(self) -> None:
        """Forgets what was received; the counts stay."""
        super().reset()
        self.implausible: ImplausibleSetpoint | None = None

    def accept(self, names: Sequence[str], setpoints, efforts, arrival) -> Refusal | None:
        """Checks one message and keeps it; see `ActuatorInput.accept`."""
        self.implausible = None
        return super().accept(names, setpoints, efforts, arrival)

    @property
    def arrived(self) -> float:
        """Time of arrival of the newest setpoints [s]; minus infinity before the first."""
        return self._newest

    def _refusal_of_values(
        self, order: NameOrder, count: int, setpoints: np.ndarray, efforts: np.ndarray
    ) -> Refusal | None:
        refusal = super()._refusal_of_values(order, count, setpoints, efforts)
        if refusal is not None or not len(setpoints):
            return refusal
        measured = order.values(setpoints) + order.offsets
        wrong = np.flatnonzero((measured < self._low) | (measured > self._high))
        if not len(wrong):
            return None
        place = int(wrong[0])
        self.implausible = ImplausibleSetpoint(
            self._actuator_names[place], float(measured[place]), float(self._low[place]),
            float(self._high[place]),
        )  # fmt: skip
        return Refusal.OUT_OF_RANGE


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
        # A cable may be allowed to lengthen without limit; its shortening always has a limit.
        least = np.where(np.isfinite(limits.displacement_min), limits.displacement_min, 0.0)
        travel = limits.displacement_max - least
        self._noise = LAG_SHARE * np.where(np.isfinite(travel), travel, np.inf)
        self.forget()

    def forget(self) -> None:
        """Forgets all measurements, as before a resynchronisation."""
        self._was_lost = False
        self._arrived = -np.inf
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
        lag = np.abs(device.setpoints - commanded)
        before, since = self._lag, device.arrived - self._arrived
        if self._was_lost:
            self._was_lost = False
            self.is_on_the_way = self._is_between(device.setpoints, commanded)
            self._lag, self._arrived = lag, device.arrived
            self._measured = device.setpoints
            return bool((lag > np.minimum(reach, self._noise)).any())
        if since <= 0.0:
            return False
        self._lag, self._arrived = lag, device.arrived
        self._measured, self.is_on_the_way = device.setpoints, False
        if before is None:
            return False
        allowed = self._rate * max(LAG_RATE * min(since, LAG_TIME), since) + self._noise
        return bool((lag - before > allowed).any())

    def _is_between(self, setpoints: np.ndarray, commanded: np.ndarray) -> bool:
        """True for setpoints between the last measured ones and the command."""
        if self._measured is None:
            return False
        low = np.minimum(self._measured, commanded) - self._noise
        high = np.maximum(self._measured, commanded) + self._noise
        return bool(((setpoints >= low) & (setpoints <= high)).all())
