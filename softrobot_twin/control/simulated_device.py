"""A simulated robot in place of hardware: delay, servos with a rate, valves, noise, and a finger."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from softrobot_twin.control.cavity_pressures import STANDARD_ATMOSPHERE
from softrobot_twin.control.device import DeviceReading
from softrobot_twin.control.inputs import refusal_of_pose
from softrobot_twin.control.loop_settings import check_numbers, setting
from softrobot_twin.errors import ParameterError
from softrobot_twin.simulation import (
    CommandEfforts,
    CommandSetpoints,
    Hold,
    Simulation,
    StepResult,
    Touched,
)
from softrobot_twin.simulation.appearance import Pose
from softrobot_twin.simulation.building.limits import efforts_at_scale
from softrobot_twin.simulation.effects.touches import TouchState

_QUEUE_LENGTH = 1024
_NOTICEABLE_SHARE = 1.0e-3
"""A change of pressure, as a share of its scale, over which a compliance is measured."""
PAUSE = 0.5
"""Share of a period in which the fingertip does not touch the robot."""


@dataclass(frozen=True)
class DeviceFlaws:
    """How a simulated robot differs from a perfect one, in addition to its own scene.

    Attributes:
        delay: Time from the arrival of a command to its effect [s].
        servo_rate: Greatest rate of the servos of cables and slides [m/s].
        marker_noise: Standard deviation of each measured coordinate [m].
        seed: Seed of the noise.
        valve_lag: Time constant of the pressure regulators [s]; 0 for none.
        flow_limit: Greatest flow into and out of a cavity, as volume at ambient pressure [m³/s]; of
            a cavity whose volume is commanded, the greatest speed of its syringe [m³/s].
        leak: Flow out of a cavity with a regulator, as volume at ambient pressure, by its gauge
            pressure [m³/(s Pa)].
        pressure_noise: Standard deviation of each measured pressure [Pa].
        angle_rate: Greatest rate of the motors of hinges [rad/s].
        angle_noise: Standard deviation of each of their measured angles [rad].
        backlash: Angle by which such a motor turns back before what it drives follows [rad].

    Raises:
        ParameterError: A value is negative or not finite, or a rate or the flow limit is zero.
    """

    delay: float = setting("Time from a command's arrival to its effect.", 0.0, "s", 0.0, 10.0)
    servo_rate: float = setting("Greatest speed of the servos of cables and slides.", 0.1, "m/s", 1e-6, 10.0)
    marker_noise: float = setting("Standard deviation of each measured coordinate.", 0.0, "m", 0.0, 1.0)
    seed: int = setting("Seed of the noise.", 0, "", 0, 2**31 - 1)
    valve_lag: float = setting("Time constant of pressure regulators; 0 for none.", 0.0, "s", 0.0, 60.0)
    flow_limit: float = setting("Greatest flow at ambient pressure, or speed of a syringe.",
                                2.0e-4, "m³/s", 1e-12, 10.0)
    leak: float = setting("Flow out at ambient pressure, by gauge pressure.", 0.0, "m³/(s Pa)", 0.0, 1.0)
    pressure_noise: float = setting("Standard deviation of each measured pressure.", 0.0, "Pa", 0.0, 1e6)
    angle_rate: float = setting("Greatest speed of the motors of hinges.", 6.0, "rad/s", 1e-6, 1000.0)
    angle_noise: float = setting("Standard deviation of each of their measured angles.", 0.0, "rad", 0.0, 1.0)
    backlash: float = setting("Angle that a motor turns back before the beam follows.", 0.0, "rad", 0.0, 1.0)

    def __post_init__(self) -> None:
        check_numbers(self, "device_")


class Valves:
    """The pneumatics of a simulated robot: regulators, syringes and pressure sensors.

    A regulator follows its command with a first-order lag, τ dp/dt = p_commanded - p, as fast as
    the flow through it allows. The gas in a cavity, measured by the product of absolute pressure p
    and volume V, changes at constant temperature by

        d(p V)/dt = (V + p C) dp/dt,  |d(p V)/dt| ≤ p_ambient Q,

    with the flow limit Q at ambient pressure and the compliance C = dV/dp of the cavity, so that a
    soft cavity fills far more slowly than a rigid one. C is measured while the cavity moves; where
    other actuators change its volume meanwhile, it is at least that at rest.

    A leak lets gas out, p_ambient G (p - p_ambient) of the same product: the pressure falls with a time
    T = (V + p C) / (p_ambient G), against which a regulator with a lag keeps T / (T + τ) of what is
    commanded, and one at its limit of flow Q no more than Q / G.

    Args:
        simulation: The body, at rest and warmed up.
        flaws: Lag, flow limit, leak and noise.
        ambient_pressure: Absolute pressure around the robot [Pa].

    Attributes:
        cavities: Indices of the cavities among the actuators, shape (cavity_count,).
        by_pressure: True for the actuators whose pressure is commanded, shape (actuator_count,).
    """

    def __init__(self, simulation: Simulation, flaws: DeviceFlaws, ambient_pressure: float):
        actuators = simulation.actuators
        self.cavities = np.arange(actuators.count)[actuators.of_section("cavities")]
        is_cavity = np.zeros(actuators.count, bool)
        is_cavity[self.cavities] = True
        self.by_pressure = is_cavity & actuators.is_effort_driven
        self._actuators = actuators
        self._zeros = np.where(self.by_pressure, actuators.rest_setpoints, 0.0)
        self._by_volume = is_cavity & ~actuators.is_effort_driven
        is_angle = np.array([kind.setpoint.unit == "rad" for kind in actuators.kinds], bool)
        self._servo_rates = np.where(is_angle, flaws.angle_rate, flaws.servo_rate)
        self._flaws, self._ambient = flaws, ambient_pressure
        self._rest_volumes = actuators.displacement_scale[self.by_pressure]
        self._noticeable = _NOTICEABLE_SHARE * actuators.effort_scale[self.by_pressure]
        self._volumes, self._seen_volumes = self._rest_volumes, self._rest_volumes
        self._seen_pressures = np.zeros(len(self._rest_volumes))
        self._compliances = self._least_compliances = self._at_rest(simulation)

    def _at_rest(self, simulation: Simulation) -> np.ndarray:
        """Compliances at rest [m³/Pa], 0 where bodies move in time, shape (regulator_count,)."""
        found = np.zeros(simulation.actuators.count)
        for group in simulation.actuators.groups:
            if group.kind.section == "cavities":
                doubling = efforts_at_scale(simulation.model, group.term)
                simulation.restore(simulation.state)
                if doubling is not None:
                    found[self.cavities] = group.displacement_scale / doubling
        return np.maximum(found[self.by_pressure], 0.0)

    def aims(self, commanded: np.ndarray, present: np.ndarray, time_step: float) -> np.ndarray:
        """Setpoints that the lag allows after a time [s], each shape (actuator_count,).

        Args:
            commanded: Commanded setpoints, in the actuators' units, shape (actuator_count,).
            present: Present ones, same shape.
            time_step: The time [s].
        """
        lag = self._flaws.valve_lag
        if lag == 0.0:
            return commanded
        leaks = 1.0 + lag * self._leak_rates(present)
        share = 1.0 - np.exp(-time_step * leaks / lag)
        aim = self._zeros + (commanded - self._zeros) / leaks
        return np.where(self.by_pressure, present + share * (aim - present), commanded)

    def _pressures(self, present: np.ndarray) -> np.ndarray:
        """True gauge pressures of the regulators at setpoints [Pa], shape (regulator_count,)."""
        return self._actuators.drives(present)[self.by_pressure]

    def _leak_rates(self, present: np.ndarray) -> np.ndarray:
        """Share of each gauge pressure that leaks in a second [1/s], shape (actuator_count,)."""
        rates = np.zeros(len(present))
        if self._flaws.leak == 0.0:
            return rates
        absolute = self._ambient + self._pressures(present)
        rates[self.by_pressure] = (
            self._ambient * self._flaws.leak / (self._volumes + absolute * self._compliances)
        )
        return rates

    def leaked(self, present: np.ndarray, time_step: float) -> np.ndarray:
        """What each setpoint loses by leaks in a time [s], shape (actuator_count,).

        Args:
            present: Setpoints, those of regulators gauge pressures [Pa], same shape.
            time_step: The time [s].
        """
        return np.minimum(time_step * self._leak_rates(present), 1.0) * (present - self._zeros)

    def reach(self, present: np.ndarray, time_step: float) -> np.ndarray:
        """Greatest move of each actuator in a time [s], shape (actuator_count,).

        Args:
            present: Setpoints, those of regulators gauge pressures [Pa], same shape.
            time_step: The time [s].
        """
        flow = self._flaws.flow_limit * time_step
        reach = np.where(self._by_volume, flow, self._servo_rates * time_step)
        pressures = self._ambient + self._pressures(present)
        gains = self._actuators.effort_gains[self.by_pressure]
        reach[self.by_pressure] = (
            self._ambient * flow / (self._volumes + pressures * self._compliances) / gains
        )
        return reach

    def observe(self, result: StepResult) -> None:
        """Takes the volumes after a step, and from them the compliances.

        Args:
            result: Result of the step.
        """
        pressures = self._pressures(result.setpoints)
        self._volumes = self._rest_volumes + result.displacements[self.by_pressure]
        change = pressures - self._seen_pressures
        is_seen = np.abs(change) > self._noticeable
        grown = self._volumes - self._seen_volumes
        slopes = np.divide(grown, change, out=np.zeros_like(grown), where=is_seen)
        slopes = np.maximum(slopes, self._least_compliances)
        self._compliances = np.where(is_seen, slopes, self._compliances)
        self._seen_volumes = np.where(is_seen, self._volumes, self._seen_volumes)
        self._seen_pressures = np.where(is_seen, pressures, self._seen_pressures)

    def measure(
        self, setpoints: np.ndarray, efforts: np.ndarray, noise: np.random.Generator
    ) -> tuple[np.ndarray, np.ndarray]:
        """What encoders and pressure sensors say; a sensor never says less than a vacuum.

        Args:
            setpoints: Setpoints where the actuators are, shape (actuator_count,).
            efforts: True efforts, same shape.
            noise: Its source.

        Returns:
            Measured setpoints and efforts, each of that shape.
        """
        efforts = np.where(self.by_pressure, setpoints, self._actuators.told_efforts(efforts))
        if len(self.cavities):
            errors = noise.normal(0.0, self._flaws.pressure_noise, len(self.cavities))
            pressures = np.maximum(efforts[self.cavities] + errors, -self._ambient)
            efforts[self.cavities] = pressures
        return np.where(self.by_pressure, efforts, setpoints), efforts


@dataclass(frozen=True)
class Presses:
    """How a fingertip presses.

    Attributes:
        touch: Name of the scene's touch.
        depth: Greatest displacement of the touched point [m].
        period: Time from press to press [s].
        direction: Direction of the press, of any length but zero.

    Raises:
        ParameterError: The depth or the period is not above zero, or the direction is zero.
    """

    touch: str
    depth: float = setting("Depth of a press.", 0.001, "m", 1e-9, 1.0)
    period: float = setting("Time from press to press; a press takes half.", 2.0, "s", 0.01, 3600.0)
    direction: tuple[float, float, float] = setting("Direction of a press.", (0.0, 0.0, -1.0))

    def __post_init__(self) -> None:
        check_numbers(self, "device_touch_")
        if len(self.direction) != 3 or not np.isfinite(self.direction).all() or not any(self.direction):
            raise ParameterError(
                "device_touch_direction", self.direction, "", "must be three numbers, not all zero"
            )


class Fingertip:
    """Moves the touched point of a robot along a line and back, then lets go for a while.

    It rests on the point when a press begins, wherever the actuators have brought the point. It only
    pushes: when the robot would have to be pulled, it has left the robot, and waits for its next press.

    Args:
        simulation: The robot's body.
        presses: How it presses.

    Raises:
        ParameterError: The scene has no such touch.
    """

    def __init__(self, simulation: Simulation, presses: Presses):
        names = simulation.touch_names
        if presses.touch not in names:
            raise ParameterError(
                "device_touch", presses.touch, "",
                f"must be a touch of the device's scene: {', '.join(names) or 'it has none'}",
            )
        self._simulation, self._presses = simulation, presses
        self._index = names.index(presses.touch)
        direction = np.array(presses.direction, float)
        self._direction = direction / np.linalg.norm(direction)
        self._origin: np.ndarray | None = None
        self._has_left = False

    def touched(self, now: float) -> Touched | None:
        """Where the fingertip holds the point at a time [s]; None while it does not touch.

        Args:
            now: Time on the monotonic clock [s].
        """
        share = now / self._presses.period % 1.0
        if share < PAUSE:
            self._origin, self._has_left = None, False
            return None
        if self._has_left:
            return None
        if self._origin is None:
            self._origin = np.array(self._simulation.touches.points[self._index])
        course = (share - PAUSE) / (1.0 - PAUSE)
        depth = 0.5 * self._presses.depth * (1.0 - np.cos(2.0 * np.pi * course))
        touched = Touched.none(len(self._simulation.touch_names))
        touched.places[self._index] = self._origin + depth * self._direction
        return touched

    def observe(self, result: StepResult) -> None:
        """Lets go where a step's force pulls at the robot.

        Args:
            result: Result of the step.
        """
        if self._origin is not None and not self._has_left:
            self._has_left = bool(result.touches.forces[self._index] @ self._direction < 0.0)


class SimulatedDevice:
    """Follows commanded setpoints with delayed, limited servos and valves on a simulated body.

    Args:
        simulation: The body, warmed up; its scene may differ from the twin's.
        flaws: Delay, limits of servos and valves, and noise.
        ambient_pressure: Absolute pressure around the robot [Pa].
        presses: How a fingertip presses it; None without one.
        follows: ``setpoints``, or ``efforts``: winches and regulators that hold what is commanded, from
            zero on, however fast it changes.

    Attributes:
        touch_names: Names of the touches; see `TouchedDevice`. Empty without a fingertip.
        cavity_names: Names of the cavities; see `PressurisedDevice`.
        pulleys: Pulleys that wind cables; see `WoundDevice`.
        pressure_variance: Variance of their measured pressures [Pa²]; 0 without noise.
        refused: Commands that were not finite or had a wrong size; they have no effect.
        result: The last step of the body, or None before the first one.
        simulation: The body.
    """

    def __init__(
        self, simulation: Simulation, flaws: DeviceFlaws,
        ambient_pressure: float = STANDARD_ATMOSPHERE, presses: Presses | None = None,
        follows: str = "setpoints",
    ):
        self._fingertip = None if presses is None else Fingertip(simulation, presses)
        self.touch_names = () if presses is None else simulation.touch_names
        self.refused = 0
        self.result: StepResult | None = None
        self.actuator_names = simulation.actuator_names
        self.effector_names = simulation.effector_names
        self.guided_names, self.rigid_names = simulation.guided_names, simulation.rigid_names
        self.pulleys = simulation.pulleys
        self.simulation = simulation
        self._flaws = flaws
        self._valves = Valves(simulation, flaws, ambient_pressure)
        self.cavity_names = tuple(self.actuator_names[index] for index in self._valves.cavities)
        self.pressure_variance = flaws.pressure_noise**2
        self._noise = np.random.default_rng(flaws.seed)
        self._queue: deque[tuple[float, np.ndarray]] = deque(maxlen=_QUEUE_LENGTH)
        self._poses: deque[tuple[float, str, Pose]] = deque(maxlen=_QUEUE_LENGTH)
        self._servo = np.array(simulation.rest_setpoints)
        self._commanded, self._driven = self._servo.copy(), self._servo.copy()
        self._follows_efforts = follows == "efforts"
        if self._follows_efforts:
            self._check_efforts()
            self._commanded = np.zeros_like(self._servo)
        is_angle = np.array([kind.setpoint.unit == "rad" for kind in simulation.actuators.kinds], bool)
        self._angles, self._play = np.flatnonzero(is_angle), np.where(is_angle, 0.5 * flaws.backlash, 0.0)
        self._time: float | None = None

    def _check_efforts(self) -> None:
        """Refuses actuators that take no effort."""
        actuators = self.simulation.actuators
        for name, takes in zip(actuators.names, actuators.takes_efforts, strict=True):
            if not takes:
                raise ParameterError("device_follows", "efforts", "",
                                     f"{name} of the device's scene takes no effort")

    def apply(self, setpoints: np.ndarray, now: float) -> None:
        """Takes the newest command; see `Device`. The delay starts at this time."""
        setpoints = np.array(setpoints, dtype=float)
        if setpoints.shape != self._servo.shape or not np.isfinite(setpoints).all():
            self.refused += 1
            return
        self._queue.append((now + self._flaws.delay, setpoints))

    def apply_pose(self, name: str, position: np.ndarray, quaternion: np.ndarray, now: float) -> None:
        """Takes the newest pose of a guided body; see `CarriedDevice`. The delay starts now."""
        pose = Pose(np.array(position, dtype=float), np.array(quaternion, dtype=float))
        if name not in self.guided_names or refusal_of_pose(pose):
            self.refused += 1
            return
        self._poses.append((now + self._flaws.delay, name, pose))

    def rigid_poses(self) -> tuple[np.ndarray, np.ndarray]:
        """Poses of the rigid bodies; see `CarriedDevice`."""
        return self.simulation.rigid_poses()

    def touches(self) -> TouchState:
        """Forces and displacements of the touches; see `TouchedDevice`. Sensors are exact."""
        return self.simulation.touches

    def _step(self, command: CommandSetpoints | CommandEfforts | Hold, now: float) -> StepResult:
        """Steps the body, pressed by the fingertip as it is at a time [s]."""
        if self._fingertip is None:
            return self.simulation.step(command)
        result = self.simulation.step(command, None, self._fingertip.touched(now))
        self._fingertip.observe(result)
        return result

    def read(self, now: float) -> DeviceReading:
        """Advances servos, valves and body to a time [s], and measures them.

        Args:
            now: Time on the monotonic clock [s].
        """
        time_step = 0.0 if self._time is None else max(0.0, now - self._time)
        self._time = now
        while self._queue and self._queue[0][0] <= now:
            self._commanded = self._queue.popleft()[1]
        while self._poses and self._poses[0][0] <= now:
            _, name, pose = self._poses.popleft()
            self.simulation.model.guides.aim(name, pose.position, pose.quaternion)
        if time_step > 0.0 and self._follows_efforts:
            efforts = self.simulation.actuators.efforts(self._commanded)
            self.result = self._step(CommandEfforts(efforts, time_step), now)
            self._servo = np.array(self.result.setpoints)
        elif time_step > 0.0:
            reach = self._valves.reach(self._servo, time_step)
            aims = self._valves.aims(self._commanded, self._servo, time_step)
            leaked = self._valves.leaked(self._servo, time_step)
            self._servo += np.clip(aims - self._servo, -reach - leaked, reach - leaked)
            driven = np.clip(self._driven, self._servo - self._play, self._servo + self._play)
            self.result = self._step(CommandSetpoints(driven, time_step), now)
            # The encoder measures the actual position: limits of the body may stop a servo.
            self._driven = np.array(self.result.setpoints)
            self._servo = self._driven + (self._servo - driven)
            self._valves.observe(self.result)
        elif not self.simulation.model.is_dynamic:
            # When no time has passed, a body without inertia still moves to its equilibrium; a body
            # with inertia does not move.
            self.result = self._step(Hold(), now)
        markers = self.simulation.scene.marker_frame.of_cameras(self.simulation.marker_positions())
        noise = self._noise.normal(0.0, self._flaws.marker_noise, markers.shape)
        setpoints, efforts = self._valves.measure(
            self._servo.copy(), np.array(self.simulation.state.efforts), self._noise
        )
        if self._flaws.angle_noise:
            setpoints[self._angles] += self._noise.normal(0.0, self._flaws.angle_noise, len(self._angles))
        return DeviceReading(
            setpoints,
            efforts,
            self.simulation.marker_ids,
            markers + noise,
            self.simulation.effector_positions(),
        )
