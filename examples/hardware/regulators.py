"""Proportional pressure regulators behind a module of analogue outputs and inputs, as a device of a twin.

A regulator such as SMC's ITV or Festo's VPPM takes its pressure as a voltage and states what it
measures as another one. Units, limits, and what is safe.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
from device_file import DeviceFileError, checked, read_entries
from modbus import ModbusTcp
from servo_bus import BusError, HardwareAlert

from softrobot_twin.control.device import DeviceReading

FULL_VOLTAGE = 10.0
"""Voltage of the module's greatest count [V]."""
LIVE_SHARE = 0.5
"""A monitor that states a voltage at no pressure is cut off below this share of it."""
_TRIES = 3


class Regulator(NamedTuple):
    """A regulator, and the cavity that it fills.

    Attributes:
        name: Name of the cavity in the scene.
        output: Register of its command.
        input: Register of its monitor.
        output_zero: Voltage that asks for no gauge pressure [V].
        output_full: Voltage that asks for `full_pressure` [V].
        input_zero: Voltage of its monitor at no gauge pressure [V].
        input_full: The same at `full_pressure` [V].
        full_pressure: Gauge pressure at full scale [Pa].
        least: Least gauge pressure that may be commanded [Pa].
        greatest: Greatest one [Pa].
    """

    name: str
    output: int
    input: int
    output_zero: float
    output_full: float
    input_zero: float
    input_full: float
    full_pressure: float
    least: float
    greatest: float

    def volts(self, pressure: float) -> float:
        """The voltage that asks for a gauge pressure."""
        share = pressure / self.full_pressure
        return self.output_zero + share * (self.output_full - self.output_zero)

    def pressure(self, volts: float) -> float:
        """The gauge pressure that a voltage of its monitor states."""
        return self.full_pressure * (volts - self.input_zero) / (self.input_full - self.input_zero)


class RegulatorsFile(NamedTuple):
    """What a file says about regulators.

    Attributes:
        regulators: The regulators.
        host: Name or address of the module.
        port: Its TCP port.
        unit: Its number behind a gateway.
        output_counts: Count of an output at 10 V.
        input_counts: Count of an input at 10 V.
        ramp: Greatest change of a pressure that is sent, in a second [Pa/s].
        overpressure: Above the greatest pressure of a cavity by so much, all are vented [Pa].
        command_timeout: After this time without a command all are vented [s].
        answer_time: Longest time until the module answers [s].
    """

    regulators: tuple[Regulator, ...]
    host: str
    port: int
    unit: int
    output_counts: int
    input_counts: int
    ramp: float
    overpressure: float
    command_timeout: float
    answer_time: float


def read_regulators(file: Path | str) -> RegulatorsFile:
    """Reads the description of regulators.

    Raises:
        DeviceFileError: The file cannot be read, or a value is missing, unknown or out of range.
    """
    file = Path(file)
    given, entries = read_entries(file, "regulators", "regulator")
    values = checked(file, "", given, {
        "host": (str, "", 0, 0), "port": (int, "", 1, 65535), "unit": (int, "", 0, 255),
        "output_counts": (int, "", 100, 65535), "input_counts": (int, "", 100, 65535),
        "ramp": (float, "Pa/s", 1.0, 1e9), "overpressure": (float, "Pa", 1.0, 1e7),
        "command_timeout": (float, "s", 0.02, 10.0), "answer_time": (float, "s", 1e-3, 1.0),
    })  # fmt: skip
    volts, pascals = (float, "V", 0.0, FULL_VOLTAGE), (float, "Pa", -1e5, 1e7)
    own = {"name": (str, "", 0, 0), "output": (int, "", 0, 65535), "input": (int, "", 0, 65535),
           "output_zero": volts, "output_full": volts, "input_zero": volts, "input_full": volts,
           "full_pressure": (float, "Pa", 1.0, 1e7), "least": pascals, "greatest": pascals}  # fmt: skip
    regulators: list[Regulator] = []
    for index, entry in enumerate(entries):
        where = f"regulators[{index}]."
        one = Regulator(**checked(file, where, entry, own))
        _check_regulator(file, where, one, regulators)
        regulators.append(one)
    return RegulatorsFile(regulators=tuple(regulators), **values)


def _check_regulator(file: Path, where: str, one: Regulator, before: list[Regulator]) -> None:
    for key in ("name", "output", "input"):
        if getattr(one, key) in [getattr(other, key) for other in before]:
            raise DeviceFileError(file, f"{where}{key}", getattr(one, key), "", "is used twice")
    for low, high in (("output_zero", "output_full"), ("input_zero", "input_full"), ("least", "greatest")):
        if not getattr(one, low) < getattr(one, high):
            unit = "Pa" if low == "least" else "V"
            raise DeviceFileError(file, f"{where}{low}", getattr(one, low), unit, f"must be below {high}")
    for key in ("least", "greatest"):
        volts = one.volts(getattr(one, key))
        if not 0.0 <= volts <= FULL_VOLTAGE:
            raise DeviceFileError(file, f"{where}{key}", getattr(one, key), "Pa",
                                  f"needs {volts:.3g} V; the module has 0 to 10 V")  # fmt: skip


