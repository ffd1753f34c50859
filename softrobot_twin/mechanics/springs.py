"""Springs between points of soft bodies, rigid bodies and point masses, or points of the world.

The vector of a spring is r = Σ c_a x_a + r_0 with constant coefficients c_a. It has the energy
½ k (L - L₀)² with L = ‖r‖. With damping, the force c (L - L_begin)/h of its lengthening in the step
is added: a second spring of stiffness c/h whose rest length is the length at the beginning of the
step (a Kelvin-Voigt element by backward Euler). With d = r/L and the tension

    T = k (L - L₀) + c (L - L_begin)/h,

the force at node a is -c_a T d, and the stiffness of two nodes is

    c_a c_b ((k + c/h) d dᵀ + T/L (1 - d dᵀ)).

A thread carries tension only. With the lengthening e = L - L₀ and a small length w it has

    T = 0 for e ≤ 0,    T = k e²/(2 w) up to w,    T = k (e - w/2) above,

so that the force has a continuous slope, as Newton's method needs. A taut thread is w/2 longer than
a spring of the same tension.
"""

from __future__ import annotations

import numpy as np

from softrobot_twin.geometry.vector3 import add_scaled, dot, norm, row, scaled, set_row
from softrobot_twin.kernels.compilation import INNER, KERNEL, ONCE, njit
from softrobot_twin.mechanics.barycentric import BarycentricMapping
from softrobot_twin.mechanics.force_term import ForceTerm
from softrobot_twin.mechanics.kinematics import size_of_points
from softrobot_twin.mechanics.stencil import bind_stencils, stacked

# w of a thread as a share of its length at rest. Newton's method takes some more steps for a
# smaller one.
TAKE_UP = 2.0e-4
# A segment shorter than this share of the longest one at rest has no direction.
NO_LENGTH = 1.0e-8


@njit(**INNER)
def segment_vector(x, nodes, coefficients, constant):
    """r = Σ c_a x_a + r_0 of one segment.

    Args:
        x: Node positions [m], shape (node_count, 3).
        nodes: Nodes of the segment, -1 where there is none, shape (width,).
        coefficients: c of these nodes, same shape.
        constant: r_0 [m], shape (3,).
    """
    r = (constant[0], constant[1], constant[2])
    for a in range(len(nodes)):
        if nodes[a] >= 0:
            r = add_scaled(r, row(x, nodes[a]), coefficients[a])
    return r


# A slack spring has no stiffness across, and a slack net or chain has none at all. The projected
# stiffness takes this share of the stiffness along, so that Newton's method reaches a taut state.
LEAST_ACROSS = 1.0e-3


@njit(**KERNEL)
def spring_law(length, least, stiffness, rest_length, drag, length_before, take_up):
    """T/L, ∂T/∂L and the stiffness across, which is T/L; isotropic where length ≤ `least`.

    Args:
        length: L [m].
        least: Length up to which the spring has no direction [m].
        stiffness: k [N/m].
        rest_length: L₀ [m].
        drag: c/h [N/m].
        length_before: L_begin [m].
        take_up: w [m]; where it is positive, the law is that of a thread.
    """
    if take_up > 0.0:
        stretch = length - rest_length
        if stretch <= 0.0:
            return 0.0, 0.0, 0.0
        taut = min(stretch / take_up, 1.0)
        # Both parts of the law in one: e - w t (2 - t)/2 with t = min(e/w, 1).
        pull = stiffness * (stretch - 0.5 * take_up * taut * (2.0 - taut)) / length
        return pull, stiffness * taut, pull
    along = stiffness + drag
    if length > least:
        tension = stiffness * (length - rest_length) + drag * (length - length_before)
        return tension / length, along, tension / length
    return (stiffness if rest_length == 0.0 else 0.0), along, along


@njit(**KERNEL)
def write_lengths(x, nodes, coefficients, constants, lengths):
    """Length of every spring.

    Args:
        x: Node positions [m], shape (node_count, 3).
        nodes: Nodes of each spring, -1 where there is none, shape (spring_count, width).
        coefficients: c of these nodes, same shape.
        constants: r_0 of each spring [m], shape (spring_count, 3).
        lengths: Takes the lengths [m], shape (spring_count,).
    """
    for s in range(len(nodes)):
        lengths[s] = norm(segment_vector(x, nodes[s], coefficients[s], constants[s]))


