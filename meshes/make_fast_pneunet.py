"""Makes meshes of a PneuNet with gaps between its chambers: ``python meshes/make_fast_pneunet.py``.

It lies along x, its root at x = 0, its base on z = 0. Gas in the chambers, the closed surface
``cavity``, presses their thin walls against each other, and the paper in the base does not stretch:
so it bends towards -z. The paper is not in the mesh: scenes add it as threads. All cells are boxes,
and one over the thickness of a wall is enough, as hexahedra do not lock.

Dimensions are those of GIBBON's example of a PneuNet with moulds to print (docs/robots.md).
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

# The script also runs from a checkout that is not installed.
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from softrobot_twin.geometry.hexahedral_mesh import HEXAHEDRON_FACES  # noqa: E402
from softrobot_twin.geometry.shape_functions import HEXAHEDRON_CORNERS  # noqa: E402


@dataclass(frozen=True)
class Shape:
    """Dimensions [mm].

    Attributes:
        chamber_count: Number of chambers.
        chamber: Length, width and height of a chamber.
        wall: Thickness of the walls that part chambers from gaps.
        gap: Length of a gap.
        side: Thickness of the walls along the sides.
        base: Thickness of the base, with the paper in its middle.
        channel: Width and height of the channel that joins the chambers, on the base.
        roof: Thickness of the silicone between the channel and a gap.
        ceiling: Thickness of the silicone above the chambers.
    """

    chamber_count: int = 7
    chamber: tuple[float, float, float] = (8.0, 15.0, 25.0)
    wall: float = 1.2
    gap: float = 2.5
    side: float = 2.0
    base: float = 2.0
    channel: tuple[float, float] = (2.0, 3.0)
    roof: float = 1.0
    ceiling: float = 4.0


@dataclass(frozen=True)
class Refinement:
    """How a mesh is cut into cells.

    Attributes:
        chamber: Cells along a chamber.
        beside: Cells from the channel to a side wall.
        rise: Cells from the roof of the channel to the ceiling.
        thick: Cells through base, walls, roofs and gaps.
    """

    chamber: int = 1
    beside: int = 1
    rise: int = 2
    thick: int = 1


# Name of a refinement (its number of nodes) and how it is cut.
REFINEMENTS = {
    1176: Refinement(), 1400: Refinement(2, 1, 2), 2128: Refinement(2, 2, 3),
    3696: Refinement(3, 3, 5), 14574: Refinement(4, 4, 8, 2),
}  # fmt: skip
KEPT = (1176, 1400)
"""Refinements that scenes use; the others show what these miss."""


def make(refinement: Refinement, shape: Shape = Shape()):
    """Nodes [m], hexahedra, and quadrilaterals of the cavity."""
    along, across, up = _cuts(refinement, shape)
    cells = np.stack(np.meshgrid(*(np.arange(len(cut) - 1) for cut in (along, across, up)),
                                 indexing="ij"), axis=-1).reshape(-1, 3)  # fmt: skip
    x, y, z = (0.5 * (cut[:-1] + cut[1:])[cells[:, k]] for k, cut in enumerate((along, across, up)))
    period = 2.0 * shape.wall + shape.chamber[0] + shape.gap
    within, floor = x % period, shape.base
    in_chamber = (within > shape.wall) & (within < shape.wall + shape.chamber[0])
    gas = in_chamber & (np.abs(y) < 0.5 * shape.chamber[1])
    gas &= (z > floor) & (z < floor + shape.chamber[2])
    gas |= ((np.abs(y) < 0.5 * shape.channel[0]) & (z > floor) & (z < floor + shape.channel[1])
            & (x > shape.wall) & (x < along[-1] - shape.wall))  # fmt: skip
    air = (within > period - shape.gap) & (z > floor + shape.channel[1] + shape.roof)
    corners = ((HEXAHEDRON_CORNERS + 1.0) / 2.0).round().astype(int)
    counts = [len(along), len(across), len(up)]
    nodes = np.ravel_multi_index(np.moveaxis(cells[:, None] + corners, -1, 0), counts)
    solid = ~gas & ~air
    # Faces of gas cells that a solid cell shares, with the normal out of the gas.
    faces = nodes[gas][:, HEXAHEDRON_FACES].reshape(-1, 4)
    known = {tuple(sorted(face)) for face in nodes[solid][:, HEXAHEDRON_FACES].reshape(-1, 4)}
    walls = faces[[tuple(sorted(face)) in known for face in faces]]
    # A quadrilateral counts as two triangles: those of both halves are mirror images.
    low = np.unravel_index(walls, counts)[1].mean(axis=1) < 0.5 * (len(across) - 1)
    walls[low] = np.roll(walls[low], 1, axis=1)
    used, numbers = np.unique(nodes[solid], return_inverse=True)
    positions = np.stack([1e-3 * cut[index] for cut, index in zip(
        (along, across, up), np.unravel_index(used, counts), strict=True)], axis=1)  # fmt: skip
    return positions, numbers.reshape(-1, 8), np.searchsorted(used, walls)


def _cuts(refinement: Refinement, shape: Shape) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Places of the planes between cells along x, y and z [mm]."""
    thick = refinement.thick
    period = [(shape.wall, thick), (shape.chamber[0], refinement.chamber), (shape.wall, thick),
              (shape.gap, thick)]  # fmt: skip
    along = (period * shape.chamber_count)[:-1]
    beside = (0.5 * (shape.chamber[1] - shape.channel[0]), refinement.beside)
    across = [(shape.side, thick), beside, (shape.channel[0], thick), beside, (shape.side, thick)]
    rise = shape.chamber[2] - shape.channel[1] - shape.roof
    up = [(shape.base, thick), (shape.channel[1], thick), (shape.roof, thick),
          (rise, refinement.rise), (shape.ceiling, thick)]  # fmt: skip
    steps = [np.cumsum(np.concatenate([[0.0], *(np.full(count, length / count)
             for length, count in parts)])) for parts in (along, across, up)]  # fmt: skip
    return steps[0], steps[1] - 0.5 * steps[1][-1], steps[2]


def write(path: Path, positions, hexahedra, walls) -> None:
    """Writes the body and the cavity as physical groups, Gmsh version 2.2."""
    import meshio

    blocks = [("hexahedron", hexahedra), ("quad", walls)]
    tags = [np.full(len(cells), tag, np.int32) for tag, (_, cells) in enumerate(blocks, start=1)]
    meshio.Mesh(
        positions, [(kind, cells.astype(np.int32)) for kind, cells in blocks],
        cell_data={"gmsh:physical": tags, "gmsh:geometrical": tags},
        field_data={"body": np.array([1, 3]), "cavity": np.array([2, 2])},
    ).write(path, file_format="gmsh22", binary=True)
    print(f"{path.name}: {len(positions)} nodes, {len(hexahedra)} hexahedra")


def main(arguments: list[str] | None = None) -> int:
    """Writes the requested meshes; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--size", type=int, choices=REFINEMENTS, action="append",
                        help=f"may be repeated (default: {KEPT})")  # fmt: skip
    parser.add_argument("--output", type=Path, default=Path(__file__).resolve().parent,
                        help="folder of the meshes (default: beside the script)")  # fmt: skip
    options = parser.parse_args(arguments)
    for size in options.size or KEPT:
        write(options.output / f"fast_pneunet_{size}.msh", *make(REFINEMENTS[size]))
    return 0


if __name__ == "__main__":
    sys.exit(main())
