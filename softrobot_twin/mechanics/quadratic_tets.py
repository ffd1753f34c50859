"""Corotational quadratic tetrahedra, which do not lock: `corotational.py`'s law, ten nodes.

A linear tetrahedron cannot bend, and when ν nears 0.5 it can hardly change shape without changing
volume. Ten nodes let the strain vary linearly inside the element. The energy is

    Σ_q V/4 (µ ‖F_q - R_q‖² + λ/2 tr²(R_qᵀF_q - 1))

over four quadrature points q, each with its own deformation gradient F_q = Σ x_a ∇N_a(q)ᵀ and its
own rotation R_q. Forces and tangent are its exact derivatives; what `corotational.py` says about
one element holds here at each point. The arithmetic is in `quadratic_kernels.py`.
"""

from __future__ import annotations

import numpy as np

from softrobot_twin.geometry.quadratic import QuadraticMesh
from softrobot_twin.mechanics.corotational_elements import CorotationalElements
from softrobot_twin.mechanics.material import LameParameters
from softrobot_twin.mechanics.quadratic_gradients import POINT_COUNT, quadratic_gradients
from softrobot_twin.mechanics.quadratic_kernels import add_all, add_all_forces


class QuadraticTets(CorotationalElements):
    """Force term of an elastic body of corotational quadratic tetrahedra.

    An element counts as inside out when it folds anywhere: see `quadratic_folds.py`.
    """

    name = "corotational quadratic tetrahedra"
    _add_all = add_all
    _add_all_forces = add_all_forces

    def __init__(self, mesh: QuadraticMesh, free_index: np.ndarray, material: LameParameters):
        """Prepare the elements.

        Args:
            mesh: The body at rest.
            free_index: Free-node index of each node, -1 where it is fixed, shape (node_count,).
            material: Lamé's constants [Pa].
        """
        gradients, volumes = quadratic_gradients(mesh.node_positions, mesh.tets)
        super().__init__(mesh, free_index, material, gradients, volumes / POINT_COUNT)
