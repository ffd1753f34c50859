"""The barrier against folds between the quadrature points of an element.

Quadratic tetrahedra have no quadrature point at their corners, on their edges and faces, where they
fold first, and hexahedra have none at their corners. det F is a cubic polynomial in a quadratic
tetrahedron. Samples of it do not tell that it is positive between them; its Bernstein coefficients
do, which are mixed determinants of F at three corners each (`element_inversion.py`). Coefficients
of a whole element would forbid shapes that are upright; those of its parts, cut at the mid-edges, are
near det F itself. So the places are the corners and mid-edges, and the values

    J_t = D(F_a, F_b, F_c),    D(F, F, F) = det F

of triples t of places that belong to one part. The octahedron in the middle is cut along each of its
diagonals, so that no numbering of the nodes prefers one. Where all J_t are positive, the element
is upright everywhere. Each has the barrier of `volume_barrier.py`, with the share of volume of a
place. In a hexahedron the places are its corners, with the map of its corners alone, and J_t is det F.

With the gradients g_a of a node at the places, and the mixed cofactors C(F_a, F_b) = ∂(3 D)/∂F_c,

    ∂J_t/∂x = (C(F_b, F_c) g_a + C(F_a, F_c) g_b + C(F_a, F_b) g_c) / 3

Most elements are nearly as at rest but for a common deformation M of their corners: if F at all of them
is M (1 + D) with |D| ≤ d, then J_t ≥ det M (2 - (1 + d)³), which is looked at first.

A body with a value that is not positive has no such barrier: to unfold, others may have to pass
through zero too. No move of a step makes one so (`ForceTerm.crossed_count`).

Arguments of the kernels here; those of one batch have no first axis:
    D, F: Three matrices, each three rows of three numbers.
    bounds, least: Of each element, shape (batch_count, BATCH).
    corners: F at the four corners, shape (4, 9 × BATCH).
    gradients: ∇N_a at each place [1/m], shape (batch_count, place_count, 3 nodes × BATCH).
    places: F at each place, shape (batch_count, place_count, 9 × BATCH).
    stiffness: κ of the law [Pa].
    triple: Three places, shape (3,).
    triples: All of them, shape (triple_count, 3).
    weights: Volume of a place [m³], shape (batch_count, BATCH).
"""

from __future__ import annotations

from itertools import combinations, product as pairs_of

import numpy as np

from softrobot_twin.geometry.matrix3 import (
    add_outer,
    add_scaled_matrix,
    cofactor,
    cofactor_change,
    cross_matrix,
    determinant,
    inner,
    product,
    scaled_matrix,
    transform,
    transposed,
)
from softrobot_twin.geometry.vector3 import add_scaled, cross, row, scaled, set_row
from softrobot_twin.kernels.compilation import INNER, KERNEL, ONCE, njit
from softrobot_twin.mechanics.element_batches import (
    BATCH,
    ElementBatches,
    in_batches,
    matrix_at,
    of_node,
    vector_at,
)
from softrobot_twin.mechanics.element_inversion import (
    WatchedCorners,
    deform_corners,
    least_coefficient,
    mixed_determinant,
    sum_of_corners,
    write_corners,
    write_element,
)
from softrobot_twin.mechanics.stencil import add_block
from softrobot_twin.mechanics.volume_barrier import (
    BARRIER_VOLUME,
    MOST_SHORTENINGS,
    SHORTER,
    barrier,
)

# Share of itself that a value keeps at least in one move. With less, bodies come so near to the
# barrier that Newton's method goes along it in ever smaller moves.
KEPT_SHARE = 0.3


def triples_of_parts() -> np.ndarray:
    """Triples of places, corners first and then mid-edges, that belong to one part of a
    tetrahedron, shape (triple_count, 3).
    """
    middle = {pair: 4 + k for k, pair in enumerate(combinations(range(4), 2))}
    of_corners = [
        (corner, *(middle[pair] for pair in middle if corner in pair)) for corner in range(4)
    ]
    # Each diagonal of the octahedron, and each pair of neighbours around it.
    diagonals = [(middle[0, a], middle[b, c]) for a, b, c in ((1, 2, 3), (2, 1, 3), (3, 1, 2))]
    inside = [
        (*diagonal, *others)
        for diagonal, first, second in ((diagonals[i], diagonals[i - 1], diagonals[i - 2])
                                        for i in range(3))
        for others in pairs_of(first, second)
    ]  # fmt: skip
    triples = {
        tuple(sorted(triple)) for part in (*of_corners, *inside)
        for triple in pairs_of(part, repeat=3)
    }  # fmt: skip
    return np.array(sorted(triples))


