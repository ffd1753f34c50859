"""Bodies that are reduced to rigid vertebrae (Coevoet 2017, section 7.2.1).

A body is divided into vertebrae, whose nodes move with a frame, and soft parts: what remains, in
pieces that are connected. Each soft part joins two vertebrae, and becomes a superelement
(`mechanics/superelements.py`) that is made ahead, by ``python -m softrobot_twin reduce-vertebrae``,
and read from a file. The Fetch has two free vertebrae and six soft parts, its accordions: the
plates between accordions are rigid, so each accordion depends on its own pressure only.

Points of the body are carried by the frames: a point of a vertebra by that of the vertebra, a point
of a soft part by those of its two, in shares that change linearly along the part. So effectors,
markers, cables and surfaces work as on any body. What passes through a soft part in this way is
placed by interpolation and not by the equilibrium of the part: cables belong to vertebrae.

The mass of soft parts is shared in the same way. Their weight therefore bends the robot, but not
their own walls.

A file holds fingerprints of what it was made from. Where mesh, material, vertebrae or walls are not
those of the scene any more, loading refuses it and says which; a twin does not start into minutes
of work that nobody expects.
"""

from __future__ import annotations

import shlex
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from softrobot_twin.geometry.connected_pieces import connected_pieces
from softrobot_twin.geometry.regions import nodes_in_box
from softrobot_twin.mechanics.barycentric import BarycentricMapping
from softrobot_twin.mechanics.cavity_surfaces import CavitySurface
from softrobot_twin.mechanics.kinematics import Nodes
from softrobot_twin.mechanics.polynomials import Monomials
from softrobot_twin.mechanics.superelements import (
    CENTRE_DEGREE,
    DEFORMATIONS,
    SuperelementFit,
    Superelements,
)
from softrobot_twin.scene import Scene
from softrobot_twin.simulation.building.beam_bodies import FramePart
from softrobot_twin.simulation.building.deformable_body import Body, in_mesh, part_named, places_in
from softrobot_twin.simulation.building.reduced_body import (
    LEAST,
    ModelFile,
    ModelFileError,
    digest,
    fingerprints_of,
    rounded_places,
    saved_prints,
)

_SAVED = tuple(name for name in SuperelementFit._fields if name != "shares")
# Version of the file; one of another version is made anew.
FORMAT = 2
COMMAND = "softrobot_twin reduce-vertebrae"


class SoftPart(NamedTuple):
    """A piece of a body between two vertebrae.

    Attributes:
        cells: Its cells, shape (cell_count,).
        inner: Its nodes that belong to no vertebra, shape (inner_count,).
        ends: The two vertebrae A and B, shape (2,).
        end_points: Means of these at rest, in mesh coordinates [m], shape (2, 3).
        cavities: Cavities whose walls it carries, by their order in the division.
        walls: These walls, by their order.
    """

    cells: np.ndarray
    inner: np.ndarray
    ends: tuple[int, int]
    end_points: np.ndarray
    cavities: tuple[int, ...]
    walls: tuple[int, ...]


class Division(NamedTuple):
    """A body divided into vertebrae and soft parts.

    Attributes:
        body: The body, not reduced.
        names: Names of the vertebrae.
        nodes: Nodes of each vertebra.
        is_fixed: Whether each is fixed, shape (vertebra_count,).
        parts: The soft parts.
        cavities: Names of the cavities on the body.
        walls: Their walls.
        positions: Nodes at rest in mesh coordinates [m], shape (node_count, 3).
    """

    body: Body
    names: tuple[str, ...]
    nodes: tuple[np.ndarray, ...]
    is_fixed: np.ndarray
    parts: tuple[SoftPart, ...]
    cavities: tuple[str, ...]
    walls: tuple[CavitySurface, ...]
    positions: np.ndarray

    def shares(self) -> tuple[np.ndarray, np.ndarray]:
        """Vertebrae that carry each node, and their shares, each of shape (node_count, 2).

        Nodes of pieces that touch one vertebra only are carried by it.
        """
        count = len(self.positions)
        ends, shares = np.zeros((count, 2), np.int64), np.zeros((count, 2))
        for part in self.parts:
            start, chord = part.end_points[0], part.end_points[1] - part.end_points[0]
            along = (self.positions[part.inner] - start) @ chord / (chord @ chord)
            along = np.clip(along, 0.0, 1.0)
            ends[part.inner] = part.ends
            shares[part.inner] = np.column_stack([1.0 - along, along])
        for vertebra, nodes in enumerate(self.nodes):
            ends[nodes] = vertebra
            shares[nodes] = 1.0, 0.0
        return ends, shares


