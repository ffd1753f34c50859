"""``python -m softrobot_twin bench``: times of a step over mesh sizes, as tables, CSV and
picture.
"""

from __future__ import annotations

import csv
import time
from collections import Counter
from collections.abc import Sequence
from itertools import cycle
from pathlib import Path

import numpy as np
from rich.table import Table

from softrobot_twin.simulation.runs.input_tables import TableFileError
from softrobot_twin.study.bench_measurement import (
    OUTSIDE,
    SUPERLU,
    WHOLE_STEP,
    BenchCase,
    SizeMeasurement,
    full_size,
    given_cases,
    growth_exponent,
    measure,
    standard_cases,
)
from softrobot_twin.study.figure import figure_file
from softrobot_twin.study.machine_facts import NUMERICAL_LIBRARIES, describe_machine
from softrobot_twin.study.output_file import cell, csv_output, make_folder
from softrobot_twin.study.terminal import (
    announce,
    by_key,
    console,
    print_apart,
    report_activity,
    table,
)
from softrobot_twin.study.timing import Spread


def _write_bench(path: Path, sizes: Sequence[SizeMeasurement]) -> None:
    """Writes all sizes as CSV; unknown values are left empty.

    Raises:
        OutputError: The file cannot be written.
    """
    families = _families_of(sizes)
    rows = [_row(size, stage, exponent(families[size.case.family], stage), full_size(size, sizes))
            for size in sizes for stage in size.stages]
    with csv_output(path, list(rows[0])) as write:
        for row in rows:
            write(map(cell, row.values()))


def _row(
    size: SizeMeasurement, stage: str, growth: float, full: SizeMeasurement | None
) -> dict[str, object]:  # fmt: skip
    """The cells of a stage by their columns."""
    times, flops = size.stages[stage], size.flops
    whole = full and full.stages[WHOLE_STEP].median
    return {
        "scene": size.case.name, "family": size.case.family, "nodes": size.node_count,
        "tets": size.tet_count, "dof": size.dof_count, "modes": size.mode_count or None,
        "points": size.point_count or None, "rows": size.row_count,
        "contacts": size.contact_count, "factorization": size.factorization,
        "threads": size.thread_count,
        "steps": size.step_count, "stage": stage, "median_ms": 1e3 * times.median,
        "p99_ms": 1e3 * times.p99, "max_ms": 1e3 * times.maximum,
        "ratio_to_superlu": times.median / size.superlu.median, "growth_exponent": growth,
        "superlu_ms": 1e3 * size.superlu.median, "superlu_samples": size.superlu_count,
        "superlu_page_faults": size.superlu_page_faults,
        "interrupted_share": size.interrupted_share, "factor_flop": flops and flops.factor,
        "solves_flop": flops and flops.solves, "dgemm_flop_per_s": size.dense_speed,
        "share_of_dgemm_speed": size.share_of_dense_speed, "factor_bytes": size.factor_bytes,
        "resident_bytes": size.resident, "full_ms": whole and 1e3 * whole,
        "ratio_to_full": whole and times.median / whole, "python_calls": size.calls,
        "kernel_share": size.kernel_share, "beside_step_ms": 1e3 * size.beside,
    }  # fmt: skip


REQUIRED_RATIO = 0.16
"""Longest allowed step on the default Diamond, in SuperLU factorizations."""
PAPER_FACTOR = 4.0
"""Least allowed ratio of the paper's time of a step to ours."""
REQUIRED_TAIL = 1.5
"""Upper bound for the 99th percentile of a step over its median."""
REQUIRED_REDUCED_TAIL = 1.3
"""The same for a reduced model, whose bar counts the largest allowed value."""
# A larger share of interrupted steps affects the 99th percentile.
_QUIET_SHARE = 0.005


