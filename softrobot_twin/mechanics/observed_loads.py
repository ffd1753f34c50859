"""Loads that an observer found, at given places; constant in a step."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softrobot_twin.mechanics.barycentric import BarycentricMapping
from softrobot_twin.mechanics.gravity import ConstantForces


class ObservedPlace(NamedTuple):
    """Where a load is looked for.

    Attributes:
        name: Its name.
        points: The points whose mean it is; where `is_found`, the points among which it is; where
            `is_wrench`, four points of a rigid body, its centre of mass and one along each axis.
        is_found: Whether the place itself is unknown.
        is_wrench: Whether there is a torque too.
        normals: Outward normals at rest of points among which a place is found, shape
            (point_count, 3); else empty.
    """

    name: str
    points: BarycentricMapping
    is_found: bool = False
    is_wrench: bool = False
    normals: np.ndarray = np.empty((0, 3))

    @property
    def dimension(self) -> int:
        """Numbers of its load: a force, or a force and a torque."""
        return 6 if self.is_wrench else 3


class ObservedLoads(ConstantForces):
    """Force term of the loads that an observer found.

    Attributes:
        places: Where they are looked for.
        forces: See `ConstantForces`; changed in place before a step.
    """

    name = "observed loads"
    is_traceable = True

    def __init__(self, places: tuple[ObservedPlace, ...], free_node_count: int):
        """Take the places; there is no load yet.

        Args:
            places: Where loads are looked for.
            free_node_count: Number of unknowns.
        """
        self.places, self.forces = places, np.zeros((free_node_count, 3))