def divide(body: Body, walls: tuple[CavitySurface, ...], scene: Scene) -> Division:
    """Divide a body into its vertebrae and the soft parts between them.

    Args:
        body: The body, with an entry of `vertebrae`, its nodes numbered from 0.
        walls: Walls of cavities on it.
        scene: The scene.

    Raises:
        SceneError: A vertebra is empty, overlaps another one, or something that must be on a
            vertebra is not; a soft part joins three; a wall is on two soft parts.
    """
    entry, key = body.entry.vertebrae, f"{body.key}.vertebrae"
    nodes = tuple(
        _nodes_of(vertebra, f"{key}.rigid[{index}]", body, scene)
        for index, vertebra in enumerate(entry.rigid)
    )
    owner = np.full(body.mesh.node_count, -1)
    for index, own in enumerate(nodes):
        taken = owner[own]
        if (taken >= 0).any():
            other = entry.rigid[int(taken.max())].name
            raise scene.error(f"{key}.rigid[{index}]", entry.rigid[index].name,
                              f"has {int((taken >= 0).sum())} nodes of {other} too; vertebrae must "
                              "be apart")
        owner[own] = index
    if body.riding:
        raise scene.error(f"{body.key}.attached", ", ".join(body.riding),
                          "nodes of a body with vertebrae cannot be attached to rigid bodies")
    loose = body.fixed & (owner < 0)
    if loose.any():
        raise scene.error(f"{body.key}.fixed", f"{int(loose.sum())} nodes",
                          "belong to no vertebra; fix nodes of vertebrae only")
    is_fixed = np.array([bool(body.fixed[own].any()) for own in nodes])
    if is_fixed.all():
        raise scene.error(key, ", ".join(v.name for v in entry.rigid), "are all fixed")
    positions = in_mesh(body.entry, body.mesh.node_positions)
    cavities = tuple(dict.fromkeys(wall.name for wall in walls))
    parts = _soft_parts(body, owner, positions, walls, cavities, key, scene)
    _check_joined(parts, is_fixed, entry, key, scene)
    names = tuple(vertebra.name for vertebra in entry.rigid)
    return Division(body, names, nodes, is_fixed, parts, cavities, walls, positions)


def _nodes_of(vertebra, key: str, body: Body, scene: Scene) -> np.ndarray:
    """Nodes of a vertebra."""
    if vertebra.region is not None:
        cells = part_named(body, "region", vertebra.region, f"{key}.region", scene)
        return np.unique(body.mesh.cells[cells])
    points = places_in(vertebra.frame, body.entry, body.mesh.node_positions)
    low, high = np.array(vertebra.box.minimum), np.array(vertebra.box.maximum)
    nodes = nodes_in_box(points, low, high)
    if len(nodes) < 3:
        raise scene.error(f"{key}.box", str(vertebra.box),
                          f"holds {len(nodes)} nodes of the body; a vertebra needs three or more",
                          unit="m")
    return nodes


def _soft_parts(
    body: Body, owner: np.ndarray, positions: np.ndarray, walls: tuple[CavitySurface, ...],
    cavities: tuple[str, ...], key: str, scene: Scene,
) -> tuple[SoftPart, ...]:  # fmt: skip
    """Connected pieces of what belongs to no vertebra, which join two vertebrae."""
    cells = body.mesh.cells
    is_inner = owner[cells] < 0
    first = np.where(is_inner, cells, -1).max(axis=1)
    rows, columns = np.nonzero(is_inner)
    piece_of_node = connected_pieces(first[rows], cells[rows, columns], len(owner))
    piece = np.where(first >= 0, piece_of_node[first], -1)
    _check_rigid_cells(owner[cells[piece < 0]], key, scene)
    wall_pieces = [_piece_of(wall, owner, piece_of_node, key, scene) for wall in walls]
    parts = []
    for index in np.unique(piece[piece >= 0]):
        own = np.flatnonzero(piece == index)
        nodes = np.unique(cells[own])
        ends = np.unique(owner[nodes][owner[nodes] >= 0])
        held_by = [w for w, at in enumerate(wall_pieces) if at == index]
        if len(ends) == 1 and not held_by:
            continue
        if len(ends) != 2:
            names = ", ".join(body.entry.vertebrae.rigid[end].name for end in ends) or "none"
            raise scene.error(key, names,
                              f"a soft part of {len(own)} cells touches {len(ends)} vertebrae; it "
                              "must join two")
        faces = tuple(nodes[owner[nodes] == end] for end in ends)
        found = tuple(dict.fromkeys(cavities.index(walls[w].name) for w in held_by))
        parts.append(SoftPart(
            own, nodes[owner[nodes] < 0], (int(ends[0]), int(ends[1])),
            np.array([positions[face].mean(axis=0) for face in faces]), found, tuple(held_by),
        ))  # fmt: skip
    return tuple(parts)


