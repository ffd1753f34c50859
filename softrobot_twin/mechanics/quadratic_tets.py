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
from softrobot_twin.mechanics.lanes import LANES, in_lanes
from softrobot_twin.mechanics.material import LameParameters
from softrobot_twin.mechanics.quadratic_gradients import POINT_COUNT, quadratic_gradients
from softrobot_twin.mechanics.quadratic_kernels import (
    CONSTANT_COUNT,
    WEIGHT,
    add_all,
    add_all_forces,
)
from softrobot_twin.mechanics.stencil import bind_stencils


class QuadraticTets:
    """Force term of an elastic body of corotational quadratic tetrahedra."""

    name = "corotational quadratic tetrahedra"

    def __init__(self, mesh: QuadraticMesh, free_index: np.ndarray, material: LameParameters):
        """Prepare the elements.

        Args:
            mesh: The body at rest.
            free_index: Free-node index of each node, -1 where it is fixed, shape (node_count,).
            material: Lamé's constants [Pa].
        """
        self.material = material
        self._mesh = mesh
        self._free_index = free_index
        self._gradients, self._volumes = quadratic_gradients(mesh.node_positions, mesh.tets)
        # Batches hold the elements' nodes in elimination order, which `bind` finds.
        self._tets = self._free = self._constants = self._offsets = self._strides = None

    def stencils(self) -> np.ndarray:
        """Free nodes that each element couples, -1 where fixed, shape (tet_count, 10)."""
        return self._free_index[self._mesh.tets]

    def bind(self, elimination_rank: np.ndarray, slots) -> None:
        """Look up where the stiffness goes, sort each element's nodes to suit, and batch."""
        bound = bind_stencils(self.stencils(), elimination_rank, slots)
        tets = np.take_along_axis(self._mesh.tets, bound.order, axis=1)
        gradients = np.take_along_axis(self._gradients, bound.order[:, None, :, None], axis=2)
        constants = np.column_stack(
            [gradients.reshape(len(tets), WEIGHT), self._volumes / POINT_COUNT]
        )
        # Lanes beyond the last element repeat a whole one, without volume and without a place.
        spare = slice((len(tets) - 1) % LANES + 1, LANES)
        self._tets = in_lanes(tets, 0)
        self._tets[-1][:, spare] = tets[-1][:, None]
        self._free = in_lanes(self._free_index[tets], -1)
        batches = in_lanes(constants, 0.0)
        batches[-1][:WEIGHT, spare] = constants[-1][:WEIGHT, None]
        self._constants = batches.reshape(-1, CONSTANT_COUNT * LANES)
        self._offsets = in_lanes(bound.offsets, -1)
        self._strides = in_lanes(bound.strides, 0)

    def add_forces(self, positions: np.ndarray, forces: np.ndarray) -> int:
        """Add -F(q) [N] to the forces on the free nodes, shape (free_node_count, 3).

        Returns:
            Number of elements that are flat or inside out at a quadrature point or a corner.
        """
        return add_all_forces(
            positions, self._tets, self._free, self._constants,
            self.material.lame_lambda, self.material.shear_modulus, forces,
        )  # fmt: skip

    def add(self, positions, forces, storage, projected: bool) -> None:
        """Add -F(q) to the forces and ∂F/∂q to the system matrix.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            forces: Forces on the free nodes [N], shape (free_node_count, 3); added to.
            storage: The factorization's storage [N/m]; added to.
            projected: True for the point-wise positive semi-definite tangent.
        """
        add_all(
            positions, self._tets, self._free, self._constants,
            self.material.lame_lambda, self.material.shear_modulus, projected,
            self._offsets, self._strides, forces, storage,
        )  # fmt: skip

    def energy(self, positions: np.ndarray) -> float:
        """Stored elastic energy [J]. Plain numpy, for studies and tests."""
        F = np.einsum("kai,kqaj->kqij", positions[self._mesh.tets], self._gradients)
        U, _, Vt = np.linalg.svd(F)
        U[..., 2] *= np.sign(np.linalg.det(U @ Vt))[..., None]
        R = U @ Vt
        trace = np.einsum("kqij,kqij->kq", R, F) - 3.0
        shear = np.sum((F - R) ** 2, axis=(2, 3))
        la, mu = self.material
        weights = self._volumes[:, None] / POINT_COUNT
        return float(np.sum(weights * (mu * shear + 0.5 * la * trace**2)))
