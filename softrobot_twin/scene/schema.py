"""The entries of a scene. All values are SI; unknown keys are refused by name."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field, PrivateAttr
from pydantic.fields import FieldInfo
from scipy.spatial.transform import Rotation

from softrobot_twin.errors import SceneError
from softrobot_twin.scene.actuator_entries import (
    ActuatorEntry,
    Cable,
    Cavity,
    Force,
    HingeMotor,
    Motor,
    Muscle,
    RestShape,
    SealedCavity,
    Slide,
    Stiffener,
)
from softrobot_twin.scene.body_entries import (
    Beam,
    Body,
    Fibre,
    MassSpringBody,
    Obstacle,
    RigidBody,
    Shaped,
    Spring,
    Tube,
)
from softrobot_twin.scene.entry import (
    Acceleration,
    Angles,
    Entry,
    Name,
    NamedEntry,
    OnBody,
    OpenNumber,
    Vector,
    forms_of,
    is_entry,
    not_zero,
    refusal,
    unit,
)
from softrobot_twin.scene.mounting_entries import MountingStage, check_mounting
from softrobot_twin.scene.patterns import Source
from softrobot_twin.scene.references import check_names, check_references
from softrobot_twin.scene.sensor_entries import Sensor
from softrobot_twin.scene.shapes import ShapeEntry
from softrobot_twin.scene.words import number
from softrobot_twin.solvers import FACTORIZATIONS


class Touching(Entry):
    """Two bodies that may touch."""

    placed: ClassVar[dict[str, str]] = {}

    pair: tuple[Name, Name]
    """Two bodies or obstacles; a name twice for self-contact."""
    friction: Annotated[float | None, unit("", ge=0.0)] = None
    """µ of the pair; by default `contact.friction`."""
    least_force: Annotated[float | None, unit("N", gt=0.0)] = None
    """Least sum of normal forces while targets are followed."""
    least_grip_margin: Annotated[float | None, unit("", gt=0.0, lt=1.0)] = None
    """Least share of friction that is left, 1 - Σ |λ_t| / Σ µ λ_n; targets give way."""


class TouchingPoint(Entry):
    """A point that may touch one triangle of the same body."""

    placed: ClassVar[dict[str, str]] = {"point": "point", "against": "point"}

    on: Name | None = None
    """Its body."""
    point: Vector
    """The nearest node counts."""
    against: Vector
    """The nearest triangle counts."""


class Contact(Entry):
    """Which bodies may touch, and how contact is solved."""

    told: ClassVar[tuple[str, ...]] = (
        "candidates below {alarm_distance:=mm} mm", "contact below {contact_distance:=mm} mm",
        "tolerance {tolerance:=} m",
    )  # fmt: skip

    between: tuple[Touching, ...] = ()
    """Pairs that may touch; all others pass through each other."""
    points: tuple[TouchingPoint, ...] = ()
    """Points that may touch given triangles of the same body."""
    friction: Annotated[float, unit("", ge=0.0)] = 0.0
    """µ of other pairs."""
    alarm_distance: Annotated[float, unit("m", gt=0.0)] = 0.003
    """Nearer features become contact candidates."""
    contact_distance: Annotated[float, unit("m", ge=0.0)] = 0.0
    """Features this near are in contact."""
    force_limit: Annotated[float | None, unit("N", gt=0.0)] = None
    """Greatest force of one contact in the inverse problem."""
    push_out_speed: Annotated[float, unit("m/s", gt=0.0)] = 0.05
    """Speed at which overlapping bodies are separated."""
    tolerance: Annotated[float, unit("m", gt=0.0)] = 1.0e-8
    """Greatest residual of gaps and sticking."""
    most_sweeps: Annotated[int, Field(ge=1, le=100_000)] = 1000
    """Most sweeps over all contacts."""

    def check(self) -> None:
        """Refuse a section without pairs, and distances that are not in order."""
        if not self.between and not self.points:
            raise ValueError("has no pairs: between or points is required")
        if self.contact_distance >= self.alarm_distance:
            raise ValueError("contact_distance must be below alarm_distance")
        for index, entry in enumerate(self.between):
            friction = self.friction_of(entry)
            if entry.least_grip_margin is not None and not friction:
                raise refusal(f"between[{index}].least_grip_margin", entry.least_grip_margin,
                              "the pair has no friction that could be left")
            if entry.least_force is not None and not friction:
                raise refusal(f"between[{index}].least_force", entry.least_force,
                              "is not built for a pair without friction")

    def friction_of(self, entry: Touching) -> float:
        """µ of a pair.

        Args:
            entry: The pair.
        """
        return self.friction if entry.friction is None else entry.friction


class Marker(Entry):
    """A point of a body that a camera observes."""

    placed: ClassVar[dict[str, str]] = {"id": "numbers", "point": "point"}

    id: Annotated[int, Field(ge=0, lt=2**32)]
    """Its number in messages of markers."""
    body: Name | None = None
    """Its body."""
    point: Vector
    """Where it is at rest."""


_Scale = Annotated[float, unit("", gt=0.5, lt=2.0)]


class MarkerFrame(Entry):
    """Frame of the cameras that measure the markers."""

    position: Vector = (0.0, 0.0, 0.0)
    """Its origin, in the frame of the robot."""
    rotation: Angles = (0.0, 0.0, 0.0)
    """Angles about the robot's axes."""
    scale: Annotated[tuple[_Scale, _Scale, _Scale], unit("")] = (1.0, 1.0, 1.0)
    """What they measure of a unit length along each axis."""

    @property
    def is_usual(self) -> bool:
        """Whether the cameras measure in the frame of the robot."""
        return not any((*self.position, *self.rotation)) and self.scale == (1.0, 1.0, 1.0)

    def of_robot(self, points: np.ndarray) -> np.ndarray:
        """Measured points in the frame of the robot [m], shape (..., 3).

        Args:
            points: In the frame of the cameras [m], shape (..., 3).
        """
        return points if self.is_usual else points / self.scale @ self._turn.T + self.position

    def of_cameras(self, points: np.ndarray) -> np.ndarray:
        """Points in the frame of the cameras, the inverse of `of_robot`.

        Args:
            points: In the frame of the robot [m], shape (..., 3).
        """
        return points if self.is_usual else (points - self.position) @ self.to_cameras

    @property
    def to_cameras(self) -> np.ndarray:
        """What a vector of the robot is multiplied with from the right, shape (3, 3)."""
        return self._turn * self.scale

    @property
    def _turn(self) -> np.ndarray:
        return Rotation.from_euler("xyz", self.rotation).as_matrix()


