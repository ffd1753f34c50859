"""A deformable body of a scene: its mesh, its fixed nodes, and the points that it carries.

A body is of one material, or some of its cells are of others.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Set
from dataclasses import dataclass, fields
from functools import cached_property, lru_cache, partial, reduce
from pathlib import Path
from typing import ClassVar, NamedTuple, TypeVar

import numpy as np
from scipy.sparse import csr_array
from scipy.spatial.transform import Rotation

from softrobot_twin.errors import MeshError
from softrobot_twin.geometry.box_mesh import read_box
from softrobot_twin.geometry.cad_meshing import kept_mesh
from softrobot_twin.geometry.cell_mesh import CellMesh
from softrobot_twin.geometry.connected_pieces import connected_pieces
from softrobot_twin.geometry.hexahedral_mesh import HexahedralMesh
from softrobot_twin.geometry.mesh_parts import NO_PARTS, MeshParts
from softrobot_twin.geometry.mesh_reading import CUT, MeshReading, read_solid_mesh
from softrobot_twin.geometry.point_location import (
    PointLocation,
    locate_points,
    remembered_location,
)
from softrobot_twin.geometry.regions import nodes_in_box, nodes_in_sphere
from softrobot_twin.mechanics.barycentric import BarycentricMapping
from softrobot_twin.mechanics.element_kinds import HEXAHEDRAL, element_named
from softrobot_twin.mechanics.elements import Elements
from softrobot_twin.mechanics.force_term import ForceTerm
from softrobot_twin.mechanics.inertia import (
    ConsistentInertia,
    LumpedInertia,
    MassDamping,
    borne_masses,
    coupled_to,
    lumped_masses,
    scalar_mass_matrix,
    uniform_masses,
)
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
from softrobot_twin.mechanics.patch_volumes import (PatchVolumes, divided, element_bulk, patched_cells)
from softrobot_twin.mechanics.point_law import can_divide
from softrobot_twin.mechanics.remembering_elements import RememberingElements
from softrobot_twin.mechanics.softening import SofteningConstants
from softrobot_twin.mechanics.strain_rate_damping import StrainRateDamping
from softrobot_twin.mechanics.viscosity import ViscousTerm
from softrobot_twin.scene import Scene
from softrobot_twin.scene.body_entries import Body as BodyEntry
from softrobot_twin.scene.body_entries import (
    ElasticEntry,
    Material,
    Region,
    RegionMaterial,
    Softening,
    ViscosityTerm,
)

# A cell with corners on both sides of a face of a box, farther from it than this share of the
# body's size, is reported: it belongs to the side of its centre.
CUT_BY_FACE = 1.0e-5
# Nodes this close to a box but outside it, relative to the body's size, are reported: they may
# belong to the region.
BESIDE = 1.0e-5
# A mesh larger than this [m] is reported as probably given in millimetres.
LARGEST_SIZE = 5.0
# A point farther from the body than this share of the body's size is refused, a nearer one is
# snapped to it.
SNAP_SHARE = 0.02
# A point closer to the body than this share of its size is on it.
ON_BODY = 5.0e-6
# Where the weight of a patch ends, by its radius: its mean at a flat face is as deep as that of a
# ball, 35/128 of this and 3/8 of the radius.
SUPPORT = 48.0 / 35.0
# Least spacings of the finer lattice of samples in the support of a patch; it has up to twice this.
LATTICE = 4.0


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

    def cells_in(self, mesh: CellMesh) -> np.ndarray:
        """Its cells, shape (cell_count,).

        Args:
            mesh: The body.
        """
        return np.arange(mesh.cell_count) if self.cells is None else self.cells

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
        cells = claimed_cells(other, place, entry, mesh, parts, scene, notes)
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
        at_rest = law_at_rest(own, law, base)
        if hasattr(at_rest.parameters, "turned"):
            turn = Rotation.from_euler("xyz", entry.mesh.rotation).as_matrix()
            at_rest = at_rest._replace(parameters=at_rest.parameters.turned(turn))
        made.append(MaterialPart(
            place, law, *at_rest,
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
    if own.bulk_modulus is not None:
        nu, kappa = None, own.bulk_modulus(entry.constants)
    if kappa is None:
        parameters = own.parameters(entry.constants, bulk_modulus_of_shear(mu, nu))
        return AtRest(parameters, 2.0 * mu * (1.0 + nu), nu)
    return AtRest(own.parameters(entry.constants, kappa), *moduli_of_shear_and_bulk(mu, kappa))


def _check_volume(part: MaterialPart, entry: BodyEntry, key: str, scene: Scene, notes: list[str]) -> None:
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
        raise scene.error(f"{key}.volume", entry.volume,
                          "patches need a law with a bulk modulus, such as neo_hookean; the law "
                          f"{part.law} of {part.key} has none")
    if entry.vertebrae:
        raise scene.error(f"{key}.volume", entry.volume,
                          "superelements of vertebrae are not built with patches: omit volume or "
                          "vertebrae")


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
    return terms, SofteningConstants(softening.r, softening.m, softening.beta) if softening else None


def _strain_range(part: ElasticEntry, base: Material) -> tuple[float, float] | None:
    """Range of a part: its own, or that of the body where it has the body's law and constants."""
    is_other = part.law not in (None, base.law) or part.constants not in (None, base.constants)
    return part.strain_range if part.strain_range or is_other else base.strain_range


