"""The force term of a body of elements: mesh, shape functions, quadrature and a law."""

from __future__ import annotations

import numpy as np

from softrobot_twin.geometry.cell_mesh import node_counts_of, points_of
from softrobot_twin.geometry.shape_functions import MEAN_HEXAHEDRON, hourglass_fields
from softrobot_twin.geometry.smoothed_mesh import EdgeRings
from softrobot_twin.geometry.vector_arrays import (
    add_numbers,
    add_vectors,
    are_same,
    copy_vectors,
    make_unknown,
    write_differences,
)
from softrobot_twin.kernels.traced_stage import clear
from softrobot_twin.mechanics.assembly_parts import InParts, parts_of, sorted_along
from softrobot_twin.mechanics.block_addition import are_contiguous
from softrobot_twin.mechanics.compression_watch import CompressionWatch, coarseness
from softrobot_twin.mechanics.element_assembly import assembly_of, deform_all
from softrobot_twin.mechanics.element_batches import BATCH, lay_out_elements, stencils_of
from softrobot_twin.mechanics.element_inversion import (
    count_folded,
    point_to_corner_weights,
    watched_corners,
)
from softrobot_twin.mechanics.fold_barrier import FoldBarrier
from softrobot_twin.mechanics.force_term import ForceTerm
from softrobot_twin.mechanics.hourglass import Hourglass
from softrobot_twin.mechanics.material import LameParameters
from softrobot_twin.mechanics.point_law import law_of
from softrobot_twin.mechanics.ring_barrier import RingBarrier
from softrobot_twin.mechanics.strain_watch import StrainWatch, extreme_squares
from softrobot_twin.mechanics.volume_barrier import (
    add_barrier_energies,
    add_barrier_forces,
    add_barrier_stiffness,
    largest_share_of_points,
)

# Stretch by which the stiffness of a law at rest is measured.
SMALL_STRETCH = 1.0e-4
# Change of the deformation gradient over which its differential is differentiated.
CURVATURE_STEP = 2.0e-5


