"""Frames that turn on a hinge or a ball joint, without constraints.

A hinged frame B is carried by its parent A: a rigid body, a node of a beam, or the world. With the
hinge point p in the frame of A, the rotation R₀ of B against A at rest, and the axis a of the hinge
in the frame of B,

    c_B = c_A + R_A p,    R_B = R_A R₀ exp(α [a]×).

Its frame nodes are those of rigid bodies, and a hinge adds one block of unknowns: the angle α, and
two numbers that nothing depends on. A ball joint uses all three as a rotation vector φ in world
axes. Both are one map S of the block u, φ = S u: S = (R_B a, 0, 0) of a hinge, S = 1 of a ball
joint. An increment turns A, and B against A:

    R_A ← exp([θ]×) R_A,    R_B ← exp([θ]×) exp([S u]×) R_B.

So a point x of B, with levers ρ = x - c_B and P = c_B - c_A, moves by

    dx = dc_A - [P + ρ]× θ - [ρ]× S u,

and a force f on it changes the generalised forces by (second derivatives of -f·x)

    own block:       Sᵀ (f·ρ 1 - (f ρᵀ + ρ fᵀ)/2) S
    rotation, own:   (f·ρ 1 - ρ fᵀ) S.

A force f and a moment m on the frame as a whole, as those of a beam at its end, act by

    dc_B = dc_A - [P]× θ,    dφ_B = θ + S u,    rotation, own: ½ [m]× S,

the last because exp([θ]×) exp([S u]×) is the rotation by θ + S u + ½ θ × S u + ….

A hinge transmits no moment about its axis, and all others; nothing yields. The angle is measured
from the frames and written back on the axis in every move, so that nothing drifts. It is known up
to whole turns.

Arguments of the kernels here; those of one hinge have no first axis:
    A, Q: Matrices, three rows of three numbers.
    a, lever: Vectors, three numbers.
    axes: Unit vectors in the hinged frames, zero for ball joints, shape (hinge_count, 3).
    crosses, free_parents: Place of a block and of the parent, -1 for none, shape (hinge_count,).
    forces: At the four nodes of each frame [N], shape (4 hinge_count, 3).
    is_ball, offsets, stiffness, strides: Of each own block, shape (hinge_count,).
    move: u, θ and α of the unknowns, shape (free_node_count, 3).
    nodes, parents: Origin node of each frame and of its parent, shape (hinge_count,).
    out: Angles, shape (hinge_count,); rotations, shape (hinge_count, 3, 3); turns of the unknowns,
        shape (free_node_count, 3); levers, shape (count, 3, 3, 3); or blocks, shape (count, 3, 3).
    points: Hinge points in the frames of the parents [m], shape (hinge_count, 3).
    R_parent, R_own: R_A and R_B, three rows of three numbers.
    relative, rests: Rotation of each in its parent's frame, shape (hinge_count, 3, 3).
    storage: The factorization's storage, shape (size,); added to.
    twists: Force [N] and moment [N m] on each frame, shape (2 hinge_count, 3).
    x: Node positions [m], shape (node_count, 3).
"""

from __future__ import annotations

from copy import copy
from typing import NamedTuple

import numpy as np

from softrobot_twin.geometry.matrix3 import (
    IDENTITY,
    add_outer,
    add_scaled_matrix,
    cross_matrix,
    plus_identity,
    product,
    product_transposed,
    rows,
    set_rows,
    trace,
    transform,
    transposed,
    transposed_product,
)
from softrobot_twin.geometry.vector3 import (
    add,
    dot,
    is_zero,
    negated,
    row,
    scaled,
    set_row,
    subtract,
)
from softrobot_twin.kernels.compilation import INLINED, KERNEL, ONCE, njit
from softrobot_twin.mechanics.force_term import OwnBlocks
from softrobot_twin.mechanics.kinematics import fold_own_forces
from softrobot_twin.mechanics.rigid_bodies import (
    NOTHING_ATTACHED,
    AttachedNodes,
    RigidFrames,
    add_lever_turning,
    rotation_at,
    write_frame,
    write_levers,
)
from softrobot_twin.mechanics.rotation import exponential, logarithm, orthonormalised

