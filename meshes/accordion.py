"""The accordion of the Springy and the Fetch: a bellows of revolution around its axis."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from meshes.swept_body import CAVITY, EMPTY

# What fills each kind of layer, ring by ring from the axis: core, neck, fold, tip.
FILLING = {
    "end": ("body", "body", "body", "body"),
    "pocket": (CAVITY, CAVITY, CAVITY, "body"),
    "wall": (CAVITY, "body", "body", "body"),
    "groove": (CAVITY, "body", EMPTY, EMPTY),
}


@dataclass(frozen=True)
class AccordionCells:
    """How an accordion is cut.

    Attributes:
        sectors: Nodes around the axis; even.
        neck: Rings through the wall of a neck.
        fold: Rings from there to the tip of a pocket.
        tip: Rings from there to the outer side.
        wall: Layers through a wall.
        groove: Layers along a groove.
        pocket: Layers along a pocket.
    """

    sectors: int
    neck: int
    fold: int
    tip: int
    wall: int
    groove: int = 1
    pocket: int = 1


@dataclass(frozen=True)
class AccordionShape:
    """Dimensions of an accordion between two ends [mm].

    From end to end a pocket of gas, a wall, a groove, a wall, a pocket and so on; the ends close
    the first and the last pocket. Pockets are joined by a core of gas within necks.

    Attributes:
        height: From end to end, along the axis.
        core_radius: Of the gas within the necks.
        neck_radius: Of the necks: how deep the grooves reach.
        tip_radius: Of the gas in the pockets.
        outer_radius: Of the folds.
        fold_count: Number of pockets.
        wall: Thickness of the walls between pockets and grooves, along the axis.
        tip_height: Height of a pocket at its tip; at the core it follows from the volume.
        cavity_volume: Volume of the gas [mm³].
    """

    height: float
    core_radius: float
    neck_radius: float
    tip_radius: float
    outer_radius: float
    fold_count: int
    wall: float
    tip_height: float
    cavity_volume: float

    @property
    def core_height(self) -> float:
        """Height of a pocket where it meets the core.

        A pocket's height falls from h_c at r_c to h_t at r_t, so that its volume beyond the core is
        2π (h_c ∫ r (1 − u) dr + h_t ∫ r u dr), u = (r − r_c) / (r_t − r_c).
        """
        core, width = self.core_radius, self.tip_radius - self.core_radius
        pocket = (self.cavity_volume - np.pi * core**2 * self.height) / self.fold_count
        at_tip = width * (core / 2.0 + width / 3.0)
        at_core = width * (core / 2.0 + width / 6.0)
        return float((pocket / (2.0 * np.pi) - self.tip_height * at_tip) / at_core)

    def stretches(self, cells: AccordionCells) -> list[tuple[str, int, float, float]]:
        """Kind, number of layers, and height at the core and at the tip of each stretch."""
        folds, walls = self.fold_count, 2 * (self.fold_count - 1)
        grooves = [
            (self.height - folds * pocket - walls * self.wall) / (folds - 1)
            for pocket in (self.core_height, self.tip_height)
        ]
        pocket = [("pocket", cells.pocket, self.core_height, self.tip_height)]
        wall = [("wall", cells.wall, self.wall, self.wall)]
        groove = [("groove", cells.groove, *grooves)]
        return pocket + (wall + groove + wall + pocket) * (folds - 1)

    def layers(self, cells: AccordionCells) -> tuple[list[str], np.ndarray]:
        """Kind of each layer, and heights of the levels above the lower end at core and tip.

        Returns:
            The kinds, and the heights [mm], shape (layer_count + 1, 2).
        """
        kinds, heights = [], [np.zeros((1, 2))]
        for kind, count, at_core, at_tip in self.stretches(cells):
            steps = np.arange(1, count + 1)[:, None] / count
            heights.append(heights[-1][-1] + steps * (at_core, at_tip))
            kinds += [kind] * count
        return kinds, np.vstack(heights)

    def rings(self, cells: AccordionCells) -> tuple[np.ndarray, np.ndarray]:
        """Radii of the rings of nodes [mm], and which part of `FILLING` lies within each."""
        marks = [self.core_radius, self.neck_radius, self.tip_radius, self.outer_radius]
        counts = [cells.neck, cells.fold, cells.tip]
        radii = [[self.core_radius]]
        for start, end, count in zip(marks[:-1], marks[1:], counts, strict=True):
            radii.append(np.linspace(start, end, count + 1)[1:])
        return np.concatenate(radii), np.repeat(np.arange(4), [1, *counts])

    def tip_shares(self, radii: np.ndarray) -> np.ndarray:
        """How far each radius lies between the core, 0, and the tips of the pockets, 1."""
        width = self.tip_radius - self.core_radius
        return np.clip((np.asarray(radii) - self.core_radius) / width, 0.0, 1.0)
