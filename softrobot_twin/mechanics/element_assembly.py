"""Forces, energy and stiffness of elements of every shape with every law.

An element has nodes a and quadrature points q with gradients ∇N_a and weights w_q [m³]. With moves
u_a of its nodes from where gradients were taken,

    F_q  = 1 + Σ_a u_a ∇N_a(q)ᵀ
    E    = Σ_q w_q Ψ(F_q),    f_a = -Σ_q w_q P(F_q) ∇N_a
    K_ab = Σ_q w_q (∂P/∂F : e_i ∇N_bᵀ) ∇N_a    as columns i = 0, 1, 2

Where the law turns (`point_law.py`), its kernels get V = F Rᵀ and answer with P Rᵀ. In the stiffness
the gradients g_a = R ∇N_a stand in place of ∇N_a: dP ∇N_a = (dP Rᵀ) g_a and
(e_i ∇N_bᵀ) Rᵀ = e_i g_bᵀ.

How many nodes and points an element has is told by its arrays; the law is told by the type of its
parameters, so that its kernels are compiled into the loops. See `element_batches.py` for how
quantities lie in memory. Kernels that take a law are not kept on disk one by one: only whole
assemblies are, and only of laws inside this package (`assembly_of`).

Arguments of the kernels here; those of one batch or point have no first axis:
    A: Matrices that gradients are multiplied with, shape (9 × BATCH,).
    C: ∂P/∂F at a point, shape (81 × BATCH,).
    D, F, shifted: Matrices at a point, shape (9 × BATCH,).
    e: An element of a batch.
    G: ∇N_a at a point [1/m], shape (3 nodes × BATCH,).
    K: One block of each element [N/m], shape (9 × BATCH,).
    L: Rows of `linearize` of the law, shape (3 rows × BATCH,).
    law: Parameters of the law.
    moves: Of the nodes from where gradients were taken [m], shape (node_count, 3).
    P: Sums of stresses times gradients of the nodes [N], shape (3 nodes × BATCH,).
    projected: Whether the differential must be positive semidefinite.
    R: Rotations, shape (9 × BATCH,).
    T: Three matrices at a point, shape (27 × BATCH,).
    cells, free: Nodes and unknowns, shape (batch_count, most nodes of a batch, BATCH).
    deformations: F, shape (batch_count, point_count, 9 × BATCH).
    forces: On the unknowns [N], shape (free_node_count, 3).
    gradients: ∇N_a [1/m], shape (batch_count, point_count, 3 nodes × BATCH).
    negative: Whether a point is not positive semidefinite, shape (BATCH,).
    U, X, g: Moves [m], vectors and gradients [1/m] of the nodes, shape (3 nodes × BATCH,).
    upright: 1.0 where a point is upright, else 0.0, shape (batch_count, point_count, BATCH).
    weights: Volumes of the points [m³], shape (batch_count, point_count, BATCH).
    x: Vectors of the nodes, shape (node_count, 3).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import numpy as np

from softrobot_twin.geometry.matrix3 import (
    IDENTITY,
    ZERO,
    add_outer,
    add_scaled_matrix,
    plus_identity,
    product,
    product_transposed,
    scaled_matrix,
    transform,
)
from softrobot_twin.geometry.vector3 import add_scaled, dot, row, scaled, set_row, subtract
from softrobot_twin.kernels.compilation import (
    GENERIC,
    INLINED,
    INNER,
    INNER_UNCACHED,
    KERNEL,
    ONCE,
    UNCACHED,
    njit,
)
from softrobot_twin.kernels.worker_threads import NOTED, STATE_SIZE, note
from softrobot_twin.mechanics.assembly_parts import next_part
from softrobot_twin.mechanics.block_addition import add_blocks, add_contiguous_blocks
from softrobot_twin.mechanics.element_batches import (
    BATCH,
    at,
    copy_entries,
    matrix_at,
    node_count_of,
    of_node,
    of_nodes,
    put_matrix,
    put_rows,
    put_vector,
    rows_at,
    scratch,
    vector_at,
)
from softrobot_twin.mechanics.element_inversion import count_inverted, find_folds, take_lowest
from softrobot_twin.mechanics.point_law import (
    differential,
    energy_density,
    law_at,
    law_is_isotropic,
    law_projects,
    law_turns,
    linearize,
    stress,
)
from softrobot_twin.mechanics.polar import find_rotations, find_upright
from softrobot_twin.mechanics.principal_axes import (
    principal_axes,
    principal_differential,
    principal_rows,
)
from softrobot_twin.mechanics.volume_barrier import BARRIER_VOLUME, no_volumes_yet, take_least_volumes

# An eigenvalue of ∂P/∂F that is negative by less than this share of its trace is none.
ROUNDING = 1.0e-13
UNIT_CHANGES = tuple(
    tuple(tuple(float(3 * i + j == entry) for j in range(3)) for i in range(3)) for entry in range(9)
)


@njit(**INNER)
def gather(x, cells, X):
    """Vectors of the elements' nodes."""
    for a in range(len(cells)):
        node = of_node(X, a)
        for e in range(BATCH):
            put_vector(node, 0, e, row(x, cells[a, e]))


