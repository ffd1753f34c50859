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

import numpy as np

from softrobot_twin.geometry.proximities import Proximities, found_by, put_pairs
from softrobot_twin.geometry.shapes.distance_kernels import CAPSULE
from softrobot_twin.geometry.surface_shape import PARALLEL_FACE, RIM_POINTS
from softrobot_twin.geometry.vector_arrays import gather_vectors
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
def carry_by_vertices(point_nodes, points, weights, sign, column, span, nodes, coefficients):
    """Places inside triangles of a deformable body: three vertices carry each.

    Args:
        point_nodes: Node of each surface point, shape (point_count,).
    """
    for c in range(span[0], min(span[1], len(nodes))):
        for k in range(3):
            weight = weights[c, k]
            nodes[c, column + k] = point_nodes[points[c, k]] if weight != 0.0 else NO_NODE
            coefficients[c, column + k] = sign * weight


@njit(**KERNEL)
def carry_by_mapping(
    point_nodes, point_weights, points, weights, sign, column, span, nodes, coefficients
):
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
        self.nodes, self._points = self.point_nodes, np.empty((self.point_count, 3))

    def points(self, positions: np.ndarray) -> np.ndarray:
        """Where its points are [m], shape (point_count, 3); the next call overwrites them.

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        gather_vectors(positions, self.point_nodes, self._points)
        return self._points

    def outline(self, positions: np.ndarray) -> np.ndarray:
        """Points that tell how far it moves [m], shape (any, 3).

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        return positions[self.point_nodes]

    def carry(self, positions, points, weights, places, *where) -> None:
        """Write the nodes that carry places on it, and their coefficients; may be traced.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            points: Its points around each place, shape (capacity, 3).
            weights: Their barycentric weights, shape (capacity, 3).
            places: The places [m], shape (capacity, 3).
            where: The last arguments of the kernels above, from `sign` on.
        """
        carry_by_vertices(self.point_nodes, points, weights, *where)


