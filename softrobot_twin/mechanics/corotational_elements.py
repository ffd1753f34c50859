"""Corotational elements of any order, the energy summed over quadrature points q:

    Σ_q w_q (µ ‖F_q - R_q‖² + λ/2 tr²(R_qᵀF_q - 1))
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from softrobot_twin.mechanics.batched_elements import BatchedElements


class CorotationalElements(BatchedElements):
    """What linear and quadratic corotational elements share; each brings its two kernels."""

    _add_all: Callable
    _add_all_forces: Callable

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
