"""Pressure regulators that are simulated, on a port of this machine: to try and to test without hardware.

``python simulated_regulators.py regulators.yaml`` serves them: give `host: 127.0.0.1` and the port that it
prints in the file.
"""

from __future__ import annotations

import contextlib
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from modbus import SimulatedModule
from regulators import FULL_VOLTAGE, Regulator, RegulatorsFile, read_regulators


class SimulatedRegulators:
    """Regulators with a first-order lag, and the module that they hang on.

    Args:
        description: The regulators.
        lag: Time constant [s].
        now: The clock that they move by [s].
        port: TCP port of the module; 0 for any.

    Attributes:
        module: The module.
        pressures: Their gauge pressures [Pa], by name.
        cut: Names of those whose monitor is cut off.
    """

    def __init__(
        self, description: RegulatorsFile, lag: float = 0.05,
        now: Callable[[], float] = time.monotonic, port: int = 0,
    ):  # fmt: skip
        self._description, self._lag, self._now, self._moved = description, lag, now, now()
        self._by_input = {one.input: one for one in description.regulators}
        self.pressures = {one.name: 0.0 for one in description.regulators}
        self.cut: set[str] = set()
        self.module = SimulatedModule(self._monitor, 2.0 * description.command_timeout, now, port)

    def asked(self, one: Regulator) -> float:
        """The gauge pressure that the module's output asks a regulator for [Pa]."""
        volts = self.module.outputs.get(one.output, 0) / self._description.output_counts * FULL_VOLTAGE
        return one.full_pressure * (volts - one.output_zero) / (one.output_full - one.output_zero)

    def move(self) -> None:
        """Moves on until now."""
        now = self._now()
        share, self._moved = -np.expm1(-(now - self._moved) / self._lag), now
        for one in self._description.regulators:
            self.pressures[one.name] += share * (self.asked(one) - self.pressures[one.name])

    def _monitor(self, outputs: dict[int, int], register: int) -> int:
        one = self._by_input.get(register)
        self.move()
        if one is None or one.name in self.cut:
            return 0
        share = self.pressures[one.name] / one.full_pressure
        volts = one.input_zero + share * (one.input_full - one.input_zero)
        return round(min(max(volts, 0.0), FULL_VOLTAGE) / FULL_VOLTAGE * self._description.input_counts)


def main() -> None:
    """Serves the regulators of a file until it is interrupted."""
    served = SimulatedRegulators(read_regulators(Path(sys.argv[1])))
    print(f"regulators {list(served.pressures)} on 127.0.0.1, port {served.module.port}", flush=True)
    with contextlib.suppress(KeyboardInterrupt):
        threading.Event().wait()
    served.module.close()


if __name__ == "__main__":
    main()