@njit(**INNER)
def _at_places(places, triple, e):
    """F of element e at the three places of a triple."""
    return (
        matrix_at(places[triple[0]], 0, e), matrix_at(places[triple[1]], 0, e),
        matrix_at(places[triple[2]], 0, e),
    )  # fmt: skip


@njit(**INNER)
def _value_of(F):
    """J_t of F at three places."""
    return mixed_determinant(F[0], F[1], F[2]) / 6.0


@njit(**INNER)
def _value_gradient(F, gradients, triple, a, e):
    """∂J_t by node a of element e."""
    first, second, third = _gradients_at(gradients, triple, a, e)
    change = transform(cofactor_change(F[1], F[2]), first)
    change = add_scaled(change, transform(cofactor_change(F[0], F[2]), second), 1.0)
    change = add_scaled(change, transform(cofactor_change(F[0], F[1]), third), 1.0)
    return scaled(change, 1.0 / 6.0)


@njit(**INNER)
def _gradients_at(gradients, triple, a, e):
    """∇N_a of element e at the three places of a triple."""
    return (
        vector_at(of_node(gradients[triple[0]], a), 0, e),
        vector_at(of_node(gradients[triple[1]], a), 0, e),
        vector_at(of_node(gradients[triple[2]], a), 0, e),
    )


@njit(**ONCE)
def _value_turning(F, gradients, triple, a, b, e):
    """v of ∂²J_t by nodes a and b, which is -[v]×."""
    first = _gradients_at(gradients, triple, a, e)
    second = _gradients_at(gradients, triple, b, e)
    turning = transform(F[2], _mixed_cross(first[0], second[0], first[1], second[1]))
    other = transform(F[0], _mixed_cross(first[1], second[1], first[2], second[2]))
    last = transform(F[1], _mixed_cross(first[2], second[2], first[0], second[0]))
    return scaled(add_scaled(add_scaled(turning, other, 1.0), last, 1.0), 1.0 / 6.0)


@njit(**INNER)
def _mixed_cross(a, b, c, d):
    """a × d + c × b."""
    return add_scaled(cross(a, d), cross(c, b), 1.0)


@njit(**ONCE)
def _bound_values(corners, bounds):
    """A lower bound of all J_t of each element, from F at its corners; not positive for NaN."""
    for e in range(BATCH):
        mean = scaled_matrix(sum_of_corners(corners, e), 0.25)
        volume, largest = determinant(mean), 0.0
        inverse = transposed(cofactor(mean))
        for corner in range(4):
            apart = add_scaled_matrix(matrix_at(corners[corner], 0, e), mean, -1.0)
            relative = product(inverse, apart)
            largest = max(largest, inner(relative, relative))
        reach = 1.0 + np.sqrt(largest) / volume
        bounds[e] = volume * (2.0 - reach * reach * reach) if volume > 0.0 else -1.0


@njit(**ONCE)
def _least_of_corners(corners, e):
    """The least Bernstein coefficient of element e as a whole."""
    F = np.empty((4, 3, 3))
    write_element(corners, e, F)
    return least_coefficient(F) / 6.0


