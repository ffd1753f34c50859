"""How a robot is assembled: from the shape that its scene draws to the one in which it rests."""

from __future__ import annotations

from typing import Annotated, ClassVar

from pydantic import Field

from softrobot_twin.scene.entry import Angles, Entry, Name, Vector, refusal, unit
from softrobot_twin.scene.references import check_known

MOUNTED_ACTUATORS = ("cables", "hinge_motors")
"""Sections whose actuators a mounting can set."""


class MountedBody(Entry):
    """Brings a fixed or guided rigid body to where it is mounted."""

    told: ClassVar[tuple[str, ...]] = ("{body}", "by {translation:mm} mm", "turned by {turn} rad")
    placed: ClassVar[dict[str, str]] = {"translation": "direction", "turn": "direction"}

    body: Name
    """The rigid body."""
    translation: Vector = (0.0, 0.0, 0.0)
    """Displacement of its origin, on a straight line."""
    turn: Angles = (0.0, 0.0, 0.0)
    """Rotation vector in the world, by which it is turned about its origin at the same time."""


class MountedActuator(Entry):
    """Brings an actuator to the displacement at which it is mounted."""

    told: ClassVar[tuple[str, ...]] = ("{actuator} to {displacement}",)
    placed: ClassVar[dict[str, str]] = {}

    actuator: Name
    """The cable or hinge motor."""
    displacement: Annotated[float, unit("m or rad")]
    """Its displacement from the drawn shape: the angle of a motor [rad], the shortening of a cable [m]."""


class MountingStage(Entry):
    """Moves of a mounting that are made together."""

    told: ClassVar[tuple[str, ...]] = ("{bodies}", "{actuators}")
    placed: ClassVar[dict[str, str]] = {}

    bodies: tuple[MountedBody, ...] = ()
    """What is moved."""
    actuators: tuple[MountedActuator, ...] = ()
    """What is pulled or turned."""
    steps: Annotated[int, Field(ge=1, le=10_000)] = 5
    """Equilibria on the way, the last one included."""

    def check(self) -> None:
        """Refuse a stage that moves nothing."""
        if not (self.bodies or self.actuators):
            raise ValueError("moves nothing: give bodies or actuators")


def check_mounting(scene) -> None:
    """Refuses a mounting that moves what is not there, or what cannot be moved.

    Args:
        scene: The scene.

    Raises:
        PydanticCustomError: A name is not that of a fixed or guided body, or of such an actuator.
    """
    motions = {body.name: body.motion for body in scene.rigid_bodies}
    known = [entry.name for section in MOUNTED_ACTUATORS for entry in getattr(scene, section)]
    for key, stage in scene.keyed("mounting"):
        for index, move in enumerate(stage.bodies):
            check_known(f"{key}.bodies[{index}].body", "mounting moves", move.body, list(motions))
            if motions[move.body] == "free":
                raise refusal(f"{key}.bodies[{index}].body", move.body,
                              "moves by forces alone: only fixed and guided bodies are moved")
        for index, move in enumerate(stage.actuators):
            check_known(f"{key}.actuators[{index}].actuator", "mounting sets", move.actuator, known)
    if scene.mounting and scene.slides:
        raise refusal("mounting", "(and slides)", "a scene with slides cannot be mounted yet")