class Elements(InParts, ForceTerm):
    """Force term of elements of one shape with one law.

    The forces of the last state are stored, with the deformation and rotation of each point, and
    are reused as long as positions are the same to the bit: the state at the end of a step is that
    at the beginning of the next one.

    Attributes:
        law: Parameters of the law.
        strain_watch: Watches their strain, where their law has a range of strains; else None.
        compression_watch: Watches the compression of hexahedra; else None.
        has_energy: Whether it is elastic: what it does follows from the state alone.
        hourglass: What resists the motions of hexahedra that their points do not see; else None.
    """

    strain_watch: StrainWatch | None = None
    compression_watch: CompressionWatch | None = None
    hourglass: Hourglass | None = None
    has_energy = True
    is_traceable = True

    def __init__(self, mesh, free_index: np.ndarray, law: tuple):
        """Prepare the elements.

        Args:
            mesh: The body at rest, a `CellMesh`.
            free_index: Unknown of each node, -1 where it is fixed, shape (node_count,).
            law: Parameters of a registered law.
        """
        self.law = self._law_at_rest = law
        self.name = f"{law_of(law).name} elements"
        self.stays_upright = not law_of(law).is_linear
        mesh = sorted_along(mesh)
        self.mesh, self._free_index = mesh, free_index
        self._shape = mesh.shape_functions
        self._points = points_of(mesh)
        self._node_counts = node_counts_of(mesh)
        self._stencils = stencils_of(mesh.cells, self._node_counts, free_index)
        self._assembly = assembly_of(type(law))
        self._to_corners = point_to_corner_weights(self._shape)
        self._corners = watched_corners(mesh)
        # Where F is constant, its one point tells all.
        has_places = len(self._to_corners) > 0 or len(self._corners.edges) > 0
        self.fold_barrier: FoldBarrier | RingBarrier | None = None
        self._folded_count = 0
        if self.stays_upright and has_places:
            self.fold_barrier = FoldBarrier(mesh.cells, self._to_corners, self._corners)
        elif self.stays_upright and isinstance(mesh, EdgeRings):
            self.fold_barrier = RingBarrier(mesh.tets, free_index)
        # Displacements are relative to the positions at which the gradients were computed.
        self._reference = mesh.node_positions
        self._constant_stiffness = None
        # Batches hold the elements' nodes in elimination order, which `bind` finds.
        self._cells = self._free = self._gradients = self._weights = None

    def bind(self, elimination_rank: np.ndarray, slots) -> None:
        """Find the places of the stiffness, sort each element's nodes in their order, and form
        batches.

        Args:
            elimination_rank: Place of each unknown in the elimination order.
            slots: The factorization's `slots`.
        """
        batches = lay_out_elements(
            self.mesh.cells, self._node_counts, self._points, self._free_index, elimination_rank,
            slots,
        )  # fmt: skip
        self._cells, self._free, self._gradients, self._weights = batches[:4]
        self._offsets, self._strides = batches.offsets, batches.strides
        self._are_contiguous = are_contiguous(batches.offsets, batches.strides)
        self.parts = parts_of(batches.cells, batches.free, self.mesh.node_positions)
        batch_count, point_count = self._weights.shape[:2]
        self.deformations = np.zeros((batch_count, point_count, 9 * BATCH))
        entries = 9 if law_of(self.law).turns else 0
        self._rotations = np.zeros((batch_count, point_count, entries * BATCH))
        self._uprights = np.zeros((batch_count, point_count, BATCH))
        self._forces, self._known_at = np.empty((0, 3)), np.empty((0, 3))
        self._moves = np.empty_like(self._reference)
        self._forget()
        self._constant_stiffness = None
        self._barrier_stiffness = self._stretch_stiffness()
        if isinstance(self.fold_barrier, RingBarrier):
            self.fold_barrier.bind(elimination_rank, slots)
        elif self.fold_barrier is not None:
            self.fold_barrier.bind(batches)
        if self.mesh.shape_functions is MEAN_HEXAHEDRON:
            rest, cells = self.mesh.node_positions, self.mesh.cells
            fields = hourglass_fields(rest[cells], self._points.gradients[:, 0])
            self.hourglass = Hourglass(
                rest, fields, batches, self._lame_at_rest(), law_of(self.law).is_linear,
                self.has_energy,
            )  # fmt: skip
        if law_of(self.law).is_linear:
            self._constant_stiffness = self._sum_stiffness_once()

    def _add_fold_forces(self) -> None:
        """Add the forces of the barrier between points to those of the state that is known."""
        barrier = self.fold_barrier
        self.nearly_flat_count, self.crossed_count = self._nearly_flat_points, 0
        if barrier is None:
            return
        acts = barrier.take(self._known_at, self.deformations)
        self.crossed_count, self._folded_count = barrier.crossed_count, barrier.folded_count
        if acts and self._uprights.all():
            barrier.add_forces(self._barrier_stiffness, self._forces)
            self.nearly_flat_count += barrier.acting_count

    def _forget(self) -> None:
        """Discard the stored state."""
        make_unknown(self._known_at)
        self.nearly_flat_count = self.crossed_count = self._nearly_flat_points = 0

    def _stretch_stiffness(self) -> float:
        """The stiffness of the law at rest against a uniaxial stretch [Pa].

        Zero for a law of small displacements: in it det F says nothing of a volume.
        """
        if law_of(self.law).is_linear:
            return 0.0
        stretched = self._reference * [1.0 + SMALL_STRETCH, 1.0, 1.0]
        return 2.0 * self._law_energy(stretched)[0] / (self._weights.sum() * SMALL_STRETCH**2)

    def _lame_at_rest(self) -> LameParameters:
        """Lamé's constants of the law at small strains, from energies of a shear and of volumes."""
        size, volume = SMALL_STRETCH, self._weights.sum()
        rest = self.mesh.node_positions
        sheared = np.outer(rest[:, 1], [size, 0.0, 0.0])
        moves = (sheared, size * rest, -size * rest)
        of_shear, *of_volume = (
            assembly_of(type(self._law_at_rest)).add_energies(
                self._law_at_rest, move, self._cells, self._gradients, self._weights,
                np.empty_like(self.deformations), np.empty_like(self._uprights),
            ) for move in moves)  # fmt: skip
        mu = 2.0 * of_shear / (volume * size**2)
        kappa = sum(of_volume) / (9.0 * volume * size**2)
        return LameParameters(kappa - 2.0 * mu / 3.0, mu)

    def _sum_stiffness_once(self) -> np.ndarray:
        """The stiffness at rest, laid out as the factorization stores it."""
        present = self._offsets >= 0
        last = (self._offsets + 2 * self._strides + 2)[present].max(initial=-1)
        storage = np.zeros(last + 1)
        forces = np.zeros((self._free_index.max() + 1, 3))
        self.add_forces(self._reference, forces)
        self._add_stiffness(storage, False)
        self._forget()
        return storage

    def add_forces(self, positions: np.ndarray, forces: np.ndarray) -> int:
        """Add -F(q) [N] to the forces on the unknowns, shape (free_node_count, 3).

        Returns:
            Number of elements that are flat or inside out.
        """
        inverted_count = self._take_state(positions, forces.shape)
        add_vectors(self._forces, forces)
        if len(self._corners.edges):
            return count_folded(positions, self.mesh.cells, *self._corners, self._uprights)
        return max(inverted_count, self._folded_count)

    def _take_state(self, positions: np.ndarray, shape: tuple[int, int]) -> int:
        """Find -F(q) [N] and the states of all points, and count those inverted.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            shape: That of the forces, (free_node_count, 3).
        """
        if self._forces.shape != shape or self._known_at.shape != positions.shape:
            self._forces, self._known_at = np.empty(shape), np.empty(positions.shape)
        clear(self._forces.reshape(-1))
        copy_vectors(positions, self._known_at)
        inverted_count, acts = self.run_parts(
            self._assembly.add_forces, self.law, self._moved(positions), self._cells, self._free,
            self._gradients, self._weights, self._to_corners,
            self.deformations, self._rotations, self._uprights, self._forces,
        )  # fmt: skip
        self._nearly_flat_points = 0
        if acts and self._barrier_stiffness:
            self._nearly_flat_points = add_barrier_forces(
                self._barrier_stiffness, self._free, self._gradients, self._weights,
                self.deformations, self._forces,
            )  # fmt: skip
        if self.hourglass is not None:
            self.hourglass.take(positions)
            self.hourglass.add_forces(self.run_parts, self._forces)
        self._add_fold_forces()
        return inverted_count

    def _moved(self, positions: np.ndarray) -> np.ndarray:
        """Displacements from the reference [m], shape (node_count, 3); overwritten by the next call.
        """
        write_differences(positions, self._reference, self._moves)
        return self._moves

    def knows(self, positions: np.ndarray) -> bool:
        """Whether the forces at node positions [m] are stored; see `ForceTerm.knows`."""
        return self._is_stored(positions)

    def _is_stored(self, positions: np.ndarray) -> bool:
        """Whether the stored state is that at node positions [m], to the bit."""
        return are_same(positions, self._known_at)

    def _deformations_at(self, positions: np.ndarray) -> np.ndarray:
        """F at the points, shape (batch_count, point_count, 9 × BATCH), not to be changed.

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        if self._is_stored(positions):
            return self.deformations
        deformations = np.empty_like(self.deformations)
        deform_all(positions - self._reference, self._cells, self._gradients, deformations)
        return deformations

    def add(self, positions, forces, storage, projected: bool) -> None:
        """Add -F(q) to the forces and ∂F/∂q to the system matrix.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            forces: Forces on the unknowns [N], shape (free_node_count, 3); added to.
            storage: The factorization's storage [N/m]; added to.
            projected: True for the positive semidefinite tangent, projected point by point.
        """
        if not self._is_stored(positions):
            self._take_state(positions, forces.shape)
        add_vectors(self._forces, forces)
        if self._constant_stiffness is not None:
            add_numbers(self._constant_stiffness, storage)
            return
        self._add_stiffness(storage, projected)
        if self._nearly_flat_points:
            add_barrier_stiffness(
                self._barrier_stiffness, self._cells, self._gradients, self._weights,
                self.deformations, projected, self._offsets, self._strides, storage,
            )  # fmt: skip
        if self.fold_barrier is not None and self.fold_barrier.acting_count:
            self.fold_barrier.add_stiffness(self._barrier_stiffness, projected, storage)

    def _add_stiffness(self, storage, projected: bool) -> None:
        self.run_parts(
            self._assembly.add_stiffness, self.law, self._cells, self._gradients, self._weights, projected,
            self.deformations, self._rotations, self._uprights,
            self._offsets, self._strides, self._are_contiguous, storage,
        )  # fmt: skip
        self._add_hourglass_stiffness(storage, projected)

    def _add_hourglass_stiffness(self, storage, projected: bool) -> None:
        if self.hourglass is not None:
            self.hourglass.add_stiffness(self.run_parts, projected, self._are_contiguous, storage)

    def largest_share(self, before: np.ndarray, after: np.ndarray) -> float:
        """How much of a move may be made before an element loses most of its volume.

        Args:
            before: Node positions where the move begins [m], shape (node_count, 3).
            after: Those after the whole move [m], same shape.
        """
        if law_of(self.law).is_linear:
            return 1.0
        barrier = self.fold_barrier
        begin, end = self._deformations_at(before), self._deformations_at(after)
        share = largest_share_of_points(self._weights, begin, end - begin)
        if barrier is None:
            return share
        return min(share, barrier.largest_share(
            barrier.places_at(before, begin), barrier.places_at(after, end)
        ))  # fmt: skip

    def add_force_curvature(
        self, positions: np.ndarray, direction: np.ndarray, reach: float, curvature: np.ndarray
    ) -> None:
        """See `ForceTerm.add_force_curvature`; that of the barrier against flat elements is not added.

        Differences of the exact differential at the points, each over a step of its own, are exact
        to some ten digits.
        """
        if law_of(self.law).is_linear:
            return
        self._assembly.add_force_curvature(
            self.law, positions - self._reference, direction, self._cells, self._free,
            self._gradients, self._weights, CURVATURE_STEP, curvature,
        )  # fmt: skip
        if self.hourglass is not None:
            self.hourglass.add_force_curvature(positions, direction, curvature)
            self._forget()

    def extreme_squares(self, positions: np.ndarray, least: float, greatest: float) -> tuple[float, float]:
        """Squares of the least and greatest principal stretch beyond given ones.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            least: Only lower squares count.
            greatest: Only greater ones count.
        """
        return extreme_squares(self._deformations_at(positions), self._weights, least, greatest)

    @property
    def has_varied_strain(self) -> bool:
        """Whether its strain varies in cells beside what the law sees, and may be large."""
        return self.mesh.shape_functions is MEAN_HEXAHEDRON and not law_of(self.law).is_linear

    def coarseness(self, positions: np.ndarray, lame: LameParameters) -> float:
        """How coarse hexahedra are for their compression, too much above 1; see `compression_watch.py`.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            lame: Of its material at small strains, patches of volume included.
        """
        hourglass = self.hourglass
        if self._is_stored(positions):
            F, y = hourglass.deformations, hourglass.strains
        else:
            F, _, y = hourglass.measured_at(positions)
        return coarseness(F, self._weights[:, 0], hourglass.moduli, y, *lame)

    def energy(self, positions: np.ndarray) -> float:
        """Stored elastic energy [J].

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        energy, is_upright = self._law_energy(positions)
        if self.hourglass is not None:
            energy += self.hourglass.energy(positions)
        if self._barrier_stiffness and is_upright:
            deformations = self._deformations_at(positions)
            energy += add_barrier_energies(self._barrier_stiffness, self._weights, deformations)
            if self.fold_barrier is not None:
                energy += self.fold_barrier.energy(self._barrier_stiffness, positions, deformations)
        return energy

    def _law_energy(self, positions: np.ndarray) -> tuple[float, bool]:
        """Energy by the law alone [J], and whether all points are upright."""
        uprights = np.empty_like(self._uprights)
        energy = self._assembly.add_energies(
            self.law, positions - self._reference, self._cells, self._gradients, self._weights,
            np.empty_like(self._rotations), uprights,
        )  # fmt: skip
        return energy, bool(uprights.all())