def stage_table(sizes: Sequence[SizeMeasurement]) -> Table:
    """Median, 99th percentile and maximum of each stage of each size.

    Args:
        sizes: What was measured.
    """
    return table("Time of a step in ms: median / p99 / max", "stage", *map(_title, sizes),
                 rows=([stage, *(_times(size.times.get(stage)) for size in sizes)]
                       for stage in (*_stage_names(sizes), SUPERLU)))


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
        ("calls of Python in a step", lambda size: f"{size.calls:.0f}"),
        ("share of kernels in a step", lambda size: f"{100.0 * size.kernel_share:.0f} %"),
        ("tick beside the step, ms", lambda size: _number(1e3 * size.beside, "{:.3f}")),
        ("rows of H, contacts with force",
         lambda size: f"{size.row_count:.0f}, {size.contact_count:.0f}"),
        ("paper's step / ours", lambda size: _paper_ratio(size)),
        ("steps timed, SuperLU timed", lambda size: f"{size.step_count}, {size.superlu_count}"),
        ("page faults in one SuperLU", lambda size: _number(size.superlu_page_faults, "{:.0f}")),
        ("whole step / one SuperLU", lambda size: _number(size.ratio, "{:.3f}")),
        ("full model's step / this one", lambda size: _full_ratio(size, full_size(size, sizes))),
        ("steps interrupted by other programs",
         lambda size: f"{100.0 * size.interrupted_share:.1f} %"),
        ("p99 / median", lambda size: f"{size.tail:.2f}"),
        ("operations, factor, Mflop", lambda size: _count(size.flops and size.flops.factor)),
        ("operations, solves, Mflop", lambda size: _count(size.flops and size.flops.solves)),
        ("dgemm in this run, Gflop/s", lambda size: f"{1e-9 * size.dense_speed:.1f}"),
        ("factor and solves at dgemm speed, ms", lambda size: _ms(size.limit)),
        ("share of dgemm speed reached", lambda size: _number(size.share_of_dense_speed, "{:.2f}")),
        ("factor's buffers, MB", lambda size: _count(size.factor_bytes)),
        ("memory of the process, MB", lambda size: _count(size.resident)),
        ("status of the steps", lambda size: _shares(size.statuses)),
        ("QP solved by", lambda size: _shares(size.qp_solvers) if any(size.qp_solvers) else "-"),
    )
    return table("Each size", "what", *map(_title, sizes),
                 rows=([what, *map(words, sizes)] for what, words in cells))


def _growth_table(sizes: Sequence[SizeMeasurement]) -> Table | None:
    """Exponent of each stage over each family; None when no family has two sizes."""
    families = {family: members for family, members in _families_of(sizes).items()
                if len({size.dof_count for size in members}) > 1}
    if not families:
        return None
    return table("Growth: time ~ dof^p, p fitted to medians", "stage", *(
        f"{family} ({len(members)} sizes)" for family, members in families.items()),
        rows=([stage, *(_number(exponent(members, stage), "{:.2f}") for members in families.values())]
              for stage in (*_stage_names(sizes), SUPERLU)))


def _families_of(sizes: Sequence[SizeMeasurement]) -> dict[str, list[SizeMeasurement]]:
    """Sizes by family, in their order."""
    return by_key((size.case.family, size) for size in sizes)


def exponent(sizes: Sequence[SizeMeasurement], stage: str) -> float:
    """Growth exponent of one stage's median over sizes.

    Args:
        sizes: What was measured, of one family.
        stage: Name of the stage.
    """
    return growth_exponent([size.dof_count for size in sizes], _medians(sizes, stage))


def _medians(sizes: Sequence[SizeMeasurement], stage: str) -> list[float]:
    """Median of a stage of each size [s]; NaN where a size does not have this stage."""
    return [size.times[stage].median if stage in size.times else np.nan for size in sizes]


def _stage_names(sizes: Sequence[SizeMeasurement]) -> list[str]:
    """All stages in their order, then the time outside them, then the whole step."""
    inner = dict.fromkeys(name for size in sizes for name in size.stages)
    return [name for name in inner if name not in (OUTSIDE, WHOLE_STEP)] + [OUTSIDE, WHOLE_STEP]


def check_requirements(size: SizeMeasurement) -> list[str]:
    """Compares a step with the requirements of the default Diamond, one sentence for each.

    Args:
        size: What was measured of the Diamond.
    """
    step = size.stages[WHOLE_STEP]
    return [
        f"required {REQUIRED_RATIO}: {_met(size.ratio <= REQUIRED_RATIO)}: a whole step on "
        f"{size.case.name} takes {_ms(step.median)} ms, {size.ratio:.3f} of one SuperLU "
        f"factorization ({_ms(size.superlu.median)} ms)",
        f"required p99 < {REQUIRED_TAIL} × median: {_met(size.tail < REQUIRED_TAIL)}: p99 is "
        f"{_ms(step.p99)} ms, {size.tail:.2f} × the median{_interruption_note(size)}",
    ]


