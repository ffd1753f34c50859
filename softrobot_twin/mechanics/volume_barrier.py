"""A barrier against elements that fold: energy that grows without bound as det F approaches zero.

A law for small strains, such as the corotational one, lets an element pass through a flat shape at
a finite energy, which no material does. Where det F = J is less than J₀ = 0.1, far outside the range
in which such a law is valid, the energy per volume

    Ψ_b = κ b(J/J₀),    b(s) = -(1 - s)² ln s

is added (Li et al. 2020, eq. 6, with a volume in place of a distance).
It is twice continuously differentiable at J₀, and κ is the stiffness of the law against a uniaxial
stretch. Elsewhere nothing is added, to the bit. With c_a = cof(F) ∇N_a, the derivative of J by node a,

    f_a  = -w κ b'/J₀ c_a
    K_ab =  w κ (b''/J₀² c_a c_bᵀ + b'/J₀ ∂c_a/∂x_b),    ∂c_a/∂x_b = [F (∇N_a × ∇N_b)]×

A body of which a point is flat or inside out has no barrier: to unfold, other elements may have to
pass through flat shapes too.

Between its points an element has the barrier of `fold_barrier.py`.

Along a move, J of a point is a cubic polynomial. `largest_share` follows it, so that a step can stop
before an element folds.

Arguments of the kernels here:
    a, b, e: Two nodes of an element, and the element of the batch.
    curvature, slope: w κ b''/J₀² and w κ b'/J₀ [J].
    deformations: F, shape (batch_count, point_count, 9 × BATCH).
    F: That of one point, shape (9 × BATCH,).
    G, gradients: ∇N_a at one point [1/m], shape (3 nodes × BATCH,).
    stiffness: κ [Pa].
    storage: The factorization's storage [N/m], shape (size,); added to.
    volumes: J, shape (BATCH,).
    weights: Volumes of the points [m³], shape (batch_count, point_count, BATCH).
"""

from __future__ import annotations

import numpy as np

from softrobot_twin.geometry.matrix3 import (
    add_outer,
    add_scaled_matrix,
    cofactor,
    cross_matrix,
    determinant,
    inner,
    scaled_matrix,
    transform,
)
from softrobot_twin.geometry.vector3 import cross, scaled
from softrobot_twin.kernels.compilation import INNER, KERNEL, ONCE, njit
from softrobot_twin.mechanics.element_batches import (
    BATCH,
    matrix_at,
    node_count_of,
    of_node,
    vector_at,
)
from softrobot_twin.mechanics.polar import is_upright
from softrobot_twin.mechanics.stencil import add_block

# J₀: volume of a point, as a share of that at rest, below which the barrier acts.
BARRIER_VOLUME = 0.1
# Share of its volume that a point keeps at least in one move.
KEPT_VOLUME = 0.1
# Factor by which a share is shortened until the volumes along it are proved to be kept, and how
# often at most.
SHORTER, MOST_SHORTENINGS = 0.8, 60


@njit(**KERNEL)
def barrier(volume):
    """b and its two derivatives by J; zero where the barrier does not act.

    Args:
        volume: J, greater than zero.
    """
    s = volume / BARRIER_VOLUME
    if s >= 1.0:
        return 0.0, 0.0, 0.0
    gap, log = 1.0 - s, np.log(s)
    first = 2.0 * gap * log - gap * gap / s
    second = -2.0 * log + 4.0 * gap / s + gap * gap / (s * s)
    return -gap * gap * log, first / BARRIER_VOLUME, second / BARRIER_VOLUME**2


@njit(**KERNEL)
def no_volumes_yet():
    """Memory for `take_least_volumes`, before the first point."""
    return np.full(BATCH, np.inf)


@njit(**KERNEL)
def take_least_volumes(F, upright, least):
    """The least J of each place in a batch over all points; -∞ where one is not upright.

    Args:
        F: Deformation of a batch at one point, shape (9 × BATCH,).
        upright: 1.0 where it is upright, else 0.0, shape (BATCH,).
        least: The least so far; written, shape (BATCH,).
    """
    for e in range(BATCH):
        volume = determinant(matrix_at(F, 0, e))
        volume = volume if upright[e] > 0.0 else -np.inf
        least[e] = volume if volume < least[e] else least[e]


@njit(**INNER)
def acts_in(F, volumes):
    """Whether a point of a batch has less than J₀; writes J of all of them."""
    least = BARRIER_VOLUME
    for e in range(BATCH):
        volumes[e] = determinant(matrix_at(F, 0, e))
    for e in range(BATCH):
        least = min(least, volumes[e])
    return least < BARRIER_VOLUME


@njit(**KERNEL)
def add_barrier_energies(stiffness, weights, deformations):
    """Energy of the barrier in all elements, which are upright [J]; see `add_barrier_forces`."""
    volumes, total = np.empty(BATCH), 0.0
    for k in range(len(weights)):
        for q in range(weights.shape[1]):
            F = deformations[k, q]
            if acts_in(F, volumes):
                for e in range(BATCH):
                    if weights[k, q, e] > 0.0 and volumes[e] < BARRIER_VOLUME:
                        total += stiffness * weights[k, q, e] * barrier(volumes[e])[0]
    return total


