"""Damping by the rate of strain: viscosity beside elasticity (Kelvin and Voigt), Rayleigh's β.

The elastic constants times β [s] are the viscosities. With the shape where the step begins as
reference (F₀ the deformation gradient there, u = q - q₀ the way of the step, V the volume at rest)

    D = Σ u_a g_aᵀ / h,    σ = β (λ tr(D) 1 + µ (D + Dᵀ)),    f_a = -V σ g_a,    g_a = F₀⁻ᵀ ∇N_a
    K_ab = V β (λ g_a g_bᵀ + µ g_b g_aᵀ + µ (g_a·g_b) 1),    f = -K u / h,    ∂f/∂q = -K / h

At rest K is β times the elastic stiffness: Rayleigh's damping. Unlike that, it is objective:

- It takes power always, uᵀ K u / h² ≥ 0, whatever the strain and the motion.
- It has no torque about where the nodes began. Backward Euler changes the angular momentum by
  h Σ x₀ × f in a step, so that a free body loses none by this force.
- A translation gives no force, a rotation by θ one of the order of θ²: tr D is (2 cos θ - 2)/h.

An element that is flat, or nearly, has no F₀⁻ᵀ or an enormous one: its rotation R₀ stands in for it
there. It still takes power only, but where it is strained it has a torque. One that is inside out
but not flat needs no such care: all of the above holds for it too. The arithmetic is in
`strain_rate_kernels.py`.
"""

from __future__ import annotations

import numpy as np

from softrobot_twin.mechanics.batched_elements import BatchedElements
from softrobot_twin.mechanics.lanes import LANES
from softrobot_twin.mechanics.material import LameParameters
from softrobot_twin.mechanics.quadrature import quadrature
from softrobot_twin.mechanics.strain_rate_kernels import (
    add_all_forces,
    add_all_stiffness,
    begin_all,
)


class StrainRateDamping(BatchedElements):
    """Force term of the viscosity of a deformable body, of linear or quadratic tetrahedra.

    Until the first step begins, and if it takes infinitely long, there is no force.

    Attributes:
        beta: β [s].
    """

    name = "strain-rate damping"

    def __init__(self, mesh, free_index: np.ndarray, material: LameParameters, beta: float):
        """Prepare the elements.

        Args:
            mesh: The body at rest, a `TetMesh` or a `QuadraticMesh`.
            free_index: Free-node index of each node, -1 where it is fixed, shape (node_count,).
            material: Lamé's constants of the body's elasticity [Pa].
            beta: Viscosity over elastic constant, β [s], not negative.

        Raises:
            ValueError: β is negative or not finite.
        """
        if not 0.0 <= beta < np.inf:
            raise ValueError(f"beta must be finite and not negative, not {beta} s")
        super().__init__(mesh, free_index, material, *quadrature(mesh))
        self.beta = float(beta)
        self._start, self._scaled = np.empty((0, 0)), np.empty((0, 0, 0))

    def bind(self, elimination_rank: np.ndarray, slots) -> None:
        """Lay out the elements, and make room for what a step keeps."""
        super().bind(elimination_rank, slots)
        batch_count, node_count = self._tets.shape[:2]
        room = 3 * node_count * LANES
        self._start = np.zeros((batch_count, room))
        self._scaled = np.zeros((batch_count, self._gradients.shape[1], room))

    def begin_step(
        self, positions: np.ndarray, velocities: np.ndarray, time_step: float
    ) -> None:
        """Take the shape that the step begins with as the reference.

        Args:
            positions: Node positions q₀ [m], shape (node_count, 3).
            velocities: Not needed.
            time_step: h [s].
        """
        rate = self.beta / time_step
        begin_all(positions, self._tets, self._constants, rate, self._start, self._scaled)

    def add_forces(self, positions: np.ndarray, forces: np.ndarray) -> int:
        """Add -K (q - q₀)/h [N] to the forces on the free nodes.

        Args:
            positions: Node positions q [m], shape (node_count, 3), also of fixed and guided ones,
                whose way in the step strains their elements too.
            forces: Forces on the free nodes [N], shape (free_node_count, 3); added to.

        Returns:
            0: what is inside out, the elastic term counts.
        """
        add_all_forces(
            positions, self._tets, self._free, self._start, self._scaled,
            self.material.lame_lambda, self.material.shear_modulus, forces,
        )  # fmt: skip
        return 0

    def add(self, positions, forces, storage, projected: bool) -> None:
        """Add the forces, and K/h to the system matrix.

        Args:
            positions: Node positions q [m], shape (node_count, 3).
            forces: Forces on the free nodes [N], shape (free_node_count, 3); added to.
            storage: The factorization's storage [N/m]; added to.
            projected: Of no effect: the stiffness is never negative.
        """
        self.add_forces(positions, forces)
        add_all_stiffness(
            self._scaled, self.material.lame_lambda, self.material.shear_modulus,
            self._offsets, self._strides, storage,
        )  # fmt: skip
