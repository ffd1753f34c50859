"""Points of a body in the coordinates of a basis: x = x₀ + Φ q.

The coordinates are three by three the positions of *coordinate nodes*, which are free nodes without
a place in space; so a step treats them as any unknowns. The points are carried points whose
derivatives D are Φ itself, the same in every state.

A body whose base rides on a platform is translated with it: x = x₀ + Φ q + s, with the displacement
s of the platform, which nothing but a slide moves and which never turns.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softrobot_twin.geometry.vector_arrays import gather_vectors
from softrobot_twin.kernels.compilation import KERNEL, njit
from softrobot_twin.mechanics.kinematics import longest_row

# Numbers that stay in the nearest cache while all coordinates are added.
BLOCK = 1024


@njit(**KERNEL)
def write_displacements(modes, coordinates, out):
    """Φ q, with all products in double precision.

    Args:
        modes: Φ by coordinates, single or double, shape (mode_count, 3 point_count); the count is
            a multiple of three.
        coordinates: q [m], shape (mode_count,).
        out: Takes the displacements [m], shape (3 point_count,).
    """
    out[:] = 0.0
    for begin in range(0, len(out), BLOCK):
        end = min(begin + BLOCK, len(out))
        own = out[begin:end]
        for m in range(0, len(coordinates), 3):
            q, r, s = coordinates[m], coordinates[m + 1], coordinates[m + 2]
            first, second = modes[m, begin:end], modes[m + 1, begin:end]
            third = modes[m + 2, begin:end]
            for k in range(len(own)):
                own[k] += q * first[k] + r * second[k] + s * third[k]


@njit(**KERNEL)
def place_points(positions, coordinate_nodes, modes, rest, first_point, coordinates, moved):
    """Write x₀ + Φ q of all points.

    Args:
        positions: Node positions [m], shape (node_count, 3); those of the points are written.
        coordinate_nodes: Nodes whose positions are the coordinates, shape (mode_count / 3,).
        modes: See `write_displacements`.
        rest: x₀ [m], shape (point_count, 3).
        first_point: Node that is the first point.
        coordinates: Takes q [m], shape (mode_count,).
        moved: Takes Φ q [m], shape (3 point_count,).
    """
    gather_vectors(positions, coordinate_nodes, coordinates.reshape(-1, 3))
    write_displacements(modes, coordinates, moved)
    for p in range(len(rest)):
        for i in range(3):
            positions[first_point + p, i] = rest[p, i] + moved[3 * p + i]


@njit(**KERNEL)
def raise_to_points(move, unknowns, modes, coordinates, moved, longest, largest):
    """Raise a number to the longest displacement of a point.

    A step asks for the same move several times, and in statics for the velocity, which is zero; all
    points are a large product.

    Args:
        move: Of all unknowns [m], shape (free_node_count, 3).
        unknowns: Unknowns that three coordinates each are, shape (mode_count / 3,).
        modes: See `write_displacements`.
        coordinates: Those that were moved last [m], shape (mode_count,); changed.
        moved: Memory for the displacements, shape (3 point_count,).
        longest: What the last move was, shape (1,); changed.
        largest: The number [m], shape (1,); changed where it is finite.
    """
    is_any, is_known = False, True
    for n in range(len(unknowns)):
        for i in range(3):
            value = move[unknowns[n], i]
            is_any = is_any or value != 0.0
            is_known = is_known and value == coordinates[3 * n + i]
            coordinates[3 * n + i] = value
    if not is_known:
        write_displacements(modes, coordinates, moved)
        longest[0] = longest_row(moved.reshape(-1, 3))
    if is_any and largest[0] < np.inf and not longest[0] <= largest[0]:
        largest[0] = longest[0]


class Platform(NamedTuple):
    """What a reduced body rides on.

    Attributes:
        node: The node of the scene that is the origin of its frame.
        origin: That node at rest [m], shape (3,).
    """

    node: int
    origin: np.ndarray

    def displacement(self, positions: np.ndarray) -> np.ndarray:
        """How far it is from its place at rest [m], shape (3,).

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        return positions[self.node] - self.origin


