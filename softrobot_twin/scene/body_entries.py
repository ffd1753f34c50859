"""Entries of bodies: deformable and rigid bodies, obstacles, springs and point masses."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from pydantic import BeforeValidator, Field, model_validator
from pydantic_core import PydanticCustomError

from softrobot_twin.geometry.box_mesh import cells_of_size
from softrobot_twin.geometry.cad_meshing import CAD_SUFFIXES, TRIANGLE_SUFFIXES
from softrobot_twin.mechanics.element_kinds import element_named, element_names
from softrobot_twin.mechanics.laws import law_named, law_names
from softrobot_twin.mechanics.material import poisson_ratio_of_bulk
from softrobot_twin.mechanics.point_law import OwnConstants, can_divide, has_bulk_modulus
from softrobot_twin.scene.entry import (
    LARGEST,
    Angles,
    Direction,
    Entry,
    Name,
    NamedEntry,
    Vector,
    not_zero,
    refusal,
    registered,
    unit,
)
from softrobot_twin.scene.material_presets import MATERIAL_PRESETS, POISSON_RATIO, UNFITTED
from softrobot_twin.scene.refusal_messages import nearest
from softrobot_twin.scene.shapes import Box, Capsule, Cylinder, Length, Plane, ShapeEntry, Sphere, SurfaceFile

# --- deformable bodies ---------------------------------------------------------------------------


MOST_BOX_CELLS = 1_000_000
"""A box of more cells than this is refused."""
_CellCount = Annotated[int, Field(ge=1)]
UP = (0.0, 0.0, 1.0)

PATCHES_NOT_REDUCED = "are not built for reduced bodies: name volume: per_element"
"""Why a reduced body has no patches."""


class BoxMesh(Entry):
    """A box that is meshed without a file, from the origin of the mesh to its `size`."""

    told: ClassVar[tuple[str, ...]] = ("a box of {size:mm} mm", "{cell_counts:×} cells")
    one_of: ClassVar[tuple[str, ...]] = ("cell_size", "cells")

    size: Annotated[tuple[Length, Length, Length], unit("m")]
    """Its edges."""
    cell_size: Annotated[float | None, unit("m", gt=0.0)] = None
    """Greatest edge of its cells."""
    cells: tuple[_CellCount, _CellCount, _CellCount] | None = None
    """Cells along x, y, z."""

    def check(self) -> None:
        """Refuse more cells than `MOST_BOX_CELLS`."""
        count = math.prod(self.cell_counts)
        if count > MOST_BOX_CELLS:
            key = "cells" if self.cell_size is None else "cell_size"
            raise refusal(key, getattr(self, key) if self.cells is None else list(self.cells),
                          f"makes {count:.6g} cells, more than {MOST_BOX_CELLS}")  # fmt: skip

    @property
    def cell_counts(self) -> tuple[int, int, int]:
        """Cells along x, y, z."""
        if self.cell_size is not None:
            return cells_of_size(self.size, self.cell_size)
        assert self.cells is not None  # it is checked that one is given
        return self.cells


class Mesh(Entry):
    """A mesh file, a CAD file that is meshed, or a box, and its placement."""

    told: ClassVar[tuple[str, ...]] = (
        "{file}", "{box}", "tetrahedra of {size:mm} mm", "scale {scale}",
        "rotation {rotation} rad", "translation {translation} m",
    )  # fmt: skip
    placed: ClassVar[dict[str, str]] = {"rotation": "angles", "translation": "point"}

    file: Path | None = None
    """A mesh, or CAD file (.stl, .obj, .ply, .off, .step, .stp)."""
    box: BoxMesh | None = None
    """A box from the origin, in place of a file."""
    size: Annotated[float | None, unit("m", gt=0.0)] = None
    """Edge of the tetrahedra of a CAD file."""
    scale: Annotated[float, unit("m per file unit", gt=0.0)] = 1.0
    """Metres in a unit of the file; not for STEP."""
    rotation: Angles = (0.0, 0.0, 0.0)
    """About the world's axes; after the scale."""
    translation: Vector = (0.0, 0.0, 0.0)
    """After the rotation."""
    merge_distance: Annotated[float | None, unit("m", ge=0.0)] = None
    """Nearer nodes are merged; by default coincident ones that separate the mesh."""

    def check(self) -> None:
        """Refuse what is not exactly one source, and keys that have no effect on it."""
        if self.file is None and self.box is None:
            raise refusal("file", "(nothing)", "is required, or a box in its place")
        if self.box is not None:
            for key in ("file", "size", "scale", "merge_distance"):
                if key in self.model_fields_set and getattr(self, key) is not None:
                    value = getattr(self, key)
                    raise refusal(key, str(value) if key == "file" else value,
                                  "is given beside box, where it has no effect")  # fmt: skip
            return
        assert self.file is not None, "checked above"
        if not self.is_cad:
            if self.size is not None:
                raise refusal("size", self.size, f"is that of tetrahedra made from CAD files "
                              f"({', '.join(CAD_SUFFIXES)}); {self.label} has its own")
            return
        if self.size is None:
            raise refusal("size", "(nothing)", f"is required: the edge of the tetrahedra that "
                          f"{self.label} is meshed with")
        if self.scale != 1.0 and not self.label.lower().endswith(TRIANGLE_SUFFIXES):
            raise refusal("scale", self.scale, "is not taken: a STEP file states its unit")

    @property
    def is_cad(self) -> bool:
        """Whether it is made from a CAD file."""
        return self.file is not None and self.file.suffix.lower() in CAD_SUFFIXES

    @property
    def label(self) -> str:
        """Name of the file, or ``the box``, for messages."""
        return "the box" if self.file is None else self.file.name


