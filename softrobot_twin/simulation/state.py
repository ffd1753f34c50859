"""The state of a simulation: a value that can be copied, saved and restored."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np


@dataclass(frozen=True)
class State:
    """Everything from the past that a step depends on. Its arrays are read-only.

    Attributes:
        positions: Node positions [m], shape (node_count, 3).
        setpoints: Setpoint of each actuator, in the unit of its kind: the length of a cable or
            the position of a slide [m], shape (actuator_count,).
        efforts: Effort λ_a of each actuator, in the unit of its kind: the tension of a cable [N],
            shape (actuator_count,).
        step_count: Steps since rest, those among them that kept the state before.
        time: Time of all these steps [s].
        velocities: Velocity of each unknown [m/s], of rigid bodies' rotations [rad/s],
            shape (free_node_count, 3); without rows in statics.
        slips: Share of the friction that acts at each point of each cable, -1 to 1; see
            `cable_friction`, shape (segment_count,), or empty without friction along cables.
    """

    positions: np.ndarray
    setpoints: np.ndarray
    efforts: np.ndarray
    step_count: int = 0
    time: float = 0.0
    velocities: np.ndarray = field(default_factory=lambda: np.empty((0, 3)))
    slips: np.ndarray = field(default_factory=lambda: np.empty(0))

    def __post_init__(self):
        arrays = (self.positions, self.setpoints, self.efforts, self.velocities, self.slips)
        for array in arrays:
            array.setflags(write=False)

    def kept_through(self, time_step: float) -> State:
        """The same state, with time and count of one more step: the result of a failed step.

        Args:
            time_step: The step's duration [s].
        """
        return replace(self, step_count=self.step_count + 1, time=self.time + time_step)