WantedStiffness = Annotated[float | None, unit("N/m", gt=0.0)]


class EffectorOrientation(Entry):
    """How the body shall be turned from rest."""

    pointing: Annotated[Vector | None, not_zero("must not be zero: it is a direction")] = None
    """Axis whose direction counts; by default the whole rotation."""
    points: tuple[Vector, ...] = ()
    """Three or more, whose best-fit rotation counts. A rigid body needs none."""
    weight: Annotated[float, unit("", gt=0.0)] = 1.0
    """Weight of the error of the orientation."""
    length_per_radian: Annotated[float | None, unit("m/rad", gt=0.0)] = None
    """What counts as one radian; by default the robot's size."""

    def describe(self) -> str:
        """What is asked for, and how it is weighed."""
        asked = self.phrase("axis {pointing} pointing") or "orientation"
        patch = self.phrase(" of {points:#point}") if self.points else ""
        whole = self.phrase("{length_per_radian:mm} mm") or "the robot's size"
        return self.phrase(f"{asked}{patch}, weight {{weight:=}}, {whole} per radian")


class EffectorStiffness(Entry):
    """How stiff a touch shall find the effector."""

    target: tuple[WantedStiffness, WantedStiffness, WantedStiffness] = (None, None, None)
    """Along x, y, z while the actuators hold; null where free."""
    weight: Annotated[float, unit("", ge=0.0)] = 1.0
    """Weight of its error."""
    length: Annotated[float | None, unit("m", gt=0.0)] = None
    """What counts as an error of 100 %; by default a tenth of the robot's size."""

    def describe(self) -> str:
        """What is asked for, and how it is weighed."""
        asked = [f"{axis} {number(one)} N/m"
                 for axis, one in zip("xyz", self.target, strict=True) if one is not None]  # fmt: skip
        whole = self.phrase("{length:mm} mm") or "a tenth of the robot's size"
        return self.phrase(f"stiffness {' '.join(asked) or 'by messages'}, weight {{weight:=}}, "
                         f"{whole} for 100 %")  # fmt: skip