class ViscosityTerm(Entry):
    """A term of a Prony series: a share of the stiffness that relaxes."""

    told: ClassVar[tuple[str, ...]] = ("{share} in {time} s",)

    share: Annotated[float, unit("", gt=0.0, lt=1.0)]
    """g: share of the modulus at once."""
    time: Annotated[float, unit("s", gt=0.0)]
    """τ: in this time its stress falls to 1/e."""


class Softening(Entry):
    """Softening by the first stretch (Ogden and Roxburgh 1999)."""

    told: ClassVar[tuple[str, ...]] = ("softening: r {r}", "m {m} J/m³", "β {beta:=}")

    r: Annotated[float, unit("", gt=1.0)]
    """The stress falls by 1/r of itself at most."""
    m: Annotated[float, unit("J/m³", gt=0.0)]
    """Energy density; a small one softens early."""
    beta: Annotated[float, unit("", ge=0.0)] = 0.0
    """β: greater ones soften less after great stretches."""


def with_preset(entry: Mapping) -> Mapping:
    """An entry with what its preset gives.

    Args:
        entry: An entry of a material as it is written.

    Raises:
        PydanticCustomError: The preset is not known, is refused, or something beside it says
            otherwise.
    """
    name = entry.get("preset")
    if name is None:
        return entry
    if name in UNFITTED:
        raise refusal("preset", name, f"is refused: {UNFITTED[name]}; give law and constants")
    if not isinstance(name, str) or name not in MATERIAL_PRESETS:
        word = re.sub(r"[\W_]+", "", str(name)).lower()
        alike = [one for one in MATERIAL_PRESETS if word and one.replace("_", "").startswith(word)]
        if alike:
            raise refusal("preset", name, f"is no preset; is {' or '.join(alike)} meant?")
        raise refusal("preset", name, f"is none of the presets: {', '.join(MATERIAL_PRESETS)}"
                      f"{nearest(name, MATERIAL_PRESETS)}")  # fmt: skip
    preset = MATERIAL_PRESETS[name]
    own = {"law": preset.law, "constants": preset.constants, "young_modulus": None}
    for key, value in own.items():
        given = entry.get(key)
        if given is not None and given != value:
            raise refusal(key, given, f"is what the preset {name} gives: leave out one of them")
    filled = {**entry, "law": preset.law, "constants": dict(preset.constants)}
    if entry.get("poisson_ratio") is None and entry.get("bulk_modulus") is None:
        filled["poisson_ratio"] = POISSON_RATIO
    if entry.get("density") is None and entry.get("total_mass") is None:
        filled["density"] = preset.density
    if entry.get("strain_range") is None:
        filled["strain_range"] = preset.strain_range
    return filled


def _numbers_by_name(given: Any) -> Any:
    """Constants as floats and tuples of floats; which of them a law takes is checked later."""
    if given is None:
        return None
    if not isinstance(given, Mapping):
        raise ValueError("must be a section with the constants of the law by name")
    return {str(name): _constant(str(name), value) for name, value in given.items()}


def _constant(name: str, value: Any) -> float | tuple[float, ...]:
    if isinstance(value, list | tuple):
        parts = (_constant(f"{name}[{index}]", part) for index, part in enumerate(value))
        return tuple(parts)  # type: ignore[arg-type]  # laws refuse lists inside lists
    try:
        if isinstance(value, bool | bytes):
            raise TypeError
        number = float(value)
    except (TypeError, ValueError):
        raise refusal(name, value, "must be a number, written without its unit") from None
    if not math.isfinite(number):
        raise refusal(name, value, "must be finite")
    return number


