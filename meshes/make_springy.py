"""Makes the tetrahedral meshes of the Springy: ``python meshes/make_springy.py``.

The Springy is an accordion of silicone that lengthens when it is inflated: a body of revolution
around z, from z = 0 to 50 mm, of radius 22.5 mm. Two flat ends close it. Between them lie four
pockets of gas, joined along the axis, and three grooves between them, so that the walls between
pocket and groove bend. The cavity, of 5.47 cm³, is the closed surface ``cavity``; the body is the
region ``body``.

Every polygon has the area of the circle that it replaces: all refinements have the same volume of
silicone and of gas. Each mesh is the same after a third of a turn about z and in the mirror y.
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
from meshes.swept_body import polar_section, swept  # noqa: E402

LOWEST_RADIUS_RATIO = 0.1
ACCORDION = AccordionShape(
    height=42.0, core_radius=3.0, neck_radius=7.0, tip_radius=17.5, outer_radius=22.5,
    fold_count=4, wall=3.5, tip_height=1.1, cavity_volume=5470.0,
)  # fmt: skip
# Thickness of the ends [mm].
END = 4.0


@dataclass(frozen=True)
class Refinement:
    """How a mesh is cut.

    Attributes:
        accordion: Between the ends.
        end: Layers of each end.
    """

    accordion: AccordionCells
    end: int


# Name of a refinement (about its number of nodes) and how it is cut.
REFINEMENTS = {
    400: Refinement(AccordionCells(6, neck=1, fold=1, tip=1, wall=1), 1),
    964: Refinement(AccordionCells(12, neck=1, fold=2, tip=1, wall=1), 1),
    1444: Refinement(AccordionCells(18, neck=1, fold=2, tip=1, wall=1), 1),
    1532: Refinement(AccordionCells(12, neck=1, fold=2, tip=1, wall=2, groove=2), 2),
    4000: Refinement(AccordionCells(18, neck=1, fold=3, tip=2, wall=3, groove=2), 2),
}


def make_springy(refinement: Refinement, shape: AccordionShape = ACCORDION) -> PneumaticMesh:
    """Meshes the Springy.

    Args:
        refinement: The refinement.
        shape: Dimensions between the ends.

    Returns:
        The mesh [m].
    """
    cells = refinement.accordion
    radii, parts = shape.rings(cells)
    section = polar_section(radii, cells.sectors)
    kinds, inner = shape.layers(cells)
    end = np.repeat(np.linspace(0.0, END, refinement.end + 1)[:, None], 2, axis=1)
    heights = np.vstack([end[:-1], END + inner, END + shape.height + end[1:]])
    kinds = ["end"] * refinement.end + kinds + ["end"] * refinement.end
    filling = np.array([FILLING[kind] for kind in kinds])
    shares = np.concatenate([[0.0], np.repeat(shape.tip_shares(radii), cells.sectors)])
    return swept(
        section,
        heights[:, :1] + (heights[:, 1:] - heights[:, :1]) * shares,
        np.repeat(filling[:, parts], cells.sectors, axis=1),
    )


def _faults(made: PneumaticMesh) -> list[str]:
    """Reasons why a mesh cannot be used, as sentences."""
    volumes = {"cavity": ACCORDION.cavity_volume}
    symmetries = {"a third of a turn": turn_about_z(3), "the mirror y": mirror(1)}
    return pneumatic_faults(made, volumes, symmetries, LOWEST_RADIUS_RATIO)


def main(arguments: list[str] | None = None) -> int:
    """Makes the requested meshes; returns 1 when one of them cannot be used."""
    parser = mesh_parser("Mesh the Springy.", REFINEMENTS)
    options = parser.parse_args(arguments)
    return 0 if make_all(options, "springy", REFINEMENTS, make_springy, _faults) else 1


if __name__ == "__main__":
    sys.exit(main())