class PointsOnBody(OnBody):
    """The mean of some points of a body."""

    placed: ClassVar[dict[str, str]] = {"points": "point", "directions": "letters"}

    points: Annotated[tuple[Vector, ...], Field(min_length=1)]
    """Places at rest; the effector or touch is at their mean."""
    directions: tuple[Literal["x", "y", "z"], ...] = ("x", "y", "z")
    """Axes along which a target counts, or a touch acts."""

    def check(self) -> None:
        """Refuse no directions, and the same one twice."""
        has_directions = self.directions or getattr(self, "orientation", None) is not None
        if not has_directions or len(set(self.directions)) != len(self.directions):
            raise ValueError("directions must be x, y or z, each at most once")


class Effector(PointsOnBody):
    """A point that follows a target: the mean of its points."""

    told: ClassVar[tuple[str, ...]] = (
        "{points:#point}", "directions {directions:= }, weight {weight:=}", "{orientation}",
        "{stiffness}",
    )  # fmt: skip
    placed: ClassVar[dict[str, str]] = {**PointsOnBody.placed, "measured_by": "numbers"}

    weight: Annotated[float, unit("", gt=0.0)] = 1.0
    """Weight of its error."""
    orientation: EffectorOrientation | None = None
    """Directions may be empty with it."""
    stiffness: EffectorStiffness | None = None
    measured_by: tuple[int, ...] = ()
    """Ids of markers that measure it in closed loop."""


class Touch(PointsOnBody):
    """Where a body may be touched, by a measured force or at a measured place."""

    carriers: ClassVar[tuple[str, ...]] = ()

    while_touched: Literal["hold_actuators", "follow_targets"] = "hold_actuators"
    """Wait, so that the stiffness is felt, or counteract the touch."""
    force_limit: Annotated[OpenNumber, unit("N", gt=0.0)] = math.inf
    """A greater measured force is refused."""


class MovingBase(Entry):
    """The base moves, as on an arm; the scene stays in its frame, and bears its acceleration."""

    told: ClassVar[tuple[str, ...]] = ("at most {most_acceleration} m/s²",)

    most_acceleration: Annotated[float, unit("m/s²", gt=0.0)] = 50.0
    """More is noise, and is cut."""


class Grip(OnBody):
    """What may take hold of a rigid body, or of the world, and let go: a cup, a magnet, glue."""

    told: ClassVar[tuple[str, ...]] = ("{points:#point} on {holds:=}", "within {reach:mm} mm",
                                       "up to {force_limit} N")  # fmt: skip
    placed: ClassVar[dict[str, str]] = {"points": "point"}

    points: Annotated[tuple[Vector, ...], Field(min_length=1)]
    """Places at rest; three on no line hold the rotation too."""
    holds: Name
    """The rigid body that it may hold, or `world`."""
    reach: Annotated[OpenNumber, unit("m", ge=0.0)] = math.inf
    """It takes hold where all points are as near."""
    stiffness: Annotated[float | None, unit("N/m", gt=0.0)] = None
    """Of the whole grip; by default ten times a block of the body."""
    force_limit: Annotated[OpenNumber, unit("N", gt=0.0)] = math.inf
    """It lets go where it bears more."""


