"""Nodes that are held along some axes, and free along the others.

Such a node keeps its block of three unknowns. Along its held axes forces and entries of rows are
left out, and the diagonal of A is so large that A⁻¹ has nothing but zeros there, to round-off. So
no move has a component along them, and all that is solved with A is what elimination would give.
"""

from __future__ import annotations

import numpy as np

from softrobot_twin.kernels.compilation import KERNEL, njit
from softrobot_twin.mechanics.force_term import OwnBlocks
from softrobot_twin.mechanics.kinematics import add_plain_blocks

# Diagonal of A along held axes [N/m]: no other entry of any robot is seen beside it. No force has it.
HELD = 1.0e30


@njit(**KERNEL)
def leave_free(unknowns, free_axes, vectors):
    """Set the components of vectors along held axes to zero.

    Args:
        unknowns: Unknown of each vector, shape (count,).
        free_axes: See `Nodes.free_axes`.
        vectors: Forces, or entries of rows, shape (count, 3); changed.
    """
    for k in range(len(unknowns)):
        for i in range(3):
            vectors[k, i] *= free_axes[unknowns[k], i]


class HeldAxes(OwnBlocks):
    """The last force term of a scene that holds nodes along some axes: it leaves forces there out."""

    name = "held axes"
    is_traceable = True

    def __init__(self, free_axes: np.ndarray):
        """Find the nodes.

        Args:
            free_axes: See `Nodes.free_axes`.
        """
        own = np.flatnonzero((free_axes == 0.0).any(axis=1))
        self._every, self._free_axes, self._stencils = np.arange(len(free_axes)), free_axes, own[:, None]
        self._sources = 9 * np.arange(len(own))
        self._blocks = (HELD * (1.0 - free_axes[own])[:, :, None] * np.eye(3)).ravel()

    def add_forces(self, positions: np.ndarray, forces: np.ndarray) -> int:
        """Leave out the forces along held axes; see `ForceTerm.add_forces`."""
        leave_free(self._every, self._free_axes, forces)
        return 0

    def add_stiffness(self, positions: np.ndarray, storage: np.ndarray, projected: bool) -> None:
        """Add to the diagonal along held axes; see `ForceTerm.add_stiffness`."""
        add_plain_blocks(self._sources, self._offsets, self._strides, self._blocks, storage)
