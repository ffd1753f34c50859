"""Makes the tetrahedral meshes of the Flexo's hand: ``python meshes/make_flexo.py``.

Three fingers at 120° about z stand on z = 0, 70 mm long. The first one is 12 mm wide, in y, and
tapers from 10 mm at its base to 5 mm at its tip. Its inner side is the plane x = 14 mm; its cable
runs along the middle of that side, so the fingers bend towards the axis and close on an object
between them.

The body is a grid of bricks, five tetrahedra each. In a scene their elements are quadratic: then
nodes lie at the middle of all edges, also of the faces' diagonals. So the cable's points are nodes,
two for each brick along the coarse mesh.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

# The script also runs from a checkout that is not installed.
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from meshes.make_grasper import brick_tets  # noqa: E402
from meshes.mesh_making import (  # noqa: E402
    faults_of,
    make_all,
    mesh_parser,
    oriented_tets,
    turn_about_z,
)
from softrobot_twin.geometry.tet_mesh import TetMesh  # noqa: E402

LOWEST_RADIUS_RATIO = 0.3


@dataclass(frozen=True)
class Refinement:
    """Numbers of bricks of a mesh.

    Attributes:
        along: From the base to the tip.
        through: Through the thickness.
        across: Across the width.
    """

    along: int
    through: int
    across: int


# Name of a refinement (its number of nodes) and the bricks of each finger.
REFINEMENTS = {48: Refinement(3, 1, 1), 216: Refinement(7, 2, 2)}


@dataclass(frozen=True)
class FingerShape:
    """Dimensions of a finger [m].

    Attributes:
        length: From the base to the tip.
        width: Width of the section.
        base: Thickness at the base.
        tip: Thickness at the tip.
        inner: Distance of the inner side from the axis of the hand.
    """

    length: float = 70e-3
    width: float = 12e-3
    base: float = 10e-3
    tip: float = 5e-3
    inner: float = 14e-3

    def cable(self) -> np.ndarray:
        """Points of the cable along the inner side [m], shape (5, 3)."""
        heights = self.length * np.arange(1, 6) / 6.0
        return np.column_stack([np.full(5, self.inner), np.zeros(5), heights])


def make_hand(refinement: Refinement, shape: FingerShape = FingerShape()) -> TetMesh:
    """Meshes three fingers.

    Args:
        refinement: The refinement.
        shape: Dimensions of the finger.

    Returns:
        The mesh [m].
    """
    bricks = (refinement.along, refinement.through, refinement.across)
    along, through, across = np.meshgrid(
        *(np.linspace(0.0, 1.0, count + 1) for count in bricks), indexing="ij"
    )
    thickness = shape.base + along * (shape.tip - shape.base)
    positions = np.stack(
        [shape.inner + through * thickness, shape.width * (across - 0.5), shape.length * along],
        axis=-1,
    ).reshape(-1, 3)
    tets = brick_tets(np.ones(bricks, dtype=bool))
    placed = np.vstack([
        positions @ np.linalg.matrix_power(turn_about_z(3), finger).T for finger in range(3)
    ])
    cells = np.vstack([tets + finger * len(positions) for finger in range(3)])
    return TetMesh(placed, oriented_tets(placed, cells))


def _faults(mesh: TetMesh) -> list[str]:
    """Reasons why a mesh cannot be used, as sentences."""
    return faults_of(mesh, 1e3 * FingerShape().cable(), LOWEST_RADIUS_RATIO)


def main(arguments: list[str] | None = None) -> int:
    """Makes the requested meshes; returns 1 when one of them cannot be used."""
    options = mesh_parser("Mesh the hand of the Flexo.", REFINEMENTS).parse_args(arguments)
    return 0 if make_all(options, "flexo_hand", REFINEMENTS, make_hand, _faults) else 1


if __name__ == "__main__":
    sys.exit(main())
