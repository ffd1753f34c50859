"""Contact curvature: how the gap of a facet that presses on a round shape changes as it moves.

Where the inside of an edge or triangle of a body touches a round shape, the contact point rolls
along the facet as this tilts, or moves across an oblique cylinder, and the gap is the least
distance D over the facet's parameters t. With p = Σ c_k(t) x_k, u_i = ∂p/∂t_i, the shape's normal n
and the curvature D_xx of its distance,

    ∂²gap/∂x_k ∂x_m = c_k c_m D_xx - Σ_ij V_ik S⁻¹_ij V_jmᵀ,
    S_ij = u_iᵀ D_xx u_j,    V_ik = ∂c_k/∂t_i n + c_k D_xx u_i.

The force λ n then stiffens the facet by +λ Σ_ij V_ik S⁻¹_ij V_jmᵀ. Without it, facets tilt back and
forth from step to step. It is positive semidefinite, and its blocks are among those of the facet's
element. The other part, -λ c_k c_m D_xx, may make A indefinite; only `is_whole` takes it. The part
c_k D_xx u_i of V is left out where the shape moves, since what moves along with it does not roll,
and where `with_sliding` is False.

The corners a, b, c of a facet of a reduced body are points x = x₀ + D q of its coordinates. Only of
facets that press the stiffness K is folded, Eᵀ K E with E = [D_a; D_b; D_c], into the one block of
the coordinates.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softrobot_twin.kernels.compilation import KERNEL, ONCE, njit
from softrobot_twin.mechanics.kinematics import CarriedPoints, clique_slots

# A facet along a straight side would be infinitely stiff: its curvature is at least this share of
# the curvature across. A greater share makes facets that are nearly along the side tilt too far:
# the contact point rolls from end to end and back, from step to step.
LEAST_CURVATURE = 1.0e-6
# A normal with less than this share along the axis belongs to the straight side.
ON_SIDE = 1.0e-3


@njit(**ONCE)
def inverse_along(u, curvature, count, out):
    """S⁻¹ of one facet, bounded by `LEAST_CURVATURE`.

    Args:
        u: Sides of the facet from its first corner [m], shape (2, 3).
        curvature: D_xx [1/m], shape (3, 3).
        count: Number of sides, 1 or 2.
        out: Takes S⁻¹ [1/m], shape (2, 2).
    """
    S = np.zeros((2, 2))
    shortest = np.inf
    for a in range(count):
        shortest = min(shortest, np.dot(u[a], u[a]))
        for b in range(count):
            S[a, b] = np.dot(u[a], np.dot(curvature, u[b]))
    floor = LEAST_CURVATURE * np.trace(curvature) * shortest
    if count == 1:
        out[0, 0] = 1.0 / max(S[0, 0], floor)
        return
    half, product = 0.5 * (S[0, 0] + S[1, 1]), S[0, 0] * S[1, 1] - S[0, 1] * S[0, 1]
    least = half - np.sqrt(max(half * half - product, 0.0))
    S[0, 0] += max(0.0, floor - least)
    S[1, 1] += max(0.0, floor - least)
    scale = 1.0 / (S[0, 0] * S[1, 1] - S[0, 1] * S[0, 1])
    out[0, 0], out[1, 1] = scale * S[1, 1], scale * S[0, 0]
    out[0, 1] = out[1, 0] = -scale * S[0, 1]


@njit(**KERNEL, inline="always")
def write_facet_stiffness(x, nodes, weights, curvature, normal, force, slides, whole, out):
    """λ Vᵀ S⁻¹ V of one facet, or -λ ∂²gap/∂x², in blocks of its corners.

    Args:
        x: Node positions [m].
        nodes: Nodes of its corners, -1 where there is none, shape (3,).
        weights: c of the corners at the contact point, shape (3,).
        curvature: D_xx [1/m], shape (3, 3).
        normal: The shape's normal n, shape (3,).
        force: λ [N].
        slides: Whether what moves across the normal moves along the shape, which stands still.
        whole: Whether to take the part -λ c_k c_m D_xx too, where it slides.
        out: Takes the stiffness [N/m], three rows and columns for each corner, shape (9, 9).

    Returns:
        Number of corners, 0 where it cannot tilt.
    """
    corners = np.zeros(3, np.int64)
    count = 0
    for k in range(3):
        if nodes[k] >= 0:
            corners[count] = k
            count += 1
    out[:] = 0.0
    if count == 0 or count == 1 and not (slides and whole):
        return 0
    u, inverse, V = np.zeros((2, 3)), np.zeros((2, 2)), np.zeros((2, 3, 3))
    for a in range(count - 1):
        for i in range(3):
            u[a, i] = x[nodes[corners[a + 1]], i] - x[nodes[corners[0]], i]
    if count > 1:
        inverse_along(u, curvature, count - 1, inverse)
    for a in range(count - 1):
        across = np.dot(curvature, u[a])
        for k in range(count):
            along = -1.0 if k == 0 else 1.0 if k == a + 1 else 0.0
            for i in range(3):
                V[a, k, i] = along * normal[i]
                if slides:
                    V[a, k, i] += weights[corners[k]] * across[i]
    for k in range(count):
        for m in range(count):
            row, column = 3 * corners[k], 3 * corners[m]
            for i in range(3):
                for j in range(3):
                    total = 0.0
                    for a in range(count - 1):
                        for b in range(count - 1):
                            total += V[a, k, i] * inverse[a, b] * V[b, m, j]
                    if slides and whole:
                        total -= weights[corners[k]] * weights[corners[m]] * curvature[i, j]
                    out[row + i, column + j] = force * total
    return count


@njit(**KERNEL, inline="always")
def write_curvature(normal, radius, axis, is_straight, has_round_ends, out):
    """D_xx where a round shape is touched; False where it is flat, and its curvature zero.

    Args:
        normal: The shape's normal there, shape (3,).
        radius: Its radius [m].
        axis: Direction of its straight side, shape (3,).
        is_straight: It has such a side.
        has_round_ends: What is not its side is round too.
        out: Takes the curvature [1/m], shape (3, 3).
    """
    along = abs(normal[0] * axis[0] + normal[1] * axis[1] + normal[2] * axis[2])
    on_side = is_straight and along < ON_SIDE
    if is_straight and not on_side and not has_round_ends:
        out[:] = 0.0
        return False
    for i in range(3):
        for j in range(3):
            across = (1.0 if i == j else 0.0) - normal[i] * normal[j]
            if on_side:
                across -= axis[i] * axis[j]
            out[i, j] = across / radius
    return True


@njit(**KERNEL)
def write_facets(
    x, pair, which, nodes, coefficients, directions, forces, radius, axis, is_straight,
    has_round_ends, slides, whole, facets, stiffness,
):  # fmt: skip
    """Write the stiffness of all facets that press on the shape of one pair.

    Args:
        x: Node positions [m], shape (node_count, 3).
        pair: The pair.
        which: Pair of each contact, shape (count,) or longer.
        nodes: Nodes of each contact, of which the first three count, -1 where there is none,
            shape (capacity, width).
        coefficients: c of these nodes, same shape.
        directions: Normal and tangents of each contact, shape (capacity, 3, 3).
        forces: λ of the normal rows [N], shape (count,).
        radius: See `write_curvature`.
        axis: See there.
        is_straight: See there.
        has_round_ends: See there.
        slides: See `write_facet_stiffness`.
        whole: See there.
        facets: Output: the contacts of these facets, shape (count,).
        stiffness: Output: their stiffness [N/m], shape (count, 9, 9).

    Returns:
        Number of these facets.
    """
    curvature, count = np.zeros((3, 3)), 0
    for c in range(len(forces)):
        force, normal = forces[c], directions[c, 0]
        if which[c] != pair or not force > 0.0:
            continue
        if write_curvature(
            normal, radius, axis, is_straight, has_round_ends, curvature
        ) and write_facet_stiffness(
            x, nodes[c, :3], coefficients[c, :3], curvature, normal, force, slides, whole,
            stiffness[count],
        ):  # fmt: skip
            facets[count] = c
            count += 1
    return count


@njit(**KERNEL)
def add_facets(nodes, facets, stiffness, node_count, keys, offsets, strides, low_is_row, storage):
    """Add the stiffness of facets to the system matrix.

    Args:
        nodes: Nodes of each contact, see `write_facets`.
        facets: Contacts of the facets, shape (facet_count,).
        stiffness: Their stiffness [N/m], shape (facet_count, 9, 9).
        node_count: Number of nodes.
        keys: Pairs of nodes low × node count + high, ascending, shape (block_count,).
        offsets: Place of each pair's block in the storage, -1 for none, same shape.
        strides: Distance between two columns of that block, same shape.
        low_is_row: Whether the lower node of each pair is the block's row, same shape.
        storage: The factorization's storage [N/m]; added to.
    """
    for f in range(len(facets)):
        own = nodes[facets[f]]
        for k in range(3):
            for m in range(k, 3):
                if own[k] < 0 or own[m] < 0:
                    continue
                low, high = (k, m) if own[k] <= own[m] else (m, k)
                place = np.searchsorted(keys, own[low] * node_count + own[high])
                offset = offsets[place]
                if offset < 0:
                    continue
                row, column = (3 * low, 3 * high) if low_is_row[place] else (3 * high, 3 * low)
                for j in range(3):
                    for i in range(3):
                        storage[offset + i] += stiffness[f, row + i, column + j]
                    offset += strides[place]


@njit(**ONCE)
def fold_facet(stiffness, points, derivatives, half, offsets, strides, storage):
    """Add Eᵀ K E of one facet to the system matrix, E = [D_a; D_b; D_c].

    Args:
        stiffness: K [N/m], shape (9, 9).
        points: Carried point of each corner, -1 where there is none, shape (3,).
        derivatives: D of all carried points, shape (point_count, width, 3, 3).
        half: Work array for K E, shape (9, 3 width).
        offsets: Place of each block of two coordinate nodes, -1 above the diagonal, shape
            (width, width).
        strides: Distance of its columns, same shape.
        storage: The factorization's storage [N/m]; added to.
    """
    width = derivatives.shape[1]
    for r in range(9):
        for j in range(width):
            for b in range(3):
                total = 0.0
                for k in range(3):
                    if points[k] >= 0:
                        for i in range(3):
                            total += stiffness[r, 3 * k + i] * derivatives[points[k], j, i, b]
                half[r, 3 * j + b] = total
    for j in range(width):
        for m in range(width):
            if offsets[j, m] < 0:
                continue
            for b in range(3):
                place = offsets[j, m] + b * strides[j, m]
                for a in range(3):
                    total = 0.0
                    for k in range(3):
                        if points[k] >= 0:
                            for i in range(3):
                                D = derivatives[points[k], j, i, a]
                                total += D * half[3 * k + i, 3 * m + b]
                    storage[place + a] += total


@njit(**KERNEL)
def fold_facets(
    nodes, facets, stiffness, first_point, free_index, derivatives, half, offsets, strides, storage
):
    """Add the stiffness of facets of a reduced body to the system matrix.

    Args:
        nodes: Nodes of each contact, see `write_facets`.
        facets: Contacts of the facets, shape (facet_count,).
        stiffness: Their stiffness [N/m], shape (facet_count, 9, 9).
        first_point: Number of unknowns; carried points are numbered from here on.
        free_index: Unknown or carried point of each node, -1 where none, shape (node_count,).
        derivatives: This and the next four: see `fold_facet`.
        half: See there.
        offsets: See there.
        strides: See there.
        storage: See there.
    """
    points = np.zeros(3, np.int64)
    for f in range(len(facets)):
        for k in range(3):
            n = nodes[facets[f], k]
            points[k] = free_index[n] - first_point if n >= 0 else -1
        fold_facet(stiffness[f], points, derivatives, half, offsets, strides, storage)


class RoundPair(NamedTuple):
    """A deformable surface that may touch a round shape.

    Attributes:
        index: The pair's place among all that may touch.
        triangles: Nodes of the surface's triangles, shape (triangle_count, 3).
        carrier: What carries the shape; see `contact_pairs`.
        radius: The shape's radius [m].
        axis: Direction of its straight side in the carrier's frame, shape (3,), or None.
        has_round_ends: What is not its side is round too.
    """

    index: int
    triangles: np.ndarray
    carrier: object
    radius: float
    axis: np.ndarray
    has_round_ends: bool

    @property
    def stands(self) -> bool:
        """Whether the shape stands still."""
        return len(self.carrier.nodes) == 0

    def axis_at(self, positions: np.ndarray) -> np.ndarray:
        """Direction of its straight side now, shape (3,); zero where it has none.

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        return self.carrier.pose(positions)[1] @ self.axis


