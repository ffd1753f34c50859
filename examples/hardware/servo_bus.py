"""A bus of servos that speak the Dynamixel protocol 2.0: packets, check sums, and a serial port.

Written from the public description of the protocol,
https://emanual.robotis.com/docs/en/dxl/protocol2

A packet is FF FF FD 00, id, length (2 bytes), instruction, parameters, CRC (2 bytes); all numbers
have their lowest byte first. Where FF FF FD occurs in the content, another FD follows it.
"""

from __future__ import annotations

import os
import select
import termios
import time
import tty
from collections.abc import Mapping, Sequence
from typing import NamedTuple, Protocol

HEADER = b"\xff\xff\xfd\x00"
BROADCAST = 0xFE
PING, READ, WRITE, STATUS, SYNC_READ, SYNC_WRITE = 0x01, 0x02, 0x03, 0x55, 0x82, 0x83
ALERT = 0x80
"""Bit of a status that tells of an error of the hardware, such as overload or heat."""
_ERRORS = {
    1: "the instruction failed", 2: "the instruction is unknown", 3: "the CRC was wrong",
    4: "a value is out of range", 5: "the data have another length", 6: "a value is beyond a limit",
    7: "the address cannot be written",
}  # fmt: skip
_LONGEST = 1024
"""Longest content of a packet that is believed."""


class BusError(Exception):
    """The bus did not do what it was asked.

    Attributes:
        servo: Id of the servo; None when it is not known.
    """

    def __init__(self, servo: int | None, reason: str):
        self.servo = servo
        super().__init__(reason if servo is None else f"servo {servo}: {reason}")


class BusTimeout(BusError):
    """A servo did not answer."""


class ChecksumError(BusError):
    """An answer was damaged on the way."""


class ServoError(BusError):
    """A servo refused an instruction."""


class HardwareAlert(BusError):
    """A servo reports an error of its hardware: it has switched its torque off, or will."""


class Port(Protocol):
    """Where bytes go out and come in."""

    def write(self, content: bytes) -> None:
        """Sends bytes."""

    def read(self, timeout: float) -> bytes:
        """Bytes that have come; waits for the first at most a time [s]; empty after it."""

    def forget(self) -> None:
        """Drops what has come and was not read."""

    def close(self) -> None:
        """Closes the port."""


def _crc_table() -> tuple[int, ...]:
    table = []
    for byte in range(256):
        rest = byte << 8
        for _ in range(8):
            rest = (rest << 1) ^ (0x8005 if rest & 0x8000 else 0)
        table.append(rest & 0xFFFF)
    return tuple(table)


_CRC = _crc_table()


def crc16(content: bytes) -> int:
    """Check sum of a packet: the rest of the division by x¹⁶ + x¹⁵ + x² + 1, beginning with 0."""
    rest = 0
    for byte in content:
        rest = ((rest << 8) & 0xFFFF) ^ _CRC[(rest >> 8) ^ byte]
    return rest


def packet(servo: int, instruction: int, parameters: bytes = b"") -> bytes:
    """A packet to a servo, or from one.

    Args:
        servo: Its id, or `BROADCAST`.
        instruction: What it shall do; of an answer `STATUS`.
        parameters: The content; of an answer the error comes first.
    """
    content = (bytes([instruction]) + parameters).replace(b"\xff\xff\xfd", b"\xff\xff\xfd\xfd")
    head = HEADER + bytes([servo]) + (len(content) + 2).to_bytes(2, "little")
    return head + content + crc16(head + content).to_bytes(2, "little")


class Packet(NamedTuple):
    """A packet that was read.

    Attributes:
        servo: Id of the sender or receiver.
        instruction: What it is.
        parameters: Its content.
    """

    servo: int
    instruction: int
    parameters: bytes


class PacketReader:
    """Finds packets in a stream of bytes; skips what is none, such as noise."""

    def __init__(self) -> None:
        self._bytes = bytearray()

    def clear(self) -> None:
        """Forgets what came of a packet."""
        self._bytes.clear()

    def feed(self, content: bytes) -> list[Packet]:
        """The packets that are complete with these bytes.

        Raises:
            ChecksumError: A packet was damaged; it is left out of what is read next.
        """
        self._bytes += content
        found = []
        while (one := self._next()) is not None:
            found.append(one)
        return found

    def _next(self) -> Packet | None:
        content = self._bytes
        while True:
            start = content.find(HEADER)
            if start < 0:
                # The last bytes may be the beginning of a header.
                del content[: max(0, len(content) - len(HEADER) + 1)]
                return None
            del content[:start]
            if len(content) < 7:
                return None
            length = int.from_bytes(content[5:7], "little")
            if 3 <= length <= _LONGEST:
                break
            del content[: len(HEADER)]
        if len(content) < 7 + length:
            return None
        whole = bytes(content[: 7 + length])
        if crc16(whole[:-2]) != int.from_bytes(whole[-2:], "little"):
            # Its length may be what is wrong: a header may follow inside of it.
            del content[: len(HEADER)]
            raise ChecksumError(whole[4], "an answer with a wrong check sum")
        del content[: 7 + length]
        inner = whole[7:-2].replace(b"\xff\xff\xfd\xfd", b"\xff\xff\xfd")
        return Packet(whole[4], inner[0], inner[1:])


