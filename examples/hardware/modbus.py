"""Registers of a module of analogue inputs and outputs over Modbus TCP, and such a module simulated.

Written from the public description, https://www.modbus.org/specs.php

A message is transaction, protocol (0) and length (2 bytes each), unit (1 byte), then function and data,
highest byte first. Function 4 reads input registers, 6 writes a register, and an answer with 128 added
to the function is an exception.
"""

from __future__ import annotations

import contextlib
import socket
import struct
import threading
import time
from collections.abc import Callable

from servo_bus import BusError, BusTimeout

READ_INPUTS, WRITE = 4, 6
_EXCEPTIONS = {1: "the function is unknown", 2: "the address is unknown", 3: "the value cannot be",
               4: "the module failed", 6: "the module is busy"}  # fmt: skip
_HEADER = struct.Struct(">HHHB")


class ModbusTcp:
    """A connection to a module; it is opened at its first use, and again after an error.

    Args:
        host: Name or address of the module.
        port: Its TCP port, usually 502.
        unit: Its number behind a gateway; 1 where there is none.
        answer_time: Longest time until an answer [s].
    """

    def __init__(self, host: str, port: int, unit: int, answer_time: float):
        self._address, self._unit, self._answer_time = (host, port), unit, answer_time
        self._socket: socket.socket | None = None
        self._transaction = 0

    def read_inputs(self, first: int, count: int) -> list[int]:
        """Values of some input registers, which follow each other.

        Args:
            first: The first register.
            count: How many.

        Raises:
            BusError: The module cannot be reached, does not answer, or refuses.
        """
        answer = self._ask(struct.pack(">BHH", READ_INPUTS, first, count))
        if len(answer) != 2 + 2 * count or answer[1] != 2 * count:
            self._fail(f"{len(answer)} bytes in place of {2 + 2 * count}")
        return list(struct.unpack(f">{count}H", answer[2:]))

    def write(self, register: int, value: int) -> None:
        """Writes a register; see `read_inputs`.

        Args:
            register: The register.
            value: 0 to 65535.
        """
        request = struct.pack(">BHH", WRITE, register, value)
        if self._ask(request) != request:
            self._fail("another register or value was written")

    def _ask(self, request: bytes) -> bytes:
        """Function and data of the answer to a request."""
        self._transaction = (self._transaction + 1) % 65536
        try:
            if self._socket is None:
                self._socket = socket.create_connection(self._address, self._answer_time)
                self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._socket.settimeout(self._answer_time)
            self._socket.sendall(
                _HEADER.pack(self._transaction, 0, len(request) + 1, self._unit) + request)
            transaction, protocol, length, unit = _HEADER.unpack(self._receive(_HEADER.size))
            if (transaction, protocol, unit) != (self._transaction, 0, self._unit) or not 2 < length < 255:
                self._fail("an answer to something else")
            answer = self._receive(length - 1)
        except TimeoutError as error:
            self.close()
            raise BusTimeout(None, f"{self._address[0]}: no answer") from error
        except OSError as error:
            self._fail(str(error))
        if answer[0] == request[0] + 128:
            raise BusError(None, f"{self._address[0]}: {_EXCEPTIONS.get(answer[1], 'refused')}")
        if answer[0] != request[0]:
            self._fail("an answer of another function")
        return answer

    def _receive(self, size: int) -> bytes:
        content = b""
        while len(content) < size:
            more = self._socket.recv(size - len(content))
            if not more:
                raise OSError("the module closed the connection")
            content += more
        return content

    def _fail(self, reason: str) -> None:
        """Closes the connection, whose further bytes cannot be trusted, and tells why."""
        self.close()
        raise BusError(None, f"{self._address[0]}: {reason}")

    def close(self) -> None:
        """Closes the connection."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None


class SimulatedModule:
    """A module on a port of this machine, served by a thread.

    Args:
        inputs: From its output registers, a dictionary, to the value of an input register.
        watchdog: Without a request for this time its outputs are zero [s].
        now: The clock of the watchdog [s].
        port: TCP port; 0 for any.

    Attributes:
        port: The port.
        outputs: Its output registers.
        is_silent: Whether it does not answer.
        spoil: Changes an answer on its way.
    """

    def __init__(
        self, inputs: Callable[[dict[int, int], int], int], watchdog: float = 1.0,
        now: Callable[[], float] = time.monotonic, port: int = 0,
    ):  # fmt: skip
        self.outputs: dict[int, int] = {}
        self.is_silent, self.spoil = False, lambda answer: answer
        self._inputs, self._watchdog, self._now, self._heard = inputs, watchdog, now, now()
        self._listener = socket.create_server(("127.0.0.1", port))
        self.port = self._listener.getsockname()[1]
        threading.Thread(target=self._serve, daemon=True).start()

    def rest(self) -> None:
        """Lets the watchdog act."""
        if self._now() - self._heard > self._watchdog:
            self.outputs = dict.fromkeys(self.outputs, 0)

    def _serve(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                connection, _ = self._listener.accept()
                threading.Thread(target=self._talk, args=(connection,), daemon=True).start()

    def _talk(self, connection: socket.socket) -> None:
        with contextlib.suppress(OSError, struct.error), connection:
            while True:
                head = connection.recv(_HEADER.size, socket.MSG_WAITALL)
                transaction, _, length, unit = _HEADER.unpack(head)
                request = connection.recv(length - 1, socket.MSG_WAITALL)
                self.rest()
                self._heard = self._now()
                answer = self._answer(request)
                whole = _HEADER.pack(transaction, 0, len(answer) + 1, unit) + answer
                if not self.is_silent:
                    connection.sendall(self.spoil(whole))

    def _answer(self, request: bytes) -> bytes:
        function, first, value = struct.unpack(">BHH", request)
        if function == WRITE:
            self.outputs[first] = value
            return request
        if function != READ_INPUTS:
            return bytes([function + 128, 1])
        found = [self._inputs(self.outputs, first + place) for place in range(value)]
        return struct.pack(f">BB{value}H", function, 2 * value, *found)

    def close(self) -> None:
        """Ends it; connections that are open end with their other side."""
        # A thread that waits for a connection would still take one after a mere close.
        with contextlib.suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
