"""Entries of actuators: cables, cavities, slides, motors of hinges, forces, muscles, and motors that
drive several cables.

Each kind of actuator has a section of its own in a scene. `add_actuator_section` in `schema.py`
gives a scene the section of a kind that is defined elsewhere.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from softrobot_twin.scene.body_entries import BoxRegion, SphereRegion
from softrobot_twin.scene.entry import (
    FRAMED,
    ClosedRange,
    Direction,
    Entry,
    Name,
    NamedEntry,
    OnBody,
    OpenNumber,
    OpenPull,
    OpenRange,
    Vector,
    allows_zero,
    not_below_zero,
    not_zero,
    refusal,
    unit,
)
from softrobot_twin.scene.references import names_in

# Greatest range of the angle of a hinge [rad]: less than a whole turn.
MOST_TURN = 6.0
NO_LIMITS, POSITIVE = (-math.inf, math.inf), (0.0, math.inf)
_CANNOT_PUSH = "a cable cannot push: the least tension must not be negative"


class ActuatorEntry(NamedEntry):
    """Base of the entries of all kinds of actuators.

    Attributes:
        noun: Name of one actuator of the kind in messages.
    """

    noun: ClassVar[str]

    def check_references(self, scene, key: str) -> None:
        """Refuses names of objects that the scene does not have.

        Args:
            scene: The scene.
            key: Key of this entry, such as ``cables[0]``.

        Raises:
            PydanticCustomError: A named object does not exist.
        """


class Pulley(Entry):
    """A pulley on a motor's shaft that winds cables."""

    told: ClassVar[tuple[str, ...]] = ("by a pulley of radius {radius:mm} mm",)

    radius: Annotated[float, unit("m", gt=0.0)]
    """To the middle of the cable."""
    winds: Literal["positive", "negative"] = "positive"
    """Sense of rotation that shortens the cable."""
    angle: Annotated[OpenRange, unit("rad"), allows_zero("the angle at rest")] = NO_LIMITS
    """Limits of the angle, 0 at rest."""
    rate: Annotated[OpenNumber | None, unit("rad/s", gt=0.0)] = None
    """Greatest speed."""

    @property
    def wound(self) -> float:
        """Length that one radian winds up [m/rad], negative where that takes a negative angle."""
        return self.radius if self.winds == "positive" else -self.radius


class Cable(OnBody, ActuatorEntry):
    """A cable through the body, pulled at its pull point."""

    noun: ClassVar[str] = "cable"
    placed: ClassVar[dict[str, str]] = {"pull_point": "point", "points": "point"}

    also_on: tuple[str, ...] = ()
    """Further bodies, or patterns such as ``rib_*``; the nearest carries each point."""
    frame: Literal["world", "mesh"] = "world"
    """Frame of its points; `mesh` is before the placement."""
    pull_point: Vector
    """Its winch or motor, at rest."""
    pull_point_on: Name = "world"
    """``body`` for its own bodies, or a rigid body."""
    points: Annotated[tuple[Vector, ...], Field(min_length=1)]
    """Its path, from the pull point on."""
    wraps: tuple[Name, ...] = ()
    """Capsules or cylinders that it is laid around, one between two points."""
    hold_radius: Annotated[float, unit("m", ge=0.0)] = 0.0
    """Radius over which a point holds the material. With 0 finer meshes yield more."""
    shortening: Annotated[OpenRange, unit("m"), allows_zero("the shortening at rest")] = NO_LIMITS
    """Limits of the shortening from rest."""
    rate: Annotated[OpenNumber | None, unit("m/s", gt=0.0)] = None
    """Greatest speed."""
    tension: Annotated[OpenPull, unit("N"), not_below_zero(_CANNOT_PUSH)] = POSITIVE
    """Its limits; the lower is not negative."""
    pulley: Pulley | None = None
    """Its pulley: commands and measurements by angle."""
    axial_stiffness: Annotated[OpenNumber | None, unit("N", gt=0.0)] = None
    """EA: tension by strain; by default it does not stretch."""
    friction: Annotated[float, unit("", ge=0.0)] = 0.0
    """µ at points and wraps: the tension falls by exp(-µβ) at a turn by β."""
    offset: Annotated[float, unit("m")] = 0.0
    """Measured less true length."""
    presliding: Annotated[float | None, unit("m", gt=0.0)] = None
    """Motion until friction acts; by default a thousandth of the length."""

    def check(self) -> None:
        """Refuse presliding without friction, and what is not built around obstacles."""
        if self.wraps and self.axial_stiffness is not None:
            raise refusal("axial_stiffness", self.axial_stiffness, "is not built for a cable that wraps obstacles")
        if self.presliding is not None and not self.friction:
            raise refusal("presliding", self.presliding,
                          "is how friction builds up, but the cable has none: give friction")


