"""What a deformable body looks like: its own surface, or a finer one that it carries."""

from __future__ import annotations

from importlib import import_module

import numpy as np

from softrobot_twin.errors import SceneError
from softrobot_twin.geometry.point_location import locate_points
from softrobot_twin.scene import Scene
from softrobot_twin.simulation.body import Body

# A carried surface may stand off its body by this share of the body's size, and no more.
STAND_OFF = 0.1


class OwnSkin:
    """The surface of the mesh itself.

    Attributes:
        name: The body's name.
        triangles: Indices into `positions`, shape (triangle_count, 3).
    """

    def __init__(self, body: Body):
        """Find the nodes of the surface.

        Args:
            body: The body.
        """
        self.name = body.name
        self._nodes, places = np.unique(
            body.mesh.surface_triangles + body.first_node, return_inverse=True
        )
        self.triangles = places.reshape(-1, 3)

    def positions(self, node_positions: np.ndarray) -> np.ndarray:
        """Where its points are.

        Args:
            node_positions: Node positions [m], shape (node_count, 3).

        Returns:
            Positions [m], shape (point_count, 3).
        """
        return node_positions[self._nodes]


class CarriedSkin:
    """A finer surface, for the eye only, that the mesh carries along; see `OwnSkin`."""

    def __init__(self, body: Body, scene: Scene):
        """Read the surface and find the tetrahedra that carry it.

        A point outside the mesh is carried by the nearest tetrahedron, with weights below zero:
        at rest it stays where it is, and it turns with that tetrahedron.

        Args:
            body: The body.
            scene: The scene.

        Raises:
            MeshError: The file cannot be used.
            SceneError: The surface does not fit the body.
        """
        reading = import_module("softrobot_twin.geometry.surface_reading")
        entry, mesh = body.entry.visual, body.entry.mesh
        points, self.triangles = reading.read_surface(
            scene.file_path(entry.file), scale=entry.scale,
            rotation=mesh.rotation, translation=mesh.translation,
        )  # fmt: skip
        self.name = body.name
        found = locate_points(body.mesh.corner_mesh, points)
        furthest = float(found.distances.max())
        if furthest > STAND_OFF * body.size:
            raise SceneError(
                scene.path, f"{body.key}.visual.file", str(entry.file), "",
                f"stands off its body by {1e3 * furthest:.2f} mm, more than a tenth of the "
                f"body's {1e3 * body.size:.1f} mm: is its scale right?",
            )  # fmt: skip
        corners = body.mesh.corner_mesh.node_positions[body.mesh.corner_mesh.tets[found.tets]]
        self._mapping = body.mapping(found.tets, barycentric_weights(corners, points))

    def positions(self, node_positions: np.ndarray) -> np.ndarray:
        """Where its points are; see `OwnSkin.positions`."""
        return self._mapping.positions(node_positions)


def barycentric_weights(corners: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Weights of points in tetrahedra, also of points outside.

    Args:
        corners: Corners of the tetrahedron of each point [m], shape (point_count, 4, 3).
        points: The points [m], shape (point_count, 3).

    Returns:
        Weights, each row of sum 1, shape (point_count, 4).
    """
    edges = (corners[:, 1:] - corners[:, :1]).transpose(0, 2, 1)
    last = np.linalg.solve(edges, (points - corners[:, 0])[..., None])[..., 0]
    return np.column_stack([1.0 - last.sum(axis=1), last])


def skins(bodies: tuple[Body, ...], scene: Scene) -> tuple:
    """What each deformable body looks like.

    Args:
        bodies: The bodies.
        scene: The scene.

    Returns:
        A skin for each body.

    Raises:
        MeshError: A surface file cannot be used.
        SceneError: A surface does not fit its body.
    """
    return tuple(
        OwnSkin(body) if body.entry.visual is None else CarriedSkin(body, scene)
        for body in bodies
    )
