"""Rigid bodies from their scene entries: shape, mass, place."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from softrobot_twin.errors import SceneError
from softrobot_twin.mechanics.barycentric import BarycentricMapping
from softrobot_twin.mechanics.rigid_frames import RigidFrames
from softrobot_twin.scene import Scene
from softrobot_twin.scene.body_entries import RigidBody
from softrobot_twin.simulation.framed_nodes import FramedNodes
from softrobot_twin.simulation.shape_building import build_shape, triangulated


@dataclass(frozen=True)
class RigidPart:
    """A rigid body of a scene.

    Attributes:
        entry: What the scene says of it.
        index: Its place among all rigid bodies.
        first_node: Its first frame node.
        origin: Where its frame stands at rest [m]: a free body's centre of mass, shape (3,).
        rotation: From its frame to the world at rest, shape (3, 3).
        centre_of_mass: The frame's origin in the coordinates of the scene entry [m], shape (3,).
        shape: Its shape, in its frame.
        mass: Mass [kg]; 0 for a guided body.
        inertia: About the centre of mass, in its frame [kg m²], shape (3, 3).
        radius: Distance of its furthest point from the frame's origin [m].
    """

    entry: RigidBody
    index: int
    first_node: int
    origin: np.ndarray
    rotation: np.ndarray
    centre_of_mass: np.ndarray
    shape: object
    mass: float
    inertia: np.ndarray
    radius: float

    @property
    def name(self) -> str:
        """The body's name."""
        return self.entry.name

    @property
    def is_free(self) -> bool:
        """True for a body that moves by itself, False for one that is guided."""
        return self.entry.motion == "free"

    def carried(self, points) -> BarycentricMapping:
        """Points that move with it.

        Args:
            points: In the world, at rest [m], shape (point_count, 3).

        Returns:
            Their mapping onto its frame nodes.
        """
        local = (np.asarray(points, float).reshape(-1, 3) - self.origin) @ self.rotation
        nodes = np.tile(self.first_node + np.arange(4), (len(local), 1))
        return BarycentricMapping(nodes, np.column_stack([1.0 - local.sum(axis=1), local]))

    def entry_pose(self, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Origin [m] and rotation of the entry's coordinates at a state, (3,) and (3, 3)."""
        frame = positions[self.first_node : self.first_node + 4]
        rotation = (frame[1:] - frame[0]).T
        return frame[0] - rotation @ self.centre_of_mass, rotation


def build_rigid_parts(scene: Scene, first_node: int, notes: list[str]) -> tuple[RigidPart, ...]:
    """Build all rigid bodies.

    Args:
        scene: The scene.
        first_node: Nodes of the scene that come before their frames.
        notes: Takes what was mended.

    Returns:
        The rigid bodies.

    Raises:
        SceneError: A body is free where nothing holds it.
        MeshError: A surface cannot be used.
    """
    parts = []
    for index, entry in enumerate(scene.rigid_bodies):
        key = f"rigid_bodies[{index}]"
        if entry.motion == "free" and scene.integration == "quasi_static":
            raise SceneError(
                scene.path, f"{key}.motion", "free", "",
                f"{entry.name} floats: in quasi_static integration nothing gives it an "
                "equilibrium; make the scene dynamic, or the body guided",
            )  # fmt: skip
        parts.append(_build_part(entry, index, first_node + 4 * index, scene, notes))
    return tuple(parts)


def _build_part(entry, index: int, first_node: int, scene, notes) -> RigidPart:
    rotation = Rotation.from_euler("xyz", entry.rotation).as_matrix()
    shape = build_shape(entry.shape, scene, notes)
    centre, mass, inertia = np.zeros(3), 0.0, np.zeros((3, 3))
    if entry.motion == "free":
        volume, centre, unit_inertia = shape.mass_properties()
        mass = entry.mass if entry.mass is not None else entry.density * volume
        inertia = unit_inertia * (mass / volume)
        shape = build_shape(entry.shape, scene, notes, shift=-centre)
    corners, _ = triangulated(shape)
    radius = float(np.linalg.norm(corners, axis=1).max())
    origin = np.asarray(entry.position, float) + rotation @ centre
    return RigidPart(
        entry, index, first_node, origin, rotation, centre, shape, mass, inertia, radius
    )


def frame_nodes(
    positions: np.ndarray, free_nodes: np.ndarray, free_index: np.ndarray,
    boxes: list[float], parts: tuple[RigidPart, ...],
) -> FramedNodes:  # fmt: skip
    """Add the frame nodes of rigid bodies to all other nodes.

    Args:
        positions: The other nodes at rest [m], shape (n, 3).
        free_nodes: Those that move, shape (free,).
        free_index: Their unknowns, shape (n,).
        boxes: Diagonals of the other bodies' boxes [m].
        parts: The rigid bodies.

    Returns:
        All nodes.
    """
    free = np.array([part.is_free for part in parts])
    unknowns = len(free_nodes) + 2 * int(free.sum())
    frames = RigidFrames(len(positions), free, len(free_nodes), unknowns)
    rest = np.vstack([positions, frames.rest_nodes([(p.origin, p.rotation) for p in parts])])
    rest.setflags(write=False)
    radii = np.array([part.radius for part in parts])
    return FramedNodes(
        rest, free_nodes, np.concatenate([free_index, frames.free_index()]), unknowns,
        max([*boxes, *(2.0 * radii)]), frames, radii[free],
    )  # fmt: skip
