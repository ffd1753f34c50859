"""A correction of the positions, of which any share can be made, and which can be taken back.

Slides prescribe where a base is, so it goes there at once, and carries what is attached to it as a
rigid body; only the displacement of the unknowns has shares.
"""

from __future__ import annotations

import numpy as np

from softrobot_twin.geometry.vector_arrays import copy_vectors
from softrobot_twin.simulation.building.model import Model


class Move:
    """The last correction of one simulation. Its arrays are allocated once.

    Attributes:
        start: Node positions when slides have moved, and before anything else has [m], shape
            (node_count, 3).
        displacement: What it displaces the unknowns by [m], shape (free_node_count, 3).
    """

    def __init__(self, model: Model):
        """Allocate.

        Args:
            model: The built scene.
        """
        self._nodes, self._slides = model.nodes, model.slides
        self.start = np.empty_like(model.nodes.rest_positions)
        # Without slides it starts from where the positions were.
        self._before = self.start if model.slides is None else np.empty_like(self.start)
        self.displacement = np.zeros((model.nodes.free_node_count, 3))

    def begin(
        self, before: np.ndarray, displacement: np.ndarray, efforts: np.ndarray | None = None
    ) -> None:
        """Note a correction before it is made.

        Args:
            before: Node positions [m], shape (node_count, 3).
            displacement: Of the unknowns [m], shape (free_node_count, 3).
            efforts: Those of `Actuation`, of slides their displacements, shape (actuator_count,);
                needed with slides.
        """
        copy_vectors(before, self.start)
        copy_vectors(displacement, self.displacement)
        if self._slides is not None:
            self._before[:] = before
            self._slides.shift(self.start, -efforts[-self._slides.count :])

    def make(self, positions: np.ndarray, share: float) -> None:
        """Go from where it starts by a share of the displacement.

        Args:
            positions: Takes the node positions [m], shape (node_count, 3).
            share: The share.
        """
        copy_vectors(self.start, positions)
        self._nodes.advance(positions, self.displacement, share)

    def take_back(self, positions: np.ndarray) -> None:
        """Go back to where the positions were before it, also those of slides.

        Args:
            positions: Takes the node positions [m], shape (node_count, 3).
        """
        positions[:] = self._before