class ElasticEntry(Entry):
    """The constants of a law, which a body's material and those of its parts share."""

    told: ClassVar[tuple[str, ...]] = (
        "viscous: shares {viscosity}", "{softening}", "{fit}", "strain range {strain_range:%}",
    )  # fmt: skip

    law: Annotated[str | None, registered("law", law_names)] = None
    """The law; more can be registered."""
    young_modulus: Annotated[float | None, unit("Pa", gt=0.0)] = None
    """E at rest, for laws without `constants`."""
    poisson_ratio: Annotated[float | None, unit("", gt=-1.0, le=0.5)] = None
    """ν at rest; 0.5 is for hyperelastic laws."""
    bulk_modulus: Annotated[float | None, unit("Pa", gt=0.0)] = None
    """κ at rest, in place of Poisson's ratio."""
    constants: Annotated[Any, BeforeValidator(_numbers_by_name)] = None
    """Constants of laws that have their own."""
    preset: str | None = None
    """A material by name, such as ``dragon_skin_30``."""
    strain_range: Annotated[tuple[float, float] | None, unit("")] = None
    """Principal strains in which the law is trusted."""

    @model_validator(mode="before")
    @classmethod
    def _fill_in_preset(cls, entry: Any) -> Any:
        if isinstance(entry, str):
            entry = {"preset": entry}
        return with_preset(entry) if isinstance(entry, Mapping) else entry

    def check(self) -> None:
        """Refuse strains that are not in order, and two constants that say the same."""
        strains = self.strain_range
        if strains is not None and not -1.0 < strains[0] < 0.0 < strains[1]:
            raise refusal("strain_range", list(strains),
                          "must be two strains: the least between -1 and 0, the greatest above 0")
        if self.poisson_ratio is not None and self.bulk_modulus is not None:
            raise refusal("bulk_modulus", self.bulk_modulus,
                          f"is beside poisson_ratio {self.poisson_ratio:g}, which says the same; "
                          "give one")

    @property
    def fit(self) -> str | None:
        """How well a preset describes what is sold, in words; None without one."""
        if self.preset is None:
            return None
        preset = MATERIAL_PRESETS[self.preset]
        low, high = 100.0 * preset.curve[0][0], 100.0 * preset.largest_strain
        return (f"preset {self.preset}: fitted with an error of {100.0 * preset.rms_error:.1f} % "
                f"(largest {100.0 * preset.largest_error:.1f} %) to {preset.source}, its data lie "
                f"at strains of {low:.0f} % to {high:.0f} % in tension: at smaller ones, and in "
                "compression, the law is extrapolated")  # fmt: skip

    def volume_constants(self, otherwise: ElasticEntry | None = None) -> tuple[float | None, float | None]:
        """Poisson's ratio and bulk modulus at rest [Pa], of which one is given, or none.

        Args:
            otherwise: An entry whose constant holds where this has none.
        """
        if self.poisson_ratio is None and self.bulk_modulus is None and otherwise is not None:
            return otherwise.volume_constants()
        return self.poisson_ratio, self.bulk_modulus

    def check_law(self, law: str, otherwise: ElasticEntry | None = None) -> None:
        """Check that these are the constants of a law.

        Args:
            law: Its name.
            otherwise: An entry whose Poisson's ratio or bulk modulus holds where this has none.

        Raises:
            PydanticCustomError: A constant is missing, is none of the law's, or does not fit.
        """
        own = law_named(law).own
        if own is not None and own.bulk_modulus is not None:
            for key in ("poisson_ratio", "bulk_modulus"):
                if getattr(self, key) is not None:
                    raise refusal(key, getattr(self, key), f"the law {law} has it among its constants")
            self._check_own_constants(law, own)
            return
        nu, kappa = self.volume_constants(otherwise)
        if nu is None and kappa is None:
            raise refusal("poisson_ratio", "(nothing)", "is required, or bulk_modulus [Pa] in its place")
        if nu == 0.5 and not has_bulk_modulus(law_named(law).parameters):
            raise refusal("poisson_ratio", nu,
                          f"the law {law} is not defined for an incompressible material: give less "
                          "than 0.5, or a law with a bulk modulus, such as neo_hookean")
        if own is not None:
            self._check_own_constants(law, own)
            return
        if self.constants is not None:
            raise refusal("constants", self.constants,
                          f"the law {law} has no constants of its own; it takes young_modulus [Pa] "
                          "and poisson_ratio")
        if self.young_modulus is None:
            raise refusal("young_modulus", "(nothing)", f"is required by the law {law}")
        if kappa is not None and not poisson_ratio_of_bulk(self.young_modulus, kappa) > -1.0:
            least = self.young_modulus / 9.0
            raise refusal("bulk_modulus", kappa, f"must be above young_modulus / 9, {least:g} Pa")

    def _check_own_constants(self, law: str, own: OwnConstants) -> None:
        """Check the constants of a law with constants of its own."""
        takes = f"the law {law} takes constants: {{{_described(own)}}}"
        if self.young_modulus is not None:
            raise refusal("young_modulus", self.young_modulus, f"{takes}, not young_modulus")
        if self.constants is None:
            raise refusal("constants", "(nothing)", f"is required: {takes}")
        _check_constants(self.constants, own, takes)
        try:
            mu = own.shear_modulus(self.constants)
        except ValueError as error:
            raise refusal("constants", self.constants, f"{error}; {takes}") from None
        if not mu > 0.0:
            raise refusal("constants", self.constants,
                          f"give the shear modulus {mu:g} Pa at rest, which must be above 0 Pa",
                          unit="Pa")


def _described(own: OwnConstants) -> str:
    """Constants of a law with their units: ``c10, c01 [Pa]``."""
    words = []
    for index, constant in enumerate(own.constants):
        name = f"{constant.name}: [..]" if constant.is_list else constant.name
        rest = own.constants[index + 1 :]
        same = rest and (rest[0].unit, rest[0].is_list) == (constant.unit, constant.is_list)
        words.append(name if same or not constant.unit else f"{name} [{constant.unit}]")
    return ", ".join(words)


def _check_constants(given: dict, own: OwnConstants, takes: str) -> None:
    """Refuse unknown, missing, wrong and endless constants by name."""
    known = {constant.name: constant for constant in own.constants}
    for name, value in given.items():
        if name not in known:
            raise refusal(f"constants.{name}", value, f"is none of its constants: {takes}")
    for name, constant in known.items():
        key, measured = f"constants.{name}", constant.unit
        if name not in given:
            raise refusal(key, "(nothing)", f"is required: {takes}", unit=measured)
        value = given[name]
        if isinstance(value, tuple) != constant.is_list:
            kind = "a list of numbers, one for each term" if constant.is_list else "one number"
            raise refusal(key, value, f"must be {kind}: {takes}", unit=measured)
        numbers = value if constant.is_list else (value,)
        if not numbers or any(isinstance(number, tuple) for number in numbers):
            raise refusal(key, value, f"must have a number for each term: {takes}", unit=measured)
        if not all(abs(number) <= LARGEST for number in numbers):
            raise refusal(key, value, f"must not be greater than {LARGEST:g}", unit=measured)


class Material(ElasticEntry):
    """The material law."""

    told: ClassVar[tuple[str, ...]] = ("{density} kg/m³", "{total_mass} kg in total", *ElasticEntry.told)

    law: Annotated[str, registered("law", law_names)] = "corotational"
    density: Annotated[float | None, unit("kg/m³", gt=0.0)] = None
    """Mass by volume."""
    total_mass: Annotated[float | None, unit("kg", gt=0.0)] = None
    """In place of a density."""
    viscosity: tuple[ViscosityTerm, ...] = ()
    """Prony series of a hyperelastic law."""
    softening: Softening | None = None

    def check(self) -> None:
        """Refuse no mass, two masses, and constants that are not those of the law."""
        super().check()
        if self.density is not None and self.total_mass is not None:
            raise ValueError(f"density {self.density:g} kg/m³ and total_mass {self.total_mass:g} "
                             "kg are both given; give one of them")
        if self.density is None and self.total_mass is None:
            raise ValueError("density [kg/m³] or total_mass [kg] is required")
        self.check_law(self.law)


