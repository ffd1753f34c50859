"""Effectors: points that follow targets, δ_e = x - x_d along some directions."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softrobot_twin.constraints.constraint_term import ConstraintTerm
from softrobot_twin.geometry.vector3 import add, add_scaled, divided, row, set_row
from softrobot_twin.kernels.compilation import KERNEL, njit
from softrobot_twin.mechanics.barycentric import BarycentricMapping

AXES = {"x": 0, "y": 1, "z": 2}


@njit(**KERNEL)
def write_means(x, nodes, weights, point_ends, effector_ends, out):
    """Mean of each effector's points; nodes of a point, and points of an effector, are contiguous.

    Args:
        x: Node positions [m], shape (node_count, 3).
        nodes: Nodes that carry the points, point after point, shape (weight_count,).
        weights: Their barycentric weights, same shape.
        point_ends: Where the nodes of each point end in `nodes`, shape (point_count,).
        effector_ends: Where the points of each effector end, shape (effector_count,).
        out: Takes the means [m], shape (effector_count, 3).
    """
    node, point = 0, 0
    for e in range(len(effector_ends)):
        first, total = point, (0.0, 0.0, 0.0)
        while point < effector_ends[e]:
            position = (0.0, 0.0, 0.0)
            while node < point_ends[point]:
                position = add_scaled(position, row(x, nodes[node]), weights[node])
                node += 1
            total = add(total, position)
            point += 1
        set_row(out, e, divided(total, float(point - first)))


@njit(**KERNEL)
def write_rows(x, nodes, weights, point_ends, effector_ends, places, H, blocks, values):
    """The constant H, and those coordinates of the means that are controlled.

    Args:
        x: Node positions [m], shape (node_count, 3).
        nodes: Nodes that carry the points, point after point, shape (weight_count,).
        weights: Their barycentric weights, same shape.
        point_ends: Where the nodes of each point end in `nodes`, shape (point_count,).
        effector_ends: Where the points of each effector end, shape (effector_count,).
        places: 3 × effector + axis of each row, shape (row_count,).
        H: Entries of H, shape (entry_count, 3).
        blocks: Takes the entries of H, same shape.
        values: Takes the coordinates [m], shape (row_count,).
    """
    means = np.empty((len(effector_ends), 3))
    write_means(x, nodes, weights, point_ends, effector_ends, means)
    for row in range(len(places)):
        values[row] = means[places[row] // 3, places[row] % 3]
    for entry in range(len(H)):
        for i in range(3):
            blocks[entry, i] = H[entry, i]


class EffectorPoints(NamedTuple):
    """One effector: the mean of some points of the body.

    Attributes:
        name: Name of the effector.
        points: Its points.
        directions: Axes it is controlled along, a subset of 0, 1, 2.
        weight: Weight of its error in the inverse problem.
    """

    name: str
    points: BarycentricMapping
    directions: tuple[int, ...]
    weight: float


class Effectors(ConstraintTerm):
    """Constraint term of all effectors of a scene. Their H is constant.

    Attributes:
        position_row_count: Number of rows of positions: all, see `PosedEffectors`.
        orientations: None; see there.
        row_lengths: See there.
    """

    orientations: tuple = ()
    row_lengths = np.empty(0)

    name = "effectors"
    group = "effectors"
    is_traceable = True

    def __init__(self, effectors: tuple[EffectorPoints, ...], free_index: np.ndarray):
        """Lay out the rows.

        Args:
            effectors: The effectors.
            free_index: Free-node index of each node, -1 where fixed, shape (node_count,).
        """
        self.effectors = effectors
        self.row_effector = np.array(
            [i for i, effector in enumerate(effectors) for _ in effector.directions], np.int64
        )
        self.row_axis = np.array(
            [axis for effector in effectors for axis in effector.directions], np.int64
        )
        self.row_weights = np.array(
            [effector.weight for effector in effectors for _ in effector.directions]
        )
        self.row_count = self.position_row_count = len(self.row_axis)
        self._row_place = 3 * self.row_effector + self.row_axis
        entries = [
            (row, node, weight, axis)
            for row, (index, axis) in enumerate(zip(self.row_effector, self.row_axis, strict=True))
            for node, weight in _node_weights(effectors[index], free_index)
        ]
        self.entry_rows = np.array([entry[0] for entry in entries], np.int64)
        self.entry_nodes = np.array([entry[1] for entry in entries], np.int64)
        self._blocks = np.zeros((len(entries), 3))
        for block, (_, _, weight, axis) in zip(self._blocks, entries, strict=True):
            block[axis] = weight
        mappings = [effector.points for effector in effectors]
        # A scene may have targets of sensors alone.
        none = np.empty(0, np.int64)
        self._nodes = np.concatenate([none, *(m.nodes.ravel() for m in mappings)]).astype(np.int64)
        self._weights = np.concatenate([np.empty(0), *(m.barycentric_weights.ravel() for m in mappings)])
        widths = [np.full(m.point_count, m.nodes.shape[1]) for m in mappings]
        self._point_ends = np.cumsum(np.concatenate([none, *widths]))
        self._effector_ends = np.cumsum([m.point_count for m in mappings], dtype=np.int64)

    def rows_of(self, places: np.ndarray) -> np.ndarray:
        """The controlled coordinates of the effectors, shape (row_count,).

        Args:
            places: All coordinates [m], shape (effector_count, 3).
        """
        return places.take(self._row_place)

    def positions(self, node_positions: np.ndarray) -> np.ndarray:
        """Positions of the effectors [m], shape (effector_count, 3).

        Args:
            node_positions: Node positions [m], shape (node_count, 3).
        """
        means = np.empty((len(self.effectors), 3))
        write_means(
            node_positions, self._nodes, self._weights, self._point_ends,
            self._effector_ends, means,
        )  # fmt: skip
        return means

    def evaluate(self, positions: np.ndarray, blocks: np.ndarray, values: np.ndarray) -> None:
        """Write H and the controlled coordinates x [m]; the caller subtracts the target."""
        write_rows(
            positions, self._nodes, self._weights, self._point_ends,
            self._effector_ends, self._row_place, self._blocks, blocks, values,
        )  # fmt: skip


def along_all_axes(effectors: Effectors, free_index: np.ndarray) -> Effectors:
    """The same points with rows along x, y and z, whatever directions a scene controls.

    Args:
        effectors: The effectors of a scene.
        free_index: See `Effectors`.
    """
    points = tuple(one._replace(directions=(0, 1, 2)) for one in effectors.effectors)
    return Effectors(points, free_index)


def _node_weights(effector: EffectorPoints, free_index: np.ndarray):
    """Free nodes and weights of the mean of an effector's points."""
    nodes, place = np.unique(effector.points.nodes, return_inverse=True)
    share = effector.points.barycentric_weights.ravel() / effector.points.point_count
    weights = np.bincount(place.ravel(), share, len(nodes))
    for node, weight in zip(free_index[nodes], weights, strict=True):
        if node >= 0 and weight != 0.0:
            yield node, weight
