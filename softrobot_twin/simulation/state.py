"""The state of a simulation: a value that can be copied, saved and restored."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, TypeVar

import numpy as np

Made = TypeVar("Made")


def made(kind: type[Made], before: Mapping[str, Any] = {}, **fields: Any) -> Made:
    """An object of a frozen class, in a tenth of the time of a call of the class: each step makes some.

    Args:
        kind: The class.
        before: Fields by their names, such as those of another object.
        **fields: More of them, or in their place. The others are the defaults of the class.
    """
    one = object.__new__(kind)
    one.__dict__.update(before, **fields)
    return one


@dataclass(frozen=True)
class PastMotion:
    """What a scheme of second order knows of the past beside velocities. Read-only arrays.

    Attributes:
        accelerations: v̇ of each unknown by its smooth forces [m/s²], of rotations J⁻¹ times the
            torque [rad/s²], shape (free_node_count, 3).
        acceleration_rates: How fast the averaged acceleration a of the scheme is ahead of it,
            (a - v̇)/h [m/s³] and [rad/s³], same shape.
        contact_forces: Forces of contacts on the unknowns in the last three steps, newest first
            [N] and [N m], shape (3, free_node_count, 3); (3, 0, 3) without contact.
        time_step: Length of the last step [s].
    """

    accelerations: np.ndarray
    acceleration_rates: np.ndarray
    contact_forces: np.ndarray
    time_step: float

    def __post_init__(self):
        for array in (self.accelerations, self.acceleration_rates, self.contact_forces):
            array.setflags(write=False)


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
        past: What a scheme of second order needs of the steps before; None at its start, and in
            all other scenes. Whoever changes positions or velocities leaves it out: it would
            belong to another motion.
        memory: What optional effects remember, by "part.field"; see `step_part`.
    """

    positions: np.ndarray
    setpoints: np.ndarray
    efforts: np.ndarray
    step_count: int = 0
    time: float = 0.0
    velocities: np.ndarray = field(default_factory=lambda: np.empty((0, 3)))
    past: PastMotion | None = None
    memory: Mapping[str, np.ndarray] = field(default_factory=dict)

    def __post_init__(self):
        arrays = (self.positions, self.setpoints, self.efforts, self.velocities)
        for array in (*arrays, *self.memory.values()):
            array.setflags(write=False)

    def memory_of(self, part: str) -> dict[str, np.ndarray]:
        """What a part remembers, by field.

        Args:
            part: Name of the part.
        """
        start = f"{part}."
        return {key.removeprefix(start): array for key, array in self.memory.items() if key.startswith(start)}

    def kept_through(self, time_step: float) -> State:
        """The same state, with time and count of one more step: the result of a failed step.

        Args:
            time_step: The step's duration [s].
        """
        return made(State, self.__dict__, step_count=self.step_count + 1, time=self.time + time_step)