class CavityWall(Entry):
    """A closed surface that encloses gas or liquid: a file, or a part of a mesh."""

    placed: ClassVar[dict[str, str]] = {}

    body: Name | None = None
    """Its body."""
    also_on: tuple[Name, ...] = ()
    """Other bodies of the wall; the nearest carries each vertex."""
    part: str | None = None
    """Name of triangles in the file of the body's mesh."""
    file: Path | None = None
    """Surface mesh, placed like the body's own mesh."""
    scale: Annotated[float, unit("m per file unit", gt=0.0)] = 1.0
    """Scale of the file."""

    def check(self) -> None:
        """Refuse what is not exactly one source, and keys that have no effect on it."""
        if (self.part is None) == (self.file is None):
            raise ValueError("a wall of a cavity is either a part of its body's mesh or a file")
        if self.also_on and self.file is None:
            raise refusal("also_on", list(self.also_on), "a part of one body's mesh lies on that body; give a file")


class WalledEntry(NamedEntry):
    """A cavity: what its walls enclose."""

    placed: ClassVar[dict[str, str]] = {}

    walls: Annotated[tuple[CavityWall, ...], Field(min_length=1)]
    """Closed surfaces with one pressure; volumes sum up."""


class Cavity(WalledEntry, ActuatorEntry):
    """A cavity that is inflated: by a pressure, or by a volume."""

    noun: ClassVar[str] = "cavity"

    control: Literal["pressure", "volume"] = "pressure"
    """A pressure by a regulator, or a volume by a syringe."""
    pressure: Annotated[OpenRange, unit("Pa"), allows_zero("the gauge pressure at rest")] = POSITIVE
    """Gauge; negative allows a vacuum."""
    pressure_offset: Annotated[float, unit("Pa")] = 0.0
    """What is measured at gauge pressure 0."""
    pressure_gain: Annotated[float, unit("", gt=0.0)] = 1.0
    """Gauge pressure by measured pressure less `pressure_offset`."""
    volume: Annotated[OpenRange, unit("m³"), not_below_zero("a volume is not negative")] = POSITIVE
    """Limits of the volume."""
    growth: Annotated[OpenRange, unit("m³"), allows_zero("the growth at rest")] = NO_LIMITS
    """Limits of the change from rest."""
    rate: Annotated[OpenNumber | None, unit("Pa/s or m³/s", gt=0.0)] = None
    """Greatest change of the command per second."""
    flow: Annotated[OpenNumber | None, unit("m³/s", gt=0.0)] = None
    """Greatest flow under pressure."""
    liquid_density: Annotated[float | None, unit("kg/m³", gt=0.0)] = None
    """Of its liquid; by default gas. The pressure counts at its highest point at rest."""

    def check(self) -> None:
        """Refuse a flow where the volume is commanded."""
        if self.flow is not None and self.control == "volume":
            raise refusal("flow", self.flow, "the volume is commanded: give its greatest change per second as rate")


class SealedCavity(WalledEntry):
    """A cavity without a valve, at constant temperature."""

    pressure: Annotated[float, unit("Pa")] = 0.0
    """Gauge pressure at rest."""
    ambient_pressure: Annotated[float, unit("Pa", ge=0.0)] = 101_325.0
    """Absolute pressure around it."""

    def check(self) -> None:
        """Refuse a pressure below that of a vacuum."""
        if self.pressure + self.ambient_pressure <= 0.0:
            raise refusal("pressure", self.pressure, "the absolute pressure of a gas is above zero")


class Motor(NamedEntry):
    """Cables that are driven by one motor, all by the same length."""

    told: ClassVar[tuple[str, ...]] = ("shortens {cables}", "{pulley}")
    placed: ClassVar[dict[str, str]] = {}

    cables: Annotated[tuple[Name, ...], Field(min_length=1)]
    """Its cables."""
    pulley: Pulley | None = None
    """Pulley that winds them all."""


class Slide(ActuatorEntry):
    """Moves a guided rigid body, and nodes attached to it, along an axis."""

    noun: ClassVar[str] = "slide"
    placed: ClassVar[dict[str, str]] = {"axis": "direction"}

    body: Name
    """The guided rigid body that it moves."""
    axis: Annotated[Direction, not_zero("the axis of a slide must not be zero")]
    """Direction of positive positions, in the world."""
    travel: Annotated[ClosedRange, unit("m"), allows_zero("the position at rest", "its travel")]
    """Limits of its position, 0 at rest."""
    rate: Annotated[float | None, unit("m/s", gt=0.0)] = None
    """Greatest speed."""


