"""Nodes of a scene with rigid bodies: four frame nodes each, moved as one by an exact rotation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from softrobot_twin.mechanics.barycentric import writable
from softrobot_twin.mechanics.rigid_frames import RigidFrames
from softrobot_twin.simulation.nodes import Nodes, advance_nodes, longest_row


@njit(cache=True, nogil=True, error_model="numpy")
def longest_at_rim(vectors, points, radii, are_forces):
    """Longest of some vectors, those of rotations as a way, or as a force, at the rim."""
    largest = longest_row(vectors[:points])
    at_rim = np.empty((2, 3))
    for k in range(len(radii)):
        if not largest < np.inf:
            break
        first = points + 2 * k
        for i in range(3):
            at_rim[0, i], turning = vectors[first, i], vectors[first + 1, i]
            at_rim[1, i] = turning / radii[k] if are_forces else turning * radii[k]
        found = longest_row(at_rim)
        if not found <= largest:
            largest = found
    return largest


@dataclass(frozen=True)
class FramedNodes(Nodes):
    """Nodes whose last are the frames of rigid bodies; see `Nodes`.

    Attributes:
        frames: Where each rigid body's frame nodes and its two unknowns lie.
        radii: Distance of each free rigid body's furthest point from its centre of mass [m];
            turns angles into ways and torques into forces, shape (free_body_count,).
    """

    frames: RigidFrames
    radii: np.ndarray

    def advance(self, positions: np.ndarray, move: np.ndarray, share: float) -> None:
        """Move the nodes; a rigid body's rotation is made exactly, see `Nodes.advance`."""
        advance_nodes(positions, self.free_nodes, move, share)
        if self.frames.free_body_count:
            self.frames.advance(positions, move, share)

    def displacement(self, before: np.ndarray, after: np.ndarray) -> np.ndarray:
        """Way [m], and angle [rad] for rotations, of each unknown."""
        before, after = writable(before), writable(after)
        way = super().displacement(before, after)
        self.frames.displacement(before, after, way)
        return way

    def longest(self, move: np.ndarray) -> float:
        """Longest way that a point makes in a move [m]; not finite if one is not."""
        return longest_at_rim(writable(move), len(self.free_nodes), self.radii, False)

    def largest_force(self, forces: np.ndarray) -> float:
        """Largest force on a node [N]; torques count as forces at the body's furthest point."""
        return longest_at_rim(forces, len(self.free_nodes), self.radii, True)
