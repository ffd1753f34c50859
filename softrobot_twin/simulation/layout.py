"""Where everything of a scene lies: bodies, point masses and rigid bodies among all nodes."""

from __future__ import annotations

from importlib import import_module
from typing import NamedTuple

import numpy as np

from softrobot_twin.errors import SceneError
from softrobot_twin.geometry.tet_mesh import TetMesh
from softrobot_twin.mechanics.barycentric import BarycentricMapping
from softrobot_twin.scene import Scene
from softrobot_twin.simulation.body import Body, build_body, placed_in_world
from softrobot_twin.simulation.carry import carry
from softrobot_twin.simulation.nodes import Nodes
from softrobot_twin.simulation.scene_files import check_files


class Layout(NamedTuple):
    """The bodies of a scene and their nodes.

    Attributes:
        scene: The scene.
        bodies: Its deformable bodies.
        rigid: Its rigid bodies, shape (rigid_body_count,).
        mass_nodes: Nodes of each mass-spring body, by its name.
        nodes: All nodes.
    """

    scene: Scene
    bodies: tuple[Body, ...]
    rigid: tuple
    mass_nodes: dict[str, np.ndarray]
    nodes: Nodes

    def body_named(self, name: str | None):
        """The body of this name, deformable or rigid; unnamed, the only deformable one."""
        if name is None:
            return self.bodies[0]
        return next(body for body in (*self.bodies, *self.rigid) if body.name == name)

    def carried(
        self, name: str | None, points, key: str, notes: list[str], spread_radius: float = 0.0
    ) -> BarycentricMapping:
        """Map points onto a body.

        Args:
            name: The body; None for the only deformable one.
            points: Points at rest [m], shape (point_count, 3).
            key: Scene entry the points come from, to name in errors.
            notes: Takes a warning for each point that had to be snapped.
            spread_radius: See `carry`.

        Returns:
            The mapping.

        Raises:
            SceneError: A point is too far from a deformable body.
        """
        body = self.body_named(name)
        if isinstance(body, Body):
            return carry(body, points, key, self.scene, notes, spread_radius)
        return body.carried(points)

    def in_world(self, name: str | None, frame: str, points) -> np.ndarray:
        """Points of an entry that says which frame they are in [m], shape (count, 3)."""
        if frame == "world":
            return np.asarray(points, float).reshape(-1, 3)
        return placed_in_world(self.body_named(name).entry, points)

    def mesh_among_nodes(self, body: Body):
        """A body's mesh with its nodes numbered among all nodes, as the terms want it."""
        positions = self.nodes.rest_positions
        if len(positions) == body.mesh.node_count:
            return body.mesh
        corners = TetMesh(positions, body.mesh.corner_mesh.cells + body.first_node)
        if body.entry.element == "linear":
            return corners
        quadratic = import_module("softrobot_twin.geometry.quadratic_mesh").QuadraticMesh
        return quadratic(
            corners, np.array(positions), body.mesh.cells + body.first_node,
            body.mesh.mid_edge_ends + body.first_node,
        )  # fmt: skip


def lay_out(scene: Scene, notes: list[str]) -> Layout:
    """Read all bodies of a scene and number their nodes.

    Args:
        scene: The scene.
        notes: Takes what was mended.

    Returns:
        The layout.

    Raises:
        MeshError: A mesh cannot be used.
        SceneError: An entry does not fit.
    """
    check_files(scene)
    bodies: list[Body] = []
    first_node = 0
    for index, entry in enumerate(scene.deformables):
        key = "body" if scene.body is not None else f"bodies[{index}]"
        bodies.append(build_body(entry, key, first_node, scene, notes))
        first_node += bodies[-1].mesh.node_count
    positions = [body.mesh.node_positions for body in bodies]
    fixed = [body.fixed for body in bodies]
    mass_nodes = {}
    for entry in scene.mass_springs:
        mass_nodes[entry.name] = first_node + np.arange(len(entry.points))
        positions.append(np.asarray(entry.points, float))
        fixed.append(np.isin(np.arange(len(entry.points)), entry.fixed))
        first_node += len(entry.points)
    rigid = ()
    if scene.rigid_bodies:
        building = import_module("softrobot_twin.simulation.rigid_building")
        rigid = building.build_rigid_parts(scene, first_node, notes)
    _note_unused_contact_surfaces(bodies, scene, notes)
    nodes = _number(positions, fixed, rigid)
    if nodes.free_node_count == 0 and (scene.deformables or scene.mass_springs):
        raise _nothing_moves(scene)
    return Layout(scene, tuple(bodies), rigid, mass_nodes, nodes)


def _note_unused_contact_surfaces(bodies: list[Body], scene: Scene, notes: list[str]) -> None:
    contact = scene.contact
    named = set() if contact is None else {name for t in contact.between for name in t.pair}
    # A point that is known ahead may leave out whose it is, where there is one body.
    points = contact is not None and bool(contact.points)
    for body in bodies:
        if body.entry.contact_surface is not None and body.name not in named and not points:
            notes.append(
                f"{body.key}.contact_surface is not used: contact.between names no pair with "
                f"{body.name}"
            )


def _nothing_moves(scene: Scene) -> SceneError:
    """The error of a scene whose bodies have no unknown."""
    key, what = "mass_springs", "all points are fixed"
    if scene.deformables:
        key = "body.fixed" if scene.body is not None else "bodies"
        what = "all nodes are fixed or attached"
    return SceneError(scene.path, key, what, "", "nothing in the scene can move by itself")


def _number(positions: list[np.ndarray], fixed: list[np.ndarray], rigid: tuple) -> Nodes:
    """Number the unknowns: what moves by itself, node by node."""
    boxes = [float(np.linalg.norm(np.ptp(part, axis=0))) for part in positions]
    held = np.concatenate([np.empty(0, bool), *fixed])
    free_nodes = np.flatnonzero(~held)
    free_index = np.full(len(held), -1, dtype=np.int64)
    free_index[free_nodes] = np.arange(len(free_nodes))
    rest = np.concatenate([np.empty((0, 3)), *positions])
    if rigid:
        building = import_module("softrobot_twin.simulation.rigid_building")
        return building.frame_nodes(rest, free_nodes, free_index, boxes, rigid)
    rest.setflags(write=False)
    # A single point has no size that could limit how far it moves.
    size = max(boxes) or np.inf
    return Nodes(rest, free_nodes, free_index, len(free_nodes), size)