class Reaction(NamedEntry):
    """The force and torque by which something holds a part, as a load cell there shows them."""

    told: ClassVar[tuple[str, ...]] = ("of {of:=}", "attached to {attached_to}", "about {about} m")
    placed: ClassVar[dict[str, str]] = {"about": "point"}

    of: Name
    """A body, beam or mass-spring body, for its fixed nodes; or a guided or fixed rigid body, for
    all on it but its weight."""
    attached_to: Name | None = None
    """A rigid body: for the nodes attached to it."""
    about: Vector | None = None
    """Point of the torque; by default the mean of what is held, or a rigid body's origin."""


class ObservedForce(OnBody):
    """A force that is found from markers."""

    placed: ClassVar[dict[str, str]] = {"points": "point"}

    points: tuple[Vector, ...] = ()
    """It acts at their mean. Without points its place, or on a rigid body its torque, is found."""
    touch: Name | None = None
    """Touch at whose points it acts, in place of body and points."""

    def check(self) -> None:
        """Refuse two ways to say where it acts."""
        if self.touch is not None and (self.points or self.body is not None):
            raise refusal("touch", self.touch, "a touch has its own body and points: give none here")


class Observer(Entry):
    """Finds unknown forces from markers and sensors, by a Kalman filter."""

    told: ClassVar[tuple[str, ...]] = ("changes of {walk:=} N in a second",)

    forces: tuple[ObservedForce, ...] = ()
    """By default one at each touch, else at each effector, else at a place that is found."""
    walk: Annotated[float, unit("N", gt=0.0)] = 0.3
    """Standard deviation of its change in a second."""
    greatest_force: Annotated[float, unit("N", gt=0.0)] = 5.0
    """Standard deviation before anything is seen."""
    marker_noise: Annotated[float | None, unit("m", gt=0.0)] = None
    """Standard deviation of a coordinate; by default estimated."""
    systematic_error: Annotated[float, unit("m", ge=0.0)] = 0.0
    """Standard deviation of the model's error at the markers."""

    def check(self) -> None:
        """Refuse a name that is given twice."""
        names = [force.name for force in self.forces]
        for index, name in enumerate(names):
            if name in names[:index]:
                raise refusal(f"forces[{index}].name", name, f"force {name} is given more than once")


class Control(Entry):
    """How a robot that vibrates is led to its targets; a single word is its `law`."""

    told: ClassVar[tuple[str, ...]] = (
        "{law:=}", "by {inputs:=}", "around {around}", "{modes} modes", "{horizon} s ahead",
        "delay {delay} s", "shaping {shaping}",
    )  # fmt: skip
    by_word: ClassVar[str] = "law"

    law: Literal["dynamic", "quasi_static"] = "dynamic"
    """By prediction, or as if it stood still in each tick."""
    inputs: Literal["setpoints", "efforts"] = "setpoints"
    """Lengths, pressures and volumes, or tensions and pressures."""
    around: tuple[Annotated[float, unit("m, N, Pa or m³")], ...] = ()
    """Where the linear model is made. By default zeros; of tensions a tenth of the greatest."""
    modes: Annotated[int, Field(ge=1, le=50)] = 5
    """Modes of the linear model."""
    horizon: Annotated[float, unit("s", gt=0.0, le=5.0)] = 0.25
    """Time for which motion is predicted."""
    delay: Annotated[float, unit("s", ge=0.0, le=1.0)] = 0.0
    """From a command to its effect on the robot."""
    shaping: Literal["none", "zv", "zvd"] = "none"
    """Spreads targets over time, with `law: quasi_static`; zvd bears a wrong frequency."""

    def check(self) -> None:
        """Refuse a shaping that has no effect."""
        if self.law == "dynamic" and self.shaping != "none":
            raise refusal("shaping", self.shaping, "is for law quasi_static: law dynamic predicts motion")


