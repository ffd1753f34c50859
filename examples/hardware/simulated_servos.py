"""Servos that are simulated, on a pseudo-terminal: to try and to test without hardware.

``python simulated_servos.py servos.yaml`` prints the port that the hardware node should open.
"""

from __future__ import annotations

import contextlib
import os
import select
import sys
import threading
import time
import tty
from collections.abc import Callable
from pathlib import Path

from servo_bus import (
    ALERT,
    BROADCAST,
    PING,
    READ,
    STATUS,
    SYNC_READ,
    SYNC_WRITE,
    WRITE,
    ChecksumError,
    Packet,
    PacketReader,
    packet,
)
from servos import (
    GOAL_POSITION,
    HARDWARE_ERROR,
    OPERATING_MODE,
    PRESENT_CURRENT,
    PRESENT_POSITION,
    TORQUE_ENABLE,
    WATCHDOG,
    WATCHDOG_UNIT,
    read_servos,
)

MODEL = 1060
_ACCESS, _RANGE = 7, 4


class SimulatedServo:
    """The table of a servo, and a motor that moves to its goal at a speed.

    Args:
        ticks: Where it is at the start.
        speed: Its speed [ticks/s].
        now: The clock that it moves by [s].

    Attributes:
        table: Its table.
        current: What it states as its present current, in its own unit.
    """

    def __init__(self, ticks: int, speed: float = 4096.0,
                 now: Callable[[], float] = time.monotonic):  # fmt: skip
        self.table, self.speed, self._now = bytearray(256), speed, now
        self._position, self._moved, self._heard = float(ticks), now(), now()
        self.current = 0
        self.table[OPERATING_MODE] = 3
        self._put(GOAL_POSITION, ticks, 4)
        self._put(PRESENT_POSITION, ticks, 4)

    @property
    def position(self) -> float:
        """Where it is [ticks]."""
        self.move()
        return self._position

    @property
    def has_torque(self) -> bool:
        """Whether it drives."""
        return bool(self.table[TORQUE_ENABLE])

    def _put(self, address: int, value: int, size: int) -> None:
        self.table[address : address + size] = value.to_bytes(size, "little", signed=True)

    def move(self) -> None:
        """Moves on until now; stands still when the watchdog has acted."""
        now = self._now()
        passed, self._moved = now - self._moved, now
        limit = self.table[WATCHDOG]
        if 0 < limit < 255 and now - self._heard > limit * WATCHDOG_UNIT:
            self.table[WATCHDOG] = 255
        if self.has_torque and self.table[WATCHDOG] != 255:
            goal = int.from_bytes(self.table[GOAL_POSITION : GOAL_POSITION + 4], "little",
                                  signed=True)  # fmt: skip
            reach = self.speed * passed
            self._position += max(-reach, min(reach, goal - self._position))
        self._put(PRESENT_POSITION, round(self._position), 4)
        self._put(PRESENT_CURRENT, self.current, 2)

    def heard(self) -> None:
        """Notes that an instruction came, for the watchdog."""
        self.move()
        self._heard = self._now()

    def read(self, address: int, size: int) -> tuple[int, bytes]:
        """Error, and bytes of the table."""
        self.move()
        if address + size > len(self.table):
            return _RANGE, b""
        return 0, bytes(self.table[address : address + size])

    def write(self, address: int, content: bytes) -> int:
        """Writes to the table; returns the error."""
        if address + len(content) > len(self.table):
            return _RANGE
        # The first part of the table can be written without torque only.
        if address < TORQUE_ENABLE and self.has_torque:
            return _ACCESS
        if address == GOAL_POSITION and self.table[WATCHDOG] == 255:
            return _RANGE
        self.move()
        self.table[address : address + len(content)] = content
        return 0


class SimulatedBus:
    """Answers instructions to servos.

    Attributes:
        servos: The servos by id.
        silent: Ids of servos that do not answer.
        damaged: Ids of servos whose answers have a wrong check sum.
        noise: Bytes that come before each answer.
        echoes: Whether what is sent comes back, as some adapters do it.
    """

    def __init__(self, servos: dict[int, SimulatedServo]):
        self.servos = servos
        self.silent: set[int] = set()
        self.damaged: set[int] = set()
        self.noise, self.echoes = b"", False
        self._reader = PacketReader()

    def answer(self, content: bytes) -> bytes:
        """What comes back for what was sent."""
        answers = [content] if self.echoes else []
        with contextlib.suppress(ChecksumError):
            for one in self._reader.feed(content):
                answers.append(self._answer(one))
        return b"".join(answers)

    def _answer(self, one: Packet) -> bytes:
        given = one.parameters
        if one.servo != BROADCAST and one.servo not in self.servos:
            return b""
        for servo in self.servos.values():
            servo.heard()
        address, size = int.from_bytes(given[:2], "little"), int.from_bytes(given[2:4], "little")
        if one.instruction == SYNC_READ:
            return b"".join(self._state(servo, *self.servos[servo].read(address, size))
                            for servo in given[4:] if servo in self.servos)  # fmt: skip
        if one.instruction == SYNC_WRITE:
            for start in range(4, len(given), size + 1):
                servo = given[start]
                if servo in self.servos:
                    self.servos[servo].write(address, given[start + 1 : start + 1 + size])
            return b""
        servo = self.servos[one.servo]
        if one.instruction == PING:
            return self._state(one.servo, 0, MODEL.to_bytes(2, "little") + b"\x2d")
        if one.instruction == READ:
            return self._state(one.servo, *servo.read(address, size))
        if one.instruction == WRITE:
            return self._state(one.servo, servo.write(address, given[2:]))
        return self._state(one.servo, 2)

    def _state(self, servo: int, error: int, content: bytes = b"") -> bytes:
        if servo in self.silent:
            return b""
        if self.servos[servo].table[HARDWARE_ERROR]:
            error |= ALERT
        answer = bytearray(packet(servo, STATUS, bytes([error]) + content))
        if servo in self.damaged:
            answer[-1] ^= 0x55
        return self.noise + bytes(answer)


class Terminal:
    """A bus on a pseudo-terminal, served by a thread.

    Args:
        bus: The bus.

    Attributes:
        path: File that takes the place of the serial port.
    """

    def __init__(self, bus: SimulatedBus):
        self._bus = bus
        self._own, self._other = os.openpty()
        tty.setraw(self._other)
        self.path = os.ttyname(self._other)
        self._wake, self._woken = os.pipe()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def _serve(self) -> None:
        while True:
            ready, _, _ = select.select([self._own, self._wake], [], [])
            if self._wake in ready:
                return
            answer = self._bus.answer(os.read(self._own, 4096))
            if answer:
                os.write(self._own, answer)

    def close(self) -> None:
        """Ends the thread and the terminal."""
        os.write(self._woken, b"x")
        self._thread.join()
        for file in (self._own, self._other, self._wake, self._woken):
            os.close(file)


def main() -> None:
    """Serves the servos of a file, at their zero, until it is interrupted."""
    description = read_servos(Path(sys.argv[1]))
    servos = {servo.id: SimulatedServo(servo.zero_ticks) for servo in description.servos}
    terminal = Terminal(SimulatedBus(servos))
    print(f"servos {list(servos)} on {terminal.path}", flush=True)
    with contextlib.suppress(KeyboardInterrupt):
        threading.Event().wait()
    terminal.close()


if __name__ == "__main__":
    main()
