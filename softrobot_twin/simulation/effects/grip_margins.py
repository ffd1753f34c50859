"""How much more friction the pairs of a grasp could have: their distance to the friction cone.

Of all contacts of a pair,

    margin = 1 - Σ |λ_t| / Σ µ λ_n

is one where nothing pulls along the surfaces, and zero where every contact slips. Single contacts at the
rim slip long before; what they give up the others bear, so that the bodies move against each other only
where the sum is used up.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from softrobot_twin.constraints.contact import Contacts
from softrobot_twin.simulation.building.model import Model
from softrobot_twin.simulation.result import GRIP
from softrobot_twin.simulation.state import State
from softrobot_twin.simulation.step.newton import Newton
from softrobot_twin.simulation.step.step_part import PartReport, StepPart


class GripMargins(StepPart):
    """Tells the margins of pairs, and which are below what the scene asks for."""

    name = "grip_margin"

    def __init__(self, contacts: Contacts, least: dict[tuple[str, str], float]):
        """Take the pairs.

        Args:
            contacts: The contact term.
            least: Least margin of each pair, by its names.
        """
        self._contacts, self._least = contacts, np.array([*least.values()])
        self.figures = tuple(map(".".join, least))
        self._groups = contacts.pairs_named(list(least))

    def memory_at_rest(self) -> dict[str, np.ndarray]:
        """See `StepPart`: Σ λ_n and Σ |λ_t| of each pair, which targets are bound by."""
        return {"sums": np.zeros((2, len(self._contacts.pairs)))}

    def recall(self, state: State) -> None:
        """See `StepPart`."""
        self._contacts.sums_at_start[:] = state.memory_of(self.name)["sums"]

    def end(self, positions: np.ndarray, efforts: np.ndarray) -> dict[str, np.ndarray]:
        """See `StepPart`."""
        solution = self._contacts.memory
        return {"sums": self._contacts.sums_of_pairs(solution.pairs, solution.forces)}

    def report(self, state: State, newton: Newton) -> PartReport:
        """See `StepPart`; NaN of pairs that do not press."""
        sums = state.memory_of(self.name)["sums"]
        margins = 1.0 - self._contacts.friction_used(self._groups, sums)
        low = tuple(f"{name}.{GRIP}" for name, few in zip(self.figures, margins < self._least) if few)
        return PartReport(low, dict(zip(self.figures, margins.tolist())))


def grip_margins_of(model: Model) -> Iterator[StepPart]:
    """The part of a scene that asks for the margin of a pair.

    Args:
        model: The model of a simulation.
    """
    least = {entry.pair: entry.least_grip_margin for entry in model.scene.touching
             if entry.least_grip_margin}  # fmt: skip
    if least:
        yield GripMargins(model.contacts, least)