class Solver(Entry):
    """How a step is solved, and its tolerances."""

    factorization: Literal[*FACTORIZATIONS] = "multifrontal"  # type: ignore[valid-type]
    """Multifrontal Cholesky, or SuperLU."""
    threads: Annotated[int | None, Field(ge=1, le=64)] = None
    """Most threads; by default the cores, at most four."""
    energy_weight: Annotated[float, unit("", ge=0.0, le=1.0)] = 1.0e-6
    """ε of eq. (17): makes redundant actuation unique."""
    newton_iterations: Annotated[int, Field(ge=1, le=100)] = 1
    """Most linearizations in a step."""
    residual_tolerance: Annotated[float, unit("N", gt=0.0)] = 1.0e-4
    """Residual force of a node at which Newton's method stops; less where the loads are small."""
    reach_tolerance: Annotated[float | None, unit("m", gt=0.0)] = None
    """Distance within which a target counts as reached; by default 0.1 mm, at most a thousandth of the size."""
    exploration: bool = False
    """At rest, look for a nearer pose by simulation."""

    def check(self) -> None:
        """Refuse threads for a factorization that has none."""
        if self.factorization == "superlu" and self.threads not in (None, 1):
            raise refusal("threads", self.threads, "is for factorization multifrontal: SuperLU works on one thread")


