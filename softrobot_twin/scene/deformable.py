"""Entries of deformable bodies: mesh, material, what holds them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, field_validator, model_validator
from pydantic_core import PydanticCustomError

from softrobot_twin.mechanics.laws import law_names
from softrobot_twin.scene.entry import Angles, Entry, Name, Vector, unit


class Mesh(Entry):
    """The body's tetrahedra and where they stand."""

    file: Path
    """Mesh file, relative to the scene file."""
    scale: Annotated[float, unit("m per file unit", gt=0.0)] = 1.0
    rotation: Angles = (0.0, 0.0, 0.0)
    translation: Vector = (0.0, 0.0, 0.0)
    merge_distance: Annotated[float | None, unit("m", ge=0.0)] = None
    """Nodes nearer than this become one; when left out, only those at one place that cut the mesh
    into separate pieces; 0 merges none."""


class Material(Entry):
    """The law of the body."""

    law: str = "corotational"
    """Name of a registered law: corotational or linear, or one from outside the package."""
    young_modulus: Annotated[float, unit("Pa", gt=0.0)]
    poisson_ratio: Annotated[float, unit("", gt=-1.0, lt=0.5)]
    density: Annotated[float | None, unit("kg/m³", gt=0.0)] = None
    total_mass: Annotated[float | None, unit("kg", gt=0.0)] = None
    """In place of a density: what the whole body weighs on a scale."""

    @field_validator("law")
    @classmethod
    def _is_registered(cls, law: str) -> str:
        if law not in law_names():
            raise PydanticCustomError("literal_error", "is no law", {"words": law_names()})
        return law

    @model_validator(mode="after")
    def _weighed_once(self):
        if self.density is not None and self.total_mass is not None:
            raise ValueError(
                f"density {self.density:g} kg/m³ and total_mass {self.total_mass:g} kg are both "
                "given; give one of them"
            )
        if self.density is None and self.total_mass is None:
            raise ValueError("density [kg/m³] or total_mass [kg] is required")
        return self


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

    frame: Literal["world", "mesh"] = "world"
    """Whether coordinates are the world's, or those of the mesh before it was placed."""
    box: BoxRegion | None = None
    sphere: SphereRegion | None = None
    nodes: tuple[Annotated[int, Field(ge=0)], ...] | None = None

    @model_validator(mode="after")
    def _one_kind(self):
        given = [kind for kind in ("box", "sphere", "nodes") if getattr(self, kind) is not None]
        if len(given) != 1:
            raise ValueError("a region is exactly one of box, sphere, nodes")
        return self


class Attachment(Region):
    """Nodes that move with a rigid body. A free rigid body takes their mass."""

    to: Name
    """The rigid body."""


class Damping(Entry):
    """Rayleigh damping, C = α M + β K; a motion of angular frequency ω decays by the ratio
    α/2ω + βω/2."""

    mass: Annotated[float, unit("1/s", ge=0.0)] = 0.0
    """α: also the drag that holds back first-order motion."""
    stiffness: Annotated[float, unit("s", ge=0.0)] = 0.0
    """β: viscosities over elastic constants; K is that of the present shape."""


class Visual(Entry):
    """A finer surface that the body carries, for the eye only."""

    file: Path
    """Surface mesh, relative to the scene file; placed like the body's own mesh."""
    scale: Annotated[float, unit("m per file unit", gt=0.0)] = 1.0


class ContactSurface(Entry):
    """A closed surface that the body carries and touches with, in place of its mesh's own."""

    file: Path
    """Surface mesh, relative to the scene file; placed like the body's own mesh."""
    scale: Annotated[float, unit("m per file unit", gt=0.0)] = 1.0


class Body(Entry):
    """One deformable body."""

    name: Name = "body"
    mesh: Mesh
    element: Literal["linear", "quadratic"] = "quadratic"
    """Shape functions; for quadratic ones a node is added on the middle of every edge. Linear ones
    are faster and lock: they are too stiff in bending, the more so as Poisson's ratio nears 0.5."""
    material: Material
    fixed: tuple[Region, ...] = ()
    attached: tuple[Attachment, ...] = ()
    mass: Literal["lumped", "consistent", "uniform"] | None = None
    """How its mass, and with it its weight, is spread over nodes: each node its share of the
    elements around it, by the elements' shape functions, or every node alike, whatever is around
    it. When left out, lumped for linear elements and consistent for quadratic ones."""
    damping: Damping = Damping()
    visual: Visual | None = None
    contact_surface: ContactSurface | None = None

    @property
    def mass_model(self) -> Literal["lumped", "consistent", "uniform"]:
        """How its mass is spread over nodes."""
        if self.mass is not None:
            return self.mass
        return "lumped" if self.element == "linear" else "consistent"
