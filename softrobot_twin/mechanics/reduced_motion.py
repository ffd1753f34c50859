"""Inertia and damping of a body in the coordinates of a basis.

The mass of the coordinates is M = Φᵀ M Φ with M of all nodes: the same at all states, so a step
multiplies by a small matrix. Terms of motion are those of nodes (`inertia.py`),

    f = -c M ((q - q₀)/h - v₀),    -∂f/∂q = c M / h,

with c = w/h for inertia, and c = α, v₀ = 0 for mass damping.

Strain-rate damping is that of `strain_rate_damping.py` at the sampled points: with F₀ where the step
begins, F₁ F₀⁻¹ = 1 + G' (q - q₀), where row i of G' is row i of G times F₀⁻¹, and the corotational law
with constants β/h times the elastic ones. So it damps the stiffness that these points have, a rigid
motion has no force, and the heat is never negative.

Arguments of the kernels here:
    matrix: M [kg], shape (mode_count, mode_count).
    nodes, unknowns: Nodes whose positions are the coordinates, and their unknowns, shape (count,).
    speeds: Memory, shape (count, 3).
    start, start_velocities: q₀ [m] and v₀ [m/s], shape (count, 3).
    storage: The factorization's storage [N/m]; added to.
    x: Node positions [m], shape (node_count, 3).
"""

from __future__ import annotations

import numpy as np

from softrobot_twin.geometry.vector_arrays import gather_vectors, write_differences
from softrobot_twin.kernels.compilation import KERNEL, njit
from softrobot_twin.mechanics.element_batches import BATCH, at, scratch
from softrobot_twin.mechanics.force_term import InertiaTerm
from softrobot_twin.mechanics.inertia import RememberedNodes
from softrobot_twin.mechanics.laws.corotational import Corotational
from softrobot_twin.mechanics.material import LameParameters
from softrobot_twin.mechanics.reduced_elements import (
    PointGradients,
    ReducedElements,
    deform_points,
)
from softrobot_twin.mechanics.stencil import add_stencil_matrix, bind_stencils
from softrobot_twin.mechanics.strain_rate_damping import invert_transposed


@njit(**KERNEL)
def _subtract_pulls(x, nodes, unknowns, matrix, start, start_velocities, per_second, rate, speeds, forces):
    """f -= c M ((x - x₀)/h - v₀), with 1/h as `per_second` and c as `rate`."""
    for k in range(len(nodes)):
        for i in range(3):
            speed = (x[nodes[k], i] - start[k, i]) * per_second
            speeds[k, i] = rate * (speed - start_velocities[k, i])
    for k in range(len(nodes)):
        for i in range(3):
            pull = 0.0
            for n in range(len(nodes)):
                for j in range(3):
                    pull += matrix[3 * k + i, 3 * n + j] * speeds[n, j]
            forces[unknowns[k], i] -= pull


@njit(**KERNEL)
def _add_multiple(order, offsets, strides, matrix, factor, storage):
    """Add a multiple of M to the system matrix; see `add_stencil_matrix`."""
    add_stencil_matrix(order, offsets, strides, factor * matrix, storage)


class ReducedMasses(RememberedNodes):
    """Force term of a mass matrix of coordinates, whose state where the step begins is remembered.

    Attributes:
        matrix: M [kg], shape (mode_count, mode_count).
        rate: c [1/s].
    """

    is_traceable = True
    rate: float

    def __init__(self, nodes: np.ndarray, unknowns: np.ndarray, matrix: np.ndarray):
        """Take the mass.

        Args:
            nodes: Nodes whose positions are the coordinates, shape (mode_count / 3,).
            unknowns: Their unknowns, same shape.
            matrix: M [kg], symmetric and positive definite, shape (mode_count, mode_count).
        """
        super().__init__(nodes, unknowns)
        self.matrix = np.array(matrix, dtype=float)
        self._stencils = self._unknowns[None]
        self._speeds = np.empty_like(self._start)

    def bind(self, elimination_rank: np.ndarray, slots) -> None:
        """Find the places of the matrix; see `ForceTerm.bind`."""
        bound = bind_stencils(self._stencils, elimination_rank, slots)
        self._bound = tuple(field[0] for field in bound)

    def add_forces(self, positions: np.ndarray, forces: np.ndarray) -> int:
        """Add -c M ((q - q₀)/h - v₀) [N]; see `ForceTerm.add_forces`. It inverts no element."""
        _subtract_pulls(
            positions, self._nodes, self._unknowns, self.matrix, self._start,
            self._start_velocities, self._per_second, self.rate, self._speeds, forces,
        )  # fmt: skip
        return 0

    def add_stiffness(self, positions, storage, projected: bool) -> None:
        """Add c M / h; see `ForceTerm.add_stiffness`."""
        _add_multiple(*self._bound, self.matrix, self.rate * self._per_second, storage)


class ReducedInertia(ReducedMasses, InertiaTerm):
    """Force term -M w ((q - q₀)/h - v₀)/h of a body in the coordinates of a basis."""

    name = "reduced inertia"
    is_traceable = True

    @property
    def rate(self) -> float:
        """w/h [1/s]."""
        return self._per_second * self.weight

    def add_accelerations(self, positions, forces, accelerations) -> None:
        """Add M⁻¹ f; see `InertiaTerm`."""
        own = np.linalg.solve(self.matrix, forces[self._unknowns].ravel())
        accelerations[self._unknowns] += own.reshape(-1, 3)

    def kinetic_energy(self, positions: np.ndarray, velocities: np.ndarray) -> float:
        """½ vᵀ M v [J]; see `ForceTerm.kinetic_energy`."""
        own = velocities[self._unknowns].ravel()
        return float(0.5 * own @ self.matrix @ own)


