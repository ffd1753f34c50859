"""Forces at points of bodies as actuators: their effort is the force, their displacement its dual.

A force λ acts at the point x = Σ w_a x_a along a unit vector d: on the nodes as Hᵀ λ, H_a = w_a dᵀ.

- Where d stands in the world, H is constant, and the displacement is δ = d · (x - x_rest).
- Where d turns with the body, d = R d_rest with the rotation R of a patch or a frame
  (`effector_orientation.py`). No displacement has this H for its derivative, because the work of
  such a force depends on the way: δ = d · (x - x_rest) is only told. The stiffness of the turning
  load,

      -λ w_a ∂d/∂x_b = λ w_a [d]ₓ T [R s_b]ₓ,    T = (tr V - V)⁻¹,

  is not symmetric; its symmetric part is added.

On a frame, a turning point adds the same terms as the pull of a cable (`kinematics.py`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.sparse as sp

from softrobot_twin.constraints.constraint_term import ConstraintTerm
from softrobot_twin.constraints.effector_orientation import write_rotations
from softrobot_twin.constraints.row_stack import add_row_forces
from softrobot_twin.constraints.spread_stiffness import MOST_COUPLED
from softrobot_twin.geometry.vector3 import dot, row, scaled, set_row
from softrobot_twin.kernels.compilation import KERNEL, njit
from softrobot_twin.kernels.traced_stage import clear
from softrobot_twin.mechanics.barycentric import BarycentricMapping
from softrobot_twin.mechanics.kinematics import CarriedPoints, FoldedStiffness
from softrobot_twin.mechanics.stencil import bind_stencils, lower_pairs, stacked


class PointForce(NamedTuple):
    """One force.

    Attributes:
        point: Where it acts: one point.
        direction: d at rest, a unit vector, shape (3,).
        patch: Nodes and arms [m] by whose rotation d turns, and whether they are a rigid frame;
            None where d stands in the world.
    """

    point: BarycentricMapping
    direction: np.ndarray
    patch: tuple[np.ndarray, np.ndarray, bool] | None = None


@njit(**KERNEL)
def write_force_rows(x, nodes, weights, rows, entries, directions, places, blocks, values):
    """Write w_a d of every node, and d · (x - x_rest) of every force.

    Args:
        x: Node positions [m], shape (node_count, 3).
        nodes: Nodes that carry the points, point after point, shape (n,).
        weights: w of each, same shape.
        rows: Force of each, same shape.
        entries: Entry of H of each, -1 where it does not move, same shape.
        directions: d of every force, shape (force_count, 3).
        places: x_rest of every force [m], same shape.
        blocks: Takes the entries of H, shape (entry_count, 3).
        values: Takes δ [m], shape (force_count,).
    """
    values[:] = 0.0
    for n in range(len(nodes)):
        d, weight = row(directions, rows[n]), weights[n]
        values[rows[n]] += weight * dot(d, row(x, nodes[n]))
        if entries[n] >= 0:
            set_row(blocks, entries[n], scaled(d, weight))
    for r in range(len(values)):
        values[r] -= dot(row(directions, r), row(places, r))


class PointForces(ConstraintTerm):
    """Constraint term of forces whose directions stand in the world.

    Attributes:
        points: Where each acts.
    """

    name = "forces"
    group = "actuators"
    is_traceable = True

    def __init__(
        self, forces: tuple[PointForce, ...], free_index: np.ndarray, rest_positions: np.ndarray,
        size: float, points: CarriedPoints | None = None,
    ):  # fmt: skip
        """Lay out the rows.

        Args:
            forces: The forces.
            free_index: Unknown or carried point of each node, -1 where fixed, shape (node_count,).
            rest_positions: Node positions at rest [m], shape (node_count, 3).
            size: Size of the largest body, the natural scale of the rows [m].
            points: The carried points of the scene; None without any.
        """
        self.row_count, self.scales = len(forces), np.full(len(forces), size)
        self.points = tuple(force.point for force in forces)
        self._rest_directions = np.array([force.direction for force in forces], float)
        self._directions = self._rest_directions.copy()
        self._places = np.array([point.positions(rest_positions)[0] for point in self.points])
        widths = [point.nodes.shape[1] for point in self.points]
        self._nodes = np.concatenate([point.nodes[0] for point in self.points])
        self._weights = np.concatenate([point.barycentric_weights[0] for point in self.points])
        self._rows = np.repeat(np.arange(len(forces)), widths)
        unknowns = free_index[self._nodes]
        moves = (unknowns >= 0) & (self._weights != 0.0)
        self._entries = np.where(moves, np.cumsum(moves) - 1, -1)
        self.entry_rows, self.entry_nodes = self._rows[moves], unknowns[moves]
        self._stencils = self._coupled(forces, free_index, points)
        self._points, self._folded = points, None
        self._buffer = np.empty((len(self.entry_rows), 3)), np.empty(self.row_count)
        if points is not None and (self._stencils >= points.free_count).any():
            self._folded = FoldedStiffness(points, self._stencils)
            self._pulls = np.empty((points.free_count + points.count, 3))

    def _coupled(self, forces, free_index, points) -> np.ndarray:
        """Unknowns and carried points that the stiffness of each force couples, -1 where none.

        Args:
            forces, free_index, points: See the constructor.

        Returns:
            Shape (row_count, width); without lines where no point turns.
        """
        if points is None or not len(points.turning_unknowns):
            return np.empty((0, 1), np.int64)
        of_rows = [self.entry_nodes[self.entry_rows == row] for row in range(self.row_count)]
        return stacked([own[None, own >= points.free_count] for own in of_rows])

    def stencils(self) -> np.ndarray:
        """Unknowns that the stiffness couples, -1 where none, shape (row_count, width)."""
        return self._stencils if self._folded is None else self._folded.stencils()

    def bind(self, elimination_rank: np.ndarray, slots) -> None:
        """Find the places of the stiffness in the storage."""
        if self._folded is not None:
            elimination_rank, slots = self._folded.bind(elimination_rank, slots)
        self._bound = bind_stencils(self._stencils, elimination_rank, slots)

    def evaluate(self, positions: np.ndarray, blocks: np.ndarray, values: np.ndarray) -> None:
        """Write H and the displacements δ [m]; see `ConstraintTerm.evaluate`."""
        write_force_rows(
            positions, self._nodes, self._weights, self._rows, self._entries, self._directions,
            self._places, blocks, values,
        )  # fmt: skip

    def add_stiffness(
        self, positions: np.ndarray, multipliers: np.ndarray, storage: np.ndarray,
        projected: bool = False,
    ) -> None:
        """Add the stiffness of points that turn; see `ConstraintTerm.add_stiffness`.

        It may be of any sign: projected, there is none.
        """
        if projected or not len(self._stencils):
            return
        self.evaluate(positions, *self._buffer)
        if self._folded is None:
            self._add_turning(multipliers, storage)
            return
        clear(self._pulls.reshape(-1))
        add_row_forces(self.entry_rows, self.entry_nodes, self._buffer[0], multipliers, self._pulls)
        self._folded.clear()
        self._add_turning(multipliers, self._folded.scratch)
        self._folded.fold(positions, self._pulls[self._points.free_count :], storage)

    def _add_turning(self, multipliers: np.ndarray, storage: np.ndarray) -> None:
        """Add the stiffness of directions that turn, at the state evaluated last: there is none."""

    def lines(self, positions: np.ndarray, length: float) -> list[np.ndarray]:
        """A line along each force, which ends where it acts [m], each of shape (2, 3).

        Args:
            positions: Node positions [m], shape (node_count, 3).
            length: Length of each line [m].
        """
        self.evaluate(positions, *self._buffer)
        tips = [point.positions(positions)[0] for point in self.points]
        return [np.stack([tip - length * d, tip]) for tip, d in zip(tips, self._directions, strict=True)]


class TurningForces(PointForces):
    """Constraint term of forces of which some turn with their body; see the module."""

    conserves, loss = False, "forces that turn with their body"

    def __init__(self, forces: tuple[PointForce, ...], *others, **options):
        """Lay out the rows; see `PointForces`."""
        self._turning = [row for row, force in enumerate(forces) if force.patch is not None]
        patches = [forces[row].patch for row in self._turning]
        self._patch_nodes = np.concatenate([nodes for nodes, _, _ in patches])
        self._arms = np.concatenate([arms for _, arms, _ in patches])
        self._ends = np.cumsum([len(nodes) for nodes, _, _ in patches])
        self._are_rigid = np.array([is_rigid for _, _, is_rigid in patches])
        self._rotations, self._turnings = np.zeros((2, len(patches), 3, 3))
        super().__init__(forces, *others, **options)

    def _coupled(self, forces, free_index, points) -> np.ndarray:
        """See `PointForces`; those of the patch too, unless it is large."""
        coupled = [own[own >= 0] for own in super()._coupled(forces, free_index, points)]
        coupled = coupled or [np.empty(0, np.int64)] * len(forces)
        self._parts, patches = [], np.split(np.arange(len(self._arms)), self._ends[:-1])
        for row, patch in zip(self._turning, patches, strict=True):
            own = self.entry_rows == row
            reached = free_index[self._patch_nodes[patch]]
            nodes = np.union1d(self.entry_nodes[own], reached[reached >= 0])
            if len(nodes) <= MOST_COUPLED:
                coupled[row] = nodes
            weights, arms = np.zeros(len(nodes)), np.zeros((len(nodes), 3))
            shares = self._weights[(self._rows == row) & (self._entries >= 0)]
            np.add.at(weights, np.searchsorted(nodes, self.entry_nodes[own]), shares)
            arms[np.searchsorted(nodes, reached[reached >= 0])] = self._arms[patch][reached >= 0]
            self._parts.append((row, self._turning.index(row), nodes, weights, arms))
        return stacked([own[None] for own in coupled])

    def evaluate(self, positions: np.ndarray, blocks: np.ndarray, values: np.ndarray) -> None:
        """Write H and the displacements δ [m]; see `ConstraintTerm.evaluate`."""
        write_rotations(
            positions, self._patch_nodes, self._arms, self._ends, self._are_rigid,
            self._rotations, self._turnings,
        )  # fmt: skip
        turning = self._turning
        self._directions[turning] = np.einsum("pij,pj->pi", self._rotations, self._rest_directions[turning])
        super().evaluate(positions, blocks, values)

    def _slopes(self, part, multipliers: np.ndarray) -> np.ndarray:
        """λ w_a [d]ₓ T [R s_b]ₓ of one force, at the state evaluated last, shape (n, n, 3, 3)."""
        row, patch, _, weights, arms = part
        turned = cross_matrices(arms @ self._rotations[patch].T)
        slopes = cross_matrices(self._directions[row]) @ self._turnings[patch] @ turned
        return multipliers[row] * weights[:, None, None, None] * slopes

    def _add_turning(self, multipliers: np.ndarray, storage: np.ndarray) -> None:
        """Add the symmetric part of the stiffness of turning directions; see `PointForces`."""
        lines, columns = lower_pairs(self._stencils.shape[1])
        for part in self._parts:
            row, count = part[0], len(part[2])
            if count > MOST_COUPLED:
                continue
            slopes = self._slopes(part, multipliers)
            order, offsets = self._bound.order[row], self._bound.offsets[row]
            matrix = np.zeros((self._stencils.shape[1],) * 2 + (3, 3))
            matrix[:count, :count] = 0.5 * (slopes + slopes.transpose(1, 0, 3, 2))
            present = offsets >= 0
            blocks = matrix[order[lines], order[columns]][present]
            steps = np.arange(3)[:, None] + np.arange(3) * self._bound.strides[row][present, None, None]
            np.add.at(storage, offsets[present, None, None] + steps, blocks)

    def lacking_stiffness(self, positions: np.ndarray, multipliers: np.ndarray, size: int):
        """See `ConstraintTerm.lacking_stiffness`."""
        self.evaluate(positions, *self._buffer)
        lacking = sp.csr_array((size + 3 * (self._points.count if self._points else 0),) * 2)
        for part in self._parts:
            slopes, places = self._slopes(part, multipliers), 3 * part[2][:, None] + np.arange(3)
            if len(places) <= MOST_COUPLED:
                slopes = 0.5 * (slopes - slopes.transpose(1, 0, 3, 2))
            lines, columns = np.broadcast_arrays(places[:, None, :, None], places[None, :, None, :])
            entries = slopes.ravel(), (lines.ravel(), columns.ravel())
            lacking = lacking + sp.coo_array(entries, shape=lacking.shape).tocsr()
        return lacking if self._points is None else self._points.fold(positions, lacking)


def cross_matrices(vectors: np.ndarray) -> np.ndarray:
    """Matrices of the cross product with vectors, shape (..., 3, 3).

    Args:
        vectors: Shape (..., 3).
    """
    return np.cross(vectors[..., None, :], np.eye(3)).swapaxes(-1, -2)
