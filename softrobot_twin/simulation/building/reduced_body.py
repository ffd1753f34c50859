"""A deformable body in the coordinates of a basis, among the nodes of a scene.

In the node positions of a scene such a body has its coordinate nodes first, then the points that
terms of the scene ask for: where cables, effectors, markers and contacts are. Nothing else of the body
is placed in a step. Which points these are is found by building the terms once with all nodes of
the mesh as points (`asked`); surfaces for pictures are placed when they are asked for (`Placed`).

A file of such a body is saved by ``python -m softrobot_twin reduce``. The displacement of every node is u = Φ q: a mode is a displacement of all nodes, and q are its
coordinates (proper orthogonal decomposition of states of the full model). Elastic forces are sums
over few quadrature points with weights of their own, so that they do nearly the same work along the
basis as all points together (energy-conserving sampling; Farhat et al. 2014;
points in place of elements: Hernández et al. 2017).

Further modes, the spare ones, and points of their own tell the error: see `reduction_error.py`.

A file, an archive of numpy, holds fingerprints of the body that it was made from; one of another
body is refused. A file may have been cut short on its way, or written by another program: each array
is checked when it is taken, and what is wrong is said by one error that names the file and the array.
"""

from __future__ import annotations

import hashlib
import io
import json
import shlex
import zipfile
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import ClassVar, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from softrobot_twin.errors import SoftRobotTwinError
from softrobot_twin.geometry.cell_mesh import points_of
from softrobot_twin.mechanics.barycentric import BarycentricMapping
from softrobot_twin.mechanics.force_term import ForceTerm
from softrobot_twin.mechanics.inertia import borne_masses
from softrobot_twin.mechanics.laws import law_named
from softrobot_twin.mechanics.reduced_elements import (
    PointGradients,
    ReducedElements,
    SampledPoints,
    point_gradients,
)
from softrobot_twin.mechanics.reduced_motion import (
    ReducedInertia,
    ReducedMassDamping,
    ReducedStrainRateDamping,
)
from softrobot_twin.mechanics.reduced_points import Platform, ReducedPoints
from softrobot_twin.scene import Scene
from softrobot_twin.simulation.building.deformable_body import Body, MaterialPart, in_mesh

# Digits of coordinates in fingerprints, as a share of the body's size: what files can tell apart.
DIGITS = 1.0e-7
# Version of the file; one of another version is made anew.
FORMAT = 1
# Greatest displacement of a fixed node by a mode, whose largest is one: rounding of long sums.
FIXED = 1.0e-6
# Least eigenvalue of the stiffness at rest of modes that are scaled to unit stiffness: rounding.
LEAST_STIFFNESS = 1.0e-10
COMMAND = "softrobot_twin reduce"
# Most bytes that a file may unpack to: a basis of 70 000 nodes and 120 modes. Reading it takes three
# times as much memory.
MOST_BYTES = 100_000_000
# Least and greatest magnitude of any number that a model has in SI units: beyond, products overflow.
LEAST, MOST = 1.0e-30, 1.0e30
# Sums of files, and prints of the bodies that they hold for: a robot that is built again and again does
# not check its file as often.
_HELD: set[tuple] = set()
_KINDS = {"f": ("real numbers", "fiu"), "i": ("integers", "iu"), "b": ("truth values", "b"),
          "U": ("text", "U")}  # fmt: skip


class ModelFileError(SoftRobotTwinError):
    """A file of a reduced model cannot be used.

    Attributes:
        path: The file.
        reason: What is wrong, in one sentence.
        changed: What it was made from and has changed since; ``file`` where there is none, empty
            where the file itself is damaged.
    """

    def __init__(self, path: Path, reason: str, changed: tuple[str, ...] = ()):
        self.path, self.reason, self.changed = path, reason, changed
        super().__init__(f"{path}: {reason}")


def saved_prints(prints: Mapping[str, str]) -> np.ndarray:
    """Fingerprints as the array `prints` of a file.

    Args:
        prints: Fingerprints by name.
    """
    return np.array([f"{name}={value}" for name, value in prints.items()])


