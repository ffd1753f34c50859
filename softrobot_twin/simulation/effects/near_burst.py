"""Whether a cavity is near the pressure at which its walls have no balance any more.

At its limit point a cavity grows without more pressure: C = dV/dp is infinite there. So a step in
which C is many times that at rest tells of it long before steps do not converge.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from softrobot_twin.simulation.building.limits import efforts_at_scale
from softrobot_twin.simulation.building.model import Model
from softrobot_twin.simulation.result import BURST
from softrobot_twin.simulation.state import State
from softrobot_twin.simulation.step.newton import Newton
from softrobot_twin.simulation.step.step_part import PartReport, StepPart

MOST_COMPLIANT = 5.0
"""A cavity is near its limit point where C is this many times that at rest. A thick sphere of rubber
has it at three quarters of its greatest pressure; the robots of the package have at most 2.3."""


class NearBurst(StepPart):
    """Tells of cavities that are near their limit point, at the pressures of a step."""

    name = "near_burst"

    def __init__(self, names: tuple[str, ...], rows: np.ndarray, compliances: np.ndarray):
        """Take the cavities.

        Args:
            names: Of cavities whose pressure is commanded.
            rows: Their rows among those of the actuators, shape (count,).
            compliances: C of each at rest [m³/Pa], same shape.
        """
        self._names, self._rows, self._least = names, rows, MOST_COMPLIANT * compliances

    def report(self, state: State, newton: Newton) -> PartReport:
        """See `StepPart`."""
        is_near = newton.tangent.actuator_compliances[self._rows] > self._least
        return PartReport(tuple(f"{name}.{BURST}" for name, near in zip(self._names, is_near) if near))


def near_burst_of(model: Model) -> Iterator[StepPart]:
    """The part of a scene in statics with cavities whose pressure is commanded.

    Args:
        model: The model of a simulation.
    """
    actuators = model.actuators
    chosen = np.flatnonzero([
        kind.section == "cavities" and kind.is_effort_driven for kind in actuators.kinds
    ])  # fmt: skip
    group = next((group for group in actuators.groups if group.kind.section == "cavities"), None)
    efforts = efforts_at_scale(model, group.term) if len(chosen) else None
    if efforts is not None:
        first = actuators.of_section("cavities").start
        compliances = (group.term.scales / efforts)[chosen - first]
        yield NearBurst(tuple(actuators.names[row] for row in chosen), chosen, compliances)
