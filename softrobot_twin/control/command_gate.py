"""The last gate: nothing passes that is not finite or outside length, rate and tension limits."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from softrobot_twin.simulation.limits import ActuatorLimits

LENGTH_TOLERANCE = 2.0e-6
"""What an optimiser may be off by at a length limit [m]."""
TENSION_TOLERANCE = 1.0e-2
"""What an optimiser may be off by at a tension limit [N]."""


class CableCommand(NamedTuple):
    """What goes to the hardware.

    Attributes:
        lengths: Cable lengths [m], shape (actuator_count,).
        tensions: Cable tensions [N], shape (actuator_count,).
    """

    setpoints: np.ndarray
    efforts: np.ndarray


class Passage(NamedTuple):
    """What the gate lets out.

    Attributes:
        command: What to publish.
        violated: What the refused command broke, such as ``north.rate``; empty when it passed.
    """

    command: CableCommand
    violated: tuple[str, ...]


class CommandGate:
    """Passes a command that is in limits, and repeats the last one that was in place of others.

    The simulation keeps the limits already; this proves it on every command that leaves. It
    knows one thing: where the actuators were last sent or measured. Only a command that leaves,
    or a measurement told by `start_from`, changes that; no service and no failure does. At first
    the actuators are taken to be at rest.

    What an optimiser is off by at a limit is cut off. Actuators that were measured outside their
    limits come in as fast as their rates allow.

    Args:
        actuator_names: Cable names.
        rest_lengths: Lengths that shortening counts from [m], shape (actuator_count,).
        limits: Limits of shortening, rate and tension.

    Attributes:
        last: What left or was measured last.
        home: Rest, or the lengths next to it that the limits allow [m], shape (actuator_count,).
    """

    def __init__(
        self, actuator_names: Sequence[str], rest_setpoints: np.ndarray, limits: ActuatorLimits
    ):
        self._names = tuple(actuator_names)
        self._shortest = rest_setpoints - limits.displacement_max
        self._longest = rest_setpoints - limits.displacement_min
        self._limits = limits
        self.home = self.within(rest_setpoints)
        self.last = self._copy(self.home, np.zeros(len(rest_setpoints)))

    def within(self, lengths: np.ndarray) -> np.ndarray:
        """The nearest lengths inside the limits [m], shape (actuator_count,)."""
        return np.clip(lengths, self._shortest, self._longest)

    @property
    def is_outside(self) -> bool:
        """True when an actuator was measured outside its limits and has not come in yet."""
        return bool(self._outside.any())

    @property
    def _outside(self) -> np.ndarray:
        """True for each actuator that stands outside its limits, shape (actuator_count,)."""
        return np.abs(self.within(self.last.setpoints) - self.last.setpoints) > LENGTH_TOLERANCE

    def start_from(self, lengths: np.ndarray, tensions: np.ndarray) -> None:
        """Says where the cables stand: the first command may not be further than the rate allows.

        Args:
            lengths: Lengths in place [m], shape (actuator_count,).
            tensions: Tensions in place [N], shape (actuator_count,).
        """
        self.last = self._copy(lengths, tensions)

    def pass_on(self, lengths: np.ndarray, tensions: np.ndarray, time_step: float) -> Passage:
        """Lets a command through, or the last one in its place.

        Args:
            lengths: Cable lengths [m], shape (actuator_count,).
            tensions: Cable tensions [N], shape (actuator_count,).
            time_step: Time since the last command [s].
        """
        violated = self._violations(lengths, tensions, time_step)
        if not violated:
            self.last = self._copy(self._reached(lengths, time_step), tensions)
        elif self.is_outside:
            self.lead(self.within(self.last.setpoints), time_step)
        return Passage(self.last, violated)

    def lead(self, lengths: np.ndarray, time_step: float) -> CableCommand:
        """Goes towards lengths as fast as the rates allow, with the tensions of before.

        Args:
            lengths: Where to go [m], shape (actuator_count,); only as far as the limits allow.
            time_step: Time since the last command [s].
        """
        self.last = self._copy(self._reached(lengths, time_step), self.last.efforts)
        return self.last

    def reach(self, time_step: float) -> np.ndarray:
        """How far each actuator may move in a time [m], shape (actuator_count,)."""
        return self._limits.reach(time_step)

    def _copy(self, lengths: np.ndarray, tensions: np.ndarray) -> CableCommand:
        limits = self._limits
        return CableCommand(
            np.array(lengths, dtype=float),
            np.clip(np.asarray(tensions, dtype=float), limits.effort_min, limits.effort_max),
        )

    def _reached(self, lengths: np.ndarray, time_step: float) -> np.ndarray:
        """The part of the way to lengths, inside the limits, that the rates allow [m]."""
        before, reach = self.last.setpoints, self.reach(time_step)
        return np.clip(self.within(lengths), before - reach, before + reach)

    def _violations(self, lengths, tensions, time_step: float) -> tuple[str, ...]:
        shape = (len(self._names),)
        if np.shape(lengths) != shape or np.shape(tensions) != shape:
            return ("wrong_size",)
        moved = np.abs(lengths - self.last.setpoints)
        too_fast = moved > self.reach(time_step) + LENGTH_TOLERANCE
        checks = (
            ("not_finite", ~(np.isfinite(lengths) & np.isfinite(tensions))),
            ("shortening_max", lengths < self._shortest - LENGTH_TOLERANCE),
            ("shortening_min", lengths > self._longest + LENGTH_TOLERANCE),
            ("tension_min", tensions < self._limits.effort_min - TENSION_TOLERANCE),
            ("tension_max", tensions > self._limits.effort_max + TENSION_TOLERANCE),
            ("rate", too_fast & ~self._outside),
        )
        return tuple(
            f"{self._names[i]}.{word}" for word, broken in checks for i in np.flatnonzero(broken)
        )
