"""The entries of a scene. All values are SI; unknown keys are refused by name."""

from __future__ import annotations

import math
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
    HingeMotor,
    Motor,
    SealedCavity,
    Slide,
)
from softrobot_twin.scene.body_entries import (
    Beam,
    Body,
    Fibre,
    MassSpringBody,
    Obstacle,
    RigidBody,
    Spring,
    Tube,
)
from softrobot_twin.scene.entry import (
    Acceleration,
    Angles,
    Entry,
    Name,
    OpenNumber,
    Vector,
    not_zero,
    refusal,
    unit,
)
from softrobot_twin.scene.mounting_entries import MountingStage, check_mounting
from softrobot_twin.scene.patterns import Source
from softrobot_twin.scene.references import check_names, check_references
from softrobot_twin.scene.words import number
from softrobot_twin.solvers import FACTORIZATIONS


class Touching(Entry):
    """Two bodies or obstacles that may touch; the same name twice for self-contact."""

    placed: ClassVar[dict[str, str]] = {}

    pair: tuple[Name, Name]
    """Names of the two; of a body with itself the same name twice."""
    friction: Annotated[float | None, unit("", ge=0.0)] = None
    """Coefficient µ of Coulomb's law; by default that of the contact section."""
    least_force: Annotated[float | None, unit("N", gt=0.0)] = None
    """What the normal forces of the pair shall at least sum up to, where effectors follow targets and
    the pair has friction: missed only where limits of the hardware do not allow it."""
    least_grip_margin: Annotated[float | None, unit("", gt=0.0, lt=1.0)] = None
    """Share of the pair's friction that shall be left, 1 - Σ |λ_t| / Σ µ λ_n: it is told of every step,
    and a step with less names `<first>.<second>.grip_margin`. A target is missed before it falls
    below; where it is below already, actuators follow targets only to raise it."""


class TouchingPoint(Entry):
    """A point of a body that may touch one given triangle of the same body."""

    placed: ClassVar[dict[str, str]] = {"point": "point", "against": "point"}

    on: Name | None = None
    """The deformable body; optional when there is only one."""
    point: Vector
    """The nearest node of the surface is used."""
    against: Vector
    """The nearest triangle of the surface is used."""


class Contact(Entry):
    """Which bodies may touch, and how contact is solved."""

    told: ClassVar[tuple[str, ...]] = (
        "candidates below {alarm_distance:=mm} mm", "contact below {contact_distance:=mm} mm",
        "tolerance {tolerance:=} m",
    )  # fmt: skip

    between: tuple[Touching, ...] = ()
    """Pairs that may touch; all others pass through each other."""
    points: tuple[TouchingPoint, ...] = ()
    """Points of a body that may touch given triangles of the same body."""
    friction: Annotated[float, unit("", ge=0.0)] = 0.0
    """µ of pairs without their own value."""
    alarm_distance: Annotated[float, unit("m", gt=0.0)] = 0.003
    """Features nearer than this become contact candidates."""
    contact_distance: Annotated[float, unit("m", ge=0.0)] = 0.0
    """Features at this distance are in contact."""
    force_limit: Annotated[float | None, unit("N", gt=0.0)] = None
    """Greatest force of one contact in the inverse problem; exceeded only where it must be."""
    push_out_speed: Annotated[float, unit("m/s", gt=0.0)] = 0.05
    """Greatest speed at which overlapping bodies are separated."""
    tolerance: Annotated[float, unit("m", gt=0.0)] = 1.0e-8
    """Greatest residual of gaps and sticking."""
    most_sweeps: Annotated[int, Field(ge=1, le=100_000)] = 1000
    """Greatest number of sweeps over all contacts; with friction Newton's method follows after 60.
    """

    def check(self) -> None:
        """Refuse a section without pairs, and distances that are not in order."""
        if not self.between and not self.points:
            raise ValueError("has no pairs: between or points is required")
        if self.contact_distance >= self.alarm_distance:
            raise ValueError("contact_distance must be below alarm_distance")
        for index, entry in enumerate(self.between):
            friction = self.friction if entry.friction is None else entry.friction
            if entry.least_grip_margin is not None and not friction:
                raise refusal(f"between[{index}].least_grip_margin", entry.least_grip_margin,
                              "the pair has no friction that could be left")
            if entry.least_force is not None and not friction:
                raise refusal(f"between[{index}].least_force", entry.least_force,
                              "is not built for a pair without friction")