def _or(value, otherwise):
    return otherwise if value is None else value


def claimed_cells(
    other: RegionMaterial, place: str, entry: BodyEntry, mesh: CellMesh, parts: MeshParts,
    scene: Scene, notes: list[str],
) -> np.ndarray:  # fmt: skip
    """Cells of an entry with a region or a box, such as one of `materials`.

    Args:
        other: The entry.
        place: Its key.
        entry: That of the body.
        mesh: The body's mesh.
        parts: Named regions of its file.
        scene: The scene.
        notes: List to which warnings are appended.

    Raises:
        SceneError: There is no such cell.
    """
    if other.region:
        try:
            return parts.region(other.region)
        except MeshError as error:
            raise scene.error(f"{place}.region", other.region, f"{entry.mesh.label} {error.reason}") from None
    corners = places_in(other.frame, entry, mesh.corner_mesh.node_positions)
    of_cells = corners[mesh.corner_mesh.cells]
    low, high = np.array(other.box.minimum), np.array(other.box.maximum)
    cells = nodes_in_box(mesh.corner_mesh.centres_at(corners), low, high)
    if not len(cells):
        lowest, highest = corners.min(axis=0), corners.max(axis=0)
        raise scene.error(f"{place}.box", str(other.box),
                          "holds the centre of no cell of the body, which reaches from "
                          f"{lowest.tolist()} to {highest.tolist()} m", unit="m")
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
        kind, value = ("region", other.region) if other.region else ("box", str(other.box))
        raise scene.error(f"{key}.materials[{index}].{kind}", value,
                          f"claims {len(taken)} cells that {key}.materials[{taken[0]}] claims too; "
                          "a cell has one material", unit="m" if kind == "box" else "")


