"""The energy of volume changes, over patches of elements: elements that do not lock.

Rubber hardly changes its volume. Where every element has to keep its own, a mesh has nearly no
shapes left (it locks). Here the volumes of patches are kept, and the elements resist changes of
shape. With the volume v_P and that at rest V_P,

    v = Σ_e Σ_q w_q det F_q,    E = Σ_P V κ U(v/V),    p = κ U'(v/V)

    f_a  = -p g_a,    g_a = ∂v/∂x_a = Σ w c_a,    c_a = cof(F) ∇N_a
    K_ab = κ U''/V g_a g_bᵀ + p ∂g_a/∂x_b,        ∂c_a/∂x_b = -[F (∇N_a × ∇N_b)]×

with U of `volume_change.py`. Projected, the last part is left out: it has both signs. This is the
F-bar method of patches (de Souza Neto et al. 2005) as an energy, or a
pressure that is constant in a patch and eliminated.

Elements keep a small share of the bulk modulus, `element_bulk`, which resists what a patch does not
see: one part of it that swells while another one shrinks, as the two sides of a wall in bending do.
The sizes of patches and this share were chosen by measurement (docs/elements.md, "Rubber").

Arguments of the kernels here; those of one element or patch have no first axis:
    G: ∇N_a at one point [1/m], shape (nodes, 3).
    cell: Nodes of the elements, shape (element_count, nodes).
    curvature: Of each pair of a patch [m], shape (width, width, 3), or (0, 0, 0).
    forces: On the unknowns [N], shape (free_node_count, 3).
    free: Unknowns of the nodes of each patch, shape (patch_count, width).
    g: ∂v/∂x_a [m²], shape (width, 3).
    gradients: ∇N_a at each point [1/m], shape (element_count, point_count, nodes, 3).
    moves, x: Moves and positions of the nodes [m], shape (node_count, 3).
    places: Nodes among those of the patch, shape (element_count, nodes).
    t: A vector, three numbers.
    waits_for_all, state, done, parts: See `assembly_parts.py`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softrobot_twin.geometry.cell_mesh import points_of
from softrobot_twin.geometry.cell_patches import grow_patches
from softrobot_twin.geometry.matrix3 import (
    IDENTITY,
    add_outer,
    cofactor,
    determinant,
    transform,
)
from softrobot_twin.geometry.smoothed_mesh import EdgeRings
from softrobot_twin.geometry.vector3 import add_scaled, cross, dot, row, scaled, set_row
from softrobot_twin.geometry.vector_arrays import write_differences
from softrobot_twin.kernels.compilation import INLINED, INNER, KERNEL, ONCE, njit
from softrobot_twin.mechanics.assembly_parts import InParts, groups_along, next_part, parts_of
from softrobot_twin.mechanics.block_addition import (
    add_blocks,
    add_contiguous_blocks,
    are_contiguous,
)
from softrobot_twin.mechanics.element_batches import BATCH, in_batches, put_vector, scratch
from softrobot_twin.mechanics.force_term import ForceTerm
from softrobot_twin.mechanics.point_law import has_bulk_modulus
from softrobot_twin.mechanics.stencil import bind_stencils
from softrobot_twin.mechanics.volume_change import volumetric

PATCH_SIZES = {4: 12, 10: 2}
"""Tetrahedra of a patch, by the nodes of one. Hexahedra are patches by themselves."""
RING_PATCH_SIZE = 8
"""Tetrahedra of a patch where strain is smoothed over edges."""
_LINEAR_BULK, _OTHER_BULK = 0.5, 5.0


class Divided(NamedTuple):
    """A law, divided between elements and patches.

    Attributes:
        law: Parameters of the elements' law.
        bulk_modulus: κ of the patches [Pa]; zero where elements keep all of it.
    """

    law: tuple
    bulk_modulus: float


def element_bulk(mesh) -> float:
    """Largest bulk modulus that elements keep, by their shear modulus.

    Linear tetrahedra are too stiff in bending anyway; the others are as stiff as a beam with it.

    Args:
        mesh: The elements, as far as `Elements` needs them.
    """
    return _LINEAR_BULK if mesh.shape_functions.node_count == 4 else _OTHER_BULK


def divided(law: tuple, shear_modulus: float, share: float) -> Divided:
    """Leave elements a small bulk modulus, and patches the rest.

    Args:
        law: Parameters of a law for which `can_divide` is true.
        shear_modulus: µ at rest [Pa].
        share: Bulk modulus that elements keep at most, by µ; see `element_bulk`.
    """
    kept = min(law.bulk_modulus, share * shear_modulus)
    if has_bulk_modulus(type(law)):
        return Divided(law._replace(bulk_modulus=kept), law.bulk_modulus - kept)
    return Divided(law.with_bulk_modulus(kept), law.bulk_modulus - kept)


class Patched(NamedTuple):
    """Cells, and the patches over which their volumes are summed.

    Attributes:
        mesh: The cells, as far as `Elements` needs them.
        patches: Number of each cell's patch, from 0, shape (cell_count,).
    """

    mesh: object
    patches: np.ndarray


def patched_cells(mesh, patch_size: int | None = None) -> Patched:
    """Patches of elements: a few tetrahedra, or a single element of another kind.

    Args:
        mesh: The elements, as far as `Elements` needs them; of rings the tetrahedra are taken.
        patch_size: Tetrahedra of a patch; by default that of `PATCH_SIZES` or `RING_PATCH_SIZE`.
    """
    size = patch_size or PATCH_SIZES.get(mesh.shape_functions.node_count, 1)
    if isinstance(mesh, EdgeRings):
        mesh, size = mesh.tets, patch_size or RING_PATCH_SIZE
    if size == 1:
        return Patched(mesh, np.arange(len(mesh.cells)))
    return Patched(mesh, grow_patches(mesh.cells[:, :4], size))


@njit(**INNER)
def deformation(moves, cell, gradients):
    """F = 1 + Σ u_a ∇N_aᵀ of one element at one point."""
    F = IDENTITY
    for a in range(len(cell)):
        F = add_outer(F, row(moves, cell[a]), row(gradients, a))
    return F


@njit(**KERNEL)
def write_volumes(moves, cells, first, gradients, weights, volumes):
    """v of all patches.

    Args:
        moves: Moves of the nodes from where gradients were taken [m], shape (node_count, 3).
        cells: Nodes of the elements, patch after patch, shape (element_count, nodes).
        first: First element of each patch, and the number of all, shape (patch_count + 1,).
        gradients: ∇N_a at each point [1/m], shape (element_count, point_count, nodes, 3).
        weights: Volume of each point at rest [m³], shape (element_count, point_count).
        volumes: v [m³]; written, shape (patch_count,).
    """
    for k in range(len(volumes)):
        volumes[k] = 0.0
        for e in range(first[k], first[k + 1]):
            for q in range(weights.shape[1]):
                F = deformation(moves, cells[e], gradients[e, q])
                volumes[k] += weights[e, q] * determinant(F)


@njit(**INLINED)
def _add_to_pair(a, b, t, curvature):
    """Add t of a pair of nodes of a patch, or -t of the pair the other way round."""
    sign, sums = 1.0 if a > b else -1.0, curvature[max(a, b), min(a, b)]
    for i in range(3):
        sums[i] += sign * t[i]


@njit(**ONCE)
def _add_curvature(F, G, places, w, curvature):
    """Add w F (∇N_a × ∇N_b) of one point; see `write_gradients`."""
    for a in range(len(G)):
        for b in range(a):
            turn = transform(F, cross(row(G, a), row(G, b)))
            _add_to_pair(places[a], places[b], scaled(turn, w), curvature)


@njit(**ONCE)
def _add_tetrahedron(x, cell, places, g, curvature):
    """Add volume and derivatives of a linear tetrahedron by its edges; see `write_gradients`.

    With the edges a, b, c from its first node, v = a·(b × c)/6, ∂v/∂x_1 = (b × c)/6 and so on.
    """
    first = row(x, cell[0])
    a = scaled(add_scaled(row(x, cell[1]), first, -1.0), 1.0 / 6.0)
    b = add_scaled(row(x, cell[2]), first, -1.0)
    c = add_scaled(row(x, cell[3]), first, -1.0)
    by_a, by_b, by_c = scaled(cross(b, c), 1.0 / 6.0), cross(c, a), cross(a, b)
    origin = places[0]
    for node, change in ((1, by_a), (2, by_b), (3, by_c)):
        place = places[node]
        set_row(g, place, add_scaled(row(g, place), change, 1.0))
        set_row(g, origin, add_scaled(row(g, origin), change, -1.0))
    if len(curvature) > 0:
        b, c = scaled(b, 1.0 / 6.0), scaled(c, 1.0 / 6.0)
        _add_to_pair(places[1], places[0], add_scaled(b, c, -1.0), curvature)
        _add_to_pair(places[2], places[0], add_scaled(c, a, -1.0), curvature)
        _add_to_pair(places[3], places[0], add_scaled(a, b, -1.0), curvature)
        _add_to_pair(places[1], places[2], c, curvature)
        _add_to_pair(places[2], places[3], a, curvature)
        _add_to_pair(places[3], places[1], b, curvature)
    return 6.0 * dot(a, by_a)


@njit(**INLINED)
def write_gradients(k, x, moves, cells, places, first, gradients, weights, g, curvature):
    """v of one patch; adds its derivatives.

    Args:
        k: The patch.
        x: Node positions [m], shape (node_count, 3).
        moves, cells, first, gradients, weights: See `write_volumes`.
        places: Each element's nodes among those of its patch, shape (element_count, nodes).
        g: ∂v/∂x_a [m²]; added to, shape (width, 3).
        curvature: Σ w F (∇N_a × ∇N_b) of each pair a > b [m]; added to, shape (width, width, 3).
            Without entries where it is not needed.

    Returns:
        v [m³].
    """
    volume = 0.0
    for e in range(first[k], first[k + 1]):
        if cells.shape[1] == 4:
            volume += _add_tetrahedron(x, cells[e], places[e], g, curvature)
            continue
        for q in range(weights.shape[1]):
            w, G = weights[e, q], gradients[e, q]
            F = deformation(moves, cells[e], G)
            C = cofactor(F)
            volume += w * determinant(F)
            for a in range(len(G)):
                place = places[e, a]
                set_row(g, place, add_scaled(row(g, place), transform(C, row(G, a)), w))
            if len(curvature) > 0:
                _add_curvature(F, G, places[e], w, curvature)
    return volume


@njit(**KERNEL)
def add_patch_forces(waits_for_all, state, done, parts, bulk_modulus, rest_volumes, x, moves, cells,
                     places, first, gradients, weights, free, forces):  # fmt: skip
    """Subtract p g of all patches from the forces on the unknowns.

    Args:
        bulk_modulus: κ [Pa].
        rest_volumes: V [m³], shape (patch_count,).
        x, moves, cells, places, first, gradients, weights: See `write_gradients`.
        free: Unknowns of each patch's nodes, -1 where there are none, shape (patch_count, width).
        forces: Forces on the unknowns [N], shape (free_node_count, 3); added to.
    """
    g, none = np.empty((free.shape[1], 3)), np.empty((0, 0, 3))
    part = next_part(-1, parts, waits_for_all, state, done)
    while part < len(parts.begins) - 1:
        for batch in parts.batches[parts.begins[part] : parts.begins[part + 1]]:
            for k in range(batch * BATCH, min((batch + 1) * BATCH, len(free))):
                g[:] = 0.0
                volume = write_gradients(k, x, moves, cells, places, first, gradients, weights, g, none)
                pressure = bulk_modulus * volumetric(volume / rest_volumes[k])[1]
                _subtract_pressure(pressure, g, free[k], forces)
        part = next_part(part, parts, waits_for_all, state, done)


@njit(**INLINED)
def _subtract_pressure(pressure, g, free, forces):
    """Subtract p g of one patch from the forces on its unknowns."""
    for a in range(len(g)):
        n = free[a]
        if n >= 0:
            set_row(forces, n, add_scaled(row(forces, n), row(g, a), -pressure))


@njit(**ONCE)
def write_block(stiffness, pressures, of_a, of_b, turns, K):
    """K_ab of a batch of patches, column by column.

    Args:
        stiffness: κ U''/V, shape (BATCH,).
        pressures: p; zero where the curvature is left out, shape (BATCH,).
        of_a, of_b: g of both nodes, shape (3, BATCH).
        turns: The curvature of the pair, same shape.
        K: The blocks; written, shape (9 × BATCH,).
    """
    for e in range(BATCH):
        row = scaled((of_a[0, e], of_a[1, e], of_a[2, e]), stiffness[e])
        x, y, z = scaled((turns[0, e], turns[1, e], turns[2, e]), pressures[e])
        first, second, third = scaled(row, of_b[0, e]), scaled(row, of_b[1, e]), scaled(row, of_b[2, e])
        put_vector(K, 0, e, (first[0], first[1] - z, first[2] + y))
        put_vector(K, 1, e, (second[0] + z, second[1], second[2] - x))
        put_vector(K, 2, e, (third[0] - y, third[1] + x, third[2]))


@njit(**KERNEL)
def add_patch_stiffness(waits_for_all, state, done, parts, bulk_modulus, projected, rest_volumes, x,
                        moves, cells, places, first, gradients, weights, free, offsets, strides,
                        are_contiguous, forces, storage):  # fmt: skip
    """Subtract p g of all patches from the forces, and add their stiffness.

    Args:
        bulk_modulus, rest_volumes, x, moves, cells, places, first, gradients, weights, free,
            forces: See `add_patch_forces`; the nodes of a patch in elimination order.
        projected: True for a positive semidefinite stiffness.
        offsets: Place of each block, see `bind_stencils`, -1 beyond the last patch, shape
            (batch_count, pair_count, BATCH).
        strides: Distance of its columns, same shape.
        are_contiguous: Whether all blocks are contiguous.
        storage: The factorization's storage [N/m]; added to.
    """
    width = free.shape[1]
    K, stiffness, pressures = scratch(9), scratch(1), scratch(1)
    g, curvature = np.zeros((width, 3, BATCH)), np.zeros((width, width, 3, BATCH))
    own, turns = np.empty((width, 3)), np.empty((width, width, 3))
    part = next_part(-1, parts, waits_for_all, state, done)
    while part < len(parts.begins) - 1:
        for k in parts.batches[parts.begins[part] : parts.begins[part + 1]]:
            for e in range(min(BATCH, len(free) - k * BATCH)):
                n = k * BATCH + e
                own[:] = 0.0
                turns[:] = 0.0
                volume = write_gradients(
                    n, x, moves, cells, places, first, gradients, weights, own, turns
                )
                for a in range(width):
                    for i in range(3):
                        g[a, i, e] = own[a, i]
                        for b in range(a):
                            curvature[a, b, i, e] = turns[a, b, i]
                _, slope, second = volumetric(volume / rest_volumes[n])
                stiffness[e] = bulk_modulus * second / rest_volumes[n]
                pressures[e] = 0.0 if projected else bulk_modulus * slope
                _subtract_pressure(bulk_modulus * slope, own, free[n], forces)
            pair = 0
            for b in range(width):
                for a in range(b, width):
                    write_block(stiffness, pressures, g[a], g[b], curvature[a, b], K)
                    if are_contiguous:
                        add_contiguous_blocks(offsets[k, pair], K, storage)
                    else:
                        add_blocks(offsets[k, pair], strides[k, pair], K, storage)
                    pair += 1
        part = next_part(part, parts, waits_for_all, state, done)


class PatchVolumes(InParts, ForceTerm):
    """Force term of the volumes of all patches of a material.

    Attributes:
        bulk_modulus: κ [Pa].
        patch_count: Number of patches.
    """

    name = "patch volumes"
    is_traceable = True

    def __init__(self, mesh, free_index: np.ndarray, bulk_modulus: float, patches: np.ndarray):
        """Prepare the patches.

        Args:
            mesh: The elements at rest, as `Elements` takes them.
            free_index: Unknown of each node, -1 where it is fixed, shape (node_count,).
            bulk_modulus: κ [Pa].
            patches: Number of each element's patch, from 0, shape (element_count,). Here they are
                numbered as `groups_along` does.
        """
        self.bulk_modulus = float(bulk_modulus)
        self.patch_count = int(patches.max()) + 1
        patches = groups_along(mesh, patches)
        order = np.argsort(patches, kind="stable")
        points, numbers = points_of(mesh), patches[order]
        self._cells = np.ascontiguousarray(mesh.cells[order], np.int64)
        self._gradients = np.ascontiguousarray(points.gradients[order])
        self._weights = np.ascontiguousarray(points.weights[order])
        self._first = np.searchsorted(numbers, np.arange(self.patch_count + 1))
        self._rest_volumes = np.add.reduceat(self._weights.sum(axis=1), self._first[:-1])
        self._reference, self._moves = mesh.node_positions, np.empty_like(mesh.node_positions)
        self._number_nodes(numbers)
        nodes = self._nodes
        self._stencils = np.where(nodes >= 0, free_index[nodes], -1)
        self._offsets = self._strides = None

    def _number_nodes(self, numbers: np.ndarray) -> None:
        """List each patch's nodes once, and find each element's nodes in its list."""
        node_count = len(self._reference)
        keys, inverse = np.unique(numbers[:, None] * node_count + self._cells, return_inverse=True)
        patch, node = np.divmod(keys, node_count)
        begin = np.searchsorted(patch, np.arange(self.patch_count))
        column = np.arange(len(keys)) - begin[patch]
        self._nodes = np.full((self.patch_count, int(column.max()) + 1), -1, np.int64)
        self._nodes[patch, column] = node
        self._places = np.ascontiguousarray(column[inverse.reshape(self._cells.shape)])

    def bind(self, elimination_rank: np.ndarray, slots) -> None:
        """See `ForceTerm.bind`; sorts the nodes of each patch in elimination order."""
        bound = bind_stencils(self._stencils, elimination_rank, slots)
        self._nodes = bound.sorted(self._nodes)
        self._stencils = bound.sorted(self._stencils)
        moved = np.argsort(bound.order, axis=1, kind="stable")
        patch = np.repeat(np.arange(self.patch_count), np.diff(self._first))
        self._places = np.ascontiguousarray(moved[patch[:, None], self._places])
        self._are_contiguous = are_contiguous(bound.offsets, bound.strides)
        self._offsets, self._strides = in_batches(bound.offsets, -1), in_batches(bound.strides, 0)
        self.parts = parts_of(in_batches(self._nodes, -1), in_batches(self._stencils, -1), self._reference)

    def add_forces(self, positions: np.ndarray, forces: np.ndarray) -> int:
        """Add -∂E/∂q [N]; see `ForceTerm.add_forces`. Elements count what is flat."""
        self.run_parts(
            add_patch_forces, self.bulk_modulus, self._rest_volumes, positions, self._moved(positions), self._cells, self._places, self._first, self._gradients,
            self._weights, self._stencils, forces,
        )  # fmt: skip
        return 0

    def add(self, positions, forces, storage, projected: bool) -> None:
        """Add forces and stiffness; see `ForceTerm.add`."""
        self.run_parts(
            add_patch_stiffness, self.bulk_modulus, projected, self._rest_volumes, positions,
            self._moved(positions), self._cells, self._places, self._first, self._gradients,
            self._weights, self._stencils, self._offsets, self._strides, self._are_contiguous, forces,
            storage,
        )  # fmt: skip

    def _moved(self, positions: np.ndarray) -> np.ndarray:
        write_differences(positions, self._reference, self._moves)
        return self._moves

    def volume_ratios(self, positions: np.ndarray) -> np.ndarray:
        """v/V of each patch, shape (patch_count,).

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        volumes = np.empty(self.patch_count)
        write_volumes(
            self._moved(positions), self._cells, self._first, self._gradients, self._weights,
            volumes,
        )  # fmt: skip
        return volumes / self._rest_volumes

    def pressures(self, positions: np.ndarray) -> np.ndarray:
        """-p of each patch: what it presses with, positive where it is compressed [Pa].

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        ratios = self.volume_ratios(positions)
        return -self.bulk_modulus * np.array([volumetric(J)[1] for J in ratios])

    def energy(self, positions: np.ndarray) -> float:
        """E [J]; see `ForceTerm.energy`."""
        ratios = self.volume_ratios(positions)
        densities = np.array([volumetric(J)[0] for J in ratios])
        return self.bulk_modulus * float(self._rest_volumes @ densities)