# Parent of a frame that is joined to the world.
WORLD = -1


class Hinges(NamedTuple):
    """Joints of frames with their parents.

    Attributes:
        parents: Origin node of each parent, `WORLD` where there is none, shape (count,).
        free_parents: Place of the parent among the free bodies, -1 where it is guided, fixed or the
            world, shape (count,).
        points: Hinge point in the parent's frame [m], shape (count, 3).
        rotations: R₀, from the hinged frame to the parent's at rest, shape (count, 3, 3).
        axes: Unit vector of each axis in the hinged frame, zero for a ball joint, shape (count, 3).
        radii: Distance of the furthest point that a turn moves from the hinge point [m],
            shape (count,).
    """

    parents: np.ndarray
    free_parents: np.ndarray
    points: np.ndarray
    rotations: np.ndarray
    axes: np.ndarray
    radii: np.ndarray


@njit(**INLINED)
def _parent_pose(x, parent):
    """Origin and rotation of a parent, those of the world for `WORLD`."""
    if parent < 0:
        return (0.0, 0.0, 0.0), IDENTITY
    return row(x, parent), rotation_at(x, parent)


@njit(**INLINED)
def _angle_about(axis, Q):
    """Angle of a rotation about an axis, from the part of the rotation about it, in (-π, π]."""
    twist = (Q[2][1] - Q[1][2], Q[0][2] - Q[2][0], Q[1][0] - Q[0][1])
    return np.arctan2(0.5 * dot(axis, twist), 0.5 * (trace(Q) - 1.0))


@njit(**ONCE)
def from_rest(R_parent, rest, R_own):
    """R₀ᵀ R_Aᵀ R_B: the rotation of a hinged frame since rest, in its own axes."""
    return transposed_product(product(R_parent, rest), R_own)


@njit(**INLINED)
def _turn_map(x, node, axis):
    """S of a joint."""
    if is_zero(axis):
        return IDENTITY
    a = transform(rotation_at(x, node), axis)
    return ((a[0], 0.0, 0.0), (a[1], 0.0, 0.0), (a[2], 0.0, 0.0))


@njit(**KERNEL)
def _write_relative(x, nodes, parents, out):
    """R_Aᵀ R_B of every hinged frame."""
    for k in range(len(nodes)):
        _, R = _parent_pose(x, parents[k])
        set_rows(out[k], transposed_product(R, rotation_at(x, nodes[k])))


@njit(**KERNEL)
def _write_angles(x, nodes, parents, rests, axes, out):
    """Angle of every hinge; zero of ball joints."""
    for k in range(len(nodes)):
        axis = row(axes, k)
        _, R = _parent_pose(x, parents[k])
        Q = from_rest(R, rows(rests[k]), rotation_at(x, nodes[k]))
        out[k] = 0.0 if is_zero(axis) else _angle_about(axis, Q)


@njit(**KERNEL)
def _place_hinged(x, nodes, parents, points, rests, axes, relative):
    """Put every hinged frame where its parent carries it, at a given relative rotation.

    That of a hinge is reduced to the part about its axis. A frame that is there already is the same
    to the bit where its parent has not moved.
    """
    for k in range(len(nodes)):
        centre, R = _parent_pose(x, parents[k])
        axis, Q = row(axes, k), rows(relative[k])
        if is_zero(axis):
            turned = orthonormalised(product(R, Q))
        else:
            rest = rows(rests[k])
            angle = _angle_about(axis, transposed_product(rest, Q))
            turned = product(product(R, rest), exponential(scaled(axis, angle)))
        write_frame(add(centre, transform(R, row(points, k))), turned, x, nodes[k])


@njit(**KERNEL)
def _turn_relative(x, parents, axes, first_own, move, share, relative):
    """Turn relative rotations by a share of a move, in the axes of the parents before the move."""
    for k in range(len(parents)):
        own, axis = scaled(row(move, first_own + k), share), row(axes, k)
        Q = rows(relative[k])
        if is_zero(axis):
            _, R = _parent_pose(x, parents[k])
            turn = transform(transposed(R), own)
            set_rows(relative[k], product(exponential(turn), Q))
        else:
            set_rows(relative[k], product(Q, exponential(scaled(axis, own[0]))))


