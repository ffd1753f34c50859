"""What `explain` warns of in pneumatic robots: pressures near a burst, and threads too far apart."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from softrobot_twin.geometry.wall_thickness import ThinnestPart
from softrobot_twin.scene.body_entries import Helix
from softrobot_twin.simulation import Simulation, Status
from softrobot_twin.simulation.command import LONG, CommandSetpoints
from softrobot_twin.simulation.result import BURST

SHARES = (0.25, 0.5, 0.75, 1.0)
"""Of the greatest pressures, one after the other."""
MOST_STEPS = 8
"""Steps that may lead to balance at each."""
MOST_ALONE = 12
"""Of more cavities only all together are driven."""
WIDEST = 2.0
"""Threads that are further apart than so many thicknesses of the wall are warned of."""


def burst_warnings(simulation: Simulation) -> Iterator[str]:
    """Drive each cavity alone, and all together, up to their greatest pressures.

    Args:
        simulation: The simulation of the scene; at rest afterwards. In motion nothing is driven.

    Yields:
        A sentence for each that comes near its limit point, or finds no balance.
    """
    actuators, most = simulation.actuators, simulation.limits.effort_max
    driven = [index for index, kind in enumerate(actuators.kinds)
              if kind.section == "cavities" and kind.is_effort_driven and 0.0 < most[index] < np.inf]
    if simulation.model.is_dynamic or not driven:
        return
    alone = [[index] for index in driven] if 1 < len(driven) <= MOST_ALONE else []
    for chosen in (*alone, driven):
        end = np.zeros(actuators.count)
        end[chosen] = most[chosen]
        names = ", ".join(actuators.names[index] for index in chosen)
        for share in SHARES:
            told = _trouble_at(simulation, actuators.setpoints(share * end))
            if told:
                yield (f"{names}: at {1e-3 * share * most[chosen].max():.3g} kPa, {share:g} of the "
                       f"greatest pressure, {told}: lower `pressure`, add fibres or thicker walls, or "
                       "command the volume")  # fmt: skip
                break
        simulation.reset()


def _trouble_at(simulation: Simulation, setpoints: np.ndarray) -> str:
    """What is wrong at given pressures, after those before; empty where it is in balance."""
    for _ in range(MOST_STEPS):
        result = simulation.step(CommandSetpoints(setpoints, LONG))
        if result.status is Status.OK or result.status.is_failure:
            break
    near = [name.partition(".")[0] for name in result.report.active_limits if name.endswith(BURST)]
    if near:
        return (f"the walls of {', '.join(near)} yield more than five times as easily as at rest, as "
                "they do near the pressure at which they burst")  # fmt: skip
    if result.status in (Status.OK, Status.LINEARIZED):
        return ""
    return f"no balance is found ({', '.join((result.status.value, *result.report.active_limits))})"


def fibre_warnings(simulation: Simulation, thinnest: list[ThinnestPart]) -> Iterator[str]:
    """Compare how far wound threads are apart with the thinnest part of their body.

    Args:
        simulation: The simulation of the scene.
        thinnest: Thinnest part of each deformable body.

    Yields:
        A sentence for each entry whose threads let the wall between them bulge.
    """
    walls = {body.name: part.thickness
             for body, part in zip(simulation.model.bodies, thinnest, strict=True)}
    for fibre in simulation.scene.fibres:
        wall = walls[fibre.on] if fibre.on else next(iter(walls.values()))
        if fibre.helix is None or thread_distance(fibre.helix) <= WIDEST * wall:
            continue
        yield (f"fibres {fibre.name}: {1e3 * thread_distance(fibre.helix):.3g} mm between neighbouring "
               f"threads, in a wall of {1e3 * wall:.3g} mm: it bulges between them; more than {WIDEST:g} "
               "thicknesses are too far for walls that threads shall hold")  # fmt: skip


def thread_distance(helix: Helix) -> float:
    """Mean distance of neighbouring threads, across them [m].

    Args:
        helix: The threads; those of both hands count.
    """
    turn = 2.0 * np.pi * helix.radius
    hands = 2 if helix.handedness == "both" else 1
    return float(helix.pitch / (hands * helix.count) * turn / np.hypot(turn, helix.pitch))
