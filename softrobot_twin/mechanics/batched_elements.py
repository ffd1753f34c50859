"""Elements of one kind in batches: where their nodes, constants and stiffness lie in memory.

What an element is, linear or quadratic, is in its gradients at its quadrature points; what force it
has is up to the classes made from this one and the kernels that work on a batch.
"""

from __future__ import annotations

import numpy as np

from softrobot_twin.mechanics.force_term import ForceTerm
from softrobot_twin.mechanics.lanes import LANES, in_lanes
from softrobot_twin.mechanics.material import LameParameters
from softrobot_twin.mechanics.stencil import bind_stencils


class BatchedElements(ForceTerm):
    """Tetrahedra of any order and their places in the system.

    Attributes:
        material: Lamé's constants [Pa].
    """

    def __init__(
        self,
        mesh,
        free_index: np.ndarray,
        material: LameParameters,
        gradients: np.ndarray,
        weights: np.ndarray,
    ):
        """Prepare the elements.

        Args:
            mesh: The body at rest, its elements of k nodes.
            free_index: Free-node index of each node, -1 where it is fixed, shape (node_count,).
            material: Lamé's constants [Pa].
            gradients: Gradients of the shape functions at the quadrature points [1/m],
                shape (element_count, point_count, k, 3).
            weights: Volume that each point stands for [m³], shape (element_count,).
        """
        self.material = material
        self._mesh = mesh
        self._free_index = free_index
        self._gradients, self._weights = gradients, weights
        # Batches hold the elements' nodes in elimination order, which `bind` finds.
        self._tets = self._free = self._constants = self._offsets = self._strides = None

    def stencils(self) -> np.ndarray:
        """Free nodes that each element couples, -1 where fixed, shape (element_count, k)."""
        return self._free_index[self._mesh.tets]

    def bind(self, elimination_rank: np.ndarray, slots) -> None:
        """Look up where the stiffness goes, sort each element's nodes to suit, and batch."""
        bound = bind_stencils(self.stencils(), elimination_rank, slots)
        tets = np.take_along_axis(self._mesh.tets, bound.order, axis=1)
        gradients = np.take_along_axis(self._gradients, bound.order[:, None, :, None], axis=2)
        gradients = gradients.reshape(len(tets), -1)
        # Lanes beyond the last element repeat a whole one, without volume and without a place.
        spare = slice((len(tets) - 1) % LANES + 1, LANES)
        self._tets = in_lanes(tets, 0)
        self._tets[-1][:, spare] = tets[-1][:, None]
        self._free = in_lanes(self._free_index[tets], -1)
        batches = in_lanes(np.column_stack([gradients, self._weights]), 0.0)
        batches[-1][:-1, spare] = gradients[-1][:, None]
        self._constants = batches.reshape(len(batches), -1)
        self._offsets = in_lanes(bound.offsets, -1)
        self._strides = in_lanes(bound.strides, 0)
