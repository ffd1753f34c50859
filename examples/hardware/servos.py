"""Servos that wind the cables of a robot or turn its hinges, as a device of a twin: units and safety."""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
from device_file import DeviceFileError, checked, read_entries
from servo_bus import BusError, HardwareAlert, Port, SerialPort, ServoBus

from softrobot_twin.control.device import DeviceReading

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


class Servo(NamedTuple):
    """A servo, and what it moves: a cable that its pulley winds, or a hinge.

    Setpoints are lengths of the cable [m], from the pull point to the robot's last hold point as the
    twin counts it, or angles of the hinge [rad], and efforts tensions [N] or torques [N m].

    Attributes:
        name: Name of the cable or of the hinge motor in the scene.
        id: Id on the bus.
        direction: 1 where more ticks wind the cable up, or turn the hinge to greater angles, else -1.
        zero_ticks: Ticks at which the setpoint is `zero`.
        zero: That setpoint.
        least: Least setpoint to which the servo may go.
        greatest: Greatest one.
        radius: Radius of the pulley with the cable on it [m]; None for a hinge.
    """

    name: str
    id: int
    direction: int
    zero_ticks: int
    zero: float
    least: float
    greatest: float
    radius: float | None = None

    @property
    def unit(self) -> str:
        """Unit of its setpoints."""
        return "rad" if self.radius is None else "m"

    @property
    def by_tick(self) -> float:
        """Change of the setpoint by one tick; negative where more ticks wind a cable up."""
        arm = 1.0 if self.radius is None else -self.radius
        return self.direction * arm * 2.0 * math.pi / TICKS_PER_TURN

    def setpoint(self, ticks: float) -> float:
        """The setpoint at some ticks."""
        return self.zero + (ticks - self.zero_ticks) * self.by_tick

    def ticks(self, setpoint: float) -> int:
        """Nearest ticks for a setpoint."""
        return self.zero_ticks + round((setpoint - self.zero) / self.by_tick)

    def effort(self, current: int, torque_constant: float) -> float:
        """Tension or torque, without the friction of the gears.

        Args:
            current: As the servo states it, positive where it turns towards more ticks.
            torque_constant: Torque by current of the servo [N m/A].
        """
        torque = self.direction * current * AMPERES_PER_UNIT * torque_constant
        return torque if self.radius is None else max(0.0, torque / self.radius)

    def strains(self, effort: float, goal: float, measured: float) -> bool:
        """Whether a goal asks for more of an effort, by a tick or further."""
        growing = math.copysign(1.0, effort) if self.radius is None else -1.0
        return growing * (goal - measured) > abs(self.by_tick)


class ServosFile(NamedTuple):
    """What a file says about servos.

    Attributes:
        servos: The servos.
        port: File of the serial port.
        baud_rate: Bits per second.
        mode: ``position``: one turn; or ``extended_position``: many turns.
        torque_constant: Torque by current [N m/A].
        greatest_tension: Above this tension of a cable the servos stop [N]; infinite without cables.
        greatest_torque: The same of the torque on a hinge [N m].
        largest_jump: A command further than this from the measured length is refused [m].
        largest_turn: The same of angles [rad].
        command_timeout: After this time without a command the servos stop [s].
        answer_time: Longest time until servos and the adapter of the bus answer, besides that of
            the bytes [s].
    """

    servos: tuple[Servo, ...]
    port: str
    baud_rate: int
    mode: str
    torque_constant: float
    command_timeout: float
    answer_time: float
    greatest_tension: float = math.inf
    largest_jump: float = math.inf
    greatest_torque: float = math.inf
    largest_turn: float = math.inf

    def greatest_effort(self, servo: Servo) -> float:
        """Above it the servos stop, in the unit of the servo's effort."""
        return self.greatest_torque if servo.radius is None else self.greatest_tension

    def largest_move(self, servo: Servo) -> float:
        """Commands that are further away are refused, in the unit of the servo's setpoint."""
        return self.largest_turn if servo.radius is None else self.largest_jump