class BoxRegion(Entry):
    """Nodes inside an axis-aligned box."""

    told: ClassVar[tuple[str, ...]] = ("box from {minimum:mm} mm to {maximum:mm} mm",)

    minimum: Vector
    """Lower corner."""
    maximum: Vector
    """Upper corner."""

    def check(self) -> None:
        """Refuse corners that are not in order."""
        if any(a > b for a, b in zip(self.minimum, self.maximum, strict=True)):
            raise ValueError("the minimum of a box is above its maximum")

    def __str__(self) -> str:
        return f"{list(self.minimum)}..{list(self.maximum)}"


class RegionMaterial(ElasticEntry):
    """The material of some cells: of a named region, or of a box."""

    placed: ClassVar[dict[str, str]] = {"box": "box"}
    one_of: ClassVar[tuple[str, ...]] = ("region", "box")

    region: str | None = None
    """Name of a volume in the mesh file."""
    box: BoxRegion | None = None
    """The cells whose centre is in it."""
    frame: Literal["world", "mesh"] = "world"
    """Frame of the box; `mesh` is before the placement."""
    density: Annotated[float | None, unit("kg/m³", gt=0.0)] = None
    """By default, as law and Poisson's ratio, from `material`."""
    viscosity: tuple[ViscosityTerm, ...] | None = None
    """By default from `material`; [] for none."""
    softening: Softening | None = None

    @property
    def place(self) -> str:
        """Which cells are of it, in words."""
        return f"region {self.region}" if self.box is None else self.box.describe()


class SphereRegion(Entry):
    """Nodes inside a sphere."""

    placed: ClassVar[dict[str, str]] = {"centre": "point"}

    centre: Vector
    """Centre."""
    radius: Annotated[float, unit("m", gt=0.0)]
    """Radius."""


class Region(Entry):
    """Nodes in a box or in a sphere, or by their index."""

    placed: ClassVar[dict[str, str]] = {"box": "box", "sphere": "inside"}
    one_of: ClassVar[tuple[str, ...]] = ("box", "sphere", "nodes")
    one_of_words: ClassVar[str] = "a region has exactly one of {}"

    frame: Literal["world", "mesh"] = "world"
    """`mesh` is before the placement."""
    box: BoxRegion | None = None
    sphere: SphereRegion | None = None
    nodes: tuple[Annotated[int, Field(ge=0)], ...] | None = None
    """Nodes, by their index in the mesh file."""


class FixedRegion(Region):
    """Nodes that do not move along some axes."""

    placed: ClassVar[dict[str, str]] = {**Region.placed, "axes": "letters"}

    axes: Annotated[tuple[Literal["x", "y", "z"], ...], Field(min_length=1)] = ("x", "y", "z")
    """Axes of the world along which they do not move."""


class Attachment(Region):
    """Nodes that move with a rigid body, which takes their mass if it is free."""

    to: Name
    """The rigid body."""


class Vertebra(NamedEntry):
    """A rigid part of a body: the nodes of a region of its mesh, or in a box."""

    placed: ClassVar[dict[str, str]] = {"box": "box"}
    one_of: ClassVar[tuple[str, ...]] = ("region", "box")

    region: str | None = None
    """Name of a volume in the mesh file."""
    box: BoxRegion | None = None
    """The nodes in it."""
    frame: Literal["world", "mesh"] = "mesh"
    """Frame of the box; `mesh` is before the placement."""


class Vertebrae(Entry):
    """Reduces a body to rigid vertebrae with superelements between them, by ``reduce-vertebrae``.

    The superelements are made once, by ``python -m softrobot_twin reduce-vertebrae SCENE``.
    """

    placed: ClassVar[dict[str, str]] = {"rigid": "regions"}

    rigid: Annotated[tuple[Vertebra, ...], Field(min_length=2)]
    """One that holds fixed nodes is fixed."""
    superelements: Path | None = None
    """Their file; by default beside the mesh."""
    degree: Annotated[int, Field(ge=2, le=6)] = 4
    """Total degree of their polynomials."""


class Reduced(Entry):
    """Reduces a body to the coordinates of a basis, made by ``reduce``."""

    file: Path
    """File of the reduced model."""
    spare_modes: bool = False
    """Use the spare modes: more exact, slower, without an estimate of the error."""


class Damping(Entry):
    """Rayleigh damping, C = α M + β K; the damping ratio is α/2ω + βω/2."""

    mass: Annotated[float, unit("1/s", ge=0.0)] = 0.0
    """α: in first-order motion it is the drag."""
    stiffness: Annotated[float, unit("s", ge=0.0)] = 0.0
    """β; K is the stiffness of the present shape."""


class Visual(Entry):
    """A finer surface, only for display."""

    file: Path
    """Surface mesh, placed like the body's own mesh."""
    scale: Annotated[float, unit("m per file unit", gt=0.0)] = 1.0
    """Metres in a file unit."""


class ContactSurface(Visual):
    """A closed surface for contact, in place of the mesh's."""