class ModelFile:
    """The arrays of a file.

    Attributes:
        path: The file.
        sums: Name of each array and the sum of its bytes.
    """

    def __init__(self, path: Path):
        """Read all arrays.

        Args:
            path: The file.

        Raises:
            ModelFileError: It is not there, is no archive of arrays, or was cut short or changed on
                its way.
        """
        self.path = path
        if not path.is_file():
            raise ModelFileError(path, "does not exist", ("file",))
        try:
            found = list(_arrays_of(path))
        # A damaged archive raises errors of a dozen classes of zipfile, zlib, tokenize and numpy.
        except Exception as error:
            words = " ".join(str(error).split())[:200] or type(error).__name__
            raise self.damaged(words) from None
        self._arrays = {name: array for name, array, _ in found}
        self.sums = tuple((name, sum_of_bytes) for name, _, sum_of_bytes in found)

    def damaged(self, reason: str) -> ModelFileError:
        """The error that says what is wrong in the file.

        Args:
            reason: What is wrong.
        """
        return ModelFileError(self.path, f"is no reduced model, or damaged: {reason}")

    def check_prints(self, prints: Mapping[str, str]) -> None:
        """Refuse a file that was made of something else.

        Args:
            prints: Fingerprints of the scene's body.

        Raises:
            ModelFileError: It names what has changed.
        """
        pairs = [str(entry).partition("=") for entry in self.taken("prints", None, kind="U")]
        found = {name: value for name, _, value in pairs}
        changed = tuple(name for name, value in prints.items() if found.get(name) != value)
        if changed:
            raise ModelFileError(self.path, f"was made of another {', '.join(changed)}", changed)

    def taken(
        self, name: str, *shape: int | None, kind: str = "f", least: float = -MOST,
        most: float = MOST, may_be_nan: bool = False,
    ) -> np.ndarray:  # fmt: skip
        """An array of the file, checked.

        Args:
            name: Its name.
            shape: Its shape, None for an axis of any length.
            kind: ``f`` for real numbers, ``i`` for integers, ``b`` for truth values, ``U`` for text.
            least: Least value.
            most: Greatest value.
            may_be_nan: Whether NaN is among the values of real numbers.

        Returns:
            The array: real numbers in double precision, integers as int64.

        Raises:
            ModelFileError: It is missing, of another shape or kind, or has values beyond bounds.
        """
        if name not in self._arrays:
            raise self.damaged(f"it has no array {name}")
        found = self._arrays[name]
        fits = found.ndim == len(shape) and all(
            wanted in (None, length) for wanted, length in zip(shape, found.shape, strict=False)
        )
        words, kinds = _KINDS[kind]
        if not fits or found.dtype.kind not in kinds:
            needed = ", ".join("any" if length is None else str(length) for length in shape)
            raise self.damaged(
                f"{name} has shape ({', '.join(map(str, found.shape))}) and type "
                f"{found.dtype.name}; {words} of shape ({needed}) are needed"
            )
        if kind in "bU":
            return found
        values = found.astype(float if kind == "f" else np.int64)
        is_good = (values >= least) & (values <= most)
        if may_be_nan:
            is_good |= np.isnan(values)
        if not is_good.all():
            wrong = values[~is_good].ravel()
            raise self.damaged(f"{len(wrong)} of {name} are not between {least:g} and {most:g}, "
                               f"such as {wrong[0]:g}")  # fmt: skip
        return values


def _arrays_of(path: Path):
    """Name, array and checked sum of the bytes of each member of an archive."""
    with zipfile.ZipFile(path) as archive:
        members = archive.infolist()
        size = sum(member.file_size for member in members)
        if size > MOST_BYTES:
            raise ValueError(f"it unpacks to {1e-6 * size:.0f} MB, the most is "
                             f"{1e-6 * MOST_BYTES:.0f} MB")  # fmt: skip
        for member in members:
            with archive.open(member) as packed:
                stream = io.BytesIO(packed.read(member.file_size))
            array = np.lib.format.read_array(stream, allow_pickle=False)
            if stream.read(1):
                raise ValueError(f"{member.filename} is longer than its array")
            yield member.filename.removesuffix(".npy"), array, member.CRC


