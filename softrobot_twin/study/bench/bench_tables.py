"""Measured sizes as tables for the terminal, and the verdict on the bar."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np
from rich.table import Table

from softrobot_twin.study.bench.growth import growth_exponent
from softrobot_twin.study.bench.size_measurement import OUTSIDE, WHOLE_STEP, SizeMeasurement
from softrobot_twin.study.reports.terminal import table

RATIO_BAR = 0.16
"""Most of one SuperLU factorization that a whole step on the default Diamond may take."""
PAPER_FACTOR = 4.0
"""How many times faster than the paper's step ours must be."""
TAIL_BAR = 1.5
"""Most that the 99th percentile of a step may be, in medians."""
# More interrupted steps than this reach into the 99th percentile.
_QUIET_SHARE = 0.005


def stage_table(sizes: Sequence[SizeMeasurement]) -> Table:
    """Median, 99th percentile and maximum of each stage of each size."""
    made = table("Time of a step in ms: median / p99 / max", "stage",
                 *(f"{size.case.name}\n{size.dof_count} dof" for size in sizes))
    for stage in stage_names(sizes):
        made.add_row(stage, *(_times(size, stage) for size in sizes))
    made.add_row("one SuperLU factorization", *(
        f"{_ms(size.superlu.median)} / {_ms(size.superlu.p99)} / {_ms(size.superlu.maximum)}"
        for size in sizes))
    return made


def size_table(sizes: Sequence[SizeMeasurement]) -> Table:
    """What else was measured of each size."""
    made = table("Each size", "what",
                 *(f"{size.case.name}\n{size.dof_count} dof" for size in sizes))
    for what, words in (
        ("nodes, tets", lambda size: f"{size.node_count}, {size.tet_count}"),
        ("factorization", lambda size: size.factorization),
        ("rows of H, contacts with force",
         lambda size: f"{size.row_count:.0f}, {size.contact_count:.0f}"),
        ("paper's step / ours", lambda size: _paper_ratio(size)),
        ("steps timed, SuperLU timed", lambda size: f"{size.step_count}, {size.superlu_count}"),
        ("page faults in one SuperLU", lambda size: f"{size.superlu_page_faults:.0f}"),
        ("whole step / one SuperLU", lambda size: f"{size.ratio:.3f}"),
        ("steps interrupted by others",
         lambda size: f"{100.0 * size.interrupted_share:.1f} %"),
        ("p99 / median", lambda size: f"{size.tail:.2f}"),
        ("operations, factor, Mflop", lambda size: _count(size.flops and size.flops.factor)),
        ("operations, solves, Mflop", lambda size: _count(size.flops and size.flops.solves)),
        ("dgemm in this run, Gflop/s", lambda size: f"{1e-9 * size.dense_speed:.1f}"),
        ("all that at dgemm speed, ms", lambda size: _ms(size.limit)),
        ("of dgemm speed reached", lambda size: _number(size.share_of_dense_speed, "{:.2f}")),
        ("factor's buffers, MB", lambda size: _count(size.factor_bytes)),
        ("process in RAM, with it, MB", lambda size: _count(size.resident)),
        ("steps ended", lambda size: _tally(size.statuses)),
        ("QP answered by", lambda size: _tally(size.qp_solvers) if any(size.qp_solvers) else "-"),
    ):
        made.add_row(what, *map(words, sizes))
    return made


def growth_table(sizes: Sequence[SizeMeasurement]) -> Table | None:
    """Exponent of each stage over each family; None when no family has two sizes."""
    families = {family: members for family, members in families_of(sizes).items()
                if len({size.dof_count for size in members}) > 1}
    if not families:
        return None
    made = table("Growth: time ~ dof^p, p fitted to medians", "stage", *(
        f"{family} ({len(members)} sizes)" for family, members in families.items()))
    for stage in stage_names(sizes):
        made.add_row(stage, *(
            _number(exponent(members, stage), "{:.2f}") for members in families.values()))
    made.add_row("one SuperLU factorization", *(
        _number(growth_exponent([size.dof_count for size in members],
                                [size.superlu.median for size in members]), "{:.2f}")
        for members in families.values()))
    return made