class ServoBus:
    """Reads and writes the tables of servos.

    Args:
        port: Where the servos are.
        timeout: Longest time from an instruction to the end of an answer [s].
    """

    def __init__(self, port: Port, timeout: float = 0.02):
        self._port, self.timeout, self._reader = port, timeout, PacketReader()

    def ping(self, servo: int) -> int:
        """Number of the model of a servo.

        Raises:
            BusError: It does not answer.
        """
        return int.from_bytes(self._ask(packet(servo, PING), [servo])[servo][:2], "little")

    def read(self, servo: int, address: int, size: int) -> bytes:
        """Bytes of a servo's table.

        Raises:
            BusError: It does not answer, or refuses.
        """
        asked = packet(servo, READ, address.to_bytes(2, "little") + size.to_bytes(2, "little"))
        return self._checked(servo, self._ask(asked, [servo])[servo], size)

    def write(self, servo: int, address: int, content: bytes) -> None:
        """Writes to a servo's table, and waits for the answer.

        Raises:
            BusError: It does not answer, or refuses.
        """
        asked = packet(servo, WRITE, address.to_bytes(2, "little") + content)
        self._ask(asked, [servo])

    def sync_read(self, servos: Sequence[int], address: int, size: int) -> dict[int, bytes]:
        """The same bytes of the tables of several servos, asked at once.

        Raises:
            BusError: One does not answer, or refuses.
        """
        parameters = address.to_bytes(2, "little") + size.to_bytes(2, "little") + bytes(servos)
        answers = self._ask(packet(BROADCAST, SYNC_READ, parameters), servos)
        return {servo: self._checked(servo, answers[servo], size) for servo in servos}

    def sync_write(self, address: int, contents: Mapping[int, bytes]) -> None:
        """Writes to the tables of several servos at once; nobody answers.

        Args:
            address: First byte of the tables.
            contents: Content by servo, all of the same length.

        Raises:
            BusError: The port cannot send.
        """
        size = len(next(iter(contents.values())))
        parameters = address.to_bytes(2, "little") + size.to_bytes(2, "little")
        for servo, content in contents.items():
            parameters += bytes([servo]) + content
        self._send(packet(BROADCAST, SYNC_WRITE, parameters))

    def _send(self, asked: bytes) -> None:
        # Late answers to an earlier instruction are not answers to this one.
        try:
            self._port.forget()
            self._reader.clear()
            self._port.write(asked)
        except OSError as error:
            raise BusError(None, f"the port cannot send: {error}") from error

    def _ask(self, asked: bytes, servos: Sequence[int]) -> dict[int, bytes]:
        """Answers of some servos, by their ids."""
        self._send(asked)
        deadline, answers = time.monotonic() + self.timeout, {}
        while len(answers) < len(servos):
            rest = deadline - time.monotonic()
            missing = next(servo for servo in servos if servo not in answers)
            if rest <= 0.0:
                raise BusTimeout(missing, "no answer")
            try:
                content = self._port.read(rest)
            except OSError as error:
                raise BusError(missing, f"the port cannot receive: {error}") from error
            for one in self._reader.feed(content):
                # An adapter may return what was sent: an instruction is no answer.
                if one.instruction == STATUS and one.servo in servos:
                    answers[one.servo] = self._without_error(one)
        return answers

    @staticmethod
    def _without_error(one: Packet) -> bytes:
        if not one.parameters:
            raise ChecksumError(one.servo, "an answer without content")
        error = one.parameters[0]
        if error & ALERT:
            raise HardwareAlert(one.servo, "an error of the hardware, such as overload or heat")
        if error:
            raise ServoError(one.servo, _ERRORS.get(error, f"error {error}"))
        return one.parameters[1:]

    @staticmethod
    def _checked(servo: int, content: bytes, size: int) -> bytes:
        if len(content) != size:
            raise ChecksumError(servo, f"{len(content)} bytes in place of {size}")
        return content


class SerialPort:
    """A serial port of this machine, 8 bits, no parity, one stop bit.

    Args:
        path: Its file, such as ``/dev/ttyUSB0``.
        baud_rate: Bits per second; one that the system knows.

    Raises:
        BusError: The port cannot be opened, or does not know the rate.
    """

    def __init__(self, path: str, baud_rate: int):
        speed = getattr(termios, f"B{baud_rate}", None)
        if speed is None:
            raise BusError(None, f"baud_rate {baud_rate} is not one of this system's")
        try:
            self._file = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        except OSError as error:
            raise BusError(None, f"{path} cannot be opened: {error.strerror}") from error
        try:
            tty.setraw(self._file)
            settings = termios.tcgetattr(self._file)
            settings[4] = settings[5] = speed
            termios.tcsetattr(self._file, termios.TCSANOW, settings)
        except termios.error as error:
            os.close(self._file)
            raise BusError(None, f"{path} is not a serial port") from error

    def write(self, content: bytes) -> None:
        """Sends bytes; see `Port`."""
        while content:
            content = content[os.write(self._file, content) :]

    def read(self, timeout: float) -> bytes:
        """Bytes that have come; see `Port`."""
        if not select.select([self._file], [], [], timeout)[0]:
            return b""
        content = os.read(self._file, 4096)
        if not content:
            raise OSError("the port was closed at its other end")
        return content

    def forget(self) -> None:
        """Drops what has come; see `Port`."""
        try:
            termios.tcflush(self._file, termios.TCIFLUSH)
        except termios.error as error:
            raise OSError(*error.args) from error

    def close(self) -> None:
        """Closes the port."""
        os.close(self._file)