class ReducedPoints:
    """A kind of unknowns (`kinematics.UnknownKind`): the points that coordinates of a basis carry.

    Attributes:
        coordinate_nodes: Nodes whose positions are the coordinates, shape (mode_count / 3,).
        unknowns: Unknowns that three coordinates each are, same shape.
        carried_unknowns: All coordinates, for each point, shape (point_count, mode_count / 3).
        turning_unknowns: Empty: D does not depend on the state.
        turning_columns: Empty.
    """

    has_constant_derivatives = True

    def __init__(
        self, coordinate_nodes: np.ndarray, unknowns: np.ndarray, first_point: int,
        rest: np.ndarray, modes: np.ndarray, platform: Platform | None = None,
    ):  # fmt: skip
        """Take the points.

        Args:
            coordinate_nodes: Nodes whose positions are the coordinates, shape (mode_count / 3,).
            unknowns: Their unknowns, same shape.
            first_point: Index of the first point among all nodes.
            rest: Positions at rest [m], shape (point_count, 3).
            modes: Φ of each point, shape (point_count, 3, mode_count).
            platform: What the body rides on; None where its base stands still.
        """
        self._platform, self.is_traceable = platform, platform is None
        self.coordinate_nodes = np.asarray(coordinate_nodes, np.int64)
        self.unknowns = np.asarray(unknowns, np.int64)
        self._points, self._first_point = slice(first_point, first_point + len(rest)), first_point
        self._rest, self._modes = np.asarray(rest, float), np.ascontiguousarray(modes, float)
        by_coordinate = self._modes.reshape(3 * len(rest), self._modes.shape[2]).T
        # A basis is saved in single precision: nodes of a mesh that is not turned lose nothing, and
        # a surface of thousands of points is read in half the time.
        single = np.ascontiguousarray(by_coordinate, np.float32)
        is_exact = (single == by_coordinate).all()
        self._by_coordinate = single if is_exact else np.ascontiguousarray(by_coordinate)
        self._moved = np.zeros(3 * len(rest))
        self._measured, self._longest = np.zeros(len(by_coordinate)), np.zeros(1)
        self._coordinates = np.zeros(len(by_coordinate))
        self.carried_unknowns = np.tile(self.unknowns, (len(rest), 1))
        self.turning_unknowns = self.turning_columns = np.empty(0, np.int64)

    def advance(self, positions: np.ndarray, move: np.ndarray, share: float) -> None:
        """Place the points, after the coordinates were moved; see `Nodes.advance`."""
        self.place(positions)

    def place(self, positions: np.ndarray) -> None:
        """Place the points by the coordinates.

        Args:
            positions: Node positions [m], shape (node_count, 3); those of the points are written.
        """
        place_points(
            positions, self.coordinate_nodes, self._by_coordinate, self._rest, self._first_point,
            self._coordinates, self._moved,
        )  # fmt: skip
        if self._platform is not None:
            moved = self._moved.reshape(-1, 3)
            moved += self._platform.displacement(positions)
            np.add(self._rest, moved, out=positions[self._points])

    def displacement(self, before: np.ndarray, after: np.ndarray, out: np.ndarray) -> None:
        """Writes nothing: coordinates are free nodes; see `Nodes.displacement`."""

    def raise_largest(self, vectors: np.ndarray, are_forces: bool, largest: np.ndarray) -> None:
        """Raise a number to the longest displacement of a point; forces on coordinates are those on
        free nodes; see `UnknownKind`."""
        if not are_forces and len(self._rest):
            raise_to_points(
                vectors, self.unknowns, self._by_coordinate, self._measured, self._moved,
                self._longest, largest,
            )  # fmt: skip

    def write_derivatives(self, positions: np.ndarray, out: np.ndarray) -> None:
        """Write D = Φ of every point; see `UnknownKind.write_derivatives`."""
        count, width = self.carried_unknowns.shape
        by_block = self._modes.reshape(count, 3, width, 3).transpose(0, 2, 1, 3)
        out[:, :width] = by_block

    def add_turning(self, positions: np.ndarray, forces: np.ndarray, out: np.ndarray) -> None:
        """Adds nothing: D does not depend on the state; see `UnknownKind`."""
