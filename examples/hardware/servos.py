"""Servos with pulleys that wind the cables of a robot, as a device of a twin: units and safety."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
import yaml
from servo_bus import BusError, HardwareAlert, Port, SerialPort, ServoBus

from softrobot_twin.control.device import DeviceReading
from softrobot_twin.errors import SoftRobotTwinError

TICKS_PER_TURN = 4096
AMPERES_PER_UNIT = 2.69e-3
"""Unit of currents in the servos' tables [A]."""
WATCHDOG_UNIT = 0.02
"""Unit of the servos' bus watchdog [s]."""

# Places in the table of a servo of the X series.
OPERATING_MODE, TORQUE_ENABLE, HARDWARE_ERROR, WATCHDOG = 11, 64, 70, 98
GOAL_POSITION, PRESENT_CURRENT, PRESENT_POSITION = 116, 126, 132
_MODES = {"position": 3, "extended_position": 4}
_TRIES = 3


class ServosError(SoftRobotTwinError):
    """A file that describes servos cannot be used.

    Attributes:
        file: The file.
        key: The key in it.
        value: Its value.
        unit: Its unit.
    """

    def __init__(self, file: Path, key: str, value: object, unit: str, reason: str):
        self.file, self.key, self.value, self.unit = file, key, value, unit
        shown = f"{key} = {value!r} {unit}".rstrip() + ": " if key else ""
        super().__init__(f"{file}: {shown}{reason}")


class Servo(NamedTuple):
    """A servo, and the cable that its pulley winds.

    Attributes:
        name: Name of the cable in the scene.
        id: Id on the bus.
        radius: Radius of the pulley with the cable on it [m].
        direction: 1 where more ticks wind the cable up, -1 where fewer do.
        zero_ticks: Ticks at which the cable has the length `zero_length`.
        zero_length: That length, from the pull point to the robot's last hold point as the twin
            counts it [m].
        least_length: Least length to which the servo may wind [m].
        greatest_length: Greatest length to which it may unwind [m].
    """

    name: str
    id: int
    radius: float
    direction: int
    zero_ticks: int
    zero_length: float
    least_length: float
    greatest_length: float

    @property
    def length_per_tick(self) -> float:
        """Change of the length by one tick [m]; negative where more ticks wind up."""
        return -self.direction * self.radius * 2.0 * math.pi / TICKS_PER_TURN

    def length(self, ticks: float) -> float:
        """Length of the cable [m] at some ticks."""
        return self.zero_length + (ticks - self.zero_ticks) * self.length_per_tick

    def ticks(self, length: float) -> int:
        """Nearest ticks for a length [m]."""
        return self.zero_ticks + round((length - self.zero_length) / self.length_per_tick)

    def tension(self, current: int, torque_constant: float) -> float:
        """Tension of the cable [N], without the friction of the gears.

        Args:
            current: As the servo states it, positive where it turns towards more ticks.
            torque_constant: Torque by current of the servo [N m/A].
        """
        torque = self.direction * current * AMPERES_PER_UNIT * torque_constant
        return max(0.0, torque / self.radius)


class ServosFile(NamedTuple):
    """What a file says about servos.

    Attributes:
        servos: The servos.
        port: File of the serial port.
        baud_rate: Bits per second.
        mode: ``position``: one turn; or ``extended_position``: many turns.
        torque_constant: Torque by current [N m/A].
        greatest_tension: Above this tension the servos stop [N].
        largest_jump: A command further than this from the measured length is refused [m].
        command_timeout: After this time without a command the servos stop [s].
        answer_time: Longest time until servos and the adapter of the bus answer, besides that of
            the bytes [s].
    """

    servos: tuple[Servo, ...]
    port: str
    baud_rate: int
    mode: str
    torque_constant: float
    greatest_tension: float
    largest_jump: float
    command_timeout: float
    answer_time: float


def read_servos(file: Path | str) -> ServosFile:
    """Reads the description of servos.

    Raises:
        ServosError: The file cannot be read, or a value is missing, unknown or out of range.
    """
    file = Path(file)
    try:
        given = yaml.safe_load(file.read_text())
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise ServosError(file, "", "", "", f"cannot be read: {error}") from error
    common = {"port": (str, "", 0, 0), "baud_rate": (int, "bit/s", 1, 1e8), "mode": (str, "", 0, 0),
              "torque_constant": (float, "N m/A", 1e-6, 1e3),
              "greatest_tension": (float, "N", 1e-6, 1e5),
              "largest_jump": (float, "m", 1e-6, 10.0),
              "command_timeout": (float, "s", 0.02, 2.54),
              "answer_time": (float, "s", 1e-4, 1.0)}  # fmt: skip
    own = {"name": (str, "", 0, 0), "id": (int, "", 0, 252), "radius": (float, "m", 1e-5, 1.0),
           "direction": (int, "", -1, 1), "zero_ticks": (int, "ticks", -(2**31), 2**31 - 1),
           "zero_length": (float, "m", 0.0, 1e3), "least_length": (float, "m", 0.0, 1e3),
           "greatest_length": (float, "m", 0.0, 1e3)}  # fmt: skip
    if not isinstance(given, dict) or not isinstance(given.get("servos"), list):
        raise ServosError(file, "servos", given and type(given).__name__, "", "must be a list")
    entries = given.pop("servos")
    values = _checked(file, "", given, common)
    if values["mode"] not in _MODES:
        raise ServosError(file, "mode", values["mode"], "", f"must be one of {list(_MODES)}")
    servos = tuple(Servo(**_checked(file, f"servos[{index}].", entry, own))
                   for index, entry in enumerate(entries))  # fmt: skip
    for index, servo in enumerate(servos):
        _check_servo(file, f"servos[{index}].", servo, servos[:index], values["mode"])
    if not servos:
        raise ServosError(file, "servos", [], "", "names no servo")
    return ServosFile(servos=servos, **values)