def digest(*values) -> str:
    """Digest of strings and arrays.

    Args:
        *values: Strings and arrays; their order counts.
    """
    made = hashlib.sha256()
    for value in values:
        made.update(value.encode() if isinstance(value, str) else np.ascontiguousarray(value))
    return made.hexdigest()


def rounded_places(body: Body, points: np.ndarray) -> np.ndarray:
    """Points in mesh coordinates [m] as integers, equal where files cannot tell them apart.

    Args:
        body: The body.
        points: Places in mesh coordinates [m], shape (count, 3).
    """
    # Half a digit is added: most coordinates are round numbers, and stay clear of a limit.
    return np.floor(points / (DIGITS * _size(body)) + 0.5).astype(np.int64)


def _size(body: Body) -> float:
    positions = in_mesh(body.entry, body.mesh.node_positions)
    return float(np.linalg.norm(np.ptp(positions, axis=0)))


def fingerprints_of(body: Body) -> dict[str, str]:
    """Digests of a body's mesh and material; its placement in the world is in neither.

    Args:
        body: The body.
    """
    materials = [
        (part.law, repr((*_constants(part), part.density)), part.cells_in(body.mesh))
        for part in body.materials
    ]  # fmt: skip
    places = rounded_places(body, in_mesh(body.entry, body.mesh.node_positions))
    bearing = body.entry.element + (" in patches" if body.entry.has_patches else "")
    return {
        "mesh": digest(f"{_size(body):.6e}", places, body.mesh.cells, bearing),
        "material": digest(*(value for part in materials for value in part)),
    }


def _constants(part: MaterialPart) -> tuple:
    """What the stiffness of a material follows from: E and ν, or the constants of its law."""
    if law_named(part.law).own is None:
        return part.young_modulus, part.poisson_ratio
    return part.law_parameters


class BodyReduction(NamedTuple):
    """What a body is reduced to.

    Attributes:
        basis: Φ: displacement of each node by each coordinate, in mesh coordinates; the largest
            displacement of a node by a coordinate is one, so coordinates are in metres. Zero at
            fixed nodes. The modes in use come first, then the spare ones,
            shape (node_count, 3, mode_count + spare mode count).
        mode_count: Number of modes in use, a multiple of three.
        sampled: The quadrature points that stand for all, with the modes in use.
        spare_sampled: Those that stand for all with the spare modes too.
        ranges: Largest magnitude of each coordinate in the training, spare ones included [m],
            shape (mode_count + spare mode count,).
        measured: Median and largest error against the full model at fresh states, as a share of
            the effectors' displacement, or of a tenth of the largest one where that is more; NaN
            before, shape (2,).
        training: How it was made: command, seed, numbers of states, errors, times.
    """

    basis: np.ndarray
    mode_count: int
    sampled: SampledPoints
    spare_sampled: SampledPoints
    ranges: np.ndarray
    measured: np.ndarray
    training: dict

    def with_spare_modes(self) -> BodyReduction:
        """The same with the spare modes in use, and none spare."""
        return self._replace(mode_count=self.basis.shape[2], sampled=self.spare_sampled)


def reduction_fingerprints(body: Body) -> dict[str, str]:
    """Digests of what a reduction is made from: mesh, material and fixed nodes of a body.

    Args:
        body: The body.
    """
    return {
        "format": str(FORMAT), **fingerprints_of(body),
        "fixed nodes": digest(np.flatnonzero(body.fixed).astype(np.int64)),
    }  # fmt: skip


