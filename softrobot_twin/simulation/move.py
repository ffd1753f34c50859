"""A correction of the positions, of which any share can be made, and which can be taken back."""

from __future__ import annotations

import numpy as np

from softrobot_twin.simulation.actuation import NO_MOVES
from softrobot_twin.simulation.model import Model


class Move:
    """The last correction of one simulation. Its arrays are allocated once.

    Attributes:
        start: Node positions before it [m], shape (node_count, 3).
        displacement: What it displaces the unknowns by [m], shape (free_node_count, 3).
    """

    def __init__(self, model: Model):
        """Allocate.

        Args:
            model: The built scene.
        """
        self._nodes, self._slides = model.nodes, model.slides
        self.start = np.empty_like(model.nodes.rest_positions)
        self.displacement = np.zeros((model.nodes.free_node_count, 3))
        self._slid = NO_MOVES

    def begin(self, start: np.ndarray, displacement: np.ndarray, slid: np.ndarray) -> None:
        """Note a correction before it is made.

        Args:
            start: Node positions [m], shape (node_count, 3).
            displacement: Of the unknowns [m], shape (free_node_count, 3).
            slid: Displacement of each slide along its axis [m], shape (slide_count,).
        """
        self.start[:], self.displacement[:], self._slid = start, displacement, slid

    def make(self, positions: np.ndarray, share: float) -> None:
        """Go from where it starts as far as a share of it leads.

        Args:
            positions: Takes the node positions [m], shape (node_count, 3).
            share: The share.
        """
        self.take_back(positions)
        self._nodes.advance(positions, self.displacement, share)
        if len(self._slid):
            self._slides.shift(positions, share * self._slid)

    def take_back(self, positions: np.ndarray) -> None:
        """Go back to where it starts.

        Args:
            positions: Takes the node positions [m], shape (node_count, 3).
        """
        positions[:] = self.start
