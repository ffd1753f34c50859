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

    lengths: np.ndarray
    tensions: np.ndarray


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

    The simulation keeps the limits already; this proves it on every command that leaves. The
    cables are taken to be at rest until `start_from` says otherwise.

    Args:
        actuator_names: Cable names.
        rest_lengths: Lengths that shortening counts from [m], shape (actuator_count,).
        limits: Limits of shortening, rate and tension.
    """

    def __init__(self, actuator_names: Sequence[str], rest_lengths: np.ndarray, limits: ActuatorLimits):
        self._names = tuple(actuator_names)
        self._shortest = rest_lengths - limits.shortening_max
        self._longest = rest_lengths - limits.shortening_min
        self._limits = limits
        self._last = CableCommand(np.array(rest_lengths), np.zeros(len(rest_lengths)))

    def start_from(self, lengths: np.ndarray, tensions: np.ndarray) -> None:
        """Says where the cables stand: the first command may not be further than the rate allows.

        Args:
            lengths: Lengths in place [m], shape (actuator_count,).
            tensions: Tensions in place [N], shape (actuator_count,).
        """
        self._last = CableCommand(np.array(lengths), np.array(tensions))

    def pass_on(self, lengths: np.ndarray, tensions: np.ndarray, time_step: float) -> Passage:
        """Lets a command through, or the last safe one in its place.

        Args:
            lengths: Cable lengths [m], shape (actuator_count,).
            tensions: Cable tensions [N], shape (actuator_count,).
            time_step: Time since the last command [s].
        """
        violated = self._violations(lengths, tensions, time_step)
        if violated:
            return Passage(self._last, violated)
        self._last = CableCommand(np.array(lengths), np.array(tensions))
        return Passage(self._last, ())

    def _violations(self, lengths, tensions, time_step: float) -> tuple[str, ...]:
        shape = (len(self._names),)
        if np.shape(lengths) != shape or np.shape(tensions) != shape:
            return ("wrong_size",)
        moved = np.abs(lengths - self._last.lengths)
        checks = (
            ("not_finite", ~(np.isfinite(lengths) & np.isfinite(tensions))),
            ("shortening_max", lengths < self._shortest - LENGTH_TOLERANCE),
            ("shortening_min", lengths > self._longest + LENGTH_TOLERANCE),
            ("tension_min", tensions < self._limits.tension_min - TENSION_TOLERANCE),
            ("tension_max", tensions > self._limits.tension_max + TENSION_TOLERANCE),
            ("rate", moved > self._limits.rate * time_step + LENGTH_TOLERANCE),
        )
        return tuple(
            f"{self._names[i]}.{word}" for word, broken in checks for i in np.flatnonzero(broken)
        )