class RegulatorDevice:
    """Regulators as a `softrobot_twin.control.device.Device`.

    Safety: all are vented until the first command, without a command for `command_timeout`, where a
    cavity is above its greatest pressure by `overpressure`, and after `close`. A command outside of a
    regulator's limits is refused: then no pressure changes. What is sent changes by `ramp` at most, but
    venting is at once. If this process ends or hangs, the module's own watchdog sets its outputs to 0 V.

    Args:
        description: The regulators.

    Attributes:
        description: The regulators.
        cavity_names: Names of the cavities, which are the actuators.
        pressure_variance: Variance of what a monitor's count rounds off [Pa²].
        refused: Number of commands refused.
        trouble: Why the cavities are vented, or why a command was refused; empty when they follow.

    Raises:
        BusError: The module does not answer.
    """

    effector_names: tuple[str, ...] = ()
    recovered = "the regulators answer again; they are vented until a command"

    def __init__(self, description: RegulatorsFile):
        self.description, own = description, description.regulators
        self.actuator_names = self.cavity_names = tuple(one.name for one in own)
        self._module = ModbusTcp(description.host, description.port, description.unit,
                                 description.answer_time)  # fmt: skip
        count = max(one.full_pressure / (one.input_full - one.input_zero) for one in own)
        self.pressure_variance = (count * FULL_VOLTAGE / description.input_counts) ** 2 / 12.0
        self._zero = np.clip(np.zeros(len(own)), [one.least for one in own],
                             [one.greatest for one in own])  # fmt: skip
        self._inputs = range(min(one.input for one in own), max(one.input for one in own) + 1)
        self._commanded = self._time = -math.inf
        self.refused, self.trouble = 0, ""
        try:
            self.recover()
        except BusError:
            self._module.close()
            raise

    def apply(self, setpoints: np.ndarray, now: float) -> None:
        """Takes the newest command: gauge pressures [Pa]; it is sent with the next measurement."""
        wanted = np.asarray(setpoints, float)
        for one, pressure in zip(self.description.regulators, wanted, strict=True):
            # Written so that a NaN is refused too.
            if not one.least <= pressure <= one.greatest:
                self.refused += 1
                self.trouble = (f"command refused: {one.name} {pressure:.0f} Pa is not within "
                                f"{one.least:g} to {one.greatest:g} Pa")  # fmt: skip
                return
        self._goal, self._commanded, self.trouble = wanted.copy(), now, ""

    def read(self, now: float) -> DeviceReading:
        """Measures, and sends the next pressures on the way to the newest command.

        Raises:
            BusError: The module does not answer; its watchdog vents if this goes on.
            HardwareAlert: A monitor states less than at no pressure: its wire or its supply is off.
        """
        counts = self._module.read_inputs(self._inputs.start, len(self._inputs))
        own, pressures = self.description.regulators, []
        for one in own:
            volts = FULL_VOLTAGE * counts[one.input - self._inputs.start] / self.description.input_counts
            if volts < LIVE_SHARE * one.input_zero:
                self._vent()
                raise HardwareAlert(None, f"{one.name}: its monitor states {volts:.2f} V, less than "
                                    f"{one.input_zero:g} V at no pressure: is it cut off?")  # fmt: skip
            pressures.append(one.pressure(volts))
        measured = np.array(pressures)
        self._drive(now, measured)
        return DeviceReading(measured, measured.copy(), np.empty(0, np.uint32), np.empty((0, 3)),
                             np.empty((0, 3)))  # fmt: skip

    def _drive(self, now: float, measured: np.ndarray) -> None:
        """Sends the next pressures, or vents."""
        passed, self._time = max(0.0, now - self._time), now
        if self._goal is None:
            return
        if now - self._commanded > self.description.command_timeout:
            self._vent("no command arrives: all cavities are vented")
            return
        for one, pressure in zip(self.description.regulators, measured, strict=True):
            if pressure > one.greatest + self.description.overpressure:
                self._vent(f"{one.name} has {pressure:.0f} Pa, more than {one.greatest:g} Pa: all "
                           "cavities are vented")  # fmt: skip
                return
        most = self.description.ramp * passed if math.isfinite(passed) else 0.0
        self._send(self._sent + np.clip(self._goal - self._sent, -most, most))

    def _send(self, pressures: np.ndarray) -> None:
        for one, pressure in zip(self.description.regulators, pressures, strict=True):
            count = round(one.volts(pressure) / FULL_VOLTAGE * self.description.output_counts)
            self._module.write(one.output, count)
        self._sent = pressures

    def _vent(self, reason: str = "") -> None:
        """Lets the gas out of all cavities; the next command fills them again."""
        self._goal, self.trouble = None, reason
        self._send(self._zero)

    def recover(self) -> None:
        """After an error of the bus: all are vented until the next command.

        Raises:
            BusError: The module still does not answer.
        """
        self._vent()

    def close(self) -> list[str]:
        """Vents all cavities, tried several times, and closes the connection.

        Returns:
            What went wrong: cavities that may still be under pressure.
        """
        problems: list[str] = []
        for left in reversed(range(_TRIES)):
            try:
                self._vent()
                break
            except BusError as error:
                if not left:
                    problems.append(f"the cavities may still be under pressure: {error}")
        self._module.close()
        return problems