class CarriedSurface:
    """A surface that a deformable body carries; see `DeformableSurface`."""

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
        """See `DeformableSurface.points`.

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        write_points(positions, self._nodes, self._weights, self._points)
        return self._points

    def outline(self, positions: np.ndarray) -> np.ndarray:
        """See `DeformableSurface.outline`."""
        return self.points(positions).copy()

    def carry(self, positions, points, weights, places, *where) -> None:
        """See `DeformableSurface.carry`."""
        carry_by_mapping(self._nodes, self._weights, points, weights, *where)


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
        """See `DeformableSurface.points`; may not be traced.

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        origin, rotation = self.pose(positions)
        return np.add(self._local @ rotation.T, origin, out=self._points)

    def outline(self, positions: np.ndarray) -> np.ndarray:
        """See `DeformableSurface.outline`; of a plane, which has no end, its origin."""
        return np.vstack([self.points(positions), positions[self._frame]])

    def carry(self, positions, points, weights, places, *where) -> None:
        """See `DeformableSurface.carry`."""
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
            *_: Arguments of `DeformableSurface.carry`; not read.
        """


class ContactPair:
    """Two things that may touch.

    Attributes:
        first: The first side, such as a `DeformableSurface`.
        second: The second.
        friction: Coefficient µ.
        names: Names of both.
        is_traceable: Whether `write` may be traced; see `traced_stage.py`.
    """

    is_traceable = False

    def __init__(self, first, second, friction: float, names: tuple[str, str]):
        """Take both sides; see the attributes."""
        self.first, self.second = first, second
        self.friction, self.names = friction, names

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
    """A triangle surface and an analytic shape on a rigid body or an obstacle.

    Attributes:
        shape: The shape.
    """

    is_traceable = True

    def __init__(self, first, second, detector, friction: float, names: tuple[str, str]):
        """Store the two sides of the pair.

        Args:
            first: The surface.
            second: What carries the shape.
            detector: A `SurfaceShapeDetector`.
            friction: Coefficient µ.
            names: Names of both.
        """
        super().__init__(first, second, friction, names)
        self.shape = detector.shape
        self._detector = detector

    def write(self, positions, reach, rows, span) -> None:
        """See `ContactPair.write`."""
        self._detector.write(
            self.first.points(positions), *self.second.kept_pose(positions), reach, rows, span
        )


class TwoBoxes(ContactPair):
    """Two boxes: face by face; where edges or corners meet, as any surface and shape."""

    def __init__(self, faces, general: SurfaceAndShape):
        """Store the two sides of the pair.

        Args:
            faces: A `BoxPairDetector`.
            general: The same boxes, the first as a surface.
        """
        super().__init__(general.first, general.second, general.friction, general.names)
        self._faces, self._general, self._has_searched = faces, general, False

    def near(self, positions: np.ndarray, margin: float) -> Proximities:
        """What is nearer than a margin [m].

        Args:
            positions: Node positions [m], shape (node_count, 3).
            margin: Distance below which points count as near [m].
        """
        found = self._faces.detect(self.first.pose(positions), self.second.pose(positions), margin)
        # The general search runs in the first call too: it is compiled before bodies touch.
        if found is None or not self._has_searched:
            self._has_searched = True
            near = self._general.near(positions, margin)
            return near if found is None else found
        return found


class TwoSurfaces(ContactPair):
    """Two triangle surfaces; or a surface and itself, by search or by triangles known ahead."""

    def __init__(self, first, second, detector, friction: float, names: tuple[str, str]):
        """Store the two sides; see `SurfaceAndShape`.

        The detector is a `SurfacePairDetector`; a `SelfDetector` or `FixedPairs` where both sides are
        the same.
        """
        super().__init__(first, second, friction, names)
        self._detector, self.is_traceable = detector, getattr(detector, "is_traceable", False)

    def write(self, positions, reach, rows, span) -> None:
        """See `ContactPair.write`."""
        x = y = self.first.points(positions)
        if self.second is not self.first:
            y = self.second.points(positions)
        self._detector.write(x, y, reach, rows, span)


class BallAndShape(ContactPair):
    """A rigid ball and a shape: its one nearest point, exact wherever it rolls."""

    def __init__(self, ball, radius: float, centre, second, shape, friction: float, names):
        """Store the two sides of the pair.

        Args:
            ball: What carries the ball.
            radius: Its radius [m].
            centre: Its centre in its carrier's frame [m], shape (3,).
            second: What carries the shape.
            shape: The shape.
            friction: Coefficient µ.
            names: Names of both.
        """
        super().__init__(ball, second, friction, names)
        self._radius, self._centre, self._shape = radius, np.asarray(centre, float), shape

    def near(self, positions: np.ndarray, margin: float) -> Proximities:
        """What is nearer than a margin [m].

        Args:
            positions: Node positions [m], shape (node_count, 3).
            margin: Distance below which points count as near [m].
        """
        at, turned = self.first.pose(positions)
        origin, rotation = self.second.pose(positions)
        centre = at + turned @ self._centre
        distances, normals = self._shape.signed_distances([(centre - origin) @ rotation])
        gap, normal = distances[0] - self._radius, normals @ rotation.T
        count = 1 if gap < margin else 0
        none, whole = np.full((count, 3), -1), np.zeros((count, 3))
        return Proximities(
            none, whole, none, whole, (centre - self._radius * normal)[:count],
            (centre - distances[0] * normal)[:count], normal[:count],
            np.full(count, gap), np.zeros(count, np.int64),
        )  # fmt: skip


class RoundAndPlane(ContactPair):
    """A rigid capsule or cylinder and a plane: the points of its round that come lowest.

    A capsule touches with the balls at its ends, a cylinder with the lowest points of its rims;
    where a cap is parallel to the plane, with points all round it. So it rolls as it is round.
    """

    def __init__(self, solid, shape, second, plane, friction: float, names: tuple[str, str]):
        """Store the two sides of the pair.

        Args:
            solid: What carries the capsule or cylinder.
            shape: The capsule or cylinder, in its carrier's frame.
            second: What carries the plane.
            plane: The plane, in its carrier's frame.
            friction: Coefficient µ.
            names: Names of both.
        """
        super().__init__(solid, second, friction, names)
        self._plane, self._radius = plane, shape.radius
        self._is_capsule = shape.kind == CAPSULE
        self._centre, self._axes = shape.frame()
        self._half_length = shape.extents()[1]

    def near(self, positions: np.ndarray, margin: float) -> Proximities:
        """What is nearer than a margin [m].

        Args:
            positions: Node positions [m], shape (node_count, 3).
            margin: Distance below which points count as near [m].
        """
        at, turned = self.first.pose(positions)
        origin, rotation = self.second.pose(positions)
        normal = rotation @ self._plane.normal
        centre, axes = at + turned @ self._centre, turned @ self._axes
        points, keys = self._lowest(normal @ axes)
        points = centre + points @ axes.T
        if self._is_capsule:
            points -= self._radius * normal
        gaps = (points - origin - rotation @ self._plane.point) @ normal
        touching = gaps < margin
        points, gaps, keys = points[touching], gaps[touching], keys[touching]
        count = len(gaps)
        none, whole = np.full((count, 3), -1), np.zeros((count, 3))
        return Proximities(
            none, whole, none, whole, points, points - gaps[:, None] * normal,
            np.tile(normal, (count, 1)), gaps, keys,
        )  # fmt: skip

    def _lowest(self, normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Points that may touch, and their keys; of a capsule the ends of its axis.

        Args:
            normal: The plane's normal in the shape's own frame, whose third axis is its axis.
        """
        ends = np.array([[0.0, 0.0, -self._half_length], [0.0, 0.0, self._half_length]])
        if self._is_capsule:
            return ends, np.arange(2)
        across = np.hypot(normal[0], normal[1])
        caps = np.flatnonzero(np.array([-normal[2], normal[2]]) <= PARALLEL_FACE)
        if across > PARALLEL_FACE:
            lowest = np.array([*(-self._radius / across * normal[:2]), 0.0])
            return ends[caps] + lowest, 16 * caps
        angles = 2.0 * np.pi * np.arange(RIM_POINTS) / RIM_POINTS
        rim = self._radius * np.column_stack([np.cos(angles), np.sin(angles), 0.0 * angles])
        return ends[caps[0]] + rim, 16 * caps[0] + 1 + np.arange(RIM_POINTS)
