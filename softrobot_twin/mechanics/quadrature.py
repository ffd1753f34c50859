"""Gradients and volumes at the quadrature points of tetrahedra, linear or quadratic."""

from __future__ import annotations

import numpy as np

from softrobot_twin.geometry.tet_mesh import TetMesh
from softrobot_twin.mechanics.shape_gradients import shape_gradients


def quadrature(mesh) -> tuple[np.ndarray, np.ndarray]:
    """Gradients of the shape functions at rest, and what each point stands for.

    Args:
        mesh: The body at rest, a `TetMesh` or a `QuadraticMesh`; k nodes an element.

    Returns:
        Gradients [1/m], shape (element_count, point_count, k, 3), and the volume of each point
        [m³], shape (element_count,).
    """
    if isinstance(mesh, TetMesh):
        gradients, volumes = shape_gradients(mesh.node_positions, mesh.tets)
        return gradients[:, None], volumes
    from softrobot_twin.mechanics.quadratic_gradients import POINT_COUNT, quadratic_gradients

    gradients, volumes = quadratic_gradients(mesh.node_positions, mesh.tets)
    return gradients, volumes / POINT_COUNT
