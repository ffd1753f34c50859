"""Rigid bodies: their frames, their inertia and their damping.

A rigid body is described by four nodes, so that one mapping carries points on soft and on rigid
bodies. Its frame nodes are its origin c and the tips c + R e_x, c + R e_y, c + R e_z, one metre
away from it. A point r of the body is

    x = (1 - r_x - r_y - r_z) c + r_x tip_x + r_y tip_y + r_z tip_z:

the weights are constant, as on a tetrahedron (Coevoet 2017, section 6.2).

A free body has two unknowns of three directions: the translation of c, and a rotation vector θ in
world axes, R ← exp([θ]×) R. Its frame nodes have no unknowns of their own; `kinematics` transforms
forces, rows and stiffness at points of the body to the two unknowns.

Inertia is that of Coevoet 2017, eq. (1), M v̇, by backward Euler. Momentum and angular momentum at
the end of the step, m Δc/h and J φ/h with J = R I Rᵀ and φ = log(R R₀ᵀ), differ from those at its
beginning by the impulse of the step:

    force = -(m Δc/h - m v₀)/h,    torque = -(J φ/h - J₀ ω₀)/h.

A body without torque therefore keeps its angular momentum in the world exactly, at any time step.
Its energy never grows: with Π the angular momentum in the body's frame and Ω = I⁻¹ Π, the step
gives Π₀ - Π = (exp([hΩ]×) - 1) Π, which is at right angles to Ω, so that the energy lost is half of
(Π₀ - Π)·I⁻¹(Π₀ - Π).

With a weight other than 1, for a scheme of second order, the inertia is J in the middle of the turn:
the implicit midpoint rule, which keeps the angular momentum of a free body too, and treats both
directions of time alike, so that its energy does not drift.

Damping in proportion to mass (Rayleigh's α, or the drag of viscous motion) is

    force = -α m Δc/h,    torque = -α J φ/h.

Both have the form p - s m Δc and l - s J φ. A turn θ on top of R changes J φ by
(J Jr⁻¹(φ) - [J φ]×) θ, where Jr⁻¹ is the inverse of the right Jacobian; see `middle_stiffness` for J
in the middle. Only the symmetric part of
this goes to the stiffness. The rest is smaller by the angle turned in the step times the difference
of the principal moments, and Newton's iteration contracts by about that: to 1e-12 in 9 iterations
at 0.05 rad a step, in 36 at 0.5 rad, and not at all from about 1 rad on (moments 1 : 2 : 2.8; in
one iteration where they are equal).

Arguments of the kernels here; those of one body have no first axis:
    are_forces: Whether the vectors are forces [N] and [N m]; else moves [m] and [rad].
    before, after, x: Node positions [m], shape (node_count, 3).
    bodies, nodes: Free body and node of each attached point, shape (point_count,).
    centre: Its place [m], three numbers.
    centres, pushes, twists: Of each free body [m], [N] and [N m], shape (body_count, 3).
    first_unknown: Unknown of the translation of the first free body.
    forces, rates, vectors, velocities, move: Of the unknowns, shape (free_node_count, 3); forces of
        `add_lever_turning` at the points, shape (point_count, 3).
    in_middle: Whether J is that of the middle of the turn.
    inertias, inverses, rotations: Of each free body, shape (body_count, 3, 3).
    inertia: One of them, shape (3, 3).
    local: Attached points in the frames of their bodies [m], shape (point_count, 3).
    masses, radii: Of each free body [kg] and [m], shape (body_count,).
    offsets, strides: Places of the blocks of each free body in storage, shape (2 body_count,).
    origins: Origin node of each free body, or of that of each point, shape (count,).
    out: Of the unknowns, shape (free_node_count, 3); levers, shape (point_count, 2, 3, 3); blocks,
        shape (body_count, 3, 3); or momenta, shape (body_count, 3).
    R: Rotation, three rows of three numbers.
    scale: s [1/s²].
    storage: The factorization's storage, shape (size,); added to.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np

from softrobot_twin.geometry.matrix3 import (
    IDENTITY,
    add_scaled_matrix,
    cross_matrix,
    product,
    product_transposed,
    rows,
    set_rows,
    transform,
    transposed,
)
from softrobot_twin.geometry.vector3 import (
    add,
    add_scaled,
    dot,
    is_zero,
    negated,
    row,
    scaled,
    set_row,
    subtract,
)
from softrobot_twin.kernels.compilation import INLINED, KERNEL, ONCE, njit
from softrobot_twin.mechanics.barycentric import BarycentricMapping
from softrobot_twin.mechanics.force_term import InertiaTerm, OwnBlocks
from softrobot_twin.mechanics.rotation import (
    exponential,
    inverse_jacobian,
    left_jacobian,
    orthonormalised,
    turn_between,
)


@njit(**INLINED)
def axes_at(x, origin):
    """Axes of the body whose origin is node `origin`, from its tips: the rows of Rᵀ."""
    centre = row(x, origin)
    return (
        subtract(row(x, origin + 1), centre),
        subtract(row(x, origin + 2), centre),
        subtract(row(x, origin + 3), centre),
    )


@njit(**INLINED)
def rotation_at(x, origin):
    """Rotation R of the body whose origin is node `origin`."""
    return transposed(axes_at(x, origin))


def _numbers(vector) -> tuple[float, ...]:
    """A vector as kernels take it."""
    return tuple(map(float, vector))


@njit(**KERNEL, forceinline=True)
def write_frame(centre, R, x, origin):
    """Write the four frame nodes of a body for its origin and rotation."""
    axes = transposed(R)
    set_row(x, origin, centre)
    set_row(x, origin + 1, add(centre, axes[0]))
    set_row(x, origin + 2, add(centre, axes[1]))
    set_row(x, origin + 3, add(centre, axes[2]))


@njit(**KERNEL)
def advance_kernel(x, origins, first_unknown, move, share):
    """Move free bodies by a share of a move; one that does not move is the same to the bit."""
    for k in range(len(origins)):
        n, t = origins[k], first_unknown + 2 * k
        translation, turn = scaled(row(move, t), share), scaled(row(move, t + 1), share)
        if is_zero(translation) and is_zero(turn):
            continue
        R = orthonormalised(product(exponential(turn), rotation_at(x, n)))
        write_frame(add(row(x, n), translation), R, x, n)


@njit(**KERNEL)
def displacement_kernel(before, after, origins, first_unknown, out):
    """Translation and rotation vector of each free body from one state to another."""
    for k in range(len(origins)):
        n, t = origins[k], first_unknown + 2 * k
        set_row(out, t, subtract(row(after, n), row(before, n)))
        set_row(out, t + 1, turn_between(rotation_at(before, n), rotation_at(after, n)))


@njit(**KERNEL)
def place_attached(x, nodes, origins, local):
    """Write the positions of attached nodes, by the frames of their bodies."""
    for k in range(len(nodes)):
        axes, place = axes_at(x, origins[k]), row(x, origins[k])
        place = add_scaled(place, axes[0], local[k, 0])
        place = add_scaled(place, axes[1], local[k, 1])
        set_row(x, nodes[k], add_scaled(place, axes[2], local[k, 2]))


@njit(**KERNEL)
def raise_to_rim(vectors, first_unknown, radii, are_forces, largest):
    """Raise a finite number, shape (1,), to the largest of some moves or forces; rotations count by
    the displacement of the body's furthest point.
    """
    for k in range(len(radii)):
        for part in range(2):
            square = 0.0
            for i in range(3):
                value = vectors[first_unknown + 2 * k + part, i]
                if part == 1:
                    value = value / radii[k] if are_forces else value * radii[k]
                square += value * value
            found = np.sqrt(square)
            # A comparison with NaN is false, but the result must not be finite then.
            if largest[0] < np.inf and not found <= largest[0]:
                largest[0] = found


@njit(**KERNEL)
def write_levers(x, nodes, origins, out):
    """Derivatives of points on rigid bodies: 1 by the translation, -[ρ]× with ρ = x - c by the
    rotation.
    """
    for k in range(len(nodes)):
        set_rows(out[k, 0], IDENTITY)
        lever = subtract(row(x, nodes[k]), row(x, origins[k]))
        set_rows(out[k, 1], cross_matrix(negated(lever)))


@njit(**KERNEL)
def add_lever_turning(x, nodes, origins, bodies, forces, out):
    """Add f·ρ 1 - (f ρᵀ + ρ fᵀ)/2 of every point to the block of its body's rotation."""
    for k in range(len(nodes)):
        lever = subtract(row(x, nodes[k]), row(x, origins[k]))
        force, block = row(forces, k), out[bodies[k]]
        along = dot(force, lever)
        for i in range(3):
            for j in range(3):
                block[i, j] -= 0.5 * (force[i] * lever[j] + force[j] * lever[i])
            block[i, i] += along


