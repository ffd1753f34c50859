"""What a deformable body looks like: its own surface, or a finer one that it carries."""

from __future__ import annotations

import numpy as np

from softrobot_twin.geometry.surface_reading import read_surface
from softrobot_twin.scene import Scene
from softrobot_twin.simulation.body import Body
from softrobot_twin.simulation.carry import carry_surface


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
    """A finer surface that the mesh carries along; see `OwnSkin` and `carry_surface`."""

    def __init__(self, body: Body, entry, key: str, scene: Scene):
        """Read the surface and find the tetrahedra that carry it.

        Args:
            body: The body.
            entry: What names the surface's file.
            key: Where it does.
            scene: The scene.

        Raises:
            MeshError: The file cannot be used.
            SceneError: The surface does not fit the body.
        """
        mesh = body.entry.mesh
        points, self.triangles = read_surface(
            scene.file_path(entry.file), scale=entry.scale,
            rotation=mesh.rotation, translation=mesh.translation,
        )  # fmt: skip
        self.name = body.name
        self._mapping = carry_surface(body, points, entry, key, scene)

    def positions(self, node_positions: np.ndarray) -> np.ndarray:
        """Where its points are; see `OwnSkin.positions`."""
        return self._mapping.positions(node_positions)


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
    return tuple(_skin(body, scene) for body in bodies)


def _skin(body: Body, scene: Scene):
    """What is there for the eye, or else what the body touches with, or else its own surface."""
    for name in ("visual", "contact_surface"):
        entry = getattr(body.entry, name)
        if entry is not None:
            return CarriedSkin(body, entry, f"{body.key}.{name}", scene)
    return OwnSkin(body)