@dataclass(frozen=True)
class Body:
    """A deformable body, placed, with its fixed nodes, which answers what a scene builds of it.

    Its nodes are unknowns. Two kinds of bodies answer otherwise: `ReducedBody` and `VertebraBody`.

    Attributes:
        entry: Its entry in the scene.
        key: Key of this entry, such as ``bodies[2]``.
        mesh: The body at rest, its nodes numbered from 0.
        first_node: Its first node among all nodes of the scene.
        fixed: Nodes that are fixed or attached, shape (node_count,) of bool.
        held: Axes along which each node is held, all of those in `fixed`, shape (node_count, 3) of bool.
        riding: Its nodes attached to each rigid body, by that body's name.
        is_held: Every connected part has three nodes that are not on one line and are fixed, or
            attached to a rigid body that is guided or held by beams.
        materials: Its materials; a single one has all cells.
        parts: Named regions, surfaces and sets of edges of the mesh file, with the indices of
            `mesh`; the nodes of surfaces and edges are corners.
        vertebrae: Rigid parts that carry it; empty where its nodes or coordinates are unknowns.
        is_reduced: Whether it has fewer unknowns than free nodes.
    """

    entry: BodyEntry
    key: str
    mesh: CellMesh
    first_node: int
    fixed: np.ndarray
    held: np.ndarray
    riding: dict[str, np.ndarray]
    is_held: bool
    materials: tuple[MaterialPart, ...]
    parts: MeshParts = NO_PARTS
    vertebrae: tuple = ()
    is_reduced: ClassVar[bool] = False

    @property
    def name(self) -> str:
        """The body's name."""
        return self.entry.name

    @property
    def whole(self) -> Body:
        """The body that is not reduced; the body itself where it is not."""
        return self

    def become(self, kind: type[OfKind], **own) -> OfKind:
        """The body as one of another kind.

        Args:
            kind: Class of the kind.
            **own: Attributes that others do not have, or that change.
        """
        return kind(**{field.name: getattr(self, field.name) for field in fields(Body)} | own)

    @property
    def scene_node_count(self) -> int:
        """Number of nodes that it has among those of the scene."""
        return self.mesh.node_count

    @property
    def free_node_count(self) -> int:
        """Number of its nodes, or blocks of three coordinates, that are unknowns."""
        return int(np.count_nonzero(~self.fixed))

    @property
    def places(self) -> np.ndarray:
        """Numbers of its nodes in the scene, coordinates left out, shape (count,)."""
        return self.first_node + np.arange(self.scene_node_count)

    def rest_nodes(self) -> np.ndarray:
        """Its nodes in the scene at rest [m], shape (scene_node_count, 3)."""
        return self.mesh.node_positions

    def held_nodes(self) -> np.ndarray:
        """Axes along which its nodes in the scene are no unknowns, shape (scene_node_count, 3) of bool."""
        return self.held

    def placed(self, rigid: Iterable, first_frame_node: int) -> Body:
        """The body that knows the frames it moves with.

        Args:
            rigid: The rigid bodies of the scene, with `name`, `first_node` and `origin`.
            first_frame_node: Where the frames of its vertebrae begin among all nodes.
        """
        return self

    def mesh_nodes(self, node_positions: np.ndarray) -> np.ndarray:
        """Nodes of its mesh at a state [m], shape (node_count, 3); those of vertebrae are left out.

        Args:
            node_positions: Node positions of the scene [m], shape (node_count, 3).
        """
        return node_positions[self.first_node : self.first_node + self.scene_node_count]

    def nodes_as(self, other: Body, node_positions: np.ndarray) -> np.ndarray:
        """Its nodes in its scene, where another model of the body is [m], shape (scene_node_count, 3).

        Args:
            other: The body in the other model.
            node_positions: Node positions of that model [m], shape (node_count, 3).
        """
        return other.mesh_nodes(node_positions)

    def strained_terms(self, layout) -> Iterable[tuple[MaterialPart, ForceTerm]]:
        """What bears its strain: a term for each material and each kind of its cells, and for patches.

        Args:
            layout: The bodies, a `Layout`.
        """
        mesh, index = layout.mesh_among_nodes(self), layout.nodes.free_index
        return ((part, term) for part in self.materials
                for term in strained_terms(mesh, part, part.cells, index, self.entry.has_patches))  # fmt: skip

    def borne_masses(self, layout) -> np.ndarray:
        """Mass whose weight acts at each of its nodes [kg], shape (scene_node_count,).

        Args:
            layout: The bodies, a `Layout`.
        """
        # A body falls undeformed only if its weight is distributed like its inertia.
        if self.entry.mass_model == "consistent":
            return borne_masses(self.mesh, self.density, self._lumped_elements(layout))
        return self.node_masses()

    def motion_terms(self, layout, free_index: np.ndarray) -> Iterator[ForceTerm]:
        """Its inertia in dynamic scenes, and damping.

        Args:
            layout: The bodies, a `Layout`.
            free_index: Unknown of each node that bears mass, else -1, shape (node_count,).
        """
        dynamic, damping = layout.scene.integration == "dynamic", self.entry.damping
        own = np.flatnonzero(~self.fixed)
        nodes, masses = own + self.first_node, self.node_masses()[own]
        if dynamic and self.entry.mass_model == "consistent":
            mesh, lumped = layout.mesh_among_nodes(self), self._lumped_elements(layout)
            yield ConsistentInertia(mesh, free_index, self.density, nodes, lumped, layout.nodes.free_axes)
        elif dynamic:
            yield LumpedInertia(nodes, free_index[nodes], masses)
        if damping.mass > 0.0:
            yield MassDamping(nodes, free_index[nodes], masses, damping.mass)
        if damping.stiffness > 0.0:
            yield from self._strain_rate_dampings(layout)

    def _lumped_elements(self, layout) -> np.ndarray | None:
        """Elements with nodes attached to free rigid bodies; None without such nodes."""
        free = {part.name for part in layout.rigid if part.is_free}
        attached = [self.riding[name] for name in sorted(free & set(self.riding))]
        return coupled_to(self.mesh, np.concatenate(attached)) if attached else None

    def _strain_rate_dampings(self, layout) -> Iterator[StrainRateDamping]:
        """A term for each material and each kind of its cells.

        With patches it is the elements' share of the stiffness that is damped.
        """
        beta = self.entry.damping.stiffness
        for part in self.materials:
            for block in layout.mesh_among_nodes(self).strained_blocks(part.cells):
                lame = part.lame_parameters
                if self.entry.has_patches:
                    mu = part.shear_modulus
                    kept = divided(part.law_parameters, mu, element_bulk(block.mesh)).law.bulk_modulus
                    lame = lame._replace(lame_lambda=kept - 2.0 * mu / 3.0)
                yield StrainRateDamping(block.mesh, layout.nodes.free_index, lame, beta)

    def distances(self, points) -> np.ndarray:
        """Distances of points at rest from it, zero inside [m]; points (count, 3).

        Args:
            points: Places in the world [m], shape (count, 3).
        """
        return locate_points(self.mesh.corner_mesh, np.asarray(points, float)).distances

    @cached_property
    def size(self) -> float:
        """Diagonal of its bounding box [m]."""
        low, high = self.mesh.bounding_box
        return float(np.linalg.norm(high - low))

    @property
    def mass(self) -> float:
        """Its mass [kg]."""
        return self.entry.material.total_mass or sum(part.density * part.volume for part in self.materials)

    @property
    def density(self) -> float | np.ndarray:
        """Its mass per volume [kg/m³]: one for all cells, or of each cell, shape (cell_count,)."""
        return cell_values(self.materials, "density", self.mesh.cell_count)

    def mass_matrix(self, is_consistent: bool) -> csr_array:
        """Mass between nodes, the same along each axis [kg], sparse, shape (node_count, node_count).

        Args:
            is_consistent: Whether it is consistent, and not diagonal.
        """
        if is_consistent:
            return scalar_mass_matrix(self.mesh, self.density)
        nodes = np.arange(self.mesh.node_count)
        return csr_array((self.node_masses(), (nodes, nodes)))

    def node_masses(self) -> np.ndarray:
        """Mass of each node where the mass is diagonal, none negative [kg], shape (node_count,)."""
        spread = uniform_masses if self.entry.mass_model == "uniform" else lumped_masses
        return spread(self.mesh, self.density)

    def mapping(self, cells: np.ndarray, barycentric_weights: np.ndarray) -> BarycentricMapping:
        """Nodes and weights of points inside its cells; see `CellMesh.carriers`."""
        return self.carried_by(self.on_mesh(cells, barycentric_weights))

    def on_mesh(self, cells: np.ndarray, barycentric_weights: np.ndarray) -> BarycentricMapping:
        """The same on the nodes of its mesh, numbered from 0.

        Args:
            cells: Cell of each point, shape (count,).
            barycentric_weights: Weights of its corners, shape (count, corner_count).
        """
        return BarycentricMapping(*self.mesh.carriers(cells, barycentric_weights))

    def carried_by(self, on_mesh: BarycentricMapping) -> BarycentricMapping:
        """Points on the nodes of its mesh, numbered from 0, on the nodes of the scene.

        Args:
            on_mesh: The points on the nodes of its mesh.
        """
        return BarycentricMapping(on_mesh.nodes + self.first_node, on_mesh.barycentric_weights)

    def node_mapping(self, nodes: np.ndarray) -> BarycentricMapping:
        """Nodes of its mesh as points that it carries.

        Args:
            nodes: The nodes, shape (count,).
        """
        return self.carried_by(single_nodes(nodes))

    def shown_nodes(self, nodes: np.ndarray):
        """The same for pictures and files: points of a reduced body are placed when asked for.

        Args:
            nodes: The nodes, shape (count,).

        Returns:
            Something with the `positions` of a `BarycentricMapping`.
        """
        return self.shown(single_nodes(nodes))

    def shown(self, on_mesh: BarycentricMapping):
        """Points on the nodes of its mesh, numbered from 0; see `shown_nodes`."""
        return self.carried_by(on_mesh)


