"""Time of a step over the number of contacts, on a block that rubs on 10 to 200 points.

`python tools/contact_growth.py [STEPS] [FOLDER]` prints the table, and writes contacts.csv and
contacts.png into a folder; docs/computing_time.md has figures.
"""

from __future__ import annotations

import csv
import math
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from time import perf_counter, thread_time
from typing import NamedTuple

import meshio
import numpy as np
from bench_robots import growth_exponent
from rich.table import Table
from specimens import column_mesh

from softrobot_twin.harness.figure import figure_file
from softrobot_twin.harness.machine_facts import NUMERICAL_LIBRARIES, describe_machine
from softrobot_twin.harness.output_file import OutputError, make_folder
from softrobot_twin.harness.terminal import console, table
from softrobot_twin.harness.timing import Spread, spread
from softrobot_twin.scene import Scene, scene_from_mapping
from softrobot_twin.simulation import Hold, Simulation
from softrobot_twin.study.accuracy_study import write_mesh
from softrobot_twin.study.bench_measurement import (
    INTERRUPTION,
    WHOLE_STEP,
    without_garbage_collection,
)

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
        contact_count: Contacts with force, median.
        row_count: Rows of H, median.
        dof_count: Unknowns.
        sweeps: Sweeps of the contact solver in a step, median.
        converged: Share of the steps that ended as ok or linearized.
        stages: Time of each stage and of the whole step [s], over the steps that no other process
            interrupted; over all steps where every step was interrupted.
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
    """Times steps of a rigid slab that lies on 225 points: all rows act on six unknowns.

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
    """A block that hangs from a guided press, above a smaller fixed block.

    Args:
        file: The block's mesh.
        side: Nodes along the side of the fixed square below it.
    """
    pitch = _SIZE[0] / _CELLS[0]
    # The block has a node in its middle, so a square with an even number of nodes is off centre.
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
    """Times the steps of a scene; `before` is called before each step with its number."""
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
    """Commands the press to move down and then on a circle."""
    angle = 2.0 * math.pi * step / _STEPS_A_ROUND
    depth = _PRESSED * min(1.0, 4.0 * step / _STEPS_A_ROUND)
    place = [_RUBBED * (math.cos(angle) - 1.0), _RUBBED * math.sin(angle), -depth]
    simulation.model.guides.aim("press", place)


COLUMNS = ("contacts", "rows", "dof", "sweeps", "steps_ok", "interrupted_share", "stage",
           "median_ms", "p99_ms", "max_ms", "growth_exponent")
# Stages whose time depends on the contacts.
_CONTACT_STAGES = ("detect", "condense", "optimise", WHOLE_STEP)
_COLOURS = {"detect": "#5f5aa2", "condense": "#3a8f5c", "optimise": "#d95f02",
            WHOLE_STEP: "#1b6ca8"}


def print_growth(steps: int, output: Path | None = None) -> None:
    """Times steps over numbers of contacts and prints the results.

    Args:
        steps: Steps to time for each number.
        output: Folder for ``contacts.csv`` and ``contacts.png``, or None.

    Raises:
        SoftRobotTwinError: An output cannot be written.
    """
    if output is not None:
        make_folder(output)
    with tempfile.TemporaryDirectory() as folder:
        found = measure_contacts(Path(folder), steps)
        slab = measure_slab(Path(folder), steps)
    conditions = describe_machine(NUMERICAL_LIBRARIES)
    shown = console()
    shown.print(f"A block of {found[0].dof_count} dof rubs on fixed blocks of different widths. W "
                "of all rows is computed\nin 'condense', the contacts are solved in 'optimise'. "
                "Steps that other processes\ninterrupted are left out.")
    shown.print(conditions + "\n")
    shown.print(contact_table(found))
    shown.print(describe_slab(slab))
    if output is not None:
        write_contacts(output / "contacts.csv", found)
        draw_contacts(output / "contacts.png", found, conditions)
        shown.print(f"\nwritten: {output / 'contacts.csv'}, {output / 'contacts.png'}")


def describe_slab(slab: ContactMeasurement) -> str:
    """Text with the time of a step of the rigid slab."""
    times = slab.stages[WHOLE_STEP]
    return (f"A rigid slab at rest on {slab.contact_count:.0f} points: a step takes "
            f"{1e3 * times.median:.3g} ms,\np99 {1e3 * times.p99:.3g}; solving its contacts "
            f"{1e3 * slab.stages['optimise'].median:.3g}; {100.0 * slab.converged:.0f} % of the "
            "steps\nended as ok or linearized.")


def exponent(found: Sequence[ContactMeasurement], stage: str) -> float:
    """Growth exponent p of a stage's median, time ~ rowsᵖ."""
    return growth_exponent([one.row_count for one in found],
                           [one.stages[stage].median for one in found])


