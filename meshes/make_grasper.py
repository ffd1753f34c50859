"""Makes the tetrahedral meshes of a finger of the Grasper: ``python meshes/make_grasper.py``.

The finger lies along −x, its root at x = 0, inside the box [−103.4, 0, 0] to [0, 15, 15] mm. Its
cable runs out and back at y = 12.5 mm, so the finger bends about the material at y = 0, and
towards +y. Four notches therefore open on the side y = 15 mm, one in the middle between each two
points of the cable: they leave hinges 5 mm thick, 10 mm from the cable, and close as the cable
is wound in until the segments touch. The back tapers towards the tip; the side y = 15 mm stays
flat, because the last segment grasps with it. Three fingers at 120°, with their +y sides towards
the common axis, close on an object between them.

The body is a grid of bricks, five tetrahedra each, the same in its mirror z ↔ 15 mm − z, so that
the cable bends it in the x–y plane and no other. All refinements fill the same body.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

# The script also runs from a checkout that is not installed.
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from meshes.mesh_making import faults_of, make_all, mesh_parser, oriented_tets  # noqa: E402
from softrobot_twin.geometry.tet_mesh import TetMesh  # noqa: E402

LOWEST_RADIUS_RATIO = 0.2
# Points of the cable in order [mm], after the pull point (0, 12.5, 2.5).
CABLE_POINTS = np.array(
    [
        (-17.5, 12.5, 2.5), (-32.5, 12.5, 2.5), (-47.5, 12.5, 2.5), (-62.5, 12.5, 2.5),
        (-77.5, 12.5, 2.5), (-83.5, 12.5, 4.5), (-85.5, 12.5, 6.5), (-85.5, 12.5, 8.5),
        (-83.5, 12.5, 10.5), (-77.5, 12.5, 12.5), (-62.5, 12.5, 12.5), (-47.5, 12.5, 12.5),
        (-32.5, 12.5, 12.5), (-17.5, 12.5, 12.5),
    ]
)  # fmt: skip


@dataclass(frozen=True)
class Refinement:
    """Numbers and lengths of the bricks of a mesh.

    Attributes:
        length: Longest brick along the finger [m].
        notch_cells: Bricks along each hinge.
        hinge_cells: Bricks through a hinge's thickness.
        block_cells: Bricks from there to the side that grasps.
        width_cells: Bricks across the finger; even, so that it is its own mirror image.
    """

    length: float
    notch_cells: int
    hinge_cells: int
    block_cells: int
    width_cells: int


# Name of a refinement (about its number of nodes) and how it is cut.
REFINEMENTS = {
    158: Refinement(9e-3, 2, 1, 1, 2),
    180: Refinement(9e-3, 1, 1, 2, 2),
    360: Refinement(9e-3, 2, 2, 1, 4),
    400: Refinement(7.5e-3, 2, 1, 2, 4),
    1200: Refinement(3.0e-3, 2, 2, 2, 6),
}


@dataclass(frozen=True)
class FingerShape:
    """Dimensions of a finger [m].

    Attributes:
        length: From the root to the tip.
        side: Height and width of the square section.
        root: Length of the part a scene fixes.
        notch_centres: Distances of the notches from the root.
        notch_width: Width of a notch.
        hinge: Thickness left below a notch.
        taper_start: Distance from the root where the back starts to rise.
        tip_height: Height of the section at the tip.
    """

    length: float = 103.4e-3
    side: float = 15e-3
    root: float = 15e-3
    notch_centres: tuple[float, ...] = (25e-3, 40e-3, 55e-3, 70e-3)
    notch_width: float = 6.5e-3
    hinge: float = 5e-3
    taper_start: float = 88.4e-3
    tip_height: float = 7.5e-3

    def stretches(self) -> list[tuple[float, float, bool]]:
        """Start and end of each stretch along the finger, and whether it is a notch."""
        half = 0.5 * self.notch_width
        cuts = [(0.0, False), (self.root, False)]
        for centre in self.notch_centres:
            cuts += [(centre - half, True), (centre + half, False)]
        cuts += [(self.taper_start, False), (self.length, False)]
        return [(start, end, notch) for (start, notch), (end, _) in pairwise(cuts)]


def make_finger(refinement: Refinement, shape: FingerShape = FingerShape()) -> TetMesh:
    """Meshes a finger.

    Args:
        refinement: The refinement.
        shape: Dimensions of the finger.

    Returns:
        The mesh [m].
    """
    distances, in_notch = _cut_along(refinement, shape)
    hinge = np.linspace(0.0, shape.hinge, refinement.hinge_cells + 1)
    block = np.linspace(shape.hinge, shape.side, refinement.block_cells + 1)
    heights = np.concatenate([hinge, block[1:]])
    widths = np.linspace(0.0, shape.side, refinement.width_cells + 1)
    grid = np.stack(np.meshgrid(distances, heights, widths, indexing="ij"), axis=-1)

    filled = np.ones([count - 1 for count in grid.shape[:3]], dtype=bool)
    filled[in_notch, refinement.hinge_cells :] = False
    positions = _placed(grid.reshape(-1, 3), shape)
    tets = brick_tets(filled)
    used, corners = np.unique(tets, return_inverse=True)
    return TetMesh(positions[used], oriented_tets(positions[used], corners.reshape(tets.shape)))


def _cut_along(refinement: Refinement, shape: FingerShape) -> tuple[np.ndarray, np.ndarray]:
    """Distances of the grid's sections from the root [m]; whether a notch follows each but one."""
    distances, in_notch = [0.0], []
    for start, end, notch in shape.stretches():
        count = refinement.notch_cells if notch else int(np.ceil((end - start) / refinement.length))
        distances += list(np.linspace(start, end, count + 1)[1:])
        in_notch += [notch] * count
    return np.array(distances), np.array(in_notch)


