"""Corotational linear tetrahedra: small strain in the frame that turns with the element.

The energy of one element is V (µ ‖F - R‖² + λ/2 tr²(RᵀF - 1)) with F = R S. Forces and tangent are
its exact first and second derivatives, so Newton's method converges quadratically:

    P    = 2µ (F - R) + λ tr(RᵀF - 1) R  =  2µ F - c R,      c = 2µ - λ tr(RᵀF - 1)
    K_ab = V (λ g_a g_bᵀ + 2µ (g_a·g_b) 1 + c [g_a]× (tr(RS Rᵀ) 1 - RS Rᵀ)⁻¹ [g_b]×),   g_a = R ∇N_a

At rest the last term is µ [g_a]× [g_b]×, and K_ab is linear elasticity's. The arithmetic is in
`corotational_kernels.py`.
"""

from __future__ import annotations

import numpy as np

from softrobot_twin.geometry.tet_mesh import TetMesh
from softrobot_twin.mechanics.corotational_elements import CorotationalElements
from softrobot_twin.mechanics.corotational_kernels import add_all, add_all_forces
from softrobot_twin.mechanics.material import LameParameters
from softrobot_twin.mechanics.shape_gradients import shape_gradients


class CorotationalTets(CorotationalElements):
    """Force term of an elastic body of corotational linear tetrahedra."""

    name = "corotational tetrahedra"
    _add_all = add_all
    _add_all_forces = add_all_forces

    def __init__(self, mesh: TetMesh, free_index: np.ndarray, material: LameParameters):
        """Prepare the elements.

        Args:
            mesh: The body at rest.
            free_index: Free-node index of each node, -1 where it is fixed, shape (node_count,).
            material: Lamé's constants [Pa].
        """
        gradients, volumes = shape_gradients(mesh.node_positions, mesh.tets)
        super().__init__(mesh, free_index, material, gradients[:, None], volumes)