OfKind = TypeVar("OfKind", bound=Body)


def of_kind(bodies: Iterable[Body], kind: type[OfKind]) -> tuple[OfKind, ...]:
    """The bodies of one kind, in their order.

    Args:
        bodies: Bodies of any kinds.
        kind: `ReducedBody` or `VertebraBody`.
    """
    return tuple(body for body in bodies if isinstance(body, kind))


def strained_terms(
    mesh: CellMesh, part: MaterialPart, cells: np.ndarray | None, free_index: np.ndarray,
    has_patches: bool,
) -> Iterator[Elements | PatchVolumes]:  # fmt: skip
    """Terms of what bears the strain of cells of one material, and of its patches.

    Args:
        mesh: The body, among all nodes.
        part: The material.
        cells: Its cells in rising order; None for all.
        free_index: Unknown of each node, -1 where it is fixed, shape (node_count,).
        has_patches: Whether patches resist changes of volume.
    """
    for block in mesh.strained_blocks(cells):
        law, memory, bulk_modulus = part.law_parameters, (part.viscosity, part.softening), 0.0
        if has_patches:
            law, bulk_modulus = divided(law, part.shear_modulus, element_bulk(block.mesh))
        if any(memory):
            yield RememberingElements(block.mesh, free_index, law, *memory)
        else:
            yield Elements(block.mesh, free_index, law)
        if bulk_modulus > 0.0:
            tets, patches = patched_cells(block.mesh)
            yield PatchVolumes(tets, free_index, bulk_modulus, patches)