def _check_rigid_cells(owners: np.ndarray, key: str, scene: Scene) -> None:
    """Refuse cells between two vertebrae that have no node of their own to yield."""
    bridging = (owners != owners[:, :1]).any(axis=1)
    if bridging.any():
        raise scene.error(key, f"{int(bridging.sum())} cells",
                          "join two vertebrae without a node between them")


def _piece_of(wall: CavitySurface, owner, piece_of_node, key: str, scene: Scene) -> int:
    """The piece whose nodes carry a wall."""
    used = wall.vertices.nodes[wall.vertices.barycentric_weights != 0.0]
    pieces = np.unique(piece_of_node[used[owner[used] < 0]])
    if len(pieces) != 1:
        raise scene.error(key, wall.name,
                          f"a wall of this cavity is on {len(pieces)} soft parts; a cavity of a "
                          "body with vertebrae must have each wall on one, between two vertebrae")
    return int(pieces[0])


def _check_joined(parts, is_fixed, entry, key: str, scene: Scene) -> None:
    """Refuse vertebrae that no chain of soft parts joins to a fixed one, in statics."""
    ends = np.array([part.ends for part in parts], np.int64).reshape(-1, 2)
    group = connected_pieces(*ends.T, len(is_fixed))
    for index in range(len(is_fixed)):
        if scene.integration == "quasi_static" and not is_fixed[group == group[index]].any():
            raise scene.error(f"{key}.rigid[{index}]", entry.rigid[index].name,
                              "floats: no soft part joins it to a fixed vertebra")


# --- the file -------------------------------------------------------------------------------------


def reduction_path(body: Body, scene: Scene) -> Path:
    """The file of a body's superelements.

    Args:
        body: A body with vertebrae.
        scene: Its scene.
    """
    entry = body.entry
    if entry.vertebrae.superelements:
        return scene.file_path(entry.vertebrae.superelements)
    name = entry.mesh.file.stem if entry.mesh.file else entry.name
    return scene.mesh_folder(entry) / f"{name}_vertebrae.npz"


def fingerprints(division: Division) -> dict[str, str]:
    """Digests of what superelements are made from: mesh, material, vertebrae, cavity walls.

    Args:
        division: The body, divided.
    """
    body = division.body
    walls = [
        (wall.name, rounded_places(body, in_mesh(body.entry, wall.vertices.positions(
            body.mesh.node_positions))), wall.triangles) for wall in division.walls
    ]  # fmt: skip
    return {
        "format": str(FORMAT),
        **fingerprints_of(body),
        "vertebrae": digest(*division.nodes, repr(body.entry.vertebrae.degree)),
        "cavity walls": digest(*(value for wall in walls for value in wall)),
    }


class Reduction(NamedTuple):
    """The superelements of a body, as they are saved.

    Attributes:
        fits: Π of each soft part, in the order of the division; end points in mesh coordinates.
        degree: Total degree of Π.
        rest_volumes: Volume of each cavity at rest [m³], shape (cavity_count,).
        rest_areas: Area of its walls at rest [m²], shape (cavity_count,).
        measured: Median and largest error of the reduced model against the full one, by the
            displacement, as the command found it at fresh states; NaN before, shape (2,).
    """

    fits: tuple[SuperelementFit, ...]
    degree: int
    rest_volumes: np.ndarray
    rest_areas: np.ndarray
    measured: np.ndarray = np.full(2, np.nan)


def write_reduction(path: Path, reduction: Reduction, prints: dict[str, str]) -> None:
    """Save superelements and the fingerprints of what they were made from.

    Args:
        path: The file.
        reduction: The superelements.
        prints: Fingerprints by name.
    """
    arrays = {
        "degree": reduction.degree, "rest_volumes": reduction.rest_volumes,
        "rest_areas": reduction.rest_areas, "count": len(reduction.fits),
        "measured": reduction.measured,
        "prints": saved_prints(prints),
    }  # fmt: skip
    for s, fit in enumerate(reduction.fits):
        arrays.update({f"{name}_{s}": getattr(fit, name) for name in _SAVED})
    np.savez_compressed(path, **arrays)


