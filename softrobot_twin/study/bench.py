"""``python -m softrobot_twin bench``: times of a step, as tables and CSV.

`tools/bench_robots.py` measures the package's robots and compares them with the paper.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich.table import Table

from softrobot_twin.harness.machine_facts import NUMERICAL_LIBRARIES, describe_machine
from softrobot_twin.harness.output_file import make_folder
from softrobot_twin.harness.study_rows import write_rows
from softrobot_twin.harness.terminal import console, print_apart, report_activity, table
from softrobot_twin.harness.timing import Spread
from softrobot_twin.study.bench_measurement import (
    OUTSIDE,
    WHOLE_STEP,
    BenchCase,
    SizeMeasurement,
    default_scene_path,
    given_cases,
    measure,
)


def bench_rows(sizes: Sequence[SizeMeasurement]) -> list[dict[str, object]]:
    """The rows of bench.csv, a row for each stage of each size; what is not known is None or NaN.

    Args:
        sizes: What was measured.
    """
    return [{
        "scene": size.case.name, "nodes": size.node_count,
        "tets": size.tet_count, "dof": size.dof_count, "modes": size.mode_count or None,
        "points": size.point_count or None, "rows": size.row_count,
        "contacts": size.contact_count, "factorization": size.factorization,
        "threads": size.thread_count,
        "steps": size.step_count, "stage": stage, "median_ms": 1e3 * times.median,
        "p99_ms": 1e3 * times.p99, "max_ms": 1e3 * times.maximum,
        "interrupted_share": size.interrupted_share, "resident_bytes": size.resident,
    } for size in sizes for stage, times in size.stages.items()]  # fmt: skip


def _stage_table(sizes: Sequence[SizeMeasurement]) -> Table:
    """Median, 99th percentile and maximum of each stage of each size."""
    return table("Time of a step in ms: median / p99 / max", "stage", *map(_title, sizes),
                 rows=([stage, *(_times(size.stages.get(stage)) for size in sizes)]
                       for stage in _stage_names(sizes)))


def _title(size: SizeMeasurement) -> str:
    unknowns = f"{size.mode_count} modes" if size.is_reduced else f"{size.dof_count} dof"
    return f"{size.case.name}\n{unknowns}"


def _size_table(sizes: Sequence[SizeMeasurement]) -> Table:
    """Table of the other measurements of each size."""
    cells = (
        ("nodes, tets", lambda size: f"{size.node_count}, {size.tet_count}"),
        ("modes, sampled points",
         lambda size: f"{size.mode_count}, {size.point_count}" if size.is_reduced else "-"),
        ("factorization", lambda size: size.factorization),
        ("threads that factorize", lambda size: str(size.thread_count)),
        ("rows of H, contacts with force",
         lambda size: f"{size.row_count:.0f}, {size.contact_count:.0f}"),
        ("steps timed", lambda size: str(size.step_count)),
        ("steps interrupted by other programs",
         lambda size: f"{100.0 * size.interrupted_share:.1f} %"),
        ("p99 / median", lambda size: f"{size.tail:.2f}"),
        ("memory of the process, MB", lambda size: _count(size.resident)),
        ("status of the steps", lambda size: _shares(size.statuses)),
        ("QP solved by", lambda size: _shares(size.qp_solvers) if any(size.qp_solvers) else "-"),
    )
    return table("Each size", "what", *map(_title, sizes),
                 rows=([what, *map(words, sizes)] for what, words in cells))


def _stage_names(sizes: Sequence[SizeMeasurement]) -> list[str]:
    """All stages in their order, then the time outside them, then the whole step."""
    inner = dict.fromkeys(name for size in sizes for name in size.stages)
    return [name for name in inner if name not in (OUTSIDE, WHOLE_STEP)] + [OUTSIDE, WHOLE_STEP]


def _times(times: Spread | None) -> str:
    return "-" if times is None else " / ".join(map(_ms, times))


def _ms(seconds: float) -> str:
    """Milliseconds with three or four significant digits."""
    value = 1e3 * seconds
    if not np.isfinite(value):
        return "-"
    return f"{value:.3f}" if value < 10.0 else f"{value:.1f}"


def _count(number: float | None) -> str:
    return "-" if number is None else f"{1e-6 * number:.2f}"


def _shares(counted: Counter[str]) -> str:
    total = sum(counted.values())
    return ", ".join(f"{name or 'none'} {100.0 * count / total:.0f} %"
                     for name, count in counted.most_common())


def bench(scenes: list[Path], steps: int, output: Path | None = None,
          commands: Path | None = None, threads: int | None = None) -> int:
    """Times the steps of scenes, and prints the results.

    Args:
        scenes: Scene files; none for the Diamond.
        steps: Steps to time for each.
        output: Folder for ``bench.csv``, or None.
        commands: Commands file whose longest constant part is timed, or None for a circle.
        threads: Most threads of a step, or None for those of the scenes.

    Returns:
        Exit code, always 0.

    Raises:
        SoftRobotTwinError: A scene cannot be used or an output not be written.
    """
    if output is not None:
        make_folder(output)
    cases = given_cases(scenes or [default_scene_path()], commands)
    if threads is not None:
        cases = [case._replace(scene=case.scene.changed(solver={"threads": threads}))
                 for case in cases]
    sizes = measure_all(cases, steps)
    shown = console()
    shown.print("Garbage collection off. Effectors move along a circle; robots without\n"
                "effectors move their actuators over their limits; with --commands robots repeat\n"
                "the longest hold of a commands file.\n"
                "Steps are measured in elapsed time.")
    shown.print(describe_machine(NUMERICAL_LIBRARIES) + "\n")
    print_sizes(sizes)
    if output is not None:
        write_rows(output / "bench.csv", bench_rows(sizes))
        shown.print(f"written: {output / 'bench.csv'}")
    return 0


def measure_all(cases: Sequence[BenchCase], steps: int) -> list[SizeMeasurement]:
    """Measures all cases, one after another.

    Args:
        cases: The cases.
        steps: Steps to time for each.

    Raises:
        SoftRobotTwinError: See `measure`.
    """
    sizes = []
    for number, case in enumerate(cases, start=1):
        # A line in place of a progress bar, whose thread would disturb the timing.
        report_activity(f"{case.name}, {number} of {len(cases)}: {steps} steps")
        sizes.append(measure(case, steps))
    return sizes


def print_sizes(sizes: Sequence[SizeMeasurement]) -> None:
    """Prints the times of the stages, and the other measurements.

    Args:
        sizes: What was measured.
    """
    print_apart(_stage_table(sizes), _size_table(sizes))
