"""The entries of a scene. All values are SI; what is not listed here is refused by name."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from softrobot_twin.scene.deformable import Body
from softrobot_twin.scene.entry import (
    Acceleration,
    Entry,
    Name,
    OpenNumber,
    OpenPull,
    OpenRange,
    Vector,
    refusal,
    unit,
)
from softrobot_twin.scene.references import check_names, check_references
from softrobot_twin.scene.surroundings import (
    Contact,
    MassSpringBody,
    Motor,
    Obstacle,
    RigidBody,
    Slide,
    Spring,
    Tube,
)


class Cable(Entry):
    """A cable through the body, pulled at its pull point."""

    name: Name
    body: Name | None = None
    """The body it runs through; may be left out where there is only one."""
    frame: Literal["world", "mesh"] = "world"
    """Whether its points are the world's, or those of its body's mesh before it was placed."""
    pull_point: Vector
    pull_point_on: Name = "world"
    """``world``, ``body`` for its own body, or the name of a rigid body."""
    points: Annotated[tuple[Vector, ...], Field(min_length=1)]
    """Points on the body that the cable runs through, from the pull point on."""
    hold_radius: Annotated[float, unit("m", ge=0.0)] = 0.0
    """Each of them pulls on the material within this radius, as a washer does; 0: on one point,
    which gives way more and more as the mesh is refined."""
    shortening: Annotated[OpenRange, unit("m")] = (-math.inf, math.inf)
    """Limits of what is wound in, against the cable's length at rest; infinite where there is
    none. No cable is wound in by more than its length."""
    rate: Annotated[OpenNumber | None, unit("m/s", gt=0.0)] = None
    """Greatest change of length in a second; no limit when left out."""
    tension: Annotated[OpenPull, unit("N")] = (0.0, math.inf)
    """Limits of the tension; a cable cannot push, so the lower one is not negative."""

    @model_validator(mode="after")
    def _pulls(self):
        if self.tension[0] < 0.0:
            raise refusal("tension", self.tension,
                          "a cable cannot push: the least tension must not be negative")
        if not self.shortening[0] <= 0.0 <= self.shortening[1]:
            raise refusal("shortening", self.shortening,
                          "the shortening at rest, 0, must lie within its limits")
        return self


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
