"""Makes the tetrahedral meshes of a PneuNet gripper's finger: ``python meshes/make_pneunet.py``.

The finger lies along −x, its root at x = 0, inside the box [−115, 0, −10] to [0, 30, 10] mm. Six
chambers in a row, joined by a channel at their floor, hold 8.9 cm³ of gas: the closed surface
``cavity``. Between two chambers a gap opens towards y = 30 mm. The lowest 2 mm, under floor and
channel, are the region ``layer``, which a scene makes hard to stretch; the rest is ``body``. So gas
bends the finger towards −y, the side that grasps.

A section in the x–y plane, of quadrilaterals, is swept along z; the mesh is its own image in the
mirror z.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from itertools import pairwise
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
)
from meshes.swept_body import CAVITY, Section, chequered, joined, ruled_quads, swept  # noqa: E402

LOWEST_RADIUS_RATIO = 0.1


@dataclass(frozen=True)
class Refinement:
    """How a mesh is cut.

    Attributes:
        root: Cells along the root.
        chamber: Cells along a chamber.
        between: Cells along the channel between two chambers.
        skin: Cells through walls, roofs and ceilings.
        rise: Cells from the channel to the ceiling.
        side: Cells through each of the side walls.
        half_width: Cells from there to the middle.
    """

    root: int = 1
    chamber: int = 1
    between: int = 1
    skin: int = 1
    rise: int = 1
    side: int = 1
    half_width: int = 1


# Name of a refinement (about its number of nodes) and how it is cut.
REFINEMENTS = {
    400: Refinement(),
    620: Refinement(between=2, rise=2),
    1000: Refinement(between=2, rise=3, half_width=2),
    1500: Refinement(root=3, between=2, skin=2, rise=3, half_width=2),
}


@dataclass(frozen=True)
class FingerShape:
    """Dimensions of a finger [mm].

    Attributes:
        length: Along −x, from the root to the tip.
        height: Along y.
        width: Along z.
        root: Length before the first chamber, which a scene fixes.
        tip: Thickness of the wall at the tip.
        chamber_count: Number of chambers.
        layer: Thickness of the layer under the chambers.
        channel: Height of the channel.
        roof: Thickness of the material between the channel and a gap.
        ceiling: Thickness of the material above the chambers.
        cavity_width: Width of chambers and channel.
        gap: Width of the gaps at their bottom and at their top.
        cavity_volume: Volume of the gas [mm³]; the chambers' length follows from it.
    """

    length: float = 115.0
    height: float = 30.0
    width: float = 20.0
    root: float = 20.0
    tip: float = 4.0
    chamber_count: int = 6
    layer: float = 2.0
    channel: float = 2.0
    roof: float = 3.0
    ceiling: float = 3.5
    cavity_width: float = 12.0
    gap: tuple[float, float] = (3.0, 6.0)
    cavity_volume: float = 8900.0

    def chambers(self) -> list[tuple[float, float]]:
        """Start and end of each chamber, as distances from the root [mm]."""
        run = self.length - self.root - self.tip
        area = self.cavity_volume / self.cavity_width
        rise = self.height - self.ceiling - self.layer - self.channel
        length = (area - self.channel * run) / (self.chamber_count * rise)
        period = (run - length) / (self.chamber_count - 1)
        starts = self.root + period * np.arange(self.chamber_count)
        return [(float(start), float(start + length)) for start in starts]


def make_finger(refinement: Refinement, shape: FingerShape = FingerShape()) -> PneumaticMesh:
    """Meshes a finger.

    Args:
        refinement: The refinement.
        shape: Dimensions of the finger.

    Returns:
        The mesh [m].
    """
    section, inside = _section(refinement, shape)
    half_cavity, half_width = 0.5 * shape.cavity_width, 0.5 * shape.width
    side, middle = refinement.side, 2 * refinement.half_width
    widths = np.interp(
        np.arange(2 * side + middle + 1),
        [0, side, side + middle, 2 * side + middle],
        [-half_width, -half_cavity, half_cavity, half_width],
    )
    beside = np.where(inside == CAVITY, "body", inside)
    labels = np.array([beside] * side + [inside] * middle + [beside] * side)
    return swept(section, widths[:, None], labels)


def _section(refinement: Refinement, shape: FingerShape) -> tuple[Section, np.ndarray]:
    """Section in the x–y plane, and the label of each of its faces where there is a cavity."""
    parts = _floor(refinement, shape) + _chambers(refinement, shape)
    corners = np.vstack([quads for quads, _ in parts])[:, ::-1] * (-1.0, 1.0)
    labels = np.concatenate([[label] * len(quads) for quads, label in parts])
    return chequered(*joined(corners)), labels


def _line(start: tuple[float, float], end: tuple[float, float], cells: int) -> np.ndarray:
    """Points of a straight line (distance from the root, height) [mm], shape (cells + 1, 2)."""
    return np.linspace(start, end, cells + 1)


def _floor(refinement: Refinement, shape: FingerShape) -> list[tuple[np.ndarray, str]]:
    """The layer along the whole finger, and the channel above it."""
    cuts = [0.0, *np.ravel(shape.chambers()), shape.length]
    parts = []
    for number, (start, end) in enumerate(pairwise(cuts)):
        ends = number in (0, len(cuts) - 2)
        if number == 0:
            cells = refinement.root
        elif ends:
            cells = refinement.skin
        else:
            cells = refinement.chamber if number % 2 else refinement.between
        levels = [
            _line((start, y), (end, y), cells)
            for y in (0.0, shape.layer, shape.layer + shape.channel)
        ]
        parts.append((ruled_quads(levels[0], levels[1], 1), "layer"))
        parts.append((ruled_quads(levels[1], levels[2], 1), "body" if ends else CAVITY))
    return parts


def _chambers(refinement: Refinement, shape: FingerShape) -> list[tuple[np.ndarray, str]]:
    """What lies above the channel: root, chambers with their ceilings, walls, roofs, tip."""
    skin, rise = refinement.skin, refinement.rise
    low, high = shape.layer + shape.channel, shape.height - shape.ceiling
    chambers = shape.chambers()
    tops = _outer_tops(shape)
    parts = []
    for (start, end), top in zip(chambers, tops, strict=True):
        ceiling = _line((start, high), (end, high), refinement.chamber)
        floor = _line((start, low), (end, low), refinement.chamber)
        parts.append((ruled_quads(floor, ceiling, rise), CAVITY))
        outer = _line((top[0], shape.height), (top[1], shape.height), refinement.chamber)
        parts.append((ruled_quads(ceiling, outer, skin), "body"))
    for before, after in pairwise(range(shape.chamber_count)):
        left, right = chambers[before][1], chambers[after][0]
        bottom = [0.5 * (left + right) + side * 0.5 * shape.gap[0] for side in (-1.0, 1.0)]
        roof = low + shape.roof
        face = _line((bottom[0], roof), (tops[before][1], shape.height), rise)
        parts.append((ruled_quads(face, _line((left, low), (left, high), rise), skin), "body"))
        face = _line((bottom[1], roof), (tops[after][0], shape.height), rise)
        parts.append((ruled_quads(_line((right, low), (right, high), rise), face, skin), "body"))
        below = _line((left, low), (right, low), refinement.between)
        above = _line((bottom[0], roof), (bottom[1], roof), refinement.between)
        parts.append((ruled_quads(below, above, skin), "body"))
    ends = (((0.0, chambers[0][0]), refinement.root), ((chambers[-1][1], shape.length), skin))
    for (start, end), cells in ends:
        levels = [_line((start, y), (end, y), cells) for y in (low, high, shape.height)]
        parts.append((ruled_quads(levels[0], levels[1], rise), "body"))
        parts.append((ruled_quads(levels[1], levels[2], skin), "body"))
    return parts


def _outer_tops(shape: FingerShape) -> list[tuple[float, float]]:
    """Start and end of each chamber's top side: from gap to gap, at the ends as the chamber."""
    chambers = shape.chambers()
    tops = [list(chamber) for chamber in chambers]
    for before, after in pairwise(range(shape.chamber_count)):
        middle = 0.5 * (chambers[before][1] + chambers[after][0])
        tops[before][1] = middle - 0.5 * shape.gap[1]
        tops[after][0] = middle + 0.5 * shape.gap[1]
    return [(start, end) for start, end in tops]


def _faults(made: PneumaticMesh) -> list[str]:
    """Reasons why a mesh cannot be used, as sentences."""
    volumes = {CAVITY: FingerShape().cavity_volume}
    return pneumatic_faults(made, volumes, {"the mirror z": mirror(2)}, LOWEST_RADIUS_RATIO)


def main(arguments: list[str] | None = None) -> int:
    """Makes the requested meshes; returns 1 when one of them cannot be used."""
    parser = mesh_parser("Mesh a finger of the PneuNet gripper.", REFINEMENTS)
    options = parser.parse_args(arguments)
    return 0 if make_all(options, "pneunet_finger", REFINEMENTS, make_finger, _faults) else 1


if __name__ == "__main__":
    sys.exit(main())