def write_body_reduction(path: Path, reduction: BodyReduction, prints: dict[str, str]) -> None:
    """Save a reduction and the fingerprints of what it was made from.

    The basis is saved in single precision: rounded modes are modes as good as the exact ones.

    Args:
        path: The file.
        reduction: What is saved.
        prints: See `reduction_fingerprints`.
    """
    arrays = {
        "basis": reduction.basis.astype(np.float32), "mode_count": reduction.mode_count,
        "ranges": reduction.ranges, "measured": reduction.measured,
        "training": json.dumps(reduction.training), "prints": saved_prints(prints),
    }  # fmt: skip
    for name in ("sampled", "spare_sampled"):
        for field, values in getattr(reduction, name)._asdict().items():
            arrays[f"{name}_{field}"] = values
    np.savez(path, **arrays)


def read_body_reduction(file: ModelFile, body: Body) -> BodyReduction:
    """Read a reduction.

    Args:
        file: The file.
        body: The body that it is for.

    Raises:
        ModelFileError: It was made of another body, or is damaged.
    """
    prints = reduction_fingerprints(body)
    file.check_prints(prints)
    basis = file.taken("basis", body.mesh.node_count, 3, None)
    total = basis.shape[2]
    count = int(file.taken("mode_count", kind="i", least=3, most=total))
    if count % 3 or total % 3:
        raise file.damaged(f"{count} modes of {total}: multiples of three are needed")
    sampled, spare_sampled = (
        _sampled_points(file, name, body) for name in ("sampled", "spare_sampled")
    )
    try:
        training = json.loads(str(file.taken("training", kind="U")))
    except ValueError as error:
        raise file.damaged(f"training is no JSON: {error}") from None
    reduction = BodyReduction(
        basis, count, sampled, spare_sampled, file.taken("ranges", total, least=0.0),
        file.taken("measured", 2, least=0.0, may_be_nan=True), training,
    )  # fmt: skip
    seen = (*file.sums, *prints.values())
    if seen not in _HELD:
        _check_on_body(file, reduction, body)
        _HELD.add(seen)
    return reduction


def _sampled_points(file: ModelFile, name: str, body: Body) -> SampledPoints:
    most = max(block.numbers.max() for block in body.mesh.strained_blocks())
    cells = file.taken(f"{name}_cells", None, kind="i", least=0, most=most)
    points = file.taken(f"{name}_points", len(cells), kind="i", least=0)
    weights = file.taken(f"{name}_weights", len(cells), least=LEAST)
    if len(np.unique(np.stack([cells, points]), axis=1).T) < max(len(cells), 1):
        raise file.damaged(f"{name} has no points, or the same twice")
    return SampledPoints(cells, points, weights)


def _check_on_body(file: ModelFile, reduction: BodyReduction, body: Body) -> None:
    """Refuse modes that move fixed nodes, and points that do not hold the modes.

    Raises:
        ModelFileError: It says which.
    """
    if np.abs(reduction.basis[body.fixed]).max(initial=0.0) > FIXED:
        raise file.damaged("its modes move fixed nodes")
    for name, model in (("sampled", reduction), ("spare_sampled", reduction.with_spare_modes())):
        stiffness = np.zeros((model.mode_count, model.mode_count))
        for part in body.materials:
            lame_lambda, shear_modulus = part.lame_parameters
            for block in body.mesh.strained_blocks(part.cells):
                inside = np.isin(model.sampled.cells, block.numbers)
                if model.sampled.points[inside].max(initial=0) >= points_of(
                        block.mesh, np.arange(1)).weights.size:  # fmt: skip
                    raise file.damaged(f"{name}_points has points that its cells do not have")
                found = point_gradients(block, model.sampled, model.basis[:, :, :model.mode_count])
                weighted = found.weights[:, None, None] * found.gradients
                turned = found.gradients.reshape(len(weighted), 3, 3, -1).transpose(0, 2, 1, 3)
                traces = found.gradients[:, ::4].sum(axis=1)
                both = found.gradients + turned.reshape(found.gradients.shape)
                stiffness += shear_modulus * np.tensordot(weighted, both, ((0, 1), (0, 1)))
                stiffness += lame_lambda * (found.weights * traces.T) @ traces
        size = np.sqrt(np.diag(stiffness))
        if not (size > 0.0).all() or not np.linalg.eigvalsh(
                stiffness / np.outer(size, size))[0] > LEAST_STIFFNESS:  # fmt: skip
            raise file.damaged(f"at the points {name} the stiffness at rest is not positive "
                               "definite: too few points, or modes that depend on each other")


