"""Materials of a deformable body: one for all of it, or others for some of its cells."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from softrobot_twin.errors import MeshError, SceneError
from softrobot_twin.geometry.cell_mesh import CellMesh
from softrobot_twin.geometry.mesh_parts import MeshParts
from softrobot_twin.geometry.regions import nodes_in_box
from softrobot_twin.mechanics.laws import law_named
from softrobot_twin.mechanics.material import (
    INCOMPRESSIBLE,
    LameParameters,
    bulk_modulus,
    bulk_modulus_of_shear,
    lame_parameters,
    moduli_of_shear_and_bulk,
    poisson_ratio_of_bulk,
    shear_modulus,
)
from softrobot_twin.mechanics.point_law import can_divide
from softrobot_twin.mechanics.softening import SofteningConstants
from softrobot_twin.mechanics.viscosity import ViscousTerm
from softrobot_twin.scene import Scene
from softrobot_twin.scene.body_entries import Body as BodyEntry
from softrobot_twin.scene.body_entries import (
    ElasticEntry,
    Material,
    RegionMaterial,
    Softening,
    ViscosityTerm,
)

# A cell with corners on both sides of a face of a box, farther from it than this share of the
# body's size, is reported: it belongs to the side of its centre.
CUT_BY_FACE = 1.0e-5


@dataclass(frozen=True)
class MaterialPart:
    """Cells of a body that have one material.

    Attributes:
        key: Key of its entry, such as ``body.material`` or ``body.materials[0]``.
        law: Name of its law.
        law_parameters: Parameters of its law.
        young_modulus: At rest [Pa].
        poisson_ratio: At rest.
        density: [kg/m³].
        cells: Its cells, int64, shape (cell_count,); None for a body of one material.
        volume: Their volume [m³].
        viscosity: Its Prony series; empty for none.
        softening: Its softening; None for none.
        strain_range: Least and greatest principal strain that the law is trusted in; None for any.
    """

    key: str
    law: str
    law_parameters: tuple
    young_modulus: float
    poisson_ratio: float
    density: float
    cells: np.ndarray | None
    volume: float
    viscosity: tuple[ViscousTerm, ...] = ()
    softening: SofteningConstants | None = None
    strain_range: tuple[float, float] | None = None

    @property
    def turns(self) -> bool:
        """Whether its law follows rotations."""
        return self.law != "linear"

    @property
    def shear_modulus(self) -> float:
        """µ at rest [Pa]."""
        return shear_modulus(self.young_modulus, self.poisson_ratio)

    @property
    def lame_parameters(self) -> LameParameters:
        """Lamé's constants at rest [Pa]."""
        if self.poisson_ratio == 0.5:
            mu = self.shear_modulus
            return LameParameters(bulk_modulus(self.young_modulus, 0.5) - 2.0 * mu / 3.0, mu)
        return lame_parameters(self.young_modulus, self.poisson_ratio)


def material_parts(
    entry: BodyEntry, key: str, mesh: CellMesh, parts: MeshParts, scene: Scene, notes: list[str]
) -> tuple[MaterialPart, ...]:
    """The materials of a body: what no entry of `materials` claims has `material`.

    Args:
        entry: The body's entry.
        key: Key of this entry.
        mesh: Its mesh.
        parts: Named parts of its mesh file.
        scene: The scene.
        notes: List to which cells that a box cuts are appended.

    Returns:
        The materials that have cells: that of the body first, then the others in their order.

    Raises:
        SceneError: A region is not known, a box is empty, two entries claim a cell, or a law does
            not offer what the body asks for.
    """
    base, owner = entry.material, np.full(mesh.cell_count, -1)
    claims: list[tuple[str, Material | RegionMaterial, np.ndarray | None]] = []
    for index, other in enumerate(entry.materials):
        place = f"{key}.materials[{index}]"
        cells = _claimed(other, place, entry, mesh, parts, scene, notes)
        _refuse_claimed_twice(cells, owner, index, other, key, scene)
        owner[cells] = index
        claims.append((place, other, cells))
    rest = np.flatnonzero(owner < 0)
    if len(rest):
        claims.insert(0, (f"{key}.material", base, rest if claims else None))
    else:
        notes.append(f"{key}.material is not used: {key}.materials claims every cell")
    made = []
    for place, own, cells in claims:
        law, volume = own.law or base.law, float(mesh.volume)
        if cells is not None:
            volume = float(mesh.volumes[cells].sum())
        density = _or(own.density, base.density)
        made.append(MaterialPart(
            place, law, *law_at_rest(own, law, base),
            base.total_mass / volume if density is None else density, cells, volume,
            *_memory(_or(own.viscosity, base.viscosity), _or(own.softening, base.softening)),
            _strain_range(own, base),
        ))  # fmt: skip
        _check_volume(made[-1], entry, key, scene, notes)
    return tuple(made)