@njit(**KERNEL)
def write_projected_lengths(x, reference, nodes, coefficients, constants, least, lengths):
    """Each spring's vector at a reference, projected on its direction at a state.

    Args:
        x: Node positions [m], shape (node_count, 3).
        reference: Node positions at the reference [m], same shape.
        nodes: Nodes of each spring, -1 where there is none, shape (spring_count, width).
        coefficients: c of these nodes, same shape.
        constants: r_0 of each spring [m], shape (spring_count, 3).
        least: A spring that is not longer has no direction [m]; its whole length is taken.
        lengths: Takes the projected lengths [m], shape (spring_count,).
    """
    for s in range(len(nodes)):
        r = segment_vector(x, nodes[s], coefficients[s], constants[s])
        other = segment_vector(reference, nodes[s], coefficients[s], constants[s])
        length = norm(r)
        lengths[s] = dot(r, other) / length if length > least else norm(other)


@njit(**KERNEL)
def add_spring_forces(x, nodes, coefficients, constants, least, laws, lengths_before, free, forces):
    """Add -c_a T d of every spring.

    Args:
        x: Node positions [m], shape (node_count, 3).
        nodes: Nodes of each spring, -1 where there is none, shape (spring_count, width).
        coefficients: c of these nodes, same shape.
        constants: r_0 of each spring [m], shape (spring_count, 3).
        least: A spring that is not longer has no direction [m].
        laws: Stiffness [N/m], rest length [m], damping per step [N/m] and w [m] of each spring,
            shape (spring_count, 4).
        lengths_before: Length of each spring where the step began [m], shape (spring_count,).
        free: Row of `forces` of each node, negative where fixed, shape (spring_count, width).
        forces: Forces on unknowns, then on carried points [N], shape (row_count, 3); added to.
    """
    for s in range(len(nodes)):
        r = segment_vector(x, nodes[s], coefficients[s], constants[s])
        pull, _, _ = spring_law(
            norm(r), least, laws[s, 0], laws[s, 1], laws[s, 2], lengths_before[s], laws[s, 3]
        )
        for a in range(free.shape[1]):
            n = free[s, a]
            if n >= 0:
                force = add_scaled(row(forces, n), scaled(r, pull), -coefficients[s, a])
                set_row(forces, n, force)


@njit(**ONCE)
def add_spring_block(share, along, across, d, o, stride, storage):
    """Add share (across 1 + (along - across) d dᵀ) at one block.

    Args:
        share: Factor of the block.
        along: Stiffness along the spring [N/m].
        across: Stiffness across the spring [N/m].
        d: Direction of the spring, a vector of `vector3`, shape (3,).
        o: Place of the block in the storage.
        stride: Distance between two columns of the block.
        storage: The factorization's storage [N/m]; added to.
    """
    for j in range(3):
        bend = share * (along - across) * d[j]
        for i in range(3):
            storage[o + i] += bend * d[i]
        storage[o + j] += share * across
        o += stride


@njit(**KERNEL)
def add_spring_stiffness(
    x, nodes, coefficients, constants, least, laws, lengths_before, projected, offsets, strides,
    storage,
):  # fmt: skip
    """Add the stiffness of every spring; where projected, a positive one.

    Args:
        x: Node positions [m], shape (node_count, 3).
        nodes: Nodes of each spring, -1 where there is none, shape (spring_count, width).
        coefficients: c of these nodes, same shape.
        constants: r_0 of each spring [m], shape (spring_count, 3).
        least: A spring that is not longer has no direction [m].
        laws: Stiffness [N/m], rest length [m], damping per step [N/m] and w [m] of each spring,
            shape (spring_count, 4).
        lengths_before: Length of each spring where the step began [m], shape (spring_count,).
        projected: Whether the stiffness across is at least `LEAST_ACROSS` of that along.
        offsets: Place of each pair's block, -1 for none, shape (spring_count, pair_count).
        strides: Distance between two columns of that block, same shape.
        storage: The factorization's storage [N/m]; added to.
    """
    width = nodes.shape[1]
    for s in range(len(nodes)):
        r = segment_vector(x, nodes[s], coefficients[s], constants[s])
        length = norm(r)
        _, along, across = spring_law(
            length, least, laws[s, 0], laws[s, 1], laws[s, 2], lengths_before[s], laws[s, 3]
        )
        if projected:
            across = max(across, LEAST_ACROSS * along)
        d = scaled(r, 1.0 / length if length > least else 0.0)
        pair = 0
        for b in range(width):
            for a in range(b, width):
                o = offsets[s, pair]
                if o >= 0:
                    share = coefficients[s, a] * coefficients[s, b]
                    add_spring_block(share, along, across, d, o, strides[s, pair], storage)
                pair += 1