class Body(Entry):
    """One deformable body."""

    placed: ClassVar[dict[str, str]] = {"mesh": "inside", "materials": "regions", "fixed": "regions",
                                         "attached": "regions", "vertebrae": "inside"}  # fmt: skip

    name: Name = "body"
    """Its name."""
    mesh: Mesh
    element: Annotated[str, registered("element", element_names)] = "quadratic"
    """Linear is too stiff in bending; smoothed is about as exact as quadratic, and faster."""
    material: Material
    materials: tuple[RegionMaterial, ...] = ()
    """Of parts; other cells have `material`."""
    fixed: tuple[FixedRegion, ...] = ()
    """Nodes that do not move."""
    attached: tuple[Attachment, ...] = ()
    """Nodes that move with a rigid body."""
    volume: Literal["per_element", "patches"] | None = None
    """Where volumes are kept; patches do not lock near ν 0.5. Default: patches for smoothed
    elements."""
    mass: Literal["lumped", "consistent", "uniform"] | None = None
    """By volume, by shape functions, or equally. Default: consistent for quadratic elements, else
    lumped."""
    damping: Damping = Damping()
    vertebrae: Vertebrae | None = None
    """Rigid parts of a reduced body, by `reduce-vertebrae`."""
    reduced: Reduced | None = None
    """Basis of a reduced body, made by `reduce`."""
    visual: Visual | None = None
    contact_surface: ContactSurface | None = None

    def check(self) -> None:
        """Refuse materials without a density, and what is not built for the body."""
        if self.materials and self.material.density is None:
            raise ValueError("a body with materials needs material.density: a total_mass does not "
                             "say how the mass is distributed")
        self._check_reduction()
        self._check_memory()
        for index, part in enumerate(self.materials):
            try:
                part.check_law(part.law or self.material.law, self.material)
            except PydanticCustomError as error:
                inner = error.context or {}
                raise refusal(f"materials[{index}].{inner['key']}", inner["value"], inner["reason"],
                              unit=inner["unit"]) from None

    def _check_reduction(self) -> None:
        """Refuse what is not built for bodies in the coordinates of a basis, or with vertebrae."""
        if self.reduced is None and self.vertebrae is None:
            return
        if self.reduced is not None and self.vertebrae is not None:
            raise refusal("reduced", str(self.reduced.file), "is given beside vertebrae: name one of them")
        if self.reduced is not None and self.has_patches:
            raise refusal("volume", "patches", PATCHES_NOT_REDUCED)
        bodies = "bodies with vertebrae" if self.reduced is None else "reduced bodies"
        for index, region in enumerate(self.fixed):
            if len(set(region.axes)) < 3:
                raise refusal(f"fixed[{index}].axes", ", ".join(region.axes), f"is not built for {bodies}")
        for key, entry in self._materials_by_key().items():
            for name in ("viscosity", "softening"):
                if getattr(entry, name):
                    raise refusal(f"{key}.{name}", self.name, f"is not built for {bodies}")

    def _check_memory(self) -> None:
        """Refuse viscosity and softening where they are not built."""
        base = self.material
        for key, entry in self._materials_by_key().items():
            law = base.law if entry.law is None else entry.law
            viscosity = base.viscosity if entry.viscosity is None else entry.viscosity
            softening = base.softening if entry.softening is None else entry.softening
            shares = [term.share for term in viscosity]
            if shares and not sum(shares) < 1.0:
                raise refusal(f"{key}.viscosity", f"shares {shares}",
                              f"sum to {sum(shares):g}: they are shares of the modulus at once, "
                              "and must leave some of it: less than 1")
            for name, asked in (("viscosity", shares), ("softening", softening)):
                if not asked:
                    continue
                if not has_bulk_modulus(law_named(law).parameters):
                    names = [name for name in law_names()
                             if has_bulk_modulus(law_named(name).parameters)]  # fmt: skip
                    raise refusal(f"{key}.{name}", law,
                                  f"is not a law that {name} is built for: {', '.join(names)}")

    def _materials_by_key(self) -> dict[str, Any]:
        parts = {f"materials[{index}]": part for index, part in enumerate(self.materials)}
        return {"material": self.material, **parts}

    @property
    def has_patches(self) -> bool:
        """Whether patches of elements resist changes of its volume."""
        if self.volume is not None:
            return self.volume == "patches"
        laws = (self.material.law, *(part.law for part in self.materials if part.law))
        return element_named(self.element).has_patches and all(
            can_divide(law_named(law).parameters) for law in laws
        )

    @property
    def mass_model(self) -> Literal["lumped", "consistent", "uniform"]:
        """How its mass is distributed to the nodes."""
        if self.mass is not None:
            return self.mass
        return "lumped" if element_named(self.element).lumps_mass else "consistent"


# --- beams ---------------------------------------------------------------------------------------


class RectangleSection(Entry):
    """A rectangular cross-section."""

    told: ClassVar[tuple[str, ...]] = ("{thickness:mm} × {width:mm} mm",)

    thickness: Annotated[float, unit("m", gt=0.0)]
    """Along the `thickness_direction`."""
    width: Annotated[float, unit("m", gt=0.0)]
    """At right angles to it."""
    torsion: Annotated[float | None, unit("m⁴", gt=0.0)] = None
    """Torsion constant; by default by Saint-Venant."""
    shear_factor: Annotated[float | None, unit("", gt=0.0, le=1.0)] = None
    """Shear area by area; by default by Cowper."""


class CircleSection(Entry):
    """A full circle."""

    told: ClassVar[tuple[str, ...]] = ("circle of radius {radius:mm} mm",)

    radius: Annotated[float, unit("m", gt=0.0)]
    """Radius."""


class TubeSection(Entry):
    """A circular tube."""

    told: ClassVar[tuple[str, ...]] = ("tube of radius {radius:mm} mm", "wall {wall:mm} mm")

    radius: Annotated[float, unit("m", gt=0.0)]
    """The outer radius."""
    wall: Annotated[float, unit("m", gt=0.0)]
    """Thickness of the wall."""

    def check(self) -> None:
        """Refuse a wall that leaves no hollow."""
        if self.wall >= self.radius:
            raise ValueError("the wall of a tube is thinner than its radius; a circle has no wall")


class GivenSection(Entry):
    """A cross-section by its constants; y is the `thickness_direction`, z = tangent × y."""

    told: ClassVar[tuple[str, ...]] = ("given constants",)

    area: Annotated[float, unit("m²", gt=0.0)]
    """Area."""
    inertia_y: Annotated[float, unit("m⁴", gt=0.0)]
    """∫ z² dA, of bending that deflects along z."""
    inertia_z: Annotated[float, unit("m⁴", gt=0.0)]
    """∫ y² dA, of bending that deflects along y."""
    torsion: Annotated[float, unit("m⁴", gt=0.0)]
    """Torsion constant."""
    shear_area_y: Annotated[float | None, unit("m²", gt=0.0)] = None
    """Of shear along y; by default 5/6 of the area."""
    shear_area_z: Annotated[float | None, unit("m²", gt=0.0)] = None
    """By default 5/6 of the area."""
    radius: Annotated[float | None, unit("m", gt=0.0)] = None
    """For touching and pictures; by default from the area."""


