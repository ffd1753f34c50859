"""What a caller may ask of one step. The kind of command picks how λ is found, nothing else."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class FollowTargets:
    """Inverse step: pull so that the effectors come to their targets (Coevoet 2017, eq. 17-18).

    Attributes:
        targets: Where each effector should be [m], shape (effector_count, 3), in the order of
            `Simulation.effector_names`. A row of NaN leaves that effector free.
        time_step: Time since the last step [s]; scales the rate limits of the actuators.
        commanded: Lengths of the actuators that are commanded while the others are optimised
            around them [m], NaN where free, shape (actuator_count,); None: all are free.
    """

    targets: np.ndarray
    time_step: float
    commanded: np.ndarray | None = None


@dataclass(frozen=True)
class CommandSetpoints:
    """Direct step: every actuator goes to a setpoint (eq. 16); a cable goes slack, never pushes.

    Attributes:
        setpoints: Asked lengths of cables, pull point to last point, and positions of slides
            [m], shape (actuator_count,).
        time_step: Time since the last step [s].
    """

    setpoints: np.ndarray
    time_step: float


@dataclass(frozen=True)
class CommandEfforts:
    """Direct step: every actuator works with an effort: a cable is pulled with a tension.

    Attributes:
        efforts: Asked tensions of cables [N], shape (actuator_count,); NaN for slides, which stay.
        time_step: Time since the last step [s].
    """

    efforts: np.ndarray
    time_step: float


@dataclass(frozen=True)
class Hold:
    """Keep every actuator where it is while the body settles.

    Attributes:
        time_step: Time since the last step [s]; needed where a scene moves in time.
    """

    time_step: float = 0.0


Command = FollowTargets | CommandSetpoints | CommandEfforts | Hold
