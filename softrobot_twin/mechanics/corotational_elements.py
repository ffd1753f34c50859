"""Corotational elements of any order, the energy summed over quadrature points q:

    Σ_q w_q (µ ‖F_q - R_q‖² + λ/2 tr²(R_qᵀF_q - 1))
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from softrobot_twin.mechanics.batched_elements import BatchedElements
from softrobot_twin.mechanics.lanes import LANES


class CorotationalElements(BatchedElements):
    """What linear and quadratic corotational elements share; each brings its two kernels.

    A step ends by taking the forces where the next begins: they are kept, and the rotations found
    with them, and taken for granted as long as positions are the same to the bit.
    """

    _add_all: Callable
    _add_all_forces: Callable

    def bind(self, elimination_rank: np.ndarray, slots) -> None:
        """Make room for what is kept as well; see `BatchedElements.bind`."""
        super().bind(elimination_rank, slots)
        batches, points = len(self._tets), self._gradients.shape[1]
        self._rotations = np.zeros((batches, points, 9 * LANES))
        self._uprights = np.zeros((batches, points, LANES))
        self._forces, self._known_at = np.empty((0, 3)), np.empty((0, 3))

    def add_forces(self, positions: np.ndarray, forces: np.ndarray) -> int:
        """Add -F(q) [N] to the forces on the free nodes, shape (free_node_count, 3).

        Returns:
            Number of elements that are flat or inside out.
        """
        self._forces = np.zeros_like(forces)
        flat_count = type(self)._add_all_forces(
            positions, self._tets, self._free, self._constants,
            self.material.lame_lambda, self.material.shear_modulus,
            self._rotations, self._uprights, self._forces,
        )  # fmt: skip
        self._known_at = positions.copy()
        forces += self._forces
        return flat_count

    def add(self, positions, forces, storage, projected: bool) -> None:
        """Add -F(q) to the forces and ∂F/∂q to the system matrix.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            forces: Forces on the free nodes [N], shape (free_node_count, 3); added to.
            storage: The factorization's storage [N/m]; added to.
            projected: True for the positive semi-definite tangent, projected point by point.
        """
        are_known = np.array_equal(positions, self._known_at)
        if not are_known:
            self._forces = np.zeros_like(forces)
        type(self)._add_all(
            positions, self._tets, self._free, self._constants,
            self.material.lame_lambda, self.material.shear_modulus, projected,
            are_known, self._rotations, self._uprights,
            self._offsets, self._strides, self._forces, storage,
        )  # fmt: skip
        if not are_known:
            self._known_at = positions.copy()
        forces += self._forces

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