class CrossSection(Entry):
    """A rectangle, a circle, a tube, or given constants."""

    told: ClassVar[tuple[str, ...]] = (
        "{rectangle}", "{circle}", "{tube}", "{constants}", "{end_scale} of it at the end",
    )  # fmt: skip
    one_of: ClassVar[tuple[str, ...]] = ("rectangle", "circle", "tube", "constants")
    one_of_words: ClassVar[str] = "a section has exactly one of {}"

    rectangle: RectangleSection | None = None
    circle: CircleSection | None = None
    tube: TubeSection | None = None
    constants: GivenSection | None = None
    end_scale: Annotated[float, unit("", gt=0.0)] = 1.0
    """Size at the end by size at the start, linear between."""

    @property
    def is_round(self) -> bool:
        """Whether it is the same in all directions."""
        return self.circle is not None or self.tube is not None


class BeamMaterial(Entry):
    """Isotropic, linear elastic."""

    told: ClassVar[tuple[str, ...]] = ("E {young_modulus} Pa", "ν {poisson_ratio}", "{density} kg/m³")

    young_modulus: Annotated[float, unit("Pa", gt=0.0)]
    """E."""
    poisson_ratio: Annotated[float, unit("", gt=-1.0, le=0.5)]
    """ν."""
    density: Annotated[float, unit("kg/m³", gt=0.0)]
    """Mass by volume."""


class BeamJoint(Entry):
    """Joins a point of a beam to something else."""

    placed: ClassVar[dict[str, str]] = {"axis": "direction", "through": "point"}

    at: Literal["start", "end"] | Annotated[int, Field(ge=0)]
    """A point, by its index."""
    to: str
    """A rigid body, beam or ``world``; of a pattern such as ``hub_*`` the nearest."""
    by: Literal["rigid", "hinge", "ball"] = "rigid"
    """Rigidly, by a hinge about `axis`, or a ball joint."""
    to_at: Literal["start", "end"] | Annotated[int, Field(ge=0)] | None = None
    """Point of the other beam; by default the one in the same place."""
    axis: Direction | None = None
    """Axis of a hinge, in the world at rest."""
    through: Vector | None = None
    """Its place; by default the joined point."""

    def check(self) -> None:
        """Refuse a hinge without an axis, and an axis or a place without a hinge."""
        if self.by == "hinge" and (self.axis is None or not any(self.axis)):
            raise ValueError("a hinge needs an axis that is not zero")
        if self.by != "hinge" and self.axis is not None:
            raise ValueError(f"an axis is that of a hinge; this joint is {self.by}")
        if self.by == "rigid" and self.through is not None:
            raise ValueError("a rigid joint needs no place: it is rigid between what it joins")
        if self.by == "rigid" and self.to == "world":
            raise ValueError("an end that is clamped in the world is given as fixed")

    def describe(self) -> str:
        """What is joined to what, and how it can turn."""
        at = self.at if isinstance(self.at, str) else f"point {self.at}"
        turns = {"hinge": " by a hinge about {axis}", "ball": " by a ball joint"}.get(self.by, "")
        return self.phrase(f"{at} to {{to}}{turns}")


class BeamArc(Entry):
    """A piece of a circle that lengthens a beam beyond its first or last point, without a corner.

    What lies beyond the arc is rigid: a joint of the beam's end takes hold of the end of the arc.
    """

    placed: ClassVar[dict[str, str]] = {"towards": "direction"}

    at: Literal["start", "end"]
    """The end of the beam."""
    radius: Annotated[float, unit("m", gt=0.0)]
    """Radius of its axis."""
    angle: Annotated[float, unit("rad", gt=0.0, lt=2.0 * math.pi)]
    """How far it bends."""
    towards: Annotated[Direction, not_zero("must not be zero: the centre lies there")]
    """From the beam's end to the centre."""
    elements: Annotated[int, Field(ge=1, le=1000)] = 2
    """Its elements, beside those of the beam."""


class Beam(NamedEntry):
    """A slender body that bends, twists, stretches and shears."""

    placed: ClassVar[dict[str, str]] = {"points": "point", "thickness_direction": "direction",
                                        "joined": "regions", "arcs": "regions"}  # fmt: skip

    points: Annotated[tuple[Vector, ...], Field(min_length=2)]
    """Its axis at rest."""
    curve: Literal["straight", "smooth"] = "straight"
    """Straight with rigid corners, or a smooth curve."""
    elements: Annotated[int, Field(ge=1, le=100_000)]
    """At least one between two points."""
    section: CrossSection
    thickness_direction: Annotated[Direction | None, not_zero("must not be zero")] = None
    """Direction y of the cross-section; a round section needs none."""
    material: BeamMaterial
    fixed: tuple[Literal["start", "end"], ...] = ()
    """Ends that are clamped in the world."""
    joined: tuple[BeamJoint, ...] = ()
    arcs: Annotated[tuple[BeamArc, ...], Field(max_length=2)] = ()
    """Arcs at its ends."""
    damping: Damping = Damping()

    def check(self) -> None:
        """Refuse points, elements, joints, arcs and fixed ends that make no beam."""
        spans = len(self.points) - 1
        for index, (a, b) in enumerate(zip(self.points, self.points[1:], strict=False)):
            if a == b:
                raise ValueError(f"points {index} and {index + 1} are the same point")
        if self.elements < spans:
            raise ValueError(f"{self.elements} elements are too few for {spans + 1} points: one "
                             "between two points is the least")
        if self.thickness_direction is None and not self.section.is_round:
            raise ValueError("thickness_direction is required for a section that is not round")
        for joint in self.joined:
            if isinstance(joint.at, int) and joint.at > spans:
                raise ValueError(f"joins point {joint.at}, but has the points 0 to {spans}")
        if len(set(self.fixed)) != len(self.fixed):
            raise ValueError("names an end twice in fixed")
        if len({arc.at for arc in self.arcs}) != len(self.arcs):
            raise ValueError("has two arcs at one end")