@njit(**KERNEL)
def find_least_values(to_places, triples, weights, deformations, places, least):
    """The least J_t of each element, or a lower bound of it where that is J₀ or more.

    Args:
        to_places: F at the places, corners first, from F at the points, shape (place_count,
            point_count); no rows where `places` are known.
        triples: The triples, shape (triple_count, 3).
        weights: Share of volume of a place [m³], 0 beyond the last element, shape (batch_count, BATCH).
        deformations: F at the points, shape (batch_count, point_count, 9 × BATCH).
        places: F at the places; written where elements have lower values, shape (batch_count,
            place_count, 9 × BATCH).
        least: Written, shape (batch_count, BATCH).

    Returns:
        Whether one is below J₀, if all are positive; and how many are not.
    """
    lowest, crossed_count = np.inf, 0
    for k in range(len(weights)):
        if len(to_places) > 0:
            deform_corners(to_places[:4], deformations[k], places[k, :4])
            _bound_values(places[k], least[k])
            if least[k].min() >= BARRIER_VOLUME:
                continue
            deform_corners(to_places[4:], deformations[k], places[k, 4:])
        for e in range(BATCH):
            if weights[k, e] == 0.0:
                least[k, e] = BARRIER_VOLUME
            elif len(to_places) == 0 or not least[k, e] >= BARRIER_VOLUME:
                least[k, e] = _least_value(triples, places[k], e, len(to_places) > 0)
                lowest = min(lowest, least[k, e])
                crossed_count += not least[k, e] > 0.0
    return crossed_count == 0 and lowest < BARRIER_VOLUME, crossed_count


@njit(**ONCE)
def _least_value(triples, places, e, are_of_tetrahedra):
    """The least J_t of element e, or a lower bound of it where that is J₀ or more."""
    if are_of_tetrahedra:
        bound = _least_of_corners(places, e)
        if bound >= BARRIER_VOLUME:
            return bound
    least = np.inf
    for t in range(len(triples)):
        if are_of_tetrahedra:
            value = _value_of(_at_places(places, triples[t], e))
        else:
            value = determinant(matrix_at(places[t], 0, e))
        # NaN stays.
        least = least if value >= least else value
    return least


@njit(**KERNEL)
def add_energies(stiffness, triples, weights, places, least):
    """Energy of the barrier in all elements [J]; see `add_forces`."""
    total = 0.0
    for k in range(len(weights)):
        for e in range(BATCH):
            if least[k, e] < BARRIER_VOLUME:
                for t in range(len(triples)):
                    value = _value_of(_at_places(places[k], triples[t], e))
                    if value < BARRIER_VOLUME:
                        total += stiffness * weights[k, e] * barrier(value)[0]
    return total


@njit(**KERNEL)
def add_forces(stiffness, free, gradients, triples, weights, places, least, forces):
    """Add the forces of the barrier of all elements, of which all values are positive.

    Args:
        stiffness: κ [Pa].
        free: Unknowns of the nodes of each batch, -1 where there are none,
            shape (batch_count, node_count of an element, BATCH).
        gradients: ∇N_a at each place [1/m], shape (batch_count, place_count, 3 nodes × BATCH).
        triples, weights, places, least: See `find_least_values`.
        forces: Forces on the unknowns [N], shape (free_node_count, 3); added to.

    Returns:
        Number of values on which the barrier acts.
    """
    count = 0
    for k in range(len(weights)):
        for e in range(BATCH):
            if least[k, e] >= BARRIER_VOLUME:
                continue
            for t in range(len(triples)):
                F = _at_places(places[k], triples[t], e)
                value = _value_of(F)
                if value >= BARRIER_VOLUME:
                    continue
                count += 1
                slope = stiffness * weights[k, e] * barrier(value)[1]
                for a in range(free.shape[1]):
                    n = free[k, a, e]
                    if n >= 0:
                        c = _value_gradient(F, gradients[k], triples[t], a, e)
                        for i in range(3):
                            forces[n, i] -= slope * c[i]
    return count


