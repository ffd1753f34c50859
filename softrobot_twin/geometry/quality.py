"""Quality of tetrahedra."""

from __future__ import annotations

import numpy as np

from softrobot_twin.geometry.cell_mesh import SomeCells
from softrobot_twin.geometry.tet_mesh import TetMesh, tet_volumes


def radius_ratios(mesh: TetMesh | SomeCells) -> np.ndarray:
    """Three times the ratio of the radii of the inscribed and the circumscribed sphere.

    With V the volume, S the area of the four faces, and p, q, r the products of the lengths of
    opposite edges, the radii are 3 V / S and
    √((p+q+r)(−p+q+r)(p−q+r)(p+q−r)) / (24 V).

    Args:
        mesh: The tetrahedra.

    Returns:
        Ratio of each tetrahedron, from 0 (flat) to 1 (regular), shape (tet_count,).
    """
    corners = mesh.node_positions[mesh.cells]

    def edge_length(i: int, j: int) -> np.ndarray:
        return np.linalg.norm(corners[:, j] - corners[:, i], axis=1)

    def face_area(i: int, j: int, k: int) -> np.ndarray:
        normal = np.cross(corners[:, j] - corners[:, i], corners[:, k] - corners[:, i])
        return 0.5 * np.linalg.norm(normal, axis=1)

    area = face_area(1, 2, 3) + face_area(0, 2, 3) + face_area(0, 1, 3) + face_area(0, 1, 2)
    p = edge_length(0, 1) * edge_length(2, 3)
    q = edge_length(0, 2) * edge_length(1, 3)
    r = edge_length(0, 3) * edge_length(1, 2)
    # Round-off can make the product of a nearly flat tetrahedron slightly negative.
    product = np.maximum((p + q + r) * (-p + q + r) * (p - q + r) * (p + q - r), 0.0)
    denominator = area * np.sqrt(product)
    flat = denominator <= 0.0
    ratios = 216.0 * tet_volumes(mesh.node_positions, mesh.cells) ** 2 / np.where(flat, 1.0, denominator)
    return np.clip(np.where(flat, 0.0, ratios), 0.0, 1.0)