class Placed:
    """Points of a reduced body that no term needs, placed from its coordinates.

    It has `positions` and `point_count` as a `BarycentricMapping`.
    """

    def __init__(
        self, coordinate_nodes: np.ndarray, rest: np.ndarray, modes: np.ndarray,
        platform: Platform | None = None,
    ):  # fmt: skip
        """Take the points.

        Args:
            coordinate_nodes: Nodes whose positions are the coordinates, shape (mode_count / 3,).
            rest: Positions at rest [m], shape (point_count, 3).
            modes: Φ of each point, shape (point_count, 3, mode_count).
            platform: What the body rides on; None where its base stands still.
        """
        self._nodes, self._rest, self._platform = coordinate_nodes, rest, platform
        self._rows = modes.reshape(3 * len(rest), modes.shape[2])
        self.point_count = len(rest)

    def positions(self, node_positions: np.ndarray) -> np.ndarray:
        """Positions of the points [m], shape (point_count, 3).

        Args:
            node_positions: Node positions of the scene [m], shape (node_count, 3).
        """
        coordinates = node_positions[self._nodes].ravel()
        points = self._rest + (self._rows @ coordinates).reshape(-1, 3)
        if self._platform is not None:
            points += self._platform.displacement(node_positions)
        return points


@dataclass(frozen=True, kw_only=True)
class ReducedBody(Body):
    """A body in the coordinates of a basis: coordinate nodes and points replace its nodes.

    Attributes:
        reduction: Its basis and sampled points.
        basis: Φ of the modes in use in world axes, shape (mesh_node_count, 3, mode_count).
        points: The points that terms ask for, on the nodes of its mesh; None while all nodes of the
            mesh are points.
        asked: What terms asked for while all nodes were points.
        platform: What its base rides on; None where it stands still.
    """

    reduction: BodyReduction
    basis: np.ndarray
    points: dict[tuple[bytes, bytes], int] | None = None
    asked: list[BarycentricMapping] = field(default_factory=list)
    platform: Platform | None = None
    is_reduced: ClassVar[bool] = True

    @property
    def whole(self) -> Body:
        """See `Body.whole`."""
        return self.become(Body)

    @property
    def mode_count(self) -> int:
        """Number of coordinates."""
        return self.basis.shape[2]

    @property
    def scene_node_count(self) -> int:
        """Number of its coordinate nodes and points."""
        points = self.mesh.node_count if self.points is None else len(self.points)
        return self.mode_count // 3 + points

    @property
    def free_node_count(self) -> int:
        """See `Body.free_node_count`."""
        return self.mode_count // 3

    @property
    def coordinate_nodes(self) -> np.ndarray:
        """Nodes whose positions are the coordinates, shape (mode_count / 3,)."""
        return self.first_node + np.arange(self.mode_count // 3)

    @property
    def first_point(self) -> int:
        """Its first point among all nodes of the scene."""
        return self.first_node + self.mode_count // 3

    @property
    def places(self) -> np.ndarray:
        """See `Body.places`."""
        return super().places[self.mode_count // 3 :]

    def carried_by(self, on_mesh: BarycentricMapping) -> BarycentricMapping:
        """See `Body.carried_by`: on its points, for which terms ask so."""
        if self.points is None:
            self.asked.append(on_mesh)
            return BarycentricMapping(on_mesh.nodes + self.first_point, on_mesh.barycentric_weights)
        places = [self.points[key] for key in _keys_of(on_mesh)]
        nodes = self.first_point + np.array(places, np.int64).reshape(-1, 1)
        return BarycentricMapping(nodes, np.ones((len(nodes), 1)))

    def point_modes(self) -> tuple[np.ndarray, np.ndarray]:
        """Positions at rest [m] and Φ of its points, shape (count, 3) and (count, 3, mode_count)."""
        nodes_at_rest = self.mesh.node_positions
        if self.points is None:
            return nodes_at_rest, self.basis
        keys = [(np.frombuffer(nodes, np.int64), np.frombuffer(weights))
                for nodes, weights in self.points]  # fmt: skip
        rest = np.array([weights @ nodes_at_rest[nodes] for nodes, weights in keys]).reshape(-1, 3)
        modes = [np.tensordot(weights, self.basis[nodes], 1) for nodes, weights in keys]
        return rest, np.array(modes).reshape(len(keys), 3, self.mode_count)

    def with_asked_points(self, first_node: int) -> ReducedBody:
        """The same with the points that were asked for, each once, in place of all nodes.

        Args:
            first_node: Its first node among those of the scene.
        """
        keys = [key for mapping in self.asked for key in _keys_of(mapping)]
        points = {key: index for index, key in enumerate(dict.fromkeys(keys))}
        return replace(self, first_node=first_node, points=points, asked=[])

    def rest_nodes(self) -> np.ndarray:
        """See `Body.rest_nodes`: coordinates, which are zero, then points."""
        return np.vstack([np.zeros((self.mode_count // 3, 3)), self.point_modes()[0]])

    def held_nodes(self) -> np.ndarray:
        """See `Body.held_nodes`: points are no unknowns."""
        are_points = np.arange(self.scene_node_count) >= self.mode_count // 3
        return np.repeat(are_points[:, None], 3, axis=1)

    def placed(self, rigid: Iterable, first_frame_node: int) -> ReducedBody:
        """See `Body.placed`: the body rides on a platform, or stands still."""
        own = (Platform(part.first_node, part.origin) for part in rigid if part.name in self.riding)
        return replace(self, platform=next(own, None))

    def mesh_nodes(self, node_positions: np.ndarray) -> np.ndarray:
        """See `Body.mesh_nodes`: where the coordinates place them."""
        placed = self.mesh.node_positions + self.basis @ node_positions[self.coordinate_nodes].ravel()
        if self.platform is not None:
            placed += self.platform.displacement(node_positions)
        return placed

    def nodes_as(self, other: ReducedBody, node_positions: np.ndarray) -> np.ndarray:
        """See `Body.nodes_as`: its coordinates are those of the other, or zero. Points are left out."""
        coordinates = node_positions[other.coordinate_nodes]
        return np.vstack([coordinates, np.zeros((self.scene_node_count - len(coordinates), 3))])

    def shown(self, on_mesh: BarycentricMapping) -> Placed:
        """See `Body.shown`."""
        modes = np.zeros((on_mesh.point_count, 3, self.mode_count))
        for nodes, weights in zip(on_mesh.nodes.T, on_mesh.barycentric_weights.T, strict=True):
            modes += weights[:, None, None] * self.basis[nodes]
        rest = on_mesh.positions(self.mesh.node_positions)
        return Placed(self.coordinate_nodes, rest, modes, self.platform)

    def kind(self, free_index: np.ndarray) -> ReducedPoints:
        """Its kind of unknowns.

        Args:
            free_index: Unknown of each node of the scene, shape (node_count,).
        """
        nodes = self.coordinate_nodes
        return ReducedPoints(nodes, free_index[nodes], self.first_point, *self.point_modes(), self.platform)

    def sampled(self) -> Iterator[tuple[MaterialPart, PointGradients]]:
        """Its sampled points, of each material and each kind of its cells."""
        for part in self.materials:
            for block in self.mesh.strained_blocks(part.cells):
                yield part, point_gradients(block, self.reduction.sampled, self.basis)

    def strained_terms(self, layout) -> Iterator[tuple[MaterialPart, ForceTerm]]:
        """See `Body.strained_terms`: forces at its sampled points."""
        nodes, index = self.coordinate_nodes, layout.nodes.free_index
        for part, points in self.sampled():
            yield part, ReducedElements(points, part.law_parameters, nodes, index)

    def borne_masses(self, layout) -> np.ndarray:
        """See `Body.borne_masses`: zero, its coordinates have `weights`."""
        return np.zeros(self.scene_node_count)

    def motion_terms(self, layout, free_index: np.ndarray) -> Iterator[ForceTerm]:
        """See `Body.motion_terms`: those of its coordinates."""
        nodes, damping = self.coordinate_nodes, self.entry.damping
        if layout.scene.integration == "dynamic":
            mass = self.coordinate_masses(self.entry.mass_model == "consistent")
            yield ReducedInertia(nodes, free_index[nodes], mass)
        if damping.mass > 0.0:
            # Drag is that of the diagonal masses, as on the nodes.
            mass = self.coordinate_masses(False)
            yield ReducedMassDamping(nodes, free_index[nodes], mass, damping.mass)
        if damping.stiffness > 0.0:
            for part, points in self.sampled():
                yield ReducedStrainRateDamping(
                    points, part.lame_parameters, damping.stiffness, nodes, free_index)  # fmt: skip

    def coordinate_masses(self, is_consistent: bool) -> np.ndarray:
        """Φᵀ M Φ, the mass of the coordinates [kg], shape (mode_count, mode_count).

        Args:
            is_consistent: Whether M is consistent, and not diagonal.
        """
        M = self.mass_matrix(is_consistent)
        return sum(modes.T @ (M @ modes) for modes in self.basis.transpose(1, 0, 2))

    def weights(self, gravity: np.ndarray) -> np.ndarray:
        """Weight as forces on the coordinates [N], shape (mode_count / 3, 3).

        Args:
            gravity: Acceleration [m/s²], shape (3,).
        """
        is_consistent = self.entry.mass_model == "consistent"
        masses = borne_masses(self.mesh, self.density) if is_consistent else self.node_masses()
        return np.einsum("n,i,nim->m", masses, gravity, self.basis, optimize=True).reshape(-1, 3)


def _keys_of(mapping: BarycentricMapping) -> Iterator[tuple[bytes, bytes]]:
    """Nodes and weights of each point, those without weight left out."""
    for nodes, weights in zip(mapping.nodes, mapping.barycentric_weights, strict=True):
        used = weights != 0.0
        yield nodes[used].astype(np.int64).tobytes(), weights[used].astype(float).tobytes()


def reduced_body(body: Body, scene: Scene) -> ReducedBody:
    """The body in the coordinates of the basis that its file has.

    Args:
        body: The body, with an entry `reduced`.
        scene: The scene.

    Raises:
        SceneError: The file is not there, of another body, or damaged; or the scene asks for something that
            is not built for reduced bodies.
    """
    path: Path = scene.file_path(body.entry.reduced.file)
    key = f"{body.key}.reduced"
    _refuse(body, scene)
    try:
        reduction = read_body_reduction(ModelFile(path), body)
    except ModelFileError as error:
        command = f"{COMMAND} {shlex.quote(str(scene.path))}"
        raise scene.error(f"{key}.file", str(path), f"{error.reason}; run: {command}") from None
    if body.entry.reduced.spare_modes:
        reduction = reduction.with_spare_modes()
    turn = Rotation.from_euler("xyz", body.entry.mesh.rotation).as_matrix()
    used = reduction.basis[:, :, : reduction.mode_count]
    return body.become(ReducedBody, reduction=reduction, basis=np.einsum("ij,njm->nim", turn, used))


def _refuse(body: Body, scene: Scene) -> None:
    """Refuse what is not built for reduced bodies, by name."""
    if body.riding and not rides_on_a_slide(body, scene):
        raise scene.error(f"{body.key}.attached", ", ".join(body.riding),
                          "nodes of a reduced body may be attached to one platform that a slide "
                          "moves; others are not built")


def rides_on_a_slide(body: Body, scene: Scene) -> bool:
    """Whether a body is attached to one rigid body, and that is moved by a slide.

    Args:
        body: The body.
        scene: The scene.
    """
    return len(body.riding) == 1 and set(body.riding) <= {slide.body for slide in scene.slides}