def _compare_with_full(size: SizeMeasurement, full: SizeMeasurement | None) -> str:
    """A reduced model's step beside that of its full one, and its tail beside the required one."""
    step = size.stages[WHOLE_STEP]
    beside = "give its full scene too to compare them"
    if full is not None:
        beside = (f"{_full_ratio(size, full)} times faster than its full model {full.case.name} "
                  f"({_ms(full.stages[WHOLE_STEP].median)} ms)")
    return (f"required p99 <= {REQUIRED_REDUCED_TAIL} × median of a reduced model: "
            f"{_met(size.tail <= REQUIRED_REDUCED_TAIL)}: {size.case.name} takes "
            f"{_ms(step.median)} ms (p99 {_ms(step.p99)} ms, {size.tail:.2f} × the median), "
            f"{beside}{_interruption_note(size)}")


def _full_ratio(size: SizeMeasurement, full: SizeMeasurement | None) -> str:
    if full is None:
        return "-"
    return f"{full.stages[WHOLE_STEP].median / size.stages[WHOLE_STEP].median:.1f}"


def compare_with_paper(size: SizeMeasurement) -> str:
    """Compares a robot's step with the paper's divided by `PAPER_FACTOR`, with both mesh sizes.

    Args:
        size: What was measured of a robot with published values.
    """
    paper, step = size.case.paper, size.stages[WHOLE_STEP]
    required = paper.step / PAPER_FACTOR if paper.required is None else paper.required
    touching = " in contact" if size.contact_count else ""
    return (f"required {_ms(required)} ms: {_met(step.median <= required)}: a whole step of "
            f"{size.case.name}{touching} takes {_ms(step.median)} ms "
            f"(p99 {_ms(step.p99)} ms), {paper.source} {_ms(paper.step)} ms, "
            f"{paper.step / step.median:.1f} times as long, on another machine; "
            f"{size.dof_count} dof here, {paper.dof} there, {size.contact_count:.0f} contacts "
            f"with force, {size.row_count:.0f} rows{_interruption_note(size)}")


def _paper_ratio(size: SizeMeasurement) -> str:
    paper = size.case.paper
    return "-" if paper is None else f"{paper.step / size.stages[WHOLE_STEP].median:.1f}"


def _interruption_note(size: SizeMeasurement) -> str:
    """Warning when other processes affected the 99th percentile; else empty."""
    if size.interrupted_share <= _QUIET_SHARE:
        return ""
    return (f" (other processes interrupted {100.0 * size.interrupted_share:.1f} % of the steps: "
            "measure again on a quiet machine)")


def _met(yes: bool) -> str:
    return "met" if yes else "not met"


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


def _number(value: float, form: str) -> str:
    return form.format(value) if np.isfinite(value) else "-"


def _shares(counted: Counter[str]) -> str:
    total = sum(counted.values())
    return ", ".join(f"{name or 'none'} {100.0 * count / total:.0f} %"
                     for name, count in counted.most_common())


# SOFA 25.06 with SoftRobots.Inverse, built with -O3 -march=native, on the original Diamond's mesh
# of 1628 nodes: a step in SuperLU factorizations of the same matrix.
SOFA_RATIOS = {"SOFA as shipped": 1.37, "SOFA, best tuning": 0.78}
_STAGE_COLOURS = ("#5f5aa2", "#d95f02", "#3a8f5c", "#a03b76", "#c79a00", "#7a5230", "#9a9a9a",
                  "#4db3c8")
# Families of one or two sizes are drawn as points with different shapes.
_MARKERS = "Dsv^P*"
_STEP_COLOUR = "#1b6ca8"
_SUPERLU_COLOUR = "#222222"


def draw_bench(path: Path, sizes: Sequence[SizeMeasurement], conditions: str) -> None:
    """Draws all sizes and writes the picture.

    Args:
        path: Picture to write; its suffix determines the format.
        sizes: Measured sizes.
        conditions: Machine and versions, for the bottom of the picture.

    Raises:
        MissingExtraError: matplotlib is not installed.
        OutputError: The picture cannot be written.
    """
    with figure_file(path, (13.0, 6.0), "Time of a step", conditions) as figure:
        left, right = figure.subplots(1, 2)
        _draw_stages(left, sizes)
        _draw_ratios(right, sizes)


