"""The basis of a reduced body, and the quadrature points that stand for all.

The modes are those of a proper orthogonal decomposition of displacements, orthogonal in the norm of
the body's stiffness at rest. In that norm a force is as large as the displacement that it causes,
so points that are sampled for forces are sampled for displacements. Of a body that moves in time, its slowest
vibrations come first, and the others are those of what is left.

Points and weights are sampled so that they do the same virtual work along the modes as all points
together, at states of the training: energy-conserving sampling and weighting (Farhat et al.
2014), a sparse solution of non-negative least
squares (Lawson and Hanson 1974, chapter 23).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse import csr_array, kron
from scipy.sparse.linalg import eigsh

from softrobot_twin.geometry.cell_mesh import CellBlock
from softrobot_twin.mechanics.elements import Elements
from softrobot_twin.mechanics.reduced_elements import (
    ReducedElements,
    SampledPoints,
    all_points,
    point_gradients,
)
from softrobot_twin.simulation import Simulation
from softrobot_twin.simulation.build import bound_factorization, build_terms
from softrobot_twin.simulation.building.deformable_body import Body
from softrobot_twin.solvers.superlu import SuperLU

# Points whose gradients are held at once: bounds the memory of points times modes.
CHUNK = 4096
# Equations that points are sampled for, states times modes, and points that are looked at; of these
# half are drawn by the size of their forces. On the Diamond with 56 000 points and 48 modes, 75 of
# 300 states leave errors of 1.2 % at the worst of 200 fresh ones, all states 0.9 %.
MOST_EQUATIONS, MOST_CANDIDATES = 14_400, 8_000
# At least so many states are looked at, however many modes there are.
LEAST_STATES = 48
# States at which the size of the forces of all points is taken.
SIZE_STATES = 4
# Greatest displacement at the states that points are sampled at for vibrations, by the body's size, and
# what their forces count beside those of the other states: a larger share takes more points.
SHAKEN_SIZE, SHAKEN_SHARE = 0.01, 0.3
# So many points at least are added at once, or this share of those that are chosen.
ADDED_SHARE = 0.08
# A residual that falls by less than this share of it in a round falls no more.
STALLED = 1.0e-4


def blocks_of(body: Body) -> Iterator[tuple[CellBlock, tuple]]:
    """The cells of a body of one kind and one material, and the parameters of their law.

    Args:
        body: The body.
    """
    for part in body.materials:
        for block in body.mesh.strained_blocks(part.cells):
            yield block, part.law_parameters


# --- modes ---------------------------------------------------------------------------------------


def rest_stiffness(body: Body) -> csr_array:
    """Stiffness of a body's nodes at rest, of the elastic constants at small strains.

    Args:
        body: The body.

    Returns:
        [N/m], shape (3 node_count, 3 node_count); fixed nodes are not removed.
    """
    mesh, count = body.mesh, body.mesh.node_count
    terms = [Elements(block.mesh, np.arange(count), law) for block, law in blocks_of(body)]
    made = bound_factorization(SuperLU, terms, count)
    made.clear()
    for term in terms:
        term.add(mesh.node_positions, np.zeros((count, 3)), made.storage, False)
    return made.matrix().tocsr()


class Modes(NamedTuple):
    """Modes of displacements.

    Attributes:
        basis: Displacement of each node by each coordinate; the largest of a node is one, shape
            (node_count, 3, count).
        stiffness: φᵀKφ of each mode: its energy at one metre, twice [N/m], shape (count,).
        shares: Share of the energy of all displacements that is beyond the first 0, 1, 2... modes,
            shape (at least count + 1,).
    """

    basis: np.ndarray
    stiffness: np.ndarray
    shares: np.ndarray

    def coordinates(self, K: csr_array, displacements: np.ndarray) -> np.ndarray:
        """Coordinates of the nearest displacements in the norm of K [m], shape (n, count).

        Args:
            K: The stiffness at rest.
            displacements: Of the nodes [m], shape (n, node_count, 3).
        """
        flat = self.basis.reshape(-1, self.basis.shape[2])
        work = (K @ flat).T @ displacements.reshape(len(displacements), -1).T.astype(float)
        return (work / self.stiffness[:, None]).T


def proper_modes(displacements: np.ndarray, K: csr_array, most: int) -> Modes:
    """Proper orthogonal decomposition of displacements in the norm of a stiffness.

    Args:
        displacements: Of the nodes [m], shape (n, node_count, 3).
        K: The stiffness at rest.
        most: Most modes; fewer where the displacements have no more, to rounding.
    """
    U = displacements.reshape(len(displacements), -1).astype(float)
    gram = U @ (K @ U.T)
    energies, vectors = np.linalg.eigh(0.5 * (gram + gram.T))
    energies, vectors = np.maximum(energies[::-1], 0.0), vectors[:, ::-1]
    shares = 1.0 - np.concatenate([[0.0], np.cumsum(energies)]) / energies.sum()
    count = min(most, int(np.count_nonzero(energies > 1.0e-12 * energies[0])))
    modes = (U.T @ vectors[:, :count]).reshape(*displacements.shape[1:], count)
    longest = np.sqrt((modes * modes).sum(axis=1).max(axis=0))
    return Modes(modes / longest, energies[:count] / longest**2, np.maximum(shares, 0.0))


def vibration_modes(simulation: Simulation, body: Body, count: int) -> np.ndarray:
    """The slowest vibrations of a body at rest, shape (count, node_count, 3).

    Springs and tubes vibrate with it; other bodies are held, and actuators are free.

    Args:
        simulation: The scene in statics; its state is not used.
        body: The body, one of its model.
        count: How many; fewer of a mesh that has few more unknowns.
    """
    terms, nodes = build_terms(simulation.scene), simulation.model.nodes
    made = bound_factorization(SuperLU, terms.forces, nodes.free_node_count)
    made.clear()
    forces, still = np.zeros((2, nodes.free_node_count, 3))
    for term in terms.forces:
        if term.remembers_start:
            term.begin_step(nodes.rest_positions, still, np.inf)
        term.add(nodes.rest_positions, forces, made.storage, False)
    free = np.flatnonzero(~body.fixed)
    own, unknowns = ((3 * of[:, None] + np.arange(3)).ravel()
                     for of in (free, nodes.free_index[body.first_node + free]))  # fmt: skip
    K = made.matrix().tocsr()[unknowns][:, unknowns].tocsc()
    mass = body.mass_matrix(body.entry.mass_model == "consistent")[free][:, free]
    count, start = min(count, len(own) // 3), np.random.default_rng(0).standard_normal(len(own))
    _, found = eigsh(K, count, kron(mass, np.eye(3), format="csc"), sigma=0.0, v0=start)
    shapes = np.zeros((count, 3 * body.mesh.node_count))
    shapes[:, own] = found.T
    return shapes.reshape(count, -1, 3)


def with_vibrations(vibrations: np.ndarray, displacements: np.ndarray, K: csr_array, most: int) -> Modes:
    """Modes of vibrations, and the proper modes of what displacements have beside them.

    Args:
        vibrations: See `vibration_modes`.
        displacements: Of the nodes [m], shape (n, node_count, 3).
        K: The stiffness at rest.
        most: Most modes in all.
    """
    own = proper_modes(vibrations, K, len(vibrations))
    count = own.basis.shape[2]
    beside = displacements - np.tensordot(own.coordinates(K, displacements), own.basis.transpose(2, 0, 1), 1)
    others = proper_modes(beside, K, most - count)
    left, whole = (np.sum(U * (K @ U.T).T) for U in (
        of.reshape(len(of), -1).astype(float) for of in (beside, displacements)))  # fmt: skip
    return Modes(
        np.concatenate([own.basis, others.basis], axis=2),
        np.concatenate([own.stiffness, others.stiffness]),
        np.concatenate([np.ones(count), others.shares * left / whole]),
    )  # fmt: skip


def shaken(body: Body, modes: Modes, count: int) -> np.ndarray:
    """States of small vibrations to both sides, in coordinates [m], shape (2 count, mode_count).

    Args:
        body: The body.
        modes: The modes.
        count: Number of vibrations among them, which come first.
    """
    size = float(np.linalg.norm(np.ptp(body.mesh.node_positions, axis=0)))
    states = SHAKEN_SIZE * size * np.eye(modes.basis.shape[2])[:count]
    return np.concatenate([states, -states])


def mode_count_of(shares: np.ndarray, energy: float) -> int:
    """Fewest modes, a multiple of three, beyond which there is at most a share of the energy.

    Args:
        shares: Share of the energy beyond the first 0, 1, 2... modes, shape (count + 1,).
        energy: The share that may be left out.
    """
    enough = int(np.argmax(shares <= energy)) if (shares <= energy).any() else len(shares) - 1
    return 3 * max(1, -(-enough // 3))


# --- sampled points ------------------------------------------------------------------------------


def _chunks(
    body: Body, basis: np.ndarray, chosen: SampledPoints | None = None,
) -> Iterator[tuple[SampledPoints, ReducedElements]]:  # fmt: skip
    """All points of a body, or chosen ones, with their forces: so many at once as memory allows."""
    nodes = np.arange(basis.shape[2] // 3)
    for block, law in blocks_of(body):
        own = all_points(block)
        if chosen is not None:
            is_chosen = np.isin(_keys(own), _keys(chosen))
            own = SampledPoints(*(field[is_chosen] for field in own))
        for first in range(0, len(own.cells), CHUNK):
            some = SampledPoints(*(field[first : first + CHUNK] for field in own))
            gradients = point_gradients(block, some, basis)
            yield some, ReducedElements(gradients, law, nodes, nodes)


def _keys(points: SampledPoints) -> np.ndarray:
    """A number for each point of a body; no cell has as many points as a thousand."""
    return 1000 * points.cells + points.points


def _force(elements: ReducedElements, state: np.ndarray) -> np.ndarray:
    """Σ Gᵀ w P of all points of a term [N], shape (mode_count,)."""
    forces = np.zeros((len(state) // 3, 3))
    elements.add_forces(state.reshape(-1, 3), forces)
    return -forces.ravel()


class Work(NamedTuple):
    """Virtual work of points along the modes, each scaled to unit stiffness.

    Attributes:
        points: The candidates.
        columns: Of each candidate at each state, shape (state_count × mode_count, point_count).
        total: Of all points of the body, shape (state_count × mode_count,).
    """

    points: SampledPoints
    columns: np.ndarray
    total: np.ndarray


def work_of(body: Body, modes: Modes, states: np.ndarray, rng: np.random.Generator) -> Work:
    """Take the virtual work of points of a body at states.

    Args:
        body: The body.
        modes: The modes.
        states: Coordinates [m], shape (state_count, mode_count).
        rng: Draws the candidates, where there are more points than `MOST_CANDIDATES`.
    """
    scale = 1.0 / np.sqrt(modes.stiffness)
    seen = states[np.linspace(0, len(states) - 1, min(SIZE_STATES, len(states))).astype(int)]
    total, sizes, points = np.zeros(states.shape), [], []
    for some, elements in _chunks(body, modes.basis):
        for state, sum_of_all in zip(states, total, strict=True):
            sum_of_all += scale * _force(elements, state)
        size = sum(np.abs(elements.point_forces(state) * scale).sum(axis=1) for state in seen)
        sizes.append(size)
        points.append(some)
    points = SampledPoints(*map(np.concatenate, zip(*points, strict=True)))
    candidates = _drawn(np.concatenate(sizes), MOST_CANDIDATES, rng)
    candidates = SampledPoints(*(field[candidates] for field in points))
    parts, columns = [], []
    for some, elements in _chunks(body, modes.basis, candidates):
        if not len(some.cells):
            continue
        forces = [(elements.point_forces(state) * scale).astype(np.float32) for state in states]
        columns.append(np.stack(forces).transpose(0, 2, 1).reshape(states.size, -1))
        parts.append(some)
    candidates = SampledPoints(*map(np.concatenate, zip(*parts, strict=True)))
    return Work(candidates, np.concatenate(columns, axis=1), total.ravel())


def _drawn(sizes: np.ndarray, most: int, rng: np.random.Generator) -> np.ndarray:
    """Some of many points: half of them any, half likely by the size of their forces."""
    count = len(sizes)
    if count <= most:
        return np.arange(count)
    any_of_them = rng.choice(count, most // 2, replace=False)
    large = rng.choice(count, most // 2, replace=False, p=sizes / sizes.sum())
    return np.union1d(any_of_them, large)


class SparseWeights(NamedTuple):
    """Points that stand for all.

    Attributes:
        chosen: Their columns, shape (count,).
        weights: Positive, shape (count,).
        error: Norm of what is left, as a share of the total's.
    """

    chosen: np.ndarray
    weights: np.ndarray
    error: float


def sparse_weights(columns: np.ndarray, total: np.ndarray, tolerance: float) -> SparseWeights:
    """Few non-negative weights with columns · weights ≈ total.

    The method of Lawson and Hanson, which adds the columns of steepest descent, several at a time
    while they are many.

    Args:
        columns: Shape (equation_count, column_count).
        total: Shape (equation_count,).
        tolerance: Norm of the residual, as a share of the total's, at which it ends.
    """
    size = np.linalg.norm(total)
    lengths = np.sqrt(np.einsum("ij,ij->j", columns, columns, dtype=np.float64))
    lengths[lengths == 0.0] = np.inf
    chosen, weights = np.empty(0, np.int64), np.empty(0)
    A, gram, against = np.empty((len(total), 0)), np.empty((0, 0)), np.empty(0)
    residual, error, one_by_one = total, 1.0, False
    while error > tolerance:
        gain = (residual.astype(np.float32) @ columns) / lengths
        gain[chosen] = 0.0
        count = 1 if one_by_one else max(1, int(ADDED_SHARE * len(chosen)))
        count = min(count, len(gain) - len(chosen))
        if count < 1:
            break
        best = np.argpartition(-gain, count - 1)[:count]
        best = best[gain[best] > 0.0]
        if not len(best):
            break
        added = columns[:, best].astype(float)
        beside = A.T @ added
        gram = np.block([[gram, beside], [beside.T, added.T @ added]])
        A, against = np.hstack([A, added]), np.concatenate([against, added.T @ total])
        chosen = np.concatenate([chosen, best])
        weights = np.concatenate([weights, np.zeros(len(best))])
        kept, weights = _non_negative(gram, against, weights)
        A, gram, against, chosen = A[:, kept], gram[np.ix_(kept, kept)], against[kept], chosen[kept]
        residual, before = total - A @ weights, error
        error = float(np.linalg.norm(residual) / size)
        if error >= (1.0 - STALLED) * before:
            if one_by_one:
                break
            one_by_one = True
    order = np.argsort(chosen)
    return SparseWeights(chosen[order], weights[order], error)


def _non_negative(
    gram: np.ndarray, against: np.ndarray, weights: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Least squares from feasible weights, without the columns whose weights become negative.

    Args:
        gram: AᵀA, shape (count, count).
        against: Aᵀ b, shape (count,).
        weights: Non-negative ones to begin from, shape (count,).

    Returns:
        The columns that are kept, and their weights, positive.
    """
    kept = np.arange(len(against))
    scale = 1.0 / np.sqrt(np.diag(gram))
    while True:
        own = scale[kept]
        matrix = gram[np.ix_(kept, kept)] * np.outer(own, own)
        matrix[np.diag_indices(len(kept))] += 1.0e-11  # columns may depend on each other
        solution = own * cho_solve(cho_factor(matrix), own * against[kept])
        if solution.min() > 0.0:
            return kept, solution
        falls = solution <= 0.0
        drop = weights[falls] - solution[falls]
        share = np.min(np.where(drop > 0.0, weights[falls] / np.where(drop > 0.0, drop, 1.0), 0.0))
        weights = weights + share * (solution - weights)
        gone = falls & (weights <= 1.0e-12 * max(weights.max(), 1.0e-300))
        kept, weights = kept[~gone], np.maximum(weights[~gone], 0.0)