def read_servos(file: Path | str) -> ServosFile:
    """Reads the description of servos.

    Raises:
        DeviceFileError: The file cannot be read, or a value is missing, unknown or out of range.
    """
    file = Path(file)
    given, entries = read_entries(file, "servos", "servo")
    common = {"port": (str, "", 0, 0), "baud_rate": (int, "bit/s", 1, 1e8), "mode": (str, "", 0, 0),
              "torque_constant": (float, "N m/A", 1e-6, 1e3),
              "command_timeout": (float, "s", 0.02, 2.54),
              "answer_time": (float, "s", 1e-4, 1.0)}  # fmt: skip
    of_pulleys = {"greatest_tension": (float, "N", 1e-6, 1e5), "largest_jump": (float, "m", 1e-6, 10.0)}
    of_hinges = {"greatest_torque": (float, "N m", 1e-6, 1e3), "largest_turn": (float, "rad", 1e-6, 10.0)}
    winds = ["radius" in entry for entry in entries if isinstance(entry, dict)]
    common |= of_pulleys if any(winds) else {}
    common |= {} if all(winds) else of_hinges
    values = checked(file, "", given, common)
    if values["mode"] not in _MODES:
        raise DeviceFileError(file, "mode", values["mode"], "", f"must be one of {list(_MODES)}")
    servos = tuple(_servo(file, f"servos[{index}].", entry) for index, entry in enumerate(entries))
    for index, servo in enumerate(servos):
        _check_servo(file, f"servos[{index}].", servo, servos[:index], values["mode"])
    return ServosFile(servos=servos, **values)


def _servo(file: Path, where: str, entry: object) -> Servo:
    """The servo of an entry: one with a radius winds a cable, others turn hinges."""
    winds = isinstance(entry, dict) and "radius" in entry
    word, unit, low = ("length", "m", 0.0) if winds else ("angle", "rad", -1e3)
    own = {"name": (str, "", 0, 0), "id": (int, "", 0, 252), "direction": (int, "", -1, 1),
           "zero_ticks": (int, "ticks", -(2**31), 2**31 - 1)}  # fmt: skip
    places = ("zero", "least", "greatest")
    own |= {f"{place}_{word}": (float, unit, low, 1e3) for place in places}
    own |= {"radius": (float, "m", 1e-5, 1.0)} if winds else {}
    values = checked(file, where, entry, own)
    for place in places:
        values[place] = values.pop(f"{place}_{word}")
    return Servo(**values)


def _check_servo(
    file: Path, where: str, servo: Servo, before: tuple[Servo, ...], mode: str
) -> None:
    if servo.direction == 0:
        raise DeviceFileError(file, f"{where}direction", 0, "", "must be 1 or -1")
    for key in ("name", "id"):
        if getattr(servo, key) in [getattr(other, key) for other in before]:
            raise DeviceFileError(file, f"{where}{key}", getattr(servo, key), "", "is used twice")
    word = "angle" if servo.radius is None else "length"
    if not servo.least < servo.greatest:
        raise DeviceFileError(file, f"{where}least_{word}", servo.least, servo.unit,
                          f"must be below greatest_{word}")  # fmt: skip
    ends = servo.ticks(servo.least), servo.ticks(servo.greatest)
    least, most = (0, TICKS_PER_TURN - 1) if mode == "position" else (-(2**20) + 1, 2**20 - 1)
    if min(ends) < least or max(ends) > most:
        raise DeviceFileError(file, f"{where}least_{word}", servo.least, servo.unit,
                          f"the {word}s need the ticks {min(ends)} to {max(ends)}; in mode {mode} "
                          f"a servo has {least} to {most}")  # fmt: skip