def single_nodes(nodes: np.ndarray) -> BarycentricMapping:
    """Nodes of a mesh as points, numbered from 0.

    Args:
        nodes: Numbers of the nodes, shape (count,).
    """
    nodes = np.asarray(nodes, np.int64)
    return BarycentricMapping(nodes[:, None], np.ones((len(nodes), 1)))


def build_body(
    entry: BodyEntry, key: str, first_node: int, scene: Scene, notes: list,
    held_bodies: Set[str] = frozenset(),
) -> Body:
    """Read the mesh and fix its nodes.

    Args:
        entry: The body's entry.
        key: Key of this entry.
        first_node: Number of nodes of the scene before its own.
        scene: The scene.
        notes: List to which repairs of the mesh are appended.
        held_bodies: Names of free rigid bodies that beams hold.

    Returns:
        The body.

    Raises:
        MeshError: The mesh cannot be used.
        SceneError: A region holds no node, or nothing holds a body that must be held.
    """
    reading = _read_mesh(entry, scene)
    notes.extend(f"{key}.mesh ({entry.mesh.label}): {note}" for note in reading.notes)
    entry = _with_element_of_cells(entry, key, reading, scene, notes)
    mesh = element_named(entry.element).make_mesh(reading.mesh)
    nodes_in = partial(_nodes_in, entry, mesh, reading, scene, notes)
    held = np.zeros((mesh.node_count, 3), dtype=bool)
    for index, region in enumerate(entry.fixed):
        nodes = nodes_in(region, f"{key}.fixed[{index}]")
        held[np.ix_(nodes, ["xyz".index(axis) for axis in region.axes])] = True
    in_part = held.any(axis=1) & ~held.all(axis=1)
    riding = {}
    for index, region in enumerate(entry.attached):
        nodes = nodes_in(region, f"{key}.attached[{index}]")
        if in_part[nodes].any():
            raise scene.error(f"{key}.attached[{index}]", f"{in_part[nodes].sum()} nodes",
                              f"of it are held along some axes by {key}.fixed: a node is held or attached")
        riding[region.to] = np.union1d(riding.get(region.to, nodes), nodes)
        held[nodes] = True
    # A mid-edge node is attached or held if both ends of its edge are.
    for name, nodes in riding.items():
        between = np.isin(mesh.mid_edge_ends, nodes).all(axis=1)
        riding[name] = np.union1d(nodes, reading.mesh.node_count + np.flatnonzero(between))
    held[reading.mesh.node_count :] |= held[mesh.mid_edge_ends].all(axis=1)
    fixed = held.all(axis=1)
    if fixed.all():
        notes.append(
            f"{key} ({entry.name}): all its {len(fixed)} nodes are fixed or attached; nothing of "
            "it can bend."
        )
    cut = next((note for note in reading.notes if CUT in note), "")
    # Nodes attached to a free rigid body are not fixed in space, unless beams hold it.
    free = {rigid.name for rigid in scene.rigid_bodies if rigid.motion == "free"} - held_bodies
    in_space = held.copy()
    for name in free & set(riding):
        in_space[riding[name]] = False
    is_held = _is_held(mesh, in_space, f"{key}.fixed", scene, cut)
    materials = material_parts(entry, key, mesh, reading.parts, scene, notes)
    return Body(entry, key, mesh, first_node, fixed, held, riding, is_held, materials, reading.parts)


def _read_mesh(entry: BodyEntry, scene: Scene) -> MeshReading:
    """The mesh of a body from its file, or of a box."""
    mesh = entry.mesh
    if mesh.box:
        of_hexahedra = element_named(entry.element).of_hexahedra
        return read_box(mesh.box.size, mesh.box.cell_counts, of_hexahedra,
                        translation=mesh.translation, rotation=mesh.rotation)
    file, scale, notes = scene.file_path(mesh.file), mesh.scale, ()
    if mesh.is_cad:
        kept = kept_mesh(file, mesh.size, mesh.scale)
        file, scale, notes = kept.path, 1.0, kept.notes
    found = file.stat() if file.is_file() else None
    changed = None if found is None else (file.absolute(), found.st_mtime_ns, found.st_size)
    reading = _reading(file, changed, scale, mesh.merge_distance, mesh.translation, mesh.rotation)
    return reading._replace(notes=(*notes, *reading.notes))


