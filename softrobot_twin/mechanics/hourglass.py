"""Stiffness of hexahedra against the hour-glass modes, which the mean of their strain does not see.

A hexahedron has one point: the law sees the mean F of its deformation gradient, that of the twelve affine
motions. The other twelve motions of its corners are the hour-glass vectors

    h_i = Σ_a γ_ia x_a,    i = 0 ... 3,    Σ_a γ_ia = 0,    Σ_a γ_ia X_a = 0

which are zero at rest and in every affine motion, and so patch tests are exact. Their energy is

    y_i = F⁻¹ h_i,    E = ½ yᵀ (M - m 1) y + ½ m hᵀ h

M [N/m] is that of small strains: a cell of linear elasticity at rest whose strain is enhanced by the
modes of Wilson and Taylor and two more (`shape_functions.modes`), with these modes eliminated. So a
cell bends as beam theory asks and keeps its volume without locking. No stress of the mean state is in
M. Therefore E is positive whatever the compression, and cells cannot fold into an hour-glass pattern, as
they do where enhanced modes are unknowns and see that stress (Wriggers and Reese 1996).

F⁻¹ measures h by the strained cell, as the logarithmic strain does: a cell that is compressed to half
its length has four times the stiffness of M against bending strain. It is what Neo-Hookean rubber has,
to the third derivative of its energy. In place of F⁻¹ = Cᵀ/J, with the cofactors C of F, stands φ(J) Cᵀ,

    φ = (1 + ε²) J / (J² + ε²)

so that flat and inverted cells have finite forces; there m, a hundredth of the least eigenvalue of M,
is what is left. With g = M y, w = Σ g_i · Cᵀ h_i,
N = Σ h_i g_iᵀ and the bilinear D(A, B) = `cofactor_change`,

    P_i = ∂E/∂h_i = φ C g_i + m h_i,    P = ∂E/∂F = φ' w C + φ D(F, N)

and their differentials are exact. The positive semidefinite part of the stiffness is that without g.
A law of small displacements has y = h.

Viscosity: with y₀ where a step begins, rates have the potential ½ s (y - y₀)ᵀ M (y - y₀). A Prony series
has the potential ½ s yᵀ M y - bᵀ y. Both are one form here. Softening (Mullins) is not taken into
account: h is resisted as by new material.

Sources: Belytschko and Bindeman 1993, Puso 2000, Reese 2005.

Arguments of the kernels here; those of one batch have no first axis:
    C, F, dC, dF: Matrices, shape (9 × BATCH,).
    cells, free: Nodes and unknowns, shape (batch_count, 8, BATCH).
    d, dh, dy, dg, g, h, y: Four vectors of each element, shape (batch_count, 12 × BATCH).
    floor: m [N/m], shape (batch_count, BATCH).
    factors: φ and its first two derivatives, shape (3 × BATCH,).
    gammas: γ_ia [1], vector after vector of four for each node, shape (batch_count, 32 × BATCH).
    gradients: Mean ∇N_a [1/m], shape (batch_count, 24 × BATCH).
    is_linear: Whether the law is that of small displacements.
    moduli: M [N/m], row by row, shape (batch_count, 144 × BATCH).
    moves: Moves of the nodes from rest [m], shape (node_count, 3).
    pull: b [N], shape (batch_count, 12 × BATCH).
    scale: s, shape (1,).
    deformations: F of all cells, shape (batch_count, 9 × BATCH).
    forces: On the unknowns [N], shape (free_node_count, 3).
    start: y₀ [m], shape (batch_count, 12 × BATCH).
    P, dP: P, then the four P_i, shape (21 × BATCH,).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from softrobot_twin.geometry.matrix3 import (
    IDENTITY,
    ZERO,
    add_outer,
    add_scaled_matrix,
    cofactor,
    cofactor_change,
    determinant,
    inner,
    scaled_matrix,
    transform,
    transposed,
)
from softrobot_twin.geometry.shape_functions import HourglassFields
from softrobot_twin.geometry.vector3 import add_scaled, dot, row, scaled, set_row
from softrobot_twin.geometry.vector_arrays import write_differences
from softrobot_twin.kernels.compilation import INNER, KERNEL, ONCE, njit
from softrobot_twin.mechanics.assembly_parts import next_part
from softrobot_twin.mechanics.block_addition import add_blocks, add_contiguous_blocks
from softrobot_twin.mechanics.element_assembly import deform, gather, subtract_forces
from softrobot_twin.mechanics.element_batches import (
    BATCH,
    ElementBatches,
    at,
    in_batches,
    matrix_at,
    of_node,
    put_matrix,
    put_vector,
    scratch,
    vector_at,
)
from softrobot_twin.mechanics.material import LameParameters

VECTORS = 4
"""Hour-glass vectors of a cell."""
CHUNK = 1000
"""Cells whose moduli are found at once: it bounds the memory."""


def hourglass_moduli(fields: HourglassFields, lame: LameParameters) -> np.ndarray:
    """M of cells of one material.

    Args:
        fields: Of the cells.
        lame: Lamé's constants of small strains [Pa].

    Returns:
        [N/m], shape (cell_count, 12, 12).
    """
    found = np.empty((len(fields.gammas), 3 * VECTORS, 3 * VECTORS))
    for first in range(0, len(found), CHUNK):
        some = slice(first, first + CHUNK)
        gradients, weights = fields.gradients[some], fields.weights[some]
        count, _, node_count = gradients.shape[:3]
        scaled_gradients = weights[:, :, None, None] * gradients
        products = np.einsum("kqai,kqbj->kaibj", scaled_gradients, gradients, optimize=True)
        K = lame.lame_lambda * products + lame.shear_modulus * products.transpose(0, 1, 4, 3, 2)
        traces = lame.shear_modulus * np.einsum("kaibi->kab", products)
        for axis in range(3):
            K[:, :, axis, :, axis] += traces
        K = K.reshape(count, 3 * node_count, 3 * node_count)
        own, modes = slice(0, 24), slice(24, 3 * node_count)
        condensed = K[:, own, own] - K[:, own, modes] @ np.linalg.solve(
            K[:, modes, modes], K[:, modes, own]
        )
        # A displacement of the corners that has given hour-glass vectors: by the pseudoinverse of γ.
        inverse = np.linalg.pinv(fields.gammas[some])
        condensed = condensed.reshape(count, 8, 3, 8, 3)
        M = np.einsum("kai,kambn,kbj->kimjn", inverse, condensed, inverse, optimize=True)
        found[some] = M.reshape(count, 3 * VECTORS, 3 * VECTORS)
    return found


FLAT = 0.05
"""ε, volume ratio of a cell that counts as flat."""


# --- at one state --------------------------------------------------------------------------------


@njit(**INNER)
def _measure(U, gammas, h):
    """h of one batch, from the moves of its nodes."""
    h[:] = 0.0
    for a in range(len(U) // (3 * BATCH)):
        moves = of_node(U, a)
        for i in range(VECTORS):
            for e in range(BATCH):
                factor = gammas[at(VECTORS * a + i, e)]
                put_vector(h, i, e, add_scaled(vector_at(h, i, e), vector_at(moves, 0, e), factor))


@njit(**INNER)
def find_state(is_linear, F, C, factors):
    """C and φ of one batch."""
    for e in range(BATCH):
        matrix = matrix_at(F, 0, e)
        J = determinant(matrix)
        below = 1.0 / (J * J + FLAT * FLAT)
        size = (1.0 + FLAT * FLAT) * below
        slope = size * (FLAT * FLAT - J * J) * below
        curvature = 2.0 * size * J * (J * J - 3.0 * FLAT * FLAT) * below * below
        if is_linear:
            put_matrix(C, 0, e, IDENTITY)
            put_vector(factors, 0, e, (1.0, 0.0, 0.0))
        else:
            put_matrix(C, 0, e, cofactor(matrix))
            put_vector(factors, 0, e, (size * J, slope, curvature))


@njit(**INNER)
def strain(C, factors, h, y):
    """y_i = φ Cᵀ h_i."""
    for i in range(VECTORS):
        for e in range(BATCH):
            back = transposed(matrix_at(C, 0, e))
            put_vector(y, i, e, scaled(transform(back, vector_at(h, i, e)), factors[at(0, e)]))


@njit(**INNER)
def _multiply(moduli, y, g):
    """M y."""
    for r in range(3 * VECTORS):
        for e in range(BATCH):
            g[at(r, e)] = moduli[at(3 * VECTORS * r, e)] * y[e]
        for s in range(1, 3 * VECTORS):
            for e in range(BATCH):
                g[at(r, e)] += moduli[at(3 * VECTORS * r + s, e)] * y[at(s, e)]


@njit(**INNER)
def _pull_back(moduli, scale, y, start, pull, d, g):
    """g = s M (y - y₀) - b, and d = y - y₀."""
    for i in range(len(y)):
        d[i] = y[i] - start[i]
    _multiply(moduli, d, g)
    for i in range(len(g)):
        g[i] = scale * g[i] - pull[i]


@njit(**ONCE)
def _sums(C, h, g, e):
    """w and N of one element."""
    N, back = ZERO, transposed(matrix_at(C, 0, e))
    w = 0.0
    for i in range(VECTORS):
        own, force = vector_at(h, i, e), vector_at(g, i, e)
        w += dot(force, transform(back, own))
        N = add_outer(N, own, force)
    return w, N


@njit(**INNER)
def stresses(is_linear, F, C, factors, h, g, floor, P):
    """P of one batch."""
    for e in range(BATCH):
        cofactors = matrix_at(C, 0, e)
        phi, slope, _ = vector_at(factors, 0, e)
        w, N = _sums(C, h, g, e)
        S = scaled_matrix(cofactors, slope * w)
        turned = cofactor_change(matrix_at(F, 0, e), N)
        put_matrix(P, 0, e, add_scaled_matrix(S, turned, 0.0 if is_linear else phi))
    for i in range(VECTORS):
        for e in range(BATCH):
            force = scaled(vector_at(g, i, e), factors[at(0, e)])
            answer = transform(matrix_at(C, 0, e), force)
            put_vector(P, 3 + i, e, add_scaled(answer, vector_at(h, i, e), floor[e]))


@njit(**INNER)
def differentiate(is_linear, F, C, factors, h, g, moduli, scale, floor, dF, dh, dC, dy, dg, dP):
    """The change of P by changes of F and h; dC, dy and dg are memory."""
    for e in range(BATCH):
        phi, slope, _ = vector_at(factors, 0, e)
        cofactors, dA = matrix_at(C, 0, e), matrix_at(dF, 0, e)
        change = cofactor_change(matrix_at(F, 0, e), dA)
        change = scaled_matrix(change, 0.0 if is_linear else 1.0)
        put_matrix(dC, 0, e, change)
        dphi = slope * inner(cofactors, dA)
        # d(φ C)ᵀ h + φ Cᵀ dh
        both = transposed(add_scaled_matrix(scaled_matrix(cofactors, dphi), change, phi))
        back = transposed(cofactors)
        for i in range(VECTORS):
            moved = transform(both, vector_at(h, i, e))
            put_vector(dy, i, e, add_scaled(moved, transform(back, vector_at(dh, i, e)), phi))
    _multiply(moduli, dy, dg)
    for i in range(len(dg)):
        dg[i] *= scale
    for e in range(BATCH):
        phi, slope, curvature = vector_at(factors, 0, e)
        turn = 0.0 if is_linear else 1.0
        cofactors, change, dA = matrix_at(C, 0, e), matrix_at(dC, 0, e), matrix_at(dF, 0, e)
        dJ = inner(cofactors, dA)
        dphi = slope * dJ
        back, dback = transposed(cofactors), transposed(change)
        scaled_change = add_scaled_matrix(scaled_matrix(cofactors, dphi), change, phi)
        w, dw, N, dN = 0.0, 0.0, ZERO, ZERO
        for i in range(VECTORS):
            own, moved = vector_at(h, i, e), vector_at(dh, i, e)
            force, dforce = vector_at(g, i, e), vector_at(dg, i, e)
            z = transform(back, own)
            w += dot(force, z)
            dz = add_scaled(transform(dback, own), transform(back, moved), 1.0)
            dw += dot(dforce, z) + dot(force, dz)
            N = add_outer(N, own, force)
            dN = add_outer(add_outer(dN, moved, force), own, dforce)
            answer = add_scaled(transform(scaled_change, force), moved, floor[e])
            put_vector(dP, 3 + i, e, add_scaled(answer, transform(cofactors, dforce), phi))
        matrix = matrix_at(F, 0, e)
        S = scaled_matrix(cofactors, curvature * dJ * w + slope * dw)
        S = add_scaled_matrix(S, change, slope * w)
        S = add_scaled_matrix(S, cofactor_change(matrix, N), turn * dphi)
        S = add_scaled_matrix(S, cofactor_change(dA, N), turn * phi)
        put_matrix(dP, 0, e, add_scaled_matrix(S, cofactor_change(matrix, dN), turn * phi))


@njit(**INNER)
def _to_node(P, gradients, gammas, a, e):
    """P ∇N_a + Σ P_i γ_ia of one element."""
    force = transform(matrix_at(P, 0, e), vector_at(gradients, a, e))
    for i in range(VECTORS):
        force = add_scaled(force, vector_at(P, 3 + i, e), gammas[at(VECTORS * a + i, e)])
    return force


# --- loops over elements -------------------------------------------------------------------------


@njit(**KERNEL)
def find_strains(is_linear, moves, cells, gradients, gammas, deformations, h, y):
    """F, h and y of all elements.

    Args:
        is_linear, moves, cells, gradients, gammas, h, y: As above; h and y are written.
        deformations: F; written, shape (batch_count, 9 × BATCH).
    """
    U, C, factors = scratch(24), scratch(9), scratch(3)
    for k in range(len(cells)):
        gather(moves, cells[k], U)
        deform(U, gradients[k], deformations[k])
        _measure(U, gammas[k], h[k])
        find_state(is_linear, deformations[k], C, factors)
        strain(C, factors, h[k], y[k])


@njit(**KERNEL)
def add_energies(moduli, scale, floor, h, y, start, pull):
    """Potential of all elements [J]."""
    total, d, g = 0.0, scratch(12), scratch(12)
    for k in range(len(moduli)):
        for i in range(len(d)):
            d[i] = y[k, i] - start[k, i]
        _multiply(moduli[k], d, g)
        for i in range(len(d)):
            total += 0.5 * scale[0] * d[i] * g[i] - pull[k, i] * y[k, i]
            total += 0.5 * floor[k, i % BATCH] * h[k, i] * h[k, i]
    return total


@njit(**KERNEL)
def write_forces(moduli, scale, y, start, pull, g):
    """g of all elements."""
    d = scratch(12)
    for k in range(len(moduli)):
        _pull_back(moduli[k], scale[0], y[k], start[k], pull[k], d, g[k])


@njit(**KERNEL)
def add_forces(
    waits_for_all, state, done, parts, is_linear, free, floor, gradients, gammas, deformations, h, g, forces,
):  # fmt: skip
    """Subtract the internal forces of all elements [N]; see `find_strains` and `write_forces`."""
    C, factors, P, sums = scratch(9), scratch(3), scratch(21), scratch(24)
    part = next_part(-1, parts, waits_for_all, state, done)
    while part < len(parts.begins) - 1:
        for k in parts.batches[parts.begins[part] : parts.begins[part + 1]]:
            find_state(is_linear, deformations[k], C, factors)
            stresses(is_linear, deformations[k], C, factors, h[k], g[k], floor[k], P)
            for a in range(8):
                for e in range(BATCH):
                    put_vector(sums, a, e, _to_node(P, gradients[k], gammas[k], a, e))
            subtract_forces(free[k], sums, forces)
        part = next_part(part, parts, waits_for_all, state, done)


@njit(**KERNEL)
def add_stiffness(
    waits_for_all, state, done, parts, is_linear, moduli, scale, floor, gradients, gammas,
    deformations, h, g, projected, offsets, strides, are_contiguous, storage,
):  # fmt: skip
    """Add the stiffness of all elements.

    Args:
        waits_for_all, state, done, parts: See `assembly_parts.py`.
        is_linear, moduli, scale, floor, gradients, gammas, deformations, h, g: See `add_forces`.
        projected: True for its positive semidefinite part.
        offsets: Place of each block, see `bind_stencils`, shape (batch_count, pair_count, BATCH).
        strides: Distance of its columns, same shape.
        are_contiguous: Whether all blocks are contiguous.
        storage: The factorization's storage [N/m]; added to.
    """
    C, factors, dC, dF = scratch(9), scratch(3), scratch(9), scratch(9)
    dh, dy, dg, K = scratch(12), scratch(12), scratch(12), scratch(9)
    force, dP = scratch(12), np.empty((3, 21 * BATCH))
    part = next_part(-1, parts, waits_for_all, state, done)
    while part < len(parts.begins) - 1:
        for k in parts.batches[parts.begins[part] : parts.begins[part + 1]]:
            F = deformations[k]
            find_state(is_linear, F, C, factors)
            for i in range(len(force)):
                force[i] = 0.0 if projected else g[k, i]
            pair = 0
            for b in range(8):
                for j in range(3):
                    dF[:], dh[:] = 0.0, 0.0
                    for e in range(BATCH):
                        for axis in range(3):
                            dF[at(3 * j + axis, e)] = gradients[k, at(3 * b + axis, e)]
                        for i in range(VECTORS):
                            dh[at(3 * i + j, e)] = gammas[k, at(VECTORS * b + i, e)]
                    differentiate(
                        is_linear, F, C, factors, h[k], force, moduli[k], scale[0], floor[k], dF, dh,
                        dC, dy, dg, dP[j],
                    )  # fmt: skip
                for a in range(b, 8):
                    for j in range(3):
                        for e in range(BATCH):
                            put_vector(K, j, e, _to_node(dP[j], gradients[k], gammas[k], a, e))
                    if are_contiguous:
                        add_contiguous_blocks(offsets[k, pair], K, storage)
                    else:
                        add_blocks(offsets[k, pair], strides[k, pair], K, storage)
                    pair += 1
        part = next_part(part, parts, waits_for_all, state, done)


@njit(**KERNEL)
def add_force_changes(
    is_linear, direction, cells, free, moduli, scale, floor, gradients, gammas, deformations, h, g,
    factor, changes,
):  # fmt: skip
    """Add a factor times the change of the internal forces by moves of all nodes.

    Args:
        is_linear, cells, free, moduli, scale, floor: See `add_forces`.
        gradients, gammas, deformations, h, g: See there.
        direction: The moves [m], shape (node_count, 3).
        factor: The factor.
        changes: Takes the sum [N], shape (free_node_count, 3); added to.
    """
    C, factors, dC, dF = scratch(9), scratch(3), scratch(9), scratch(9)
    U, dh, dy, dg, dP = scratch(24), scratch(12), scratch(12), scratch(12), scratch(21)
    for k in range(len(moduli)):
        gather(direction, cells[k], U)
        deform(U, gradients[k], dF)
        for e in range(BATCH):
            put_matrix(dF, 0, e, add_scaled_matrix(matrix_at(dF, 0, e), IDENTITY, -1.0))
        _measure(U, gammas[k], dh)
        find_state(is_linear, deformations[k], C, factors)
        differentiate(
            is_linear, deformations[k], C, factors, h[k], g[k], moduli[k], scale[0], floor[k], dF, dh,
            dC, dy, dg, dP,
        )  # fmt: skip
        for a in range(8):
            for e in range(BATCH):
                n = free[k, a, e]
                if n >= 0:
                    change = _to_node(dP, gradients[k], gammas[k], a, e)
                    set_row(changes, n, add_scaled(row(changes, n), change, factor))


class Hourglass:
    """What resists the hour-glass modes of hexahedra of one material.

    Attributes:
        scale: s, shape (1,); to be set where it is not 1.
        start: y₀ [m], shape (batch_count, 12 × BATCH); to be set where it is not zero.
        pull: b [N], same shape; so.
        strains: y at the state that was taken last [m], same shape.
        moduli: M - m 1 [N/m], shape (batch_count, 144 × BATCH).
        deformations: F at that state, shape (batch_count, 9 × BATCH).
    """

    def __init__(
        self, node_positions: np.ndarray, fields: HourglassFields, batches: ElementBatches,
        lame: LameParameters, is_linear: bool, has_floor: bool = True,
    ):  # fmt: skip
        """Lay out the cells as their elements.

        Args:
            node_positions: At rest [m], shape (node_count, 3).
            fields: Of the cells.
            batches: Their elements.
            lame: Lamé's constants of small strains [Pa].
            is_linear: Whether the law is that of small displacements.
            has_floor: Whether m is not zero: h itself turns, so it is for elasticity only.
        """
        gammas = np.take_along_axis(fields.gammas, batches.order[:, None, :], axis=2)
        self._gammas = flat_batches(gammas.transpose(0, 2, 1))
        moduli, floor = divided_moduli(hourglass_moduli(fields, lame), has_floor)
        self.moduli, self._floor = flat_batches(moduli), flat_batches(floor)
        self._is_linear, self._rest = is_linear, node_positions
        self._cells, self._free = batches.cells, batches.free
        self._gradients = np.ascontiguousarray(batches.gradients[:, 0])
        self._offsets, self._strides = batches.offsets, batches.strides
        self._moves = np.empty_like(node_positions)
        count = len(self.moduli)
        self.deformations = np.zeros((count, 9 * BATCH))
        self._vectors, self.strains, self._forces, self.start, self.pull = np.zeros(
            (5, count, 3 * VECTORS * BATCH)
        )
        self.scale = np.ones(1)

    def take(self, positions: np.ndarray) -> None:
        """Take a state.

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        write_differences(positions, self._rest, self._moves)
        find_strains(
            self._is_linear, self._moves, self._cells, self._gradients, self._gammas,
            self.deformations, self._vectors, self.strains,
        )  # fmt: skip
        write_forces(
            self.moduli, self.scale, self.strains, self.start, self.pull, self._forces
        )

    def add_forces(self, run: Callable, forces: np.ndarray) -> None:
        """Subtract the internal forces at the state that was taken last.

        Args:
            run: Runs the kernel for all parts: `Elements.run_parts`.
            forces: On the unknowns [N], shape (free_node_count, 3); changed.
        """
        run(
            add_forces, self._is_linear, self._free, self._floor, self._gradients, self._gammas, self.deformations,
            self._vectors, self._forces, forces,
        )  # fmt: skip

    def add_stiffness(self, run: Callable, projected: bool, are_contiguous: bool, storage: np.ndarray) -> None:
        """Add the stiffness at the state that was taken last; see the kernel.

        Args:
            run: See `add_forces`.
            projected: True for its positive semidefinite part.
            are_contiguous: Whether all blocks are contiguous in the storage.
            storage: The factorization's storage [N/m]; added to.
        """
        run(
            add_stiffness, self._is_linear, self.moduli, self.scale, self._floor, self._gradients, self._gammas,
            self.deformations, self._vectors, self._forces, projected, self._offsets,
            self._strides, are_contiguous, storage,
        )  # fmt: skip

    def strains_at(self, positions: np.ndarray) -> np.ndarray:
        """y [m], shape (batch_count, 12 × BATCH).

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        return self.measured_at(positions)[2]

    def measured_at(self, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """F, h and y, the shapes of `deformations` and twice of `strains`.

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        found = tuple(map(np.empty_like, (self.deformations, self.strains, self.strains)))
        find_strains(
            self._is_linear, positions - self._rest, self._cells, self._gradients, self._gammas,
            *found,
        )  # fmt: skip
        return found

    def forces_at(self, positions: np.ndarray) -> np.ndarray:
        """M y [N], shape (batch_count, 12 × BATCH).

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        y, none = self.strains_at(positions), np.zeros_like(self.strains)
        found = np.empty_like(y)
        write_forces(self.moduli, np.ones(1), y, none, none, found)
        return found

    def energy(self, positions: np.ndarray) -> float:
        """Potential at a state [J].

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        _, h, y = self.measured_at(positions)
        return float(
            add_energies(self.moduli, self.scale, self._floor, h, y, self.start, self.pull)
        )

    def add_force_curvature(
        self, positions: np.ndarray, direction: np.ndarray, curvature: np.ndarray
    ) -> None:
        """Add ∂²f/∂h² of the internal forces at q + h x; see `ForceTerm.add_force_curvature`.

        It is the central difference of the exact change of the forces.
        """
        if self._is_linear or not direction.any():
            return
        longest = np.abs(direction).max()
        step = STEP_SHARE * np.abs(1.0 / self._gradients[self._gradients != 0.0]).min() / longest
        for sign in (1.0, -1.0):
            self.take(positions + sign * step * direction)
            add_force_changes(
                self._is_linear, direction, self._cells, self._free, self.moduli,
                self.scale, self._floor, self._gradients, self._gammas, self.deformations,
                self._vectors, self._forces, 0.5 * sign / step, curvature,
            )  # fmt: skip
        self.take(positions)


FLOOR = 0.01
"""m, by the least eigenvalue of M."""
STEP_SHARE = 2.0e-5
"""Move over which `add_force_changes` is differentiated, by the size of a cell."""


def divided_moduli(moduli: np.ndarray, has_floor: bool) -> tuple[np.ndarray, np.ndarray]:
    """M - m 1 and m of cells [N/m], shapes (cell_count, 12, 12) and (cell_count, 1).

    Args:
        moduli: M, shape (cell_count, 12, 12).
        has_floor: Whether m is not zero.
    """
    symmetric = 0.5 * (moduli + moduli.transpose(0, 2, 1))
    floor = np.zeros((len(moduli), 1))
    if has_floor:
        floor[:, 0] = FLOOR * np.linalg.eigvalsh(symmetric)[:, 0]
    return symmetric - floor[:, :, None] * np.eye(3 * VECTORS), floor


def flat_batches(values: np.ndarray) -> np.ndarray:
    """Batches of arrays of cells, each entry after entry, shape (batch_count, entries × BATCH).

    Args:
        values: One array a cell, shape (cell_count, ...).
    """
    batches = in_batches(values.reshape(len(values), -1), 0.0)
    return batches.reshape(len(batches), -1)