class AttachedNodes(NamedTuple):
    """Nodes of soft bodies that are attached to free rigid bodies.

    Attributes:
        nodes: The nodes, shape (count,).
        bodies: Place of each node's body among the free rigid bodies, shape (count,).
        local: Their positions in the body's frame [m], shape (count, 3).
    """

    nodes: np.ndarray
    bodies: np.ndarray
    local: np.ndarray


NOTHING_ATTACHED = AttachedNodes(np.empty(0, np.int64), np.empty(0, np.int64), np.empty((0, 3)))


class RigidFrames:
    """Numbering of the frame nodes and the unknowns of rigid bodies, and the motion of the bodies.

    It is the `UnknownKind` of rigid bodies: its carried points are the frame nodes of the free
    bodies, four each, followed by the nodes attached to free bodies.

    Attributes:
        first_node: Origin node of the first body; four nodes a body from there on.
        body_count: Number of bodies, free and guided.
        free: Whether each body is free (or else guided), shape (body_count,).
        free_bodies: The free ones among the bodies, shape (free_body_count,).
        origins: Origin node of each free body, shape (free_body_count,).
        first_unknown: Translation of the first free body; its rotation comes next, and so on.
        free_node_count: Number of unknowns; carried points are numbered from here on.
        translations: Translation unknown of each free body, shape (free_body_count,).
        rotations: Its rotation unknown, shape (free_body_count,).
    """

    is_traceable = True
    has_constant_derivatives = False

    def __init__(
        self, first_node: int, free, first_unknown: int, free_node_count: int,
        radii=None, attached: AttachedNodes = NOTHING_ATTACHED,
    ):  # fmt: skip
        """Number nodes and unknowns.

        Args:
            first_node: Number of nodes before the first frame node.
            free: Whether each rigid body is free, shape (body_count,).
            first_unknown: Number of unknowns before those of rigid bodies.
            free_node_count: Number of all unknowns.
            radii: Distance of the furthest point of each free body from its origin [m], turns
                angles into displacements and torques into forces, shape (free_body_count,); one
                metre when left out.
            attached: Nodes attached to free bodies.
        """
        self.free = np.asarray(free, dtype=bool).reshape(-1)
        self.first_node = int(first_node)
        self.body_count = len(self.free)
        self.free_bodies = np.flatnonzero(self.free)
        self.origins = self.first_node + 4 * self.free_bodies
        self.first_unknown = int(first_unknown)
        self.free_node_count = int(free_node_count)
        self.translations = self.first_unknown + 2 * np.arange(len(self.free_bodies))
        self.rotations = self.translations + 1
        self.radii = np.ones(len(self.free_bodies)) if radii is None else np.array(radii, float)
        self.attached = attached
        corners = self.origins[:, None] + np.arange(4)
        self._carried_nodes = np.concatenate([corners.ravel(), attached.nodes])
        own = np.arange(len(self.free_bodies))
        self._carried_bodies = np.concatenate([np.repeat(own, 4), attached.bodies])
        self._carried_origins = self.origins[self._carried_bodies]
        self.carried_unknowns = np.column_stack([
            self.translations[self._carried_bodies], self.rotations[self._carried_bodies]
        ])  # fmt: skip
        self.turning_unknowns = self.turning_columns = self.rotations

    @property
    def free_body_count(self) -> int:
        """Number of free bodies."""
        return len(self.free_bodies)

    def unknowns_of(self, first_nodes: np.ndarray) -> np.ndarray:
        """Translation of some bodies, -1 where one is not free, shape (count,).

        Args:
            first_nodes: Origin node of each, shape (count,).
        """
        unknowns = np.full(self.body_count, -1, np.int64)
        unknowns[self.free_bodies] = self.translations
        return unknowns[(np.asarray(first_nodes) - self.first_node) // 4]

    def free_index(self) -> np.ndarray:
        """Index of each frame node: of its carried point, or -1, shape (4 body_count,)."""
        index = np.full((self.body_count, 4), -1, dtype=np.int64)
        virtual = self.free_node_count + np.arange(4 * self.free_body_count)
        index[self.free_bodies] = virtual.reshape(-1, 4)
        return index.ravel()

    def attached_index(self) -> np.ndarray:
        """Index of the carried point of each attached node, shape (attached_count,)."""
        first = self.free_node_count + 4 * self.free_body_count
        return first + np.arange(len(self.attached.nodes))

    def points(self, body: int, points) -> BarycentricMapping:
        """Points that move with a body.

        Args:
            body: Its index among all rigid bodies.
            points: In the body's frame [m], shape (point_count, 3).

        Returns:
            Their mapping, weights constant.
        """
        points = np.asarray(points, dtype=float).reshape(-1, 3)
        nodes = np.tile(self.first_node + 4 * body + np.arange(4), (len(points), 1))
        return BarycentricMapping(nodes, np.column_stack([1.0 - points.sum(axis=1), points]))

    @staticmethod
    def rest_nodes(poses: Sequence[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
        """Frame nodes of bodies.

        Args:
            poses: Origin [m], shape (3,), and rotation, shape (3, 3), of each body.

        Returns:
            Node positions [m], shape (4 body_count, 3).
        """
        nodes = np.empty((4 * len(poses), 3))
        for k, (origin, rotation) in enumerate(poses):
            write_frame(_numbers(origin), tuple(map(_numbers, rotation)), nodes, 4 * k)
        return nodes

    def pose(self, positions: np.ndarray, body: int) -> tuple[np.ndarray, np.ndarray]:
        """Origin [m], shape (3,), and rotation, shape (3, 3), of one of all bodies.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            body: Number of the body.
        """
        n = self.first_node + 4 * body
        return positions[n].copy(), (positions[n + 1 : n + 4] - positions[n]).T.copy()

    def place(self, positions: np.ndarray, body: int, origin, rotation) -> None:
        """Place one of all bodies; its frame nodes are overwritten.

        Args:
            positions: Node positions [m], shape (node_count, 3); changed.
            body: Its index among all rigid bodies.
            origin: New position of its origin [m], shape (3,).
            rotation: From its frame to the world, shape (3, 3).
        """
        axes = tuple(map(_numbers, rotation))
        write_frame(_numbers(origin), axes, positions, self.first_node + 4 * body)

    def advance(self, positions: np.ndarray, move: np.ndarray, share: float) -> None:
        """Move the free bodies: c ← c + share u, R ← exp([share θ]×) R.

        R is made orthonormal again, so that it stays a rotation over any number of steps.

        Args:
            positions: Node positions [m], shape (node_count, 3); changed.
            move: u [m] and θ [rad] of the unknowns, shape (free_node_count, 3).
            share: Share of the move that is made.
        """
        if not self.free_body_count:
            return
        advance_kernel(positions, self.origins, self.first_unknown, move, share)
        if len(self.attached.nodes):
            origins = self._carried_origins[4 * self.free_body_count :]
            place_attached(positions, self.attached.nodes, origins, self.attached.local)

    def recede(self, positions: np.ndarray, move: np.ndarray) -> None:
        """Undo a move: `advance` by the move leads back again.

        Args:
            positions: Node positions [m], shape (node_count, 3); changed.
            move: Of the unknowns [m] and [rad], shape (free_node_count, 3).
        """
        self.advance(positions, move, -1.0)

    def twist_derivatives(self, positions: np.ndarray) -> list:
        """None: free frames have unknowns of their own; see `HingedFrames.twist_derivatives`."""
        return []

    def displacement(self, before: np.ndarray, after: np.ndarray, out: np.ndarray) -> None:
        """Translation [m] and rotation vector log(R_after R_beforeᵀ) [rad] of the free bodies.

        Args:
            before: Node positions [m], shape (node_count, 3).
            after: Those of a later state; no body has turned by half a turn between.
            out: Of the unknowns, shape (free_node_count, 3); only rigid bodies' are written.
        """
        displacement_kernel(before, after, self.origins, self.first_unknown, out)

    def raise_largest(self, vectors: np.ndarray, are_forces: bool, largest: np.ndarray) -> None:
        """Raise a number to the largest displacement [m] or force [N] at the rim; see `UnknownKind`."""
        raise_to_rim(vectors, self.first_unknown, self.radii, are_forces, largest)

    def write_derivatives(self, positions: np.ndarray, out: np.ndarray) -> None:
        """Write 1 by the translation and -[x - c]× by the rotation; see `UnknownKind`."""
        write_levers(positions, self._carried_nodes, self._carried_origins, out)

    def add_turning(self, positions: np.ndarray, forces: np.ndarray, out: np.ndarray) -> None:
        """Add the change of the torque (x - c) × f with the rotation; see `UnknownKind`."""
        add_lever_turning(
            positions, self._carried_nodes, self._carried_origins, self._carried_bodies, forces, out
        )


@njit(**INLINED)
def world_inertia(R, inertia):
    """J = R I Rᵀ."""
    return product_transposed(product(R, rows(inertia)), R)


@njit(**KERNEL)
def add_motion_forces(
    x, origins, first_unknown, masses, inertias, centres, rotations, scale, in_middle, pushes,
    twists, forces,
):  # fmt: skip
    """Add p - s m Δc and l - s J φ of every body, J at the end or in the middle of its turn."""
    for k in range(len(origins)):
        n, t = origins[k], first_unknown + 2 * k
        R = rotation_at(x, n)
        moved = subtract(row(x, n), row(centres, k))
        push = add_scaled(row(pushes, k), moved, -(scale * masses[k]))
        turn = turn_between(rows(rotations[k]), R)
        if in_middle:
            R = product(exponential(scaled(turn, -0.5)), R)
        spin = transform(world_inertia(R, inertias[k]), turn)
        twist = add_scaled(row(twists, k), spin, -scale)
        set_row(forces, t, add(row(forces, t), push))
        set_row(forces, t + 1, add(row(forces, t + 1), twist))


@njit(**ONCE)
def middle_stiffness(J, turn):
    """∂(J φ)/∂θ with J in the middle of the turn φ, θ on top of its end.

    With Jl the left Jacobian, φ changes by Jl⁻¹(φ) θ, and the middle turns by half of Jl(φ/2) times
    that: J Jl⁻¹(φ) + (J [φ]× - [J φ]×) Jl(φ/2) Jl⁻¹(φ)/2.
    """
    change = inverse_jacobian(turn)
    moved = product(left_jacobian(scaled(turn, 0.5)), change)
    gyroscopic = product(J, cross_matrix(turn))
    gyroscopic = add_scaled_matrix(gyroscopic, cross_matrix(transform(J, turn)), -1.0)
    return add_scaled_matrix(product(J, change), product(gyroscopic, moved), 0.5)


@njit(**KERNEL)
def add_motion_stiffness(
    x, origins, masses, inertias, rotations, scale, in_middle, projected, offsets, strides, storage
):
    """Add s m, and the symmetric part of the derivative of s J φ or, where projected, s J alone.

    That is s J Jr⁻¹(φ) of J at the end, see `middle_stiffness` for J in the middle of the turn.
    """
    for k in range(len(origins)):
        R = rotation_at(x, origins[k])
        if in_middle:
            turn = turn_between(rows(rotations[k]), R)
            R = product(exponential(scaled(turn, -0.5)), R)
            block = world_inertia(R, inertias[k])
            if not projected:
                block = middle_stiffness(block, turn)
        else:
            block = world_inertia(R, inertias[k])
            if not projected:
                # The right Jacobian's inverse is the transpose of the left one's.
                turn = turn_between(rows(rotations[k]), R)
                block = product_transposed(block, inverse_jacobian(turn))
        for i in range(3):
            storage[offsets[2 * k] + i * (strides[2 * k] + 1)] += scale * masses[k]
        for j in range(3):
            o = offsets[2 * k + 1] + j * strides[2 * k + 1]
            for i in range(3):
                storage[o + i] += 0.5 * scale * (block[i][j] + block[j][i])


@njit(**KERNEL)
def remember_poses(x, origins, centres, rotations):
    """Origin and rotation of every free body."""
    for k in range(len(origins)):
        set_row(centres, k, row(x, origins[k]))
        set_rows(rotations[k], rotation_at(x, origins[k]))


class RigidMotion(OwnBlocks):
    """Force term whose forces follow the motion since the step's beginning.

    Nodes of beams are free bodies without a mass of their own, after all others.

    Attributes:
        masses: Mass of each free body that has one [kg], shape (count,).
        inertias: Inertia about its origin in its own frame [kg m²], shape (count, 3, 3).
    """

    remembers_start = True

    def __init__(self, frames: RigidFrames, masses, inertias):
        """Prepare.

        Args:
            frames: The rigid bodies; a free body's origin is its centre of mass.
            masses: Mass of the first free bodies [kg], shape (count,).
            inertias: Inertia about the centre of mass in the body's frame [kg m²],
                shape (count, 3, 3), symmetric.
        """
        self.masses = np.array(masses, dtype=float).reshape(-1)
        self.inertias = np.array(inertias, dtype=float).reshape(-1, 3, 3)
        count = len(self.masses)
        self._origins, self._first_unknown = frames.origins[:count], frames.first_unknown
        self._translations, self._rotation_unknowns = (
            frames.translations[:count], frames.rotations[:count]
        )
        self._centres = np.zeros((count, 3))
        self._rotations = np.tile(np.eye(3), (count, 1, 1))
        # Before the first step there is no motion yet, and no force.
        self._scale, self._in_middle = 0.0, False
        self._pushes, self._twists = np.zeros((count, 3)), np.zeros((count, 3))
        # Translation and rotation do not couple about the centre of mass.
        unknowns = np.column_stack([self._translations, self._rotation_unknowns])
        self._stencils = unknowns.reshape(-1, 1)

    def _remember_poses(self, positions: np.ndarray) -> None:
        remember_poses(positions, self._origins, self._centres, self._rotations)

    def add_forces(self, positions: np.ndarray, forces: np.ndarray) -> int:
        """Add the forces [N] and torques [N m]; it inverts no element."""
        add_motion_forces(
            positions, self._origins, self._first_unknown, self.masses,
            self.inertias, self._centres, self._rotations, self._scale, self._in_middle,
            self._pushes, self._twists, forces,
        )  # fmt: skip
        return 0

    def add_stiffness(self, positions, storage, projected: bool) -> None:
        """Add the stiffness.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            storage: The factorization's storage; added to.
            projected: True for a stiffness that is positive for any rotation. Else it may be
                indefinite where a body rotates by more than about a radian in a step.
        """
        add_motion_stiffness(
            positions, self._origins, self.masses, self.inertias, self._rotations,
            self._scale, self._in_middle, projected, self._offsets, self._strides, storage,
        )  # fmt: skip


@njit(**KERNEL)
def write_momenta(x, velocities, origins, first_unknown, inertias, out):
    """J ω of every free body."""
    for k in range(len(origins)):
        J = world_inertia(rotation_at(x, origins[k]), inertias[k])
        set_row(out, k, transform(J, row(velocities, first_unknown + 2 * k + 1)))


@njit(**KERNEL)
def carry_rates(before, after, origins, first_unknown, inertias, inverses, in_middle, rates):
    """Rates ω of every body become J₁⁻¹ J ω, J₁ of a later state and J of an earlier one.

    J is that of the earlier state itself, or of the middle of the turn between them.
    """
    for k in range(len(origins)):
        R, end = rotation_at(before, origins[k]), rotation_at(after, origins[k])
        if in_middle:
            R = product(exponential(scaled(turn_between(R, end), 0.5)), R)
        momentum = transform(world_inertia(R, inertias[k]), row(rates, first_unknown + 2 * k + 1))
        rate = transform(world_inertia(end, inverses[k]), momentum)
        set_row(rates, first_unknown + 2 * k + 1, rate)


class RigidInertia(RigidMotion, InertiaTerm):
    """Force term of the inertia of free rigid bodies; see `RigidMotion` for its attributes."""

    name = "rigid inertia"
    is_traceable = True

    def begin_step(self, positions: np.ndarray, velocities: np.ndarray, time_step: float) -> None:
        """Store the state and the momenta at the beginning of the step.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            velocities: Of the unknowns [m/s] and [rad/s], shape (free_node_count, 3).
            time_step: h [s].
        """
        self._remember_poses(positions)
        self._scale, self._in_middle = 1.0 / time_step**2, self.weight != 1.0
        self._write_momenta(positions, velocities, self._twists)
        self._twists /= time_step
        np.multiply(self.masses[:, None], velocities[self._translations], self._pushes)
        self._pushes /= time_step
        if self._in_middle:
            for values in (self._twists, self._pushes):
                values *= self.weight
            self._scale *= self.weight

    def add_accelerations(self, positions, forces, accelerations) -> None:
        """Add M⁻¹ f; see `InertiaTerm`."""
        accelerations[self._translations] += forces[self._translations] / self.masses[:, None]
        inverses = self._in_world(positions, self._inverse_inertias)
        torques = forces[self._rotation_unknowns]
        accelerations[self._rotation_unknowns] += np.einsum("kab,kb->ka", inverses, torques)

    def _in_world(self, positions: np.ndarray, matrices: np.ndarray) -> np.ndarray:
        """Matrices in the bodies' own axes in world axes, shape (count, 3, 3)."""
        R = positions[self._origins[:, None] + [1, 2, 3]] - positions[self._origins][:, None]
        return np.einsum("kia,kij,kjb->kab", R, matrices, R)

    def gyroscopic_rates(self, positions, velocities) -> tuple[np.ndarray, np.ndarray]:
        """Rotation unknowns, and J⁻¹ (ω × J ω) of each body [rad/s²], shapes (count,) and (count, 3).

        Args:
            positions: Node positions [m], shape (node_count, 3).
            velocities: Of the unknowns [m/s] and [rad/s], shape (free_node_count, 3).
        """
        momenta = self.angular_momenta(positions, velocities)
        torques = np.cross(velocities[self._rotation_unknowns], momenta)
        inverses = self._in_world(positions, self._inverse_inertias)
        return self._rotation_unknowns, np.einsum("kab,kb->ka", inverses, torques)

    def world_blocks(self, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Blocks of the mass matrix: their unknowns, and m 1 or J of each [kg] or [kg m²].

        Args:
            positions: Node positions [m], shape (node_count, 3).

        Returns:
            Of shapes (2 count,) and (2 count, 3, 3).
        """
        blocks = [self.masses[:, None, None] * np.eye(3), self._in_world(positions, self.inertias)]
        return (
            np.concatenate([self._translations, self._rotation_unknowns]), np.concatenate(blocks)
        )

    def carry_rates(
        self, before: np.ndarray, after: np.ndarray, rates: np.ndarray, in_middle: bool = False
    ) -> None:
        """Rates that have at a later state the angular momentum which they had earlier.

        Args:
            before: Node positions of the earlier state [m], shape (node_count, 3).
            after: Those of the later state [m], same shape.
            rates: Of the unknowns, shape (free_node_count, 3); those of rotations are changed.
            in_middle: Whether the momentum is that in the middle of the turn between them.
        """
        carry_rates(
            before, after, self._origins, self._first_unknown,
            self.inertias, self._inverse_inertias, in_middle, rates,
        )  # fmt: skip

    @cached_property
    def _inverse_inertias(self) -> np.ndarray:
        """Inverse inertia of each body in its own frame [1/(kg m²)], shape (count, 3, 3)."""
        return np.linalg.inv(self.inertias)

    def angular_momenta(self, positions: np.ndarray, velocities: np.ndarray) -> np.ndarray:
        """Angular momentum of each body about its centre [N m s], shape (count, 3).

        Args:
            positions: Node positions [m], shape (node_count, 3).
            velocities: Of the unknowns [m/s, rad/s], shape (free_node_count, 3).
        """
        momenta = np.empty((len(self.masses), 3))
        self._write_momenta(positions, velocities, momenta)
        return momenta

    def _write_momenta(self, positions, velocities, out) -> None:
        write_momenta(
            positions, velocities, self._origins, self._first_unknown,
            self.inertias, out,
        )  # fmt: skip

    def kinetic_energy(self, positions: np.ndarray, velocities: np.ndarray) -> float:
        """½ m v² + ½ ω·J ω of all free bodies [J]."""
        linear = velocities[self._translations]
        angular = velocities[self._rotation_unknowns]
        spinning = np.sum(self.angular_momenta(positions, velocities) * angular)
        return 0.5 * float(self.masses @ np.sum(linear**2, axis=1) + spinning)


class RigidDamping(RigidMotion):
    """Force term of damping by mass and inertia."""

    name = "rigid damping"
    is_traceable = True

    def __init__(self, frames: RigidFrames, masses, inertias, rates):
        """Prepare.

        Args:
            frames: The rigid bodies; a free body's origin is its centre of mass.
            masses: Mass of each free body [kg], shape (count,).
            inertias: Inertia about the centre of mass in the body's frame [kg m²],
                shape (count, 3, 3).
            rates: α of each [1/s], shape (count,), or one for all.
        """
        rates = np.broadcast_to(np.asarray(rates, dtype=float), np.shape(masses))
        super().__init__(frames, rates * masses, rates[:, None, None] * np.asarray(inertias))

    def begin_step(self, positions: np.ndarray, velocities: np.ndarray, time_step: float) -> None:
        """Remember where the step of h [s] begins; see `RigidInertia.begin_step`."""
        self._remember_poses(positions)
        self._scale = 1.0 / time_step