# A scene is built anew for each other number, by the same file.
@lru_cache(maxsize=8)
def _reading(
    file: Path, changed: tuple | None, scale: float, merge_distance: float | None,
    translation: tuple, rotation: tuple,
) -> MeshReading:  # fmt: skip
    """What a mesh file has, until the file changes; see `read_solid_mesh`."""
    return read_solid_mesh(file, scale=scale, translation=translation, rotation=rotation,
                           merge_tolerance=merge_distance)  # fmt: skip


def _with_element_of_cells(
    entry: BodyEntry, key: str, reading: MeshReading, scene: Scene, notes: list[str]
) -> BodyEntry:
    """The entry with hexahedral elements for hexahedra, and quadratic ones for ten-node tetrahedra,
    unless the scene sets the element.

    Raises:
        SceneError: The element that the scene sets is made of other cells, or the body is reduced
            to vertebrae.
    """
    has_hexahedra = isinstance(reading.mesh, HexahedralMesh)
    has_mid_edge_nodes = len(reading.mid_edge_nodes.ends) > 0
    if "element" not in entry.model_fields_set and (has_mid_edge_nodes or has_hexahedra):
        element = "quadratic" if has_mid_edge_nodes else HEXAHEDRAL
        entry = entry.model_copy(update={"element": element})
    elif has_mid_edge_nodes and entry.element == "linear":
        notes.append(f"{key}.element = linear: of the file's ten-node tetrahedra only the corners "
                     "are used.")  # fmt: skip
    if element_named(entry.element).of_hexahedra != has_hexahedra:
        held = "hexahedra" if has_hexahedra else "tetrahedra only"
        raise scene.error(f"{key}.element", entry.element,
                          f"{entry.mesh.label} has {held}: omit element, or name one made of them")
    if has_hexahedra and entry.vertebrae:
        raise scene.error(f"{key}.vertebrae", f"{len(entry.vertebrae.rigid)} vertebrae",
                          f"{entry.mesh.label} has hexahedra: only bodies of tetrahedra are "
                          "reduced")
    return entry


def _nodes_of_file(mesh, reading: MeshReading) -> np.ndarray:
    """Node of the mesh for each node of the file, −1 where it has none, shape (file_nodes,)."""
    numbers = reading.mesh_node_indices
    ends = mesh.mid_edge_ends
    if len(ends) == 0:
        return numbers
    corners = reading.mesh.node_count
    keys = ends[:, 0] * corners + ends[:, 1]  # ascending, as the edges are numbered
    asked = np.sort(reading.mid_edge_nodes.ends, axis=1)
    numbers = numbers.copy()
    numbers[reading.mid_edge_nodes.file_nodes] = corners + np.searchsorted(
        keys, asked[:, 0] * corners + asked[:, 1]
    )
    return numbers


def part_named(body: Body, kind: str, name: str, key: str, scene: Scene) -> np.ndarray:
    """A named part of a body's mesh file.

    Args:
        body: The body.
        kind: ``region``, ``surface`` or ``edge_set``; see `MeshParts`.
        name: Its name in the file.
        key: Scene entry that names it, for errors.
        scene: The scene.

    Returns:
        Cells, triangles or edges of the body's mesh, with nodes numbered from 0.

    Raises:
        SceneError: The file has no such part, or it cannot be used.
    """
    try:
        return getattr(body.parts, kind)(name)
    except MeshError as error:
        file = body.entry.mesh.label
        raise scene.error(key, name, f"{file}: {error.reason}") from None


def placed_in_world(entry: BodyEntry, points) -> np.ndarray:
    """Points given in mesh coordinates, in world coordinates [m], shape (count, 3).

    Args:
        entry: The body's entry; its mesh is turned and moved.
        points: Places in mesh coordinates [m], shape (count, 3).
    """
    turn = Rotation.from_euler("xyz", entry.mesh.rotation)
    return turn.apply(np.asarray(points, float).reshape(-1, 3)) + entry.mesh.translation


def places_in(frame: str, entry: BodyEntry, points: np.ndarray) -> np.ndarray:
    """Points of a body in the frame of an entry, ``world`` or ``mesh`` [m], shape (count, 3).

    Args:
        frame: The frame.
        entry: The body's entry.
        points: Places in the world [m], shape (count, 3).
    """
    return in_mesh(entry, points) if frame == "mesh" else points


def in_mesh(entry: BodyEntry, points) -> np.ndarray:
    """Points given in world coordinates, in those of the mesh [m], shape (count, 3).

    Args:
        entry: The body's entry; its mesh is turned and moved.
        points: Places in the world [m], shape (count, 3).
    """
    turn = Rotation.from_euler("xyz", entry.mesh.rotation)
    return turn.inv().apply(np.asarray(points, float).reshape(-1, 3) - entry.mesh.translation)


