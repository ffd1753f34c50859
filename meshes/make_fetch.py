"""Makes the tetrahedral meshes of the Fetch: ``python meshes/make_fetch.py``.

The Fetch is two platforms on top of each other, along z from 0 to 116 mm: three plates, 6 mm thick
and of radius 38 mm, and between each two of them three accordions, 49 mm high and of radius 12 mm,
whose axes stand 22 mm from the middle at azimuths 0°, 120° and 240°. The plates close the
accordions' gas, 8.0 cm³ each.

Regions are the plates ``plate_0`` (bottom), ``plate_1`` and ``plate_2`` (top), and the soft parts
``module_1`` and ``module_2`` between them. Cavities are ``cavity_1_a``, ``cavity_1_b``,
``cavity_1_c`` of the lower platform, by azimuth, and ``cavity_2_a`` to ``cavity_2_c`` of the upper.

One section, of three discs and the triangles of a plate between and around them, is swept along z.
Polygons have the areas of the circles that they replace. Each mesh is the same after a third of a
turn about z and in the mirror y.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

# The script also runs from a checkout that is not installed.
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from meshes.accordion import FILLING, AccordionCells, AccordionShape  # noqa: E402
from meshes.mesh_making import (  # noqa: E402
    PneumaticMesh,
    make_all,
    mesh_parser,
    mirror,
    pneumatic_faults,
    turn_about_z,
)
from meshes.swept_body import (  # noqa: E402
    CAVITY,
    UNCOLOURED,
    Section,
    joined,
    polar_section,
    rounding_factor,
    swept,
)

LOWEST_RADIUS_RATIO = 0.1
LEGS = ("a", "b", "c")
MODULES = (1, 2)


@dataclass(frozen=True)
class FetchShape:
    """Dimensions of the Fetch [mm].

    Attributes:
        accordion: Each of the six accordions, from plate to plate.
        pitch_radius: Distance of their axes from the middle.
        plate_radius: Radius of the plates.
        plate_thickness: Along z.
        inner_node: Distance from the middle of the plates' nodes between two accordions.
    """

    accordion: AccordionShape = AccordionShape(
        height=49.0, core_radius=4.0, neck_radius=6.0, tip_radius=10.0, outer_radius=12.0,
        fold_count=4, wall=2.0, tip_height=4.5, cavity_volume=8000.0,
    )  # fmt: skip
    pitch_radius: float = 22.0
    plate_radius: float = 38.0
    plate_thickness: float = 6.0
    inner_node: float = 20.0


@dataclass(frozen=True)
class Refinement:
    """How a mesh is cut.

    Attributes:
        accordion: Each of the accordions.
        outline: Nodes of a plate's outline.
    """

    accordion: AccordionCells
    outline: int = 12


# Name of a refinement (about its number of nodes) and how it is cut.
REFINEMENTS = {
    1500: Refinement(AccordionCells(4, neck=1, fold=1, tip=1, wall=1)),
    3714: Refinement(AccordionCells(8, neck=1, fold=2, tip=1, wall=1)),
    5152: Refinement(AccordionCells(8, neck=1, fold=2, tip=1, wall=2)),
    5586: Refinement(AccordionCells(12, neck=1, fold=2, tip=1, wall=1), 24),
}


def make_fetch(refinement: Refinement, shape: FetchShape = FetchShape()) -> PneumaticMesh:
    """Meshes the Fetch.

    Args:
        refinement: The refinement.
        shape: Dimensions of the robot.

    Returns:
        The mesh [m].
    """
    section, faces, tip_shares = _section(refinement, shape)
    kinds, inner = shape.accordion.layers(refinement.accordion)
    pitch = shape.plate_thickness + shape.accordion.height
    heights, labels = [np.zeros((1, 2))], [["plate_0"] * len(faces)]
    for module in MODULES:
        heights.append((module - 1) * pitch + shape.plate_thickness + inner)
        labels += [[_label(kind, face, module) for face in faces] for kind in kinds]
        labels.append([f"plate_{module}"] * len(faces))
    heights.append(np.full((1, 2), len(MODULES) * pitch + shape.plate_thickness))
    heights = np.vstack(heights)
    heights = heights[:, :1] + (heights[:, 1:] - heights[:, :1]) * tip_shares
    return swept(section, heights, np.array(labels))


def _label(kind: str, face: tuple[str, int] | None, module: int) -> str:
    """Label of a cell between two plates, over a face of `_section`."""
    if face is None:
        return ""
    leg, part = face
    filling = FILLING[kind][part]
    names = {"body": f"module_{module}", CAVITY: f"{CAVITY}_{module}_{leg}"}
    return names.get(filling, filling)


def _section(
    refinement: Refinement, shape: FetchShape
) -> tuple[Section, list[tuple[str, int] | None], np.ndarray]:
    """Section of the plates.

    Returns:
        The section; for each face its leg and the part of an accordion, or None beside them; and
        how far each node lies from an accordion's core, 0, to the tips of its pockets, 1.
    """
    radii, parts = shape.accordion.rings(refinement.accordion)
    sectors = refinement.accordion.sectors
    disc = polar_section(radii, sectors)
    disc = disc._replace(points=disc.points + (shape.pitch_radius, 0.0))
    shares = np.repeat(shape.accordion.tip_shares(radii), sectors)
    third = [(disc.points[disc.faces], disc.ranks[disc.faces],
              np.concatenate([[0.0], shares])[disc.faces])]  # fmt: skip
    third += _between(disc, refinement, shape)
    corners, ranks, tip_shares = (np.concatenate(every) for every in zip(*third, strict=True))
    turns = [turn_about_z(3)[:2, :2], turn_about_z(3)[:2, :2].T]
    points, faces = joined(np.vstack([corners, *(corners @ turn.T for turn in turns)]))
    node_ranks, node_shares = np.empty(len(points), dtype=np.int64), np.empty(len(points))
    node_ranks[faces] = np.tile(ranks, (3, 1))
    node_shares[faces] = np.tile(tip_shares, (3, 1))
    owners = []
    for leg in LEGS:
        owners += [(leg, part) for part in np.repeat(parts, sectors)]
        owners += [None] * (len(corners) - len(disc.faces))
    return Section(points, faces, node_ranks), owners, node_shares


def _between(disc: Section, refinement: Refinement, shape: FetchShape) -> list[tuple[np.ndarray, ...]]:
    """Triangles of the third of a plate around a disc: corners, ranks and tip shares of each half.

    A strip between the disc's outer ring and the outline, the line between two discs and the
    middle. No edge crosses a mirror plane, so the order along the strip ranks mirror images alike.
    """
    sectors, outline_count = refinement.accordion.sectors, refinement.outline
    last_ring = np.arange(len(disc.points) - sectors, len(disc.points))[: sectors // 2 + 1]
    radius = rounding_factor(outline_count) * shape.plate_radius
    angles = np.arange(outline_count // 6 + 1) * 2.0 * np.pi / outline_count
    outline = radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    outer = np.vstack([outline, outline[-1] * shape.inner_node / radius, np.zeros((1, 2))])
    points = np.vstack([disc.points[last_ring], outer])
    ranks = np.concatenate([disc.ranks[last_ring], UNCOLOURED + np.arange(len(outer))])
    triangles = _strip(points, len(last_ring))
    on_ring = np.arange(len(points)) < len(last_ring)
    quads = np.column_stack([triangles, triangles[:, 2]])
    mirrored = quads[:, [0, 2, 1, 1]]
    return [
        (points[quads], ranks[quads], on_ring[quads].astype(float)),
        (points[mirrored] * (1.0, -1.0), ranks[mirrored], on_ring[mirrored].astype(float)),
    ]


def _strip(points: np.ndarray, first_count: int) -> np.ndarray:
    """Triangles between two lines of points, by the shorter diagonal each time.

    Args:
        points: Points of the first line, counter-clockwise around a hole, then of the second.
        first_count: Points of the first line.

    Returns:
        Triangles, counter-clockwise, shape (triangle_count, 3).
    """
    left, right = 0, first_count
    triangles = []
    while left + 1 < first_count or right + 1 < len(points):
        across = [
            np.linalg.norm(points[left + 1] - points[right]) if left + 1 < first_count else np.inf,
            np.linalg.norm(points[left] - points[right + 1])
            if right + 1 < len(points)
            else np.inf,
        ]
        if across[0] <= across[1]:
            triangles.append((left, right, left + 1))
            left += 1
        else:
            triangles.append((left, right, right + 1))
            right += 1
    return np.array(triangles)


def _faults(made: PneumaticMesh) -> list[str]:
    """Reasons why a mesh cannot be used, as sentences."""
    volume = FetchShape().accordion.cavity_volume
    volumes = {f"{CAVITY}_{module}_{leg}": volume for module in MODULES for leg in LEGS}
    symmetries = {"a third of a turn": turn_about_z(3), "the mirror y": mirror(1)}
    return pneumatic_faults(made, volumes, symmetries, LOWEST_RADIUS_RATIO)


def main(arguments: list[str] | None = None) -> int:
    """Makes the requested meshes; returns 1 when one of them cannot be used."""
    parser = mesh_parser("Mesh the Fetch.", REFINEMENTS)
    options = parser.parse_args(arguments)
    return 0 if make_all(options, "fetch", REFINEMENTS, make_fetch, _faults) else 1


if __name__ == "__main__":
    sys.exit(main())