class CoordinateBlocks(NamedTuple):
    """Places in the storage of the blocks of a reduced body's coordinates.

    Attributes:
        offsets: Of the block of each two coordinate nodes, -1 above the diagonal, shape
            (width, width).
        strides: Distance of its columns, same shape.
    """

    offsets: np.ndarray
    strides: np.ndarray


class ContactCurvature:
    """Stiffness of all facets that press on round shapes.

    Attributes:
        with_sliding: Whether facets that move across a shape roll too. It makes W stiffer than the
            body is, by the part that is left out: good where W is only to lead to an equilibrium,
            not where its compliance decides what is best, nor where friction prevents the move.
        is_whole: With sliding, leave nothing out.
    """

    def __init__(
        self, pairs: tuple[RoundPair, ...], free_index: np.ndarray,
        carried: CarriedPoints | None = None,
    ):  # fmt: skip
        """Take the pairs.

        Args:
            pairs: Pairs of a deformable surface and a round shape.
            free_index: Unknown or carried point of each node, -1 where it has none, shape
                (node_count,).
            carried: The carried points of the scene; None without any.
        """
        self._pairs = pairs
        self._free_index, self._carried = free_index, carried
        self._blocks: dict[int, CoordinateBlocks] = {}
        self._half = np.zeros((9, 0 if carried is None else 3 * carried.unknowns.shape[1]))
        self.with_sliding = self.is_whole = False

    def bind(self, elimination_rank: np.ndarray, slots) -> None:
        """Look up where the blocks of the surfaces' edges go.

        Args:
            elimination_rank: Place of each unknown in the elimination order.
            slots: The factorization's `slots`.
        """
        self._unknown_count = len(elimination_rank)
        for pair in self._pairs:
            unknowns = self._coordinates_of(pair)
            if unknowns is not None:
                blocks = clique_slots(unknowns, elimination_rank, slots)
                self._blocks[pair.index] = CoordinateBlocks(*blocks)
        plain = [pair.triangles for pair in self._pairs if pair.index not in self._blocks]
        triangles = np.unique(np.concatenate([np.empty((0, 3), np.int64), *plain]), axis=0)
        count = len(self._free_index)
        edges = [np.sort(triangles[:, c], axis=1) for c in ([0, 1], [1, 2], [2, 0])]
        low, high = np.concatenate([*edges, np.tile(np.unique(triangles)[:, None], 2)]).T
        keys = np.unique(low * count + high)
        ends = self._free_index[np.stack(np.divmod(keys, count))]
        # Facets on nodes without an unknown of their own are left out: this term is never negative.
        free = ((ends >= 0) & (ends < len(elimination_rank))).all(axis=0)
        ranks = elimination_rank[ends[:, free]]
        low_is_row = np.ones(len(keys), dtype=np.bool_)
        low_is_row[free] = ranks[0] >= ranks[1]
        rows = np.where(ranks[0] >= ranks[1], ends[0, free], ends[1, free])
        columns = np.where(ranks[0] >= ranks[1], ends[1, free], ends[0, free])
        offsets = np.full(len(keys), -1, dtype=np.int64)
        strides = np.zeros(len(keys), dtype=np.int64)
        offsets[free], strides[free] = slots(rows, columns)
        self._of_nodes = count, keys, offsets, strides, low_is_row
        # Nothing is left to be compiled at the first touch: where nothing touches, it adds nothing.
        for pair in self._pairs:
            self._add_pair(
                pair, np.zeros((1, 3)), np.zeros(3), np.zeros(0, np.int64),
                np.zeros((0, 8), np.int64), np.zeros((0, 8)), np.zeros((0, 3, 3)), np.zeros(0),
                np.zeros(1),
            )  # fmt: skip

    def _coordinates_of(self, pair: RoundPair) -> np.ndarray | None:
        """Unknowns that carry all corners of a surface, as those of a reduced body; else None."""
        points = self._free_index[np.unique(pair.triangles)] - self._unknown_count
        if self._carried is None or not len(points) or points.min() < 0:
            return None
        return self._carried.shared_unknowns(points)

    def add(self, contacts, positions: np.ndarray, forces: np.ndarray, storage: np.ndarray) -> None:
        """Add the stiffness of the contacts detected last.

        Args:
            contacts: The contacts.
            positions: Node positions [m], shape (node_count, 3).
            forces: λ of their rows [N], shape (row_count,).
            storage: The factorization's storage [N/m]; added to.
        """
        if not forces.any():
            return
        normal_forces = forces[contacts.row_starts[:-1]]
        for pair in self._pairs:
            self._add_pair(
                pair, positions, pair.axis_at(positions), contacts.pair, contacts.nodes,
                contacts.coefficients, contacts.directions, normal_forces, storage,
            )  # fmt: skip

    def couples_one_facet(self, contacts) -> np.ndarray:
        """Whether the row of each contact couples nodes of one facet only, shape (count,).

        So it is where a facet of free and fixed nodes presses on a shape that stands still.

        Args:
            contacts: The contacts detected last, a `Contacts`.
        """
        standing = np.array([pair.index for pair in self._pairs if pair.stands], np.int64)
        nodes = contacts.nodes[: contacts.count, :3]
        own = (nodes < 0) | (self._free_index[nodes] < self._unknown_count)
        return np.isin(contacts.pair[: contacts.count], standing) & own.all(axis=1)

    def add_row_stiffness(self, contacts, stiffness: np.ndarray, storage: np.ndarray) -> None:
        """Add k h hᵀ of the normal rows h of contacts to the system matrix.

        Args:
            contacts: The contacts.
            stiffness: k of each, zero where its row couples more than a facet [N/m],
                shape (count,).
            storage: The factorization's storage [N/m]; added to.
        """
        facets = np.flatnonzero(stiffness > 0.0)
        weights, normals = contacts.coefficients[facets, :3], contacts.directions[facets, 0]
        shares = stiffness[facets, None, None] * weights[:, :, None] * weights[:, None, :]
        # Of k_cm and k_mc round-off would make two numbers.
        shares = np.triu(shares) + np.triu(shares, 1).transpose(0, 2, 1)
        rows = shares[:, :, None, :, None] * normals[:, None, :, None, None]
        blocks = (rows * normals[:, None, None, None, :]).reshape(-1, 9, 9)
        add_facets(contacts.nodes, facets, blocks, *self._of_nodes, storage)

    def _add_pair(
        self, pair, positions, axis, which, nodes, coefficients, directions, forces, storage
    ) -> None:
        count = len(forces)
        facets, stiffness = np.empty(count, np.int64), np.empty((count, 9, 9))
        count = write_facets(
            positions, pair.index, which, nodes, coefficients, directions, forces, pair.radius,
            axis, bool(pair.axis.any()), pair.has_round_ends, self.with_sliding and pair.stands,
            self.is_whole, facets, stiffness,
        )  # fmt: skip
        facets, stiffness = facets[:count], stiffness[:count]
        blocks = self._blocks.get(pair.index)
        if blocks is None:
            add_facets(nodes, facets, stiffness, *self._of_nodes, storage)
            return
        fold_facets(
            nodes, facets, stiffness, self._unknown_count, self._free_index,
            self._carried.derivatives, self._half, *blocks, storage,
        )  # fmt: skip
