"""A body's tetrahedral mesh."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from softrobot_twin.errors import MeshError
from softrobot_twin.geometry.cell_mesh import CornerMesh
from softrobot_twin.geometry.shape_functions import LINEAR_TETRAHEDRON
from softrobot_twin.geometry.surface import boundary_triangles


def tet_volumes(node_positions: np.ndarray, tets: np.ndarray) -> np.ndarray:
    """Signed volumes of tetrahedra, positive for the node order that a mesh requires.

    Args:
        node_positions: Node positions [m], shape (node_count, 3).
        tets: Node indices of the tetrahedra, shape (tet_count, 4).

    Returns:
        Volumes [m³], shape (cell_count,).
    """
    first = node_positions[tets[:, 0]]
    a, b, c = (node_positions[tets[:, corner]] - first for corner in (1, 2, 3))
    return np.einsum("ti,ti->t", np.cross(a, b), c) / 6.0


@dataclass(frozen=True, eq=False)
class TetMesh(CornerMesh):
    """Linear tetrahedra that fill a body. Both arrays are read-only.

    Attributes:
        node_positions: Node positions [m], float64, shape (node_count, 3).
        cells: Node indices, int64, shape (cell_count, 4), all of positive volume.

    Raises:
        MeshError: The arrays do not form such a mesh; ``geometry.mesh_reading`` repairs common
        faults.
    """

    node_positions: np.ndarray
    cells: np.ndarray

    shape_functions = LINEAR_TETRAHEDRON

    def __post_init__(self) -> None:
        positions = np.array(self.node_positions, dtype=np.float64, order="C")
        cells = np.array(self.cells, dtype=np.int64, order="C")
        positions.setflags(write=False)
        cells.setflags(write=False)
        object.__setattr__(self, "node_positions", positions)
        object.__setattr__(self, "cells", cells)
        if not (self.volumes > 0.0).all():
            wrong = np.flatnonzero(~(self.volumes > 0.0))
            raise MeshError(
                None,
                f"{len(wrong)} tetrahedra have no positive volume, the first is {wrong[0]} "
                f"with {self.volumes[wrong[0]]:.3g} m³",
            )

    @property
    def load_shares(self) -> np.ndarray:
        """Share of a uniform load on a tetrahedron that each node carries, shape (4,)."""
        return np.full(4, 0.25)

    @property
    def as_tets(self) -> np.ndarray:
        """Tetrahedra that fill the same space: its cells."""
        return self.cells

    def centres_at(self, positions: np.ndarray) -> np.ndarray:
        """Mean of the corners of each cell [m], shape (cell_count, 3).

        Args:
            positions: Of the nodes [m], shape (node_count, 3).
        """
        return positions[self.cells].mean(axis=1)

    @cached_property
    def surface_triangles(self) -> np.ndarray:
        """Node indices of the surface, shape (triangle_count, 3); see `boundary_triangles`."""
        return boundary_triangles(self.cells)

    @cached_property
    def volumes(self) -> np.ndarray:
        """Volumes of the tetrahedra [m³], shape (cell_count,)."""
        volumes = tet_volumes(self.node_positions, self.cells)
        volumes.setflags(write=False)
        return volumes

    def renumbered(self, node_positions: np.ndarray, first_node: int) -> TetMesh:
        """See `CellMesh.renumbered`."""
        return type(self)(node_positions, self.cells + first_node)
