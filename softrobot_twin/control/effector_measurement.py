"""Where the effectors really are, from the markers that move with them."""

from __future__ import annotations

import numpy as np

from softrobot_twin.control.marker_input import Misfit
from softrobot_twin.simulation import Simulation


class EffectorMeasurement:
    """Moves each believed effector by the mean misfit of the markers beside it.

    Args:
        simulation: Gives the markers of each effector and its controlled directions.
    """

    def __init__(self, simulation: Simulation):
        self._markers = simulation.effector_markers
        self._controlled = np.array(
            [
                [axis in effector.directions for axis in "xyz"]
                for effector in simulation.scene.effectors
            ],
            dtype=bool,
        ).reshape(-1, 3)

    @property
    def is_possible(self) -> bool:
        """True when some effector has markers that move with it."""
        return any(len(indices) for indices in self._markers)

    def is_complete(self, measured: np.ndarray) -> bool:
        """True when every effector that has markers is seen by one of them.

        Args:
            measured: Measured markers [m], shape (marker_count, 3); NaN where not seen.
        """
        return all(
            np.isfinite(measured[indices]).all(axis=1).any()
            for indices in self._markers
            if len(indices)
        )

    def effectors(self, believed: np.ndarray, misfit: Misfit) -> np.ndarray:
        """Measured effectors [m], shape (effector_count, 3); NaN where no marker is seen.

        Args:
            believed: Where the model has them [m], shape (effector_count, 3).
            misfit: Measured against predicted markers, at the same state of the model.
        """
        measured = np.full_like(believed, np.nan)
        for effector, indices in enumerate(self._markers):
            vectors = misfit.vectors[indices]
            vectors = vectors[np.isfinite(vectors).all(axis=1)]
            if len(vectors):
                measured[effector] = believed[effector] + vectors.mean(axis=0)
        return measured

    def controlled(self, targets: np.ndarray, positions: np.ndarray) -> np.ndarray:
        """Targets along the controlled directions, positions along the others [m], same shape."""
        return np.where(self._controlled, targets, positions)

    def differences(self, targets: np.ndarray, positions: np.ndarray) -> np.ndarray:
        """Target minus position, 0 in a direction that is not controlled [m], same shape."""
        return np.where(self._controlled, targets - positions, 0.0)

    def errors(
        self, targets: np.ndarray, believed: np.ndarray, measured: np.ndarray
    ) -> np.ndarray:
        """Distances from the targets [m], shape (effector_count,), measured where possible.

        Args:
            targets: Asked positions [m], shape (effector_count, 3); NaN rows give NaN.
            believed: Effectors of the model [m], same shape.
            measured: Measured effectors [m], same shape; NaN rows fall back on the model.
        """
        seen = np.isfinite(measured).all(axis=1, keepdims=True)
        differences = self.differences(targets, np.where(seen, measured, believed))
        return np.linalg.norm(differences, axis=1)