@njit(**INNER)
def volume_gradient(F, gradients, a, e):
    """c_a = cof(F) ∇N_a of element e at one point."""
    return transform(cofactor(matrix_at(F, 0, e)), vector_at(of_node(gradients, a), 0, e))


@njit(**KERNEL)
def add_barrier_forces(stiffness, free, gradients, weights, deformations, forces):
    """Add the forces of the barrier of all elements, which are upright.

    Args:
        stiffness: κ [Pa].
        free: Unknowns of the nodes of each batch, -1 where there are none,
            shape (batch_count, node_count of an element, BATCH).
        gradients: ∇N_a at each point [1/m], shape (batch_count, point_count, 3 nodes × BATCH).
        weights: Volume of each point [m³], 0 beyond the last element,
            shape (batch_count, point_count, BATCH).
        deformations: F, shape (batch_count, point_count, 9 × BATCH).
        forces: Forces on the unknowns [N], shape (free_node_count, 3); added to.

    Returns:
        Number of points on which the barrier acts.
    """
    volumes, count = np.empty(BATCH), 0
    for k in range(len(weights)):
        for q in range(weights.shape[1]):
            F = deformations[k, q]
            if not acts_in(F, volumes):
                continue
            for e in range(BATCH):
                if weights[k, q, e] == 0.0 or volumes[e] >= BARRIER_VOLUME:
                    continue
                count += 1
                slope = stiffness * weights[k, q, e] * barrier(volumes[e])[1]
                for a in range(free.shape[1]):
                    n = free[k, a, e]
                    if n >= 0:
                        c = volume_gradient(F, gradients[k, q], a, e)
                        for i in range(3):
                            forces[n, i] -= slope * c[i]
    return count


@njit(**KERNEL)
def add_barrier_stiffness(
    stiffness, cells, gradients, weights, deformations, projected, offsets, strides, storage
):
    """Add the stiffness of the barrier of all elements.

    Args:
        stiffness, gradients, weights, deformations: See `add_barrier_forces`.
        cells: Nodes of each batch, see `node_count_of`.
        projected: True for its positive semidefinite part, without the curvature of J.
        offsets: Place of each block, see `bind_stencils`, shape (batch_count, pair_count, BATCH).
        strides: Distance of its columns, same shape.
        storage: The factorization's storage [N/m]; added to.
    """
    volumes = np.empty(BATCH)
    for k in range(len(weights)):
        node_count = node_count_of(cells[k])
        for q in range(weights.shape[1]):
            F, G = deformations[k, q], gradients[k, q]
            if not acts_in(F, volumes):
                continue
            for e in range(BATCH):
                if weights[k, q, e] == 0.0 or volumes[e] >= BARRIER_VOLUME:
                    continue
                _, slope, curvature = barrier(volumes[e])
                weight = stiffness * weights[k, q, e]
                slope = 0.0 if projected else weight * slope
                pair = 0
                for b in range(node_count):
                    for a in range(b, node_count):
                        if offsets[k, pair, e] >= 0:
                            block = barrier_block(F, G, a, b, e, weight * curvature, slope)
                            add_block(block, offsets[k, pair, e], strides[k, pair, e], storage)
                        pair += 1


@njit(**ONCE)
def barrier_block(F, G, a, b, e, curvature, slope):
    """K_ab of one element at one point."""
    c_a, c_b = volume_gradient(F, G, a, e), volume_gradient(F, G, b, e)
    across = cross(vector_at(of_node(G, a), 0, e), vector_at(of_node(G, b), 0, e))
    turning = scaled_matrix(cross_matrix(transform(matrix_at(F, 0, e), across)), -slope)
    return add_outer(turning, scaled(c_a, curvature), c_b)


@njit(**ONCE)
def keeps_volume(F, D, share):
    """Whether J stays above the kept share along F + t D for all t up to a share, from 0.

    The cubic's four Bernstein coefficients bound it from below.

    Args:
        F: Deformation where the move begins, upright.
        D: Its change by the whole move.
        share: End of t.
    """
    first, third = determinant(F), share**3 * determinant(D)
    slope = share * inner(cofactor(F), D)
    second = share**2 * inner(cofactor(D), F)
    least = KEPT_VOLUME * first
    end = first + slope + second + third
    return (
        end > least
        and first + slope / 3.0 > least
        and first + (2.0 * slope + second) / 3.0 > least
        and is_upright(add_scaled_matrix(F, D, share))
    )


@njit(**KERNEL)
def largest_share_of_points(weights, deformations, changes):
    """How much of a move may be made so that every upright point keeps a share of its volume.

    Args:
        weights: See `add_barrier_forces`.
        deformations: F where the move begins, shape (batch_count, point_count, 9 × BATCH).
        changes: Its change by the whole move, same shape.
    """
    share = 1.0
    for k in range(len(weights)):
        for q in range(deformations.shape[1]):
            for e in range(BATCH):
                F, D = matrix_at(deformations[k, q], 0, e), matrix_at(changes[k, q], 0, e)
                if weights[k, 0, e] == 0.0 or not is_upright(F):
                    continue
                for _ in range(MOST_SHORTENINGS):
                    if keeps_volume(F, D, share):
                        break
                    share *= SHORTER
    return share
