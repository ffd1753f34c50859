"""What other models of a scene, which judge or replace a simulation, use of it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np

from softrobot_twin.scene import Scene
from softrobot_twin.simulation.building.model import Model
from softrobot_twin.simulation.command import Command
from softrobot_twin.simulation.result import StepResult
from softrobot_twin.simulation.state import State
from softrobot_twin.simulation.step.newton import Newton


class Steppable(Protocol):
    """A `Simulation`; see there."""

    model: Model
    newton: Newton
    state: State
    now: Callable[[], float]

    def __init__(self, scene: Scene, now: Callable[[], float] = ..., *, with_warnings: bool): ...

    @property
    def scene(self) -> Scene: ...

    def step(self, command: Command, *, measured: object | None = None) -> StepResult: ...

    def reset(self) -> None: ...

    def restore(self, state: State) -> None: ...

    def warm_up(self) -> None: ...

    def effector_positions(self) -> np.ndarray: ...