@njit(**KERNEL)
def _hinged_displacement(before, after, nodes, parents, axes, first_own, out):
    """Turn of each hinged frame against its parent, see `HingedFrames.displacement`."""
    for k in range(len(nodes)):
        axis = row(axes, k)
        _, R_before = _parent_pose(before, parents[k])
        _, R_after = _parent_pose(after, parents[k])
        old = transposed_product(R_before, rotation_at(before, nodes[k]))
        new = transposed_product(R_after, rotation_at(after, nodes[k]))
        if is_zero(axis):
            turn = logarithm(product_transposed(new, old))
            set_row(out, first_own + k, transform(R_before, turn))
        else:
            turned = _angle_about(axis, transposed_product(old, new))
            set_row(out, first_own + k, (turned, 0.0, 0.0))


@njit(**KERNEL)
def _write_hinged_levers(x, nodes, parents, axes, out):
    """Derivatives of the four nodes of each hinged frame, by the parent's two unknowns and its own.
    """
    for k in range(len(nodes)):
        centre, _ = _parent_pose(x, parents[k])
        S = _turn_map(x, nodes[k], row(axes, k))
        for corner in range(4):
            place, block = row(x, nodes[k] + corner), out[4 * k + corner]
            set_rows(block[0], IDENTITY)
            set_rows(block[1], cross_matrix(subtract(centre, place)))
            lever = subtract(place, row(x, nodes[k]))
            set_rows(block[2], product(cross_matrix(negated(lever)), S))


@njit(**KERNEL)
def _add_hinged_turning(x, nodes, parents, axes, free_parents, forces, out, first, crosses):
    """Add the turning terms of the points of hinged frames.

    The blocks of `out` are those of the rotations of free bodies, from `first` on the own blocks,
    and behind them one (rotation, own) for each hinge whose place in `crosses` is not negative.
    """
    for k in range(len(nodes)):
        S = _turn_map(x, nodes[k], row(axes, k))
        centre, _ = _parent_pose(x, parents[k])
        own = mixed = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
        for corner in range(4):
            place, f = row(x, nodes[k] + corner), row(forces, 4 * k + corner)
            lever = subtract(place, row(x, nodes[k]))
            own = add_scaled_matrix(own, _lever_turning(f, lever), 1.0)
            mixed = plus_identity(add_outer(mixed, negated(lever), f), dot(f, lever))
            if free_parents[k] >= 0:
                add_block(out[free_parents[k]], _lever_turning(f, subtract(place, centre)))
        add_block(out[first + k], transposed_product(S, product(own, S)))
        if crosses[k] >= 0:
            add_block(out[crosses[k]], product(mixed, S))


@njit(**INLINED)
def _lever_turning(f, lever):
    """f·ρ 1 - (f ρᵀ + ρ fᵀ)/2."""
    half = scaled(f, -0.5)
    block = plus_identity(((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)), dot(f, lever))
    return add_outer(add_outer(block, half, lever), lever, half)


@njit(**INLINED)
def add_block(out, A):
    """Add a matrix to an array of shape (3, 3)."""
    set_rows(out, add_scaled_matrix(rows(out), A, 1.0))