def _nodes_in(entry: BodyEntry, mesh: CellMesh, reading: MeshReading, scene: Scene, notes: list[str],
              region: Region, key: str) -> np.ndarray:
    """Nodes of a region; warnings are appended to `notes`."""
    positions = places_in(region.frame, entry, mesh.node_positions)
    if region.box:
        low, high = np.array(region.box.minimum), np.array(region.box.maximum)
        nodes = nodes_in_box(positions, low, high)
        beside = BESIDE * _size(positions)
        around = len(nodes_in_box(positions, low - beside, high + beside)) - len(nodes)
        if around:
            notes.append(
                f"{key}: {around} nodes lie outside the box by less than {1e3 * beside:.2g} mm and "
                "are not in it; give a face that lies between layers of nodes."
            )
        value, unit = str(region.box), "m"
    elif region.sphere:
        nodes = nodes_in_sphere(positions, region.sphere.centre, region.sphere.radius)
        value, unit = f"{list(region.sphere.centre)}, radius {region.sphere.radius}", "m"
    else:
        asked = np.asarray(region.nodes, dtype=np.int64)
        value, unit = f"{len(asked)} nodes", ""
        beyond = asked[asked >= len(reading.mesh_node_indices)]
        if len(beyond):
            raise scene.error(f"{key}.nodes", int(beyond[0]),
                              f"the mesh file has nodes 0 to {len(reading.mesh_node_indices) - 1}")
        nodes = _nodes_of_file(mesh, reading)[asked]
        nodes = nodes[nodes >= 0]
    if len(nodes) == 0:
        low, high = positions.min(axis=0), positions.max(axis=0)
        reach = f"{low.tolist()} to {high.tolist()} m{size_hint(_size(positions))}"
        raise scene.error(key, value, f"holds no node of the body, which reaches from {reach}", unit)
    return nodes


def _size(positions: np.ndarray) -> float:
    """Diagonal of the bounding box [m]."""
    return float(np.linalg.norm(np.ptp(positions, axis=0)))


def size_hint(size: float) -> str:
    """A hint at the unit for a mesh larger than a soft robot [m]; empty for others.

    Args:
        size: Size of the mesh [m].
    """
    if size <= LARGEST_SIZE:
        return ""
    return f"; it is {size:.4g} m large: is its mesh in millimetres? then give mesh.scale: 0.001"


def holds_still(points: np.ndarray, held: np.ndarray | bool = True) -> bool:
    """True where a rigid body cannot move: of held points, three or more that are not on one line.

    Args:
        points: The points [m], shape (count, 3).
        held: Axes along which each is held, shape (count, 3) of bool; True for all.
    """
    arms = points - points.mean(axis=0) if len(points) else points
    arms = arms / max(np.abs(arms).max(initial=0.0), 1.0e-300)
    node, axis = np.nonzero(np.broadcast_to(held, points.shape))
    along = np.eye(3)[axis]
    motions = np.hstack([along, np.cross(arms[node], along)])
    return bool(np.linalg.matrix_rank(motions, 1.0e-9 * np.sqrt(len(points))) == 6)


def _is_held(mesh, held: np.ndarray, key: str, scene: Scene, cut: str) -> bool:
    """Whether what holds the nodes of every connected part leaves no motion as a rigid body."""
    others = mesh.cells[:, 1:]
    first = np.broadcast_to(mesh.cells[:, :1], others.shape)
    part = connected_pieces(first.ravel(), others.ravel(), mesh.node_count)
    part_count = part.max() + 1
    for index in range(part_count):
        own = np.flatnonzero(held.any(axis=1) & (part == index))
        if holds_still(mesh.node_positions[own], held[own]):
            continue
        if scene.integration != "quasi_static":
            return False
        which = "the body" if part_count == 1 else f"part {index} of {part_count}"
        hint = f"; {cut[:1].lower()}{cut[1:]}" if cut else size_hint(_size(mesh.node_positions))
        raise scene.error(key, f"{len(own)} nodes",
                          f"{which} is not held: in quasi_static integration at least three nodes "
                          f"that are not on one line must be fixed, or the body floats away{hint}")
    return True


