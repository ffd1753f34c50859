"""Triangles with a name, checked before they are shown."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from softrobot_twin.view.refusal import ViewError


@dataclass(frozen=True)
class Surface:
    """The triangles of something that is shown; its name becomes part of an entity path.

    Attributes:
        name: Its name.
        triangles: Indices into its points, shape (triangle_count, 3).
        points: Its points [m], shape (point_count, 3), where they do not deform: those of a rigid
            body in its own coordinates, those of an obstacle in the world.

    Raises:
        ViewError: The triangles are not triples of indices, or name points that there are not.
    """

    name: str
    triangles: np.ndarray
    points: np.ndarray | None = None

    def __post_init__(self) -> None:
        triangles = np.asarray(self.triangles)
        key = f"triangles of {self.name}"
        if triangles.ndim != 2 or triangles.shape[1] != 3 or triangles.dtype.kind not in "iu":
            raise ViewError(key, f"{triangles.dtype} array of {triangles.shape}",
                            "must be integers of shape (triangle_count, 3)")
        if triangles.size and triangles.min() < 0:
            raise ViewError(key, int(triangles.min()), "an index is negative")
        if self.points is not None:
            self.refuse_points_unlike(self.points)

    def refuse_points_unlike(self, points: np.ndarray) -> None:
        """Check that the triangles find all their points.

        Raises:
            ViewError: There are too few, or they are not points.
        """
        shape, needed = np.shape(points), int(np.max(self.triangles, initial=-1)) + 1
        if len(shape) != 2 or shape[1] != 3 or shape[0] < needed:
            raise ViewError(f"positions of {self.name}", shape,
                            f"its triangles need at least ({needed}, 3)")