class HingedFrames(RigidFrames):
    """Frames of rigid bodies, and behind them frames that are hinged to these or to the world.

    One `UnknownKind` holds both, because a hinged frame moves with its parent. Its carried points
    are those of `RigidFrames`, followed by the four frame nodes of each hinged frame.

    Attributes:
        hinges: The joints.
        hinge_count: Number of hinged frames.
        hinged_nodes: Origin node of each, behind those of all bodies, shape (hinge_count,).
        own: Own unknown of each: angle in the first number, or rotation vector of a ball joint,
            shape (hinge_count,).
    """

    is_traceable = False

    def __init__(
        self, first_node: int, free, first_unknown: int, free_node_count: int, hinges: Hinges,
        radii=None, attached: AttachedNodes = NOTHING_ATTACHED,
    ):  # fmt: skip
        """Number nodes and unknowns.

        Args:
            first_node: Number of nodes before the first frame node.
            free: Whether each rigid body is free, shape (body_count,).
            first_unknown: Number of unknowns before those of rigid bodies; those of hinges come
                behind these.
            free_node_count: Number of all unknowns.
            hinges: The joints.
            radii: See `RigidFrames`.
            attached: See `RigidFrames`.
        """
        super().__init__(first_node, free, first_unknown, free_node_count, radii, attached)
        count = len(hinges.parents)
        self.hinges = Hinges(*(np.ascontiguousarray(field) for field in hinges))
        self.hinge_count = count
        self.hinged_nodes = self.first_node + 4 * (self.body_count + np.arange(count))
        self._first_own = self.first_unknown + 2 * self.free_body_count
        self.own = self._first_own + np.arange(count)
        self._rigid_points = len(self.carried_unknowns)
        self._number_carried()

    def _number_carried(self) -> None:
        """Unknowns of the carried points, and the pairs of them with turning terms."""
        has_free = self.hinges.free_parents >= 0
        parent = self.first_unknown + 2 * self.hinges.free_parents
        self._of_hinge = np.column_stack([
            np.where(has_free, parent, -1), np.where(has_free, parent + 1, -1), self.own
        ])  # fmt: skip
        rigid = np.column_stack([self.carried_unknowns, np.full(self._rigid_points, -1)])
        self.carried_unknowns = np.vstack([rigid, np.repeat(self._of_hinge, 4, axis=0)])
        both = np.flatnonzero(has_free)
        self._first_own_block = len(self.turning_unknowns)
        self._crosses = np.full(self.hinge_count, -1)
        self._crosses[both] = self._first_own_block + self.hinge_count + np.arange(len(both))
        turning = self.turning_unknowns
        self.turning_unknowns = np.concatenate([turning, self.own, self._of_hinge[both, 1]])
        self.turning_columns = np.concatenate([turning, self.own, self.own[both]])

    @property
    def is_ball(self) -> np.ndarray:
        """Whether each joint is a ball joint, shape (hinge_count,)."""
        return ~self.hinges.axes.any(axis=1)

    def unknowns_of(self, first_nodes: np.ndarray) -> np.ndarray:
        """Translation of some frames, see `RigidFrames`; of a hinged one its place in
        `HingedTwists`.

        Args:
            first_nodes: Origin node of each, shape (count,).
        """
        first_nodes = np.asarray(first_nodes)
        hinge = (first_nodes - self.first_node) // 4 - self.body_count
        found = self.free_node_count + 2 * hinge
        found[hinge < 0] = super().unknowns_of(first_nodes[hinge < 0])
        return found

    def free_index(self) -> np.ndarray:
        """Index of each frame node; see `RigidFrames`. Shape (4 (body_count + hinge_count),)."""
        first = self.free_node_count + self._rigid_points
        return np.concatenate([super().free_index(), first + np.arange(4 * self.hinge_count)])

    def resting_at(self, positions: np.ndarray) -> HingedFrames:
        """The same frames, whose angles count from other positions.

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        frames = copy(self)
        frames.hinges = self.hinges._replace(rotations=self.relative(positions))
        return frames

    def rest_poses(self, positions: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """Origin [m] and rotation of every hinged frame at rest.

        Args:
            positions: Nodes with the parents' frame nodes at rest [m], shape (node_count, 3).
        """
        poses, joints = [], self.hinges
        for parent, point, rotation in zip(
            joints.parents, joints.points, joints.rotations, strict=True
        ):
            centre, R = np.zeros(3), np.eye(3)
            if parent != WORLD:
                centre = positions[parent]
                R = (positions[parent + 1 : parent + 4] - centre).T
            poses.append((centre + R @ point, R @ rotation))
        return poses

    def angles(self, positions: np.ndarray) -> np.ndarray:
        """Angle of each hinge against rest [rad], in (-π, π]; zero of ball joints, (hinge_count,).

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        joints, out = self.hinges, np.empty(self.hinge_count)
        _write_angles(
            positions, self.hinged_nodes, joints.parents, joints.rotations, joints.axes,
            out,
        )  # fmt: skip
        return out

    def world_axes(self, positions: np.ndarray) -> np.ndarray:
        """Axis of each hinge in the world, zero of ball joints, shape (hinge_count, 3).

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        turned = [self.pose(positions, self.body_count + k)[1] @ axis
                  for k, axis in enumerate(self.hinges.axes)]  # fmt: skip
        return np.array(turned).reshape(-1, 3)

    def relative(self, positions: np.ndarray) -> np.ndarray:
        """Rotation of each hinged frame in its parent's, shape (hinge_count, 3, 3).

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        out = np.empty((self.hinge_count, 3, 3))
        _write_relative(positions, self.hinged_nodes, self.hinges.parents, out)
        return out

    def follow(self, positions: np.ndarray, relative: np.ndarray) -> None:
        """Move hinged frames after their parents, which were placed.

        Args:
            positions: Node positions [m], shape (node_count, 3); changed.
            relative: Rotation of each in its parent's frame, shape (hinge_count, 3, 3).
        """
        joints = self.hinges
        _place_hinged(
            positions, self.hinged_nodes, joints.parents, joints.points, joints.rotations,
            joints.axes, relative,
        )  # fmt: skip

    def advance(self, positions: np.ndarray, move: np.ndarray, share: float) -> None:
        """Move the free bodies and the frames hinged to them; see `RigidFrames.advance`.

        Args:
            positions: Node positions [m], shape (node_count, 3); changed.
            move: u [m], θ [rad] and α or φ [rad] of the unknowns, shape (free_node_count, 3).
            share: Share of the move that is made.
        """
        if share == 0.0 or not move[self.first_unknown :].any():
            return
        relative = self.relative(positions)
        _turn_relative(
            positions, self.hinges.parents, self.hinges.axes, self._first_own, move, share, relative
        )
        super().advance(positions, move, share)
        self.follow(positions, relative)

    def recede(self, positions: np.ndarray, move: np.ndarray) -> None:
        """Undo a move; see `RigidFrames.recede`."""
        relative = self.relative(positions)
        # The turn of a ball joint is in the axes that its parent had before it moved.
        super().advance(positions, move, -1.0)
        _turn_relative(
            positions, self.hinges.parents, self.hinges.axes, self._first_own, move, -1.0, relative
        )
        self.follow(positions, relative)

    def twist_derivatives(self, positions: np.ndarray) -> list:
        """Derivatives of places and turns of hinged frames; see `HingedTwists`.

        Args:
            positions: Node positions [m], shape (node_count, 3).

        Returns:
            For each the unknowns that it depends on, with D, shape (3, 3).
        """
        twists = HingedTwists(self)
        twists.update(positions)
        return [
            [(int(u), D) for u, D in zip(own, derivatives, strict=True) if u >= 0]
            for own, derivatives in zip(twists.unknowns, twists.derivatives, strict=True)
        ]

    def displacement(self, before: np.ndarray, after: np.ndarray, out: np.ndarray) -> None:
        """Moves of the free bodies, and turns of hinged frames against their parents [rad].

        The turn of a hinge is less than half a turn. That of a ball joint is a rotation vector in
        the axes of the world before the parent's own rotation.

        Args:
            before: Node positions [m], shape (node_count, 3).
            after: Those of a later state.
            out: Of the unknowns, shape (free_node_count, 3); only those of this kind are written.
        """
        super().displacement(before, after, out)
        _hinged_displacement(
            before, after, self.hinged_nodes, self.hinges.parents, self.hinges.axes,
            self._first_own, out,
        )  # fmt: skip

    def raise_largest(self, vectors: np.ndarray, are_forces: bool, largest: np.ndarray) -> None:
        """Raise a number to the largest displacement [m] or force [N] at the rim; see `UnknownKind`."""
        super().raise_largest(vectors, are_forces, largest)
        own = np.linalg.norm(vectors[self.own], axis=1)
        own = own / self.hinges.radii if are_forces else own * self.hinges.radii
        # The maximum of numpy is NaN where any of the two is.
        largest[0] = np.maximum(largest[0], own.max(initial=0.0))

    def write_derivatives(self, positions: np.ndarray, out: np.ndarray) -> None:
        """Write D of every carried point, shape (carried_count, 3, 3, 3); see `UnknownKind`."""
        x, rigid = positions, self._rigid_points
        write_levers(x, self._carried_nodes, self._carried_origins, out[:rigid])
        out[:rigid, 2] = 0.0
        joints = self.hinges
        _write_hinged_levers(x, self.hinged_nodes, joints.parents, joints.axes, out[rigid:])

    def add_turning(self, positions: np.ndarray, forces: np.ndarray, out: np.ndarray) -> None:
        """Add the turning terms of all carried points; see `UnknownKind`."""
        x, rigid, joints = positions, self._rigid_points, self.hinges
        add_lever_turning(
            x, self._carried_nodes, self._carried_origins, self._carried_bodies, forces[:rigid],
            out,
        )  # fmt: skip
        _add_hinged_turning(
            x, self.hinged_nodes, joints.parents, joints.axes, joints.free_parents, forces[rigid:],
            out, self._first_own_block, self._crosses,
        )  # fmt: skip


