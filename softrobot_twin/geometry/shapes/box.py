"""A box in any orientation."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field

import numpy as np

from softrobot_twin.errors import SceneError
from softrobot_twin.geometry.mass_properties import MassProperties
from softrobot_twin.geometry.shapes.distance_kernels import BOX
from softrobot_twin.geometry.shapes.shape import Shape, vectors


@dataclass(frozen=True, eq=False)
class Box(Shape):
    """A rectangular block.

    Attributes:
        centre: Centre [m], shape (3,).
        size: Lengths of the sides [m], shape (3,), all > 0.
        rotation: Directions of the sides as columns, relative to the carrier, shape (3, 3).

    Raises:
        SceneError: A number is not finite, a side is not > 0, or the rotation is not one.
    """

    kind = BOX
    centre: np.ndarray
    size: np.ndarray
    rotation: np.ndarray = field(default_factory=lambda: np.eye(3))

    def __post_init__(self) -> None:
        object.__setattr__(self, "centre", vectors("box.centre", self.centre, (3,)))
        size = vectors("box.size", self.size, (3,))
        if not (size > 0.0).all():
            raise SceneError(None, "box.size", self.size, "m", "must be three lengths > 0")
        object.__setattr__(self, "size", size)
        rotation = vectors("box.rotation", self.rotation, (3, 3), "")
        off = np.abs(rotation.T @ rotation - np.eye(3)).max()
        if off > 1e-9 or np.linalg.det(rotation) < 0.0:
            raise SceneError(None, "box.rotation", self.rotation, "", "must be a rotation matrix")
        object.__setattr__(self, "rotation", rotation)

    def frame(self) -> tuple[np.ndarray, np.ndarray]:
        """See `Shape.frame`."""
        return self.centre, self.rotation

    def extents(self) -> np.ndarray:
        """Half the sides; see `Shape.extents`."""
        return 0.5 * self.size

    def _own_surface(self, resolution: float) -> tuple[np.ndarray, np.ndarray]:
        counts = np.maximum(1, np.ceil(self.size / resolution)).astype(np.int64)
        cells, triangles = [], []
        for axis, top in itertools.product(range(3), (0, 1)):
            u, v = (axis + 1) % 3, (axis + 2) % 3
            corner = np.zeros((counts[u], counts[v], 3), np.int64)
            corner[..., axis] = top * counts[axis]
            corner[..., u] = np.arange(counts[u])[:, None]
            corner[..., v] = np.arange(counts[v])
            one, other = np.eye(3, dtype=np.int64)[[u, v] if top else [v, u]]
            square = [corner, corner + one, corner + one + other, corner + other]
            cells.append(np.stack(square, axis=2).reshape(-1, 3))
        grid, index = np.unique(np.concatenate(cells), axis=0, return_inverse=True)
        quads = index.reshape(-1, 4)
        triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]).astype(np.int64)
        return (grid / counts - 0.5) * self.size, triangles

    def _own_mass_properties(self) -> MassProperties:
        volume, squares = float(np.prod(self.size)), self.size**2
        inertia = np.diag(volume / 12.0 * (squares.sum() - squares))
        return MassProperties(volume, np.zeros(3), inertia)