class ServoDevice:
    """Servos as a `softrobot_twin.control.device.Device`.

    Safety: the torque is off until the first command, and after `close`. A command is refused that
    is further from what is measured than `largest_jump` or `largest_turn`, or not within the limits of
    a servo: then no servo moves. Without a command for `command_timeout`, and above `greatest_tension`
    or `greatest_torque`, the servos stop where they are; the next command moves them on. The servos' own watchdog stops them
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
    recovered = "the servos answer again; their torque is off until a command"

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
        self._measured: np.ndarray | None = None
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
        """Takes the newest command: lengths [m] and angles [rad]; it is sent with the next measurement.
        """
        wanted = np.asarray(setpoints, float)
        if reason := self._why_refused(wanted):
            self.refused += 1
            self.trouble = reason
            return
        self._goal, self._commanded, self._is_stopped, self.trouble = wanted.copy(), now, False, ""

    def _why_refused(self, setpoints: np.ndarray) -> str:
        if self._measured is None:
            return "command refused: nothing was measured yet"
        for servo, wanted, measured in zip(self._servos.values(), setpoints, self._measured,
                                           strict=True):  # fmt: skip
            unit, most = servo.unit, self.description.largest_move(servo)
            if not servo.least <= wanted <= servo.greatest:
                return (f"command refused: {servo.name} {wanted:.4f} {unit} is not within "
                        f"{servo.least:g} to {servo.greatest:g} {unit}")  # fmt: skip
            # Written so that a NaN is refused too.
            if not abs(wanted - measured) <= most:
                return (f"command refused: {servo.name} would jump from {measured:.4f} to "
                        f"{wanted:.4f} {unit}, more than {most:g} {unit}")  # fmt: skip
        return ""

    def read(self, now: float) -> DeviceReading:
        """Measures, and sends the newest command.

        Raises:
            BusError: A servo does not answer, or reports an error of its hardware. The servos'
                watchdog stops them if this goes on.
        """
        answers = self.bus.sync_read(list(self._servos), PRESENT_CURRENT, 10)
        setpoints, efforts = np.empty(len(answers)), np.empty(len(answers))
        for index, (servo, content) in enumerate(
            zip(self._servos.values(), answers.values(), strict=True)
        ):
            current = int.from_bytes(content[:2], "little", signed=True)
            ticks = int.from_bytes(content[6:], "little", signed=True)
            setpoints[index] = servo.setpoint(ticks)
            efforts[index] = servo.effort(current, self.description.torque_constant)
        self._measured = setpoints
        self._drive(now, efforts)
        return DeviceReading(setpoints, efforts, np.empty(0, np.uint32), np.empty((0, 3)),
                             np.empty((0, 3)))  # fmt: skip

    def _drive(self, now: float, efforts: np.ndarray) -> None:
        """Sends the goal, or stops the servos where they are."""
        if self._goal is None:
            return
        if now - self._commanded > self.description.command_timeout:
            self._stop("no command arrives: the servos stand still")
        for servo, effort, goal, measured in zip(self._servos.values(), efforts, self._goal,
                                                 self._measured, strict=True):  # fmt: skip
            greatest = self.description.greatest_effort(servo)
            # Going further is what must not be; the next command may go back.
            if abs(effort) > greatest and servo.strains(effort, goal, measured):
                verb, unit = ("turns by", "N m") if servo.radius is None else ("pulls", "N")
                self._stop(f"{servo.name} {verb} {effort:.3g} {unit}, more than {greatest:g} {unit}: "
                           "the servos stand still")  # fmt: skip
                break
        if not self._torque:
            self._switch_on()
        self._send(self._goal)

    def _stop(self, reason: str) -> None:
        """Makes what is measured the goal, once."""
        if not self._is_stopped:
            least, greatest = zip(*((one.least, one.greatest) for one in self._servos.values()), strict=True)
            self._goal = np.clip(self._measured, least, greatest)
            self._is_stopped, self.trouble = True, reason

    def _switch_on(self) -> None:
        """Switches the torque on; the goal is where the servos are, so nothing moves by that."""
        self._send(self._measured)
        time_out = max(1, min(127, round(self.description.command_timeout / WATCHDOG_UNIT)))
        for servo in self._servos:
            self.bus.write(servo, TORQUE_ENABLE, b"\1")
            self.bus.write(servo, WATCHDOG, bytes([time_out]))
        self._torque = True

    def _send(self, setpoints: np.ndarray) -> None:
        self.bus.sync_write(GOAL_POSITION, {
            servo.id: servo.ticks(wanted).to_bytes(4, "little", signed=True)
            for servo, wanted in zip(self._servos.values(), setpoints, strict=True)
        })  # fmt: skip

    def recover(self) -> None:
        """After an error of the bus: the torque counts as off, until the next command.

        A servo whose watchdog acted follows no goal until the watchdog is cleared.

        Raises:
            BusError: A servo still does not answer.
        """
        self._goal, self._measured, self._torque = None, None, False
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
