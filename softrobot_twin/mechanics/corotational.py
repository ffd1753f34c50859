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
from softrobot_twin.mechanics.corotational_kernels import (
    CONSTANT_COUNT,
    add_all,
    add_all_forces,
)
from softrobot_twin.mechanics.lanes import LANES, in_lanes
from softrobot_twin.mechanics.material import LameParameters
from softrobot_twin.mechanics.shape_gradients import shape_gradients
from softrobot_twin.mechanics.stencil import bind_stencils


class CorotationalTets:
    """Force term of an elastic body of corotational linear tetrahedra."""

    name = "corotational tetrahedra"

    def __init__(self, mesh: TetMesh, free_index: np.ndarray, material: LameParameters):
        """Prepare the elements.

        Args:
            mesh: The body at rest.
            free_index: Free-node index of each node, -1 where it is fixed, shape (node_count,).
            material: Lamé's constants [Pa].
        """
        self.material = material
        self._mesh = mesh
        self._free_index = free_index
        self._gradients, self._volumes = shape_gradients(mesh.node_positions, mesh.tets)
        # Batches hold the elements' nodes in elimination order, which `bind` finds.
        self._tets = self._free = self._constants = self._offsets = self._strides = None

    def stencils(self) -> np.ndarray:
        """Free nodes that each element couples, -1 where fixed, shape (tet_count, 4)."""
        return self._free_index[self._mesh.tets]

    def bind(self, elimination_rank: np.ndarray, slots) -> None:
        """Look up where the stiffness goes, sort each element's nodes to suit, and batch."""
        bound = bind_stencils(self.stencils(), elimination_rank, slots)
        tets = np.take_along_axis(self._mesh.tets, bound.order, axis=1)
        gradients = np.take_along_axis(self._gradients, bound.order[:, :, None], axis=1)
        constants = np.column_stack([gradients.reshape(len(tets), 12), self._volumes])
        # Lanes beyond the last element repeat a whole one, without volume and without a place.
        self._tets = in_lanes(tets, 0)
        self._tets[-1][:, self._spare_lanes()] = tets[-1][:, None]
        self._free = in_lanes(self._free_index[tets], -1)
        batches = in_lanes(constants, 0.0)
        batches[-1][:12, self._spare_lanes()] = constants[-1][:12, None]
        self._constants = batches.reshape(-1, CONSTANT_COUNT * LANES)
        self._offsets = in_lanes(bound.offsets, -1)
        self._strides = in_lanes(bound.strides, 0)

    def _spare_lanes(self) -> slice:
        """Lanes of the last batch that hold no element."""
        return slice((len(self._volumes) - 1) % LANES + 1, LANES)

    def add_forces(self, positions: np.ndarray, forces: np.ndarray) -> int:
        """Add -F(q) [N] to the forces on the free nodes, shape (free_node_count, 3).

        Returns:
            Number of elements that are flat or inside out.
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
            projected: True for the element-wise positive semi-definite tangent.
        """
        add_all(
            positions, self._tets, self._free, self._constants,
            self.material.lame_lambda, self.material.shear_modulus, projected,
            self._offsets, self._strides, forces, storage,
        )  # fmt: skip

    def relative_energy_error(self, positions: np.ndarray) -> float:
        """Share of the energy that this mesh is too coarse for, an estimate."""
        from softrobot_twin.mechanics.recovered_stress import relative_energy_error

        return relative_energy_error(
            positions, self._tets, self._constants,
            self.material.lame_lambda, self.material.shear_modulus,
        )  # fmt: skip

    def energy(self, positions: np.ndarray) -> float:
        """Stored elastic energy [J]. Plain numpy, for studies and tests."""
        F = np.einsum("kai,kaj->kij", positions[self._mesh.tets], self._gradients)
        U, _, Vt = np.linalg.svd(F)
        U[:, :, 2] *= np.sign(np.linalg.det(U @ Vt))[:, None]
        R = U @ Vt
        trace = np.einsum("kij,kij->k", R, F) - 3.0
        shear = np.sum((F - R) ** 2, axis=(1, 2))
        la, mu = self.material
        return float(np.sum(self._volumes * (mu * shear + 0.5 * la * trace**2)))
