"""Makes the meshes of the pneumatic segment: ``python meshes/make_segment.py``.

The segment is a cylinder of silicone around z, from z = 0 to 102 mm, of radius 22.2 mm. A cross of
walls along x and y divides its inside into four chambers, one in each quadrant: gas in one of them
bends it away from that quadrant. All walls are 2.0 mm thick, both ends 6.9 mm. The chambers are the
closed surfaces ``cavity_1`` to ``cavity_4``, from the quadrant x, y > 0 on counter-clockwise; the
silicone is the region ``body``.

A section of quadrilaterals, the same after a quarter of a turn and in the mirror y, is repeated
along z; polygons have the areas of the circles that they replace. The cells between are cut into
tetrahedra, or kept whole in ``segment_hexa_*.msh``: in walls as thin as these, one hexahedron bends
as several layers of tetrahedra do.
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
    make_all,
    mesh_parser,
    mirror,
    pneumatic_faults,
    turn_about_z,
)
from meshes.swept_body import CAVITY, chequered, joined, ruled_quads, swept  # noqa: E402

LOWEST_RADIUS_RATIO = 0.1
# Where a chamber's four-sided parts meet in the ends: shares of its sides, and of that height.
MIDDLE_OF_SIDE = 0.55
MIDDLE_OF_CHAMBER = 0.9


@dataclass(frozen=True)
class SegmentShape:
    """Dimensions of the segment [mm].

    Attributes:
        length: Along z.
        radius: Of the outer side.
        wall: Thickness of the outer wall and of the cross.
        end: Thickness of both ends.
    """

    length: float = 102.0
    radius: float = 22.2
    wall: float = 2.0
    end: float = 6.9

    @property
    def chamber_volume(self) -> float:
        """Volume of one chamber [mm³]: a sector between the walls, less a triangle along each."""
        half, radius = 0.5 * self.wall, self.radius - self.wall
        angle = np.arcsin(half / radius)
        sector = 0.5 * radius**2 * (0.5 * np.pi - 2.0 * angle)
        triangles = half * (radius * np.cos(angle) - half)
        return float((sector - triangles) * (self.length - 2.0 * self.end))


@dataclass(frozen=True)
class Refinement:
    """How a mesh is cut.

    Attributes:
        inner: Cells of a chamber's side from the cross's middle on, and of half its arc.
        outer: Cells of a chamber's side from there to the arc.
        wall: Cells through the outer wall; the cross has two.
        end: Layers of each end.
        chamber: Layers along the chambers.
        whole: Whether its cells are hexahedra.
    """

    inner: int
    outer: int
    wall: int
    end: int
    chamber: int
    whole: bool = False


# Name of a refinement (about its number of nodes) and how it is cut.
REFINEMENTS = {
    1000: Refinement(1, 1, 1, 1, 15),
    1500: Refinement(2, 1, 1, 1, 15),
    2300: Refinement(2, 2, 1, 1, 20),
    4000: Refinement(2, 1, 2, 2, 32),
}
HEXAHEDRAL = {1125: Refinement(3, 1, 1, 1, 6, True), 1279: Refinement(2, 1, 1, 1, 12, True)}
"""The same of meshes of hexahedra."""


def make_segment(refinement: Refinement, shape: SegmentShape = SegmentShape()) -> PneumaticMesh:
    """Meshes the segment.

    Args:
        refinement: The refinement.
        shape: Dimensions of the segment.

    Returns:
        The mesh [m].
    """
    walls, chamber = _quadrant(refinement, shape)
    corners, in_chamber = [], []
    for quadrant in range(4):
        corners += [_turned(walls, quadrant), _turned(chamber, quadrant)]
        in_chamber += [0] * len(walls) + [quadrant + 1] * len(chamber)
    section = chequered(*joined(np.vstack(corners)))
    marks = [0.0, shape.end, shape.length - shape.end, shape.length]
    counts = [refinement.end, refinement.chamber, refinement.end]
    heights = np.interp(
        np.arange(sum(counts) + 1), np.concatenate([[0], np.cumsum(counts)]), marks
    )
    along = [f"{CAVITY}_{number}" if number else "body" for number in in_chamber]
    closed = ["body"] * len(in_chamber)
    labels = [closed] * refinement.end + [along] * refinement.chamber + [closed] * refinement.end
    return swept(section, heights[:, None], np.array(labels), refinement.whole)


def _quadrant(refinement: Refinement, shape: SegmentShape) -> tuple[np.ndarray, np.ndarray]:
    """Quadrilaterals of the walls and of the chamber in x, y ≥ 0 [mm], each of shape (n, 4, 2)."""
    half, inner, outer = 0.5 * shape.wall, refinement.inner, refinement.outer
    angles, factor = _ring_angles(half / (shape.radius - shape.wall), inner)
    ring = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    inside, outside = (factor * r * ring for r in (shape.radius - shape.wall, shape.radius))
    middle = half + MIDDLE_OF_SIDE * (inside[1, 0] - half)
    shares = np.concatenate(
        [np.linspace(0.0, MIDDLE_OF_SIDE, inner + 1),
         np.linspace(MIDDLE_OF_SIDE, 1.0, outer + 1)[1:]]
    )[:, None]  # fmt: skip
    corner, centre = np.array([half, half]), np.full(2, MIDDLE_OF_CHAMBER * middle)
    axis = (1.0 - shares) * (half, 0.0) + shares * inside[0]
    side = (1.0 - shares) * corner + shares * inside[1]
    rib = np.linspace(side[inner], centre, inner + 1)
    wall_half = np.vstack(
        [ruled_quads(axis, side, 1), ruled_quads(outside, inside, refinement.wall)]
    )
    chamber_half = ruled_quads(inside[1:], rib, outer)
    beyond = np.linspace(side[inner, ::-1], centre, inner + 1)
    square = ruled_quads(np.array([(0.0, 0.0), (half, 0.0)]), np.array([(0.0, half), corner]), 1)
    near = ruled_quads(side[: inner + 1], beyond, inner)
    return (
        np.vstack([square, wall_half, _mirrored(wall_half)]),
        np.vstack([near, chamber_half, _mirrored(chamber_half)]),
    )


def _ring_angles(sine: float, cells: int) -> tuple[np.ndarray, float]:
    """Angles of the nodes from the x axis to the diagonal, and circumradius over radius.

    The second node lies on the face of the cross's wall, whose half thickness is `sine` times the
    radius of the circle; the polygon has the circle's area.
    """
    factor = 1.0
    for _ in range(50):  # Contracts by a factor under 0.1 each time.
        face = np.arcsin(sine / factor)
        angles = np.concatenate([[0.0], np.linspace(face, 0.25 * np.pi, cells + 1)])
        factor = float(np.sqrt(0.25 * np.pi / np.sin(np.diff(angles)).sum()))
    return angles, factor


def _mirrored(quads: np.ndarray) -> np.ndarray:
    """Quadrilaterals mirrored in the diagonal, counter-clockwise again."""
    return quads[:, ::-1, ::-1]


def _turned(quads: np.ndarray, quarters: int) -> np.ndarray:
    """Quadrilaterals turned by quarters of a turn."""
    for _ in range(quarters):
        quads = np.stack([-quads[..., 1], quads[..., 0]], axis=-1)
    return quads


def _faults(made: PneumaticMesh) -> list[str]:
    """Reasons why a mesh cannot be used, as sentences."""
    volumes = {f"{CAVITY}_{number}": SegmentShape().chamber_volume for number in range(1, 5)}
    symmetries = {"a quarter of a turn": turn_about_z(4), "the mirror y": mirror(1)}
    return pneumatic_faults(made, volumes, symmetries, LOWEST_RADIUS_RATIO)


def main(arguments: list[str] | None = None) -> int:
    """Makes the requested meshes; returns 1 when one of them cannot be used."""
    parser = mesh_parser("Mesh the pneumatic segment.", {**REFINEMENTS, **HEXAHEDRAL})
    options = parser.parse_args(arguments)
    written = [make_all(options, name, own, make_segment, _faults)
               for name, own in (("segment", REFINEMENTS), ("segment_hexa", HEXAHEDRAL))]  # fmt: skip
    return 0 if all(written) else 1


if __name__ == "__main__":
    sys.exit(main())