# --- rigid shapes -------------------------------------------------------------------------------


class Shaped(Entry):
    """Base of entries with exactly one shape, placed in the world."""

    told: ClassVar[tuple[str, ...]] = ("{shape}",)
    placed: ClassVar[dict[str, str]] = {"position": "point", "rotation": "angles"}
    one_of: ClassVar[tuple[str, ...]] = ("plane", "sphere", "capsule", "cylinder", "box", "surface")
    one_of_words: ClassVar[str] = "must have exactly one of the shapes {}"

    position: Vector = (0.0, 0.0, 0.0)
    """Where the origin of the shape is."""
    rotation: Angles = (0.0, 0.0, 0.0)
    """Angles about the world's axes."""
    plane: Plane | None = None
    sphere: Sphere | None = None
    capsule: Capsule | None = None
    cylinder: Cylinder | None = None
    box: Box | None = None
    surface: SurfaceFile | None = None

    @property
    def shape(self) -> ShapeEntry:
        """The one shape."""
        return getattr(self, self.given(self.one_of)[0])


# --- rigid bodies, springs and point masses ------------------------------------------------------


class Obstacle(NamedEntry, Shaped):
    """A shape that does not move."""



class RigidJoint(Entry):
    """Joins a free rigid body to another rigid body or to the world."""

    told: ClassVar[tuple[str, ...]] = ("{to:=}", "by a {by:=} at {through}", "about {axis}")
    placed: ClassVar[dict[str, str]] = {"through": "point", "axis": "direction"}

    to: Name
    """The other rigid body, or ``world``."""
    by: Literal["hinge", "ball"]
    """A hinge about `axis`, or a ball joint."""
    through: Vector
    """Its place, as drawn."""
    axis: Annotated[Direction | None, not_zero("must not be zero")] = None
    """Axis of a hinge, in the world as drawn."""
    stiffness: Annotated[float, unit("N/m", gt=0.0)] = 1.0e6
    """Of the bearing."""

    def check(self) -> None:
        """Refuse a hinge without an axis, and a ball joint with one."""
        if (self.by == "hinge") != (self.axis is not None):
            raise ValueError("a hinge has an axis, and a ball joint has none")


class RigidBody(NamedEntry, Shaped):
    """A rigid body: free, guided by commanded poses, or fixed."""

    told: ClassVar[tuple[str, ...]] = (
        "{motion:=}", "{shape}", "{mass} kg", "{density} kg/m³", "at most {speed:mm} mm/s",
        "at most {turn_rate} rad/s",
    )  # fmt: skip
    placed: ClassVar[dict[str, str]] = {
        **Shaped.placed, "velocity": "direction", "angular_velocity": "direction",
        "joined": "inside",
    }  # fmt: skip

    motion: Literal["free", "guided", "fixed"] = "free"
    """By forces, by commanded poses, or not at all."""
    mass: Annotated[float | None, unit("kg", gt=0.0)] = None
    """Mass of a free body."""
    density: Annotated[float | None, unit("kg/m³", gt=0.0)] = None
    """Of a free body, in place of a mass."""
    velocity: Annotated[tuple[float, float, float], unit("m/s")] = (0.0, 0.0, 0.0)
    """At the start."""
    angular_velocity: Annotated[tuple[float, float, float], unit("rad/s")] = (0.0, 0.0, 0.0)
    """At the start."""
    damping: Annotated[float, unit("1/s", ge=0.0)] = 0.0
    """α: the drag is α times mass and inertia."""
    speed: Annotated[float | None, unit("m/s", gt=0.0)] = None
    """Greatest speed; by default the robot's size per second."""
    turn_rate: Annotated[float | None, unit("rad/s", gt=0.0)] = None
    """Greatest angular speed; by default 1 rad/s."""
    joined: tuple[RigidJoint, ...] = ()
    """Hinges and ball joints of a free body."""

    def check(self) -> None:
        """Refuse what a body of its motion does not have, and a free one without mass."""
        given = [value for value in (self.mass, self.density) if value is not None]
        if self.motion == "free" and len(given) != 1:
            raise ValueError("a free rigid body has either a mass or a density")
        if self.motion == "guided" and given:
            raise ValueError("a guided rigid body follows commanded poses: it has no mass")
        if self.motion == "fixed" and given:
            raise ValueError("a fixed rigid body does not move: it has no mass")
        if self.motion != "guided" and (self.speed is not None or self.turn_rate is not None):
            raise ValueError("speed and turn_rate are limits of guided bodies")
        if self.motion != "free" and any(self.velocity + self.angular_velocity):
            raise ValueError(f"a {self.motion} rigid body has no initial velocity")
        if self.motion != "free" and self.joined:
            raise ValueError(f"a {self.motion} rigid body takes no part in forces: join the free body")
        if self.plane is not None:
            raise ValueError("a plane is infinite: it can only be an obstacle")


class SpringEnd(Entry):
    """A point at rest, on a body or in the world."""

    told: ClassVar[tuple[str, ...]] = ("{on:=}",)
    placed: ClassVar[dict[str, str]] = {"point": "point"}

    on: Name = "world"
    """Name of a body, or ``world``."""
    point: Vector
    """Where it is at rest."""


