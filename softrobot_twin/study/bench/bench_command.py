"""``python -m softrobot_twin bench``: what a step costs over sizes, and what solvers cost."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterable
from pathlib import Path

from softrobot_twin.study.bench.bench_cases import BenchCase, given_cases, standard_cases
from softrobot_twin.study.bench.bench_file import write_bench
from softrobot_twin.study.bench.bench_tables import (
    growth_table,
    paper_verdict,
    size_table,
    stage_table,
    verdict,
)
from softrobot_twin.study.bench.size_measurement import SizeMeasurement, measure
from softrobot_twin.study.reports.machine_facts import machine_words
from softrobot_twin.study.reports.output_error import OutputError
from softrobot_twin.study.reports.terminal import console

LIBRARIES = ("numpy", "scipy", "numba", "osqp", "daqp")


def bench(scenes: list[Path], steps: int, output: Path | None = None,
          commands: Path | None = None) -> int:
    """Times the steps of scenes, or of the standard sizes, and prints what was found.

    Args:
        scenes: Scene files; none for the standard sizes.
        steps: Steps to time for each size.
        output: Folder for ``bench.csv`` and ``bench.png``, or None.
        commands: Commands file whose longest hold is timed, in place of a circle, or None.

    Returns:
        Exit code, always 0: a bar that is not met is told, and is no failure of the command.

    Raises:
        SoftRobotTwinError: A scene cannot be used or an output not be written.
    """
    if output is not None:
        make_folder(output)
    with tempfile.TemporaryDirectory() as folder:
        cases = given_cases(scenes, commands) if scenes else standard_cases(Path(folder))
        sizes = _measure_all(cases, steps)
    conditions = machine_words(LIBRARIES)
    shown = console()
    shown.print("One thread, garbage collection off, steps along a circle; where things touch, in\n"
                "the longest hold of a commands file, or leaning. Steps by the clock;\n"
                "SuperLU and dgemm by processor time, which other processes do not stretch.")
    shown.print(conditions + "\n")
    for made in (stage_table(sizes), size_table(sizes), growth_table(sizes)):
        if made is not None:
            shown.print(made)
            shown.print()
    for size in sizes:
        if size.case.has_bar:
            for words in verdict(size):
                shown.print(words)
        if size.case.paper is not None:
            shown.print(paper_verdict(size))
    if output is not None:
        _write(output, sizes, conditions)
        shown.print(f"written: {output / 'bench.csv'}, {output / 'bench.png'}")
    return 0


def make_folder(folder: Path) -> None:
    """Makes a folder for results.

    Raises:
        OutputError: It cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(folder, error.strerror or str(error)) from error


def _measure_all(cases: Iterable[BenchCase], steps: int) -> list[SizeMeasurement]:
    sizes = []
    for case in cases:
        # A line and no bar: a bar's thread would run beside the steps that are timed.
        if sys.stderr.isatty():
            print(f"{case.name}: {steps} steps …", file=sys.stderr)
        sizes.append(measure(case, steps))
    return sizes


def _write(output: Path, sizes: list[SizeMeasurement], conditions: str) -> None:
    from softrobot_twin.study.bench.bench_picture import draw_bench

    write_bench(output / "bench.csv", sizes)
    draw_bench(output / "bench.png", sizes, conditions)
