"""What moves as a frame: a rigid body, a vertebra, or a node of a beam."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True)
class FramePart:
    """What moves with one frame, as a rigid body.

    Attributes:
        name: Its name, after that of its body, such as ``fetch.top``.
        is_free: False where it is fixed.
        origin: Origin of its frame at rest, the centre of its mass [m], shape (3,).
        rotation: From its frame to the world at rest, shape (3, 3).
        mass: Mass, including that of the attached nodes [kg].
        inertia: About the origin, in its frame [kg m²], shape (3, 3).
        radius: Distance of its furthest point from the origin [m].
        damping: α: drag by mass and inertia [1/s].
        attached: Nodes of soft bodies attached to it among all nodes, shape (attached_count,).
        local: Their positions in its frame [m], shape (attached_count, 3).
    """

    name: str
    is_free: bool
    origin: np.ndarray
    rotation: np.ndarray
    mass: float
    inertia: np.ndarray
    radius: float
    damping: float
    attached: np.ndarray = field(default_factory=lambda: np.empty(0, np.int64))
    local: np.ndarray = field(default_factory=lambda: np.empty((0, 3)))