def _placed(grid: np.ndarray, shape: FingerShape) -> np.ndarray:
    """Positions of the bricks' corners (distance, height, width), shape (count, 3)."""
    distance, height, width = grid.T
    beyond = np.clip((distance - shape.taper_start) / (shape.length - shape.taper_start), 0.0, 1.0)
    section = shape.side + beyond * (shape.tip_height - shape.side)
    y = shape.side - (shape.side - height) * section / shape.side
    return np.stack([-distance + 0.0, y, width], axis=1)


def brick_tets(filled: np.ndarray) -> np.ndarray:
    """Five tetrahedra in each filled brick; the faces' diagonals join corners of even index sum.

    Args:
        filled: Whether each brick is there, shape (along, through, across).

    Returns:
        Indices into the grid's corners, flattened, shape (tet_count, 4).
    """
    corner_shape = tuple(count + 1 for count in filled.shape)
    offsets = np.stack(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij"), axis=-1).reshape(8, 3)
    tets = []
    for brick in np.argwhere(filled):
        corners = brick + offsets
        even = corners.sum(axis=1) % 2 == 0
        number = np.ravel_multi_index(corners.T, corner_shape)
        tets.append(number[even])
        for odd in np.flatnonzero(~even):
            beside = np.abs(offsets - offsets[odd]).sum(axis=1) == 1
            tets.append([number[odd], *number[beside]])
    return np.array(tets)


def _faults(mesh: TetMesh) -> list[str]:
    """Reasons why a mesh cannot be used, as sentences."""
    return faults_of(mesh, CABLE_POINTS, LOWEST_RADIUS_RATIO)


def main(arguments: list[str] | None = None) -> int:
    """Makes the requested meshes; returns 1 when one of them cannot be used."""
    parser = mesh_parser("Mesh a finger of the Grasper.", REFINEMENTS)
    options = parser.parse_args(arguments)
    made = make_all(options, "grasper_finger", REFINEMENTS, make_finger, _faults)
    return 0 if made else 1


if __name__ == "__main__":
    sys.exit(main())
