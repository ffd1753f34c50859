"""Springs between points carried by soft bodies, rigid bodies and point masses, or held.

A spring has the energy ½ k (L - L₀)² and, damped, the force c (L - L_begin)/h of its lengthening in
the step besides: a further spring of stiffness c/h whose rest length is that of the step's
beginning (a Kelvin-Voigt element by backward Euler).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from softrobot_twin.mechanics.barycentric import BarycentricMapping
from softrobot_twin.mechanics.force_term import ForceTerm
from softrobot_twin.mechanics.spring_kernels import (
    add_spring_forces,
    add_spring_stiffness,
    write_lengths,
)
from softrobot_twin.mechanics.stencil import bind_stencils
from softrobot_twin.mechanics.stretch import NO_LENGTH

if TYPE_CHECKING:
    from softrobot_twin.mechanics.rigid_frames import RigidFrames


class Springs(ForceTerm):
    """Force term of springs r = second - first + offset.

    Attributes:
        spring_count: Number of springs.
        stiffness: k [N/m], shape (spring_count,).
        rest_lengths: L₀ [m], shape (spring_count,).
        damping: c [N s/m], shape (spring_count,).
    """

    name = "springs"
    remembers_start = True

    def __init__(
        self,
        first: BarycentricMapping,
        second: BarycentricMapping | None,
        stiffness,
        rest_lengths,
        damping,
        free_index: np.ndarray,
        frames: RigidFrames | None = None,
        offsets=None,
    ):
        """Lay out the springs.

        Args:
            first: Their first ends.
            second: Their second ends; None where these lie fixed in the world at `offsets`.
            stiffness: k [N/m], shape (spring_count,) or one for all.
            rest_lengths: L₀ [m], shape (spring_count,) or one for all.
            damping: c [N s/m], shape (spring_count,) or one for all.
            free_index: Unknown of each node, -1 where it does not move, virtual at the frame nodes
                of free rigid bodies, shape (node_count,).
            frames: The rigid bodies, or None where there are none.
            offsets: Constant part of the springs' vectors [m], shape (spring_count, 3).

        Raises:
            ValueError: The numbers of ends differ, or nothing is said of the second ends.
        """
        count = self.spring_count = first.point_count
        if second is None and offsets is None:
            raise ValueError("springs need second ends or points in the world")
        if second is not None and second.point_count != count:
            raise ValueError(f"{count} first ends, {second.point_count} second ends")
        self._constants = np.zeros((count, 3))
        if offsets is not None:
            self._constants[:] = offsets
        columns = [np.broadcast_to(c, count) for c in (stiffness, rest_lengths, damping)]
        self.stiffness, self.rest_lengths, self.damping = (np.array(c, float) for c in columns)
        # Before the first step there is no lengthening yet, and no damping.
        self._laws = np.column_stack([self.stiffness, self.rest_lengths, np.zeros(count)])
        self._damped = bool(np.any(self.damping > 0.0))
        self._lengths_before = np.zeros(count)
        springs = [_merged(first, second, s) for s in range(count)]
        self._nodes = _padded([nodes for nodes, _ in springs], -1, np.int64)
        self._coefficients = _padded([weights for _, weights in springs], 0.0, float)
        parts = [_parts(nodes, weights, free_index, frames) for nodes, weights in springs]
        self._unknowns = _padded([[part[0] for part in p] for p in parts], -1, np.int64)
        self._shares = _padded([[part[1] for part in p] for p in parts], 0.0, float)
        self._origins = _padded([[part[2] for part in p] for p in parts], -1, np.int64)
        self._levers = np.zeros((*self._unknowns.shape, 3))
        for s, p in enumerate(parts):
            for u, part in enumerate(p):
                self._levers[s, u] = part[3]
        self._work = np.zeros((max(1, self._unknowns.shape[1]), 3))
        self._bound = None

    def stencils(self) -> np.ndarray:
        """Unknowns that each spring couples, -1 where none, shape (spring_count, width)."""
        return self._unknowns

    def bind(self, elimination_rank: np.ndarray, slots) -> None:
        """Look up where the stiffness goes, and sort the springs' unknowns to suit."""
        self._bound = bound = bind_stencils(self._unknowns, elimination_rank, slots)
        self._unknowns = np.take_along_axis(self._unknowns, bound.order, axis=1)
        self._shares = np.take_along_axis(self._shares, bound.order, axis=1)
        self._origins = np.take_along_axis(self._origins, bound.order, axis=1)
        self._levers = np.take_along_axis(self._levers, bound.order[:, :, None], axis=1)

    def begin_step(
        self, positions: np.ndarray, velocities: np.ndarray, time_step: float
    ) -> None:
        """Remember the lengths at the beginning of a step of h [s]; see `RigidInertia`."""
        if self._damped:
            self._write_lengths(positions, self._lengths_before)
            np.divide(self.damping, time_step, out=self._laws[:, 2])

    def lengths(self, positions: np.ndarray) -> np.ndarray:
        """Lengths [m], shape (spring_count,)."""
        lengths = np.empty(self.spring_count)
        self._write_lengths(positions, lengths)
        return lengths

    def _write_lengths(self, positions, lengths) -> None:
        write_lengths(positions, self._nodes, self._coefficients, self._constants, lengths)

    def energy(self, positions: np.ndarray) -> float:
        """Stored elastic energy ½ k (L - L₀)² [J]."""
        stretch = self.lengths(positions) - self.rest_lengths
        return 0.5 * float(self.stiffness @ stretch**2)

    def add_forces(self, positions: np.ndarray, forces: np.ndarray) -> int:
        """Add the springs' forces [N] and torques [N m]; they invert no element.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            forces: Of the unknowns, shape (free_node_count, 3); added to.
        """
        add_spring_forces(
            positions, self._nodes, self._coefficients, self._constants, self._laws,
            self._lengths_before, self._unknowns, self._shares, self._levers, self._origins,
            self._work[0], forces,
        )  # fmt: skip
        return 0

    def add(self, positions, forces, storage, projected: bool) -> None:
        """Add forces, and stiffness to the system matrix.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            forces: Of the unknowns [N] and [N m], shape (free_node_count, 3); added to.
            storage: The factorization's storage; added to.
            projected: True for a positive stiffness, without the negative part of pressed springs
                and without the turning of rigid ends; a slack one resists across a little.
        """
        self.add_forces(positions, forces)
        add_spring_stiffness(
            positions, self._nodes, self._coefficients, self._constants, self._laws,
            self._lengths_before, self._shares, self._levers, self._origins, projected,
            self._bound.offsets, self._bound.strides, self._work, storage,
        )  # fmt: skip