def families_of(sizes: Sequence[SizeMeasurement]) -> dict[str, list[SizeMeasurement]]:
    """Sizes by family, in their order."""
    families: dict[str, list[SizeMeasurement]] = {}
    for size in sizes:
        families.setdefault(size.case.family, []).append(size)
    return families


def exponent(sizes: Sequence[SizeMeasurement], stage: str) -> float:
    """Growth exponent of one stage's median over sizes."""
    return growth_exponent(
        [size.dof_count for size in sizes],
        [size.stages[stage].median if stage in size.stages else np.nan for size in sizes])


def stage_names(sizes: Sequence[SizeMeasurement]) -> list[str]:
    """All stages in the order they run, then what is outside them, then the whole."""
    inner = dict.fromkeys(name for size in sizes for name in size.stages)
    return [name for name in inner if name not in (OUTSIDE, WHOLE_STEP)] + [OUTSIDE, WHOLE_STEP]


def verdict(size: SizeMeasurement) -> list[str]:
    """Whether the bars set for the default Diamond are met, a sentence each."""
    step = size.stages[WHOLE_STEP]
    return [
        f"bar {RATIO_BAR}: {_met(size.ratio <= RATIO_BAR)}: a whole step on {size.case.name} takes "
        f"{_ms(step.median)} ms, {size.ratio:.3f} of one SuperLU factorization "
        f"({_ms(size.superlu.median)} ms)",
        f"bar p99 < {TAIL_BAR} × median: {_met(size.tail < TAIL_BAR)}: p99 is "
        f"{_ms(step.p99)} ms, {size.tail:.2f} × the median{_busy_words(size)}",
    ]


def paper_verdict(size: SizeMeasurement) -> str:
    """Whether a robot's step beats the paper's by `PAPER_FACTOR`, and what sizes are compared."""
    paper, step = size.case.paper, size.stages[WHOLE_STEP]
    bar = paper.step / PAPER_FACTOR
    return (f"bar {_ms(bar)} ms: {_met(step.median <= bar)}: a whole step of {size.case.name} in "
            f"contact takes {_ms(step.median)} ms (p99 {_ms(step.p99)} ms), {paper.source} "
            f"{_ms(paper.step)} ms, {paper.step / step.median:.1f} times as long, on another "
            f"machine; {size.dof_count} dof here, {paper.dof} there, {size.contact_count:.0f} "
            f"contacts with force, {size.row_count:.0f} rows{_busy_words(size)}")


def _paper_ratio(size: SizeMeasurement) -> str:
    paper = size.case.paper
    return "-" if paper is None else f"{paper.step / size.stages[WHOLE_STEP].median:.1f}"


def _busy_words(size: SizeMeasurement) -> str:
    """What a tail is worth that other processes have made."""
    if size.interrupted_share <= _QUIET_SHARE:
        return ""
    return (f" (other processes interrupted {100.0 * size.interrupted_share:.1f} % of the steps: "
            "measure again on a quiet machine)")


def _met(yes: bool) -> str:
    return "met" if yes else "not met"


def _times(size: SizeMeasurement, stage: str) -> str:
    if stage not in size.stages:
        return "-"
    times = size.stages[stage]
    return f"{_ms(times.median)} / {_ms(times.p99)} / {_ms(times.maximum)}"


def _ms(seconds: float) -> str:
    """Milliseconds with three significant digits or so."""
    value = 1e3 * seconds
    if not np.isfinite(value):
        return "-"
    return f"{value:.3f}" if value < 10.0 else f"{value:.1f}"


def _count(number: float | None) -> str:
    return "-" if number is None else f"{1e-6 * number:.2f}"


def _number(value: float, form: str) -> str:
    return form.format(value) if np.isfinite(value) else "-"


def _tally(counted: Counter[str]) -> str:
    total = sum(counted.values())
    return ", ".join(f"{name or 'none'} {100.0 * count / total:.0f} %"
                     for name, count in counted.most_common())