class Marker(Entry):
    """A point of a body that a camera observes."""

    placed: ClassVar[dict[str, str]] = {"id": "numbers", "point": "point"}

    id: Annotated[int, Field(ge=0, lt=2**32)]
    """Its number in messages of markers."""
    body: Name | None = None
    """The body it is on; optional when there is only one."""
    point: Vector
    """Where it is at rest."""


class MarkerFrame(Entry):
    """Where the frame of the cameras is that measure the markers."""

    position: Vector = (0.0, 0.0, 0.0)
    """Its origin, in the frame of the robot."""
    rotation: Angles = (0.0, 0.0, 0.0)
    """Angles about the x, y and z axes of the robot's frame, in this order."""

    @property
    def is_usual(self) -> bool:
        """Whether the cameras measure in the frame of the robot."""
        return not any((*self.position, *self.rotation))

    def of_robot(self, points: np.ndarray) -> np.ndarray:
        """Measured points in the frame of the robot [m], shape (..., 3).

        Args:
            points: In the frame of the cameras [m], shape (..., 3).
        """
        return points if self.is_usual else points @ self._turn.T + self.position

    def of_cameras(self, points: np.ndarray) -> np.ndarray:
        """Points in the frame of the cameras, the inverse of `of_robot`.

        Args:
            points: In the frame of the robot [m], shape (..., 3).
        """
        return points if self.is_usual else (points - self.position) @ self._turn

    @property
    def _turn(self) -> np.ndarray:
        return Rotation.from_euler("xyz", self.rotation).as_matrix()


WantedStiffness = Annotated[float | None, unit("N/m", gt=0.0)]


class EffectorOrientation(Entry):
    """What an effector asks for beside its position: how its body is turned from rest."""

    pointing: Annotated[Vector | None, not_zero("must not be zero: it is a direction")] = None
    """Axis of the body, in the world at rest, that points where the target turns it: its turn about
    the axis itself is left free. Without it the whole rotation is asked for."""
    points: tuple[Vector, ...] = ()
    """Points of a deformable body whose best-fit rotation it is, three or more; by default those of
    the effector. On a rigid body or a vertebra it is the body's rotation, and needs none."""
    weight: Annotated[float, unit("", gt=0.0)] = 1.0
    """Weight of the error of the orientation."""
    length_per_radian: Annotated[float | None, unit("m/rad", gt=0.0)] = None
    """Displacement that counts as much as one radian; by default the size of the robot."""

    def describe(self) -> str:
        """What is asked for, and how it is weighed."""
        asked = self.phrase("axis {pointing} pointing") or "orientation"
        patch = self.phrase(" of {points:#point}") if self.points else ""
        whole = self.phrase("{length_per_radian:mm} mm") or "the robot's size"
        return self.phrase(f"{asked}{patch}, weight {{weight:=}}, {whole} per radian")


class EffectorStiffness(Entry):
    """What an effector asks for beside its position: how stiff a touch finds it."""

    target: tuple[WantedStiffness, WantedStiffness, WantedStiffness] = (None, None, None)
    """Stiffness along x, y and z, felt by a force along that axis while the actuators hold what they
    hold; null where it is free. Messages on ``~/target_stiffness/<effector>`` replace it."""
    weight: Annotated[float, unit("", ge=0.0)] = 1.0
    """Weight of its error; zero as if the entry were not there."""
    length: Annotated[float | None, unit("m", gt=0.0)] = None
    """Distance from the target that counts as much as a stiffness that is wrong by all of its
    target; by default a tenth of the size of the robot."""

    def describe(self) -> str:
        """What is asked for, and how it is weighed."""
        asked = [f"{axis} {number(one)} N/m"
                 for axis, one in zip("xyz", self.target, strict=True) if one is not None]  # fmt: skip
        whole = self.phrase("{length:mm} mm") or "a tenth of the robot's size"
        return self.phrase(f"stiffness {' '.join(asked) or 'by messages'}, weight {{weight:=}}, "
                         f"{whole} for 100 %")  # fmt: skip