def contact_table(found: Sequence[ContactMeasurement]) -> Table:
    """Medians of each stage over numbers of contacts."""
    made = table("Time of a step in ms: median / p99", "contacts", "rows", "sweeps", "ok",
                 "interrupted",
                 *found[0].stages)
    for one in found:
        made.add_row(
            f"{one.contact_count:.0f}", f"{one.row_count:.0f}", f"{one.sweeps:.0f}",
            f"{100.0 * one.converged:.0f} %", f"{100.0 * one.interrupted_share:.0f} %",
            *(f"{1e3 * times.median:.3g} / {1e3 * times.p99:.3g}"
              for times in one.stages.values()))
    made.add_row("growth", "rows^p", "", "", "",
                 *(f"p = {exponent(found, stage):.2f}" for stage in found[0].stages))
    return made


def write_contacts(path: Path, found: Sequence[ContactMeasurement]) -> None:
    """Writes one row for each stage of each number of contacts.

    Raises:
        OutputError: The file cannot be written.
    """
    try:
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(COLUMNS)
            for one in found:
                for stage, times in one.stages.items():
                    numbers = (one.contact_count, one.row_count, one.dof_count, one.sweeps,
                               one.converged, one.interrupted_share)
                    spread = (1e3 * times.median, 1e3 * times.p99, 1e3 * times.maximum,
                              exponent(found, stage))
                    writer.writerow([*(f"{n:.6g}" for n in numbers), stage,
                                     *(f"{n:.6g}" if np.isfinite(n) else "" for n in spread)])
    except OSError as error:
        raise OutputError(path, error.strerror or str(error)) from error


def draw_contacts(path: Path, found: Sequence[ContactMeasurement], conditions: str) -> None:
    """Draws the time of the stages that depend on the contacts over their number.

    Raises:
        MissingExtraError: matplotlib is not installed.
        OutputError: The picture cannot be written.
    """
    title = f"Time of contacts, on {found[0].dof_count} dof"
    with figure_file(path, (8.0, 6.0), title, conditions) as figure:
        axes = figure.subplots()
        counts = [one.contact_count for one in found]
        for stage in _CONTACT_STAGES:
            thick = stage == WHOLE_STEP
            axes.plot(counts, [1e3 * one.stages[stage].median for one in found], "o-",
                      color=_COLOURS[stage], linewidth=2.2 if thick else 1.3,
                      markersize=5 if thick else 4,
                      label=f"{stage}, ~ rows^{exponent(found, stage):.2f}")
        rest = [1e3 * sum(times.median for stage, times in one.stages.items()
                          if stage not in _CONTACT_STAGES) for one in found]
        axes.plot(counts, rest, "o-", color="#9a9a9a", linewidth=1.3, markersize=4,
                  label="all other stages")
        axes.set(xscale="log", yscale="log", xlabel="contacts with force",
                 ylabel="median time [ms]", title="Time of a step, friction included")
        axes.legend(loc="upper left")


if __name__ == "__main__":
    print_growth(int((sys.argv[1:] or ["1000"])[0]), *map(Path, sys.argv[2:3]))
