"""All nodes of a scene: where they stand at rest, and which of them are unknowns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from softrobot_twin.mechanics.barycentric import writable


@njit(cache=True, nogil=True, error_model="numpy")
def advance_nodes(positions, free_nodes, move, share):
    """Move the free nodes by a share of the first rows of a move."""
    for k in range(len(free_nodes)):
        for i in range(3):
            positions[free_nodes[k], i] += share * move[k, i]


@njit(cache=True, nogil=True, error_model="numpy")
def write_displacement(before, after, free_nodes, way):
    """Way of each free node, in the first rows."""
    for k in range(len(free_nodes)):
        for i in range(3):
            way[k, i] = after[free_nodes[k], i] - before[free_nodes[k], i]


@njit(cache=True, nogil=True, error_model="numpy")
def longest_row(vectors):
    """Length of the longest of some vectors, shape (count, 3); not finite if one is not."""
    largest = 0.0
    for k in range(len(vectors)):
        if not largest < np.inf:
            break
        x, y, z = vectors[k, 0], vectors[k, 1], vectors[k, 2]
        square = x * x + y * y + z * z
        if not square <= largest:
            largest = square
    return np.sqrt(largest)


@dataclass(frozen=True)
class Nodes:
    """The nodes of all bodies, one after the other.

    Attributes:
        rest_positions: Where they stand at rest [m], shape (node_count, 3).
        free_nodes: Nodes that move by themselves, shape (free_node_count,).
        free_index: Place of each node among the unknowns, -1 where it has none,
            shape (node_count,).
        free_node_count: Unknowns, three numbers each.
        size: Diagonal of the largest body's bounding box [m]; infinite for a single point.
    """

    rest_positions: np.ndarray
    free_nodes: np.ndarray
    free_index: np.ndarray
    free_node_count: int
    size: float

    def advance(self, positions: np.ndarray, move: np.ndarray, share: float) -> None:
        """Move the nodes.

        Args:
            positions: Node positions [m], shape (node_count, 3); moved.
            move: Move of each unknown [m], shape (free_node_count, 3).
            share: Share of it to make.
        """
        advance_nodes(positions, self.free_nodes, move, share)

    def displacement(self, before: np.ndarray, after: np.ndarray) -> np.ndarray:
        """Way of each unknown from one state to another [m], shape (free_node_count, 3)."""
        way = np.empty((self.free_node_count, 3))
        write_displacement(writable(before), writable(after), self.free_nodes, way)
        return way

    def longest(self, move: np.ndarray) -> float:
        """Longest way that a node makes in a move [m]; not finite if one is not."""
        return longest_row(writable(move))

    def largest_force(self, forces: np.ndarray) -> float:
        """Largest force on a node [N]; not finite if one is not."""
        return longest_row(forces)
