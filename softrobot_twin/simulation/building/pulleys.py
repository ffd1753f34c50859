"""Pulleys that wind cables: angles [rad] beside the lengths [m] that the simulation uses.

At rest the angle θ is 0. A pulley of radius r that winds its cable up by turning in the sense s = ±1
has the angle θ = s (L_rest - L) / r when L of the cable is unwound, and holds it by the torque
s r λ [N m]. The pulley of a motor winds all its cables, each by the same length; its angle is that of
its first cable, as a motor's length is.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from softrobot_twin.scene import Scene
from softrobot_twin.scene.actuator_entries import Pulley
from softrobot_twin.simulation.building.actuator_kinds import Quantity

ANGLE = Quantity("angle", "rad")
TORQUE = Quantity("torque", "Nm")


def pulley_of_cable(scene: Scene) -> dict[str, Pulley]:
    """Pulley that winds each cable, by the cable's name; its own or that of its motor.

    Args:
        scene: The scene.
    """
    pulleys = {cable.name: cable.pulley for cable in scene.cables if cable.pulley is not None}
    for motor in scene.motors:
        if motor.pulley is not None:
            pulleys.update(dict.fromkeys(motor.cables, motor.pulley))
    return pulleys


def shortenings_of_angles(pulley: Pulley) -> np.ndarray:
    """Shortenings at the least and the greatest angle, in ascending order [m], shape (2,)."""
    return np.sort(np.array(pulley.angle) * pulley.wound)


class Pulleys:
    """The pulleys of a scene.

    Attributes:
        names: Their names: those of cables, then those of motors.
        driven: Indices among the actuators of the cables that each winds.
        is_wound: Whether each actuator is wound by a pulley, shape (actuator_count,).
        wound: Length that one radian winds up, negative where that takes a negative angle [m/rad],
            shape (count,).
    """

    def __init__(
        self, scene: Scene | None, actuator_names: Sequence[str], rest_setpoints: np.ndarray
    ):
        """Find what each pulley winds.

        Args:
            scene: The scene; None for no pulleys.
            actuator_names: Names of its actuators.
            rest_setpoints: Their setpoints at rest, of cables lengths [m],
                shape (actuator_count,).
        """
        places = {name: index for index, name in enumerate(actuator_names)}
        cables, motors = ((), ()) if scene is None else (scene.cables, scene.motors)
        own = [(cable.name, cable.pulley, (cable.name,)) for cable in cables]
        own += [(motor.name, motor.pulley, motor.cables) for motor in motors]
        own = [one for one in own if one[1] is not None]
        self.names = tuple(name for name, _, _ in own)
        self.driven = tuple(
            np.array([places[cable] for cable in cables]) for _, _, cables in own
        )
        self.is_wound = np.zeros(len(places), bool)
        for driven in self.driven:
            self.is_wound[driven] = True
        self.wound = np.array([pulley.wound for _, pulley, _ in own])
        self._first = np.array([driven[0] for driven in self.driven], np.int64)
        self._rest = np.array(rest_setpoints, float)

    @property
    def count(self) -> int:
        """Number of pulleys."""
        return len(self.names)

    def angles(self, setpoints: np.ndarray) -> np.ndarray:
        """Angle of each pulley [rad], shape (count,).

        Args:
            setpoints: Of all actuators, of cables lengths [m], shape (actuator_count,).
        """
        return (self._rest - setpoints)[self._first] / self.wound

    def torques(self, efforts: np.ndarray) -> np.ndarray:
        """Torque with which each pulley holds its cables, about its axis [N m], shape (count,).

        Args:
            efforts: Of all actuators, of cables tensions [N], shape (actuator_count,).
        """
        loads = np.array([efforts[driven].sum() for driven in self.driven])
        return loads * self.wound

    def lengths(self, pulley: int, angle: float) -> np.ndarray:
        """Length of each cable that a pulley winds, at an angle [m], shape (driven_count,).

        Args:
            pulley: Index of the pulley.
            angle: Its angle [rad].
        """
        return self._rest[self.driven[pulley]] - self.wound[pulley] * angle

    def tensions(self, pulley: int, torque: float) -> np.ndarray:
        """Tension of each cable, if all share the torque of their pulley alike [N].

        Args:
            pulley: Index of the pulley.
            torque: Torque about its axis [N m].

        Returns:
            Shape (driven_count,).
        """
        count = len(self.driven[pulley])
        return np.full(count, torque / self.wound[pulley] / count)