class Spring(NamedEntry):
    """A spring between two points."""

    told: ClassVar[tuple[str, ...]] = ("{ends: to }", "{stiffness} N/m", "{damping} N s/m")
    placed: ClassVar[dict[str, str]] = {"ends": "inside"}

    ends: tuple[SpringEnd, SpringEnd]
    stiffness: Annotated[float, unit("N/m", gt=0.0)]
    """Force by change of length."""
    rest_length: Annotated[float | None, unit("m", ge=0.0)] = None
    """By default the distance of the ends at rest."""
    damping: Annotated[float, unit("N s/m", ge=0.0)] = 0.0
    """Force by rate of change of length."""


class Tube(NamedEntry):
    """Springs along a path through a body, such as a tube around a cable."""

    told: ClassVar[tuple[str, ...]] = ("{points:#point}", "EA {axial_stiffness} N")
    placed: ClassVar[dict[str, str]] = {"points": "point"}

    on: Name | None = None
    """Its body."""
    points: Annotated[tuple[Vector, ...], Field(min_length=2)]
    """Its path at rest."""
    axial_stiffness: Annotated[float, unit("N", gt=0.0)]
    """EA: the force that would double its length."""


MOST_SEGMENTS = 50_000
"""A helix of more segments is refused: its threads would be finer than any mesh."""


class Helix(Entry):
    """Threads wound around an axis, in a body."""

    point: Vector = (0.0, 0.0, 0.0)
    """A point of the axis."""
    direction: Annotated[Direction, not_zero("the direction of a helix must not be zero")] = UP
    """Direction of the axis."""
    radius: Annotated[float, unit("m", gt=0.0)]
    """Distance of the threads from the axis."""
    pitch: Annotated[float, unit("m", gt=0.0)]
    """Advance in one turn."""
    reach: Annotated[tuple[float, float], unit("m")]
    """First and last place along the axis."""
    count: Annotated[int, Field(ge=1, le=1000)] = 1
    """Threads of each handedness."""
    handedness: Literal["right", "left", "both"] = "both"
    """Sense about the direction."""
    phase: Annotated[float, unit("rad")] = 0.0
    """Where the first thread begins, from x; for an axis near x, from y."""
    segments_per_turn: Annotated[int, Field(ge=3, le=1000)] = 24
    """Straight pieces in a turn."""

    def check(self) -> None:
        """Refuse a helix without length, and too fine ones."""
        if not self.reach[0] < self.reach[1]:
            raise ValueError("the first place of a helix along its axis is not before the last")
        turns = (self.reach[1] - self.reach[0]) / self.pitch
        segments = turns * self.segments_per_turn * self.count
        if segments > MOST_SEGMENTS:
            raise ValueError(f"{turns:.3g} turns of {self.count} threads have {segments:.3g} "
                             f"segments of {self.segments_per_turn} a turn, more than "
                             f"{MOST_SEGMENTS}: are pitch and reach in metres?")

    def describe(self) -> str:
        """Its threads and their angle."""
        hands = "each" if self.handedness == "both" else self.handedness
        angle = math.degrees(math.atan2(2.0 * math.pi * self.radius, self.pitch))
        return self.phrase(f"{{count:=}} of {hands} handedness at {angle:.1f}° to the axis, "
                         "radius {radius:mm} mm")  # fmt: skip


class Fibre(NamedEntry):
    """Threads that are stiff in tension: a helix, a path of points, or edges of the mesh.

    Exactly one of `helix`, `points` and `edges` is given.
    """

    told: ClassVar[tuple[str, ...]] = (
        "edges {edges}", "{points:#point}", "{helix}", "EA {stiffness} N {sense}",
    )  # fmt: skip
    placed: ClassVar[dict[str, str]] = {"points": "point", "helix": "helix"}
    one_of: ClassVar[tuple[str, ...]] = ("helix", "points", "edges")

    on: Name | None = None
    """Its body."""
    helix: Helix | None = None
    points: Annotated[tuple[Vector, ...], Field(min_length=2)] | None = None
    """Path of one thread at rest."""
    edges: str | None = None
    """Name of line elements in the mesh file."""
    stiffness: Annotated[float, unit("N", gt=0.0)]
    """EA of one thread: the force that would double its length."""
    tension_only: bool = True
    """Slack when shortened."""

    @property
    def sense(self) -> str:
        """When its threads resist, in words."""
        return "in tension only" if self.tension_only else "in tension and compression"


class MassSpringBody(NamedEntry):
    """Point masses connected by springs."""

    told: ClassVar[tuple[str, ...]] = ("{points:#point}", "{springs:#spring} of {stiffness:=} N/m")
    placed: ClassVar[dict[str, str]] = {"points": "point"}

    points: Annotated[tuple[Vector, ...], Field(min_length=1)]
    """At rest."""
    masses: tuple[Annotated[float, unit("kg", gt=0.0)], ...]
    """One for each point, or one for all."""
    springs: tuple[tuple[Annotated[int, Field(ge=0)], Annotated[int, Field(ge=0)]], ...] = ()
    """Pairs of points, by index."""
    stiffness: Annotated[float, unit("N/m", gt=0.0)] = 1.0
    """Of each spring: force by change of length."""
    damping: Annotated[float, unit("N s/m", ge=0.0)] = 0.0
    """Of each spring: force by rate."""
    fixed: tuple[Annotated[int, Field(ge=0)], ...] = ()
    """Points that do not move, by index."""

    def check(self) -> None:
        """Refuse masses, springs and fixed points that do not fit the points."""
        count = len(self.points)
        if len(self.masses) not in (1, count):
            raise ValueError(f"has {count} points but {len(self.masses)} masses")
        named = [index for pair in self.springs for index in pair] + list(self.fixed)
        if any(index >= count for index in named):
            raise ValueError(f"names point {max(named)}, but has the points 0 to {count - 1}")
        if any(a == b for a, b in self.springs):
            raise ValueError("a spring connects a point to itself")
