"""The force term of a body of elements: mesh, shape functions, quadrature and a law."""

from __future__ import annotations

import numpy as np

from softrobot_twin.geometry.shape_functions import integration_points
from softrobot_twin.mechanics.element_assembly import assembly_of
from softrobot_twin.mechanics.element_batches import BATCH, in_batches
from softrobot_twin.mechanics.element_inversion import point_to_corner_weights
from softrobot_twin.mechanics.force_term import ForceTerm
from softrobot_twin.mechanics.point_law import law_of
from softrobot_twin.mechanics.stencil import bind_stencils


class Elements(ForceTerm):
    """Force term of elements of one shape with one law.

    The forces of the last state are stored, with the deformation and rotation of each point, and
    are reused as long as positions are the same to the bit: the state at the end of a step is that
    at the beginning of the next one.

    Attributes:
        law: Parameters of the law.
    """

    def __init__(self, mesh, free_index: np.ndarray, law: tuple):
        """Prepare the elements.

        Args:
            mesh: The body at rest, a `CellMesh`.
            free_index: Unknown of each node, -1 where it is fixed, shape (node_count,).
            law: Parameters of a registered law.
        """
        self.law = law
        self.name = f"{law_of(law).name} elements"
        self._mesh, self._free_index = mesh, free_index
        self._shape = mesh.shape_functions
        self._points = integration_points(mesh.node_positions, mesh.cells, self._shape)
        self._assembly = assembly_of(type(law))
        self._to_corners = point_to_corner_weights(self._shape)
        # Displacements are relative to the positions at which the gradients were computed.
        self._reference = mesh.node_positions
        self._constant_stiffness = None
        # Batches hold the elements' nodes in elimination order, which `bind` finds.
        self._cells = self._free = self._gradients = self._weights = None

    def stencils(self) -> np.ndarray:
        """Unknowns that each element couples, -1 where fixed, shape (element_count, node_count)."""
        return self._free_index[self._mesh.cells]

    def bind(self, elimination_rank: np.ndarray, slots) -> None:
        """Find the places of the stiffness, sort each element's nodes in their order, and form
        batches.

        Args:
            elimination_rank: Place of each unknown in the elimination order.
            slots: The factorization's `slots`.
        """
        bound = bind_stencils(self.stencils(), elimination_rank, slots)
        cells = np.take_along_axis(self._mesh.cells, bound.order, axis=1)
        order = bound.order[:, None, :, None]
        gradients = np.take_along_axis(self._points.gradients, order, axis=2)
        count, point_count = gradients.shape[:2]
        # The last batch is padded with copies of an element, without volume and unknowns.
        spare = slice((count - 1) % BATCH + 1, BATCH)
        self._cells = in_batches(cells, 0)
        self._cells[-1][:, spare] = cells[-1][:, None]
        self._free = in_batches(self._free_index[cells], -1)
        rows = gradients.reshape(count, -1)
        batches = in_batches(rows, 0.0)
        batches[-1][:, spare] = rows[-1][:, None]
        self._gradients = batches.reshape(len(batches), point_count, -1)
        self._weights = in_batches(self._points.weights, 0.0)
        self._offsets = in_batches(bound.offsets, -1)
        self._strides = in_batches(bound.strides, 0)
        self._deformations = np.zeros((len(batches), point_count, 9 * BATCH))
        entries = 9 if law_of(self.law).turns else 0
        self._rotations = np.zeros((len(batches), point_count, entries * BATCH))
        self._uprights = np.zeros((len(batches), point_count, BATCH))
        self._forget()
        self._constant_stiffness = None
        if law_of(self.law).is_linear:
            self._constant_stiffness = self._sum_stiffness_once(bound)

    def _forget(self) -> None:
        """Discard the stored state."""
        self._forces, self._known_at = np.empty((0, 3)), np.empty((0, 3))

    def _sum_stiffness_once(self, bound) -> np.ndarray:
        """The stiffness at rest, laid out as the factorization stores it."""
        present = bound.offsets >= 0
        last = (bound.offsets + 2 * bound.strides + 2)[present].max(initial=-1)
        storage = np.zeros(last + 1)
        forces = np.zeros((self._free_index.max() + 1, 3))
        self.add_forces(self._reference, forces)
        self._add_stiffness(self._reference, storage, projected=False, are_known=True)
        self._forget()
        return storage

    def add_forces(self, positions: np.ndarray, forces: np.ndarray) -> int:
        """Add -F(q) [N] to the forces on the unknowns, shape (free_node_count, 3).

        Returns:
            Number of elements that are flat or inside out.
        """
        self._forces = np.zeros_like(forces)
        inverted_count = self._assembly.add_forces(
            self.law, positions - self._reference, self._cells, self._free,
            self._gradients, self._weights, self._to_corners,
            self._deformations, self._rotations, self._uprights, self._forces,
        )  # fmt: skip
        self._known_at = positions.copy()
        forces += self._forces
        return inverted_count

    def add(self, positions, forces, storage, projected: bool) -> None:
        """Add -F(q) to the forces and ∂F/∂q to the system matrix.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            forces: Forces on the unknowns [N], shape (free_node_count, 3); added to.
            storage: The factorization's storage [N/m]; added to.
            projected: True for the positive semidefinite tangent, projected point by point.
        """
        are_known = np.array_equal(positions, self._known_at)
        if self._constant_stiffness is not None:
            if are_known:
                forces += self._forces
            else:
                self.add_forces(positions, forces)
            storage[: len(self._constant_stiffness)] += self._constant_stiffness
            return
        if not are_known:
            self._forces = np.zeros_like(forces)
        self._add_stiffness(positions, storage, projected, are_known)
        if not are_known:
            self._known_at = positions.copy()
        forces += self._forces

    def _add_stiffness(self, positions, storage, projected: bool, are_known: bool) -> None:
        self._assembly.add_stiffness(
            self.law, positions - self._reference, self._cells, self._free,
            self._gradients, self._weights, projected, are_known,
            self._deformations, self._rotations, self._uprights,
            self._offsets, self._strides, self._forces, storage,
        )  # fmt: skip

    def energy(self, positions: np.ndarray) -> float:
        """Stored elastic energy [J].

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        return self._assembly.add_energies(
            self.law, positions - self._reference, self._cells, self._gradients, self._weights,
            np.empty_like(self._rotations), np.empty_like(self._uprights),
        )  # fmt: skip
