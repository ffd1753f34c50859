"""The barrier against tetrahedra that fold inside a ring whose mean deformation does not.

Where strain is smoothed over edges (`smoothed_mesh.py`), the points of quadrature see the mean over
each ring. One tetrahedron of it can be flat or inside out while the mean is not. Therefore det F of
each tetrahedron is watched as well, and has the barrier of `volume_barrier.py` with its own volume.

A body of which a tetrahedron is flat or inside out has no such barrier: to unfold, others may have
to pass through flat shapes too. No move of a step makes one so (`ForceTerm.crossed_count`).
"""

from __future__ import annotations

import numpy as np

from softrobot_twin.geometry.cell_mesh import node_counts_of, points_of
from softrobot_twin.geometry.matrix3 import determinant
from softrobot_twin.geometry.vector_arrays import write_differences
from softrobot_twin.kernels.compilation import KERNEL, njit
from softrobot_twin.mechanics.element_assembly import deform_all
from softrobot_twin.mechanics.element_batches import BATCH, lay_out_elements, matrix_at
from softrobot_twin.mechanics.polar import is_upright
from softrobot_twin.mechanics.volume_barrier import (
    BARRIER_VOLUME,
    add_barrier_energies,
    add_barrier_forces,
    add_barrier_stiffness,
    largest_share_of_points,
)


@njit(**KERNEL)
def look_at_volumes(weights, deformations):
    """Whether the barrier acts on a tetrahedron, if none is flat or inside out, and how many are.

    Args:
        weights: Volumes [m³], 0 beyond the last one, shape (batch_count, 1, BATCH).
        deformations: F, shape (batch_count, 1, 9 × BATCH).
    """
    least, folded_count = np.inf, 0
    for k in range(len(weights)):
        for e in range(BATCH):
            F = matrix_at(deformations[k, 0], 0, e)
            if weights[k, 0, e] > 0.0:
                least = min(least, determinant(F))
                folded_count += not is_upright(F)
    return folded_count == 0 and least < BARRIER_VOLUME, folded_count


class RingBarrier:
    """The barrier of the tetrahedra of a body whose strain is smoothed.

    Attributes:
        acting_count: Tetrahedra on which it acts at the state that was taken last.
        crossed_count: Those there that are flat or inside out.
    """

    def __init__(self, tets, free_index: np.ndarray):
        """Take the tetrahedra.

        Args:
            tets: They at rest, as `Elements` takes them.
            free_index: Unknown of each node, -1 where it is fixed, shape (node_count,).
        """
        self._tets, self._free_index = tets, free_index
        self.acting_count = self.crossed_count = 0

    def bind(self, elimination_rank: np.ndarray, slots) -> None:
        """Form batches; every pair of nodes of a tetrahedron is in a ring. See `Elements.bind`."""
        tets = self._tets
        self._batches = lay_out_elements(
            tets.cells, node_counts_of(tets), points_of(tets), self._free_index, elimination_rank,
            slots,
        )  # fmt: skip
        self._deformations = np.empty((len(self._batches.weights), 1, 9 * BATCH))
        self._moves = np.empty_like(tets.node_positions)

    def places_at(self, positions: np.ndarray, deformations: np.ndarray) -> np.ndarray:
        """F of the tetrahedra, shape (batch_count, 1, 9 × BATCH); see `take`."""
        own = np.empty_like(self._deformations)
        moves = positions - self._tets.node_positions
        deform_all(moves, self._batches.cells, self._batches.gradients, own)
        return own

    def take(self, positions: np.ndarray, deformations: np.ndarray) -> bool:
        """Look at a state.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            deformations: F at the points of the rings, which do not tell.

        Returns:
            Whether the barrier acts, if all points are upright.
        """
        write_differences(positions, self._tets.node_positions, self._moves)
        deform_all(self._moves, self._batches.cells, self._batches.gradients, self._deformations)
        acts, self.crossed_count = look_at_volumes(self._batches.weights, self._deformations)
        self.acting_count = 0
        return acts

    @property
    def folded_count(self) -> int:
        """Tetrahedra that are flat or inside out at the state that was taken last."""
        return self.crossed_count

    def add_forces(self, stiffness: float, forces: np.ndarray) -> None:
        """Add the forces at the state that was taken last, where the barrier acts.

        Args:
            stiffness: κ [Pa].
            forces: Forces on the unknowns [N], shape (free_node_count, 3); added to.
        """
        self.acting_count = add_barrier_forces(
            stiffness, self._batches.free, self._batches.gradients, self._batches.weights, self._deformations, forces
        )

    def add_stiffness(self, stiffness: float, projected: bool, storage: np.ndarray) -> None:
        """Add the stiffness at the state that was taken last; see `add_barrier_stiffness`."""
        add_barrier_stiffness(
            stiffness, self._batches.cells, self._batches.gradients, self._batches.weights, self._deformations, projected,
            self._batches.offsets, self._batches.strides, storage,
        )  # fmt: skip

    def energy(self, stiffness: float, positions: np.ndarray, deformations: np.ndarray) -> float:
        """Energy at a state of which all points are upright [J]; see `take`."""
        own = self.places_at(positions, deformations)
        if not look_at_volumes(self._batches.weights, own)[0]:
            return 0.0
        return add_barrier_energies(stiffness, self._batches.weights, own)

    def largest_share(self, begin: np.ndarray, end: np.ndarray) -> float:
        """How much of a move keeps a share of the volume of each tetrahedron.

        Args:
            begin: F where it begins, see `places_at`.
            end: F where it ends.
        """
        return largest_share_of_points(self._batches.weights, begin, end - begin)
