"""``python -m softrobot_twin bench --contacts``: what each further contact costs."""

from __future__ import annotations

import csv
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich.table import Table

from softrobot_twin.study.bench.bench_command import LIBRARIES, make_folder
from softrobot_twin.study.bench.contact_growth import (
    ContactMeasurement,
    measure_contacts,
    measure_slab,
)
from softrobot_twin.study.bench.growth import growth_exponent
from softrobot_twin.study.bench.size_measurement import WHOLE_STEP
from softrobot_twin.study.reports.machine_facts import machine_words
from softrobot_twin.study.reports.output_error import OutputError
from softrobot_twin.study.reports.sheet import sheet
from softrobot_twin.study.reports.terminal import console, table

COLUMNS = ("contacts", "rows", "dof", "sweeps", "steps_ok", "interrupted_share", "stage",
           "median_ms", "p99_ms", "max_ms", "growth_exponent")
# Stages that see the contacts; the others have the mesh's size only.
_SEEING = ("detect", "condense", "optimise", WHOLE_STEP)
_COLOURS = {"detect": "#5f5aa2", "condense": "#3a8f5c", "optimise": "#d95f02",
            WHOLE_STEP: "#1b6ca8"}


def bench_contacts(steps: int, output: Path | None = None) -> int:
    """Times steps over numbers of contacts and prints what was found.

    Args:
        steps: Steps to time for each number.
        output: Folder for ``contacts.csv`` and ``contacts.png``, or None.

    Returns:
        Exit code, always 0.

    Raises:
        SoftRobotTwinError: An output cannot be written.
    """
    if output is not None:
        make_folder(output)
    with tempfile.TemporaryDirectory() as folder:
        found = measure_contacts(Path(folder), steps)
        slab = measure_slab(Path(folder), steps)
    conditions = machine_words(LIBRARIES)
    shown = console()
    shown.print(f"A block of {found[0].dof_count} dof rubs on stands of different widths. W of "
                "all rows is made in\n'condense', the contacts are solved in 'optimise'. Steps "
                "that other processes interrupted\nare left out.")
    shown.print(conditions + "\n")
    shown.print(contact_table(found))
    shown.print(slab_words(slab))
    if output is not None:
        write_contacts(output / "contacts.csv", found)
        draw_contacts(output / "contacts.png", found, conditions)
        shown.print(f"\nwritten: {output / 'contacts.csv'}, {output / 'contacts.png'}")
    return 0


def slab_words(slab: ContactMeasurement) -> str:
    """What a step of the rigid slab takes."""
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
    """Draws the stages that see the contacts over their number.

    Raises:
        MissingExtraError: matplotlib is not installed.
        OutputError: The picture cannot be written.
    """
    title = f"What contacts cost, on {found[0].dof_count} dof"
    with sheet(path, (8.0, 6.0), title, conditions) as figure:
        axes = figure.subplots()
        counts = [one.contact_count for one in found]
        for stage in _SEEING:
            thick = stage == WHOLE_STEP
            axes.plot(counts, [1e3 * one.stages[stage].median for one in found], "o-",
                      color=_COLOURS[stage], linewidth=2.2 if thick else 1.3,
                      markersize=5 if thick else 4,
                      label=f"{stage}, ~ rows^{exponent(found, stage):.2f}")
        rest = [1e3 * sum(times.median for stage, times in one.stages.items()
                          if stage not in _SEEING) for one in found]
        axes.plot(counts, rest, "o-", color="#9a9a9a", linewidth=1.3, markersize=4,
                  label="all other stages")
        axes.set(xscale="log", yscale="log", xlabel="contacts that carry force",
                 ylabel="median time [ms]", title="Time of a step, friction included")
        axes.legend(loc="upper left")