class Scene(NamedEntry):
    """Everything that is simulated."""

    gravity: Acceleration = (0.0, 0.0, -9.81)
    """Zeros for none."""
    integration: Literal["quasi_static", "first_order", "dynamic"] = "quasi_static"
    """Equilibria, viscous motion, or motion with inertia."""
    time_scheme: Literal["backward_euler", "generalized_alpha"] = "backward_euler"
    """First order with much damping, or second order with `spectral_radius`."""
    spectral_radius: Annotated[float | None, unit("", ge=0.0, le=1.0)] = None
    """ρ∞, by default 0.8: 1 damps nothing, 0 fast vibrations at once."""
    body: Body | None = None
    bodies: tuple[Body, ...] = ()
    """A single deformable body is given as `body`, several as `bodies`."""
    rigid_bodies: tuple[RigidBody, ...] = ()
    mass_springs: tuple[MassSpringBody, ...] = ()
    beams: tuple[Beam, ...] = ()
    springs: tuple[Spring, ...] = ()
    tubes: tuple[Tube, ...] = ()
    fibres: tuple[Fibre, ...] = ()
    obstacles: tuple[Obstacle, ...] = ()
    contact: Contact | None = None
    cables: tuple[Cable, ...] = ()
    cavities: tuple[Cavity, ...] = ()
    sealed_cavities: tuple[SealedCavity, ...] = ()
    motors: tuple[Motor, ...] = ()
    slides: tuple[Slide, ...] = ()
    hinge_motors: tuple[HingeMotor, ...] = ()
    forces: tuple[Force, ...] = ()
    muscles: tuple[Muscle, ...] = ()
    rest_shapes: tuple[RestShape, ...] = ()
    stiffeners: tuple[Stiffener, ...] = ()
    effectors: tuple[Effector, ...] = ()
    touches: tuple[Touch, ...] = ()
    moving_base: MovingBase | None = None
    grips: tuple[Grip, ...] = ()
    reactions: tuple[Reaction, ...] = ()
    sensors: tuple[Sensor, ...] = ()
    markers: tuple[Marker, ...] = ()
    marker_frame: MarkerFrame = MarkerFrame()
    observer: Observer | None = None
    control: Control | None = None
    mounting: tuple[MountingStage, ...] = ()
    """How the robot is assembled, in this order."""
    solver: Solver = Solver()
    path: Path | None = Field(default=None, exclude=True)
    """The scene file; set by the loader."""
    _source: Source = PrivateAttr(default=Source())

    def check(self) -> None:
        """Refuse entries that do not fit each other."""
        self._check_time_scheme()
        check_names(self)
        check_references(self)
        check_mounting(self)
        if self.control is not None:
            check_control(self, self.control)

    def _check_time_scheme(self) -> None:
        """Refuse a scheme, or its parameter, where it would have no effect."""
        if self.time_scheme != "backward_euler" and self.integration != "dynamic":
            raise ValueError(f"time_scheme {self.time_scheme} needs integration dynamic, not "
                             f"{self.integration}")
        if self.spectral_radius is not None and self.time_scheme != "generalized_alpha":
            raise ValueError("spectral_radius needs time_scheme generalized_alpha")
        if self.time_scheme != "generalized_alpha":
            return
        for key, body in self.keyed("deformables"):
            if body.material.viscosity or any(part.viscosity for part in body.materials):
                raise refusal("time_scheme", self.time_scheme,
                              f"is not built for viscous materials, which {key} has")  # fmt: skip

    def error(self, key: str, value: object, reason: str, unit: str = "") -> SceneError:
        """The error of an entry that does not fit what is built of the scene.

        Args:
            key: Dotted path of the entry, such as ``cables[0].points``.
            value: Its value.
            reason: What is required.
            unit: Unit of the value.
        """
        return SceneError(self.path, key, value, unit, reason)

    @property
    def source(self) -> Source:
        """What it was read from, for messages about its entries."""
        return self._source

    @property
    def actuator_entries(self) -> dict[str, tuple[ActuatorEntry, ...]]:
        """Entries of all actuators, by section."""
        return {section: getattr(self, section) for section in ACTUATOR_SECTIONS}

    @property
    def observed_forces(self) -> tuple[ObservedForce, ...]:
        """The forces that its observer looks for, those at touches with their bodies and points."""
        if self.observer is None:
            return ()
        usual = [ObservedForce(name=one.name, body=one.body, points=one.points)
                 for one in self.touches or self.effectors]
        touches = {touch.name: touch for touch in self.touches}
        forces = self.observer.forces or usual or [ObservedForce(name="push")]
        return tuple(
            force if force.touch is None else force.changed(
                body=touches[force.touch].body, points=touches[force.touch].points)
            for force in forces)

    @property
    def deformables(self) -> tuple[Body, ...]:
        """All deformable bodies."""
        return self.bodies if self.body is None else (self.body,)

    @property
    def touching(self) -> tuple[Touching, ...]:
        """The pairs of its contact, none without contact."""
        return () if self.contact is None else self.contact.between

    @property
    def guided_bodies(self) -> tuple[RigidBody, ...]:
        """Rigid bodies that follow commanded poses."""
        return tuple(body for body in self.rigid_bodies if body.motion == "guided")

    def keyed(self, section: str) -> Iterator[tuple[str, Any]]:
        """The entries of a section, each after its key, such as ``cables[0]``.

        Args:
            section: The section; ``deformables`` for all deformable bodies.
        """
        is_single = section == "deformables" and self.body is not None
        word = "bodies" if section == "deformables" else section
        for index, entry in enumerate(getattr(self, section)):
            yield "body" if is_single else f"{word}[{index}]", entry

    def with_deformables(self, change: dict | Callable[[Body], Body]) -> Scene:
        """The same scene with all deformable bodies changed; see `changed`.

        Args:
            change: New values of keys of each body, or a function of a body that gives another.
        """
        return self.changed(body=change, bodies=change)

    def file_path(self, file: Path) -> Path:
        """The path of a file in an entry, relative to the folder of the scene file.

        Args:
            file: The path as the entry has it.
        """
        if file.is_absolute() or self.path is None:
            return file
        return Path(os.path.realpath(self.path.parent / file))

    @property
    def mesh_path(self) -> Path:
        """Mesh file of the first deformable body; raises ValueError for a box."""
        file = self.deformables[0].mesh.file
        if file is None:
            raise ValueError("a box has no mesh file")
        return self.file_path(file)

    @property
    def mesh_name(self) -> str:
        """Name of the mesh of the first deformable body, without a suffix."""
        return "box" if self.deformables[0].mesh.file is None else self.mesh_path.stem

    def mesh_folder(self, body: Body) -> Path:
        """Folder of a body's mesh file; that of the scene for a box.

        Args:
            body: A deformable body of this scene.
        """
        if body.mesh.file is not None:
            return self.file_path(body.mesh.file).parent
        return Path() if self.path is None else Path(os.path.realpath(self.path)).parent


