"""The entries of a scene. All values are SI; what is not listed here is refused by name."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator
from pydantic.fields import FieldInfo

from softrobot_twin.scene.actuator_entries import ActuatorEntry, Cable, Motor, Slide
from softrobot_twin.scene.deformable import Body
from softrobot_twin.scene.entry import Acceleration, Entry, Name, Vector, unit
from softrobot_twin.scene.references import check_names, check_references
from softrobot_twin.scene.surroundings import (
    Contact,
    MassSpringBody,
    Obstacle,
    RigidBody,
    Spring,
    Tube,
)


class Marker(Entry):
    """A point on the body that a camera sees."""

    id: Annotated[int, Field(ge=0, lt=2**32)]
    body: Name | None = None
    """The body that carries it; may be left out where there is only one."""
    point: Vector


class Effector(Entry):
    """What should go to a target: the mean of its points."""

    name: Name
    body: Name | None = None
    """The body that carries it; may be left out where there is only one."""
    points: Annotated[tuple[Vector, ...], Field(min_length=1)]
    directions: tuple[Literal["x", "y", "z"], ...] = ("x", "y", "z")
    weight: Annotated[float, unit("", gt=0.0)] = 1.0
    measured_by: tuple[int, ...] = ()
    """Ids of the markers that move with it; the closed loop measures the effector by them."""

    @model_validator(mode="after")
    def _directions(self):
        if not self.directions or len(set(self.directions)) != len(self.directions):
            raise ValueError("directions are some of x, y, z, each once")
        return self


class Solver(Entry):
    """How a step is solved, and how exactly."""

    factorization: Literal["multifrontal", "superlu"] = "multifrontal"
    qp_solver: Literal["osqp", "daqp"] = "osqp"
    energy_weight: Annotated[float, unit("", ge=0.0, le=1.0)] = 1.0e-6
    """ε of eq. (17): makes redundant actuation unique, at the price of a little tracking. Less than
    1.5e-8 counts as that: the arithmetic bears no less."""
    newton_iterations: Annotated[int, Field(ge=1, le=100)] = 1
    """Most linearizations in one step."""
    residual_tolerance: Annotated[float, unit("N", gt=0.0)] = 1.0e-4
    """Newton's iterations stop when no node is out of balance by more than this."""
    reach_tolerance: Annotated[float, unit("m", gt=0.0)] = 1.0e-4
    """A target counts as reached when the effector is this near."""


class Scene(Entry):
    """All that is simulated, and nothing else."""

    name: Name
    gravity: Acceleration = (0.0, 0.0, -9.81)
    integration: Literal["quasi_static", "first_order", "dynamic"] = "quasi_static"
    """Equilibrium at every step; viscous motion without inertia; motion with inertia."""
    body: Body | None = None
    bodies: tuple[Body, ...] = ()
    """One deformable body as `body`, several as `bodies`."""
    rigid_bodies: tuple[RigidBody, ...] = ()
    mass_springs: tuple[MassSpringBody, ...] = ()
    springs: tuple[Spring, ...] = ()
    tubes: tuple[Tube, ...] = ()
    obstacles: tuple[Obstacle, ...] = ()
    contact: Contact | None = None
    cables: tuple[Cable, ...] = ()
    motors: tuple[Motor, ...] = ()
    slides: tuple[Slide, ...] = ()
    effectors: tuple[Effector, ...] = ()
    markers: tuple[Marker, ...] = ()
    solver: Solver = Solver()
    path: Path | None = Field(default=None, exclude=True)
    """File the scene was read from; set by the loader."""

    @model_validator(mode="after")
    def _cross_check(self):
        check_names(self)
        check_references(self)
        return self

    @property
    def actuator_entries(self) -> dict[str, tuple[ActuatorEntry, ...]]:
        """Entries of all actuators, by the sections they stand in."""
        return {section: getattr(self, section) for section in ACTUATOR_SECTIONS}

    @property
    def deformables(self) -> tuple[Body, ...]:
        """All deformable bodies."""
        return self.bodies if self.body is None else (self.body,)

    def file_path(self, file: Path) -> Path:
        """A file that an entry names, found from the scene file's folder."""
        if file.is_absolute() or self.path is None:
            return file
        return (self.path.parent / file).resolve()

    @property
    def mesh_path(self) -> Path:
        """Mesh file of the first deformable body."""
        return self.file_path(self.deformables[0].mesh.file)


ACTUATOR_SECTIONS: dict[str, type[ActuatorEntry]] = {"cables": Cable, "slides": Slide}
"""Sections of a scene that hold actuators, and what is read there."""


def add_actuator_section(section: str, entry: type[ActuatorEntry]) -> None:
    """Give scenes a section for a kind of actuator.

    Args:
        section: Its key in a scene file, such as ``struts``.
        entry: What each entry is read as.

    Raises:
        ValueError: Scenes have a key of this name that means something else.
    """
    if ACTUATOR_SECTIONS.get(section) is entry:
        return
    if section in Scene.model_fields:
        raise ValueError(f"scenes have a section {section} already")
    ACTUATOR_SECTIONS[section] = entry
    Scene.__annotations__[section] = tuple[entry, ...]
    Scene.model_fields[section] = FieldInfo(annotation=tuple[entry, ...], default=())
    Scene.model_rebuild(force=True)


def remove_actuator_section(section: str) -> None:
    """Take a section back that `add_actuator_section` gave.

    Args:
        section: Its key.
    """
    del ACTUATOR_SECTIONS[section]
    del Scene.__annotations__[section], Scene.model_fields[section]
    Scene.model_rebuild(force=True)
