"""Damping by the rate of strain: viscosity beside elasticity (Kelvin and Voigt), Rayleigh's β.

The elastic constants times β [s] are the viscosities, and the law is that of
`laws/corotational.py`, with the shape at the beginning of the step as the stress-free shape. With
F₀ the deformation gradient there, u = q - q₀ the displacement in the step and V the volume at rest,

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

A step of a single linearization uses only the tangent at u = 0, which is that of small
displacements and needs no rotation. There a rotation by θ has a strain of the order of θ²: fast
rotations need more linearizations, or shorter steps.

An element that is flat, or nearly, has no F₀⁻ᵀ or an enormous one: its rotation R₀ is used instead.
The heat is still positive, but such an element resists rotation if it is strained. An inverted
element that is not flat needs no replacement.

The term is an `Elements` of the corotational law whose gradients and weights are computed anew at
the beginning of each step; F = 1 + Σ u_a g_aᵀ is their usual deformation gradient.

Arguments of the kernels here:
    cells: Nodes, shape (batch_count, most nodes of a batch, BATCH).
    rest_gradients, gradients: ∇N_a and g_a [1/m], shape (batch_count, point_count,
        3 nodes × BATCH).
    thin: Memory, shape (BATCH,).
"""

from __future__ import annotations

import numpy as np

from softrobot_twin.geometry.matrix3 import cofactor, inner, scaled_matrix
from softrobot_twin.geometry.vector3 import dot
from softrobot_twin.geometry.vector_arrays import are_same
from softrobot_twin.kernels.compilation import INNER, KERNEL, njit
from softrobot_twin.mechanics.element_assembly import (
    assembly_of,
    deform,
    gather,
    transform_gradients,
)
from softrobot_twin.mechanics.element_batches import (
    BATCH,
    matrix_at,
    node_count_of,
    of_nodes,
    put_matrix,
    scratch,
)
from softrobot_twin.mechanics.element_inversion import no_corners
from softrobot_twin.mechanics.elements import Elements
from softrobot_twin.mechanics.laws.corotational import Corotational
from softrobot_twin.mechanics.laws.small_displacement import SmallDisplacement
from softrobot_twin.mechanics.material import LameParameters
from softrobot_twin.mechanics.polar import turn_flat

# An element counts as flat where ‖F₀⁻¹‖ exceeds this: compressed to about a tenth of its thickness.
# Viscosity grows with the square, so this bounds the entries of a crushed element in the matrix.
THINNEST = 10.0


@njit(**INNER)
def invert_transposed(F, T, thin):
    """T = F⁻ᵀ, and the rotation of elements that are flat.

    Args:
        F, T: Matrices of a batch, shape (9 × BATCH,); T is written.
        thin: Memory, shape (BATCH,).
    """
    for e in range(BATCH):
        deformation = matrix_at(F, 0, e)
        cofactors = cofactor(deformation)
        det = dot(deformation[0], cofactors[0])
        # A comparison of squares alone would accept all zeros; NaN counts as flat.
        thick = (det != 0.0) & (inner(cofactors, cofactors) <= (THINNEST * det) ** 2)
        thin[e] = 0.0 if thick else 1.0
        put_matrix(T, 0, e, scaled_matrix(cofactors, 1.0 / det if thick else 0.0))
    for e in range(BATCH):
        if thin[e] > 0.0:
            turn_flat(F, T, e)


@njit(**KERNEL)
def _begin_all(moves, cells, rest_gradients, gradients):
    """g_a = F₀⁻ᵀ ∇N_a at each point of all batches."""
    U, F, T, thin = np.empty(gradients.shape[2]), scratch(9), scratch(9), scratch(1)
    for k in range(len(cells)):
        count = node_count_of(cells[k])
        gather(moves, cells[k, :count], U)
        for q in range(gradients.shape[1]):
            G = of_nodes(rest_gradients[k, q], count)
            deform(U, G, F)
            invert_transposed(F, T, thin)
            transform_gradients(G, T, gradients[k, q])