def stretches(
    path: BarycentricMapping, rest_positions: np.ndarray
) -> tuple[BarycentricMapping, BarycentricMapping, np.ndarray]:
    """Cut a path of points into its stretches.

    Args:
        path: The points in order; one given twice makes no stretch.
        rest_positions: Node positions at rest [m], shape (node_count, 3).

    Returns:
        First ends, second ends, and lengths at rest [m], shape (stretch_count,).
    """
    points = path.positions(rest_positions)
    kept = [0]
    for index in range(1, len(points)):
        if np.linalg.norm(points[index] - points[kept[-1]]) > NO_LENGTH:
            kept.append(index)
    first, second = (
        BarycentricMapping(path.nodes[ends], path.barycentric_weights[ends])
        for ends in (kept[:-1], kept[1:])
    )
    return first, second, np.linalg.norm(np.diff(points[kept], axis=0), axis=1)


def _merged(first, second, s: int) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and coefficients of one spring's vector, each node once."""
    nodes, weights = first.nodes[s], -first.barycentric_weights[s]
    if second is not None:
        nodes = np.concatenate([nodes, second.nodes[s]])
        weights = np.concatenate([weights, second.barycentric_weights[s]])
    nodes, place = np.unique(nodes, return_inverse=True)
    weights = np.bincount(place.ravel(), weights, len(nodes))
    return nodes[weights != 0.0], weights[weights != 0.0]


def _parts(nodes, weights, free_index, frames: RigidFrames | None) -> list[tuple]:
    """Unknown, share, frame origin (-1 if no rotation) and lever of each part of a spring."""
    end = frames.free_node_count if frames is not None else np.iinfo(np.int64).max
    indices = free_index[nodes]
    plain = (indices >= 0) & (indices < end)
    nothing = np.zeros(3)
    parts = [(i, w, -1, nothing) for i, w in zip(indices[plain], weights[plain], strict=True)]
    bodies = (indices[indices >= end] - end) // 4
    for body in np.unique(bodies):
        corner_weights = np.zeros(4)
        corner_weights[(indices[indices >= end] - end)[bodies == body] % 4] = (
            weights[indices >= end][bodies == body]
        )
        parts.append((frames.translations[body], corner_weights.sum(), -1, nothing))
        parts.append((frames.rotations[body], 0.0, frames.origins[body], corner_weights[1:]))
    return parts


def _padded(rows: list, filling, kind) -> np.ndarray:
    """Rows of different lengths as one array."""
    out = np.full((len(rows), max((len(row) for row in rows), default=0)), filling, kind)
    for line, row in zip(out, rows, strict=True):
        line[: len(row)] = row
    return out
