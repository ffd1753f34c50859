"""Whether a body that its cables hold is stable at given tensions too: what locking may hide.

A coarse mesh of linear tetrahedra is far too stiff in bending, and stays straight where the body
buckles. Elements that do not lock show it: wound in far enough, the body is stable as long as its
cables hold their lengths, and collapses at the same tensions.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from softrobot_twin.simulation.command import LONG, CommandSetpoints
from softrobot_twin.simulation.step.step_part import Steppable

# All cables are wound in by these shares of what they may be, one after the other, and the body comes
# near rest at each: before that its stiffness is another.
SHARES, STEPS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6), 3
# The check takes the time of some steps: of larger scenes nobody waits for it.
MOST_FREE_NODES = 2000


def stability_notes(simulation: Steppable) -> Iterator[str]:
    """Tell of a body that buckles at given tensions of its cables.

    Args:
        simulation: The simulation; at rest afterwards.

    Yields:
        A sentence, where there is something to tell.
    """
    model = simulation.model
    actuators, entries = model.actuators, model.scene.deformables
    travel = actuators.limits.displacement_max
    if (
        model.is_dynamic or not entries or any(entry.element == "linear" for entry in entries)
        or model.nodes.free_node_count > MOST_FREE_NODES or not actuators.row_count
        or not actuators.one_sided.all() or actuators.is_effort_driven.any()
        or not np.isfinite(travel).all() or not actuators.conserves or model.scene.motors
    ):  # fmt: skip
        return
    names = " and ".join(body.name for body in model.bodies)
    for share in SHARES:
        for _ in range(STEPS):
            result = simulation.step(CommandSetpoints(actuators.setpoints(share * travel), LONG))
        if result.status.is_failure or result.report.projected_tangent:
            break
        if simulation.newton.is_augmented:
            yield (
                f"{names}: where all cables are wound in by {100.0 * share:g} % of what they may "
                f"be, it is stable only because they hold their lengths; at the same tensions, "
                f"{result.efforts.max():.3g} N, it buckles: command lengths or targets there"
            )
            break
    simulation.reset()
