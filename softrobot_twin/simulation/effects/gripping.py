"""Gripping: what grips of a scene hold in a run, as cups under vacuum, magnets and glue do.

A grip is told to hold or to let go, and stays so. It takes hold where the body is within its reach, at
the beginning of a step; it lets go by itself where it bears more than its `force_limit`.
"""

from __future__ import annotations

import numpy as np

from softrobot_twin.errors import CommandError
from softrobot_twin.mechanics.grips import Grips, Held
from softrobot_twin.scene.refusal_messages import nearest
from softrobot_twin.simulation.building.model import Model
from softrobot_twin.simulation.state import State
from softrobot_twin.simulation.step.newton import Newton
from softrobot_twin.simulation.step.step_part import PartReport, StepPart

# Endings of the names of limits: a body is out of reach, or more was borne than a grip can.
OUT_OF_REACH, TORN = "out_of_reach", "force_limit"


class Gripping(StepPart):
    """Takes hold and lets go in the steps of one scene.

    Attributes:
        wanted: Whether each grip is told to hold, by its name.
    """

    name = "grips"

    def __init__(self, model: Model):
        """Take the grips.

        Args:
            model: The built scene.
        """
        self._term, self._entries = model.force_term(Grips), model.scene.grips
        shapes = {part.name: part.shape for part in model.rigid}
        self._shapes = [shapes.get(entry.holds) for entry in self._entries]
        self.wanted = dict.fromkeys((entry.name for entry in self._entries), False)
        self._missed: list[str] = []
        # What was told since the last step, which a state does not know yet.
        self._pending: dict[str, bool] = {}

    def tell(self, name: str, holds: bool) -> None:
        """Tell a grip to hold, or to let go, from the next step on.

        Args:
            name: Its name.
            holds: Whether it shall hold.

        Raises:
            CommandError: There is no such grip.
        """
        if name not in self.wanted:
            raise CommandError(name, f"is no grip of this scene{nearest(name, list(self.wanted))}; "
                               f"its grips: {', '.join(self.wanted)}")  # fmt: skip
        self.wanted[name] = self._pending[name] = bool(holds)

    def memory_at_rest(self) -> dict[str, np.ndarray]:
        """See `StepPart`: what is held, and the force of each grip."""
        none = Held(*(np.zeros_like(field) for field in self._term.held))
        count = len(self._entries)
        return {**none._asdict(), "forces": np.zeros((count, 3)), "told": np.zeros(count)}

    def begin(self, state: State, measured: object | None) -> bool:
        """See `StepPart`; takes hold of what is in reach, and lets go."""
        memory = state.memory_of(self.name)
        before = Held(*(memory[field] for field in Held._fields))
        self._term.held, self._missed = before, []
        for grip, (entry, shape) in enumerate(zip(self._entries, self._shapes, strict=True)):
            wants, holds = self.wanted[entry.name], before.holds[grip] > 0.0
            if wants and not holds and not self._reaches(grip, entry.reach, shape, state.positions):
                self._missed.append(f"{entry.name}.{OUT_OF_REACH}")
            elif wants != holds:
                self._term.take_hold(grip, wants, state.positions)
        return self._term.held is not before

    def _reaches(self, grip: int, reach: float, shape, positions: np.ndarray) -> bool:
        """Whether all points of a grip are near what it is to hold."""
        if shape is None:
            return True
        points = self._term.points.positions(positions)[self._term.grip_of_point == grip]
        return bool((shape.distances(self._term.local(grip, points, positions)) <= reach).all())

    def end(self, positions: np.ndarray, efforts: np.ndarray) -> dict[str, np.ndarray]:
        """See `StepPart`; what bears too much lets go at the beginning of the next step."""
        forces = self._term.forces(positions)
        for entry, force in zip(self._entries, forces, strict=True):
            if np.linalg.norm(force) > entry.force_limit:
                self.wanted[entry.name] = False
                self._missed.append(f"{entry.name}.{TORN}")
        self._pending.clear()
        return {**self._term.held._asdict(), "forces": forces, "told": self._told}

    @property
    def _told(self) -> np.ndarray:
        """1 for each grip that is told to hold, else 0, shape (grip_count,)."""
        return np.array([float(one) for one in self.wanted.values()])

    def may_keep(self, before: State, after: State) -> bool:
        """See `StepPart`: whether nothing changes hands."""
        holds = after.memory_of(self.name)["holds"]
        return all(np.array_equal(holds, one) for one in (self._told, before.memory_of(self.name)["holds"]))

    def report(self, state: State, newton: Newton) -> PartReport:
        """See `StepPart`."""
        return PartReport(tuple(self._missed))

    def reset(self) -> None:
        """See `StepPart`: nothing is held at rest."""
        self.wanted = dict.fromkeys(self.wanted, False)
        self._pending.clear()

    def restore(self, state: State) -> None:
        """See `StepPart`: grips are told what they do there."""
        told = state.memory_of(self.name)["told"] > 0.0
        self.wanted = dict(zip(self.wanted, told.tolist(), strict=True)) | self._pending