@njit(**INNER)
def deform(U, G, F):
    """F = 1 + Σ u_a ∇N_aᵀ at one point."""
    count = len(G) // (3 * BATCH)
    for e in range(BATCH):
        put_matrix(F, 0, e, IDENTITY)
    # Two nodes at a time, because F is read and written as often.
    for a in range(1, count, 2):
        first_moves, first_gradients = of_node(U, a - 1), of_node(G, a - 1)
        moves, gradients = of_node(U, a), of_node(G, a)
        for e in range(BATCH):
            u, g = vector_at(first_moves, 0, e), vector_at(first_gradients, 0, e)
            halfway = add_outer(matrix_at(F, 0, e), u, g)
            u, g = vector_at(moves, 0, e), vector_at(gradients, 0, e)
            put_matrix(F, 0, e, add_outer(halfway, u, g))
    if count % 2:
        moves, gradients = of_node(U, count - 1), of_node(G, count - 1)
        for e in range(BATCH):
            u, g = vector_at(moves, 0, e), vector_at(gradients, 0, e)
            put_matrix(F, 0, e, add_outer(matrix_at(F, 0, e), u, g))


@njit(**KERNEL)
def deform_all(moves, cells, gradients, deformations):
    """F at all points of all batches; see `add_forces`."""
    U = np.empty(gradients.shape[2])
    for k in range(len(cells)):
        count = node_count_of(cells[k])
        gather(moves, cells[k, :count], U)
        for q in range(gradients.shape[1]):
            deform(U, of_nodes(gradients[k, q], count), deformations[k, q])


