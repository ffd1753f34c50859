"""Surfaces by which deformable bodies, beams and cavities are drawn, and poses of rigid bodies."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softrobot_twin.geometry.surface_reading import read_surface
from softrobot_twin.mechanics.barycentric import BarycentricMapping
from softrobot_twin.mechanics.rotation import quaternion_from_rotation
from softrobot_twin.scene import Scene
from softrobot_twin.simulation.building.beam_bodies import BeamBody, swept_surface
from softrobot_twin.simulation.building.deformable_body import Body
from softrobot_twin.simulation.building.mapped_surfaces import surface_on_mesh
from softrobot_twin.simulation.building.model import Model
from softrobot_twin.simulation.building.reduced_body import Placed

# A beam is drawn with at least this many pieces, each element with no more than the second number.
DRAWN_PIECES, MOST_PIECES = 32, 16


class Skin(NamedTuple):
    """A surface by which a body, a beam or a cavity is drawn.

    Attributes:
        name: Whose surface it is.
        triangles: Indices into `positions`, shape (triangle_count, 3); those of a cavity outward as
            seen from the gas.
        points: Places its points, as a `BarycentricMapping` does.
        limits: Least and greatest gauge pressure of a cavity [Pa]; infinite without a limit.
    """

    name: str
    triangles: np.ndarray
    points: BarycentricMapping | Placed
    limits: tuple[float, float] = (-np.inf, np.inf)

    def positions(self, node_positions: np.ndarray) -> np.ndarray:
        """Where its points are.

        Args:
            node_positions: Node positions [m], shape (node_count, 3).

        Returns:
            Positions [m], shape (point_count, 3).
        """
        return self.points.positions(node_positions)


def own_skin(body: Body) -> Skin:
    """The surface of the mesh of a body.

    Args:
        body: The body.
    """
    nodes, places = np.unique(body.mesh.surface_triangles, return_inverse=True)
    return Skin(body.name, places.reshape(-1, 3), body.shown_nodes(nodes))


def beam_skin(beam: BeamBody) -> Skin:
    """The section of a beam, swept along it.

    Args:
        beam: The beam.
    """
    pieces = min(-(-DRAWN_PIECES // len(beam.lengths)), MOST_PIECES)
    points, triangles = swept_surface(beam, pieces)
    return Skin(beam.name, triangles, points)


def body_skin(body: Body, scene: Scene, notes: list[str]) -> Skin:
    """The `visual` surface; without it the contact surface; without both the mesh's own.

    Args:
        body: The body.
        scene: The scene.
        notes: List to which is appended what of a file was split.

    Raises:
        MeshError: A surface file cannot be used.
        SceneError: A surface does not fit its body.
    """
    mesh = body.entry.mesh
    for name in ("visual", "contact_surface"):
        entry = getattr(body.entry, name)
        if entry:
            points, triangles = read_surface(
                scene.file_path(entry.file), scale=entry.scale,
                rotation=mesh.rotation, translation=mesh.translation,
            )  # fmt: skip
            on_mesh, triangles = surface_on_mesh(
                body, points, triangles, entry, f"{body.key}.{name}", scene, notes
            )
            return Skin(body.name, triangles, body.shown(on_mesh))
    return own_skin(body)


class Pose(NamedTuple):
    """Where a rigid body is.

    Attributes:
        position: Of its origin [m], shape (3,).
        quaternion: Its rotation (x, y, z, w), of any length but zero, shape (4,).
    """

    position: np.ndarray
    quaternion: np.ndarray


def named_poses(model: Model, positions: np.ndarray) -> dict[str, Pose]:
    """Pose of each rigid body, by name; see `rigid_poses`."""
    poses = map(Pose, *rigid_poses(model, positions))
    return dict(zip((part.name for part in model.rigid), poses, strict=True))


def rigid_poses(model: Model, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Poses of the coordinates in which the scene gives the rigid bodies' shapes.

    Args:
        model: The built scene.
        positions: Node positions [m], shape (node_count, 3).

    Returns:
        Positions [m], shape (rigid_body_count, 3), and quaternions (x, y, z, w), shape
        (rigid_body_count, 4).
    """
    origins, quaternions = np.empty((len(model.rigid), 3)), np.empty((len(model.rigid), 4))
    for index, part in enumerate(model.rigid):
        origins[index], rotation = part.entry_pose(positions)
        quaternions[index] = quaternion_from_rotation(rotation)
    return origins, quaternions
