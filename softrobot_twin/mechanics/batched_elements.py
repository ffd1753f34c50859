"""Elements of one kind in batches: where their nodes, constants and stiffness lie in memory.

What an element is, linear or quadratic, is in its gradients at its quadrature points and in the two
kernels that work on a batch; all around it is the same.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy

import numpy as np

from softrobot_twin.mechanics.lanes import LANES, in_lanes
from softrobot_twin.mechanics.material import LameParameters
from softrobot_twin.mechanics.stencil import bind_stencils


class BatchedElements:
    """Corotational elements of any order, the energy summed over quadrature points q:

        Σ_q w_q (µ ‖F_q - R_q‖² + λ/2 tr²(R_qᵀF_q - 1))

    Attributes:
        material: Lamé's constants [Pa].
    """

    _add_all: Callable
    _add_all_forces: Callable

    def __init__(
        self,
        mesh,
        free_index: np.ndarray,
        material: LameParameters,
        gradients: np.ndarray,
        weights: np.ndarray,
    ):
        """Prepare the elements.

        Args:
            mesh: The body at rest, its elements of k nodes.
            free_index: Free-node index of each node, -1 where it is fixed, shape (node_count,).
            material: Lamé's constants [Pa].
            gradients: Gradients of the shape functions at the quadrature points [1/m],
                shape (element_count, point_count, k, 3).
            weights: Volume that each point stands for [m³], shape (element_count,).
        """
        self.material = material
        self._mesh = mesh
        self._free_index = free_index
        self._gradients, self._weights = gradients, weights
        # Batches hold the elements' nodes in elimination order, which `bind` finds.
        self._tets = self._free = self._constants = self._offsets = self._strides = None

    def stencils(self) -> np.ndarray:
        """Free nodes that each element couples, -1 where fixed, shape (element_count, k)."""
        return self._free_index[self._mesh.tets]

    def bind(self, elimination_rank: np.ndarray, slots) -> None:
        """Look up where the stiffness goes, sort each element's nodes to suit, and batch."""
        bound = bind_stencils(self.stencils(), elimination_rank, slots)
        tets = np.take_along_axis(self._mesh.tets, bound.order, axis=1)
        gradients = np.take_along_axis(self._gradients, bound.order[:, None, :, None], axis=2)
        gradients = gradients.reshape(len(tets), -1)
        # Lanes beyond the last element repeat a whole one, without volume and without a place.
        spare = slice((len(tets) - 1) % LANES + 1, LANES)
        self._tets = in_lanes(tets, 0)
        self._tets[-1][:, spare] = tets[-1][:, None]
        self._free = in_lanes(self._free_index[tets], -1)
        batches = in_lanes(np.column_stack([gradients, self._weights]), 0.0)
        batches[-1][:-1, spare] = gradients[-1][:, None]
        self._constants = batches.reshape(len(batches), -1)
        self._offsets = in_lanes(bound.offsets, -1)
        self._strides = in_lanes(bound.strides, 0)

    def stiffened(self, factor: float) -> BatchedElements:
        """The same elements, bound to the same places, of a material stiffer by a factor."""
        other = copy(self)
        la, mu = self.material
        other.material = LameParameters(factor * la, factor * mu)
        return other

    def add_forces(self, positions: np.ndarray, forces: np.ndarray) -> int:
        """Add -F(q) [N] to the forces on the free nodes, shape (free_node_count, 3).

        Returns:
            Number of elements that are flat or inside out.
        """
        return type(self)._add_all_forces(
            positions, self._tets, self._free, self._constants,
            self.material.lame_lambda, self.material.shear_modulus, forces,
        )  # fmt: skip

    def add(self, positions, forces, storage, projected: bool) -> None:
        """Add -F(q) to the forces and ∂F/∂q to the system matrix.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            forces: Forces on the free nodes [N], shape (free_node_count, 3); added to.
            storage: The factorization's storage [N/m]; added to.
            projected: True for the positive semi-definite tangent, projected point by point.
        """
        type(self)._add_all(
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
        return float(np.sum(self._weights[:, None] * (mu * shear + 0.5 * la * trace**2)))
