"""The robot on an arm: its base moves in the world, and the model stays in the frame of the base.

With the rotation R of the base, the acceleration a of its origin, and its angular velocity ω and
acceleration α, all in the frame of the base, a mass m at x with the velocity v in that frame bears

    m (Rᵀ g - a - α × x - ω × (ω × x) - 2 ω × v).

R is the turn since the scene's own gravity held, the identity where the base has not moved. All but the
positions and velocities, which are those at the beginning of a step, are exact. A rigid body bears the
load at its centre of mass.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softrobot_twin.errors import CommandError
from softrobot_twin.geometry.shortened_vectors import shortened
from softrobot_twin.mechanics.gravity import Gravity
from softrobot_twin.mechanics.rotation import rotation_from_quaternion, vector_from_rotation
from softrobot_twin.simulation.building.deformable_body import of_kind
from softrobot_twin.simulation.building.model import Model
from softrobot_twin.simulation.building.reduced_body import ReducedBody
from softrobot_twin.simulation.state import State
from softrobot_twin.simulation.step.step_part import StepPart


class BaseMotion(NamedTuple):
    """How the base moves, in its own frame.

    Attributes:
        rotation: R, shape (3, 3).
        acceleration: a [m/s²], shape (3,).
        angular_velocity: ω [rad/s], shape (3,).
        angular_acceleration: α [rad/s²], shape (3,).
    """

    rotation: np.ndarray
    acceleration: np.ndarray
    angular_velocity: np.ndarray
    angular_acceleration: np.ndarray

    @classmethod
    def still(cls, rotation: np.ndarray | None = None) -> BaseMotion:
        """A base that does not move.

        Args:
            rotation: R, shape (3, 3); None for the identity.
        """
        return cls(np.eye(3) if rotation is None else rotation, *np.zeros((3, 3)))


class BaseTrack:
    """Accelerations of the base from poses at times, by differences.

    Attributes:
        motion: What the last poses tell.
    """

    def __init__(self, most: float, size: float = np.inf):
        """Know no pose.

        Args:
            most: Greatest acceleration that counts [m/s²]; what is more is shortened to it.
            size: Size of the robot, at whose end a turn accelerates by no more either [m].
        """
        self._most, self._most_spin = most, most / size if np.isfinite(size) else np.inf
        self.forget()

    def forget(self) -> None:
        """Know no pose again."""
        self.motion = BaseMotion.still()
        # Time, place, rotation, velocity and angular velocity in the world; None where unknown.
        self._last: tuple | None = None

    def see(self, position: np.ndarray, quaternion: np.ndarray | None, time: float) -> None:
        """Take a pose.

        Args:
            position: Origin of the base in the world [m], shape (3,).
            quaternion: Its rotation (x, y, z, w), shape (4,); None for none.
            time: When it was there [s]; an earlier one than the last begins anew.

        Raises:
            CommandError: The quaternion is no rotation, or the position not finite.
        """
        R = np.eye(3)
        if quaternion is not None:
            try:
                R = rotation_from_quaternion(np.asarray(quaternion, float))
            except ValueError as error:
                raise CommandError("base", str(error)) from None
        place, last = np.asarray(position, float), self._last
        if not np.isfinite(place).all():
            raise CommandError("base", f"its position {place.tolist()} is not finite")
        if last is None or time <= last[0]:
            self._last, self.motion = (time, place, R, None, None), BaseMotion.still(R)
            return
        h = time - last[0]
        velocity = (place - last[1]) / h
        turning = vector_from_rotation(R @ last[2].T) / h
        acceleration, spin = np.zeros((2, 3))
        if last[3] is not None:
            acceleration, spin = (velocity - last[3]) / h, (turning - last[4]) / h
        self._last = time, place, R, velocity, turning
        limits = self._most, np.sqrt(self._most_spin), self._most_spin
        felt = map(shortened, (acceleration, turning, spin), limits)
        self.motion = BaseMotion(R, *(R.T @ one for one in felt))


class MovingBase(StepPart):
    """Lets the bodies bear what a moving base does to them.

    Attributes:
        motion: How the base moves from now on.
        track: Makes that from poses.
    """

    name = "base"

    def __init__(self, model: Model):
        """Take the weights.

        Args:
            model: The built scene.
        """
        self._model, self._weight = model, model.force_term(Gravity)
        self._gravity, self._masses = np.array(model.scene.gravity), self._weight.masses
        self.entry = "moving_base.most_acceleration", str(model.scene.moving_base.most_acceleration)
        self.track = BaseTrack(model.scene.moving_base.most_acceleration, model.nodes.size)
        self.reset()

    @property
    def conflict(self) -> str:
        """See `StepPart`."""
        model = self._model
        cases = (
            (model.beams, "beams"), (model.superelements, "vertebrae"),
            (of_kind(model.bodies, ReducedBody), "reduced bodies"),
            (any(cavity.liquid_density for cavity in model.scene.cavities), "liquid in cavities"),
        )  # fmt: skip
        return next((word for is_there, word in cases if is_there), "")

    def memory_at_rest(self) -> dict[str, np.ndarray]:
        """See `StepPart`: the motion, and the acceleration of a mass at the origin [m/s²]."""
        return {**BaseMotion.still()._asdict(), "load": self._gravity[None].copy()}

    def begin(self, state: State, measured: object | None) -> bool:
        """See `StepPart`; writes the forces of the step."""
        forces, nodes = self._weight.forces, self._model.nodes
        places = np.zeros_like(forces)
        places[: len(nodes.free_nodes)] = state.positions[nodes.free_nodes]
        for frames in nodes.kinds:
            places[frames.translations] = state.positions[frames.origins]
        velocities = state.velocities if len(state.velocities) else np.zeros_like(forces)
        a, w, spin = self.motion[1:]
        felt = self._felt - np.cross(spin, places) - np.cross(w, np.cross(w, places))
        forces[:] = self._masses[:, None] * (felt - 2.0 * np.cross(w, velocities))
        return False

    @property
    def _felt(self) -> np.ndarray:
        """Acceleration of a mass at the origin that nothing holds [m/s²], shape (3,)."""
        return self.motion.rotation.T @ self._gravity - self.motion.acceleration

    def end(self, positions: np.ndarray, efforts: np.ndarray) -> dict[str, np.ndarray]:
        """See `StepPart`."""
        self._is_told = False
        return {**self.motion._asdict(), "load": self._felt[None]}

    def may_keep(self, before: State, after: State) -> bool:
        """See `StepPart`: whether the base does not turn, and accelerates as before."""
        turns = self.motion.angular_velocity.any() or self.motion.angular_acceleration.any()
        return not turns and super().may_keep(before, after)

    @property
    def loads(self) -> np.ndarray:
        """See `StepPart`: what a mass feels, and how the base turns, by the mass of the robot."""
        return self._masses.sum() * np.concatenate([self._felt, *self.motion[2:]])

    @property
    def load(self) -> float:
        """See `StepPart`."""
        return float(self._masses.sum() * np.linalg.norm(self._felt))

    def reset(self) -> None:
        """See `StepPart`: the base is where the scene's gravity holds."""
        self.track.forget()
        self.motion, self._is_told = self.track.motion, False

    def tell(self, position: np.ndarray, quaternion: np.ndarray | None, time: float) -> None:
        """Take a pose of the base; see `BaseTrack.see`."""
        self.track.see(position, quaternion, time)
        self.motion, self._is_told = self.track.motion, True

    def restore(self, state: State) -> None:
        """See `StepPart`; the base moves as in the step that led to the state, if nothing came since."""
        if self._is_told:
            return
        memory = state.memory_of(self.name)
        self.motion = BaseMotion(*(memory[field] for field in BaseMotion._fields))
