"""Gradients of the quadratic shape functions at the four points of the rule of degree two.

Edges are straight at rest, so the gradients are linear inside an element, and four points
integrate their products, the stiffness at rest, exactly: it has its full rank, 24.
"""

from __future__ import annotations

import numpy as np

from softrobot_twin.geometry.quadratic import EDGES
from softrobot_twin.mechanics.shape_gradients import shape_gradients

POINT_COUNT = 4
FAR = (5.0 - np.sqrt(5.0)) / 20.0
# Barycentric coordinates of the quadrature points, FAR but for the nearest corner's; each stands for a quarter of the volume.
POINTS = np.full((4, 4), FAR) + (1.0 - 4.0 * FAR) * np.eye(4)


def quadratic_gradients(
    node_positions: np.ndarray, tets: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Gradients of the quadratic shape functions and the volumes.

    Args:
        node_positions: Rest positions [m], shape (node_count, 3).
        tets: Node indices, shape (tet_count, 10); mid-edge nodes in the middle of straight edges.

    Returns:
        Gradients ∇N_a at each point [1/m], shape (tet_count, 4, 10, 3), and volumes [m³],
        shape (tet_count,).
    """
    corner_gradients, volumes = shape_gradients(node_positions, tets[:, :4])
    # ∂N/∂L: 4 L_a - 1 at a corner; 4 L_b by L_a and 4 L_a by L_b on an edge.
    slopes = np.zeros((POINT_COUNT, 10, 4))
    corners, edges, (first, second) = np.arange(4), np.arange(4, 10), EDGES.T
    slopes[:, corners, corners] = 4.0 * POINTS - 1.0
    slopes[:, edges, first] = 4.0 * POINTS[:, second]
    slopes[:, edges, second] = 4.0 * POINTS[:, first]
    return np.einsum("qab,kbi->kqai", slopes, corner_gradients), volumes
