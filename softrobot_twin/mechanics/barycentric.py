"""Points carried by a mesh: x = M(q) with constant weights (Coevoet 2017, section 6.2).

The weights are the values of the shape functions at the point: the barycentric coordinates in a
linear tetrahedron, with a width of 4; those of the ten nodes in a quadratic one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from softrobot_twin.geometry.vector3 import add_scaled, row, set_row
from softrobot_twin.kernels.compilation import KERNEL, njit

# A weight below this is round-off of a point that is a node of the mesh.
NO_WEIGHT = 1.0e-6
# On the nodes of a frame, weights are places in it [m]; this is round-off of a zero there.
NO_LEVER = 1.0e-12


@njit(**KERNEL)
def write_points(x, nodes, weights, out):
    """Σ w_a x_a of every point.

    Args:
        x: Node positions [m], shape (node_count, 3).
        nodes: Nodes that carry each point, shape (point_count, width).
        weights: w of these nodes, same shape.
        out: Takes the points [m], shape (point_count, 3).
    """
    for p in range(len(nodes)):
        point = (0.0, 0.0, 0.0)
        for a in range(nodes.shape[1]):
            point = add_scaled(point, row(x, nodes[p, a]), weights[p, a])
        set_row(out, p, point)


@dataclass(frozen=True)
class BarycentricMapping:
    """Points that move with tetrahedra.

    Attributes:
        nodes: Nodes that carry each point, shape (point_count, width).
        barycentric_weights: Their weights, each row sums to 1, shape (point_count, width).
    """

    nodes: np.ndarray
    barycentric_weights: np.ndarray

    def __post_init__(self) -> None:
        for name in ("nodes", "barycentric_weights"):
            object.__setattr__(self, name, np.ascontiguousarray(getattr(self, name)))

    @property
    def point_count(self) -> int:
        """Number of points."""
        return len(self.nodes)

    def positions(self, node_positions: np.ndarray) -> np.ndarray:
        """Positions of the points.

        Args:
            node_positions: Node positions [m], shape (node_count, 3).

        Returns:
            Point positions [m], shape (point_count, 3).
        """
        points = np.empty((len(self.nodes), 3))
        write_points(node_positions, self.nodes, self.barycentric_weights, points)
        return points

    def followed_by(self, other: BarycentricMapping) -> BarycentricMapping:
        """These points and then those of another; narrower rows are padded with zero weights.

        Args:
            other: Points of the same nodes.
        """
        width = max(self.nodes.shape[1], other.nodes.shape[1])
        widened = [mapping._widened(width) for mapping in (self, other)]
        return BarycentricMapping(
            np.vstack([mapping.nodes for mapping in widened]),
            np.vstack([mapping.barycentric_weights for mapping in widened]),
        )

    def through(self, carriers: BarycentricMapping) -> BarycentricMapping:
        """The same points where the nodes that carry them are carried points themselves.

        Args:
            carriers: Every node that this mapping names, on other nodes.

        Returns:
            The points on those other nodes, as narrow as possible.
        """
        count = self.point_count
        nodes = carriers.nodes[self.nodes].reshape(count, -1)
        weights = self.barycentric_weights[:, :, None] * carriers.barycentric_weights[self.nodes]
        weights = weights.reshape(count, -1)
        found = [np.unique(own[used != 0.0]) for own, used in zip(nodes, weights, strict=True)]
        width = max([1, *map(len, found)])
        merged, sums = np.zeros((count, width), np.int64), np.zeros((count, width))
        for point, own in enumerate(found):
            merged[point] = own[0] if len(own) else 0
            merged[point, : len(own)] = own
            used = weights[point] != 0.0
            place = np.searchsorted(own, nodes[point][used])
            np.add.at(sums[point], place, weights[point][used])
        return BarycentricMapping(merged, sums)

    def reduced(self, least: float = NO_WEIGHT) -> BarycentricMapping:
        """The same points without weights that are round-off, as narrow as possible.

        A point that is a node of the mesh is carried by that node alone.

        Args:
            least: Least weight that is kept.
        """
        weights = self.barycentric_weights
        whole = weights.sum(axis=1, keepdims=True)
        # Weights of nodes have a sum of 1, but those of bubbles are added to them.
        whole = np.where(np.abs(whole - 1.0) < NO_WEIGHT, 1.0, whole)
        weights = np.where(np.abs(weights) < least, 0.0, weights)
        weights = weights / weights.sum(axis=1, keepdims=True) * whole
        order = np.argsort(weights == 0.0, axis=1, kind="stable")
        width = max(1, int((weights != 0.0).sum(axis=1).max(initial=0)))
        return BarycentricMapping(
            np.take_along_axis(self.nodes, order, axis=1)[:, :width],
            np.take_along_axis(weights, order, axis=1)[:, :width],
        )

    def mean(self, shares: np.ndarray | None = None) -> BarycentricMapping:
        """One point that moves as a weighted mean of all of them.

        Args:
            shares: Weight of each point, not negative, shape (point_count,); equal when left out.
        """
        shares = np.ones(self.point_count) if shares is None else shares
        nodes, place = np.unique(self.nodes, return_inverse=True)
        parts = shares[:, None] * self.barycentric_weights
        weights = np.bincount(place.ravel(), parts.ravel(), len(nodes))
        carrying = weights != 0.0
        return BarycentricMapping(
            nodes[carrying][None, :], weights[carrying][None, :] / shares.sum()
        )

    def _widened(self, width: int) -> BarycentricMapping:
        missing = width - self.nodes.shape[1]
        return BarycentricMapping(
            np.pad(self.nodes, ((0, 0), (0, missing)), mode="edge"),
            np.pad(self.barycentric_weights, ((0, 0), (0, missing))),
        )