def read_reduction(path: Path, division: Division) -> Reduction:
    """Read the superelements of a body.

    Args:
        path: The file.
        division: The body's vertebrae and soft parts.

    Raises:
        ModelFileError: It was made of another body, or is damaged.
    """
    file = ModelFile(path)
    file.check_prints(fingerprints(division))
    degree = int(file.taken("degree", kind="i", least=2, most=division.body.entry.vertebrae.degree))
    count = int(file.taken("count", kind="i"))
    if count != len(division.parts):
        raise file.damaged(f"it has {count} superelements for {len(division.parts)} soft parts")
    fits = []
    for s, part in enumerate(division.parts):
        n = DEFORMATIONS + len(part.cavities)
        fit = SuperelementFit(
            ends=file.taken(f"ends_{s}", 2, kind="i"),
            end_points=file.taken(f"end_points_{s}", 2, 3), rest=file.taken(f"rest_{s}", 6),
            cavities=file.taken(f"cavities_{s}", n - DEFORMATIONS, kind="i"),
            middle=file.taken(f"middle_{s}", n), scaling=file.taken(f"scaling_{s}", n, n),
            coefficients=file.taken(f"coefficients_{s}", Monomials(n, degree).count),
            centres=file.taken(f"centres_{s}", 3, Monomials(n, CENTRE_DEGREE).count),
            mass=float(file.taken(f"mass_{s}", least=0.0)),
        )  # fmt: skip
        if tuple(fit.ends) != part.ends or tuple(fit.cavities) != part.cavities:
            raise file.damaged(f"superelement {s} is not between its vertebrae")
        if not np.abs(fit.scaling).max(axis=0).all() or not np.linalg.eigvalsh(
                _rest_stiffness(fit, degree))[0] > 0.0:  # fmt: skip
            raise file.damaged(f"the stiffness at rest of superelement {s} is not positive definite")
        fits.append(fit)
    cavity_count = len(division.cavities)
    return Reduction(
        tuple(fits), degree,
        file.taken("rest_volumes", cavity_count, least=LEAST),
        file.taken("rest_areas", cavity_count, least=LEAST),
        file.taken("measured", 2, least=0.0, may_be_nan=True),
    )  # fmt: skip


def _rest_stiffness(fit: SuperelementFit, degree: int) -> np.ndarray:
    """∂²Π/∂e² of a superelement at rest without pressure, by coordinates of unit range, (6, 6)."""
    n = len(fit.middle)
    monomials, low = Monomials(n, degree), Monomials(n, degree - 2)
    values = np.prod((-fit.scaling @ fit.middle) ** low.exponents, axis=1)
    curvature = monomials.curvature_coefficients(fit.coefficients) @ values
    ranges = np.linalg.norm(fit.scaling, axis=0)
    slopes = fit.scaling[:, :DEFORMATIONS] / ranges[:DEFORMATIONS]
    return slopes.T @ curvature @ slopes