@njit(**KERNEL)
def _write_twist_maps(x, nodes, parents, axes, out):
    """Derivatives of the place and of the turn of each hinged frame; two lines of blocks for each.
    """
    for k in range(len(nodes)):
        centre, _ = _parent_pose(x, parents[k])
        place, turn = out[2 * k], out[2 * k + 1]
        set_rows(place[0], IDENTITY)
        set_rows(place[1], cross_matrix(subtract(centre, row(x, nodes[k]))))
        set_rows(turn[1], IDENTITY)
        set_rows(turn[2], _turn_map(x, nodes[k], row(axes, k)))


@njit(**KERNEL)
def _add_twist_turning(x, nodes, parents, axes, twists, out, own_count):
    """Add the turning terms of a force and a moment on each hinged frame.

    For each there is a block of its parent's rotation; behind all of these one of (rotation, own).
    """
    for k in range(len(nodes)):
        centre, _ = _parent_pose(x, parents[k])
        f, m = row(twists, 2 * k), row(twists, 2 * k + 1)
        add_block(out[k], _lever_turning(f, subtract(row(x, nodes[k]), centre)))
        S = _turn_map(x, nodes[k], row(axes, k))
        add_block(out[own_count + k], product(cross_matrix(scaled(m, 0.5)), S))


