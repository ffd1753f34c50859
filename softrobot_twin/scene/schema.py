"""The entries of a scene. All values are SI; what is not listed here is refused by name."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator


class Entry(BaseModel):
    """Base of all entries: frozen, no unknown keys, no NaN or infinity."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


def unit(name: str, **limits) -> object:
    """A field whose unit is told when its value is refused."""
    return Field(json_schema_extra={"unit": name}, **limits)


def check_name(name: str) -> str:
    """A name becomes part of a ROS topic."""
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name):
        raise ValueError("a name is letters, digits and underscores, a letter first")
    return name


Name = Annotated[str, AfterValidator(check_name)]
Vector = Annotated[tuple[float, float, float], unit("m")]
Angles = Annotated[tuple[float, float, float], unit("rad")]
Acceleration = Annotated[tuple[float, float, float], unit("m/s²")]
Range = tuple[float, float]


def check_range(bounds: Range) -> Range:
    """Limits must be in order; swapping them in silence would hide a mistake."""
    if bounds[0] > bounds[1]:
        raise ValueError("the lower limit is above the upper one")
    return bounds


class Mesh(Entry):
    """The body's tetrahedra and where they stand."""

    file: Path
    """Mesh file, relative to the scene file."""
    scale: Annotated[float, unit("m per file unit", gt=0.0)] = 1.0
    rotation: Angles = (0.0, 0.0, 0.0)
    translation: Vector = (0.0, 0.0, 0.0)


class Material(Entry):
    """The law of the body."""

    law: Literal["corotational", "linear"] = "corotational"
    young_modulus: Annotated[float, unit("Pa", gt=0.0)]
    poisson_ratio: Annotated[float, unit("", gt=-1.0, lt=0.5)]
    density: Annotated[float, unit("kg/m³", gt=0.0)]


class BoxRegion(Entry):
    """Nodes inside an axis-aligned box."""

    minimum: Vector
    maximum: Vector

    @model_validator(mode="after")
    def _ordered(self):
        if any(a > b for a, b in zip(self.minimum, self.maximum, strict=True)):
            raise ValueError("a box's minimum is above its maximum")
        return self


class SphereRegion(Entry):
    """Nodes inside a sphere."""

    centre: Vector
    radius: Annotated[float, unit("m", gt=0.0)]


class Region(Entry):
    """Exactly one of: a box, a sphere, nodes by their number in the mesh file."""

    box: BoxRegion | None = None
    sphere: SphereRegion | None = None
    nodes: tuple[Annotated[int, Field(ge=0)], ...] | None = None

    @model_validator(mode="after")
    def _one_kind(self):
        given = [kind for kind in ("box", "sphere", "nodes") if getattr(self, kind) is not None]
        if len(given) != 1:
            raise ValueError("a region is exactly one of box, sphere, nodes")
        return self


class Body(Entry):
    """One deformable body."""

    mesh: Mesh
    element: Literal["linear", "quadratic"] = "linear"
    """Shape functions; for quadratic ones a node is added on the middle of every edge."""
    material: Material
    fixed: tuple[Region, ...] = ()


class Cable(Entry):
    """A cable through the body, pulled at its pull point."""

    name: Name
    pull_point: Vector
    pull_point_on: Literal["world", "body"] = "world"
    points: Annotated[tuple[Vector, ...], Field(min_length=1)]
    """Points on the body that the cable runs through, from the pull point on."""
    hold_radius: Annotated[float, unit("m", ge=0.0)] = 0.0
    """Each of them pulls on the material within this radius, as a washer does; 0: on one point,
    which gives way more and more as the mesh is refined."""
    shortening: Annotated[Range, AfterValidator(check_range), unit("m")]
    """Limits of what is wound in, against the cable's length at rest."""
    rate: Annotated[float | None, unit("m/s", gt=0.0)] = None
    """Greatest change of length in a second; no limit when left out."""
    tension: Annotated[Range, AfterValidator(check_range), unit("N")]
    """Limits of the tension; a cable cannot push, so the lower one is not negative."""

    @model_validator(mode="after")
    def _pulls(self):
        if self.tension[0] < 0.0:
            raise ValueError("a cable cannot push: the least tension must not be negative")
        if not self.shortening[0] <= 0.0 <= self.shortening[1]:
            raise ValueError("the shortening at rest, 0, must lie within its limits")
        return self


class Marker(Entry):
    """A point on the body that a camera sees."""

    id: Annotated[int, Field(ge=0, lt=2**32)]
    point: Vector


class Effector(Entry):
    """What should go to a target: the mean of its points."""

    name: Name
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
    energy_weight: Annotated[float, unit("", gt=0.0, le=1.0)] = 1.0e-6
    """ε of eq. (17): makes redundant actuation unique, at the price of a little tracking."""
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
    integration: Literal["quasi_static"] = "quasi_static"
    body: Body
    cables: tuple[Cable, ...] = ()
    effectors: tuple[Effector, ...] = ()
    markers: tuple[Marker, ...] = ()
    solver: Solver = Solver()
    path: Path | None = Field(default=None, exclude=True)
    """File the scene was read from; set by the loader."""

    @model_validator(mode="after")
    def _cross_check(self):
        for kind, names in (
            ("cable", [cable.name for cable in self.cables]),
            ("effector", [effector.name for effector in self.effectors]),
            ("marker id", [marker.id for marker in self.markers]),
        ):
            twice = sorted({str(name) for name in names if names.count(name) > 1})
            if twice:
                raise ValueError(f"{kind} {', '.join(twice)} stands more than once")
        known = {marker.id for marker in self.markers}
        for effector in self.effectors:
            missing = sorted(set(effector.measured_by) - known)
            if missing:
                raise ValueError(
                    f"effector {effector.name} is measured by markers {missing}, "
                    "which the scene does not have"
                )
        return self

    @property
    def mesh_path(self) -> Path:
        """The mesh file, found from the scene file's folder."""
        file = self.body.mesh.file
        if file.is_absolute() or self.path is None:
            return file
        return (self.path.parent / file).resolve()