class ReducedMassDamping(ReducedMasses):
    """Force term -α M (q - q₀)/h of a body in the coordinates of a basis.

    Attributes:
        rate: α [1/s].
    """

    name = "reduced mass damping"
    is_traceable = True

    def __init__(self, nodes: np.ndarray, unknowns: np.ndarray, matrix: np.ndarray, rate: float):
        """Take mass and rate.

        Args:
            nodes: See `ReducedMasses`.
            unknowns: See there.
            matrix: M [kg], see there.
            rate: α [1/s], not negative.
        """
        super().__init__(nodes, unknowns, matrix)
        self.rate = float(rate)

    def begin_step(self, positions: np.ndarray, velocities: np.ndarray, time_step: float) -> None:
        """Remember the positions; the drag is that of the velocity at the end of the step."""
        super().begin_step(positions, np.zeros_like(velocities), time_step)


@njit(**KERNEL)
def _begin_points(rest_gradients, deformations, weights, stiffness, gradients, scaled):
    """G' of all points, and its rows times √(2µ w).

    Args:
        rest_gradients: G, shape (batch_count, 9, BATCH, mode_count).
        deformations: F₀, shape (batch_count, 9 × BATCH).
        weights: w of the points [m³/s], shape (batch_count, BATCH).
        stiffness: 2µ [Pa].
        gradients: Takes G', the shape of `rest_gradients`.
        scaled: Takes the scaled rows, same shape.
    """
    T, thin = scratch(9), scratch(1)
    for k in range(len(weights)):
        invert_transposed(deformations[k], T, thin)
        for e in range(BATCH):
            size = np.sqrt(stiffness * weights[k, e])
            for i in range(3):
                for j in range(3):
                    a, b, c = T[at(3 * j, e)], T[at(3 * j + 1, e)], T[at(3 * j + 2, e)]
                    x, y, z = (rest_gradients[k, 3 * i, e], rest_gradients[k, 3 * i + 1, e],
                               rest_gradients[k, 3 * i + 2, e])  # fmt: skip
                    row, scaled_row = gradients[k, 3 * i + j, e], scaled[k, 3 * i + j, e]
                    for m in range(len(row)):
                        value = a * x[m] + b * y[m] + c * z[m]
                        row[m] = value
                        scaled_row[m] = size * value


class ReducedStrainRateDamping(ReducedElements):
    """Force term of the viscosity of a body in the coordinates of a basis.

    Until the first step begins, and if it takes infinitely long, there is no force.
    """

    is_traceable = True
    remembers_start = True

    def __init__(
        self, sampled: PointGradients, material: LameParameters, beta: float,
        coordinate_nodes: np.ndarray, free_index: np.ndarray,
    ):  # fmt: skip
        """Lay out the points.

        Args:
            sampled: Gradients and weights of the points.
            material: Lamé's constants of the body's elasticity [Pa].
            beta: β [s].
            coordinate_nodes: See `ReducedElements`.
            free_index: See there.
        """
        super().__init__(sampled, Corotational(*material), coordinate_nodes, free_index)
        self.name, self._beta = "reduced strain-rate damping", float(beta)
        self._rest_gradients, self._volumes = self.gradients.copy(), self._weights.copy()
        self._rest_rows = self._rest_gradients.reshape(self._rows.shape)
        self._scaled, self._started = np.empty_like(self._rows), np.zeros_like(self._coordinates)
        self._start = self._started[: self._at_nodes.size].reshape(-1, 3)
        self._moves = np.zeros_like(self._coordinates)
        self._weights[:] = self._constant[:] = 0.0
        if self._hourglass is not None:
            self._hourglass.scale[0] = 0.0

    def begin_step(self, positions: np.ndarray, velocities: np.ndarray, time_step: float) -> None:
        """Take the shape at the beginning of the step as the stress-free one."""
        gather_vectors(positions, self._nodes, self._start)
        deform_points(self._rest_rows, self._started, self.deformations.reshape(-1))
        np.multiply(self._volumes, self._beta / time_step, out=self._weights)
        _begin_points(
            self._rest_gradients, self.deformations, self._weights, 2.0 * self.law.shear_modulus,
            self.gradients, self._scaled.reshape(self.gradients.shape),
        )  # fmt: skip
        self._constant[:] = self._scaled.T @ self._scaled
        if self._hourglass is not None:
            self._hourglass.begin(self._started, self._beta / time_step)
        self._coordinates[: self.mode_count] = np.nan

    def _moved(self) -> np.ndarray:
        """See `ReducedElements`; from where the step begins."""
        own = self._moves[: self._at_nodes.size].reshape(-1, 3)
        write_differences(self._at_nodes, self._start, own)
        return self._moves

    def add_forces(self, positions: np.ndarray, forces: np.ndarray) -> int:
        """Add the forces; inverted points are counted by the elastic term."""
        super().add_forces(positions, forces)
        return 0

    def energy(self, positions: np.ndarray) -> float:
        """No energy is stored [J]."""
        return 0.0
