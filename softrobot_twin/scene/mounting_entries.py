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
    """Displacement of its origin."""
    turn: Angles = (0.0, 0.0, 0.0)
    """Rotation vector, about its origin."""


class MountedActuator(Entry):
    """Brings an actuator to where it is mounted."""

    told: ClassVar[tuple[str, ...]] = ("{actuator}", "to {displacement}", "to {tension} N")
    placed: ClassVar[dict[str, str]] = {}

    actuator: Name
    """The cable or hinge motor."""
    displacement: Annotated[float | None, unit("m or rad")] = None
    """Angle or shortening from the drawn shape."""
    tension: Annotated[float | None, unit("N", gt=0.0)] = None
    """To which a cable is wound, in place of a displacement."""

    def check(self) -> None:
        """Refuse what is not exactly one of both."""
        if (self.displacement is None) == (self.tension is None):
            raise ValueError("goes to a displacement or to a tension: give one of both")


class MountingStage(Entry):
    """Moves of a mounting that are made together."""

    told: ClassVar[tuple[str, ...]] = ("{bodies}", "{actuators}")
    placed: ClassVar[dict[str, str]] = {}

    bodies: tuple[MountedBody, ...] = ()
    """What is moved."""
    actuators: tuple[MountedActuator, ...] = ()
    """What is pulled or turned."""
    steps: Annotated[int, Field(ge=1, le=10_000)] = 5
    """Equilibria on the way, with the last."""

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
            if move.tension is not None:
                _check_tension(scene, f"{key}.actuators[{index}]", move)
    if scene.mounting and scene.slides:
        raise refusal("mounting", "(and slides)", "a scene with slides cannot be mounted yet")


def _check_tension(scene, key: str, move: MountedActuator) -> None:
    """Refuses a tension of what is no cable, above its limit, or beside other moves of the same cable."""
    cables = {cable.name: cable for cable in scene.cables}
    if move.actuator not in cables:
        raise refusal(f"{key}.tension", move.tension, f"is for cables, and {move.actuator} is none: "
                      "give a displacement")
    most = cables[move.actuator].tension[1]
    if move.tension > most:
        raise refusal(f"{key}.tension", move.tension, f"is more than {move.actuator} bears, {most:g} N")
    moves = [other for stage in scene.mounting for other in stage.actuators]
    if sum(other.actuator == move.actuator for other in moves) > 1:
        raise refusal(f"{key}.tension", move.tension, f"a cable that is wound to a tension is moved "
                      f"once, and {move.actuator} is moved by other entries too")
