"""Surfaces that may touch: their points now, and which nodes carry a point of one of them.

A contact has up to four nodes on each side, with constant weights: three of a deformable body's
triangle, the four frame nodes of a rigid body, none where the surface stands still. Where a body
carries a contact surface of its own it has the nodes that carry three points of that.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from softrobot_twin.mechanics.barycentric import BarycentricMapping, writable

NO_NODE = -1


@njit(cache=True, nogil=True, error_model="numpy")
def gather_points(x, nodes, out):
    """Copy some rows."""
    for p in range(len(nodes)):
        for i in range(3):
            out[p, i] = x[nodes[p], i]


@njit(cache=True, nogil=True, error_model="numpy")
def carry_by_vertices(point_nodes, points, weights, sign, column, nodes, coefficients):
    """Points inside triangles of a deformable body: its three vertices carry them."""
    for c in range(len(points)):
        for k in range(3):
            weight = weights[c, k]
            nodes[c, column + k] = point_nodes[points[c, k]] if weight != 0.0 else NO_NODE
            coefficients[c, column + k] = sign * weight
        nodes[c, column + 3] = NO_NODE
        coefficients[c, column + 3] = 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def carry_by_mapping(
    point_nodes, point_weights, points, weights, sign, column, nodes, coefficients
):
    """Points inside triangles of a carried surface: what carries its three points, each node once.

    Columns beyond the last are left as they are.
    """
    for c in range(len(points)):
        count = 0
        for k in range(3):
            if weights[c, k] == 0.0:
                continue
            p = points[c, k]
            for a in range(point_nodes.shape[1]):
                share = sign * weights[c, k] * point_weights[p, a]
                if share == 0.0:
                    continue
                place = 0
                while place < count and nodes[c, column + place] != point_nodes[p, a]:
                    place += 1
                if place == count:
                    nodes[c, column + place] = point_nodes[p, a]
                    coefficients[c, column + place] = 0.0
                    count += 1
                coefficients[c, column + place] += share


@njit(cache=True, nogil=True, error_model="numpy")
def carry_by_frame(x, frame, places, sign, column, nodes, coefficients):
    """Places on a rigid body: its four frame nodes carry them."""
    for c in range(len(places)):
        rest = 1.0
        for k in range(3):
            local = 0.0
            for i in range(3):
                local += (x[frame + 1 + k, i] - x[frame, i]) * (places[c, i] - x[frame, i])
            nodes[c, column + 1 + k] = frame + 1 + k
            coefficients[c, column + 1 + k] = sign * local
            rest -= local
        nodes[c, column] = frame
        coefficients[c, column] = sign * rest


class DeformableSurface:
    """The surface of a deformable body.

    Attributes:
        triangles: Indices of its points, shape (triangle_count, 3).
        point_count: Number of its points.
        rigid_points: None: it has no shape of its own to keep.
        width: Nodes that carry a place on it, at most.
    """

    rigid_points = None
    width = 4

    def __init__(self, triangles: np.ndarray):
        """Number the nodes of the surface.

        Args:
            triangles: Nodes of its triangles, shape (triangle_count, 3).
        """
        self.point_nodes, points = np.unique(triangles, return_inverse=True)
        self.triangles = points.reshape(-1, 3).astype(np.int64)
        self.point_count = len(self.point_nodes)
        self.nodes = self.point_nodes

    def points(self, positions: np.ndarray) -> np.ndarray:
        """Where its points are [m], shape (point_count, 3)."""
        points = np.empty((self.point_count, 3))
        gather_points(writable(positions), self.point_nodes, points)
        return points

    def carry(self, positions, points, weights, places, sign, column, nodes, coefficients) -> None:
        """Write the nodes that carry places on it, and their coefficients.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            points: Its points around each place, shape (count, 3).
            weights: Their barycentric weights, shape (count, 3).
            places: The places [m], shape (count, 3).
            sign: 1 for the first side of a contact, -1 for the second.
            column: First column to write, that of the first or of the second side.
            nodes: Takes the nodes, -1 before, shape (count, 2 widths).
            coefficients: Takes the coefficients, 0 before, of the same shape.
        """
        carry_by_vertices(self.point_nodes, points, weights, sign, column, nodes, coefficients)


class CarriedSurface:
    """A surface that a deformable body carries; see `DeformableSurface`."""

    rigid_points = None

    def __init__(self, mapping: BarycentricMapping, triangles: np.ndarray):
        """Take the surface.

        Args:
            mapping: Its points, as the body's nodes carry them.
            triangles: Indices of its points, shape (triangle_count, 3).
        """
        self._mapping = mapping
        self._nodes = np.array(mapping.nodes, dtype=np.int64)
        self._weights = np.array(mapping.barycentric_weights, dtype=float)
        self.triangles = np.ascontiguousarray(triangles, dtype=np.int64)
        self.point_count = mapping.point_count
        self.nodes = np.unique(self._nodes)
        self.width = 3 * self._nodes.shape[1]

    def points(self, positions: np.ndarray) -> np.ndarray:
        """Where its points are [m], shape (point_count, 3)."""
        return self._mapping.positions(positions)

    def carry(self, positions, points, weights, places, sign, column, nodes, coefficients) -> None:
        """See `DeformableSurface.carry`."""
        carry_by_mapping(
            self._nodes, self._weights, points, weights, sign, column, nodes, coefficients
        )


class RigidSurface:
    """A shape or surface that moves with the frame of a rigid body."""

    width = 4

    def __init__(self, frame: int, points: np.ndarray, triangles: np.ndarray):
        """Take the surface.

        Args:
            frame: Its first frame node.
            points: Points in the body's frame [m], shape (point_count, 3).
            triangles: Indices of them, shape (triangle_count, 3).
        """
        self._frame = frame
        self.rigid_points = self._local = np.asarray(points, float)
        self.triangles = np.asarray(triangles, np.int64)
        self.point_count = len(points)
        self.nodes = frame + np.arange(4)

    def pose(self, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Origin [m] and rotation of its frame, (3,) and (3, 3)."""
        frame = positions[self._frame : self._frame + 4]
        return frame[0], (frame[1:] - frame[0]).T

    def points(self, positions: np.ndarray) -> np.ndarray:
        """Where its points are [m], shape (point_count, 3)."""
        origin, rotation = self.pose(positions)
        return self._local @ rotation.T + origin

    def carry(self, positions, points, weights, places, sign, column, nodes, coefficients) -> None:
        """See `DeformableSurface.carry`."""
        carry_by_frame(positions, self._frame, places, sign, column, nodes, coefficients)


class StandingSurface:
    """A shape or surface that never moves."""

    width = 4

    def __init__(self, origin, rotation, points: np.ndarray, triangles: np.ndarray):
        """Take the surface.

        Args:
            origin: Where it stands [m], shape (3,).
            rotation: From its frame to the world, shape (3, 3).
            points: Points in its frame [m], shape (point_count, 3).
            triangles: Indices of them, shape (triangle_count, 3).
        """
        self._pose = np.asarray(origin, float), np.asarray(rotation, float)
        self.rigid_points = np.asarray(points, float)
        self._points = self.rigid_points @ self._pose[1].T + self._pose[0]
        self.triangles = np.asarray(triangles, np.int64)
        self.point_count = len(points)
        self.nodes = np.empty(0, np.int64)

    def pose(self, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Origin [m] and rotation of its frame, (3,) and (3, 3)."""
        return self._pose

    def points(self, positions: np.ndarray) -> np.ndarray:
        """Where its points are [m], shape (point_count, 3)."""
        return self._points

    def carry(self, positions, points, weights, places, sign, column, nodes, coefficients) -> None:
        """Nothing carries it."""
        nodes[:, column : column + 4] = NO_NODE
        coefficients[:, column : column + 4] = 0.0