@njit(**KERNEL)
def add_stiffness(
    stiffness, gradients, triples, weights, places, least, projected, offsets, strides, storage
):
    """Add the stiffness of the barrier of all elements.

    Args:
        stiffness, gradients, triples, weights, places, least: See `add_forces`.
        projected: True for its positive semidefinite part, without the curvature of J_t.
        offsets: Place of each block, see `bind_stencils`, shape (batch_count, pair_count, BATCH).
        strides: Distance of its columns, same shape.
        storage: The factorization's storage [N/m]; added to.
    """
    node_count = gradients.shape[2] // (3 * BATCH)
    c = np.empty((node_count, 3))
    for k in range(len(weights)):
        for e in range(BATCH):
            if least[k, e] >= BARRIER_VOLUME:
                continue
            for t in range(len(triples)):
                F = _at_places(places[k], triples[t], e)
                value = _value_of(F)
                if value >= BARRIER_VOLUME:
                    continue
                _, slope, curvature = barrier(value)
                slope = 0.0 if projected else stiffness * weights[k, e] * slope
                curvature *= stiffness * weights[k, e]
                for a in range(node_count):
                    set_row(c, a, _value_gradient(F, gradients[k], triples[t], a, e))
                pair = 0
                for b in range(node_count):
                    for a in range(b, node_count):
                        if offsets[k, pair, e] >= 0:
                            v = _value_turning(F, gradients[k], triples[t], a, b, e)
                            block = scaled_matrix(cross_matrix(v), -slope)
                            block = add_outer(block, scaled(row(c, a), curvature), row(c, b))
                            add_block(block, offsets[k, pair, e], strides[k, pair, e], storage)
                        pair += 1


@njit(**ONCE)
def keeps_value(F, D, share):
    """Whether J_t stays above the kept share along F + s D for all s up to a share, from 0.

    Along it J_t is a cubic polynomial, which is bounded from below by its Bernstein coefficients.

    Args:
        F: Deformation at the three places where the move begins.
        D: Its change by the whole move.
        share: End of s.
    """
    E = (
        add_scaled_matrix(F[0], D[0], share), add_scaled_matrix(F[1], D[1], share),
        add_scaled_matrix(F[2], D[2], share),
    )  # fmt: skip
    least = KEPT_SHARE * 6.0 * _value_of(F)
    second = mixed_determinant(E[0], F[1], F[2]) + mixed_determinant(F[0], E[1], F[2])
    third = mixed_determinant(F[0], E[1], E[2]) + mixed_determinant(E[0], F[1], E[2])
    return (
        6.0 * _value_of(E) > least
        and second + mixed_determinant(F[0], F[1], E[2]) > 3.0 * least
        and third + mixed_determinant(E[0], E[1], F[2]) > 3.0 * least
    )


@njit(**KERNEL)
def largest_share_of_values(triples, weights, places, changes):
    """How much of a move may be made so that every positive value keeps a share of itself.

    Args:
        triples, weights: See `find_least_values`.
        places: F at the places where the move begins, shape (batch_count, place_count, 9 × BATCH).
        changes: Its change by the whole move, same shape.
    """
    share = 1.0
    for k in range(len(weights)):
        for e in range(BATCH):
            if weights[k, e] == 0.0:
                continue
            for t in range(len(triples)):
                F = _at_places(places[k], triples[t], e)
                if not _value_of(F) > 0.0:
                    continue
                D = _at_places(changes[k], triples[t], e)
                for _ in range(MOST_SHORTENINGS):
                    if keeps_value(F, D, share):
                        break
                    share *= SHORTER
    return share


