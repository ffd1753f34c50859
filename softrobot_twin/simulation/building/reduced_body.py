"""A deformable body in the coordinates of a basis, among the nodes of a scene.

In the node positions of a scene such a body has its coordinate nodes first, then the points that
terms of the scene ask for: where cables, effectors, markers and contacts are. Nothing else of the body
is placed in a step. Which points these are is found by building the terms once with all nodes of
the mesh as points (`asked`); surfaces for pictures are placed when they are asked for (`Placed`).
"""

from __future__ import annotations

import shlex
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from softrobot_twin.errors import SceneError
from softrobot_twin.mechanics.barycentric import BarycentricMapping
from softrobot_twin.mechanics.inertia import borne_masses
from softrobot_twin.mechanics.reduced_points import Platform, ReducedPoints
from softrobot_twin.scene import Scene
from softrobot_twin.simulation.building.body_reduction import BodyReduction, read_body_reduction
from softrobot_twin.simulation.building.deformable_body import Body
from softrobot_twin.simulation.building.model_file import ModelFileError

COMMAND = "softrobot_twin reduce"


def without_reductions(scene: Scene) -> Scene:
    """The same scene with all nodes of its reduced bodies as unknowns."""
    return with_entries(scene, {
        body.name: None for body in scene.deformables if body.reduced is not None
    })  # fmt: skip


def without_fallback(scene: Scene) -> Scene:
    """The same scene with reduced bodies that stay what they are, whatever their error is."""
    return with_reduced_entries(scene, {"fallback": None, "error": None})


def with_reduced_entries(scene: Scene, changes: dict) -> Scene:
    """The same scene with some keys of `reduced` of its reduced bodies changed."""
    return scene.with_deformables({"reduced": changes})


def with_entries(scene: Scene, reduced: dict) -> Scene:
    """The same scene with other entries `reduced` of some bodies, by their names."""
    return scene.with_deformables(
        lambda body: body.changed(reduced=reduced.get(body.name, body.reduced)))  # fmt: skip