class PointsOnBody(Entry):
    """The mean of some points of a body."""

    placed: ClassVar[dict[str, str]] = {"points": "point", "directions": "letters"}

    name: Name
    """Its name, in topics, commands and columns."""
    body: Name | None = None
    """The body it is on; optional when there is only one."""
    points: Annotated[tuple[Vector, ...], Field(min_length=1)]
    """Places at rest: the effector, or the touch, is at their mean. A touch at a single point yields
    the more, the finer the mesh is."""
    directions: tuple[Literal["x", "y", "z"], ...] = ("x", "y", "z")
    """Axes of the world along which a target counts, or a touch acts; along the others a touching
    finger slides."""

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
    """Weight of its error against those of other effectors."""
    orientation: EffectorOrientation | None = None
    """Directions may be empty with it."""
    stiffness: EffectorStiffness | None = None
    measured_by: tuple[int, ...] = ()
    """Ids of the markers that move with it; in closed loop they measure the effector."""


class Touch(PointsOnBody):
    """Where a body may be touched, by a measured force or at a measured place: at the mean of some
    points, over which the force is shared."""

    while_touched: Literal["hold_actuators", "follow_targets"] = "hold_actuators"
    """What a robot that follows targets does: wait, so that its stiffness is felt, or go on, and
    counteract the touch."""
    force_limit: Annotated[OpenNumber, unit("N", gt=0.0)] = math.inf
    """A greater measured force is refused; by default none is."""


class ObservedForce(Entry):
    """A force that nobody modelled and that is found from markers: at known points of a body or at a
    touch, at an unknown place of a soft body's surface, or with its torque on a rigid body."""

    placed: ClassVar[dict[str, str]] = {"points": "point"}

    name: Name
    """Its name, in topics and columns."""
    body: Name | None = None
    """The body it acts on; optional when there is only one."""
    points: tuple[Vector, ...] = ()
    """Places at rest: it acts at their mean. Without any, its place on the surface of a soft body is
    found too; on a rigid body it is a force at the centre of mass and a torque."""
    touch: Name | None = None
    """A touch of the scene, at whose points it acts, in place of body and points."""

    def check(self) -> None:
        """Refuse two ways to say where it acts."""
        if self.touch is not None and (self.points or self.body is not None):
            raise refusal("touch", self.touch, "a touch has its own body and points: give none here")


class Observer(Entry):
    """Finds forces from where the markers are beside the model: a random walk, a Kalman filter, and
    Huber's weights for outliers. The model bears what is found."""

    told: ClassVar[tuple[str, ...]] = ("changes of {walk:=} N in a second",)

    forces: tuple[ObservedForce, ...] = ()
    """The forces that are looked for; three markers or more tell one. By default one at each touch,
    without touches at each effector, and without these at a place that is found."""
    walk: Annotated[float, unit("N", gt=0.0)] = 0.3
    """Change of a force within a second, as standard deviation; a sudden one is noticed by itself."""
    greatest_force: Annotated[float, unit("N", gt=0.0)] = 5.0
    """What is expected before anything is seen, as standard deviation."""
    marker_noise: Annotated[float | None, unit("m", gt=0.0)] = None
    """Standard deviation of each measured coordinate; by default it is estimated."""
    systematic_error: Annotated[float, unit("m", ge=0.0)] = 0.0
    """What the model itself is off at the markers, as standard deviation: forces are the less sure."""

    def check(self) -> None:
        """Refuse a name that is given twice."""
        names = [force.name for force in self.forces]
        for index, name in enumerate(names):
            if name in names[:index]:
                raise refusal(f"forces[{index}].name", name,
                              f"force {name} is given more than once")


class Control(Entry):
    """How a robot that vibrates is led to its targets; a single word is its `law`."""

    told: ClassVar[tuple[str, ...]] = (
        "{law:=}", "by {inputs:=}", "around {around}", "{modes} modes", "{horizon} s ahead",
        "delay {delay} s", "shaping {shaping}",
    )  # fmt: skip
    by_word: ClassVar[str] = "law"

    law: Literal["dynamic", "quasi_static"] = "dynamic"
    """By prediction of its motion, where a linear model follows it; or as if it stood in each tick."""
    inputs: Literal["setpoints", "efforts"] = "setpoints"
    """What is commanded: lengths of cables, pressures and volumes; or tensions of cables, and
    pressures."""
    around: tuple[Annotated[float, unit("m, N, Pa or m³")], ...] = ()
    """Inputs around which the robot moves, of each actuator in their order, in its unit: shortenings
    or tensions, pressures, growths. By default zeros, of tensions a tenth of the greatest ones."""
    modes: Annotated[int, Field(ge=1, le=50)] = 5
    """Modes of the linear model: those through which the actuators move the effectors most."""
    horizon: Annotated[float, unit("s", gt=0.0, le=5.0)] = 0.25
    """Time for which motion is predicted."""
    delay: Annotated[float, unit("s", ge=0.0, le=1.0)] = 0.0
    """Time from a command to its effect on the real robot, counted in whole ticks, the nearest number.
    The age of markers is known by stamps."""
    shaping: Literal["none", "zv", "zvd"] = "none"
    """Of `law: quasi_static`: targets are spread over time so that slow modes do not vibrate, without
    feedback; zvd takes longer and bears a model that is less exact."""

    def check(self) -> None:
        """Refuse a shaping that has no effect."""
        if self.law == "dynamic" and self.shaping != "none":
            raise refusal("shaping", self.shaping, "is for law quasi_static: law dynamic predicts motion")


