"""Rigid bodies as four nodes each, so that one mapping carries points on soft and rigid bodies.

A rigid body's frame nodes are its origin c and the tips c + R e_x, c + R e_y, c + R e_z, one metre
out. A point r of the body is x = (1 - r_x - r_y - r_z) c + r_x tip_x + r_y tip_y + r_z tip_z: the
weights are constant, as on a tetrahedron (Coevoet 2017, section 6.2).

What moves is less: a free body has two unknowns of three directions, the translation of c and a
rotation vector θ in world axes, R ← exp([θ]×) R. Its frame nodes have virtual indices, behind all
unknowns. What is said at a frame node x (a force f, a block of a row of H) is brought to the two by

    translation: f,    rotation: (x - c) × f.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import njit

from softrobot_twin.mechanics.barycentric import BarycentricMapping
from softrobot_twin.mechanics.rotation import orthonormalise, write_exponential, write_turn


@njit(cache=True, nogil=True, error_model="numpy")
def read_rotation(x, origin, out):
    """R of the body whose origin is node `origin`, from its tips."""
    for a in range(3):
        for i in range(3):
            out[i, a] = x[origin + 1 + a, i] - x[origin, i]


@njit(cache=True, nogil=True, error_model="numpy")
def write_frame(centre, R, x, origin):
    """Put the four frame nodes of a body where its origin and rotation say."""
    for i in range(3):
        x[origin, i] = centre[i]
        for a in range(3):
            x[origin + 1 + a, i] = centre[i] + R[i, a]


@njit(cache=True, nogil=True, error_model="numpy")
def advance_kernel(x, origins, first_unknown, move, share, vectors, work):
    """Move free bodies by a share of a move; one that does not move keeps its bits."""
    centre, turn = vectors[0], vectors[1]
    R, change, turned = work[0], work[1], work[2]
    for k in range(len(origins)):
        n, t = origins[k], first_unknown + 2 * k
        still = True
        for i in range(3):
            centre[i] = x[n, i] + share * move[t, i]
            turn[i] = share * move[t + 1, i]
            still = still and share * move[t, i] == 0.0 and turn[i] == 0.0
        if still:
            continue
        read_rotation(x, n, R)
        write_exponential(turn, change)
        for i in range(3):
            for j in range(3):
                turned[i, j] = (
                    change[i, 0] * R[0, j] + change[i, 1] * R[1, j] + change[i, 2] * R[2, j]
                )
        orthonormalise(turned, change)
        write_frame(centre, turned, x, n)


@njit(cache=True, nogil=True, error_model="numpy")
def displacement_kernel(before, after, origins, first_unknown, work, out):
    """Translation and rotation vector of each free body from one state to another."""
    for k in range(len(origins)):
        n, t = origins[k], first_unknown + 2 * k
        for i in range(3):
            out[t, i] = after[n, i] - before[n, i]
        read_rotation(before, n, work[0])
        read_rotation(after, n, work[1])
        write_turn(work[0], work[1], work[2], out[t + 1])


class RigidFrames:
    """Where the frame nodes and the unknowns of rigid bodies lie, and how the bodies move.

    Attributes:
        first_node: Origin node of the first body; four nodes a body from there on.
        body_count: Number of bodies, free and guided.
        free: Whether each body is free (or else guided), shape (body_count,).
        free_bodies: The free ones among the bodies, shape (free_body_count,).
        origins: Origin node of each free body, shape (free_body_count,).
        first_unknown: Translation of the first free body; its rotation comes next, and so on.
        free_node_count: Number of unknowns; virtual indices start here.
        translations: Translation unknown of each free body, shape (free_body_count,).
        rotations: Its rotation unknown, shape (free_body_count,).
    """

    def __init__(self, first_node: int, free, first_unknown: int, free_node_count: int):
        """Number nodes and unknowns.

        Args:
            first_node: Number of nodes before the first frame node.
            free: Whether each rigid body is free, shape (body_count,).
            first_unknown: Number of unknowns before those of rigid bodies.
            free_node_count: Number of all unknowns.

        Raises:
            ValueError: The free bodies' unknowns do not fit in.
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
        if self.first_unknown + 2 * len(self.free_bodies) > self.free_node_count:
            raise ValueError(
                f"{len(self.free_bodies)} free bodies need two unknowns each from "
                f"{first_unknown} on, but there are {free_node_count} in all"
            )
        self._vectors, self._work = np.zeros((2, 3)), np.zeros((3, 3, 3))

    @property
    def free_body_count(self) -> int:
        """Number of free bodies."""
        return len(self.free_bodies)

    def free_index(self) -> np.ndarray:
        """The frame nodes' part of `free_index`: virtual, or -1, shape (4 body_count,)."""
        index = np.full((self.body_count, 4), -1, dtype=np.int64)
        virtual = self.free_node_count + np.arange(4 * self.free_body_count)
        index[self.free_bodies] = virtual.reshape(-1, 4)
        return index.ravel()

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
            write_frame(np.asarray(origin, float), np.asarray(rotation, float), nodes, 4 * k)
        return nodes

    def pose(self, positions: np.ndarray, body: int) -> tuple[np.ndarray, np.ndarray]:
        """Origin [m], shape (3,), and rotation, shape (3, 3), of one of all bodies."""
        n = self.first_node + 4 * body
        return positions[n].copy(), (positions[n + 1 : n + 4] - positions[n]).T.copy()

    def place(self, positions: np.ndarray, body: int, origin, rotation) -> None:
        """Put one of all bodies somewhere; its frame nodes are rewritten.

        Args:
            positions: Node positions [m], shape (node_count, 3); changed.
            body: Its index among all rigid bodies.
            origin: Where its origin goes [m], shape (3,).
            rotation: From its frame to the world, shape (3, 3).
        """
        centre, R = np.asarray(origin, float), np.asarray(rotation, float)
        write_frame(centre, R, positions, self.first_node + 4 * body)

    def advance(self, positions: np.ndarray, move: np.ndarray, share: float) -> None:
        """Move the free bodies: c ← c + share u, R ← exp([share θ]×) R.

        R is made orthonormal again, so that it stays a rotation over any number of steps.

        Args:
            positions: Node positions [m], shape (node_count, 3); changed.
            move: u [m] and θ [rad] of the unknowns, shape (free_node_count, 3).
            share: Share of the move that is made.
        """
        advance_kernel(
            positions, self.origins, self.first_unknown, move, share, self._vectors, self._work
        )

    def displacement(self, before: np.ndarray, after: np.ndarray, out: np.ndarray) -> None:
        """Translation [m] and rotation vector log(R_after R_beforeᵀ) [rad] of the free bodies.

        Args:
            before: Node positions [m], shape (node_count, 3).
            after: Those of a later state; no body has turned by half a turn between.
            out: Of the unknowns, shape (free_node_count, 3); only rigid bodies' are written.
        """
        displacement_kernel(before, after, self.origins, self.first_unknown, self._work, out)
