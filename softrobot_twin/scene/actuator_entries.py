"""Entries of actuators: cables, slides, and motors that drive several cables.

Each kind of actuator has a section of its own in a scene. `add_actuator_section` in `schema.py`
gives a scene the section of a kind that is defined elsewhere.
"""

from __future__ import annotations

import math
from typing import Annotated, ClassVar, Literal

from pydantic import AfterValidator, Field, model_validator

from softrobot_twin.scene.entry import (
    Entry,
    Name,
    OpenNumber,
    OpenPull,
    OpenRange,
    Vector,
    check_range,
    refusal,
    unit,
)
from softrobot_twin.scene.references import check_carrier, check_known


class ActuatorEntry(Entry):
    """Base of the entries of all kinds of actuators.

    Attributes:
        noun: Name of one actuator of the kind in messages.
    """

    noun: ClassVar[str]

    name: Name

    def check_references(self, scene, key: str) -> None:
        """Refuses names of objects that the scene does not have.

        Args:
            scene: The scene.
            key: Key of this entry, such as ``cables[0]``.

        Raises:
            PydanticCustomError: A named object does not exist.
        """

    def check_body(self, scene, key: str) -> None:
        """Refuses an unknown `body`; without a name the only deformable body is meant."""
        deformable = [body.name for body in scene.deformables]
        rigid = [body.name for body in scene.rigid_bodies]
        check_carrier(f"{key}.body", self.name, self.body, deformable, rigid)


class Cable(ActuatorEntry):
    """A cable through the body, pulled at its pull point."""

    noun: ClassVar[str] = "cable"

    body: Name | None = None
    """The body it runs through; optional when there is only one."""
    frame: Literal["world", "mesh"] = "world"
    """Its points are coordinates of the world, or of its body's mesh before its placement."""
    pull_point: Vector
    pull_point_on: Name = "world"
    """``world``, ``body`` for its own body, or the name of a rigid body."""
    points: Annotated[tuple[Vector, ...], Field(min_length=1)]
    """Points of the body that the cable runs through, starting at the pull point."""
    hold_radius: Annotated[float, unit("m", ge=0.0)] = 0.0
    """At each point the force acts on the material within this radius, as with a washer. With 0 it
    acts on one point, whose displacement grows without bound as the mesh is refined."""
    shortening: Annotated[OpenRange, unit("m")] = (-math.inf, math.inf)
    """Limits of the shortening against the length at rest; infinite for no limit. The length of a
    cable cannot become negative."""
    rate: Annotated[OpenNumber | None, unit("m/s", gt=0.0)] = None
    """Greatest change of length per second; by default no limit."""
    tension: Annotated[OpenPull, unit("N")] = (0.0, math.inf)
    """Limits of the tension; a cable cannot push, so the lower limit is not negative."""

    @model_validator(mode="after")
    def _pulls(self):
        if self.tension[0] < 0.0:
            raise refusal("tension", self.tension,
                          "a cable cannot push: the least tension must not be negative")
        if not self.shortening[0] <= 0.0 <= self.shortening[1]:
            raise refusal("shortening", self.shortening,
                          "the shortening at rest, 0, must lie within its limits")
        return self

    def check_references(self, scene, key: str) -> None:
        """See `ActuatorEntry`."""
        self.check_body(scene, key)
        rigid = [body.name for body in scene.rigid_bodies]
        check_known(f"{key}.pull_point_on", f"cable {self.name} is pulled from",
                    self.pull_point_on, ["world", "body", *rigid])  # fmt: skip


class Motor(Entry):
    """Cables that are driven by one motor, all by the same length."""

    name: Name
    cables: Annotated[tuple[Name, ...], Field(min_length=1)]


class Slide(ActuatorEntry):
    """An actuator that moves a guided rigid body, and all nodes attached to it, along an axis."""

    noun: ClassVar[str] = "slide"

    body: Name
    axis: Annotated[tuple[float, float, float], unit("")]
    """Direction of positive positions, in the world."""
    travel: Annotated[tuple[float, float], AfterValidator(check_range), unit("m")]
    """Limits of its position; at rest it is at 0."""
    rate: Annotated[float | None, unit("m/s", gt=0.0)] = None
    """Greatest speed; by default no limit."""

    @model_validator(mode="after")
    def _can_rest(self):
        if not any(self.axis):
            raise ValueError("the axis of a slide must not be zero")
        if not self.travel[0] <= 0.0 <= self.travel[1]:
            raise ValueError("the position at rest, 0, must lie within its travel")
        return self

    def check_references(self, scene, key: str) -> None:
        """See `ActuatorEntry`."""
        guided = [body.name for body in scene.rigid_bodies if body.motion == "guided"]
        check_known(f"{key}.body", f"slide {self.name} moves", self.body, guided)
