"""Cavities of bodies in the coordinates of a basis: their volume is a cubic polynomial.

The vertices of a closed surface are x = r + Φ q, and V is a sum of products of three of them
(`mechanics/cavity_surfaces.py`). With the symmetric trilinear form whose value V(x, x, x) is V,

    V(q) = V₀ + g·q + ½ qᵀ B q + ⅙ T(q, q, q),
    H = g + B q + ½ T(q, q),    ∂H/∂q = B + T(q),

    g = 3 V(r, r, Φ),    B = 6 V(r, Φ, Φ),    T = 6 V(Φ, Φ, Φ).

The coefficients are summed over the triangles once, so nothing is sampled, and a step costs the
same for any number of triangles. Rows have entries at the coordinates only.

T is symmetric. Its entries with m ≤ n ≤ p are summed; to be evaluated, it is stored by m and by
pairs n ≤ p. T(q) is then one product of a vector and a matrix, which is faster than a loop over the
sixth of the entries that differ.

A closed surface has the same volume wherever it is, so the mean over its vertices is taken off r
and every mode first: large coordinates that mostly carry a cavity along leave no round-off.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import combinations_with_replacement
from typing import NamedTuple

import numpy as np

from softrobot_twin.constraints.constraint_term import ConstraintTerm
from softrobot_twin.geometry.vector3 import row
from softrobot_twin.geometry.vector_arrays import are_same
from softrobot_twin.kernels.compilation import KERNEL, njit
from softrobot_twin.mechanics.barycentric import BarycentricMapping
from softrobot_twin.mechanics.cavity_surfaces import (
    CavitySurface,
    add_volume_gradients,
    add_volumes,
    share_of_volumes,
    sphere_volumes,
    surface_area,
)
from softrobot_twin.mechanics.stencil import add_stencil_matrix, bind_stencils

# Triangles whose coefficients are summed at once; it bounds the memory.
CHUNK = 2048

FAST = {**KERNEL, "fastmath": {"reassoc", "contract"}}


class ReducedWalls(NamedTuple):
    """Walls of cavities on one body, and the basis in which it moves.

    Attributes:
        surfaces: Walls, each closed, on the nodes of the body numbered from 0. Several may have the
            name of one cavity: their volumes sum up.
        rest_positions: The nodes of the body at rest [m], shape (node_count, 3).
        basis: Φ along the axes of the world, shape (node_count, 3, mode_count).
        coordinate_nodes: Nodes of the scene whose positions are the coordinates, three each,
            shape (mode_count / 3,).
    """

    surfaces: tuple[CavitySurface, ...]
    rest_positions: np.ndarray
    basis: np.ndarray
    coordinate_nodes: np.ndarray

# --- the coefficients ----------------------------------------------------------------------------


class VolumePolynomial(NamedTuple):
    """Coefficients of the growth V - V₀ of closed surfaces; see the module.

    Attributes:
        linear: g [m²], shape (mode_count,).
        quadratic: B [m], shape (mode_count, mode_count).
        cubic: T, entries with m ≤ n ≤ p in that order, p fastest,
            shape (mode_count (mode_count + 1) (mode_count + 2) / 6,).
    """

    linear: np.ndarray
    quadratic: np.ndarray
    cubic: np.ndarray


def volume_polynomial(surface: CavitySurface, walls: ReducedWalls) -> VolumePolynomial:
    """Sum the coefficients of a closed surface over its triangles.

    Args:
        surface: One of the surfaces of the body.
        walls: The body.
    """
    mapping, triangles = surface.vertices, np.asarray(surface.triangles, np.int64)
    modes = walls.basis.shape[2]
    points = mapping.positions(walls.rest_positions)
    points = points - points.mean(axis=0)
    mean = mapping.mean()
    common = np.tensordot(mean.barycentric_weights[0], walls.basis[mean.nodes[0]], axes=1)
    linear, quadratic = np.zeros(modes), np.zeros((modes, modes))
    cubic = np.zeros(modes * (modes + 1) * (modes + 2) // 6)
    for first in range(0, len(triangles), CHUNK):
        used, corners = np.unique(triangles[first : first + CHUNK], return_inverse=True)
        shapes = _modes_at(mapping, used, walls.basis) - common
        _add_coefficients(
            np.ascontiguousarray(points[used]), shapes, corners.reshape(-1, 3), linear, quadratic,
            cubic,
        )  # fmt: skip
    return VolumePolynomial(linear, 0.5 * (quadratic + quadratic.T), cubic)


def rest_volume(surface: CavitySurface, walls: ReducedWalls) -> float:
    """V₀ of a closed surface [m³].

    Args:
        surface: One of the surfaces of the body.
        walls: The body.
    """
    points, triangles = surface.vertices.positions(walls.rest_positions), surface.triangles
    volume, none = np.zeros(1), np.zeros(len(triangles), np.int64)
    add_volumes(points, np.asarray(triangles, np.int64), none, none[:1], volume)
    return float(volume[0])


def _modes_at(mapping: BarycentricMapping, points: np.ndarray, basis: np.ndarray) -> np.ndarray:
    """Displacement of some of the points by each mode, shape (count, 3, mode_count)."""
    shapes = np.zeros((len(points), *basis.shape[1:]))
    for nodes, weights in zip(
        mapping.nodes[points].T, mapping.barycentric_weights[points].T, strict=True
    ):
        shapes += weights[:, None, None] * basis[nodes]
    return shapes


def _add_coefficients(points, shapes, triangles, linear, quadratic, cubic) -> None:
    """Add what some triangles contribute to g, B and T."""
    modes = shapes.shape[2]
    changes = np.empty_like(shapes)
    # The triangles alone are not closed: volumes are those of cones with their tip in the mean.
    tip, tipped = len(points), np.vstack([points, np.zeros(3)])
    gradients = np.zeros_like(tipped)
    add_volume_gradients(tipped, triangles, np.zeros(len(triangles), np.int64), np.array([tip]), gradients)
    rows = shapes.reshape(-1, modes)
    linear += gradients[:tip].ravel() @ rows
    write_gradient_changes(points, shapes, triangles, 0, changes)
    quadratic += rows.T @ changes.reshape(-1, modes)
    place = 0
    for m in range(modes):
        write_gradient_changes(shapes[:, :, m].copy(), shapes, triangles, m, changes)
        own = rows[:, m:].T @ changes.reshape(-1, modes)[:, m:]
        upper = own[np.triu_indices(modes - m)]
        cubic[place : place + len(upper)] += upper
        place += len(upper)


@njit(**FAST)
def write_gradient_changes(points, shapes, triangles, first, changes):
    """Change of ∂V/∂x of each vertex by every mode: Σ (x_j × φ_k + φ_j × x_k) / 6.

    Args:
        points: x, shape (vertex_count, 3).
        shapes: φ of every mode, shape (vertex_count, 3, mode_count).
        triangles: Their vertices, shape (triangle_count, 3).
        first: Modes before this one are left out.
        changes: Written from this mode on, shape (vertex_count, 3, mode_count).
    """
    count = shapes.shape[2]
    changes[:, :, first:] = 0.0
    for t in range(len(triangles)):
        for corner in range(3):
            i = triangles[t, corner]
            j, k = triangles[t, (corner + 1) % 3], triangles[t, (corner + 2) % 3]
            x, y = row(points, j), row(points, k)
            out, a, b = changes[i], shapes[j], shapes[k]
            for p in range(first, count):
                a0, a1, a2 = a[0, p], a[1, p], a[2, p]
                b0, b1, b2 = b[0, p], b[1, p], b[2, p]
                out[0, p] += (x[1] * b2 - x[2] * b1 + a1 * y[2] - a2 * y[1]) / 6.0
                out[1, p] += (x[2] * b0 - x[0] * b2 + a2 * y[0] - a0 * y[2]) / 6.0
                out[2, p] += (x[0] * b1 - x[1] * b0 + a0 * y[1] - a1 * y[0]) / 6.0


# --- the polynomials at a state ------------------------------------------------------------------


def by_pairs(cubic: np.ndarray, mode_count: int) -> np.ndarray:
    """T by its first index and pairs n ≤ p of the others, p fastest.

    Args:
        cubic: Entries with m ≤ n ≤ p; see `VolumePolynomial`.
        mode_count: Number of coordinates.

    Returns:
        Shape (mode_count, mode_count (mode_count + 1) / 2).
    """
    pair = np.zeros((mode_count, mode_count), np.int64)
    n, p = np.triu_indices(mode_count)
    pair[n, p] = np.arange(len(n))
    m, n, p = np.array(list(combinations_with_replacement(range(mode_count), 3))).T
    entries = np.empty((mode_count, len(pair) * (len(pair) + 1) // 2))
    entries[m, pair[n, p]] = entries[n, pair[m, p]] = entries[p, pair[m, n]] = cubic
    return entries


@njit(**FAST)
def evaluate_volumes(q, linear, quadratic, contracted, growths, gradients, stiffness):
    """Growths, their gradients H and ∂H/∂q of several cavities of one body.

    Args:
        q: Coordinates [m], shape (mode_count,).
        linear: g, shape (cavity_count, mode_count).
        quadratic: B, shape (cavity_count, mode_count, mode_count).
        contracted: T(q) of all cavities, pairs n ≤ p with p fastest, shape (entry_count,).
        growths: V - V₀; written, shape (cavity_count,).
        gradients: H; written, same shape as g.
        stiffness: ∂H/∂q; written, same shape as B.
    """
    count, place = len(q), 0
    for c in range(len(growths)):
        K, growth = stiffness[c], 0.0
        for m in range(count):
            for n in range(m, count):
                K[m, n] = K[n, m] = contracted[place]
                place += 1
        for m in range(count):
            line, own = K[m], quadratic[c, m]
            second, third = 0.0, 0.0
            for n in range(count):
                second += own[n] * q[n]
                third += line[n] * q[n]
                line[n] += own[n]
            gradients[c, m] = linear[c, m] + second + third / 2.0
            growth += q[m] * (linear[c, m] + second / 2.0 + third / 6.0)
        growths[c] = growth


@njit(**KERNEL)
def add_pressures(order, offsets, strides, pressures, stiffness, matrix, storage):
    """Add -Σ p ∂H/∂q of the cavities of one body.

    Args:
        order: See `add_stencil_matrix`, as for the next two, shape (mode_count / 3,).
        offsets: Place of each pair's block in the storage, -1 for none, shape (pair_count,).
        strides: Distance between two columns of that block, same shape.
        pressures: p of each cavity [Pa], shape (cavity_count,).
        stiffness: ∂H/∂q of each cavity [m], shape (cavity_count, mode_count, mode_count).
        matrix: Memory for the sum [N/m], shape (mode_count, mode_count); overwritten.
        storage: The factorization's storage [N/m]; added to.
    """
    matrix[:] = 0.0
    for c in range(len(pressures)):
        p = pressures[c]
        if p != 0.0:
            for m in range(len(matrix)):
                for n in range(len(matrix)):
                    matrix[m, n] -= p * stiffness[c, m, n]
    add_stencil_matrix(order, offsets, strides, matrix, storage)


class BodyVolumes:
    """Volumes of the cavities of one body by its coordinates.

    The last state is stored, and reused as long as the coordinates are the same to the bit.

    The coefficients are summed when the term is bound, or evaluated without: to find the points
    that a scene needs, terms are built that are neither.

    Attributes:
        rows: Row of each cavity whose walls move, shape (cavity_count,).
        rest_volumes: Volume of each cavity of the scene in this body at rest [m³], fixed walls
            included, shape (row_count,).
        unknowns: Those of the coordinates, shape (mode_count / 3,).
        growths: V - V₀ at the state evaluated last [m³], shape (cavity_count,).
        gradients: H there [m²], shape (cavity_count, mode_count).
        stiffness: ∂H/∂q there [m], shape (cavity_count, mode_count, mode_count).
    """

    def __init__(self, names: Sequence[str], walls: ReducedWalls, free_index: np.ndarray):
        """Find the cavities that move.

        Args:
            names: Names of all cavities of the scene, in the order of their rows.
            walls: Walls on the body.
            free_index: Unknown of each node of the scene, shape (node_count,).
        """
        self._walls = walls
        self._nodes = np.asarray(walls.coordinate_nodes, np.int64)
        self.unknowns = np.asarray(free_index)[self._nodes]
        self.rest_volumes, moving = np.zeros(len(names)), set()
        for surface in walls.surfaces:
            place = names.index(surface.name)
            self.rest_volumes[place] += rest_volume(surface, walls)
            used = surface.vertices.barycentric_weights != 0.0
            if walls.basis[np.unique(surface.vertices.nodes[used])].any():
                moving.add(place)
        self.rows = np.array(sorted(moving), np.int64)
        self._names = [names[place] for place in self.rows]
        count, modes = len(self.rows), walls.basis.shape[2]
        self.growths, self.gradients = np.zeros(count), np.zeros((count, modes))
        self.stiffness = np.zeros((count, modes, modes))
        self._known_at = np.full((len(self._nodes), 3), np.nan)
        self._matrix = np.zeros((modes, modes))
        self._linear = self._quadratic = self._cubic = self._contracted = self._bound = None

    def _sum_coefficients(self) -> None:
        """Sum the coefficients of each cavity."""
        sums = []
        for name in self._names:
            surfaces = (own for own in self._walls.surfaces if own.name == name)
            parts = zip(*(volume_polynomial(own, self._walls) for own in surfaces), strict=True)
            sums.append(VolumePolynomial(*map(sum, parts)))
        self._linear = np.array([own.linear for own in sums])
        self._quadratic = np.array([own.quadratic for own in sums])
        self._cubic = np.hstack([by_pairs(own.cubic, len(own.linear)) for own in sums])
        self._contracted = np.empty(self._cubic.shape[1])

    @property
    def entry_rows(self) -> np.ndarray:
        """Row of each entry of H, shape (entry_count,)."""
        return np.repeat(self.rows, len(self.unknowns))

    @property
    def entry_nodes(self) -> np.ndarray:
        """Unknown of each entry, shape (entry_count,)."""
        return np.tile(self.unknowns, len(self.rows))

    def coordinates(self, positions: np.ndarray) -> np.ndarray:
        """q [m], shape (mode_count / 3, 3).

        Args:
            positions: Positions of the nodes of the scene [m], shape (node_count, 3).
        """
        return positions[self._nodes]

    def evaluate(self, coordinates: np.ndarray) -> None:
        """Evaluate the polynomials.

        Args:
            coordinates: q [m], shape (mode_count / 3, 3).
        """
        if are_same(coordinates, self._known_at):
            return
        self._known_at = coordinates
        if self._cubic is None:
            self._sum_coefficients()
        q = coordinates.ravel()
        np.dot(q, self._cubic, out=self._contracted)
        evaluate_volumes(
            q, self._linear, self._quadratic, self._contracted, self.growths, self.gradients,
            self.stiffness,
        )  # fmt: skip

    def bind(self, elimination_rank: np.ndarray, slots: Callable) -> None:
        """Sum the coefficients, and find the places of the stiffness; see `ConstraintTerm.bind`."""
        if self._cubic is None:
            self._sum_coefficients()
        bound = bind_stencils(self.unknowns[None], elimination_rank, slots)
        self._bound = tuple(field[0] for field in bound)

    def add_stiffness(self, positions: np.ndarray, multipliers: np.ndarray, storage: np.ndarray) -> None:
        """Add that of the pressures; see `ConstraintTerm.add_stiffness`."""
        pressures = multipliers[self.rows]
        if pressures.any():
            self.evaluate(self.coordinates(positions))
            add_pressures(*self._bound, pressures, self.stiffness, self._matrix, storage)


class ReducedCavities(ConstraintTerm):
    """Constraint term of cavities that are actuators, on bodies that move in a basis.

    As of `Cavities`, the displacement of a cavity is its growth δ = V(q) - V₀, and its multiplier
    is the gauge pressure. A cavity in which nothing moves has no entries.

    Attributes:
        bodies: The volumes of each body by its coordinates.
        surfaces: Walls of each cavity, placed by the nodes of the scene, as pictures show them.
        row_count: Number of cavities.
        rest_volumes: Volume of each at rest [m³], shape (row_count,).
        rest_areas: Area of its walls at rest [m²], shape (row_count,).
        sphere_volumes: Volume of a sphere with that area [m³], shape (row_count,).
    """

    name = "cavities"
    group = "actuators"

    def __init__(
        self, names: Sequence[str], bodies: Sequence[ReducedWalls], free_index: np.ndarray,
        surfaces: tuple[CavitySurface, ...] = (),
    ):  # fmt: skip
        """Lay out the rows.

        Args:
            names: Name of each cavity, in the order of the rows.
            bodies: Their walls on each body.
            free_index: Unknown of each node of the scene, shape (node_count,).
            surfaces: Walls of each cavity for pictures.
        """
        self.surfaces = surfaces
        names = tuple(names)
        self.row_count = len(names)
        self.bodies = tuple(BodyVolumes(names, walls, free_index) for walls in bodies)
        self.rest_volumes = sum((b.rest_volumes for b in self.bodies), np.zeros(len(names)))
        self.rest_areas = np.zeros(len(names))
        for walls in bodies:
            for surface in walls.surfaces:
                points = surface.vertices.positions(walls.rest_positions)
                area = surface_area(points, surface.triangles)
                self.rest_areas[names.index(surface.name)] += area
        self.scales, self.sphere_volumes = self.rest_volumes, sphere_volumes(self.rest_areas)
        # It answers what pictures and limits ask of `CavitySurfaces`.
        self.walls = self
        none = [np.empty(0, np.int64)]
        self.entry_rows = np.concatenate(none + [body.entry_rows for body in self.bodies])
        self.entry_nodes = np.concatenate(none + [body.entry_nodes for body in self.bodies])
        ends = np.cumsum([0, *(len(body.entry_rows) for body in self.bodies)])
        self._parts = [
            (body, slice(first, last))
            for body, first, last in zip(self.bodies, ends[:-1], ends[1:], strict=True)
            if last > first
        ]  # fmt: skip

    def volumes(self, positions: np.ndarray) -> np.ndarray:
        """Volumes [m³], shape (row_count,).

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        return self._volumes_at([body.coordinates(positions) for body, _ in self._parts])

    def _volumes_at(self, coordinates: Sequence[np.ndarray]) -> np.ndarray:
        volumes = self.rest_volumes.copy()
        for (body, _), q in zip(self._parts, coordinates, strict=True):
            body.evaluate(q)
            volumes[body.rows] += body.growths
        return volumes

    def stencils(self) -> np.ndarray:
        """Coordinates that the walls on each body couple, all of them, -1 where none.

        Returns:
            A line for each body with walls that move, shape (body_count, width).
        """
        width = max((len(body.unknowns) for body, _ in self._parts), default=1)
        stencils = np.full((len(self._parts), width), -1, np.int64)
        for line, (body, _) in zip(stencils, self._parts, strict=True):
            line[: len(body.unknowns)] = body.unknowns
        return stencils

    def bind(self, elimination_rank: np.ndarray, slots: Callable) -> None:
        """Find the places of the stiffness in the storage."""
        for body, _ in self._parts:
            body.bind(elimination_rank, slots)

    def evaluate(self, positions: np.ndarray, blocks: np.ndarray, values: np.ndarray) -> None:
        """Write H and the growths δ [m³]; see `ConstraintTerm.evaluate`."""
        values[:] = 0.0
        for body, entries in self._parts:
            body.evaluate(body.coordinates(positions))
            blocks[entries] = body.gradients.reshape(-1, 3)
            values[body.rows] += body.growths

    def add_stiffness(
        self, positions: np.ndarray, multipliers: np.ndarray, storage: np.ndarray,
        projected: bool = False,
    ) -> None:
        """Add the stiffness of the pressures; see `ConstraintTerm.add_stiffness`.

        Projected, it adds nothing: of -p ∂²V no part is known that is never negative.
        """
        if projected:
            return
        for body, _ in self._parts:
            body.add_stiffness(positions, multipliers, storage)

    def largest_share(self, positions: np.ndarray, move: np.ndarray) -> float:
        """Share of a move that leaves every cavity a volume; see `ConstraintTerm`."""
        begin = [body.coordinates(positions) for body, _ in self._parts]
        moves = [move[body.unknowns] for body, _ in self._parts]
        return share_of_volumes(
            lambda share: self._volumes_at(
                [q + share * dq for q, dq in zip(begin, moves, strict=True)]
            ),
            self.sphere_volumes,
        )  # fmt: skip