def _draw_stages(axes, sizes: Sequence[SizeMeasurement]) -> None:
    """Medians of each stage, one line for each family of meshes."""
    inner = [name for name in _stage_names(sizes) if name != WHOLE_STEP]
    colours = dict(zip(inner, _STAGE_COLOURS * 2))
    colours |= {WHOLE_STEP: _STEP_COLOUR, SUPERLU: _SUPERLU_COLOUR}
    families = _families_of(sizes)
    longest = max(families.values(), key=len)
    for members, style in zip(families.values(), _styles(families), strict=True):
        ordered = sorted(members, key=lambda size: size.dof_count)
        dofs = [size.dof_count for size in ordered]
        for stage, colour in colours.items():
            # Not every family has every stage: only scenes with contact have the stage detect.
            times = 1e3 * np.array(_medians(ordered, stage))
            growth = "" if stage == SUPERLU else _growth_label(longest, stage)
            thick = stage == WHOLE_STEP
            axes.plot(dofs, times, style, color=colour, markersize=5 if thick else 3.5,
                      linewidth=2.2 if thick else 1.2, zorder=3 if thick else 2,
                      label=f"{stage}{growth}" if members is longest else None)
    axes.set(xscale="log", yscale="log", xlabel="degrees of freedom", ylabel="median time [ms]",
             title="Time of each stage" + _families_label(families))
    axes.legend(loc="upper left", fontsize=8)


def _draw_ratios(axes, sizes: Sequence[SizeMeasurement]) -> None:
    """Median and 99th percentile of the whole step, in SuperLU factorizations.

    Reduced models, of which none is factorized, are left out.
    """
    families = _families_of([size for size in sizes if size.superlu_count])
    for (family, members), style in zip(families.items(), _styles(families), strict=True):
        ordered = sorted(members, key=lambda size: size.dof_count)
        dofs = [size.dof_count for size in ordered]
        axes.plot(dofs, [size.ratio for size in ordered], style, color=_STEP_COLOUR,
                  linewidth=2.2, markersize=5, label=f"whole step, median, {family}")
        axes.plot(dofs, [size.ratio * size.tail for size in ordered], "_", color=_STEP_COLOUR,
                  markersize=11, label=f"99th percentile, {family}")
    lines = [(f"{name}, original Diamond", ratio, "#a03b76") for name, ratio in SOFA_RATIOS.items()]
    lines.append(("required of the default Diamond", REQUIRED_RATIO, "#3a8f5c"))
    for text, ratio, colour in lines:
        axes.axhline(ratio, color=colour, linewidth=1.1, linestyle=(0, (4, 2)))
        axes.annotate(f"{text}: {ratio}", (1.0, ratio), (-4, 3),
                      xycoords=("axes fraction", "data"), textcoords="offset points",
                      ha="right", fontsize=8, color=colour)
    axes.set(xscale="log", yscale="log", xlabel="degrees of freedom",
             ylabel="whole step / one SuperLU factorization",
             title="Whole step against SuperLU on the same matrices, lower is faster")
    if families:
        axes.legend(loc="lower left", fontsize=8)


def _styles(families: dict[str, list[SizeMeasurement]]) -> list[str]:
    """Line styles: a line for each family of more than two sizes, points for the others."""
    shapes = cycle(_MARKERS)
    return ["o-" if len(members) > 2 else next(shapes) for members in families.values()]


def _growth_label(sizes: Sequence[SizeMeasurement], stage: str) -> str:
    growth = exponent(sizes, stage)
    if len(sizes) < 3 or not np.isfinite(growth):
        return ""
    return f" ~ dof^{growth:.2f}"


def _families_label(families: dict[str, list[SizeMeasurement]]) -> str:
    lines = [family for family, members in families.items() if len(members) > 2]
    points = [family for family, members in families.items() if len(members) <= 2]
    if not lines or not points:
        return ""
    return f" (lines: {', '.join(lines)}; points: {', '.join(points)})"


SLOWER, MORE_CALLS = 1.1, 1.02
"""A step that is slower by more than this than an earlier one, or makes more calls, is marked."""


