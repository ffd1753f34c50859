"""Measured sizes in one picture: time of each stage, and the step in SuperLU factorizations."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import cycle
from pathlib import Path

import numpy as np

from softrobot_twin.study.bench.bench_tables import RATIO_BAR, exponent, families_of, stage_names
from softrobot_twin.study.bench.size_measurement import WHOLE_STEP, SizeMeasurement
from softrobot_twin.study.reports.sheet import sheet

# SOFA 25.06 with SoftRobots.Inverse, built with -O3 -march=native, on the original Diamond's mesh
# of 1628 nodes: a step in SuperLU factorizations of the same matrix.
SOFA_RATIOS = {"SOFA as shipped": 1.37, "SOFA, best tuning": 0.78}
_STAGE_COLOURS = ("#5f5aa2", "#d95f02", "#3a8f5c", "#a03b76", "#c79a00", "#7a5230", "#9a9a9a",
                  "#4db3c8")
# Families of one or two sizes are points, told apart by their shape.
_MARKERS = "Dsv^P*"
_STEP_COLOUR = "#1b6ca8"
_SUPERLU_COLOUR = "#222222"


def draw_bench(path: Path, sizes: Sequence[SizeMeasurement], conditions: str) -> None:
    """Draws all sizes and writes the picture.

    Args:
        path: Picture to write; its ending says the format.
        sizes: What was measured.
        conditions: Machine and versions, for the foot of the picture.

    Raises:
        MissingExtraError: matplotlib is not installed.
        OutputError: The picture cannot be written.
    """
    with sheet(path, (13.0, 6.0), "What a step costs", conditions) as figure:
        left, right = figure.subplots(1, 2)
        _draw_stages(left, sizes)
        _draw_ratios(right, sizes)


def _draw_stages(axes, sizes: Sequence[SizeMeasurement]) -> None:
    """Medians, one line a family: a mesh of another shape is no refinement."""
    inner = [name for name in stage_names(sizes) if name != WHOLE_STEP]
    colours = dict(zip(inner, _STAGE_COLOURS * 2)) | {WHOLE_STEP: _STEP_COLOUR}
    families = families_of(sizes)
    longest = max(families.values(), key=len)
    for members, style in zip(families.values(), _styles(families), strict=True):
        ordered = sorted(members, key=lambda size: size.dof_count)
        dofs = [size.dof_count for size in ordered]
        for stage, colour in colours.items():
            # Not every family has every stage: detect is where things touch.
            times = [1e3 * size.stages[stage].median if stage in size.stages else np.nan
                     for size in ordered]
            label = f"{stage}{_growth_words(longest, stage)}" if members is longest else None
            thick = stage == WHOLE_STEP
            axes.plot(dofs, times, style, color=colour, markersize=5 if thick else 3.5,
                      linewidth=2.2 if thick else 1.2, label=label, zorder=3 if thick else 2)
        axes.plot(dofs, [1e3 * size.superlu.median for size in ordered], style,
                  color=_SUPERLU_COLOUR, markersize=3.5, linewidth=1.2,
                  label="one SuperLU factorization" if members is longest else None)
    axes.set(xscale="log", yscale="log", xlabel="degrees of freedom", ylabel="median time [ms]",
             title="Time of each stage" + _families_words(families))
    axes.legend(loc="upper left", fontsize=8)


def _draw_ratios(axes, sizes: Sequence[SizeMeasurement]) -> None:
    """Median and 99th percentile of the whole step, in SuperLU factorizations."""
    families = families_of(sizes)
    for (family, members), style in zip(families.items(), _styles(families), strict=True):
        ordered = sorted(members, key=lambda size: size.dof_count)
        dofs = [size.dof_count for size in ordered]
        axes.plot(dofs, [size.ratio for size in ordered], style, color=_STEP_COLOUR,
                  linewidth=2.2, markersize=5, label=f"whole step, median, {family}")
        axes.plot(dofs, [size.ratio * size.tail for size in ordered], "_", color=_STEP_COLOUR,
                  markersize=11, label=f"99th percentile, {family}")
    for name, ratio in SOFA_RATIOS.items():
        axes.axhline(ratio, color="#a03b76", linewidth=1.1, linestyle=(0, (4, 2)))
        axes.annotate(f"{name}, original Diamond: {ratio}", (1.0, ratio), (-4, 3),
                      xycoords=("axes fraction", "data"), textcoords="offset points",
                      ha="right", fontsize=8, color="#a03b76")
    axes.axhline(RATIO_BAR, color="#3a8f5c", linewidth=1.1, linestyle=(0, (4, 2)))
    axes.annotate(f"bar for the default Diamond: {RATIO_BAR}", (1.0, RATIO_BAR), (-4, 3),
                  xycoords=("axes fraction", "data"), textcoords="offset points", ha="right",
                  fontsize=8, color="#3a8f5c")
    axes.set(xscale="log", yscale="log", xlabel="degrees of freedom",
             ylabel="whole step / one SuperLU factorization",
             title="Whole step against SuperLU on the same matrices, lower is faster")
    axes.legend(loc="lower left", fontsize=8)


def _styles(families: dict[str, list[SizeMeasurement]]) -> list[str]:
    """A line for each family of more than two sizes, else points: two sizes are no curve."""
    shapes = cycle(_MARKERS)
    return ["o-" if len(members) > 2 else next(shapes) for members in families.values()]


def _growth_words(sizes: Sequence[SizeMeasurement], stage: str) -> str:
    growth = exponent(sizes, stage)
    if len(sizes) < 3 or not np.isfinite(growth):
        return ""
    return f" ~ dof^{growth:.2f}"


def _families_words(families: dict[str, list[SizeMeasurement]]) -> str:
    lines = [family for family, members in families.items() if len(members) > 2]
    points = [family for family, members in families.items() if len(members) <= 2]
    if not lines or not points:
        return ""
    return f" (lines: {', '.join(lines)}; points: {', '.join(points)})"
