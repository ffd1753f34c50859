"""Entries of what is around the soft bodies: obstacles, rigid bodies, springs, touch."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from softrobot_twin.scene.entry import Entry, Name, Vector, unit
from softrobot_twin.scene.shapes import Shaped

Coefficient = Annotated[float, unit("", ge=0.0)]
Length = Annotated[float, unit("m", ge=0.0)]


class Obstacle(Shaped):
    """A shape that stands still."""

    name: Name


class RigidBody(Shaped):
    """A rigid body: free, or guided by who commands it."""

    name: Name
    motion: Literal["free", "guided"] = "free"
    mass: Annotated[float | None, unit("kg", gt=0.0)] = None
    density: Annotated[float | None, unit("kg/m³", gt=0.0)] = None
    """A free body has a mass or a density, spread evenly over its shape."""
    velocity: Annotated[tuple[float, float, float], unit("m/s")] = (0.0, 0.0, 0.0)
    angular_velocity: Annotated[tuple[float, float, float], unit("rad/s")] = (0.0, 0.0, 0.0)
    """Where it starts from, in a dynamic scene."""
    damping: Annotated[float, unit("1/s", ge=0.0)] = 0.0
    """α: a free body's drag is α times its mass and inertia."""
    speed: Annotated[float | None, unit("m/s", gt=0.0)] = None
    """How fast a guided body is moved at most; when left out, by the robot's size in a second."""
    turn_rate: Annotated[float | None, unit("rad/s", gt=0.0)] = None
    """How fast it is turned at most; when left out, by one radian in a second."""

    @model_validator(mode="after")
    def _has_mass(self):
        given = [value for value in (self.mass, self.density) if value is not None]
        if self.motion == "free" and len(given) != 1:
            raise ValueError("a free rigid body has either a mass or a density")
        if self.motion == "guided" and given:
            raise ValueError("a guided rigid body goes where it is told: it has no mass")
        if self.motion == "free" and (self.speed is not None or self.turn_rate is not None):
            raise ValueError("speed and turn_rate are limits of guided bodies")
        if self.motion == "guided" and any(self.velocity + self.angular_velocity):
            raise ValueError("a guided rigid body has no velocity of its own")
        if self.plane is not None:
            raise ValueError("a plane has no end: it can only be an obstacle")
        return self


class SpringEnd(Entry):
    """A point at rest, on a body or in the world."""

    on: Name = "world"
    point: Vector


class Spring(Entry):
    """A spring between two points."""

    name: Name
    ends: tuple[SpringEnd, SpringEnd]
    stiffness: Annotated[float, unit("N/m", gt=0.0)]
    rest_length: Annotated[float | None, unit("m", ge=0.0)] = None
    """The distance at rest, when left out."""
    damping: Annotated[float, unit("N s/m", ge=0.0)] = 0.0


class Tube(Entry):
    """Springs one after the other along a path through a body, such as a tube around a cable."""

    name: Name
    on: Name | None = None
    points: Annotated[tuple[Vector, ...], Field(min_length=2)]
    axial_stiffness: Annotated[float, unit("N", gt=0.0)]
    """EA: the force that would stretch it by its own length."""


class MassSpringBody(Entry):
    """Point masses and the springs between them."""

    name: Name
    points: Annotated[tuple[Vector, ...], Field(min_length=1)]
    masses: tuple[Annotated[float, unit("kg", gt=0.0)], ...]
    """One for each point, or one for all."""
    springs: tuple[tuple[Annotated[int, Field(ge=0)], Annotated[int, Field(ge=0)]], ...] = ()
    """Pairs of points, by their place in the list."""
    stiffness: Annotated[float, unit("N/m", gt=0.0)] = 1.0
    damping: Annotated[float, unit("N s/m", ge=0.0)] = 0.0
    fixed: tuple[Annotated[int, Field(ge=0)], ...] = ()

    @model_validator(mode="after")
    def _fits(self):
        count = len(self.points)
        if len(self.masses) not in (1, count):
            raise ValueError(f"has {count} points but {len(self.masses)} masses")
        named = [index for pair in self.springs for index in pair] + list(self.fixed)
        if any(index >= count for index in named):
            raise ValueError(f"names point {max(named)}, but has points 0 to {count - 1}")
        if any(a == b for a, b in self.springs):
            raise ValueError("a spring joins a point to itself")
        return self


class Touching(Entry):
    """Two things that may touch; a body and itself for contact between its own parts."""

    pair: tuple[Name, Name]
    friction: Annotated[float | None, unit("", ge=0.0)] = None
    """Coefficient µ of Coulomb's law; the scene's when left out."""


class TouchingPoint(Entry):
    """A point of a body that may touch one triangle of the same body, known ahead."""

    on: Name | None = None
    point: Vector
    """The surface's nearest node to it is meant."""
    against: Vector
    """The surface's nearest triangle to it is meant."""


class Contact(Entry):
    """What may touch what, and how."""

    between: tuple[Touching, ...] = ()
    points: tuple[TouchingPoint, ...] = ()
    friction: Coefficient = 0.0
    """µ, where a pair has none of its own."""
    alarm_distance: Annotated[float, unit("m", gt=0.0)] = 0.003
    """What is nearer than this is watched."""
    contact_distance: Length = 0.0
    """What is as near as this touches."""
    force_limit: Annotated[float | None, unit("N", gt=0.0)] = None
    """The inverse leans on nothing harder than this at one contact, as far as that can be had."""
    push_out_speed: Annotated[float, unit("m/s", gt=0.0)] = 0.05
    """Bodies that overlap are parted no faster."""
    tolerance: Annotated[float, unit("m", gt=0.0)] = 1.0e-8
    """How exactly gaps and sticking are solved."""
    most_sweeps: Annotated[int, Field(ge=1, le=100_000)] = 1000
    """Sweeps over all contacts before the solver gives up; with friction Newton follows on 60."""

    @model_validator(mode="after")
    def _touches(self):
        if not self.between and not self.points:
            raise ValueError("names nothing that may touch: give between or points")
        if self.contact_distance >= self.alarm_distance:
            raise ValueError("contact_distance must be below alarm_distance")
        return self