def carry(
    body: Body, points, key: str, scene: Scene, notes: list[str], spread_radius: float = 0.0,
    numbers=None, remedy: str = "",
) -> BarycentricMapping:
    """Map points onto the body.

    Args:
        body: The body.
        points: Points at rest [m], shape (point_count, 3).
        key: Scene entry of the points, for errors.
        scene: The scene.
        notes: List to which one warning for all snapped points is appended.
        spread_radius: Each point moves as the mean of the body within this radius of it [m].
        numbers: Places of the points in the list of the entry; None where they are all of it.
        remedy: What else can be done about a point that is too far away, for the error.

    Returns:
        The mapping; with a radius its points lie at the means.

    Raises:
        SceneError: A point is too far from the body.
    """
    points = np.asarray(points, dtype=float).reshape(-1, 3)
    found = locate_points(body.mesh.corner_mesh, points)
    snapped = []
    for index, distance in enumerate(found.distances):
        place = f"{key}[{index if numbers is None else numbers[index]}]"
        stated = "[" + ", ".join(f"{value:g}" for value in points[index]) + "]"
        if distance > SNAP_SHARE * body.size:
            raise scene.error(place, stated,
                              f"lies {1e3 * distance:.2f} mm outside the body; points must be on it "
                              f"(within {1e3 * SNAP_SHARE * body.size:.2f} mm they are snapped to "
                              f"its surface){remedy}" + size_hint(body.size), unit="m")
        if distance > ON_BODY * body.size:
            snapped.append((distance, f"{place} = {stated} m"))
    if len(snapped) == 1:
        ((distance, place),) = snapped
        notes.append(f"{place} lies {1e3 * distance:.3f} mm outside the body: snapped to its surface")
    elif snapped:
        distance, place = max(snapped)
        notes.append(
            f"{key}: {len(snapped)} of {len(points)} points lie outside the body: snapped to its "
            f"surface; the furthest is {place}, {1e3 * distance:.3f} mm outside"
        )
    if spread_radius > 0.0:
        return spread_mapping(body, points, found, spread_radius)
    return body.mapping(found.cells, found.barycentric_weights)


def spread_mapping(body: Body, points: np.ndarray, found: PointLocation, radius: float) -> BarycentricMapping:
    """The mean of the body about each point, by the weight (1 - s²)² with s = distance / support.

    At a flat face it is as deep as that of a ball of this radius. Samples lie on a lattice that is
    fixed in the coordinates of the mesh and is finer for a smaller radius; two lattices are blended.
    So the weights of the nodes have continuous derivatives by the point and by the radius.

    Args:
        body: The body.
        points: Points at rest [m], shape (point_count, 3).
        found: Where the body is nearest to them.
        radius: The radius [m].
    """
    support = SUPPORT * radius
    on_body = body.mesh.node_positions[found.nodes]
    nearest = np.einsum("pa,pai->pi", found.barycentric_weights, on_body)
    # The centre of a point that was snapped stays within half of the support of the body.
    shift = np.hypot(1.0, 2.0 * found.distances / support)[:, None]
    centres = in_mesh(body.entry, nearest + (points - nearest) / shift)
    octave, past = divmod(np.log2(support / LATTICE), 1.0)
    coarse = past * past * (3.0 - 2.0 * past)
    lattices = ((2.0**octave, 1.0 - coarse), (2.0 ** (octave + 1.0), coarse))
    samples = [
        (spacing, part, *_samples(centre, support, spacing))
        for centre in centres for spacing, part in lattices
    ]  # fmt: skip
    places = [own for _, _, own, _ in samples]
    located = (remembered_location(body.mesh.corner_mesh, placed_in_world(body.entry, own))
               for own in places)  # fmt: skip
    at = PointLocation(*map(np.concatenate, zip(*located, strict=True)))
    rows = np.split(np.arange(len(at.cells)), np.cumsum([len(own) for own in places])[:-1])
    shares = np.empty(len(at.cells))
    for (spacing, part, _, weights), own in zip(samples, rows, strict=True):
        # A sample outside counts less with its distance: nothing jumps as the mesh changes.
        away = np.minimum(at.distances[own] / spacing, 1.0)
        inside = weights * (1.0 - away) ** 4
        shares[own] = part * inside / inside.sum()
    own = [np.concatenate(pair) for pair in zip(rows[::2], rows[1::2], strict=True)]
    patches = [body.on_mesh(at.cells[k], at.barycentric_weights[k]).mean(shares[k]) for k in own]
    return body.carried_by(reduce(BarycentricMapping.followed_by, patches))


def _samples(centre: np.ndarray, support: float, spacing: float) -> tuple[np.ndarray, np.ndarray]:
    """The points of a lattice within a support [m], shape (n, 3), and their weights, (n,)."""
    first, last = np.ceil((centre - support) / spacing), np.floor((centre + support) / spacing)
    lines = [spacing * np.arange(a, b + 1.0) for a, b in zip(first, last, strict=True)]
    lattice = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 3)
    near = np.maximum(1.0 - (((lattice - centre) / support) ** 2).sum(axis=1), 0.0)
    return lattice[near > 0.0], near[near > 0.0] ** 2