class HingeMotor(ActuatorEntry):
    """Turns a beam about the hinge at one of its points."""

    noun: ClassVar[str] = "hinge motor"
    placed: ClassVar[dict[str, str]] = {}

    beam: Name
    """The beam that it turns."""
    at: Literal["start", "end"] | Annotated[int, Field(ge=0)]
    """The point of the beam with the hinge."""
    angle: Annotated[ClosedRange, unit("rad"), allows_zero("the angle at rest")]
    """Limits of its angle, 0 at rest, about the hinge's axis."""
    offset: Annotated[float, unit("rad")] = 0.0
    """Measured less true angle."""
    rate: Annotated[float | None, unit("rad/s", gt=0.0)] = None
    """Greatest speed."""
    torque: Annotated[OpenRange, unit("N m"), allows_zero("no torque")] = NO_LIMITS
    """Limits of its torque on the beam."""
    stiffness: Annotated[float | None, unit("N m/rad", gt=0.0)] = None
    """Of motor and gear; by default they do not yield."""

    def check(self) -> None:
        """Refuse limits that are a turn or more apart."""
        if self.angle[1] - self.angle[0] > MOST_TURN:
            raise refusal("angle", self.angle,
                          f"the limits must be at most {MOST_TURN:g} rad apart: an angle is known "
                          "up to whole turns")


class Force(OnBody, ActuatorEntry):
    """A force on a body: of a magnet, a thruster, a tendon outside the model, a person."""

    noun: ClassVar[str] = "force"
    placed: ClassVar[dict[str, str]] = {"points": "point", "box": "box", "sphere": "inside", "direction": "direction"}
    one_of: ClassVar[tuple[str, ...]] = ("points", "box", "sphere")
    one_of_words: ClassVar[str] = "a force acts at exactly one of {}"

    points: Annotated[tuple[Vector, ...] | None, Field(min_length=1)] = None
    """Places at rest."""
    shares: tuple[Annotated[float, unit("", gt=0.0)], ...] | None = None
    """Share of each point; by default alike."""
    box: BoxRegion | None = None
    """The surface of a deformable body in it shares the force by area."""
    sphere: SphereRegion | None = None
    """The same in a sphere."""
    direction: Annotated[Direction | None, not_zero("the direction must not be zero")] = None
    """In the world at rest. By default free: `name_x`, `name_y`, `name_z`."""
    turns_with_body: bool = False
    """Whether its direction turns with its points."""
    control: Literal["force", "displacement"] = "force"
    """What is commanded: force, or displacement along its direction."""
    force: Annotated[OpenRange, unit("N"), allows_zero("no force")] = NO_LIMITS
    """Limits of the force."""
    displacement: Annotated[OpenRange, unit("m"), allows_zero("the place at rest")] = NO_LIMITS
    """Limits of the displacement."""
    rate: Annotated[OpenNumber | None, unit("N/s or m/s", gt=0.0)] = None
    """Greatest change of the command per second."""

    def check(self) -> None:
        """Refuse shares of other points, and displacements along a direction that turns: they depend on the way."""
        if self.shares is not None and len(self.shares) != len(self.points or ()):
            raise refusal("shares", list(self.shares), "needs a number for each of points")
        for key, usual in (("control", "force"), ("displacement", NO_LIMITS)):
            if self.turns_with_body and getattr(self, key) != usual:
                raise refusal(key, getattr(self, key),
                              "a direction that turns with the body has no displacement of its "
                              "own: command and limit the force")

    def check_references(self, scene, key: str) -> None:
        """See `ActuatorEntry`."""
        if self.points is None and self.body not in (None, *names_in(scene, "deformables")):
            raise refusal(f"{key}.body", self.body,
                          "a box or sphere takes the surface of a deformable body: give points")


class ForceLength(Entry):
    """The bell of living muscle: its force by its length."""

    told: ClassVar[tuple[str, ...]] = ("a bell of {width:=} about {optimum:=}",)

    optimum: Annotated[float, unit("", gt=0.0)] = 1.0
    """Length of its greatest force, by its length at rest."""
    width: Annotated[float, unit("", gt=0.0)] = 0.67
    """Change of length at which 1/e of the force is left."""


