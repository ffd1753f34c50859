"""What other models of a scene, which judge or replace a simulation, use of it."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, Protocol

import numpy as np

from softrobot_twin.scene import Scene
from softrobot_twin.simulation.building.limits import ActuatorLimits
from softrobot_twin.simulation.building.model import Model
from softrobot_twin.simulation.command import Command
from softrobot_twin.simulation.result import StepResult
from softrobot_twin.simulation.state import State
from softrobot_twin.simulation.step.inverse_actuation import InverseActuation
from softrobot_twin.simulation.step.newton import Newton
from softrobot_twin.simulation.step.time_budget import StageClock


class Steppable(Protocol):
    """A `Simulation`; see there."""

    model: Model
    parts: tuple
    newton: Newton
    inverse: InverseActuation | None
    state: State
    now: Callable[[], float]
    kept: NamedTuple | None
    is_balanced: bool

    def __init__(self, scene: Scene, now: Callable[[], float] = ..., *, with_warnings: bool): ...

    @property
    def scene(self) -> Scene: ...

    @property
    def limits(self) -> ActuatorLimits: ...

    def step(
        self, command: Command, budget: float | None = None, measured: object | None = None
    ) -> StepResult: ...

    def stay_by(self, command: Command, rest: StepResult) -> StepResult: ...

    def asks_as(self, before: Command, command: Command) -> bool: ...

    def come_near(
        self, positions: np.ndarray, efforts: np.ndarray, time_step: float, clock: StageClock
    ) -> np.ndarray | None: ...

    def take_parts(self, parts: tuple) -> None: ...

    def forget_solvers(self) -> None: ...

    def reset(self) -> None: ...

    def restore(self, state: State) -> None: ...

    def warm_up(self) -> None: ...

    def effector_positions(self) -> np.ndarray: ...
