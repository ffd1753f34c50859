"""Gradients of the shape functions at the quadrature points of an element at rest."""

from __future__ import annotations

import numpy as np


def shape_gradients(node_positions: np.ndarray, tets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Gradients of the linear shape functions and the volumes.

    Args:
        node_positions: Rest positions [m], shape (node_count, 3).
        tets: Node indices, shape (tet_count, 4).

    Returns:
        Gradients ∇N_a [1/m], shape (tet_count, 4, 3), and volumes [m³], shape (tet_count,).
    """
    corners = node_positions[tets]
    edges = (corners[:, 1:] - corners[:, :1]).transpose(0, 2, 1)
    inverse = np.linalg.inv(edges)
    gradients = np.empty((len(tets), 4, 3))
    gradients[:, 1:] = inverse
    gradients[:, 0] = -inverse.sum(axis=1)
    return gradients, np.linalg.det(edges) / 6.0
