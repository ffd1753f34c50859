"""A column cut into equal boxes of six tetrahedra each: a mesh of any size without a mesher."""

from __future__ import annotations

from itertools import permutations
from pathlib import Path

import numpy as np

from softrobot_twin.geometry.tet_mesh import TetMesh


def column_mesh(size: tuple[float, float, float], cells: tuple[int, int, int]) -> TetMesh:
    """Meshes a column that hangs down from the plane z = 0, its axis on the z axis.

    Args:
        size: Edges along x, y, z [m].
        cells: Boxes along each of them.

    Returns:
        The mesh [m].
    """
    counts = np.array(cells) + 1
    axes = [np.linspace(-0.5, 0.5, count) for count in counts[:2]] + [
        np.linspace(-1.0, 0.0, counts[2])]
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3) * np.array(size)
    number = np.arange(len(nodes)).reshape(counts)
    tets = []
    for path in permutations(range(3)):
        corner = np.zeros(3, dtype=int)
        corners = [_corner(number, corner)]
        for axis in path:
            corner[axis] = 1
            corners.append(_corner(number, corner))
        # Walks along the axes in an odd order turn left-handed.
        odd = np.linalg.det(np.eye(3)[list(path)]) < 0.0
        tets.append(np.stack([corners[k] for k in ((0, 2, 1, 3) if odd else range(4))], axis=-1))
    return TetMesh(nodes, np.concatenate(tets))


def write_mesh(path: Path, mesh: TetMesh) -> None:
    """Writes a mesh as binary VTK."""
    import meshio

    content = meshio.Mesh(mesh.node_positions, [("tetra", mesh.cells)])
    content.write(path, file_format="vtk42", binary=True)


def _corner(number: np.ndarray, offset: np.ndarray) -> np.ndarray:
    """Node at one corner of every box."""
    ends = np.array(number.shape) - 1 + offset
    (i, j, k), (a, b, c) = offset, ends
    return number[i:a, j:b, k:c].ravel()