def check_control(scene: Scene, control: Control) -> None:
    """Refuses `control` in a scene whose motion no control is built for.

    Args:
        scene: The scene.
        control: Its control.

    Raises:
        PydanticCustomError: It names the entry for which none is built.
    """
    if scene.integration != "dynamic":
        raise refusal("control", control.law,
                      f"needs integration dynamic, not {scene.integration}: only motion in time has modes")
    for section in ("contact", "slides", "touches", "observer", "mass_springs", "hinge_motors", "motors"):
        if getattr(scene, section):
            raise refusal("control", control.law, f"is not built for a scene with {section}")
    for key, body in scene.keyed("rigid_bodies"):
        if body.motion != "fixed":
            raise refusal("control", control.law, f"is not built for rigid bodies that move, as {key} does")
    for key, effector in scene.keyed("effectors"):
        if effector.orientation is not None or effector.stiffness is not None:
            raise refusal("control", control.law,
                          f"is built for positions alone, and {key} asks for more")
    if not scene.effectors:
        raise refusal("control", control.law, "needs an effector, which follows targets")
    if control.inputs == "efforts":
        for key, cable in scene.keyed("cables"):
            if cable.rate is not None:
                raise refusal("control.inputs", "efforts",
                              f"commands tensions, whose rate is not limited by {key}.rate: leave it out")
        for key, cavity in scene.keyed("cavities"):
            if cavity.control == "volume":
                raise refusal("control.inputs", "efforts", f"cannot command {key}, whose volume is given")


ACTUATOR_SECTIONS: dict[str, type[ActuatorEntry]] = {
    section: form.item for section, form in forms_of(Scene).items()
    if is_entry(form.item) and issubclass(form.item, ActuatorEntry)
}  # fmt: skip
"""Sections of a scene that contain actuators, and the type of their entries."""


def add_actuator_section(section: str, entry: type[ActuatorEntry]) -> None:
    """Adds a section for a kind of actuator to scenes.

    Args:
        section: Its key in a scene file, such as ``struts``.
        entry: Type of each entry.

    Raises:
        ValueError: Scenes have another key of this name.
    """
    if ACTUATOR_SECTIONS.get(section) is entry:
        return
    if section in Scene.model_fields:
        raise ValueError(f"scenes have a section {section} already")
    ACTUATOR_SECTIONS[section] = entry
    entries: Any = tuple[entry, ...]  # type: ignore[valid-type]
    Scene.__annotations__[section] = entries
    Scene.model_fields[section] = FieldInfo(annotation=entries, default=())
    Scene.model_rebuild(force=True)


# Entries that have a shape; `register_shape` gives them a key.
SHAPED_ENTRIES = Shaped, Obstacle, RigidBody


def register_shape(key: str, shape: type[ShapeEntry]) -> None:
    """Registers a shape for obstacles and rigid bodies.

    Args:
        key: Its key in an entry, such as ``sphere``.
        shape: The shape; also a `Shape`, unless its `solid` makes one.

    Raises:
        ValueError: Obstacles or rigid bodies have this key already.
    """
    if any(key in entry.model_fields for entry in SHAPED_ENTRIES):
        raise ValueError(f"obstacles or rigid bodies have a key {key} already")
    for entry in SHAPED_ENTRIES:
        entry.__annotations__[key] = shape | None
        entry.model_fields[key] = FieldInfo(annotation=shape | None, default=None)  # type: ignore[arg-type]
    Shaped.one_of = (*Shaped.one_of, key)
    forms_of.cache_clear()
    for model in (*SHAPED_ENTRIES, Scene):
        model.model_rebuild(force=True)
