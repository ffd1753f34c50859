"""Selection of nodes by regions of space, for instance of the fixed nodes of a scene."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


# Tolerance relative to the size of the body: a node on a face of a region belongs to the region
# even if its file stores single precision (6e-8); a node beside the face in a file of seven digits
# does not.
_RELATIVE_TOLERANCE = 1e-7


def _tolerance(node_positions: np.ndarray) -> float:
    """Distance up to which a node lies on a face [m]; independent of the pose of the body."""
    if len(node_positions) == 0:
        return 0.0
    from_middle = np.linalg.norm(node_positions - node_positions.mean(axis=0), axis=1)
    return _RELATIVE_TOLERANCE * 2.0 * float(from_middle.max())


def nodes_in_box(
    node_positions: np.ndarray, minimum: Sequence[float], maximum: Sequence[float]
) -> np.ndarray:
    """Finds the nodes inside a box or on its faces.

    Args:
        node_positions: Node positions [m], shape (node_count, 3).
        minimum: Smallest coordinates of the box [m], shape (3,).
        maximum: Largest coordinates of the box [m], shape (3,).

    Returns:
        Node indices in rising order, int64.
    """
    lower, upper = np.asarray(minimum, dtype=float), np.asarray(maximum, dtype=float)
    tolerance = _tolerance(node_positions)
    inside = (node_positions >= lower - tolerance) & (node_positions <= upper + tolerance)
    return np.flatnonzero(inside.all(axis=1)).astype(np.int64)


def nodes_in_sphere(node_positions: np.ndarray, centre: Sequence[float], radius: float) -> np.ndarray:
    """Finds the nodes inside a sphere or on its surface.

    Args:
        node_positions: Node positions [m], shape (node_count, 3).
        centre: Centre of the sphere [m], shape (3,).
        radius: Radius of the sphere [m].

    Returns:
        Node indices in rising order, int64.
    """
    distances = np.linalg.norm(node_positions - np.asarray(centre, dtype=float), axis=1)
    inside = distances <= radius + _tolerance(node_positions)
    return np.flatnonzero(inside).astype(np.int64)