def _checked(file: Path, where: str, given: object, wanted: Mapping) -> dict[str, object]:
    """Values of a mapping, each with its type and in its range."""
    if not isinstance(given, dict):
        raise ServosError(file, where.rstrip("."), given, "", "must be keys with values")
    for key in given:
        if key not in wanted:
            raise ServosError(file, f"{where}{key}", given[key], "",
                              f"is unknown; known are {', '.join(wanted)}")  # fmt: skip
    values = {}
    for key, (kind, unit, low, high) in wanted.items():
        if key not in given:
            raise ServosError(file, f"{where}{key}", None, unit, "is missing")
        value = given[key]
        is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
        if kind is float and is_number:
            value = float(value)
        if type(value) is not kind:
            raise ServosError(file, f"{where}{key}", value, unit, f"must be a {kind.__name__}")
        if kind is not str and not low <= value <= high:
            raise ServosError(file, f"{where}{key}", value, unit, f"must be {low:g} to {high:g}")
        values[key] = value
    return values


def _check_servo(
    file: Path, where: str, servo: Servo, before: tuple[Servo, ...], mode: str
) -> None:
    if servo.direction == 0:
        raise ServosError(file, f"{where}direction", 0, "", "must be 1 or -1")
    for key in ("name", "id"):
        if getattr(servo, key) in [getattr(other, key) for other in before]:
            raise ServosError(file, f"{where}{key}", getattr(servo, key), "", "is used twice")
    if not servo.least_length < servo.greatest_length:
        raise ServosError(file, f"{where}least_length", servo.least_length, "m",
                          "must be below greatest_length")  # fmt: skip
    ends = servo.ticks(servo.least_length), servo.ticks(servo.greatest_length)
    least, most = (0, TICKS_PER_TURN - 1) if mode == "position" else (-(2**20) + 1, 2**20 - 1)
    if min(ends) < least or max(ends) > most:
        raise ServosError(file, f"{where}least_length", servo.least_length, "m",
                          f"the lengths need the ticks {min(ends)} to {max(ends)}; in mode {mode} "
                          f"a servo has {least} to {most}")  # fmt: skip


