"""How a step's time grows with the contacts alone: one soft block, pressed on blocks of any width.

The mesh, and with it the matrix, is the same for all; only how many of its nodes find something
below them differs. The block is rubbed in a circle, so that contacts stick and slide and forces are
new in every step.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from time import perf_counter, thread_time
from typing import NamedTuple

import meshio
import numpy as np

from softrobot_twin.scene import Scene, scene_from_mapping
from softrobot_twin.simulation import Hold, Simulation
from softrobot_twin.study.bench.size_measurement import (
    INTERRUPTION,
    WHOLE_STEP,
    without_garbage_collection,
)
from softrobot_twin.study.bench.structured_column import column_mesh, write_mesh
from softrobot_twin.study.offline.run_summary import Spread, spread

SIDES = (2, 3, 4, 6, 8, 10, 12, 14)
"""Nodes along the side of the square that is touched."""
_SIZE, _CELLS = (0.060, 0.060, 0.020), (14, 14, 3)
_PRESSED, _RUBBED = 0.0005, 0.001  # m: depth, and radius of the circle
_TIME_STEP, _STEPS_A_ROUND = 0.01, 200
_FRICTION = 0.5
_SLAB_SIZE, _SLAB_CELLS = (0.300, 0.300, 0.020), (14, 14, 1)


class ContactMeasurement(NamedTuple):
    """One number of contacts.

    Attributes:
        contact_count: Contacts that carry force, median.
        row_count: Rows of H, median.
        dof_count: Unknowns.
        sweeps: Sweeps of the contact solver in a step, median.
        converged: Share of the steps that ended as ok or linearized.
        stages: Time of each stage and of the whole step [s], of steps that no other process
            interrupted; where there are none, of all.
        interrupted_share: Share of the steps that were interrupted.
    """

    contact_count: float
    row_count: float
    dof_count: int
    sweeps: float
    converged: float
    stages: dict[str, Spread]
    interrupted_share: float


def measure_contacts(folder: Path, steps: int, sides=SIDES) -> list[ContactMeasurement]:
    """Times steps for each number of contacts, the fewest first.

    Args:
        folder: Where the block's mesh is written.
        steps: Steps to time for each.
        sides: Nodes along the side of the square that is touched.
    """
    file = folder / "block.vtk"
    write_mesh(file, column_mesh(_SIZE, _CELLS))
    return [_measure(rubbing_scene(file, side), steps, _press) for side in sides]


def measure_slab(folder: Path, steps: int) -> ContactMeasurement:
    """Times steps of a rigid slab that lies on 225 points: six unknowns carry all their rows.

    Args:
        folder: Where the slab's surface is written.
        steps: Steps to time.
    """
    return _measure(slab_scene(folder / "slab.stl"), steps)


def slab_scene(file: Path) -> Scene:
    """A rigid slab of 15 by 15 points a side, at rest on a plane.

    Args:
        file: Where its surface is written.
    """
    mesh = column_mesh(_SLAB_SIZE, _SLAB_CELLS)
    half = 0.5 * _SLAB_SIZE[2]
    points = mesh.node_positions + [0.0, 0.0, half]
    meshio.write(file, meshio.Mesh(points, [("triangle", mesh.surface_triangles)]))
    return scene_from_mapping({
        "name": "slab", "integration": "dynamic",
        "rigid_bodies": [{"name": "slab", "mass": 0.5, "surface": {"file": str(file)},
                          "position": [0.0, 0.0, half]}],
        "obstacles": [{"name": "floor", "plane": {}}],
        "contact": {"friction": _FRICTION, "between": [{"pair": ["slab", "floor"]}]},
        "solver": {"newton_iterations": 1, "residual_tolerance": 1.0e-4},
    }, file)


def rubbing_scene(file: Path, side: int) -> Scene:
    """A block hanging from a guided press, over a smaller one that stands.

    Args:
        file: The block's mesh.
        side: Nodes along the side of the square that stands below it.
    """
    pitch = _SIZE[0] / _CELLS[0]
    # A node lies in the block's middle: a square of an even number of nodes stands beside it.
    offset = 0.5 * pitch * (side % 2 == 0)
    width = pitch * (side - 0.4)
    half = 0.6 * _SIZE[0]
    return scene_from_mapping({
        "name": "block_on_block",
        "gravity": [0.0, 0.0, 0.0],
        "bodies": [{
            "name": "block", "mesh": {"file": str(file)},
            "element": "linear",
            "material": {"law": "corotational", "young_modulus": 2.0e5, "poisson_ratio": 0.3,
                         "density": 1000.0},
            "attached": [{"to": "press", "box": {
                "minimum": [-half, -half, -1e-6], "maximum": [half, half, 1e-6]}}]}],
        "rigid_bodies": [{"name": "press", "motion": "guided",
                          "box": {"size": [_SIZE[0], _SIZE[1], 0.004],
                                  "centre": [0.0, 0.0, 0.002]}}],
        "obstacles": [{"name": "stand", "position": [offset, offset, -_SIZE[2] - 0.005],
                       "box": {"size": [width, width, 0.010]}}],
        "contact": {"alarm_distance": 0.001, "friction": _FRICTION,
                    "between": [{"pair": ["block", "stand"]}]},
    }, file)


def _measure(
    scene: Scene, steps: int, before: Callable[[Simulation, int], None] | None = None
) -> ContactMeasurement:
    """Times the steps of a scene; `before` is called ahead of each, with its number."""
    simulation = Simulation(scene)
    simulation.warm_up()
    contacts, rows, sweeps, times, reports, waits, good = [], [], [], [], [], [], 0
    command = Hold(_TIME_STEP)
    with without_garbage_collection():
        for step in range(_STEPS_A_ROUND + steps):
            if before is not None:
                before(simulation, step)
            worked, start = thread_time(), perf_counter()
            result = simulation.step(command)
            time = perf_counter() - start
            if step < _STEPS_A_ROUND:  # pressed down and rubbed once around
                continue
            times.append(time)
            waits.append(time - (thread_time() - worked))
            reports.append(result.report.stage_times)
            contacts.append(result.report.contact_count)
            rows.append(simulation.model.rows.row_count)
            sweeps.append(result.report.contact_sweeps)
            good += result.status.is_success
    interrupted = np.array(waits) > INTERRUPTION
    kept = np.arange(steps) if interrupted.all() else np.flatnonzero(~interrupted)
    stages = {name: spread([reports[step][name] for step in kept]) for name in simulation.stages}
    return ContactMeasurement(
        float(np.median(contacts)), float(np.median(rows)), simulation.dof_count,
        float(np.median(sweeps)), good / steps,
        {**stages, WHOLE_STEP: spread(np.array(times)[kept])}, float(interrupted.mean()))


def _press(simulation: Simulation, step: int) -> None:
    """Sends the press down, and around."""
    angle = 2.0 * math.pi * step / _STEPS_A_ROUND
    depth = _PRESSED * min(1.0, 4.0 * step / _STEPS_A_ROUND)
    place = [_RUBBED * (math.cos(angle) - 1.0), _RUBBED * math.sin(angle), -depth]
    simulation.model.guides.aim("press", place)