class Solver(Entry):
    """How a step is solved, and its tolerances."""

    factorization: Literal[*FACTORIZATIONS] = "multifrontal"  # type: ignore[valid-type]
    """How the stiffness is factorized: multifrontal Cholesky, or SuperLU as a reference."""
    threads: Annotated[int | None, Field(ge=1, le=64)] = None
    """Threads on which a large stiffness is factorized, at most; by default as many as the process has
    cores, at most four. A small one takes one thread. Results are the same to the bit."""
    qp_solver: Literal["osqp", "daqp"] = "osqp"
    """Solver of the inverse problem."""
    energy_weight: Annotated[float, unit("", ge=0.0, le=1.0)] = 1.0e-6
    """ε of eq. (17): makes redundant actuation unique, with a small tracking error. Values below
    1.5e-8, the limit of the arithmetic, count as 1.5e-8."""
    newton_iterations: Annotated[int, Field(ge=1, le=100)] = 1
    """Greatest number of linearizations in one step."""
    residual_tolerance: Annotated[float, unit("N", gt=0.0)] = 1.0e-4
    """Newton's method stops when the residual force of every node is at most this."""
    reach_tolerance: Annotated[float, unit("m", gt=0.0)] = 1.0e-4
    """A target is reached when the effector is within this distance."""
    exploration: bool = False
    """Whether a robot that rests away from its targets looks for a nearer pose by simulation, and
    goes there."""

    def check(self) -> None:
        """Refuse threads for a factorization that has none."""
        if self.factorization == "superlu" and self.threads not in (None, 1):
            raise refusal("threads", self.threads, "is for factorization multifrontal: SuperLU works on one thread")


class Scene(Entry):
    """Everything that is simulated."""

    name: Name
    """Its name, in reports and pictures."""
    gravity: Acceleration = (0.0, 0.0, -9.81)
    """Acceleration of gravity; zeros for none."""
    integration: Literal["quasi_static", "first_order", "dynamic"] = "quasi_static"
    """Equilibrium in every step; viscous motion without inertia; motion with inertia."""
    time_scheme: Literal["backward_euler", "generalized_alpha"] = "backward_euler"
    """How dynamic motion is integrated: first order, which damps much and never gains energy, or
    second order, which damps by its spectral radius."""
    spectral_radius: Annotated[float | None, unit("", ge=0.0, le=1.0)] = None
    """ρ∞ of generalized_alpha, by default 0.8: factor by which a step multiplies vibrations that are
    much faster than it. 1 damps nothing, 0 damps them at once."""
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
    effectors: tuple[Effector, ...] = ()
    touches: tuple[Touch, ...] = ()
    markers: tuple[Marker, ...] = ()
    marker_frame: MarkerFrame = MarkerFrame()
    observer: Observer | None = None
    control: Control | None = None
    mounting: tuple[MountingStage, ...] = ()
    """How the robot is assembled, in this order. Without it, it rests as it is drawn."""
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
        return (self.path.parent / file).resolve()

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
        return Path() if self.path is None else self.path.resolve().parent


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
    "cables": Cable, "cavities": Cavity, "slides": Slide, "hinge_motors": HingeMotor,
}
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


def remove_actuator_section(section: str) -> None:
    """Removes a section that `add_actuator_section` added.

    Args:
        section: Its key.
    """
    del ACTUATOR_SECTIONS[section]
    del Scene.__annotations__[section], Scene.model_fields[section]
    Scene.model_rebuild(force=True)