class ServoDevice:
    """Servos as a `softrobot_twin.control.device.Device`.

    Safety: the torque is off until the first command, and after `close`. A command is refused that
    is further from the measured length than `largest_jump`, or not within the lengths of a servo:
    then no servo moves. Without a command for `command_timeout`, and above `greatest_tension`, the
    servos stop where they are; the next command moves them on. The servos' own watchdog stops them
    if this process ends or hangs.

    Args:
        description: The servos.
        port: Where they are; None opens the serial port of the description.

    Attributes:
        description: The servos.
        bus: The bus that they are on.
        refused: Number of commands refused.
        trouble: Why the servos stand still, or why a command was refused; empty when they follow.

    Raises:
        BusError: A servo does not answer, or reports an error of its hardware.
    """

    effector_names: tuple[str, ...] = ()

    def __init__(self, description: ServosFile, port: Port | None = None):
        self.description = description
        self._servos = {servo.id: servo for servo in description.servos}
        self.actuator_names = tuple(servo.name for servo in description.servos)
        port = SerialPort(description.port, description.baud_rate) if port is None else port
        # An answer of 10 bytes has 21 on the bus, each of 10 bits.
        sent = 10.0 * (40 + 21 * len(self._servos)) / description.baud_rate
        self._port, self.bus = port, ServoBus(port, description.answer_time + sent)
        self._torque = self._is_stopped = self._is_closed = False
        self._goal: np.ndarray | None = None
        self._lengths: np.ndarray | None = None
        self._commanded = -math.inf
        self.refused, self.trouble = 0, ""
        try:
            for servo in self._servos:
                self._prepare(servo)
        except BusError:
            self.close()
            raise

    def _prepare(self, servo: int) -> None:
        """Switches the torque of a servo off and sets its mode."""
        self.bus.ping(servo)
        self.bus.write(servo, TORQUE_ENABLE, b"\0")
        if state := self.bus.read(servo, HARDWARE_ERROR, 1)[0]:
            raise HardwareAlert(servo, f"error of the hardware: {state:#04x}")
        self.bus.write(servo, OPERATING_MODE, bytes([_MODES[self.description.mode]]))

    def apply(self, setpoints: np.ndarray, now: float) -> None:
        """Takes the newest command: lengths [m]; it is sent with the next measurement."""
        lengths = np.asarray(setpoints, float)
        if reason := self._why_refused(lengths):
            self.refused += 1
            self.trouble = reason
            return
        self._goal, self._commanded, self._is_stopped, self.trouble = lengths.copy(), now, False, ""

    def _why_refused(self, lengths: np.ndarray) -> str:
        if self._lengths is None:
            return "command refused: nothing was measured yet"
        for servo, length, measured in zip(self._servos.values(), lengths, self._lengths,
                                           strict=True):  # fmt: skip
            if not servo.least_length <= length <= servo.greatest_length:
                return (f"command refused: {servo.name} {length:.4f} m is not within "
                        f"{servo.least_length:g} to {servo.greatest_length:g} m")  # fmt: skip
            # Written so that a NaN is refused too.
            if not abs(length - measured) <= self.description.largest_jump:
                most = self.description.largest_jump
                return (f"command refused: {servo.name} would jump from {measured:.4f} to "
                        f"{length:.4f} m, more than {most:g} m")  # fmt: skip
        return ""

    def read(self, now: float) -> DeviceReading:
        """Measures, and sends the newest command.

        Raises:
            BusError: A servo does not answer, or reports an error of its hardware. The servos'
                watchdog stops them if this goes on.
        """
        answers = self.bus.sync_read(list(self._servos), PRESENT_CURRENT, 10)
        lengths, tensions = np.empty(len(answers)), np.empty(len(answers))
        for index, (servo, content) in enumerate(
            zip(self._servos.values(), answers.values(), strict=True)
        ):
            current = int.from_bytes(content[:2], "little", signed=True)
            ticks = int.from_bytes(content[6:], "little", signed=True)
            lengths[index] = servo.length(ticks)
            tensions[index] = servo.tension(current, self.description.torque_constant)
        self._lengths = lengths
        self._drive(now, tensions)
        return DeviceReading(lengths, tensions, np.empty(0, np.uint32), np.empty((0, 3)),
                             np.empty((0, 3)))  # fmt: skip

    def _drive(self, now: float, tensions: np.ndarray) -> None:
        """Sends the goal, or stops the servos where they are."""
        if self._goal is None:
            return
        greatest = self.description.greatest_tension
        if now - self._commanded > self.description.command_timeout:
            self._stop("no command arrives: the servos stand still")
        elif tensions.max() > greatest:
            name = self.actuator_names[int(tensions.argmax())]
            # Winding up further is what must not be; the next command may unwind.
            ticks = np.array([abs(servo.length_per_tick) for servo in self._servos.values()])
            if (self._goal < self._lengths - ticks)[tensions > greatest].any():
                self._stop(f"{name} pulls {tensions.max():.1f} N, more than {greatest:g} N: the "
                           "servos stand still")  # fmt: skip
        if not self._torque:
            self._switch_on()
        self._send(self._goal)

    def _stop(self, reason: str) -> None:
        """Makes the present lengths the goal, once."""
        if not self._is_stopped:
            servos = self._servos.values()
            least = [servo.least_length for servo in servos]
            greatest = [servo.greatest_length for servo in servos]
            self._goal = np.clip(self._lengths, least, greatest)
            self._is_stopped, self.trouble = True, reason

    def _switch_on(self) -> None:
        """Switches the torque on; the goal is where the servos are, so nothing moves by that."""
        self._send(self._lengths)
        time_out = max(1, min(127, round(self.description.command_timeout / WATCHDOG_UNIT)))
        for servo in self._servos:
            self.bus.write(servo, TORQUE_ENABLE, b"\1")
            self.bus.write(servo, WATCHDOG, bytes([time_out]))
        self._torque = True

    def _send(self, lengths: np.ndarray) -> None:
        self.bus.sync_write(GOAL_POSITION, {
            servo.id: servo.ticks(length).to_bytes(4, "little", signed=True)
            for servo, length in zip(self._servos.values(), lengths, strict=True)
        })  # fmt: skip

    def recover(self) -> None:
        """After an error of the bus: the torque counts as off, until the next command.

        A servo whose watchdog acted follows no goal until the watchdog is cleared.

        Raises:
            BusError: A servo still does not answer.
        """
        self._goal, self._lengths, self._torque = None, None, False
        for servo in self._servos:
            self.bus.write(servo, TORQUE_ENABLE, b"\0")
            self.bus.write(servo, WATCHDOG, b"\0")

    def close(self) -> list[str]:
        """Switches the torque of all servos off, each tried several times, and closes the port.

        Returns:
            What went wrong: torques that may still be on.
        """
        problems: list[str] = []
        if self._is_closed:
            return problems
        self._is_closed = True
        for servo in self._servos:
            for left in reversed(range(_TRIES)):
                try:
                    self.bus.write(servo, TORQUE_ENABLE, b"\0")
                    break
                except HardwareAlert:
                    break  # it has obeyed, or has switched off by itself
                except BusError as error:
                    if not left:
                        problems.append(f"the torque may still be on: {error}")
        self._torque, self._goal = False, None
        self._port.close()
        return problems