class Placed:
    """Points of a reduced body that no term needs, placed from its coordinates.

    It has the `positions` of a `BarycentricMapping`.
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


@dataclass(frozen=True)
class ReducedNodes:
    """What replaces the nodes of a reduced body.

    Attributes:
        reduction: Its basis and sampled points.
        basis: Φ of the modes in use in world axes, shape (mesh_node_count, 3, mode_count).
        rest: Nodes of its mesh at rest [m], shape (mesh_node_count, 3).
        first_node: Its first coordinate node among all nodes of the scene.
        points: The points that terms ask for, on the nodes of its mesh; None while all nodes of the
            mesh are points.
        asked: What terms asked for while all nodes were points.
        platform: What its base rides on; None where it stands still.
    """

    reduction: BodyReduction
    basis: np.ndarray
    rest: np.ndarray
    first_node: int = 0
    points: dict[tuple[bytes, bytes], int] | None = None
    asked: list[BarycentricMapping] = field(default_factory=list)
    platform: Platform | None = None

    @property
    def mode_count(self) -> int:
        """Number of coordinates."""
        return self.basis.shape[2]

    @property
    def node_count(self) -> int:
        """Number of its coordinate nodes and points."""
        points = len(self.rest) if self.points is None else len(self.points)
        return self.mode_count // 3 + points

    @property
    def coordinate_nodes(self) -> np.ndarray:
        """Nodes whose positions are the coordinates, shape (mode_count / 3,)."""
        return self.first_node + np.arange(self.mode_count // 3)

    @property
    def first_point(self) -> int:
        """Its first point among all nodes of the scene."""
        return self.first_node + self.mode_count // 3

    def carried_by(self, mapping: BarycentricMapping) -> BarycentricMapping:
        """Points on nodes of its mesh, on its points among all nodes of the scene."""
        if self.points is None:
            self.asked.append(mapping)
            return BarycentricMapping(
                mapping.nodes + self.first_point, mapping.barycentric_weights
            )
        places = [self.points[key] for key in map(_key_of, *_rows_of(mapping))]
        nodes = self.first_point + np.array(places, np.int64).reshape(-1, 1)
        return BarycentricMapping(nodes, np.ones((len(nodes), 1)))

    def point_modes(self) -> tuple[np.ndarray, np.ndarray]:
        """Positions at rest [m] and Φ of its points, shape (count, 3) and (count, 3, mode_count)."""
        if self.points is None:
            return self.rest, self.basis
        keys = [(np.frombuffer(nodes, np.int64), np.frombuffer(weights))
                for nodes, weights in self.points]  # fmt: skip
        rest = np.array([weights @ self.rest[nodes] for nodes, weights in keys]).reshape(-1, 3)
        modes = [np.tensordot(weights, self.basis[nodes], 1) for nodes, weights in keys]
        return rest, np.array(modes).reshape(len(keys), 3, self.mode_count)

    def with_asked_points(self) -> ReducedNodes:
        """The same with the points that were asked for, each once, in place of all nodes."""
        keys = [key for mapping in self.asked for key in map(_key_of, *_rows_of(mapping))]
        points = {key: index for index, key in enumerate(dict.fromkeys(keys))}
        return replace(self, points=points, asked=[])

    def rest_nodes(self) -> np.ndarray:
        """Its nodes at rest: coordinates, which are zero, then points [m], (node_count, 3)."""
        return np.vstack([np.zeros((self.mode_count // 3, 3)), self.point_modes()[0]])

    def mesh_positions(self, node_positions: np.ndarray) -> np.ndarray:
        """All nodes of its mesh where the coordinates place them [m], shape (mesh_node_count, 3).

        Args:
            node_positions: Node positions of the scene [m], shape (node_count, 3).
        """
        placed = self.rest + self.basis @ node_positions[self.coordinate_nodes].ravel()
        if self.platform is not None:
            placed += self.platform.displacement(node_positions)
        return placed

    def are_points(self) -> np.ndarray:
        """Which of its nodes are points, and no unknowns themselves, shape (node_count,)."""
        return np.arange(self.node_count) >= self.mode_count // 3

    def placed(self, mapping: BarycentricMapping) -> Placed:
        """Points on nodes of its mesh that no term needs."""
        modes = np.zeros((mapping.point_count, 3, self.mode_count))
        for nodes, weights in zip(mapping.nodes.T, mapping.barycentric_weights.T, strict=True):
            modes += weights[:, None, None] * self.basis[nodes]
        rest = mapping.positions(self.rest)
        return Placed(self.coordinate_nodes, rest, modes, self.platform)

    def kind(self, free_index: np.ndarray) -> ReducedPoints:
        """Its kind of unknowns.

        Args:
            free_index: Unknown of each node of the scene, shape (node_count,).
        """
        nodes = self.coordinate_nodes
        return ReducedPoints(
            nodes, free_index[nodes], self.first_point, *self.point_modes(), self.platform
        )

    def weights_of(self, body: Body, gravity: np.ndarray) -> np.ndarray:
        """Weight as forces on the coordinates [N], shape (mode_count / 3, 3).

        Args:
            body: The body.
            gravity: Acceleration [m/s²], shape (3,).
        """
        is_consistent = body.entry.mass_model == "consistent"
        masses = borne_masses(body.mesh, body.density) if is_consistent else body.node_masses()
        return np.einsum("n,i,nim->m", masses, gravity, self.basis, optimize=True).reshape(-1, 3)


def _rows_of(mapping: BarycentricMapping) -> tuple[np.ndarray, np.ndarray]:
    return mapping.nodes, mapping.barycentric_weights


def _key_of(nodes: np.ndarray, weights: np.ndarray) -> tuple[bytes, bytes]:
    """Nodes and weights of one point, those without weight left out."""
    used = weights != 0.0
    return nodes[used].astype(np.int64).tobytes(), weights[used].astype(float).tobytes()


def reduced_nodes(body: Body, scene: Scene) -> ReducedNodes:
    """Read what a body is reduced to.

    Args:
        body: The body, with an entry `reduced`.
        scene: The scene.

    Raises:
        SceneError: The file is not there, of another body, or damaged; or the scene asks for something that
            is not built for reduced bodies.
    """
    path: Path = scene.file_path(body.entry.reduced.file)
    key = f"{body.key}.reduced"
    _refuse(body, key, scene)
    try:
        reduction = read_body_reduction(path, body)
    except ModelFileError as error:
        command = f"{COMMAND} {shlex.quote(str(scene.path))}"
        raise SceneError(
            scene.path, f"{key}.file", str(path), "", f"{error.reason}; run: {command}"
        ) from None
    if body.entry.reduced.spare_modes:
        reduction = reduction.with_spare_modes()
    turn = Rotation.from_euler("xyz", body.entry.mesh.rotation).as_matrix()
    used = reduction.basis[:, :, : reduction.mode_count]
    return ReducedNodes(reduction, np.einsum("ij,njm->nim", turn, used), body.mesh.node_positions)


def _refuse(body: Body, key: str, scene: Scene) -> None:
    """Refuse what is not built for reduced bodies, by name."""
    if scene.integration != "quasi_static":
        raise SceneError(
            scene.path, "integration", scene.integration, "",
            f"{body.name} is reduced: inertia and damping of reduced bodies are not built; use "
            "quasi_static",
        )  # fmt: skip
    if body.riding and not rides_on_a_slide(body, scene):
        raise SceneError(
            scene.path, f"{body.key}.attached", ", ".join(body.riding), "",
            "nodes of a reduced body may be attached to one platform that a slide moves; others "
            "are not built",
        )  # fmt: skip


def rides_on_a_slide(body: Body, scene: Scene) -> bool:
    """Whether a body is attached to one rigid body, and that is moved by a slide.

    Args:
        body: The body.
        scene: The scene.
    """
    return len(body.riding) == 1 and set(body.riding) <= {slide.body for slide in scene.slides}


def on_platform(body: Body, parts: Iterable) -> Body:
    """A reduced body that knows what it rides on; the body itself where it stands still.

    Args:
        body: The body.
        parts: The rigid bodies of the scene, with `name`, `first_node` and `origin`.
    """
    if body.reduction is None or not body.riding:
        return body
    part = next(part for part in parts if part.name in body.riding)
    return replace(
        body, reduction=replace(body.reduction, platform=Platform(part.first_node, part.origin))
    )