class Muscle(OnBody, ActuatorEntry):
    """Fibres that contract by their activation: a thread through a body, or a part of the body."""

    noun: ClassVar[str] = "muscle"
    placed: ClassVar[dict[str, str]] = {"points": "point", "box": "box", "direction": "direction"}
    one_of: ClassVar[tuple[str, ...]] = ("points", "box", "region")
    one_of_words: ClassVar[str] = "a muscle is exactly one of {}"

    also_on: tuple[str, ...] = ()
    """Other bodies of a thread, or patterns such as ``rib_*``; the nearest carries each point."""
    points: Annotated[tuple[Vector, ...] | None, Field(min_length=2)] = None
    """Path of a thread, bonded at its points."""
    box: BoxRegion | None = None
    """Cells whose centre is in it contract along `direction`."""
    region: str | None = None
    """The same of a named volume in the mesh file."""
    frame: Literal["world", "mesh"] = "world"
    """Frame of the box; `mesh` is before the placement."""
    direction: Annotated[Direction | None, not_zero("the direction must not be zero")] = None
    """Of the fibres of a box or region, in the world at rest."""
    force: Annotated[float | None, unit("N", gt=0.0)] = None
    """Of a thread at rest, fully active."""
    stress: Annotated[float | None, unit("Pa", gt=0.0)] = None
    """The same of a box or region."""
    free_contraction: Annotated[float | None, unit("", gt=0.0, lt=1.0)] = None
    """Share by which it shortens without load; by default its force is constant."""
    force_length: ForceLength | None = None
    """Of living muscle, in place of `free_contraction`."""
    activation: Annotated[ClosedRange, unit(""), allows_zero("no activation")] = (0.0, 1.0)
    """Limits of its activation."""
    rate: Annotated[float | None, unit("1/s", gt=0.0)] = None
    """Greatest change of the activation per second."""

    def check(self) -> None:
        """Refuse what does not belong to a thread, or to a region, and two relations."""
        is_thread = self.points is not None
        noun, needed, others = (("thread", ("force",), ("stress", "direction")) if is_thread else
                                ("region", ("stress", "direction"), ("force", "also_on")))  # fmt: skip
        for key in needed:
            if getattr(self, key) is None:
                raise refusal(key, "(nothing)", f"is required of a {noun}")
        for key in others:
            if getattr(self, key):
                raise refusal(key, getattr(self, key), f"is not a key of a {noun}")
        if self.free_contraction is not None and self.force_length is not None:
            raise refusal("free_contraction", self.free_contraction,
                          "force_length says how the force depends on the length")
        if self.activation[0] < 0.0 or self.activation[1] > 1.0:
            raise refusal("activation", self.activation, "the limits must lie within 0 and 1")

    def check_references(self, scene, key: str) -> None:
        """See `ActuatorEntry`."""
        if self.points is None and self.body in names_in(scene, *FRAMED):
            raise refusal(f"{key}.body", self.body, "a region is of a deformable body: give points")


class RestShape(ActuatorEntry):
    """Changes the rest shape of a beam: memory alloys, pneumatic or grown lengths."""

    noun: ClassVar[str] = "rest shape"
    placed: ClassVar[dict[str, str]] = {}
    one_of: ClassVar[tuple[str, ...]] = ("bend", "bend_sideways", "twist", "elongation")

    beam: Name
    """It changes evenly over its length."""
    bend: Annotated[ClosedRange | None, unit("rad"), allows_zero("the shape at rest")] = None
    """Limits of the angle between its ends, towards the `thickness_direction`."""
    bend_sideways: Annotated[ClosedRange | None, unit("rad"), allows_zero("the shape at rest")] = None
    """The same towards `thickness_direction` × tangent."""
    twist: Annotated[ClosedRange | None, unit("rad"), allows_zero("the shape at rest")] = None
    """The same about its axis."""
    elongation: Annotated[ClosedRange | None, unit("m"), allows_zero("the length at rest")] = None
    """Limits of the change of its length without load."""
    rate: Annotated[float | None, unit("rad/s or m/s", gt=0.0)] = None
    """Greatest change per second."""

    @property
    def change(self) -> str:
        """Which of `one_of` it changes."""
        return self.given(self.one_of)[0]


class Stiffener(OnBody, ActuatorEntry):
    """Changes Young's modulus of a part of a body: jamming, a phase change."""

    noun: ClassVar[str] = "stiffener"
    placed: ClassVar[dict[str, str]] = {"box": "box"}
    carriers: ClassVar[tuple[str, ...]] = ()

    region: str | None = None
    """A volume that an entry of `materials` names; by default the body."""
    box: BoxRegion | None = None
    """The cells whose centre is in it, in place of a region."""
    frame: Literal["world", "mesh"] = "world"
    """Frame of the box; `mesh` is before the placement."""
    young_modulus: Annotated[ClosedRange, unit("Pa")]
    """Limits of the modulus, at rest the material's."""
    rate: Annotated[float | None, unit("Pa/s", gt=0.0)] = None
    """Greatest change of the modulus per second."""

    def check(self) -> None:
        """Refuse two places, and a modulus of zero."""
        if self.region is not None and self.box is not None:
            raise refusal("box", str(self.box), "the cells are those of region: give one of both")
        if self.young_modulus[0] <= 0.0:
            raise refusal("young_modulus", self.young_modulus, "the limits must be above zero")
