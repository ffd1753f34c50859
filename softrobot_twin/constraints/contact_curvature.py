"""Contact curvature: how the gap of a facet that presses on a round shape changes as it tilts.

Where the inside of an edge or triangle of a body touches a round shape, the contact point rolls
along the facet as it tilts, and the gap is the least distance D over the facet's parameters t. With
p = x_0 + Σ t_i u_i, D_xx the curvature of the shape's distance and n its normal,

    ∂²gap/∂x² = … - Cᵀ S⁻¹ C ⊗ n nᵀ,    S_ij = u_iᵀ D_xx u_j,

C being the constant derivative of the u_i by the corners. The force λ n then stiffens the facet by
+λ Cᵀ S⁻¹ C ⊗ n nᵀ. Without it, facets tilt back and forth from step to step. It is positive
semidefinite, and its blocks are among those of the facet's element. The other part of the curvature
has the opposite sign, would make A indefinite, and is left out.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

# A facet along a straight side would be infinitely stiff: its curvature is at least this share of
# the curvature across. A greater share makes facets that are nearly along the side tilt too far:
# the contact point rolls from end to end and back, from step to step.
LEAST_CURVATURE = 1.0e-6
# A normal with less than this share along the axis belongs to the straight side.
ON_SIDE = 1.0e-3


@njit(cache=True, nogil=True, error_model="numpy")
def write_corner_stiffness(x, nodes, curvature, force, out):
    """λ Cᵀ S⁻¹ C of one facet; returns its number of corners, 0 where it cannot tilt."""
    corners = 0
    for k in range(3):
        if nodes[k] >= 0:
            corners += 1
    if corners < 2:
        return 0
    u = np.zeros((2, 3))
    first, edge = -1, 0
    for k in range(3):
        if nodes[k] < 0:
            continue
        if first < 0:
            first = nodes[k]
            continue
        for i in range(3):
            u[edge, i] = x[nodes[k], i] - x[first, i]
        edge += 1
    trace = curvature[0, 0] + curvature[1, 1] + curvature[2, 2]
    S = np.zeros((2, 2))
    shortest = np.inf
    for a in range(corners - 1):
        square = 0.0
        for i in range(3):
            square += u[a, i] * u[a, i]
        shortest = min(shortest, square)
        for b in range(corners - 1):
            for i in range(3):
                for j in range(3):
                    S[a, b] += u[a, i] * curvature[i, j] * u[b, j]
    floor = LEAST_CURVATURE * trace * shortest
    if corners == 2:
        k = force / max(S[0, 0], floor)
        out[0, 0], out[0, 1], out[1, 1] = k, -k, k
        return 2
    half, product = 0.5 * (S[0, 0] + S[1, 1]), S[0, 0] * S[1, 1] - S[0, 1] * S[0, 1]
    least = half - np.sqrt(max(half * half - product, 0.0))
    S[0, 0] += max(0.0, floor - least)
    S[1, 1] += max(0.0, floor - least)
    scale = force / (S[0, 0] * S[1, 1] - S[0, 1] * S[0, 1])
    k11, k12, k22 = scale * S[1, 1], -scale * S[0, 1], scale * S[0, 0]
    out[0, 0], out[0, 1], out[0, 2] = k11 + 2.0 * k12 + k22, -k11 - k12, -k12 - k22
    out[1, 1], out[1, 2], out[2, 2] = k11, k12, k22
    return 3


@njit(cache=True, nogil=True, error_model="numpy")
def add_facet(x, nodes, curvature, normal, force, keys, offsets, strides, work, storage):
    """Add one facet's stiffness to the system matrix."""
    corners = write_corner_stiffness(x, nodes, curvature, force, work)
    count, a = len(x), -1
    for k in range(3):
        if nodes[k] < 0 or corners == 0:
            continue
        a += 1
        b = a - 1
        for m in range(k, 3):
            if nodes[m] < 0:
                continue
            b += 1
            low, high = min(nodes[k], nodes[m]), max(nodes[k], nodes[m])
            place = np.searchsorted(keys, low * count + high)
            offset = offsets[place]
            if offset < 0:
                continue
            for j in range(3):
                for i in range(3):
                    storage[offset + i] += work[a, b] * normal[i] * normal[j]
                offset += strides[place]


@njit(cache=True, nogil=True, error_model="numpy")
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


