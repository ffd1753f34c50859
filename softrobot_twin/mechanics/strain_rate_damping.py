"""Damping by the rate of strain: viscosity beside elasticity (Kelvin and Voigt), Rayleigh's β.

The elastic constants times β [s] are the viscosities, and the law is the corotational one of
`corotational.py`, with the shape where the step begins as the shape without stress. With F₀ the
deformation gradient there, u = q - q₀ the way of the step and V the volume at rest,

    F = 1 + Σ u_a g_aᵀ = R U,    g_a = F₀⁻ᵀ ∇N_a
    E = (U - 1)/h,    σ = β (λ tr(E) 1 + 2µ E)
    potential  V h/2 (σ : E),    f_a = -V R σ g_a,    heat of the step  V h (σ : E)

F = F₁ F₀⁻¹ is the deformation in the step, R its rotation: the rate of strain E is that in the
element's own frame, which turns with it. It follows:

- A rigid motion has E = 0 and no force, however far the body turns in one step and however
  strained it is.
- The heat is never negative, whatever the strain and the motion, and zero for rigid motions only.
- The forces have no resultant and no torque about where the nodes are at the end of the step, as
  the elastic forces.
- Forces and tangent are the exact derivatives of the potential. Where the step begins (u = 0) the
  tangent is V β/h (λ g_a g_bᵀ + µ g_b g_aᵀ + µ (g_a·g_b) 1), positive semi-definite; further on it
  can be indefinite like the elastic one, and has the same projection.
- At rest and for small strains it is Rayleigh's damping: β times the elastic stiffness.

A step of a single linearization sees the tangent at u = 0 only, where a rotation by θ has a strain
of the order of θ²: fast turning needs more linearizations, or shorter steps.

An element that is flat, or nearly, has no F₀⁻ᵀ or an enormous one: its rotation R₀ stands in for it
there. The heat is positive still, but such an element resists rotation where it is strained. One
that is inside out but not flat needs no such care. The arithmetic is in `strain_rate_kernels.py`.
"""

from __future__ import annotations

import numpy as np

from softrobot_twin.mechanics.batched_elements import BatchedElements
from softrobot_twin.mechanics.lanes import LANES
from softrobot_twin.mechanics.material import LameParameters
from softrobot_twin.mechanics.quadrature import quadrature
from softrobot_twin.mechanics.strain_rate_kernels import add_all, add_all_forces, begin_all


class StrainRateDamping(BatchedElements):
    """Force term of the viscosity of a deformable body, of linear or quadratic tetrahedra.

    Until the first step begins, and if it takes infinitely long, there is no force.

    Attributes:
        beta: β [s].
    """

    name = "strain-rate damping"
    remembers_start = True

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
        # Where the nodes are at the beginning of a step, g_a at each point, and V β/h [m³].
        self._start = np.empty((0, 0))
        self._step_gradients, self._step_weights = np.empty((0, 0, 0)), np.empty((0, LANES))

    def bind(self, elimination_rank: np.ndarray, slots) -> None:
        """Lay out the elements, and make room for what a step keeps."""
        super().bind(elimination_rank, slots)
        batch_count, node_count = self._tets.shape[:2]
        room = 3 * node_count * LANES
        self._start = np.zeros((batch_count, room))
        self._step_gradients = np.zeros((batch_count, self._gradients.shape[1], room))
        self._step_weights = np.zeros((batch_count, LANES))

    def begin_step(
        self, positions: np.ndarray, velocities: np.ndarray, time_step: float
    ) -> None:
        """Take the shape that the step begins with as the one without stress.

        Args:
            positions: Node positions q₀ [m], shape (node_count, 3).
            velocities: Not needed.
            time_step: h [s].
        """
        begin_all(
            positions, self._tets, self._constants, self.beta / time_step,
            self._start, self._step_gradients, self._step_weights,
        )  # fmt: skip

    def add_forces(self, positions: np.ndarray, forces: np.ndarray) -> int:
        """Add -V R σ g_a [N] to the forces on the free nodes.

        Args:
            positions: Node positions q [m], shape (node_count, 3), also of fixed and guided ones,
                whose way in the step strains their elements too.
            forces: Forces on the free nodes [N], shape (free_node_count, 3); added to.

        Returns:
            0: what is inside out, the elastic term counts.
        """
        add_all_forces(
            positions, self._tets, self._free,
            self._start, self._step_gradients, self._step_weights,
            self.material.lame_lambda, self.material.shear_modulus, forces,
        )  # fmt: skip
        return 0

    def add(self, positions, forces, storage, projected: bool) -> None:
        """Add the forces, and their exact derivative to the system matrix.

        Args:
            positions: Node positions q [m], shape (node_count, 3).
            forces: Forces on the free nodes [N], shape (free_node_count, 3); added to.
            storage: The factorization's storage [N/m]; added to.
            projected: True for the positive semi-definite tangent, projected point by point.
        """
        add_all(
            positions, self._tets, self._free,
            self._start, self._step_gradients, self._step_weights,
            self.material.lame_lambda, self.material.shear_modulus, projected,
            self._offsets, self._strides, forces, storage,
        )  # fmt: skip

    def heat(self, positions: np.ndarray) -> float:
        """Energy that a step to these positions turns into heat [J], never negative.

        Plain numpy, for studies and tests.

        Args:
            positions: Node positions q [m], shape (node_count, 3).
        """
        batch_count, node_count = self._tets.shape[:2]
        start = self._start.reshape(batch_count, node_count, 3, LANES)
        g = self._step_gradients.reshape(batch_count, -1, node_count, 3, LANES)
        moves = positions[self._tets].transpose(0, 1, 3, 2) - start
        F = np.eye(3) + np.einsum("kaie,kqaje->kqeij", moves, g)
        stretches = np.linalg.svd(F, compute_uv=False)
        stretches[..., 2] *= np.where(np.linalg.det(F) < 0.0, -1.0, 1.0)
        la, mu = self.material
        square = np.sum((stretches - 1.0) ** 2, axis=-1)
        trace = np.sum(stretches - 1.0, axis=-1)
        power = 2.0 * mu * square + la * trace**2
        return float(np.sum(self._step_weights[:, None] * power))