def read_earlier(path: Path) -> dict[str, tuple[float, float]]:
    """Ratio of a whole step to one SuperLU factorization, and its calls, of an earlier run.

    Args:
        path: A ``bench.csv``.

    Returns:
        Both by the scene's name; a ratio is NaN where SuperLU was not timed.

    Raises:
        TableFileError: The file cannot be used.
    """
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = [row for row in csv.DictReader(file) if row["stage"] == WHOLE_STEP]
        return {row["scene"]: (float(row["ratio_to_superlu"] or "nan"), float(row["python_calls"]))
                for row in rows}  # fmt: skip
    except OSError as error:
        raise TableFileError(path, error.strerror or str(error)) from error
    except (KeyError, ValueError) as error:
        raise TableFileError(path, f"is no bench.csv of this version: {error!r}") from error


def _compare_with_earlier(
    sizes: Sequence[SizeMeasurement], earlier: dict[str, tuple[float, float]]
) -> Table:
    """Each step beside that of an earlier run, by SuperLU's time in the same run and by calls."""
    made = table("An earlier run", "scene", "step / SuperLU", "then", "calls", "then", "")
    for size in sizes:
        if size.case.name in earlier:
            ratio, calls = earlier[size.case.name]
            # Without SuperLU the ratio is NaN, which is above nothing.
            marks = ["slower"] * (size.ratio > SLOWER * ratio)
            marks += ["more calls"] * (size.calls > MORE_CALLS * calls)
            made.add_row(size.case.name, _number(size.ratio, "{:.3f}"), _number(ratio, "{:.3f}"),
                         f"{size.calls:.0f}", f"{calls:.0f}", ", ".join(marks))
    return made


def bench(scenes: list[Path], steps: int, output: Path | None = None,
          commands: Path | None = None, compare: Path | None = None,
          threads: int | None = None) -> int:
    """Times the steps of scenes, or of the standard sizes, and prints the results.

    Args:
        scenes: Scene files; none for the standard sizes.
        steps: Steps to time for each size.
        output: Folder for ``bench.csv`` and ``bench.png``, or None.
        commands: Commands file whose longest constant part is timed, or None for a circle.
        compare: ``bench.csv`` of an earlier run, or None.
        threads: Most threads of a step, or None for those of the scenes.

    Returns:
        Exit code, always 0: a requirement that is not met is reported, and is not a failure of the
        command.

    Raises:
        SoftRobotTwinError: A scene cannot be used or an output not be written.
    """
    if output is not None:
        make_folder(output)
    earlier = read_earlier(compare) if compare is not None else {}
    cases = given_cases(scenes, commands) if scenes else standard_cases()
    if threads is not None:
        cases = [case._replace(scene=case.scene.changed(solver={"threads": threads}))
                 for case in cases]
    sizes = _measure_all(cases, steps)
    conditions = describe_machine(NUMERICAL_LIBRARIES)
    shown = console()
    shown.print("Garbage collection off. Effectors move along a circle; robots without\n"
                "effectors move their actuators over their limits; robots with contact repeat\n"
                "the longest hold of a commands file or a part of a targets file.\n"
                "Steps are measured in elapsed time, SuperLU and dgemm in processor time, which\n"
                "does not include other processes. Reduced models are compared with full ones of\n"
                "the same mesh and element in the same run.")
    shown.print(conditions + "\n")
    print_apart(stage_table(sizes), _size_table(sizes), _growth_table(sizes))
    for size in sizes:
        if size.case.has_requirements:
            for words in check_requirements(size):
                shown.print(words)
        if size.case.paper is not None:
            shown.print(compare_with_paper(size))
        if size.is_reduced:
            shown.print(_compare_with_full(size, full_size(size, sizes)))
    if earlier:
        shown.print(_compare_with_earlier(sizes, earlier))
    if output is not None:
        _write_bench(output / "bench.csv", sizes)
        draw_bench(output / "bench.png", sizes, conditions)
        shown.print(f"written: {output / 'bench.csv'}, {output / 'bench.png'}")
    return 0


def _measure_all(cases: Sequence[BenchCase], steps: int) -> list[SizeMeasurement]:
    sizes, begin = [], time.monotonic()
    for number, case in enumerate(cases, start=1):
        # One line instead of a progress bar, whose thread would disturb the timing.
        report_activity(f"{case.name}, {number} of {len(cases)}: {steps} steps")
        sizes.append(measure(case, steps))
        if number == 1:
            announce((len(cases) - 1) * (time.monotonic() - begin),
                     f"{len(cases) - 1} more, if none takes longer than the first",
                     "fewer --steps, or scenes that are named, shorten it")
    return sizes

