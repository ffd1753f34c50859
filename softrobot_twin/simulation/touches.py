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
from softrobot_twin.mechanics.touch_loads import TouchLoads
from softrobot_twin.simulation.command import Command, CommandSetpoints, FollowTargets
from softrobot_twin.simulation.model import Model
from softrobot_twin.simulation.state import State


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

    @property
    def is_any(self) -> bool:
        """Whether any point is touched."""
        return bool(np.nan_to_num(self.forces).any() or (~np.isnan(self.places)).any())


class TouchState(NamedTuple):
    """What a step needs to know of the touches before it, and tells of those in it.

    Attributes:
        forces: Forces on the robot [N], zero along axes without touch, shape (touch_count, 3).
        origins: Where each touched point was when its touch began [m], NaN where there is no touch,
            same shape.
        points: Where the points are now [m], same shape.
    """

    forces: np.ndarray
    origins: np.ndarray
    points: np.ndarray

    @property
    def is_touched(self) -> np.ndarray:
        """Whether each point is touched, shape (touch_count,)."""
        return np.isfinite(self.origins).all(axis=1)

    @property
    def displacements(self) -> np.ndarray:
        """Displacement of each point since its touch began [m], zero without a touch, shape
        (touch_count, 3)."""
        return np.where(self.is_touched[:, None], self.points - self.origins, 0.0)


def touch_term(model: Model) -> TouchLoads | None:
    """The force term of the touches of a scene; None without any."""
    terms = (term.on_points for term in model.forces)
    return next((term for term in terms if isinstance(term, TouchLoads)), None)


class Touches:
    """Reads the touches of each step of one scene."""

    def __init__(self, model: Model, term: TouchLoads):
        """Take the term.

        Args:
            model: The built scene.
            term: Its force term of touches.
        """
        self._term, self.names = term, tuple(touch.name for touch in model.scene.touches)
        holds = [touch.while_touched == "hold_actuators" for touch in model.scene.touches]
        self._holds = np.array(holds)
        self._origins = np.empty((0, 3))

    def untouched(self, positions: np.ndarray) -> TouchState:
        """The touches of a state [m] that nothing touches."""
        count = len(self.names)
        return TouchState(
            np.zeros((count, 3)), np.full((count, 3), np.nan), self._term.points(positions)
        )

    def begin(self, touched: Touched | None, state: State) -> bool:
        """Set the loads of a step.

        Args:
            touched: What is measured; None without any touch.
            state: Where the step begins.

        Returns:
            Whether other points are held at their places than in the step before.

        Raises:
            CommandError: An array has another shape, or holds infinite values, or a touch has both a
                force and a place.
        """
        before, count = state.touches, len(self.names)
        forces, places = np.zeros((count, 3)), np.full((count, 3), np.nan)
        if touched is not None:
            forces, places = self._checked(touched)
        is_held = np.isfinite(places).all(axis=1)
        forces = np.where(np.isfinite(forces).all(axis=1)[:, None], forces, 0.0)
        acts = is_held | (forces[:, :] * self._term.axes != 0.0).any(axis=1)
        begins = acts & ~before.is_touched
        self._origins = np.where(begins[:, None], before.points, before.origins)
        self._origins[~acts] = np.nan
        return self._term.load(np.where(is_held[:, None], before.forces, forces), places)

    def _checked(self, touched: Touched) -> tuple[np.ndarray, np.ndarray]:
        """Forces [N] and places [m], of the scene's shape and not infinite."""
        shape, checked = (len(self.names), 3), []
        for name, array in zip(("touch forces", "touch places"), touched, strict=True):
            array = np.array(array, dtype=float)
            if array.shape != shape:
                raise CommandError(name, f"must have shape {shape}, not {array.shape}")
            if np.isinf(array).any():
                raise CommandError(name, f"holds {array[np.isinf(array)][0]}")
            checked.append(array)
        forces, places = checked
        both = np.isfinite(forces).all(axis=1) & np.isfinite(places).all(axis=1)
        if both.any():
            name = self.names[int(np.argmax(both))]
            raise CommandError("touch forces", f"{name} has a force and a place: give one of them")
        return forces, places

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
    def hold_points(self) -> bool:
        """Whether a finger holds a point at its place now: there the robot shows no stiffness of its
        own."""
        return bool(self._term.is_held.any())

    def end(self, positions: np.ndarray) -> TouchState:
        """The touches where a step ended, at node positions [m]."""
        forces = np.where(self._term.axes, self._term.forces(positions), 0.0)
        return TouchState(forces, self._origins, self._term.points(positions))

    @property
    def loads(self) -> np.ndarray:
        """Forces of the touches, of held points from before the step [N], shape (3 touch_count,); a copy."""
        return self._term.loads.ravel().copy()

    @property
    def load(self) -> float:
        """Sum of the forces of the step by magnitude [N], those of held points from before it."""
        return float(np.linalg.norm(self._term.loads, axis=1).sum())