@njit(**INNER)
def transform_gradients(G, A, g):
    """g_a = A ∇N_a at one point."""
    for a in range(len(G) // (3 * BATCH)):
        gradients, transformed = of_node(G, a), of_node(g, a)
        for e in range(BATCH):
            gradient = vector_at(gradients, 0, e)
            put_vector(transformed, 0, e, transform(matrix_at(A, 0, e), gradient))


@njit(**INNER)
def _add_stress_to_nodes(S, G, P):
    """Add S ∇N_a at one point to each node's sum."""
    for a in range(len(G) // (3 * BATCH)):
        gradients, node = of_node(G, a), of_node(P, a)
        for e in range(BATCH):
            force = transform(matrix_at(S, 0, e), vector_at(gradients, 0, e))
            put_vector(node, 0, e, add_scaled(vector_at(node, 0, e), force, 1.0))


@njit(**INNER)
def subtract_forces(free, P, forces):
    """Subtract the nodes' sums from the forces on the free nodes."""
    for a in range(len(free)):
        node = of_node(P, a)
        for e in range(BATCH):
            n = free[a, e]
            if n >= 0:
                set_row(forces, n, subtract(row(forces, n), vector_at(node, 0, e)))


@njit(**INLINED)
def _stress_changes(T, gradients, e):
    """The three columns of one block at one point: the changes T of the stress times ∇N_a."""
    gradient = vector_at(gradients, 0, e)
    return (
        transform(matrix_at(T, 0, e), gradient),
        transform(matrix_at(T, 1, e), gradient),
        transform(matrix_at(T, 2, e), gradient),
    )


@njit(**INNER)
def contract(a, g, T, K, is_first):
    """K_ab, column by column, from the stresses T of column b at one point.

    Args:
        a: The row.
        g: The gradients.
        T: Three matrices: the change of the stress by a move of node b along each axis.
        K: Three columns; written where this point is the first, else added to.
        is_first: Whether it is.
    """
    gradients = of_node(g, a)
    if is_first:
        for e in range(BATCH):
            put_matrix(K, 0, e, _stress_changes(T, gradients, e))
    else:
        for e in range(BATCH):
            columns = _stress_changes(T, gradients, e)
            put_matrix(K, 0, e, add_scaled_matrix(matrix_at(K, 0, e), columns, 1.0))


@njit(**GENERIC)
def seen_by_law(law, F, R, e):
    """V of one element: F Rᵀ where the law turns, else F."""
    if law_turns(law):
        return product_transposed(matrix_at(F, 0, e), matrix_at(R, 0, e))
    return matrix_at(F, 0, e)


@njit(**INNER_UNCACHED)
def weighted_stresses(law, k, q, weights, F, R, S):
    """S = w P at point q of batch k; where the law turns, P is its answer P Rᵀ times R."""
    for e in range(BATCH):
        answer = stress(law_at(law, k, q, e), seen_by_law(law, F, R, e))
        answer = scaled_matrix(answer, weights[e])
        if law_turns(law):
            answer = product(answer, matrix_at(R, 0, e))
        put_matrix(S, 0, e, answer)


@njit(**INNER_UNCACHED)
def linearize_all(law, k, q, F, R, upright, projected, L):
    """What the differential needs of the deformation at point q of batch k."""
    for e in range(BATCH):
        V, is_upright = seen_by_law(law, F, R, e), upright[e] > 0.0
        put_rows(L, 0, linearize(law_at(law, k, q, e), V, is_upright, projected), e)


@njit(**GENERIC)
def linearized_rows(law):
    """As many rows as `linearize` returns."""
    return linearize(law_at(law, 0, 0, 0), IDENTITY, True, False)


@njit(**INNER_UNCACHED)
def _differentiate_node(law, k, q, b, weights, g, L, T):
    """w ∂P : e_i g_bᵀ at point q of batch k for i = 0, 1, 2."""
    gradients, zero, like = of_node(g, b), (0.0, 0.0, 0.0), linearized_rows(law)
    for e in range(BATCH):
        here, at_point = law_at(law, k, q, e), rows_at(L, 0, like, e)
        g_b = scaled(vector_at(gradients, 0, e), weights[e])
        put_matrix(T, 0, e, differential(here, at_point, (g_b, zero, zero)))
        put_matrix(T, 1, e, differential(here, at_point, (zero, g_b, zero)))
        put_matrix(T, 2, e, differential(here, at_point, (zero, zero, g_b)))


@njit(**GENERIC)
def _fill_column(law, k, q, L, j, dF, C):
    """Column j of C for all elements at point q of batch k."""
    like = linearized_rows(law)
    for e in range(BATCH):
        dP = differential(law_at(law, k, q, e), rows_at(L, 0, like, e), dF)
        C[at(j, e)], C[at(9 + j, e)], C[at(18 + j, e)] = dP[0]
        C[at(27 + j, e)], C[at(36 + j, e)], C[at(45 + j, e)] = dP[1]
        C[at(54 + j, e)], C[at(63 + j, e)], C[at(72 + j, e)] = dP[2]


@njit(**INNER_UNCACHED)
def fill_derivatives(law, k, q, L, C):
    """C = ∂P/∂F of all elements at point q of batch k: entry 9 i + j is ∂P_i/∂F_j, both row by
    row.
    """
    for j in range(9):
        _fill_column(law, k, q, L, j, UNIT_CHANGES[j], C)


@njit(**INNER)
def find_negative(C, factor, negative):
    """Marks the elements of a batch whose derivative C has a negative eigenvalue by 1.0.

    By Cholesky's method, without a branch. An eigenvalue that is negative by rounding is none: a
    material at rest bears no load while it turns.

    Args:
        C: Of `fill_derivatives`.
        factor: Memory for as much.
        negative: Written, shape (BATCH,).
    """
    negative[:] = 0.0
    for e in range(BATCH):
        size = 0.0
        for i in range(9):
            size += abs(C[at(10 * i, e)])
        for i in range(9):
            for j in range(i + 1):
                factor[at(9 * i + j, e)] = C[at(9 * i + j, e)]
            factor[at(10 * i, e)] += ROUNDING * size
    for j in range(9):
        for k in range(j):
            for i in range(j, 9):
                for e in range(BATCH):
                    factor[at(9 * i + j, e)] -= factor[at(9 * i + k, e)] * factor[at(9 * j + k, e)]
        for e in range(BATCH):
            pivot = factor[at(10 * j, e)]
            negative[e] = negative[e] if pivot > 0.0 else 1.0
            factor[at(10 * j, e)] = np.sqrt(pivot) if pivot > 0.0 else 1.0
        for i in range(j + 1, 9):
            for e in range(BATCH):
                factor[at(9 * i + j, e)] /= factor[at(10 * j, e)]


@njit(**ONCE)
def _project_one(C, e):
    """Replaces C of one element by the nearest positive semidefinite matrix, by its eigenvalues."""
    whole = np.empty((9, 9))
    for i in range(9):
        for j in range(9):
            whole[i, j] = 0.5 * (C[at(9 * i + j, e)] + C[at(9 * j + i, e)])
            if not np.isfinite(whole[i, j]):
                return
    values, vectors = np.linalg.eigh(whole)
    for i in range(9):
        for j in range(9):
            entry = 0.0
            for k in range(9):
                entry += max(values[k], 0.0) * vectors[i, k] * vectors[j, k]
            C[at(9 * i + j, e)] = entry


@njit(**INNER_UNCACHED)
def _project_isotropic(law, V, at_point, C, e):
    """What `_project_one` does, for an isotropic law, in the axes of the stretches of V."""
    rows = _positive_rows(law, V, at_point)
    for j in range(9):
        dP = principal_differential(rows, UNIT_CHANGES[j])
        for i in range(9):
            C[at(9 * i + j, e)] = dP[i // 3][i % 3]


@njit(**INNER_UNCACHED)
def _positive_rows(law, F, at_point):
    """The rows of `principal_differential` of an isotropic law, projected.

    What the differential does to each pair of axes is all that an isotropic law does.
    """
    U, _, V = principal_axes(F)
    x = _in_axes(U, V, differential(law, at_point, add_outer(ZERO, U[0], V[0])))
    y = _in_axes(U, V, differential(law, at_point, add_outer(ZERO, U[1], V[1])))
    z = _in_axes(U, V, differential(law, at_point, add_outer(ZERO, U[2], V[2])))
    yz = _in_axes(U, V, differential(law, at_point, add_outer(ZERO, U[1], V[2])))
    zx = _in_axes(U, V, differential(law, at_point, add_outer(ZERO, U[2], V[0])))
    xy = _in_axes(U, V, differential(law, at_point, add_outer(ZERO, U[0], V[1])))
    diagonal = (x[0][0], y[1][1], z[2][2], z[1][1], x[2][2], y[0][0])
    even = (yz[1][2] + yz[2][1], zx[2][0] + zx[0][2], xy[0][1] + xy[1][0])
    odd = (yz[1][2] - yz[2][1], zx[2][0] - zx[0][2], xy[0][1] - xy[1][0])
    return principal_rows(U, V, diagonal, even, odd, True)


@njit(**INLINED)
def _in_axes(U, V, dP):
    """Uᵀ dP V, where the rows of U and V are axes."""
    return product(U, product_transposed(dP, V))


@njit(**INNER_UNCACHED)
def project_all(law, k, q, weights, negative, F, R, L, C):
    """Projects the derivatives of the elements that are marked as negative, at point q of
    batch k.

    Returns:
        Whether there is one.
    """
    is_any = False
    for e in range(BATCH):
        if negative[e] > 0.0 and weights[e] > 0.0:
            is_any = True
            if law_is_isotropic(law):
                V, at_point = seen_by_law(law, F, R, e), rows_at(L, 0, linearized_rows(law), e)
                _project_isotropic(law_at(law, k, q, e), V, at_point, C, e)
            else:
                _project_one(C, e)
    return is_any


@njit(**INNER)
def _apply_derivatives(b, weights, g, C, T):
    """What `_differentiate_node` does, by matrices C of nine rows."""
    gradients = of_node(g, b)
    for i in range(3):
        for entry in range(9):
            for e in range(BATCH):
                change = dot(vector_at(C, 3 * entry + i, e), vector_at(gradients, 0, e))
                T[at(9 * i + entry, e)] = weights[e] * change


@njit(**INNER_UNCACHED)
def _see_gradients(law, G, R, g):
    """g_a of a law at one point: turned, or ∇N_a themselves."""
    if law_turns(law):
        transform_gradients(G, R, g)
    else:
        copy_entries(G, g)


@njit(**INNER_UNCACHED)
def find_state(law, F, R, upright):
    """Whether one point is upright, and its rotation where the law turns."""
    find_upright(F, upright)
    if law_turns(law):
        find_rotations(F, upright, R)


def add_energies(law, moves, cells, gradients, weights, rotations, uprights):
    """Energy of all elements [J].

    Args:
        law, moves, cells, gradients, weights, rotations, uprights: See `add_forces`.
    """
    point_count, width = weights.shape[1], gradients.shape[2]
    U, F = np.empty(width), scratch(9)
    total = 0.0
    for k in range(len(cells)):
        count = node_count_of(cells[k])
        gather(moves, cells[k, :count], U)
        for q in range(point_count):
            deform(U, of_nodes(gradients[k, q], count), F)
            find_state(law, F, rotations[k, q], uprights[k, q])
            for e in range(BATCH):
                if weights[k, q, e] > 0.0:
                    V = seen_by_law(law, F, rotations[k, q], e)
                    total += weights[k, q, e] * energy_density(law_at(law, k, q, e), V)
    return total


def add_forces(
    waits_for_all, state, done, parts, law, moves, cells, free, gradients, weights, to_corners,
    deformations, rotations, uprights, forces,
):  # fmt: skip
    """Subtract the internal forces of all elements, but not those of the barrier.

    Leaves what it finds at the points to `add_stiffness` at the same state.

    Args:
        waits_for_all, state, done, parts: See `assembly_parts.py`.
        law: Parameters of the law.
        moves: Moves of the nodes from where gradients were taken [m], shape (node_count, 3).
        cells: Nodes of each batch, -1 behind the last one, see `node_count_of`,
            shape (batch_count, most nodes of a batch, BATCH).
        free: Unknowns of these nodes, -1 where there are none, same shape.
        gradients: ∇N_a at each point [1/m], shape (batch_count, point_count, 3 nodes × BATCH).
        weights: Volume of each point [m³], 0 beyond the last element,
            shape (batch_count, point_count, BATCH).
        to_corners: See `element_inversion.py`.
        deformations: F; written, shape (batch_count, point_count, 9 × BATCH).
        rotations: R; written where the law turns, same shape.
        uprights: 1.0 where a point is upright, else 0.0; written, shape (batch_count, point_count, BATCH).
        forces: Forces on the unknowns [N]; added to.

    Returns:
        Number of flat or inverted elements, and whether the barrier of `volume_barrier.py` acts: a
        point has less than J₀, and none is flat or inside out.
    """
    point_count, width = weights.shape[1], gradients.shape[2]
    U, P = np.empty(width), np.empty(width)
    S = scratch(9)
    corners = np.empty((len(to_corners), 9 * BATCH))
    lowest, sure = scratch(1), scratch(1)
    noted = state if len(state) > 0 else np.zeros(STATE_SIZE, np.int64)
    part = next_part(-1, parts, waits_for_all, state, done)
    while part < len(parts.begins) - 1:
        least_volumes, inverted_count = no_volumes_yet(), 0
        for k in parts.batches[parts.begins[part] : parts.begins[part + 1]]:
            count = node_count_of(cells[k])
            gather(moves, cells[k, :count], U)
            P[:] = 0.0
            lowest[:] = 1.0
            for q in range(point_count):
                F, G = deformations[k, q], of_nodes(gradients[k, q], count)
                deform(U, G, F)
                find_state(law, F, rotations[k, q], uprights[k, q])
                take_lowest(uprights[k, q], lowest)
                take_least_volumes(F, uprights[k, q], least_volumes)
                weighted_stresses(law, k, q, weights[k, q], F, rotations[k, q], S)
                _add_stress_to_nodes(S, G, P)
            subtract_forces(free[k, :count], P, forces)
            if len(to_corners) > 0:
                find_folds(to_corners, deformations[k], corners, lowest, sure)
            inverted_count += count_inverted(weights[k, 0], lowest)
        least = least_volumes.min()
        note(inverted_count, 0, noted)
        note(int(not least > -np.inf), 1, noted)
        note(int(least < BARRIER_VOLUME), 2, noted)
        part = next_part(part, parts, waits_for_all, state, done)
    return noted[NOTED], noted[NOTED + 1] == 0 and noted[NOTED + 2] > 0


def add_stiffness(
    waits_for_all, state, done, parts, law, cells, gradients, weights, projected, deformations,
    rotations, uprights, offsets, strides, are_contiguous, storage,
):  # fmt: skip
    """Add the stiffness of all elements at the state where `add_forces` was called last, but not
    that of the barrier.

    Args:
        waits_for_all, state, done, parts: See `assembly_parts.py`.
        law, cells, gradients, weights: See `add_forces`.
        projected: True for a positive semidefinite stiffness.
        deformations, rotations, uprights: What `add_forces` left.
        offsets: Place of each block, see `bind_stencils`, shape (batch_count, pair_count, BATCH).
        strides: Distance of its columns, same shape.
        are_contiguous: Whether all blocks are contiguous.
        storage: The factorization's storage [N/m]; added to.
    """
    point_count, width = weights.shape[1], gradients.shape[2]
    # What each point keeps until the blocks are summed.
    g = np.empty((point_count, width))
    L = np.empty((point_count, 3 * len(linearized_rows(law)) * BATCH))
    is_tested = projected and not law_projects(law)
    C = np.empty((point_count, (81 if is_tested else 0) * BATCH))
    factor, negative = scratch(81 if is_tested else 0), scratch(1)
    T, K = np.empty((point_count, 27 * BATCH)), scratch(9)
    part = next_part(-1, parts, waits_for_all, state, done)
    while part < len(parts.begins) - 1:
        for k in parts.batches[parts.begins[part] : parts.begins[part + 1]]:
            count = node_count_of(cells[k])
            by_matrix = False
            for q in range(point_count):
                F, G = deformations[k, q], of_nodes(gradients[k, q], count)
                _see_gradients(law, G, rotations[k, q], g[q])
                linearize_all(law, k, q, F, rotations[k, q], uprights[k, q], projected, L[q])
                if is_tested:
                    fill_derivatives(law, k, q, L[q], C[q])
                    find_negative(C[q], factor, negative)
                    by_matrix |= project_all(
                        law, k, q, weights[k, q], negative, F, rotations[k, q], L[q], C[q]
                    )
            pair = 0
            for b in range(count):
                for q in range(point_count):
                    if by_matrix:
                        _apply_derivatives(b, weights[k, q], g[q], C[q], T[q])
                    else:
                        _differentiate_node(law, k, q, b, weights[k, q], g[q], L[q], T[q])
                for a in range(b, count):
                    for q in range(point_count):
                        contract(a, g[q], T[q], K, q == 0)
                    if are_contiguous:
                        add_contiguous_blocks(offsets[k, pair], K, storage)
                    else:
                        add_blocks(offsets[k, pair], strides[k, pair], K, storage)
                    pair += 1
        part = next_part(part, parts, waits_for_all, state, done)


@njit(**INNER)
def deform_along(D, F, step, shifted):
    """F + h D of each element at one point, with h D of the size `step`; writes it, and gives 1/h.

    Args:
        D: A change of F by a direction.
        F: The deformation.
        step: Largest entry of h D.
        shifted: Takes F + h D.
    """
    inverse = np.empty(BATCH)
    for e in range(BATCH):
        largest = 0.0
        for entry in range(9):
            largest = max(largest, abs(D[at(entry, e)]))
        inverse[e] = largest / abs(step)
        share = step / largest if largest > 0.0 else 0.0
        for entry in range(9):
            shifted[at(entry, e)] = F[at(entry, e)] + share * D[at(entry, e)]
    return inverse


@njit(**INNER_UNCACHED)
def _differentials_along(law, k, q, F, D, R, upright, weights, S):
    """S = w ∂P/∂F : D at point q of batch k; where the law turns, its answer times R."""
    for e in range(BATCH):
        here, V, A = law_at(law, k, q, e), seen_by_law(law, F, R, e), seen_by_law(law, D, R, e)
        at_point = linearize(here, V, upright[e] > 0.0, False)
        answer = scaled_matrix(differential(here, at_point, A), weights[e])
        if law_turns(law):
            answer = product(answer, matrix_at(R, 0, e))
        put_matrix(S, 0, e, answer)


def add_force_curvature(law, moves, direction, cells, free, gradients, weights, step, curvature):
    """Add ∂²f/∂h² of the internal forces f = ∂E/∂q along q + h x: the third derivative of the energy.

    It is the central difference of the exact differential ∂P/∂F : D at F ± h D, D = Σ x_a ∇N_aᵀ,
    with a step of its own for each point and element.

    Args:
        law, moves, cells, free, gradients, weights: See `add_forces`.
        direction: x of all nodes, zero where they are fixed, shape (node_count, 3).
        step: Largest entry of h D.
        curvature: Takes the sum, shape (free_node_count, 3); added to.
    """
    point_count, width = weights.shape[1], gradients.shape[2]
    U, X, P = np.empty(width), np.empty(width), np.empty(width)
    F, D, S, shifted = scratch(9), scratch(9), scratch(9), scratch(9)
    other, R, upright = scratch(9), scratch(9), scratch(1)
    for k in range(len(cells)):
        count = node_count_of(cells[k])
        gather(moves, cells[k, :count], U)
        gather(direction, cells[k, :count], X)
        P[:] = 0.0
        for q in range(point_count):
            G = of_nodes(gradients[k, q], count)
            deform(U, G, F)
            deform(X, G, D)
            for e in range(BATCH):
                put_matrix(D, 0, e, plus_identity(matrix_at(D, 0, e), -1.0))
            inverse = deform_along(D, F, step, shifted)
            find_state(law, shifted, R, upright)
            _differentials_along(law, k, q, shifted, D, R, upright, weights[k, q], S)
            deform_along(D, F, -step, shifted)
            find_state(law, shifted, R, upright)
            _differentials_along(law, k, q, shifted, D, R, upright, weights[k, q], other)
            for entry in range(9):
                for e in range(BATCH):
                    i = at(entry, e)
                    S[i] = 0.5 * (S[i] - other[i]) * inverse[e]
            _add_stress_to_nodes(S, G, P)
        for i in range(width):
            P[i] = -P[i]
        subtract_forces(free[k, :count], P, curvature)


class Assembly(NamedTuple):
    """The loops over elements, compiled for a law when they are first called.

    Attributes:
        add_energies: See the function of this name; so the others.
        add_forces: Forces.
        add_stiffness: Stiffness, with forces unless they are known.
        add_force_curvature: Second derivative of the forces along a direction.
    """

    add_energies: Callable
    add_forces: Callable
    add_stiffness: Callable
    add_force_curvature: Callable


@cache
def assembly_of(parameters: type) -> Assembly:
    """The assembly for a law.

    Compiled code of a law of this package is kept on disk. That of a law from outside is not: numba
    would not notice a change in the law's file, and a process that does not know the law could not
    read what was kept.

    Args:
        parameters: The type of the law's parameters.
    """
    return _KEPT if is_of_package(parameters) else _assembly(UNCACHED)


def is_of_package(parameters: type) -> bool:
    """Whether a law is defined inside this package; see `assembly_of`.

    Args:
        parameters: The type of the law's parameters.
    """
    return parameters.__module__.startswith(_PACKAGE)


def _assembly(options: dict) -> Assembly:
    loops = (add_energies, add_forces, add_stiffness, add_force_curvature)
    return Assembly(*(njit(**options)(loop) for loop in loops))


_PACKAGE = __name__.split(".")[0] + "."
_KEPT = _assembly(KERNEL)
