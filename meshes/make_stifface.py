"""Makes the meshes of the Stifface: ``python meshes/make_stifface.py``.

The Stifface is a pad of silicone that a finger presses: a square plate of 60 × 60 × 4 mm, 20 mm
above the ground, on a wall below each of its four edges. Between the walls, below the plate, lies
nothing. The walls lean inwards by 4 mm and are soft across: cables that pull the edges outwards
stretch the plate, which stiffens it against a finger as tension stiffens a drum.

The elements are hexahedra: they do not lock where plate and walls bend. Each mesh is the same after
a quarter of a turn about z and in the mirrors x and y.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

# The script also runs from a checkout that is not installed.
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from meshes.make_bar import write  # noqa: E402
from meshes.mesh_making import mesh_parser  # noqa: E402
from softrobot_twin.geometry.hexahedral_mesh import HexahedralMesh  # noqa: E402

HALF_SIDE = 0.030
"""Half of an edge of the plate [m]."""
THICKNESS = 0.004
"""Of the plate [m]."""
HEIGHT = 0.020
"""Of the walls, from the ground to the plate [m]."""
WALL_THICKNESS = 0.0035
"""Across a wall [m]."""
WALL_HALF_WIDTH = 0.015
"""Half of a wall's length along its edge [m]."""
LEAN = 0.004
"""Distance of a wall's foot outwards from its top [m]."""


@dataclass(frozen=True)
class Refinement:
    """How a mesh is cut.

    Attributes:
        along: Cells along a wall.
        beside: Cells of the plate from the end of a wall to the next wall.
        wall: Layers of a wall from the ground to the plate.
        plate: Layers of the plate.
    """

    along: int
    beside: int
    wall: int
    plate: int


# Name of a refinement (the corners of its hexahedra) and how it is cut.
REFINEMENTS = {282: Refinement(4, 1, 3, 1), 562: Refinement(6, 2, 4, 1)}


def make_stifface(refinement: Refinement) -> HexahedralMesh:
    """Meshes the Stifface.

    Args:
        refinement: The refinement.

    Returns:
        The mesh [m].
    """
    inner = HALF_SIDE - WALL_THICKNESS
    along = np.linspace(-WALL_HALF_WIDTH, WALL_HALF_WIDTH, refinement.along + 1)
    beside = np.linspace(WALL_HALF_WIDTH, inner, refinement.beside + 1)[1:]
    beside = np.append(beside, HALF_SIDE)
    x = y = np.concatenate([-beside[::-1], along, beside])
    walls = np.linspace(0.0, HEIGHT, refinement.wall + 1)
    plate = np.linspace(HEIGHT, HEIGHT + THICKNESS, refinement.plate + 1)
    z = np.concatenate([walls, plate[1:]])
    points = np.stack(np.meshgrid(x, y, z, indexing="ij"), axis=-1).reshape(-1, 3)
    number = np.arange(len(points)).reshape(len(x), len(y), len(z))
    low, high = slice(None, -1), slice(1, None)
    corners = [(low, low), (high, low), (high, high), (low, high)]
    cells = np.stack(
        [number[i, j, k].ravel() for k in (low, high) for i, j in corners], axis=1
    )
    is_solid = _is_solid(points[cells].mean(axis=1), inner)
    used, hexahedra = np.unique(cells[is_solid], return_inverse=True)
    no_tets = np.empty((0, 4), np.int64)
    return HexahedralMesh(_leaning(points[used], inner), no_tets, hexahedra.reshape(-1, 8))


def _is_solid(middles: np.ndarray, inner: float) -> np.ndarray:
    """Whether there is silicone at the middles of cells [m], shape (cell_count,)."""
    x, y, z = np.abs(middles).T
    in_wall = ((x > inner) & (y < WALL_HALF_WIDTH)) | ((y > inner) & (x < WALL_HALF_WIDTH))
    return (z > HEIGHT) | in_wall


def _leaning(points: np.ndarray, inner: float) -> np.ndarray:
    """The points [m] with those of the walls moved outwards, the more the lower they are."""
    points = points.copy()
    outwards = LEAN * (1.0 - np.minimum(points[:, 2] / HEIGHT, 1.0))
    for axis in (0, 1):
        across = points[:, axis]
        is_wall = np.abs(across) > inner - 1.0e-9
        points[:, axis] = np.where(is_wall, across + np.sign(across) * outwards, across)
    return points


def main(arguments: list[str] | None = None) -> int:
    """Makes the requested meshes; returns 0."""
    parser = mesh_parser("Mesh the Stifface.", REFINEMENTS)
    options = parser.parse_args(arguments)
    for size in options.size or REFINEMENTS:
        path = options.output / f"stifface_{size}.msh"
        write(path, make_stifface(REFINEMENTS[size]), whole=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
