"""Touches of a step: what is measured of a finger at a robot, and what the model answers.

A touch comes in as a measured force, or as the measured place of the touched point. The step finds
the other: the place of the point under the force, or the force that holds the point.

While a finger presses, a robot that follows targets has two choices (`while_touched` in a scene). Its
actuators stay, so that the finger feels the stiffness of the robot; or it goes on to follow the
targets, and counteracts the known force. In the latter case a point that is held at a measured place
cannot follow a target: the finger decides where it is.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softrobot_twin.errors import CommandError
from softrobot_twin.mechanics.touch_loads import TouchLoads, TouchState
from softrobot_twin.simulation.building.model import Model
from softrobot_twin.simulation.command import Command, CommandSetpoints, FollowTargets, fitting
from softrobot_twin.simulation.state import State
from softrobot_twin.simulation.step.step_part import StepPart


class Touched(NamedTuple):
    """What is measured of the touches in a step.

    A touch has a force, or a place, or neither: then the point is not touched. A force of zero along
    all axes is no touch.

    Attributes:
        forces: Forces on the robot [N], NaN where none is measured, shape (touch_count, 3).
        places: Places of the touched points [m], NaN where none is measured, same shape.
    """

    forces: np.ndarray
    places: np.ndarray

    @classmethod
    def none(cls, count: int) -> Touched:
        """Nothing is measured of so many touches; the arrays may be filled.

        Args:
            count: Number of touches.
        """
        return cls(*np.full((2, count, 3), np.nan))

    def displace(self, index: int, displacement: np.ndarray, before: TouchState) -> None:
        """Fills the place of a touch in; a displacement of zero is no touch.

        Args:
            index: The touch.
            displacement: Of its point since its touch began [m], shape (3,).
            before: The touches before, which may have begun already.
        """
        if displacement.any():
            origins = before.origins if before.is_touched[index] else before.points
            self.places[index] = origins[index] + displacement

    @property
    def is_any(self) -> bool:
        """Whether any point is touched."""
        return bool(np.nan_to_num(self.forces).any() or (~np.isnan(self.places)).any())


def touch_term(model: Model) -> TouchLoads | None:
    """The force term of the touches of a scene; None without any.

    Args:
        model: The model of a simulation.
    """
    return model.force_term(TouchLoads)


class Touches(StepPart):
    """Reads the touches of each step of one scene."""

    name, takes = "touches", Touched

    def __init__(self, model: Model):
        """Take the term.

        Args:
            model: The built scene.
        """
        self._term = touch_term(model)
        self._points = self._rest = self._term.points(model.nodes.rest_positions)
        self._names = tuple(touch.name for touch in model.scene.touches)
        holds = [touch.while_touched == "hold_actuators" for touch in model.scene.touches]
        self._holds = np.array(holds)
        self._origins = np.empty((0, 3))

    def memory_at_rest(self) -> dict[str, np.ndarray]:
        """The fields of a `TouchState` that nothing touches."""
        count = len(self._names)
        return TouchState(
            np.zeros((count, 3)), np.full((count, 3), np.nan), self._rest.copy()
        )._asdict()

    def begin(self, state: State, measured: Touched | None) -> bool:
        """Set the loads of a step.

        Args:
            state: Where the step begins.
            measured: What is measured; None without any touch.

        Returns:
            Whether other points are held at their places than in the step before.

        Raises:
            CommandError: An array has another shape, or holds infinite values, or a touch has both a
                force and a place.
        """
        before, count = TouchState(**state.memory_of(self.name)), len(self._names)
        forces, places = np.zeros((count, 3)), np.full((count, 3), np.nan)
        if measured is not None:
            forces, places = self._checked(measured)
        is_held = np.isfinite(places).all(axis=1)
        forces = np.where(np.isfinite(forces).all(axis=1)[:, None], forces, 0.0)
        acts = is_held | (forces[:, :] * self._term.axes != 0.0).any(axis=1)
        begins = acts & ~before.is_touched
        self._origins = np.where(begins[:, None], before.points, before.origins)
        self._origins[~acts] = np.nan
        return self._term.load(np.where(is_held[:, None], before.forces, forces), places)

    def _checked(self, touched: Touched) -> tuple[np.ndarray, np.ndarray]:
        """Forces [N] and places [m], of the scene's shape and not infinite."""
        shape = len(self._names), 3
        forces = fitting("touch forces", touched.forces, shape, nan_allowed=True)
        places = fitting("touch places", np.array(touched.places), shape, nan_allowed=True)
        both = np.isfinite(forces).all(axis=1) & np.isfinite(places).all(axis=1)
        if both.any():
            name = self._names[int(np.argmax(both))]
            raise CommandError("touch forces", f"{name} has a force and a place: give one of them")
        return forces, places

    @property
    def samples(self) -> tuple[Touched, Touched]:
        """A force and a place that change nothing."""
        here = self._points
        none = np.full_like(here, np.nan)
        return Touched(np.zeros_like(here), none), Touched(none, here)

    def command(self, command: Command, state: State) -> Command:
        """The command that is carried out while the points are touched.

        Args:
            command: What is asked.
            state: Where the step begins.
        """
        acts = np.isfinite(self._origins).all(axis=1)
        if isinstance(command, FollowTargets) and (acts & self._holds).any():
            return CommandSetpoints(state.setpoints, command.time_step, command.reach_time)
        return command

    @property
    def holds_robot(self) -> bool:
        """Whether a finger holds a point at its place now."""
        return bool(self._term.is_held.any())

    def end(self, positions: np.ndarray, efforts: np.ndarray) -> dict[str, np.ndarray]:
        """The fields of the `TouchState` where a step ended."""
        forces = np.where(self._term.axes, self._term.forces(positions), 0.0)
        self._points = self._term.points(positions)
        return TouchState(forces, self._origins, self._points)._asdict()

    def may_keep(self, before: State, after: State) -> bool:
        """Whether nothing touches."""
        return not TouchState(**after.memory_of(self.name)).is_touched.any()

    @property
    def loads(self) -> np.ndarray:
        """Forces of the touches, of held points from before the step [N], shape (3 touch_count,); a copy."""
        return self._term.loads.ravel().copy()

    @property
    def load(self) -> float:
        """Sum of the forces of the step by magnitude [N], those of held points from before it."""
        return float(np.linalg.norm(self._term.loads, axis=1).sum())