class StrainRateDamping(Elements):
    """Force term of the viscosity of a deformable body, of elements of any shape.

    Until the first step begins, and if it takes infinitely long, there is no force.

    Attributes:
        beta: β [s].
    """

    is_traceable = True
    remembers_start = True
    has_energy = False

    def __init__(self, mesh, free_index: np.ndarray, material: LameParameters, beta: float):
        """Prepare the elements.

        Args:
            mesh: The body at rest, a `CellMesh`.
            free_index: Unknown of each node, -1 where it is fixed, shape (node_count,).
            material: Lamé's constants of the body's elasticity [Pa].
            beta: Viscosity over elastic constant, β [s], not negative.
        """
        super().__init__(mesh, free_index, Corotational(*material))
        # The elastic term watches folds.
        self._corners, self.fold_barrier = no_corners(), None
        self._law_at_start = SmallDisplacement(*material)
        self._at_start = assembly_of(SmallDisplacement)
        self.name = "strain-rate damping"
        self.beta = float(beta)

    def bind(self, elimination_rank: np.ndarray, slots) -> None:
        """Lay out the elements, and allocate the memory of a step."""
        self._reference = self.mesh.node_positions.copy()
        super().bind(elimination_rank, slots)
        self._rest_gradients, self._volumes = self._gradients, self._weights
        self._gradients = self._rest_gradients.copy()
        self._no_rotations = np.zeros((*self._volumes.shape[:2], 0))
        self._weights, self._rate = np.zeros_like(self._volumes), 0.0
        if self.hourglass is not None:
            self.hourglass.scale[0] = 0.0

    def begin_step(self, positions: np.ndarray, velocities: np.ndarray, time_step: float) -> None:
        """Take the shape at the beginning of the step as the stress-free one.

        Args:
            positions: Node positions q₀ [m], shape (node_count, 3).
            velocities: Not needed.
            time_step: h [s].
        """
        moves = positions - self.mesh.node_positions
        _begin_all(moves, self._cells, self._rest_gradients, self._gradients)
        rate = self.beta / time_step
        if rate != self._rate:
            np.multiply(self._volumes, rate, out=self._weights)
            self._rate = rate
        self._reference[:] = positions
        if self.hourglass is not None:
            self.hourglass.scale[0] = rate
            self.hourglass.start[:] = self.hourglass.strains_at(positions)
        self._forget()

    def add(self, positions, forces, storage, projected: bool) -> None:
        """See `Elements`; where the step begins there is no force, and no rotation to be found."""
        if not are_same(positions, self._reference):
            super().add(positions, forces, storage, projected)
            return
        self._forget()
        self.run_parts(
            self._at_start.add_stiffness, self._law_at_start, self._cells, self._gradients, self._weights, projected,
            self.deformations, self._no_rotations, self._uprights, self._offsets, self._strides,
            self._are_contiguous, storage,
        )  # fmt: skip
        if self.hourglass is not None:
            self.hourglass.take(positions)
            self._add_hourglass_stiffness(storage, projected)

    def knows(self, positions: np.ndarray) -> bool:
        """See `ForceTerm.knows`; where the step begins nothing has to be known."""
        return are_same(positions, self._reference) or super().knows(positions)

    def add_forces(self, positions: np.ndarray, forces: np.ndarray) -> int:
        """Add -V R σ g_a [N] to the forces on the unknowns.

        Args:
            positions: Node positions q [m], shape (node_count, 3), including fixed and guided ones,
                whose displacement in the step strains their elements.
            forces: Forces on the unknowns [N], shape (free_node_count, 3); added to.

        Returns:
            0: inverted elements are counted by the elastic term.
        """
        super().add_forces(positions, forces)
        return 0

    def energy(self, positions: np.ndarray) -> float:
        """No energy is stored [J]; see `heat`."""
        return 0.0

    def heat(self, positions: np.ndarray) -> float:
        """Energy that a step to these positions turns into heat [J], never negative.

        Args:
            positions: Node positions q [m], shape (node_count, 3).
        """
        return 2.0 * super().energy(positions)