class AtRest(NamedTuple):
    """A law with its constants.

    Attributes:
        parameters: Parameters of the law.
        young_modulus: E at rest [Pa].
        poisson_ratio: ν at rest.
    """

    parameters: tuple
    young_modulus: float
    poisson_ratio: float


def law_at_rest(entry: ElasticEntry, law: str, otherwise: ElasticEntry | None = None) -> AtRest:
    """The law with the constants of an entry.

    Args:
        entry: Constants that fit the law, as scenes are checked.
        law: Its name.
        otherwise: An entry whose Poisson's ratio or bulk modulus holds where that one has none.
    """
    (nu, kappa), own = entry.volume_constants(otherwise), law_named(law).own
    if own is None:
        nu = poisson_ratio_of_bulk(entry.young_modulus, kappa) if nu is None else nu
        parameters = law_named(law).of_moduli(entry.young_modulus, nu)
        return AtRest(parameters, entry.young_modulus, nu)
    mu = own.shear_modulus(entry.constants)
    if kappa is None:
        parameters = own.parameters(entry.constants, bulk_modulus_of_shear(mu, nu))
        return AtRest(parameters, 2.0 * mu * (1.0 + nu), nu)
    return AtRest(own.parameters(entry.constants, kappa), *moduli_of_shear_and_bulk(mu, kappa))


def _check_volume(
    part: MaterialPart, entry: BodyEntry, key: str, scene: Scene, notes: list[str]
) -> None:
    """Refuse what needs a bulk modulus of laws that have none, and tell what 0.5 stands for."""
    if part.poisson_ratio == 0.5:
        kappa = INCOMPRESSIBLE * part.shear_modulus
        notes.append(
            f"{part.key}.poisson_ratio = 0.5: incompressible, by a bulk modulus of {kappa:.3g} Pa, "
            f"{INCOMPRESSIBLE:g} shear moduli; a pressure of {1e-3 * kappa:.3g} Pa changes volumes "
            "by 0.1 %"
        )
    if entry.volume != "patches":
        return
    if not can_divide(law_named(part.law).parameters):
        raise SceneError(
            scene.path, f"{key}.volume", entry.volume, "",
            f"patches need a law with a bulk modulus, such as neo_hookean; the law {part.law} of "
            f"{part.key} has none",
        )  # fmt: skip
    if entry.vertebrae is not None:
        raise SceneError(
            scene.path, f"{key}.volume", entry.volume, "",
            "superelements of vertebrae are not built with patches: omit volume or vertebrae",
        )  # fmt: skip


def cell_values(parts: tuple[MaterialPart, ...], name: str, cell_count: int):
    """A property of the materials for each cell.

    Args:
        parts: The materials.
        name: Name of the property, of any shape (...).
        cell_count: Number of cells of the body.

    Returns:
        The property itself where there is one material for all cells; otherwise one row for each
        cell, shape (cell_count, ...).
    """
    if parts[0].cells is None:
        return getattr(parts[0], name)
    first = np.asarray(getattr(parts[0], name))
    values = np.empty((cell_count, *first.shape), first.dtype)
    for part in parts:
        values[part.cells] = getattr(part, name)
    return values


