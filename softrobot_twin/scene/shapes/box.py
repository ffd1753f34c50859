"""A box in any orientation."""

from __future__ import annotations

import itertools
from typing import Annotated, ClassVar

import numpy as np
from scipy.spatial.transform import Rotation

from softrobot_twin.geometry.mass_properties import MassProperties
from softrobot_twin.geometry.shapes.distance_kernels import BOX
from softrobot_twin.scene.entry import Angles, Vector, unit
from softrobot_twin.scene.shapes.shape_entry import Length, ShapeEntry


class Box(ShapeEntry):
    """A box."""

    told: ClassVar[tuple[str, ...]] = ("box of {size:mm} mm",)
    kind: ClassVar[int] = BOX
    has_edges: ClassVar[bool] = True

    centre: Vector = (0.0, 0.0, 0.0)
    """Centre."""
    size: Annotated[tuple[Length, Length, Length], unit("m")]
    """Lengths of its edges."""
    rotation: Angles = (0.0, 0.0, 0.0)
    """Angles about the axes."""

    @property
    def width(self) -> float:
        """See `Shape`."""
        return min(self.size)

    def frame(self) -> tuple[np.ndarray, np.ndarray]:
        """See `Shape.frame`."""
        turn = Rotation.from_euler("xyz", self.rotation)
        return np.array(self.centre), turn.as_matrix()

    def extents(self) -> np.ndarray:
        """Half the sides; see `Shape.extents`."""
        return 0.5 * np.array(self.size)

    def _own_surface(self, resolution: float) -> tuple[np.ndarray, np.ndarray]:
        counts = np.maximum(1, np.ceil(np.divide(self.size, resolution))).astype(np.int64)
        cells = []
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
        volume, squares = float(np.prod(self.size)), np.square(self.size)
        inertia = np.diag(volume / 12.0 * (squares.sum() - squares))
        return MassProperties(volume, np.zeros(3), inertia)
