"""Tells of materials that a step strained beyond the range of their law."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from softrobot_twin.mechanics.strain_watch import StrainOutside
from softrobot_twin.simulation.building.model import Model
from softrobot_twin.simulation.result import STRAINED
from softrobot_twin.simulation.state import State
from softrobot_twin.simulation.step.step_part import PartReport, StepPart


class StrainRanges(StepPart):
    """Watches the strains where each step ends."""

    name = "strain_ranges"

    def __init__(self, model: Model):
        """Take the watches.

        Args:
            model: A scene with materials that have a range of strains.
        """
        self._watches = model.strain_watches
        self._outside: list[StrainOutside] = []

    def end(self, positions: np.ndarray, efforts: np.ndarray) -> dict[str, np.ndarray]:
        """See `StepPart`."""
        watched = (watch.outside(positions) for watch in self._watches)
        self._outside = [outside for outside in watched if outside is not None]
        return {}

    def report(self, state: State) -> PartReport:
        """See `StepPart`."""
        limits = dict.fromkeys(f"{outside.body}.{STRAINED}" for outside in self._outside)
        return PartReport(tuple(limits), entries={"strains": tuple(self._outside)})


def strain_ranges_of(model: Model) -> Iterator[StepPart]:
    """The part of a scene with materials that have a range of strains."""
    if model.strain_watches:
        yield StrainRanges(model)
