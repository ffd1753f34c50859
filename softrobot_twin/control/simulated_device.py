"""A simulated robot in place of hardware, with delay, rate-limited servos and marker noise."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from softrobot_twin.control.device import DeviceReading
from softrobot_twin.control.inputs import Pose, is_pose
from softrobot_twin.errors import ParameterError
from softrobot_twin.simulation import CommandSetpoints, Hold, Simulation, StepResult

_QUEUE_LENGTH = 1024


@dataclass(frozen=True)
class DeviceFlaws:
    """How a simulated robot differs from a perfect one, in addition to its own scene.

    Attributes:
        delay: Time from the arrival of a command to its effect [s].
        servo_rate: Greatest rate of the servos [m/s].
        marker_noise: Standard deviation of each measured coordinate [m].
        seed: Seed of the noise.

    Raises:
        ParameterError: A value is negative or not finite, or the servo rate is zero.
    """

    delay: float = 0.0
    servo_rate: float = 0.1
    marker_noise: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        for name, unit in (("delay", "s"), ("servo_rate", "m/s"), ("marker_noise", "m")):
            value = getattr(self, name)
            if not np.isfinite(value) or value < 0.0:
                raise ParameterError(
                    f"device_{name}", value, unit, "must be finite and not negative"
                )
        if self.servo_rate == 0.0:
            raise ParameterError("device_servo_rate", 0.0, "m/s", "must be above zero")


class SimulatedDevice:
    """Follows commanded setpoints with delayed, rate-limited servos on a simulated body.

    Args:
        simulation: The body, warmed up; its scene may differ from the twin's.
        flaws: Delay, servo rate and noise.

    Attributes:
        refused: Commands that were not finite or had a wrong size; they have no effect.
        result: The last step of the body, or None before the first one.
    """

    def __init__(self, simulation: Simulation, flaws: DeviceFlaws):
        self.refused = 0
        self.result: StepResult | None = None
        self.actuator_names = simulation.actuator_names
        self.effector_names = simulation.effector_names
        self.guided_names, self.rigid_names = simulation.guided_names, simulation.rigid_names
        self._simulation = simulation
        self._flaws = flaws
        self._noise = np.random.default_rng(flaws.seed)
        self._queue: deque[tuple[float, np.ndarray]] = deque(maxlen=_QUEUE_LENGTH)
        self._poses: deque[tuple[float, str, Pose]] = deque(maxlen=_QUEUE_LENGTH)
        self._servo = np.array(simulation.rest_setpoints)
        self._commanded = self._servo.copy()
        self._time: float | None = None

    def apply(self, setpoints: np.ndarray, now: float) -> None:
        """Takes the newest command; see `Device`. The delay starts at this time."""
        setpoints = np.array(setpoints, dtype=float)
        if setpoints.shape != self._servo.shape or not np.isfinite(setpoints).all():
            self.refused += 1
            return
        self._queue.append((now + self._flaws.delay, setpoints))

    def apply_pose(
        self, name: str, position: np.ndarray, quaternion: np.ndarray, now: float
    ) -> None:
        """Takes the newest pose of a guided body; see `CarriedDevice`. The delay starts now."""
        pose = Pose(np.array(position, dtype=float), np.array(quaternion, dtype=float))
        if name not in self.guided_names or not is_pose(pose):
            self.refused += 1
            return
        self._poses.append((now + self._flaws.delay, name, pose))

    def rigid_poses(self) -> tuple[np.ndarray, np.ndarray]:
        """Poses of the rigid bodies; see `CarriedDevice`."""
        return self._simulation.rigid_poses()

    def read(self, now: float) -> DeviceReading:
        """Advances servos and body to a time [s], and measures them."""
        time_step = 0.0 if self._time is None else max(0.0, now - self._time)
        self._time = now
        while self._queue and self._queue[0][0] <= now:
            self._commanded = self._queue.popleft()[1]
        while self._poses and self._poses[0][0] <= now:
            _, name, pose = self._poses.popleft()
            self._simulation.model.guides.aim(name, pose.position, pose.quaternion)
        if time_step > 0.0:
            reach = self._flaws.servo_rate * time_step
            self._servo += np.clip(self._commanded - self._servo, -reach, reach)
            self.result = self._simulation.step(CommandSetpoints(self._servo.copy(), time_step))
            # The encoder measures the actual position: limits of the body may stop a servo.
            self._servo = np.array(self.result.setpoints)
        elif not self._simulation.model.is_dynamic:
            # When no time has passed, a body without inertia still moves to its equilibrium; a body
            # with inertia does not move.
            self.result = self._simulation.step(Hold())
        markers = self._simulation.marker_positions()
        noise = self._noise.normal(0.0, self._flaws.marker_noise, markers.shape)
        return DeviceReading(
            self._servo.copy(),
            np.array(self._simulation.state.efforts),
            self._simulation.marker_ids,
            markers + noise,
            self._simulation.effector_positions(),
        )