class Springs(ForceTerm):
    """Force term of springs r = second - first + offset.

    Attributes:
        spring_count: Number of springs.
        stiffness: k [N/m], shape (spring_count,).
        rest_lengths: L₀ [m], shape (spring_count,).
        damping: c [N s/m], shape (spring_count,).
        is_thread: Which of them carry tension only, bool, shape (spring_count,).
    """

    name = "springs"
    is_traceable = True
    remembers_start = True

    def __init__(
        self,
        first: BarycentricMapping,
        second: BarycentricMapping | None,
        stiffness,
        rest_lengths,
        damping,
        free_index: np.ndarray,
        offsets=None,
        is_thread=False,
    ):
        """Lay out the springs.

        Args:
            first: Their first ends.
            second: Their second ends; None where these are points of the world, `offsets`.
            stiffness: k [N/m], shape (spring_count,) or one for all.
            rest_lengths: L₀ [m], shape (spring_count,) or one for all.
            damping: c [N s/m], shape (spring_count,) or one for all.
            free_index: Unknown or carried point of each node, -1 where it does not move,
                shape (node_count,).
            offsets: Constant part of the springs' vectors [m], shape (spring_count, 3).
            is_thread: Which of them carry tension only, shape (spring_count,) or one for all.
        """
        count = self.spring_count = first.point_count
        self._constants = np.zeros((count, 3))
        if offsets is not None:
            self._constants[:] = offsets
        columns = [np.broadcast_to(c, count) for c in (stiffness, rest_lengths, damping)]
        self.stiffness, self.rest_lengths, self.damping = (np.array(c, float) for c in columns)
        self.is_thread = np.array(np.broadcast_to(is_thread, count), bool)
        take_up = np.where(self.is_thread, TAKE_UP * self.rest_lengths, 0.0)
        # Before the first step there is no lengthening, and no damping.
        self._laws = np.column_stack(
            [self.stiffness, self.rest_lengths, np.zeros(count), take_up]
        )
        self._damped = bool(np.any(self.damping > 0.0))
        self._lengths_before = np.zeros(count)
        self._least = NO_LENGTH * float(self.rest_lengths.max(initial=0.0))
        self._nodes, self._coefficients = vectors_between(first, second)
        self._stencils = np.where(self._nodes >= 0, free_index[self._nodes], -1)
        self._first, self._second = first, second

    def ends(self, positions: np.ndarray) -> np.ndarray:
        """Both ends of each spring [m], shape (spring_count, 2, 3), at node positions [m].

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        second = self._constants
        if self._second is not None:
            second = second + self._second.positions(positions)
        return np.stack([self._first.positions(positions), second], axis=1)

    def bind(self, elimination_rank: np.ndarray, slots) -> None:
        """Find the places of the stiffness in the storage, and sort the springs' nodes."""
        self._bound = bound = bind_stencils(self._stencils, elimination_rank, slots)
        self._stencils = bound.sorted(self._stencils)
        self._nodes = bound.sorted(self._nodes)
        self._coefficients = bound.sorted(self._coefficients)

    def begin_step(self, positions: np.ndarray, velocities: np.ndarray, time_step: float) -> None:
        """Remember the lengths at the beginning of a step of h [s]; see `RigidInertia`."""
        if self._damped:
            self._write_lengths(positions, self._lengths_before)
            np.divide(self.damping, time_step, out=self._laws[:, 2])

    def begin_rates(
        self, positions: np.ndarray, reference: np.ndarray, velocities: np.ndarray, span: float
    ) -> None:
        """Take the rate of lengthening from L₀ + d·(r_r - r₀), linear in the ends' way.

        The length at the reference would be too long where a spring turns.
        """
        if self._damped:
            write_projected_lengths(
                positions, reference, self._nodes, self._coefficients, self._constants,
                self._least, self._lengths_before,
            )  # fmt: skip
            np.divide(self.damping, span, out=self._laws[:, 2])

    def lengths(self, positions: np.ndarray) -> np.ndarray:
        """Lengths [m], shape (spring_count,).

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        lengths = np.empty(self.spring_count)
        self._write_lengths(positions, lengths)
        return lengths

    def _write_lengths(self, positions, lengths) -> None:
        write_lengths(positions, self._nodes, self._coefficients, self._constants, lengths)

    def energy(self, positions: np.ndarray) -> float:
        """Stored elastic energy [J], ½ k (L - L₀)² of a spring."""
        stretch = self.lengths(positions) - self.rest_lengths
        squares = stretch**2
        if self.is_thread.any():
            threads, w = self.is_thread, self._laws[self.is_thread, 3]
            e = np.maximum(stretch[threads], 0.0)
            squares[threads] = np.where(e < w, e**3 / (3.0 * w), e**2 - w * e + w**2 / 3.0)
        return 0.5 * float(self.stiffness @ squares)

    def add_forces(self, positions: np.ndarray, forces: np.ndarray) -> int:
        """Add the springs' forces [N]; they invert no element.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            forces: On the unknowns, shape (free_node_count, 3); added to.
        """
        add_spring_forces(
            positions, self._nodes, self._coefficients, self._constants, self._least, self._laws,
            self._lengths_before, self._stencils, forces,
        )  # fmt: skip
        return 0

    def add_stiffness(self, positions, storage, projected: bool) -> None:
        """Add the stiffness.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            storage: The factorization's storage; added to.
            projected: True for a positive stiffness, without the negative part of compressed
                springs; a slack one has a small stiffness across.
        """
        add_spring_stiffness(
            positions, self._nodes, self._coefficients, self._constants, self._least, self._laws,
            self._lengths_before, projected, self._bound.offsets, self._bound.strides, storage,
        )  # fmt: skip


class Joints(Springs):
    """Bearings between rigid bodies: springs without length, one at a ball joint, two on a hinge's axis.

    Their energy ½ k ‖r‖² has constant derivatives by the nodes, so their stiffness is exact in all
    states, and bodies may be joined to chains and to closed loops.
    """

    name = "joints"
    is_traceable = True


def segments(
    path: BarycentricMapping, rest_positions: np.ndarray
) -> tuple[BarycentricMapping, BarycentricMapping, np.ndarray]:
    """Divide a path of points into straight segments.

    Args:
        path: The points in order; a repeated point makes no segment.
        rest_positions: Node positions at rest [m], shape (node_count, 3).

    Returns:
        First ends, second ends, and lengths at rest [m], shape (segment_count,).
    """
    points = path.positions(rest_positions)
    kept = distinct_points(points)
    first, second = (
        BarycentricMapping(path.nodes[ends], path.barycentric_weights[ends])
        for ends in (kept[:-1], kept[1:])
    )
    return first, second, np.linalg.norm(np.diff(points[kept], axis=0), axis=1)


def distinct_points(path: np.ndarray) -> list[int]:
    """Indices of the points of a path [m], shape (point_count, 3), without repeated points.

    Args:
        path: Points of the path in order [m], shape (point_count, 3).
    """
    least = NO_LENGTH * size_of_points(path)
    kept = [0]
    for index in range(1, len(path)):
        if np.linalg.norm(path[index] - path[kept[-1]]) > least:
            kept.append(index)
    return kept


def vectors_between(
    first: BarycentricMapping, second: BarycentricMapping | None
) -> tuple[np.ndarray, np.ndarray]:
    """The vectors from points to others as sums over nodes.

    Args:
        first: Where they begin, at least one point.
        second: Where they end; None where that is in the world.

    Returns:
        Nodes of each, each once, -1 where there is none, and their coefficients, shape (count, width).
    """
    found = [_merged(first, second, s) for s in range(first.point_count)]
    return stacked([nodes[None] for nodes, _ in found]), stacked([weights[None] for _, weights in found], 0.0)


def _merged(first, second, s: int) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and coefficients of one spring's vector, each node once."""
    nodes, weights = first.nodes[s], -first.barycentric_weights[s]
    if second is not None:
        nodes = np.concatenate([nodes, second.nodes[s]])
        weights = np.concatenate([weights, second.barycentric_weights[s]])
    nodes, place = np.unique(nodes, return_inverse=True)
    weights = np.bincount(place.ravel(), weights, len(nodes))
    return nodes[weights != 0.0], weights[weights != 0.0]