@njit(cache=True, nogil=True, error_model="numpy")
def add_facets(
    x, pair, which, nodes, directions, forces, rows_per_contact, count, radius, axis, is_straight,
    has_round_ends, keys, offsets, strides, work, storage,
):  # fmt: skip
    """Add the stiffness of all facets that press on the shape of one pair."""
    for c in range(count):
        force, normal = forces[rows_per_contact * c], directions[c, 0]
        if which[c] != pair or not force > 0.0:
            continue
        if write_curvature(normal, radius, axis, is_straight, has_round_ends, work[0]):
            add_facet(
                x, nodes[c], work[0], normal, force, keys, offsets, strides, work[1], storage
            )


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
    axis: np.ndarray | None
    has_round_ends: bool

    def axis_at(self, positions: np.ndarray) -> np.ndarray:
        """Direction of its straight side now, shape (3,); zero where it has none."""
        if self.axis is None:
            return np.zeros(3)
        return self.carrier.pose(positions)[1] @ self.axis


class ContactCurvature:
    """Stiffness of all facets that press on round shapes."""

    def __init__(self, pairs: tuple[RoundPair, ...], free_index: np.ndarray):
        """Take the pairs.

        Args:
            pairs: Pairs of a deformable surface and a round shape.
            free_index: Unknown of each node, -1 where it has none, shape (node_count,).
        """
        self._pairs = pairs
        self._free_index = free_index
        self._work = np.zeros((2, 3, 3))

    def bind(self, elimination_rank: np.ndarray, slots) -> None:
        """Look up where the blocks of the surfaces' edges go.

        Args:
            elimination_rank: Place of each unknown in the elimination order.
            slots: The factorization's `slots`.
        """
        triangles = np.unique(np.concatenate([pair.triangles for pair in self._pairs]), axis=0)
        count = len(self._free_index)
        edges = [np.sort(triangles[:, c], axis=1) for c in ([0, 1], [1, 2], [2, 0])]
        low, high = np.concatenate([*edges, np.tile(np.unique(triangles)[:, None], 2)]).T
        self._keys = np.unique(low * count + high)
        ends = self._free_index[np.stack(np.divmod(self._keys, count))]
        # Facets on nodes without an unknown of their own are left out: this term is never negative.
        free = ((ends >= 0) & (ends < len(elimination_rank))).all(axis=0)
        ranks = elimination_rank[ends[:, free]]
        rows = np.where(ranks[0] >= ranks[1], ends[0, free], ends[1, free])
        columns = np.where(ranks[0] >= ranks[1], ends[1, free], ends[0, free])
        self._offsets = np.full(len(self._keys), -1, dtype=np.int64)
        self._strides = np.zeros(len(self._keys), dtype=np.int64)
        self._offsets[free], self._strides[free] = slots(rows, columns)
        # Nothing is left to be compiled at the first touch: where nothing touches, it adds nothing.
        self._add_pair(
            self._pairs[0], np.zeros((1, 3)), np.zeros(3), np.zeros(0, np.int64),
            np.zeros((0, 8), np.int64), np.zeros((0, 3, 3)), np.zeros(0), 1, 0, np.zeros(1),
        )  # fmt: skip

    def add(
        self, contacts, positions: np.ndarray, forces: np.ndarray, storage: np.ndarray
    ) -> None:
        """Add the stiffness of the contacts detected last.

        Args:
            contacts: The contacts.
            positions: Node positions [m], shape (node_count, 3).
            forces: λ of their rows [N], shape (row_count,).
            storage: The factorization's storage [N/m]; added to.
        """
        if not forces.any():
            return
        for pair in self._pairs:
            self._add_pair(
                pair, positions, pair.axis_at(positions), contacts.pair, contacts.nodes,
                contacts.directions, forces, contacts.rows_per_contact, contacts.count, storage,
            )  # fmt: skip

    def _add_pair(
        self, pair, positions, axis, which, nodes, directions, forces, rows_per_contact, count,
        storage,
    ) -> None:  # fmt: skip
        add_facets(
            positions, pair.index, which, nodes, directions, forces, rows_per_contact, count,
            pair.radius, axis, pair.axis is not None, pair.has_round_ends,
            self._keys, self._offsets, self._strides, self._work, storage,
        )  # fmt: skip