class FoldBarrier:
    """The barrier of a body of elements; its arrays are allocated once.

    Attributes:
        acting_count: Values on which it acts at the state that was taken last.
        crossed_count: Elements there with a value that is not positive.
        folded_count: 0: `Elements` counts those that are inside out.
    """

    folded_count = 0

    def __init__(self, cells: np.ndarray, to_corners: np.ndarray, corners: WatchedCorners):
        """Find the places.

        Args:
            cells: Nodes of the elements, shape (element_count, node_count).
            to_corners: See `point_to_corner_weights`.
            corners: See `watched_corners`.
        """
        self._cells, self._corners = cells, corners
        first, second = np.triu_indices(len(to_corners), 1)
        self._to_places = np.concatenate([to_corners, 0.5 * (to_corners[first] + to_corners[second])])
        corner_count = len(self._corners.edges)
        self._triples = np.repeat(np.arange(corner_count)[:, None], 3, axis=1)
        if len(to_corners):
            self._triples = triples_of_parts()
        self.acting_count = self.crossed_count = 0

    def bind(self, batches: ElementBatches) -> None:
        """Lay out the places as the elements' batches.

        Args:
            batches: The elements.
        """
        self._batches = batches
        if len(self._to_places):
            self._gradients = np.einsum("pq,kqi->kpi", self._to_places, batches.gradients)
        else:
            self._gradients = self._corner_gradients(batches.order)
        batch_count, place_count = self._gradients.shape[:2]
        self._weights = batches.weights.sum(axis=1) / place_count
        self._places = np.zeros((batch_count, place_count, 9 * BATCH))
        self._least = np.empty((batch_count, BATCH))

    def _corner_gradients(self, order: np.ndarray) -> np.ndarray:
        """∇N_a of the map of the corners alone at each corner [1/m]; see `add_forces`."""
        edges, inverses = self._corners
        count, corner_count = inverses.shape[:2]
        gradients = np.zeros((count, corner_count, order.shape[1], 3))
        for corner, nodes in enumerate(edges):
            gradients[:, corner, nodes[1:]] = inverses[:, corner]
            gradients[:, corner, nodes[0]] = -inverses[:, corner].sum(axis=1)
        gradients = np.take_along_axis(gradients, order[:, None, :, None], axis=2)
        batches = in_batches(gradients.reshape(count, -1), 0.0)
        return batches.reshape(len(batches), corner_count, -1)

    def take(self, positions: np.ndarray, deformations: np.ndarray) -> bool:
        """Look at a state.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            deformations: F at the points, shape (batch_count, point_count, 9 × BATCH).

        Returns:
            Whether the barrier acts, if all points are upright.
        """
        self.acting_count = 0
        acts, self.crossed_count = self._find(positions, deformations, self._places, self._least)
        return acts

    def _find(self, positions, deformations, places, least) -> tuple[bool, int]:
        """Write F at the places, and the least value of each element; see `find_least_values`."""
        if not len(self._to_places):
            self._write_corners(positions, places)
        return find_least_values(
            self._to_places, self._triples, self._weights, deformations, places, least
        )

    def _write_corners(self, positions: np.ndarray, places: np.ndarray) -> None:
        write_corners(positions, self._cells, *self._corners, places)

    def add_forces(self, stiffness: float, forces: np.ndarray) -> None:
        """Add the forces at the state that was taken last, where the barrier acts; see the kernel.

        Args:
            stiffness: κ of the barrier [Pa].
            forces: Forces on the unknowns [N], shape (free_node_count, 3); added to.
        """
        self.acting_count = add_forces(
            stiffness, self._batches.free, self._gradients, self._triples, self._weights, self._places,
            self._least, forces,
        )  # fmt: skip

    def add_stiffness(self, stiffness: float, projected: bool, storage: np.ndarray) -> None:
        """Add the stiffness at the state that was taken last; see the kernel.

        Args:
            stiffness: κ of the barrier [Pa].
            projected: True for a part of it that is never negative.
            storage: The factorization's storage [N/m]; added to.
        """
        add_stiffness(
            stiffness, self._gradients, self._triples, self._weights, self._places, self._least,
            projected, self._batches.offsets, self._batches.strides, storage,
        )  # fmt: skip

    def energy(self, stiffness: float, positions: np.ndarray, deformations: np.ndarray) -> float:
        """Energy at a state of which all points are upright [J]; see `take`."""
        places, least = np.zeros_like(self._places), np.empty_like(self._least)
        if not self._find(positions, deformations, places, least)[0]:
            return 0.0
        return add_energies(stiffness, self._triples, self._weights, places, least)

    def places_at(self, positions: np.ndarray, deformations: np.ndarray) -> np.ndarray:
        """F at the places, shape (batch_count, place_count, 9 × BATCH); see `take`."""
        if len(self._to_places):
            return np.einsum("pq,kqi->kpi", self._to_places, deformations)
        places = np.zeros_like(self._places)
        self._write_corners(positions, places)
        return places

    def largest_share(self, begin: np.ndarray, end: np.ndarray) -> float:
        """How much of a move keeps a share of all values.

        Args:
            begin: F at the places where it begins, see `places_at`.
            end: F there where it ends.
        """
        return largest_share_of_values(self._triples, self._weights, begin, end - begin)