def _memory(
    viscosity: tuple[ViscosityTerm, ...], softening: Softening | None
) -> tuple[tuple[ViscousTerm, ...], SofteningConstants | None]:
    """What entries of viscosity and softening say, for `RememberingElements`."""
    terms = tuple(ViscousTerm(term.share, term.time) for term in viscosity)
    if softening is None:
        return terms, None
    return terms, SofteningConstants(softening.r, softening.m, softening.beta)


def _strain_range(part: ElasticEntry, base: Material) -> tuple[float, float] | None:
    """Range of a part: its own, or that of the body where it has the body's law and constants."""
    is_other = part.law not in (None, base.law) or part.constants not in (None, base.constants)
    return part.strain_range if part.strain_range or is_other else base.strain_range


def _or(value, otherwise):
    return otherwise if value is None else value


def _claimed(
    other: RegionMaterial, place: str, entry: BodyEntry, mesh: CellMesh, parts: MeshParts,
    scene: Scene, notes: list[str],
) -> np.ndarray:  # fmt: skip
    """Cells of an entry of `materials`."""
    if other.region is not None:
        try:
            return parts.region(other.region)
        except MeshError as error:
            raise SceneError(
                scene.path, f"{place}.region", other.region, "",
                f"{entry.mesh.label} {error.reason}",
            ) from None  # fmt: skip
    corners = mesh.corner_mesh.node_positions
    if other.frame == "mesh":
        turn = Rotation.from_euler("xyz", entry.mesh.rotation)
        corners = turn.inv().apply(corners - np.asarray(entry.mesh.translation))
    of_cells = corners[mesh.corner_mesh.cells]
    low, high = np.array(other.box.minimum), np.array(other.box.maximum)
    cells = nodes_in_box(mesh.corner_mesh.centres_at(corners), low, high)
    if not len(cells):
        lowest, highest = corners.min(axis=0), corners.max(axis=0)
        raise SceneError(
            scene.path, f"{place}.box", f"{low.tolist()}..{high.tolist()}", "m",
            "holds the centre of no cell of the body, which reaches from "
            f"{lowest.tolist()} to {highest.tolist()} m",
        )  # fmt: skip
    _note_cut_cells(of_cells, cells, low, high, f"{place}.box", notes)
    return cells


def _note_cut_cells(of_cells, inside, low, high, key: str, notes: list[str]) -> None:
    """Report cells that are partly in a box: the border of the material follows their faces."""
    beside = CUT_BY_FACE * float(np.linalg.norm(np.ptp(of_cells.reshape(-1, 3), axis=0)))
    within = ((of_cells > low - beside) & (of_cells < high + beside)).all(axis=2)
    well_within = ((of_cells > low + beside) & (of_cells < high - beside)).all(axis=2)
    is_inside = np.zeros(len(of_cells), bool)
    is_inside[inside] = True
    cut = int(np.where(is_inside, ~within.all(axis=1), well_within.any(axis=1)).sum())
    if cut:
        notes.append(
            f"{key}: {cut} cells are partly inside; each has the material of the side that its "
            "centre is on, so the border follows the faces of cells. A named region of the mesh "
            "file has an exact border."
        )


def _refuse_claimed_twice(
    cells: np.ndarray, owner: np.ndarray, index: int, other: RegionMaterial, key: str, scene: Scene
) -> None:
    taken = owner[cells]
    taken = taken[taken >= 0]
    if len(taken):
        kind = "box" if other.region is None else "region"
        value = other.region
        if value is None:
            value = f"{list(other.box.minimum)}..{list(other.box.maximum)}"
        raise SceneError(
            scene.path, f"{key}.materials[{index}].{kind}", value, "m" if kind == "box" else "",
            f"claims {len(taken)} cells that {key}.materials[{taken[0]}] claims too; a cell has "
            "one material",
        )  # fmt: skip