def sampled_points(
    body: Body, modes: Modes, states: np.ndarray, tolerance: float, rng: np.random.Generator,
    vibrations: int = 0,
) -> tuple[SampledPoints, float]:  # fmt: skip
    """Points of a body that stand for all at states.

    Args:
        body: The body.
        modes: The modes.
        states: Coordinates [m], shape (state_count, mode_count).
        tolerance: Error of the virtual work that is left, as a share.
        rng: Draws states, where there are many, and candidates.
        vibrations: Number of vibrations among the modes, whose stiffness at rest counts too.

    Returns:
        The points, by their cells, and the error that is left.
    """
    count = max(LEAST_STATES, MOST_EQUATIONS // states.shape[1])
    if len(states) > count:
        states = states[np.sort(rng.choice(len(states), count, replace=False))]
    work = work_of(body, modes, np.concatenate([states, shaken(body, modes, vibrations)]), rng)
    if vibrations:
        # Small as they are, vibrations would count for nothing beside the states.
        sizes = np.linalg.norm(work.total.reshape(-1, states.shape[1]), axis=1)
        factors = SHAKEN_SHARE * sizes[: len(states)].mean() / sizes[len(states) :]
        factors = np.repeat(factors, states.shape[1])
        work.total[-len(factors) :] *= factors
        work.columns[-len(factors) :] *= factors[:, None].astype(np.float32)
    found = sparse_weights(work.columns, work.total, tolerance)
    cells, points = (field[found.chosen] for field in work.points[:2])
    order = np.lexsort((points, cells))
    return SampledPoints(cells[order], points[order], found.weights[order]), found.error


def leading(modes: Modes, count: int) -> Modes:
    """The first modes.

    Args:
        modes: The modes, the most important first.
        count: How many.
    """
    return Modes(modes.basis[:, :, :count], modes.stiffness[:count], modes.shares)