class HingedTwists:
    """Places and turns of hinged frames as carried points: what a beam needs at its ends.

    Each hinged frame has two of them from `free_count` on, its place and its turn, as a free body
    has two unknowns. A term that knows frames by such pairs of unknowns (force and torque on each)
    takes a hinged frame as if it were free; `on_unknowns` folds it. It has the members of
    `CarriedPoints` that are needed for this.

    Attributes:
        free_count: Number of unknowns; places and turns are numbered from here on.
        count: Number of places and turns.
        unknowns: Unknowns that each depends on, -1 where none, shape (count, 3).
        derivatives: D at the state given to `update` last, shape (count, 3, 3, 3).
        turning_unknowns: Row of each turning block, shape (turning_count,).
        turning_columns: Its column, same shape.
    """

    def __init__(self, frames: HingedFrames):
        """Number places and turns.

        Args:
            frames: The hinged frames.
        """
        self._frames = frames
        self.free_count, self.count = frames.free_node_count, 2 * frames.hinge_count
        self.derivatives = np.zeros((self.count, 3, 3, 3))
        self.unknowns = np.repeat(frames._of_hinge, 2, axis=0)
        self.unknowns[0::2, 2] = -1
        self.unknowns[1::2, 0] = -1
        self._with_free = np.flatnonzero(frames.hinges.free_parents >= 0)
        rotations = frames._of_hinge[self._with_free, 1]
        self.turning_unknowns = np.concatenate([rotations, rotations])
        self.turning_columns = np.concatenate([rotations, frames.own[self._with_free]])

    def place(self, hinge: int) -> int:
        """Index of the place of a hinged frame; that of its turn comes next.

        Args:
            hinge: Number of the hinge.
        """
        return self.free_count + 2 * hinge

    def update(self, positions: np.ndarray) -> None:
        """Compute D at a state: node positions [m], shape (node_count, 3).

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        frames = self._frames
        _write_twist_maps(
            positions, frames.hinged_nodes, frames.hinges.parents, frames.hinges.axes,
            self.derivatives,
        )  # fmt: skip

    def fold_forces(self, twists: np.ndarray, forces: np.ndarray, own: np.ndarray) -> None:
        """Add Dᵀ of forces [N] and moments [N m], shape (count, 3); see `CarriedPoints`."""
        fold_own_forces(own, self.unknowns, self.derivatives, twists, forces)

    def shared_unknowns(self, own: np.ndarray) -> None:
        """None: their derivatives are not constant; see `CarriedPoints`."""

    def turning(self, positions: np.ndarray, twists: np.ndarray) -> np.ndarray:
        """Turning terms of forces and moments, shape (turning_count, 3, 3).

        Args:
            positions: Node positions [m], shape (node_count, 3).
            twists: Force [N] and moment [N m] on each hinged frame in turn, shape (2 hinge_count,
                3).
        """
        frames, own = self._frames, self._with_free
        blocks = np.zeros((2 * len(own), 3, 3))
        pairs = np.ascontiguousarray(twists.reshape(-1, 2, 3)[own].reshape(-1, 3))
        _add_twist_turning(
            positions, frames.hinged_nodes[own], frames.hinges.parents[own],
            frames.hinges.axes[own], pairs, blocks, len(own),
        )  # fmt: skip
        return blocks


@njit(**KERNEL)
def _add_unused(offsets, strides, is_ball, stiffness, share, storage):
    """Add to the diagonal of each own block what keeps the matrix definite."""
    for k in range(len(offsets)):
        for i in range(3):
            is_used = i == 0 or is_ball[k]
            added = share * stiffness[k] if is_used else stiffness[k]
            storage[offsets[k] + i * (strides[k] + 1)] += added


# Share of a typical stiffness that joints have in the matrix: far above round-off, and small enough
# that Newton's method does not notice; and that of a projected stiffness.
LEAST_STIFFNESS, PROJECTED_STIFFNESS = 1.0e-5, 1.0e-2


class HingeBlocks(OwnBlocks):
    """What keeps the matrix definite at hinges. It exerts no forces.

    The two unused numbers of each hinge do no work and receive no force; a positive diagonal holds
    them at zero. A beam may spin about its axis between ball joints, which nothing resists: a
    stiffness of a share of 1e-5 keeps it at rest. A projected stiffness has more on the angles:
    without turning terms nothing else may resist there, and the moves are only the shorter for it.
    """

    name = "hinges"

    def __init__(self, unknowns, is_ball, stiffness):
        """Take the joints.

        Args:
            unknowns: The unknown of each joint's turn, shape (hinge_count,).
            is_ball: Whether it may turn about all axes, so that all three numbers are used, same shape.
            stiffness: A typical stiffness of what each joint carries [N m], same shape, positive.
        """
        self._stencils, self._is_ball = np.asarray(unknowns)[:, None], np.asarray(is_ball)
        self._stiffness = np.array(stiffness, float)

    def add_forces(self, positions: np.ndarray, forces: np.ndarray) -> int:
        """Adds none; see `ForceTerm.add_forces`."""
        return 0

    def add_stiffness(self, positions, storage, projected: bool) -> None:
        """Add the diagonal; see `ForceTerm.add_stiffness`."""
        share = PROJECTED_STIFFNESS if projected else LEAST_STIFFNESS
        _add_unused(self._offsets, self._strides, self._is_ball, self._stiffness, share, storage)
