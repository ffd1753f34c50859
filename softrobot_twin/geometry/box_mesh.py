"""Meshes of boxes, made without a file."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import permutations

import numpy as np
from scipy.spatial.transform import Rotation

from softrobot_twin.geometry.hexahedral_mesh import HexahedralMesh
from softrobot_twin.geometry.mesh_parts import MeshParts
from softrobot_twin.geometry.mesh_reading import MeshReading
from softrobot_twin.geometry.shape_functions import HEXAHEDRON_CORNERS
from softrobot_twin.geometry.tet_mesh import TetMesh

# Corners of a cell as steps of 0 or 1 along x, y, z, in the order of a hexahedron.
_STEPS = (np.asarray(HEXAHEDRON_CORNERS) > 0.0).astype(np.int64)


def cells_of_size(size: Sequence[float], cell_size: float) -> tuple[int, int, int]:
    """Least numbers of cells along x, y, z of a box whose edges are at most `cell_size` [m].

    Args:
        size: Edges of the box [m], shape (3,).
        cell_size: Greatest edge of a cell [m].
    """
    # 0.1 / 0.005 is a whole number but for its rounding.
    counts = np.ceil(np.asarray(size, float) / cell_size * (1.0 - 1e-9))
    return tuple(int(count) for count in np.maximum(counts, 1.0))


def read_box(
    size: Sequence[float], cells: Sequence[int], of_hexahedra: bool = False, *,
    translation: Sequence[float] = (0.0, 0.0, 0.0), rotation: Sequence[float] = (0.0, 0.0, 0.0),
) -> MeshReading:  # fmt: skip
    """Meshes the box from the origin to `size` and places it like a mesh that is read from a file.

    Each cell is a hexahedron or six tetrahedra around one of its diagonals. The diagonals of
    neighbours are mirror images, so that with even numbers of cells the mesh is its own image in
    the three planes through its middle.

    Args:
        size: Edges along x, y, z [m], shape (3,).
        cells: Number of cells along each of them, shape (3,).
        of_hexahedra: Whether its cells are hexahedra; otherwise they are tetrahedra.
        translation: Shift after the rotation [m], shape (3,).
        rotation: Angles about the fixed x, then y, then z axis [rad], shape (3,).

    Returns:
        The mesh, without notes and named parts; nodes are numbered along z, then y, then x.
    """
    axes = [np.linspace(0.0, edge, count + 1) for edge, count in zip(size, cells, strict=True)]
    positions = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    turn = Rotation.from_euler("xyz", np.asarray(rotation, float))
    positions = turn.apply(positions) + np.asarray(translation, float)
    corners = _corners(np.asarray(cells, np.int64))
    if of_hexahedra:
        mesh = HexahedralMesh(positions, np.empty((0, 4), np.int64), corners)
    else:
        mesh = TetMesh(positions, _tets(np.asarray(cells, np.int64)))
    every = np.arange(len(positions))
    unnamed = "a box has no named parts; give boxes in place of regions"
    return MeshReading(mesh, (), every, every, parts=MeshParts(None, {}, {}, {}, {}, unnamed))


def _corners(cells: np.ndarray) -> np.ndarray:
    """Nodes of every cell in the order of a hexahedron, shape (cell_count, 8)."""
    first = np.stack(np.meshgrid(*map(np.arange, cells), indexing="ij"), axis=-1).reshape(-1, 1, 3)
    return _numbers(first + _STEPS, cells)


def _numbers(places: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Numbers of nodes from their places in the grid."""
    _, ny, nz = cells + 1
    return (places[..., 0] * ny + places[..., 1]) * nz + places[..., 2]


def _tets(cells: np.ndarray) -> np.ndarray:
    """Six tetrahedra of every cell, shape (6 cell_count, 4)."""
    first = np.stack(np.meshgrid(*map(np.arange, cells), indexing="ij"), axis=-1).reshape(-1, 3)
    is_mirrored = first % 2
    tets = []
    for order in permutations(range(3)):
        # From one corner of the cell to the opposite one along its edges.
        path = np.zeros((4, 3), np.int64)
        for step, axis in enumerate(order):
            path[step + 1 :, axis] = 1
        is_left_handed = np.linalg.det(path[1:].astype(float)) < 0.0
        mirrored = np.where(is_mirrored[:, None, :], 1 - path, path)
        nodes = _numbers(first[:, None, :] + mirrored, cells)
        turned = (is_mirrored.sum(axis=1) % 2 == 1) ^ is_left_handed
        tets.append(np.where(turned[:, None], nodes[:, [0, 2, 1, 3]], nodes))
    return np.stack(tets, axis=1).reshape(-1, 4)
