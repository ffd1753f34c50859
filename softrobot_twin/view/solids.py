"""Rigid bodies and obstacles as rerun entities: each mesh once, then a pose a frame.

Importing this module imports rerun.
"""

from __future__ import annotations

import numpy as np
import rerun as rr

from softrobot_twin.view.frame import Frame, Stage
from softrobot_twin.view.recording import Recording
from softrobot_twin.view.surface import Surface
from softrobot_twin.view.surface_normals import SurfaceNormals

RIGID_BODIES = "/rigid_bodies"
OBSTACLES = "/obstacles"

_RIGID_COLOUR = (214, 168, 96)
_OBSTACLE_COLOUR = (112, 116, 124)


class Solids:
    """Draws what does not deform.

    Args:
        recording: Where to.
        stage: The surfaces; they are logged at once.
    """

    def __init__(self, recording: Recording, stage: Stage):
        self._recording = recording
        self._names = [body.name for body in stage.rigid_bodies]
        for body in stage.rigid_bodies:
            recording.log(f"{RIGID_BODIES}/{body.name}", _mesh(body, _RIGID_COLOUR), static=True)
        for obstacle in stage.obstacles:
            recording.log(f"{OBSTACLES}/{obstacle.name}", _mesh(obstacle, _OBSTACLE_COLOUR),
                          static=True)

    def log(self, frame: Frame) -> None:
        """Place the rigid bodies where they are in a frame."""
        for name, position, quaternion in zip(self._names, frame.rigid_positions,
                                              frame.rigid_quaternions):
            pose = rr.Transform3D(translation=position, quaternion=quaternion)
            self._recording.log(f"{RIGID_BODIES}/{name}", pose)


def _mesh(surface: Surface, colour: tuple[int, int, int]) -> rr.Mesh3D:
    """The surface with corners of its own for each triangle, so that edges look sharp."""
    corners = np.asarray(surface.points, dtype=float)[surface.triangles].reshape(-1, 3)
    triangles = np.arange(len(corners)).reshape(-1, 3)
    normals = SurfaceNormals(triangles, len(corners)).at(corners)
    return rr.Mesh3D(vertex_positions=corners.astype(np.float32),
                     triangle_indices=triangles.astype(np.uint32),
                     vertex_normals=normals.astype(np.float32), albedo_factor=colour)
