"""Pairs of things that may touch: their surfaces, and what is near between them.

A surface knows where its points are and which nodes carry a point of it. A contact has up to four
nodes on each side, with constant weights: three of a deformable body's triangle, the four frame
nodes of a rigid body, none where the surface stands still. Where a body carries a contact surface
of its own, it has the nodes that carry three points of that surface.

A pair finds what is nearer than a margin, by the detector that fits both of its sides. It writes
its contacts among those of all pairs; see `geometry/proximities.py` for `rows`, `span` and `reach`.

Arguments of the kernels here:
    column: First column of `nodes` and `coefficients` that is written.
    nodes, coefficients: Take the nodes that carry each contact, and their coefficients, shape
        (capacity, 2 widths). Columns that are not written stay as they are.
    points, weights: Surface points around each place and their barycentric weights, shape
        (capacity, 3).
    places: The places [m], shape (capacity, 3).
    sign: Factor of all coefficients, 1 or -1.
    span: First contact, and the one behind the last, shape (2,).
    x: Node positions [m], shape (node_count, 3).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from softrobot_twin.geometry.box_pairs import BoxPairDetector
from softrobot_twin.geometry.proximities import Proximities, found_by, put_pairs
from softrobot_twin.geometry.shapes.distance_kernels import measure_points
from softrobot_twin.geometry.solid_shape import SolidShapeDetector
from softrobot_twin.geometry.surface_pairs import SurfacePairDetector
from softrobot_twin.geometry.surface_shape import SurfaceShapeDetector
from softrobot_twin.kernels.compilation import KERNEL, njit
from softrobot_twin.mechanics.barycentric import BarycentricMapping, write_points

NO_NODE = -1


@njit(**KERNEL)
def read_pose(x, frame, origin, rotation):
    """Copy the pose of a rigid body.

    Args:
        x: Node positions [m], shape (node_count, 3).
        frame: First frame node of the body.
        origin: Takes its origin [m], shape (3,).
        rotation: Takes its axes as columns, shape (3, 3).
    """
    for i in range(3):
        origin[i] = x[frame, i]
        for k in range(3):
            rotation[i, k] = x[frame + 1 + k, i] - x[frame, i]


@njit(**KERNEL)
def carry_by_mapping(point_nodes, point_weights, points, weights, sign, column, span, nodes, coefficients):
    """Places inside triangles of a carried surface: what carries the corners, each node once.

    Args:
        point_nodes: Nodes that carry each surface point, shape (point_count, width).
        point_weights: Their weights, same shape.
    """
    for c in range(span[0], min(span[1], len(nodes))):
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


@njit(**KERNEL)
def carry_by_frame(x, frame, places, sign, column, span, nodes, coefficients):
    """Places on a rigid body: its four frame nodes carry them.

    Args:
        frame: First frame node of the body.
    """
    for c in range(span[0], min(span[1], len(nodes))):
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


class CarriedSurface:
    """A surface that a deformable body carries.

    Attributes:
        triangles: Indices of its points, shape (triangle_count, 3).
        point_count: Number of its points.
        nodes: Nodes that carry it.
        rigid_points: None: it has no shape of its own to keep.
        width: Nodes that carry a place on it, at most.
    """

    rigid_points = None

    def __init__(self, mapping: BarycentricMapping, triangles: np.ndarray):
        """Take the surface.

        Args:
            mapping: Its points, as the body's nodes carry them.
            triangles: Indices of its points, shape (triangle_count, 3).
        """
        self._nodes = np.array(mapping.nodes, dtype=np.int64)
        self._weights = np.array(mapping.barycentric_weights, dtype=float)
        self.triangles = np.ascontiguousarray(triangles, dtype=np.int64)
        self.point_count, self._points = mapping.point_count, np.empty((mapping.point_count, 3))
        self.nodes = np.unique(self._nodes)
        # A place lies in one triangle.
        own = np.sort(self._nodes[self.triangles].reshape(len(self.triangles), -1), axis=1)
        self.width = 1 + int(np.sum(np.diff(own, axis=1) != 0, axis=1).max(initial=0))

    def points(self, positions: np.ndarray) -> np.ndarray:
        """Where its points are [m], shape (point_count, 3); the next call overwrites them.

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        write_points(positions, self._nodes, self._weights, self._points)
        return self._points

    def outline(self, positions: np.ndarray) -> np.ndarray:
        """Points that tell how far it moves [m], shape (any, 3).

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        return self.points(positions).copy()

    def carry(self, positions, points, weights, places, *where) -> None:
        """Write the nodes that carry places on it, and their coefficients; may be traced.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            points: Its points around each place, shape (capacity, 3).
            weights: Their barycentric weights, shape (capacity, 3).
            places: The places [m], shape (capacity, 3).
            where: The last arguments of the kernels above, from `sign` on.
        """
        carry_by_mapping(self._nodes, self._weights, points, weights, *where)


class DeformableSurface(CarriedSurface):
    """The surface of a deformable body, whose points are nodes.

    Attributes:
        node_triangles: Nodes of its triangles, shape (triangle_count, 3).
    """

    def __init__(self, triangles: np.ndarray):
        """Number the nodes of the surface.

        Args:
            triangles: Nodes of its triangles, shape (triangle_count, 3).
        """
        nodes, points = np.unique(triangles, return_inverse=True)
        mapping = BarycentricMapping(nodes[:, None], np.ones((len(nodes), 1)))
        super().__init__(mapping, points.reshape(-1, 3))
        self.node_triangles = nodes[self.triangles]


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
        self._points, self._pose = np.empty((len(points), 3)), (np.empty(3), np.empty((3, 3)))

    def pose(self, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Origin [m] and rotation of its frame, (3,) and (3, 3).

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        frame = positions[self._frame : self._frame + 4]
        return frame[0], (frame[1:] - frame[0]).T

    def kept_pose(self, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The same in arrays that the next call overwrites; may be traced.

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        read_pose(positions, self._frame, *self._pose)
        return self._pose

    def points(self, positions: np.ndarray) -> np.ndarray:
        """See `CarriedSurface.points`; may not be traced.

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        origin, rotation = self.pose(positions)
        return np.add(self._local @ rotation.T, origin, out=self._points)

    def outline(self, positions: np.ndarray) -> np.ndarray:
        """See `CarriedSurface.outline`; of a plane, which has no end, its origin."""
        return np.vstack([self.points(positions), positions[self._frame]])

    def carry(self, positions, points, weights, places, *where) -> None:
        """See `CarriedSurface.carry`."""
        carry_by_frame(positions, self._frame, places, *where)


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
        self._pose = np.array(origin, float), np.array(rotation, float, order="C")
        self.rigid_points = np.asarray(points, float)
        self._points = self.rigid_points @ self._pose[1].T + self._pose[0]
        self.triangles = np.asarray(triangles, np.int64)
        self.point_count = len(points)
        self.nodes = np.empty(0, np.int64)

    def pose(self, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Origin [m] and rotation of its frame, (3,) and (3, 3).

        Args:
            positions: Node positions [m], shape (node_count, 3); not read.
        """
        return self._pose

    kept_pose = pose

    def points(self, positions: np.ndarray) -> np.ndarray:
        """Where its points are [m], shape (point_count, 3).

        Args:
            positions: Node positions [m], shape (node_count, 3); not read.
        """
        return self._points

    def carry(self, *_) -> None:
        """Nothing carries it.

        Args:
            *_: Arguments of `CarriedSurface.carry`; not read.
        """


class NoShape:
    """In place of the shape of a side that deforms."""


class Side:
    """A side of contact pairs.

    Attributes:
        name: Name of the body, beam or obstacle.
        surface: Its points and triangles, and what carries them, such as a `DeformableSurface`.
        shape: Shape of a rigid body or obstacle, in its frame; else a `NoShape`.
    """

    shape: Any = NoShape()

    def __init__(self, name: str, surface: Any, shape: Any = shape):
        """Take what is known of it; see the attributes."""
        self.name, self.surface, self.shape = name, surface, shape


class ContactPair:
    """Two things that may touch.

    Attributes:
        first: Surface of the first side.
        second: Surface of the second.
        shape: Shape of the second.
        friction: Coefficient µ.
        names: Names of both.
        is_traceable: Whether `write` may be traced; see `traced_stage.py`.
    """

    is_traceable = False

    def __init__(self, first: Side, second: Side, friction: float):
        """Take both sides.

        Args:
            first: The first side.
            second: The second.
            friction: Coefficient µ.
        """
        self.first, self.second, self.shape = first.surface, second.surface, second.shape
        self.friction, self.names = friction, (first.name, second.name)

    def near(self, positions: np.ndarray, margin: float) -> Proximities:
        """What is nearer than a margin [m].

        Args:
            positions: Node positions [m], shape (node_count, 3).
            margin: Distance below which points count as near [m].
        """
        return found_by(self.write, positions, margin=margin)

    def write(self, positions: np.ndarray, reach, rows: Proximities, span: np.ndarray) -> None:
        """Write what is near; a pair has this or `near`.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            reach: See `geometry/proximities.py`, as all that follow.
            rows: See there.
            span: See there.
        """
        put_pairs(self.near(positions, reach[0]), rows, span)


class SurfaceAndShape(ContactPair):
    """A triangle surface and a shape on a rigid body or an obstacle; see `ContactPair`."""

    is_traceable = True

    def __init__(self, first: Side, second: Side, friction: float):
        """See `ContactPair`."""
        super().__init__(first, second, friction)
        self._detector = self._make_detector(isinstance(first.shape, NoShape))

    def _make_detector(self, deforms: bool) -> SurfaceShapeDetector:
        return SurfaceShapeDetector(self.first.triangles, self.shape, deforms)

    def write(self, positions, reach, rows, span) -> None:
        """See `ContactPair.write`."""
        self._detector.write(
            self.first.points(positions), *self.second.kept_pose(positions), reach, rows, span
        )


class SolidAndRound(SurfaceAndShape):
    """A rigid triangle surface and a sphere, capsule or cylinder, exact wherever it rolls."""

    def _make_detector(self, deforms: bool) -> SurfaceShapeDetector:
        return SolidShapeDetector(self.first.triangles, self.first.rigid_points, self.shape)


class TwoBoxes(SurfaceAndShape):
    """Two boxes: face by face; where edges or corners meet, as any surface and shape."""

    is_traceable = False

    def __init__(self, first: Side, second: Side, friction: float):
        """See `ContactPair`."""
        super().__init__(first, second, friction)
        self._faces, self._has_searched = BoxPairDetector(first.shape, second.shape), False

    def write(self, positions, reach, rows, span) -> None:
        """See `ContactPair.write`."""
        poses = self.first.pose(positions), self.second.pose(positions)
        found = self._faces.detect(*poses, reach[0])
        # The general search runs in the first call too: it is compiled before bodies touch.
        if found is None or not self._has_searched:
            self._has_searched = True
            super().write(positions, reach, rows, span)
        if found is not None:
            put_pairs(found, rows, span)


class TwoSurfaces(ContactPair):
    """Two triangle surfaces; or a surface and itself, by search or by triangles known ahead."""

    def __init__(self, first: Side, second: Side, friction: float, detector=None):
        """See `ContactPair`.

        Args:
            first: The first side.
            second: The second.
            friction: Coefficient µ.
            detector: A `SelfDetector` or `FixedPairs` where both sides are the same.
        """
        super().__init__(first, second, friction)
        one, other = self.first, self.second
        self._detector = detector or SurfacePairDetector(
            one.triangles, one.point_count, other.triangles, other.point_count,
            rigid_points=(one.rigid_points, other.rigid_points),
        )  # fmt: skip
        self.is_traceable = getattr(self._detector, "is_traceable", False)

    def write(self, positions, reach, rows, span) -> None:
        """See `ContactPair.write`."""
        x = y = self.first.points(positions)
        if self.second is not self.first:
            y = self.second.points(positions)
        self._detector.write(x, y, reach, rows, span)


class BallAndShape(ContactPair):
    """A rigid ball and a shape: its one nearest point, exact wherever it rolls; see `ContactPair`."""

    def __init__(self, first: Side, second: Side, friction: float):
        """See `ContactPair`."""
        super().__init__(first, second, friction)
        self._radius, self._centre = first.shape.radius, np.array(first.shape.centre, float)
        self._form, self._frame = self.shape.form(), self.shape.frame()
        self._distance, self._gradient = np.empty(1), np.empty((1, 3))

    def near(self, positions: np.ndarray, margin: float) -> Proximities:
        """What is nearer than a margin [m].

        Args:
            positions: Node positions [m], shape (node_count, 3).
            margin: Distance below which points count as near [m].
        """
        at, turned = self.first.pose(positions)
        origin, rotation = self.second.pose(positions)
        centre = at + turned @ self._centre
        place, axes = self._frame
        own = ((centre - origin) @ rotation - place) @ axes
        measure_points(self._form, own[None], self._distance, self._gradient)
        normal = rotation @ (axes @ self._gradient[0])
        return near_shape((centre - self._radius * normal)[None], self._distance - self._radius,
                          normal, np.zeros(1, np.int64), margin)  # fmt: skip


class RollingAndPlane(ContactPair):
    """A rigid shape that rolls and a plane: the points of the shape that come lowest."""

    def __init__(self, first: Side, second: Side, friction: float):
        """See `ContactPair`."""
        super().__init__(first, second, friction)
        self._rolling, (self._centre, self._axes) = first.shape, first.shape.frame()
        self._point, self._normal = np.array(self.shape.point), self.shape.unit_normal

    def near(self, positions: np.ndarray, margin: float) -> Proximities:
        """What is nearer than a margin [m].

        Args:
            positions: Node positions [m], shape (node_count, 3).
            margin: Distance below which points count as near [m].
        """
        at, turned = self.first.pose(positions)
        origin, rotation = self.second.pose(positions)
        normal = rotation @ self._normal
        centre, axes = at + turned @ self._centre, turned @ self._axes
        points, keys = self._rolling.lowest(normal @ axes)
        points = centre + points @ axes.T
        gaps = (points - origin - rotation @ self._point) @ normal
        return near_shape(points, gaps, normal, keys, margin)


def near_shape(points, gaps, normal, keys, margin: float) -> Proximities:
    """Those of some points of a solid that are nearer to a shape than a margin.

    Args:
        points: The points [m], shape (count, 3).
        gaps: Their gaps [m], shape (count,).
        normal: Unit vector from the shape to the solid, shape (3,).
        keys: Their keys, shape (count,).
        margin: Distance below which points count as near [m].
    """
    touching = gaps < margin
    points, gaps = points[touching], gaps[touching]
    none, whole = np.full((len(gaps), 3), -1), np.zeros((len(gaps), 3))
    return Proximities(
        none, whole, none, whole, points, points - gaps[:, None] * normal,
        np.tile(normal, (len(gaps), 1)), gaps, keys[touching],
    )  # fmt: skip
