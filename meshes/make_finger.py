"""Makes the tetrahedral meshes of the finger: ``python meshes/make_finger.py``.

The finger is the body that README and examples begin with. It lies along x, its root at x = 0: 100
mm long, 16 mm wide (y) and 20 mm high (z) at its root, 12 and 14 mm where its round tip begins. Its
sections are rounded. A quarter of it is a block of boxes, six tetrahedra each, bent into shape and
mirrored in y and z, so that cables in the plane y = 0 bend it in that plane, down as easily as up.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

# The script also runs from a checkout that is not installed.
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from meshes.mesh_making import (  # noqa: E402
    PneumaticMesh,
    faults_of,
    make_all,
    mesh_parser,
    mirror,
    pneumatic_faults,
)
from softrobot_twin.geometry.box_mesh import read_box  # noqa: E402
from softrobot_twin.geometry.tet_mesh import TetMesh  # noqa: E402

LOWEST_RADIUS_RATIO = 0.25


@dataclass(frozen=True)
class Refinement:
    """Number of boxes of a quarter.

    Attributes:
        along: From the root to the tip.
        tip: Along the tip.
        half_width: Across, from the middle to the side.
        half_height: From the middle to the upper side.
    """

    along: int
    tip: int
    half_width: int
    half_height: int


# Name of a refinement (its number of nodes) and how it is cut.
REFINEMENTS = {99: Refinement(8, 2, 1, 1), 195: Refinement(10, 2, 1, 2)}


@dataclass(frozen=True)
class FingerShape:
    """Dimensions of the finger [mm].

    Attributes:
        length: Along x, from the root to the end of the tip.
        tip: Length of the tip.
        root: Width (y) and height (z) at the root.
        end: The same where the tip begins.
        end_share: Share of these that is left at the end of the tip.
        roundness: 0: sections are rectangles; 1: ellipses.
        cable_height: Distance of both cables from the middle.
        cable_length: x of the cables' last point.
    """

    length: float = 100.0
    tip: float = 8.0
    root: tuple[float, float] = (16.0, 20.0)
    end: tuple[float, float] = (12.0, 14.0)
    end_share: float = 0.55
    roundness: float = 0.8
    cable_height: float = 5.0
    cable_length: float = 90.0

    def cable_points(self) -> np.ndarray:
        """Points of both cables, shape (count, 3) [mm]."""
        places = np.linspace(0.0, self.cable_length, 7)
        return np.array([(x, 0.0, z * self.cable_height) for z in (-1.0, 1.0) for x in places])


def make_finger(refinement: Refinement, shape: FingerShape = FingerShape()) -> PneumaticMesh:
    """Meshes the finger.

    Args:
        refinement: The refinement.
        shape: Dimensions of the body.

    Returns:
        The mesh [m], all of it the region ``finger``.
    """
    along = refinement.along + refinement.tip
    counts = (along, refinement.half_width, refinement.half_height)
    block = read_box((1.0, 1.0, 1.0), counts, of_hexahedra=True).mesh
    share, across, up = (block.node_positions - block.node_positions.min(axis=0)).T
    sections = np.append(
        np.linspace(0.0, shape.length - shape.tip, refinement.along + 1),
        np.linspace(shape.length - shape.tip, shape.length, refinement.tip + 1)[1:],
    )
    x = sections[np.rint(share * along).astype(int)]
    half_width, half_height = _half_sizes(x, shape)
    # A square becomes a rounded one: its corners move inwards, the middles of its edges do not.
    y = half_width * across * np.sqrt(1.0 - 0.5 * shape.roundness * up**2)
    z = half_height * up * np.sqrt(1.0 - 0.5 * shape.roundness * across**2)
    nodes, cells = 1e-3 * np.stack([x, y, z], axis=1), block.as_tets
    for axis in (1, 2):
        nodes, cells = _with_mirror_image(nodes, cells, axis)
    return PneumaticMesh(TetMesh(nodes, cells), {"finger": np.arange(len(cells))}, {})


def _half_sizes(x: np.ndarray, shape: FingerShape) -> np.ndarray:
    """Half width and half height of the sections at x, shape (2, count) [mm]."""
    start = shape.length - shape.tip
    taper = np.stack([np.interp(x, [0.0, start], pair)
                      for pair in zip(shape.root, shape.end, strict=True)])  # fmt: skip
    way = np.maximum(x - start, 0.0) / shape.tip
    return 0.5 * taper * np.sqrt(1.0 - (1.0 - shape.end_share**2) * way**2)


def _with_mirror_image(
    nodes: np.ndarray, cells: np.ndarray, axis: int
) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and cells joined to their image in the mirror through the origin, normal to an axis."""
    nodes = np.round(nodes, 10)
    both = np.concatenate([nodes, nodes @ mirror(axis)]) + 0.0  # + 0.0 makes −0.0 and 0.0 one
    # After rounding, the nodes on the mirror coincide exactly.
    unique, indices = np.unique(both, axis=0, return_inverse=True)
    every = np.concatenate([cells, len(nodes) + cells[:, [0, 1, 3, 2]]])
    return unique, indices.reshape(-1)[every]


def finger_faults(made: PneumaticMesh) -> list[str]:
    """Reasons why a mesh cannot be used, as sentences."""
    mirrors = {"the mirror y": mirror(1), "the mirror z": mirror(2)}
    outside = faults_of(made.mesh, FingerShape().cable_points(), LOWEST_RADIUS_RATIO)
    return outside + pneumatic_faults(made, {}, mirrors, 0.0)


def main(arguments: list[str] | None = None) -> int:
    """Makes the requested meshes; returns 1 when one of them cannot be used."""
    options = mesh_parser("Mesh the finger.", REFINEMENTS).parse_args(arguments)
    return 0 if make_all(options, "finger", REFINEMENTS, make_finger, finger_faults) else 1


if __name__ == "__main__":
    sys.exit(main())
