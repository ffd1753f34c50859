"""Elements of a body in the coordinates of a basis: few quadrature points stand for all.

With modes Φ the displacement of node a is u_a = Φ_a q, and at a point

    F = 1 + G q,        G = Σ_a Φ_a ∇N_aᵀ,   shape (9, mode_count),
    f = -Σ w Gᵀ P(F),   K = Σ w Gᵀ (∂P/∂F) G,

with weights w that are those of the quadrature times what energy-conserving sampling gives. Any law
is evaluated as in whole elements, in the same batches of points. All points with their own weights
are Galerkin's projection of the full model.

The derivative ∂P/∂F of the corotational law is 2µ on the diagonal, a matrix of rank one and another
of rank three (`corotational.py`), so K is a constant and two products of few rows.

Where points are sampled, G is rounded to single precision: half the memory is read, and the sampling
is less exact by orders. Forces remain the exact derivatives of an energy, since sums of F and of
forces are in double precision; only the products of rows are in single precision too.

Arguments of the kernels here; those of one batch have no first axis:
    C: ∂P/∂F of a batch, shape (81 × BATCH,).
    M: A matrix, three rows of three numbers.
    changes, gradients: w C G and G [1/m], shape (batch_count, 9, BATCH, mode_count).
    rows: Rows of all points, shape (row_count, mode_count).
    v: A change of F, nine numbers.
    weights: Of the points [m³], shape (batch_count, BATCH).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import numpy as np

from softrobot_twin.geometry.cell_mesh import CellBlock, points_of
from softrobot_twin.geometry.matrix3 import product, transposed_product
from softrobot_twin.geometry.shape_functions import MEAN_HEXAHEDRON, hourglass_fields
from softrobot_twin.geometry.vector_arrays import gather_vectors, multiply_transposed
from softrobot_twin.kernels.compilation import KERNEL, ONCE, UNCACHED, njit
from softrobot_twin.mechanics.compression_watch import CompressionWatch, coarseness
from softrobot_twin.mechanics.element_assembly import (
    fill_derivatives,
    find_negative,
    find_state,
    is_of_package,
    linearize_all,
    linearized_rows,
    project_all,
    seen_by_law,
    weighted_stresses,
)
from softrobot_twin.mechanics.element_batches import (
    BATCH,
    at,
    matrix_at,
    put_vector,
    scratch,
    vector_at,
)
from softrobot_twin.mechanics.force_term import ForceTerm
from softrobot_twin.mechanics.laws.corotational import Corotational
from softrobot_twin.mechanics.laws.corotational import linearize as spin_stiffness
from softrobot_twin.mechanics.material import LameParameters
from softrobot_twin.mechanics.point_law import (
    energy_density,
    law_at,
    law_of,
    law_projects,
    law_turns,
)
from softrobot_twin.mechanics.reduced_hourglass import HourglassRows, ReducedHourglass
from softrobot_twin.mechanics.row_sums import WIDTH, add_squares, row_sums
from softrobot_twin.mechanics.stencil import add_stencil_matrix, bind_stencils
from softrobot_twin.mechanics.strain_watch import extreme_squares

# Modes are padded by empty ones to a multiple of this: vector instructions take 48 modes in less
# time than 45.
LANES = WIDTH
# Strain by which the stiffness of a law at rest is measured.
SMALL_STRAIN = 1.0e-4


class SampledPoints(NamedTuple):
    """Quadrature points of a body that stand for all.

    Attributes:
        cells: Cell of each by `CellBlock.numbers`, in rising order, shape (count,).
        points: Which of the cell's quadrature points it is, shape (count,).
        weights: What its volume is multiplied by, positive, shape (count,).
    """

    cells: np.ndarray
    points: np.ndarray
    weights: np.ndarray


def all_points(block: CellBlock) -> SampledPoints:
    """All quadrature points of a block of cells, by their own volumes.

    Args:
        block: The cells.
    """
    points = points_of(block.mesh)
    cell_count, point_count = points.weights.shape
    return SampledPoints(
        np.repeat(block.numbers, point_count), np.tile(np.arange(point_count), cell_count),
        np.ones(cell_count * point_count),
    )  # fmt: skip


class PointGradients(NamedTuple):
    """What sampled points of one law need.

    Attributes:
        gradients: G of each point [1/m], entries of F row by row, shape (count, 9, mode_count).
        weights: Its volume times its weight [m³], shape (count,).
        are_all: Whether they are all points of the body, by their own volumes.
        hourglass: Rows of the other motions of hexahedra; None for other cells.
    """

    gradients: np.ndarray
    weights: np.ndarray
    are_all: bool = False
    hourglass: HourglassRows | None = None


def point_gradients(block: CellBlock, sampled: SampledPoints, basis: np.ndarray) -> PointGradients:
    """Gradients of the sampled points that are in a block of cells.

    Args:
        block: The cells; their mesh has the nodes of the body, numbered from 0.
        sampled: The points of the body; those of other cells are left out.
        basis: Φ, shape (node_count, 3, mode_count).
    """
    order, cells = np.argsort(block.numbers), block.mesh.cells
    position = np.searchsorted(block.numbers, sampled.cells, sorter=order)
    found = order[np.minimum(position, len(order) - 1)]
    own = np.flatnonzero(block.numbers[found] == sampled.cells)
    place, q, mode_count = found[own], sampled.points[own], basis.shape[2]
    gradients, weights = np.empty((len(own), 9, mode_count)), sampled.weights[own]
    are_all = bool((weights == 1.0).all()) and (
        len(own) == len(cells) * points_of(block.mesh, order[:1]).weights.size)
    for first in range(0, len(own), 2048):  # bounds the memory of nodes times modes
        some = slice(first, first + 2048)
        points, rows = points_of(block.mesh, place[some]), np.arange(len(place[some]))
        G = np.einsum(
            "paj,paim->pijm", points.gradients[rows, q[some]], basis[cells[place[some]]])
        gradients[some] = G.reshape(-1, 9, mode_count)
        weights[some] *= points.weights[rows, q[some]]
    hourglass = None
    if block.mesh.shape_functions is MEAN_HEXAHEDRON:
        means = points_of(block.mesh, place).gradients[:, 0]
        fields = hourglass_fields(block.mesh.node_positions[cells[place]], means)
        vectors = np.einsum("pia,pacm->picm", fields.gammas, basis[cells[place]])
        rows = vectors.reshape(len(place), -1, mode_count)
        hourglass = HourglassRows(rows, fields, sampled.weights[own])
    return PointGradients(gradients, weights, are_all, hourglass)


# --- loops over points ---------------------------------------------------------------------------


def find_stresses(law, deformations, weights, rotations, uprights, stresses):
    """w P at all points, and what the state of each is.

    Args:
        law: Parameters of the law.
        deformations: F, shape (batch_count, 9 × BATCH).
        weights: w [m³], zero beyond the last point, shape (batch_count, BATCH).
        rotations: R; written where the law turns, shape (batch_count, 9 × BATCH).
        uprights: 1.0 where a point is upright, else 0.0; written, shape (batch_count, BATCH).
        stresses: Takes w P [N m], shape (batch_count, 9 × BATCH).

    Returns:
        Number of points that are flat or inside out.
    """
    inverted_count = 0
    for k in range(len(weights)):
        find_state(law, deformations[k], rotations[k], uprights[k])
        weighted_stresses(
            law, k, 0, weights[k], deformations[k], rotations[k], stresses[k]
        )
        for e in range(BATCH):
            if weights[k, e] > 0.0 and uprights[k, e] <= 0.0:
                inverted_count += 1
    return inverted_count


def sum_energies(law, deformations, weights, rotations, uprights):
    """Energy of all points [J]; see `find_stresses`."""
    total = 0.0
    for k in range(len(weights)):
        find_state(law, deformations[k], rotations[k], uprights[k])
        for e in range(BATCH):
            if weights[k, e] > 0.0:
                V = seen_by_law(law, deformations[k], rotations[k], e)
                total += weights[k, e] * energy_density(law_at(law, k, 0, e), V)
    return total


def write_stress_changes(law, deformations, weights, rotations, uprights, projected, gradients, changes):
    """w (∂P/∂F) G at all points.

    Args:
        law, deformations, weights, rotations, uprights: See `find_stresses`, which has been called.
        projected: True for positive semidefinite derivatives.
        gradients: G, shape (batch_count, 9, BATCH, mode_count).
        changes: Written, same shape.
    """
    L, C = scratch(3 * len(linearized_rows(law))), scratch(81)
    factor, negative = scratch(81), scratch(1)
    is_tested = projected and not law_projects(law)
    for k in range(len(weights)):
        F, R = deformations[k], rotations[k]
        linearize_all(law, k, 0, F, R, uprights[k], projected, L)
        fill_derivatives(law, k, 0, L, C)
        if is_tested:
            find_negative(C, factor, negative)
            project_all(law, k, 0, weights[k], negative, F, R, L, C)
        if law_turns(law):
            _turn_derivatives(R, C)
        _apply_to_gradients(C, weights[k], gradients[k], changes[k])


@njit(**ONCE)
def _turn_derivatives(R, C):
    """From dP Rᵀ by dF Rᵀ to dP by dF: C_{ik,jl} ← Σ C_{im,jn} R_mk R_nl."""
    for e in range(BATCH):
        turn = matrix_at(R, 0, e)
        for i in range(3):
            for j in range(3):
                first = 9 * i + j
                block = (
                    vector_at(C, first, e), vector_at(C, first + 3, e), vector_at(C, first + 6, e)
                )  # fmt: skip
                turned = transposed_product(turn, product(block, turn))
                for k in range(3):
                    put_vector(C, first + 3 * k, e, turned[k])


@njit(**ONCE)
def _apply_to_gradients(C, weights, gradients, changes):
    """w C G of one batch."""
    for i in range(9):
        for e in range(BATCH):
            line = changes[i, e]
            line[:] = 0.0
            for j in range(9):
                factor = weights[e] * C[at(9 * i + j, e)]
                row = gradients[j, e]
                for m in range(len(line)):
                    line[m] += factor * row[m]


@njit(**ONCE)
def _lower_cholesky(M):
    """L of M = L Lᵀ of a 3×3 matrix that is positive semidefinite but for rounding."""
    tiny = 1.0e-30
    l00 = math.sqrt(max(M[0][0], tiny))
    l10, l20 = M[1][0] / l00, M[2][0] / l00
    l11 = math.sqrt(max(M[1][1] - l10 * l10, tiny))
    l21 = (M[2][1] - l20 * l10) / l11
    l22 = math.sqrt(max(M[2][2] - l20 * l20 - l21 * l21, tiny))
    return l00, l10, l11, l20, l21, l22


@njit(**KERNEL)
def write_spin_rows(law, root, deformations, weights, rotations, uprights, projected, spin_rows, signs):
    """Rows √λ R and v of ∂P/∂F = 2µ 1 + λ R Rᵀ - Σ s v vᵀ of the corotational law, times √w.

    The spin stiffness M = c G⁻¹ gives dF : dP a part -wᵀ M w with w the axial vector of dF Rᵀ:
    with M = s L Lᵀ, v are the three components of Lᵀ w.

    Args:
        law, deformations, weights, rotations, uprights, projected: See `write_stress_changes`.
        root: √λ of Lamé [√Pa].
        spin_rows: Takes √λ R, then v, shape (batch_count, BATCH, 4, 9).
        signs: Takes s of each point, 1 or -1, shape (batch_count, BATCH).
    """
    for k in range(len(weights)):
        for e in range(BATCH):
            R = matrix_at(rotations[k], 0, e)
            V = seen_by_law(law, deformations[k], rotations[k], e)
            M = spin_stiffness(law, V, uprights[k, e] > 0.0, projected)
            sign = 1.0 if M[0][0] + M[1][1] + M[2][2] >= 0.0 else -1.0
            size = sign * weights[k, e]
            M = ((size * M[0][0], 0.0, 0.0), (size * M[1][0], size * M[1][1], 0.0),
                 (size * M[2][0], size * M[2][1], size * M[2][2]))  # fmt: skip
            l00, l10, l11, l20, l21, l22 = _lower_cholesky(M)
            signs[k, e] = sign
            v, stretched = spin_rows[k, e, 1:], root * math.sqrt(weights[k, e])
            for i in range(9):
                spin_rows[k, e, 0, i] = stretched * rotations[k, at(i, e)]
            for j in range(3):
                # w = (A₂₁ - A₁₂, A₀₂ - A₂₀, A₁₀ - A₀₁) with A = dF Rᵀ.
                v[0, j] = l10 * R[2][j] - l20 * R[1][j]
                v[0, 3 + j] = l20 * R[0][j] - l00 * R[2][j]
                v[0, 6 + j] = l00 * R[1][j] - l10 * R[0][j]
                v[1, j] = l11 * R[2][j] - l21 * R[1][j]
                v[1, 3 + j] = l21 * R[0][j]
                v[1, 6 + j] = -l11 * R[0][j]
                v[2, j] = -l22 * R[1][j]
                v[2, 3 + j] = l22 * R[0][j]
                v[2, 6 + j] = 0.0


FAST = {**KERNEL, "fastmath": True}
"""Options of sums that vector instructions may take in another order."""


@njit(**FAST)
def deform_points(gradients, coordinates, deformations):
    """F = 1 + G q of all points; see `find_stresses`.

    Args:
        gradients: G in the order of the batches, shape (batch_count × 9 × BATCH, mode_count).
        coordinates: q [m], shape (mode_count,).
        deformations: Written, shape (batch_count × 9 × BATCH,).
    """
    for row in range(len(gradients)):
        total = 0.0
        for m in range(len(coordinates)):
            total += gradients[row, m] * coordinates[m]
        deformations[row] = total
    for k in range(len(gradients) // (9 * BATCH)):
        for i in range(0, 9, 4):
            for e in range(BATCH):
                deformations[9 * BATCH * k + at(i, e)] += 1.0


@njit(**FAST)
def sum_forces(gradients, stresses, forces):
    """Gᵀ w P summed over all points.

    Args:
        gradients: See `deform_points`.
        stresses: w P in the same order, shape (batch_count × 9 × BATCH,).
        forces: Written [N], shape (mode_count,).
    """
    forces[:] = 0.0
    for row in range(0, len(gradients), 4):
        a, b, c, d = stresses[row], stresses[row + 1], stresses[row + 2], stresses[row + 3]
        for m in range(len(forces)):
            forces[m] += (
                a * gradients[row, m] + b * gradients[row + 1, m]
                + c * gradients[row + 2, m] + d * gradients[row + 3, m]
            )  # fmt: skip


@njit(**KERNEL)
def are_known(positions, nodes, coordinates):
    """Whether coordinates are those of a state.

    Args:
        positions: Node positions [m], shape (node_count, 3).
        nodes: Nodes whose positions are the coordinates, shape (count,).
        coordinates: The coordinates [m], shape (3 count or more,).
    """
    for n in range(len(nodes)):
        for i in range(3):
            if positions[nodes[n], i] != coordinates[3 * n + i]:
                return False
    return True


@njit(**KERNEL)
def subtract_forces(own, unknowns, forces):
    """Subtract forces on coordinates from those on unknowns.

    Args:
        own: Of the coordinates [N], shape (3 count or more,).
        unknowns: Unknowns that three coordinates each are, shape (count,).
        forces: Of the unknowns [N], shape (free_node_count, 3); changed.
    """
    for n in range(len(unknowns)):
        for i in range(3):
            forces[unknowns[n], i] -= own[3 * n + i]


_one_row, _three_rows = row_sums(1), row_sums(3)


@njit(**KERNEL)
def sum_spin_rows(spin_rows, signs, gradients, constant, rows, squares, stiffness):
    """The stiffness of the corotational law.

    Args:
        spin_rows, signs: See `write_spin_rows`.
        gradients: G, shape (batch_count, 9, BATCH, mode_count).
        constant: Its constant part [N/m], shape (mode_count, mode_count).
        rows: Memory for the rows times G of one batch: those of √λ R, then three for each v, shape
            (4 × BATCH, mode_count).
        squares: Memory for the products of the two kinds, shape (2, mode_count, mode_count).
        stiffness: Takes the sum [N/m], same shape as `constant`.
    """
    n = len(constant)
    squares[:] = 0.0
    for k in range(len(signs)):
        for e in range(BATCH):
            own = 36 * (BATCH * k + e)
            for m in range(0, n, WIDTH):
                b, b_step = (9 * BATCH * k + e) * n + m, BATCH * n
                _one_row(9, spin_rows, own, 9, 1, gradients, b, b_step, rows, e * n + m, n, 0)
                own_rows = (BATCH + 3 * e) * n + m
                _three_rows(9, spin_rows, own + 9, 9, 1, gradients, b, b_step, rows, own_rows, n, 0)
            if signs[k, e] < 0.0:
                # Added where it is subtracted below with all others, and once more.
                add_squares(BATCH + 3 * e, 3, rows, squares[0])
                add_squares(BATCH + 3 * e, 3, rows, squares[0])
        add_squares(0, BATCH, rows, squares[0])
        add_squares(BATCH, 3 * BATCH, rows, squares[1])
    for i in range(n):
        for j in range(i + 1):
            stiffness[i, j] = constant[i, j] + (squares[0, i, j] - squares[1, i, j])
            stiffness[j, i] = stiffness[i, j]


class ReducedAssembly(NamedTuple):
    """The loops over points, compiled for a law when they are first called.

    Attributes:
        find_stresses: See the function of this name; so the others.
        sum_energies: Energy.
        write_stress_changes: Derivatives of stresses along the basis.
    """

    find_stresses: Callable
    sum_energies: Callable
    write_stress_changes: Callable


@cache
def reduced_assembly_of(parameters: type) -> ReducedAssembly:
    """The loops for a law; see `element_assembly.assembly_of`.

    Args:
        parameters: The type of the law's parameters.
    """
    options = KERNEL if is_of_package(parameters) else UNCACHED
    loops = (find_stresses, sum_energies, write_stress_changes)
    return ReducedAssembly(*(njit(**options)(loop) for loop in loops))


# --- the term ------------------------------------------------------------------------------------


class ReducedElements(ForceTerm):
    """Force term of the sampled points of one law, in the coordinates of a basis.

    The forces of the last state are stored, with F and R of each point, and are reused as long as
    the coordinates are the same to the bit.

    Attributes:
        law: Parameters of the law.
        point_count: Number of sampled points.
        mode_count: Number of coordinates.
        compression_watch: See `Elements`.
    """

    is_traceable = True
    compression_watch: CompressionWatch | None = None

    def __init__(
        self, sampled: PointGradients, law: tuple, coordinate_nodes: np.ndarray,
        free_index: np.ndarray,
    ):  # fmt: skip
        """Lay out the points.

        Args:
            sampled: Gradients and weights of the points.
            law: Parameters of a registered law.
            coordinate_nodes: Nodes whose positions are the coordinates, three each,
                shape (mode_count / 3,).
            free_index: Unknown of each node, shape (node_count,).
        """
        self.law, kind = law, law_of(law)
        self.name = f"reduced {kind.name} elements"
        self.stays_upright = not (kind.turns or kind.is_linear)
        self._nodes = np.asarray(coordinate_nodes, np.int64)
        self._unknowns = np.asarray(free_index)[self._nodes]
        self._stencils = self._unknowns[None]
        count, _, modes = sampled.gradients.shape
        self.point_count, self.mode_count = count, modes
        batch_count = max(1, -(-count // BATCH))
        precision = float if sampled.are_all else np.float32
        self._width = LANES * -(-modes // LANES)
        padded = np.zeros((batch_count * BATCH, 9, self._width), precision)
        padded[:count, :, :modes] = sampled.gradients
        weights = np.zeros(batch_count * BATCH)
        weights[:count] = sampled.weights
        self._weights = weights.reshape(batch_count, BATCH)
        # Rows in the order of the batches: entry after entry, the points side by side.
        by_entry = padded.reshape(batch_count, BATCH, 9, self._width).transpose(0, 2, 1, 3)
        self.gradients = np.ascontiguousarray(by_entry)
        self._rows = self.gradients.reshape(-1, self._width)
        shape = (batch_count, 9 * BATCH)
        self.deformations, self._stresses = np.empty(shape), np.empty(shape)
        self._rotations = np.zeros(shape)
        self._uprights = np.ones((batch_count, BATCH))
        self._assembly = reduced_assembly_of(type(law))
        self._coordinates, self._forces = np.zeros(self._width), np.empty(self._width)
        self._coordinates[:modes] = np.nan
        self._at_nodes = self._coordinates[: 3 * len(self._nodes)].reshape(-1, 3)
        self._stiffness = np.zeros((self._width, self._width), precision)
        self._inverted_count, self._bound = 0, None
        self._hourglass: ReducedHourglass | None = None
        if sampled.hourglass is not None:
            self._hourglass = ReducedHourglass(
                self.gradients, sampled.hourglass, self._lame_at_rest(), kind.is_linear,
                not self.remembers_start,
            )
        if isinstance(law, Corotational):
            self._lay_out_spin_rows(padded, weights)
        elif kind.is_linear:
            self._evaluate_at(np.zeros(modes))
            self._constant = self.by_matrices(np.empty_like(self.gradients), False)
        else:
            self._changes = np.empty_like(self.gradients)

    def _lame_at_rest(self) -> LameParameters:
        """Lamé's constants of the law at small strains, from energies of a shear and of volumes."""
        size, energies = SMALL_STRAIN, []
        sheared = np.eye(3) + np.outer([size, 0.0, 0.0], [0.0, 1.0, 0.0])
        weights = np.zeros((1, BATCH))
        weights[0, 0] = 1.0
        for F in (sheared, (1.0 + size) * np.eye(3), (1.0 - size) * np.eye(3)):
            states = np.repeat(F.reshape(1, 9, 1), BATCH, axis=2).reshape(1, -1)
            energies.append(self._assembly.sum_energies(
                self.law, states, weights, np.zeros_like(states), np.ones_like(weights)))  # fmt: skip
        mu = 2.0 * energies[0] / size**2
        kappa = (energies[1] + energies[2]) / (9.0 * size**2)
        return LameParameters(kappa - 2.0 * mu / 3.0, mu)

    def _lay_out_spin_rows(self, padded: np.ndarray, weights: np.ndarray) -> None:
        """Allocate what the corotational law needs, and sum its constant part."""
        count, precision = len(weights), padded.dtype
        by_point = padded.reshape(-1, self._width)
        scaled = by_point * np.repeat(np.sqrt(2.0 * self.law.shear_modulus * weights), 9)[:, None]
        self._constant = scaled.T @ scaled
        self._squares = np.empty((2, *self._constant.shape), precision)
        self._spin_rows = np.empty((count // BATCH, BATCH, 4, 9), precision)
        self._signs = np.empty((count // BATCH, BATCH))
        self._products = np.empty((4 * BATCH, self._width), precision)

    def bind(self, elimination_rank: np.ndarray, slots) -> None:
        """Find the places of the stiffness; see `ForceTerm.bind`."""
        bound = bind_stencils(self._stencils, elimination_rank, slots)
        self._bound = tuple(field[0] for field in bound)

    def _moved(self) -> np.ndarray:
        """The coordinates [m], empty ones behind, from where there is no stress, shape (width,)."""
        return self._coordinates

    def _evaluate(self, positions: np.ndarray) -> None:
        """Forces, stresses and states of all points at a state."""
        gather_vectors(positions, self._nodes, self._at_nodes)
        deform_points(self._rows, self._moved(), self.deformations.reshape(-1))
        self._inverted_count = self._assembly.find_stresses(
            self.law, self.deformations, self._weights, self._rotations, self._uprights,
            self._stresses,
        )  # fmt: skip
        sum_forces(self._rows, self._stresses.reshape(-1), self._forces)
        if self._hourglass is not None:
            self._hourglass.add_forces(self._coordinates, self._forces)

    def add_forces(self, positions: np.ndarray, forces: np.ndarray) -> int:
        """Add the forces on the coordinates [N]; see `ForceTerm.add_forces`.

        Returns:
            Number of sampled points that are flat or inside out.
        """
        self._evaluate(positions)
        subtract_forces(self._forces, self._unknowns, forces)
        return self._inverted_count

    def knows(self, positions: np.ndarray) -> bool:
        """Whether the coordinates are the same as those of the stored state, to the bit."""
        return are_known(positions, self._nodes, self._coordinates)

    def add(self, positions, forces, storage, projected: bool) -> None:
        """Add the forces, and the stiffness to the system matrix; see `ForceTerm.add`."""
        if not self.knows(positions):
            self._evaluate(positions)
        subtract_forces(self._forces, self._unknowns, forces)
        _add_to_storage(*self._bound, self.padded_stiffness(projected), storage)

    def stiffness(self, projected: bool) -> np.ndarray:
        """K at the state evaluated last [N/m], shape (mode_count, mode_count).

        Args:
            projected: True for a part of it that is never negative.
        """
        return self.padded_stiffness(projected)[: self.mode_count, : self.mode_count].copy()

    def padded_stiffness(self, projected: bool) -> np.ndarray:
        """The same with empty modes behind.

        Args:
            projected: As for `stiffness`.
        """
        of_points = self._stiffness_of_points(projected)
        if self._hourglass is None:
            return of_points
        return self._hourglass.added_to(of_points, projected)

    def _stiffness_of_points(self, projected: bool) -> np.ndarray:
        if isinstance(self.law, Corotational):
            return self._by_spin_rows(projected)
        if law_of(self.law).is_linear:
            return self._constant
        return self.by_matrices(self._changes, projected)

    def _by_spin_rows(self, projected: bool) -> np.ndarray:
        write_spin_rows(
            self.law, math.sqrt(max(self.law.lame_lambda, 0.0)), self.deformations, self._weights,
            self._rotations, self._uprights, projected, self._spin_rows, self._signs,
        )  # fmt: skip
        sum_spin_rows(
            self._spin_rows, self._signs, self.gradients, self._constant, self._products,
            self._squares, self._stiffness,
        )  # fmt: skip
        return self._stiffness

    def by_matrices(self, changes: np.ndarray, projected: bool) -> np.ndarray:
        """The same of any law, by the derivatives of its stresses along the basis.

        Args:
            changes: Takes these derivatives [Pa], the shape of `gradients`.
            projected: As for `stiffness`.
        """
        self._assembly.write_stress_changes(
            self.law, self.deformations, self._weights, self._rotations, self._uprights, projected,
            self.gradients, changes,
        )  # fmt: skip
        multiply_transposed(self._rows, changes.reshape(-1, self._width), self._stiffness)
        return self._stiffness

    def _evaluate_at(self, coordinates: np.ndarray) -> None:
        positions = np.zeros((int(self._nodes.max()) + 1, 3))
        positions[self._nodes] = coordinates.reshape(-1, 3)
        self._evaluate(positions)

    def point_forces(self, coordinates: np.ndarray) -> np.ndarray:
        """What each point adds to Gᵀ w P [N], shape (point_count, mode_count).

        Args:
            coordinates: q [m], shape (mode_count,).
        """
        self._evaluate_at(np.asarray(coordinates, float))
        batches = self._stresses.reshape(len(self._weights), 9, BATCH, 1)
        forces = (batches * self.gradients).sum(axis=1)
        if self._hourglass is not None:
            forces = forces + self._hourglass.cell_forces()
        return forces.reshape(-1, self._width)[: self.point_count, : self.mode_count]

    def extreme_squares(self, positions: np.ndarray, least: float, greatest: float) -> tuple[float, float]:
        """Squares of the least and greatest principal stretch of the sampled points beyond given
        ones; see `Elements.extreme_squares`."""
        if not self.knows(positions):
            self._evaluate(positions)
        deformations, weights = self.deformations[:, None], self._weights[:, None]
        return extreme_squares(deformations, weights, least, greatest)

    @property
    def has_varied_strain(self) -> bool:
        """See `Elements.has_varied_strain`."""
        return self._hourglass is not None and not law_of(self.law).is_linear

    def coarseness(self, positions: np.ndarray, lame: LameParameters) -> float:
        """See `Elements.coarseness`; of the sampled hexahedra.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            lame: See there.
        """
        if not self.knows(positions):
            self._evaluate(positions)
        own = self._hourglass
        return coarseness(self.deformations, self._weights, own.moduli, own.strains, *lame)

    def energy(self, positions: np.ndarray) -> float:
        """Stored elastic energy [J]; see `ForceTerm.energy`."""
        coordinates, deformations = np.zeros(self._width), np.empty_like(self.deformations)
        coordinates[: self.mode_count] = positions[self._nodes].ravel()
        deform_points(self._rows, coordinates, deformations.reshape(-1))
        energy = self._assembly.sum_energies(
            self.law, deformations, self._weights, np.zeros_like(self._rotations),
            np.empty_like(self._uprights),
        )  # fmt: skip
        return energy if self._hourglass is None else energy + self._hourglass.energy(coordinates)


@njit(**KERNEL)
def _add_to_storage(order, offsets, strides, matrix, storage):
    """Add the matrix of all coordinates; see `add_stencil_matrix`."""
    add_stencil_matrix(order, offsets, strides, matrix, storage)