# --- the reduced body ------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class VertebraBody(Body):
    """A body that moves with rigid vertebrae: none of its nodes is among those of a scene.

    Attributes:
        division: The body's vertebrae and soft parts.
        reduction: Their superelements.
        local_ends: Middles of the faces of each soft part in the frames of its vertebrae [m],
            shape (part_count, 2, 3).
        first_frame_node: First frame node of the first vertebra; four for each.
    """

    division: Division
    reduction: Reduction
    local_ends: np.ndarray
    first_frame_node: int = -1
    is_reduced: ClassVar[bool] = True

    @property
    def whole(self) -> Body:
        """See `Body.whole`."""
        return self.division.body

    @property
    def scene_node_count(self) -> int:
        """See `Body.scene_node_count`."""
        return 0

    def rest_nodes(self) -> np.ndarray:
        """See `Body.rest_nodes`."""
        return np.empty((0, 3))

    def held_nodes(self) -> np.ndarray:
        """See `Body.held_nodes`."""
        return np.empty((0, 3), bool)

    def placed(self, rigid: Iterable, first_frame_node: int) -> VertebraBody:
        """See `Body.placed`."""
        return replace(self, first_frame_node=first_frame_node)

    def strained_terms(self, layout) -> tuple:
        """See `Body.strained_terms`: none, superelements bear its strain."""
        return ()

    def borne_masses(self, layout) -> np.ndarray:
        """See `Body.borne_masses`: vertebrae bear its mass."""
        return np.empty(0)

    def motion_terms(self, layout, free_index: np.ndarray) -> tuple:
        """See `Body.motion_terms`: none, vertebrae have inertia and damping."""
        return ()

    def carried_by(self, on_mesh: BarycentricMapping) -> BarycentricMapping:
        """See `Body.carried_by`: on the frame nodes of its vertebrae."""
        return on_mesh.through(self.node_carriers())

    def superelements(self, nodes: Nodes, scene: Scene) -> Superelements:
        """Its superelements, with cavities numbered as in the scene.

        Args:
            nodes: All nodes of the scene.
            scene: The scene.
        """
        names = [cavity.name for cavity in scene.cavities]
        place = np.array([names.index(name) for name in self.division.cavities], np.int64)
        fits = [
            fit._replace(end_points=ends, cavities=place[fit.cavities], shares=shares)
            for fit, ends, shares in zip(
                self.reduction.fits, self.local_ends, self.shared_masses(), strict=True
            )
        ]  # fmt: skip
        return Superelements(
            tuple(fits), self.reduction.degree, self.frame_nodes, len(names),
            nodes.kinds[0].unknowns_of(self.frame_nodes), scene.gravity,
        )  # fmt: skip

    def shared_masses(self) -> np.ndarray:
        """Mass of the inner nodes of each soft part on the frame nodes of its ends [kg].

        Returns:
            Shape (part_count, 8).
        """
        carriers, masses = self.node_carriers(), self.node_masses()
        found = np.zeros((len(self.reduction.fits), 8))
        for own, part in zip(found, self.division.parts, strict=True):
            own[:] = masses[part.inner] @ carriers.barycentric_weights[part.inner]
        return found

    @property
    def frame_nodes(self) -> np.ndarray:
        """First frame node of each vertebra, shape (vertebra_count,)."""
        return self.first_frame_node + 4 * np.arange(len(self.vertebrae))

    def node_carriers(self) -> BarycentricMapping:
        """Every node of the body on the frame nodes of its vertebrae."""
        ends, shares = self.division.shares()
        positions = self.mesh.node_positions
        origins = np.array([part.origin for part in self.vertebrae])
        turn = self.vertebrae[0].rotation
        local = np.einsum("nki,ij->nkj", positions[:, None] - origins[ends], turn)
        weights = np.concatenate([1.0 - local.sum(axis=2, keepdims=True), local], axis=2)
        nodes = self.frame_nodes[ends][:, :, None] + np.arange(4)
        count = len(positions)
        return BarycentricMapping(nodes.reshape(count, 8), (weights * shares[:, :, None]).reshape(count, 8))


def vertebra_body(body: Body, walls: tuple[CavitySurface, ...], scene: Scene) -> VertebraBody:
    """The body that moves with its vertebrae, by the superelements of its file.

    Args:
        body: The body, not reduced, its nodes numbered from 0.
        walls: Walls of cavities on it.
        scene: The scene.

    Raises:
        SceneError: There are no superelements, or they are of another mesh or material, or damaged.
    """
    division = divide(body, walls, scene)
    path, key = reduction_path(body, scene), f"{body.key}.vertebrae"
    try:
        reduction = read_reduction(path, division)
    except ModelFileError as error:
        command = f"{COMMAND} {shlex.quote(str(scene.path))}"
        raise scene.error(key, str(path), f"{error.reason}; run: {command}") from None
    parts = _vertebra_parts(division)
    ends = np.array([
        [fit.end_points[k] - in_mesh(body.entry, parts[fit.ends[k]].origin) for k in range(2)]
        for fit in reduction.fits
    ]).reshape(-1, 2, 3)  # fmt: skip
    return body.become(
        VertebraBody, fixed=np.ones_like(body.fixed), riding={}, vertebrae=parts, division=division,
        reduction=reduction, local_ends=ends,
    )  # fmt: skip


def _vertebra_parts(division: Division) -> tuple[FramePart, ...]:
    """The vertebrae with the masses that they carry."""
    body = division.body
    masses = body.node_masses()
    ends, shares = division.shares()
    points = body.mesh.node_positions
    rotation = Rotation.from_euler("xyz", body.entry.mesh.rotation).as_matrix()
    parts = []
    for index, name in enumerate(division.names):
        own = (masses[:, None] * shares * (ends == index)).sum(axis=1)
        mass = float(own.sum())
        origin = own @ points / mass
        arms = (points - origin) @ rotation
        squares = np.einsum("n,ni,nj->ij", own, arms, arms)
        reach = np.linalg.norm(arms[division.nodes[index]], axis=1).max()
        parts.append(FramePart(
            f"{body.name}.{name}", not division.is_fixed[index], origin, rotation, mass,
            np.trace(squares) * np.eye(3) - squares, float(reach), body.entry.damping.mass,
        ))  # fmt: skip
    return tuple(parts)
