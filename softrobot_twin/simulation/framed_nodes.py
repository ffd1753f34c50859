"""Nodes of a scene with rigid bodies: four frame nodes each, moved as one by an exact rotation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from softrobot_twin.mechanics.rigid_frames import RigidFrames
from softrobot_twin.simulation.nodes import Nodes, longest_row


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
        positions[self.free_nodes] += share * move[: len(self.free_nodes)]
        self.frames.advance(positions, move, share)

    def displacement(self, before: np.ndarray, after: np.ndarray) -> np.ndarray:
        """Way [m], and angle [rad] for rotations, of each unknown."""
        way = np.empty((self.free_node_count, 3))
        way[: len(self.free_nodes)] = after[self.free_nodes] - before[self.free_nodes]
        self.frames.displacement(before, after, way)
        return way

    def longest(self, move: np.ndarray) -> float:
        """Longest way that a point makes in a move [m]; not finite if one is not."""
        points = len(self.free_nodes)
        turns = move[points + 1 :: 2] * self.radii[:, None]
        return max(
            longest_row(move[:points]), longest_row(move[points::2]), longest_row(turns)
        )  # fmt: skip

    def largest_force(self, forces: np.ndarray) -> float:
        """Largest force on a node [N]; torques count as forces at the body's furthest point."""
        points = len(self.free_nodes)
        at_rim = forces[points + 1 :: 2] / self.radii[:, None]
        return max(
            longest_row(forces[:points]), longest_row(forces[points::2]), longest_row(at_rim)
        )  # fmt: skip
