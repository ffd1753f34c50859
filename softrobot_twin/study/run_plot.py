"""``plot``: draws what a run wrote over time, one panel for each quantity.

The file contains, in this order: the columns of a file, the panels, the drawing and the command.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import NamedTuple

import numpy as np

from softrobot_twin.harness.figure import figure_file, load_pyplot
from softrobot_twin.harness.length_units import SHOWN
from softrobot_twin.harness.terminal import console
from softrobot_twin.simulation.result import Status
from softrobot_twin.tables.column_names import (
    DRIVEN_BY,
    STATUS,
    STEP,
    TIME,
    displacement_columns,
    force_columns,
    position_columns,
    quaternion_columns,
    stiffness_columns,
    target_name,
    unit_of,
)
from softrobot_twin.tables.input_tables import TableFileError, open_columns
from softrobot_twin.tables.run_columns import ACTIVE_LIMITS, COMPUTE_TIME, TEXT_COLUMNS

SAMPLE = "sample"
"""First column of what ``workspace`` writes, in place of times."""

# --- the columns of a file -----------------------------------------------------------------------


class Series(NamedTuple):
    """The columns of a file.

    Attributes:
        path: The file.
        over: Name of the column of times or samples.
        at: Its values [s, or a number], shape (row_count,).
        numbers: All other columns of numbers, each of shape (row_count,), NaN where a cell is none.
        texts: Columns of texts, by name.
    """

    path: Path
    over: str
    at: np.ndarray
    numbers: dict[str, np.ndarray]
    texts: dict[str, list[str]]


def read_series(path: Path) -> Series:
    """Reads what a run wrote, or the table of targets or commands of one.

    Args:
        path: The CSV file.

    Raises:
        TableFileError: The file cannot be read, or is not of this kind.
    """
    columns = open_columns(path, f"{TIME},<effector>_x_m")
    over = next((name for name in (TIME, SAMPLE) if name in columns), None)
    if over is None:
        raise TableFileError(path, "is nothing that a run writes or reads: the header has neither "
                             f"{TIME} nor {SAMPLE}", 1)
    texts = {name: columns.texts(name) for name in columns.left if name in TEXT_COLUMNS}
    at = columns.pop(over)
    numbers = {name: columns.pop(name, may_be_open=True) for name in columns.left if name not in texts}
    return Series(path, over, at, numbers, texts)


# --- the panels ----------------------------------------------------------------------------------


class Line(NamedTuple):
    """A column that is drawn.

    Attributes:
        column: Its name.
        label: Its name in the legend.
        target: Column of what was wanted of it; empty without.
    """

    column: str
    label: str
    target: str = ""


class Panel(NamedTuple):
    """Lines with one quantity and unit.

    Attributes:
        title: The quantity, as it is written beside the axis.
        factor: From the unit of the columns to that which is drawn.
        unit: Unit that is drawn.
        lines: The lines.
        is_logarithmic: Whether the axis is logarithmic, as for residuals.
    """

    title: str
    factor: float
    unit: str
    lines: list[Line]
    is_logarithmic: bool = False


_WITHOUT_OWNER = {
    "residual_N": "residual", "contact_residual_m": "contact residual",
    "linearization_error_m": "linearization error", COMPUTE_TIME: "compute time",
    "contact_count": "contacts", "iterations": "iterations", "sampled_range": "range of training",
}
"""Columns that belong to the step and not to a named thing, and their quantities."""

_FEW = ("position", "body position", "error", "orientation error", "stiffness", "shortening",
        "angle", "growth", "expansion", "displacement", "length", "pressure", "tension", "torque",
        "touch force", "moved", "energy", "pressing", "reduction error", "residual")
"""Quantities that are drawn where no columns are named, in this order."""

_PARTS = {
    end: word for made, word in (
        (force_columns, "touch force"), (displacement_columns, "touch displacement"),
        (quaternion_columns, "quaternion"), (stiffness_columns, "stiffness"),
        (position_columns, "position"),
    ) for end in made("")
}  # fmt: skip
"""Ends of columns that are a part of a vector, and the quantity."""
_TRACKED = ("position", "quaternion", "stiffness")
"""Those that may have targets."""

_MOST_PANELS = 7
"""Most panels where no columns are named."""


def _quantity(name: str, names: Collection[str]) -> tuple[str, str]:
    """What a column tells, and its label: ``length`` and ``north`` of ``north_length_m``.

    Args:
        name: The column.
        names: All columns of the file.
    """
    if name in _WITHOUT_OWNER:
        return _WITHOUT_OWNER[name], _WITHOUT_OWNER[name]
    bare = name.removesuffix(f"_{unit_of(name)}")
    if bare.startswith("sum_of_magnitudes_"):
        return "pressing", bare.removeprefix("sum_of_magnitudes_").replace("_", " ", 1)
    if bare.startswith("force_on_"):
        return "contact force", bare.removeprefix("force_on_").replace("_", " ")
    for end, word in _PARTS.items():
        if name.endswith(end):
            owner, part = name.removesuffix(end), end.removesuffix(f"_{unit_of(end)}")[1:]
            # Bodies have a pose, and no targets.
            has_pose = f"{owner}_qx" in names and f"{owner}_error_m" not in names
            return f"{'body ' * (word == 'position' and has_pose)}{word}", f"{owner} {part}"
    if unit_of(name) in ("N_per_m", "m_per_N"):  # Of workspaces.
        word = "stiffness" if unit_of(name) == "N_per_m" else "compliance"
        return word, bare.replace(f"_{word}_", " ")
    for word in ("reduction_error", "orientation_error", "error", "energy", "rest_length",
                 "rest_volume", "moved"):
        if bare.endswith(f"_{word}"):
            return word.replace("_", " "), bare.removesuffix(f"_{word}")
    owner, _, word = bare.rpartition("_")
    return (word, owner) if owner else (bare, bare)


def panels_of(series: Series, globs: Sequence[str] = ()) -> list[Panel]:
    """Groups columns by quantity and unit.

    Args:
        series: The columns.
        globs: Patterns of the names that are drawn, such as ``*_tension_N``; empty for those that
            tell the most.

    Raises:
        TableFileError: A pattern matches no column.
    """
    known = [name for name in series.numbers if name != STEP]
    for glob in globs:
        if not any(fnmatchcase(name, glob) for name in (*known, *series.texts)):
            raise TableFileError(series.path, f"no column matches {glob!r}; columns: "
                                 f"{', '.join((*known, *series.texts))}")
    targets = {own: wanted for own, wanted in
               ((name, _wanted(name)) for name in known) if wanted in series.numbers}
    chosen = [name for name in known if not globs or any(fnmatchcase(name, g) for g in globs)]
    # A target is drawn with what it is the target of.
    alone = {wanted for own, wanted in targets.items() if own in chosen}
    grouped: dict[tuple[str, str], list[Line]] = {}
    for name in chosen:
        if name in alone or not np.isfinite(series.numbers[name]).any():
            continue
        quantity, label = _quantity(name, series.numbers)
        grouped.setdefault((quantity, unit_of(name)), []).append(Line(name, label, targets.get(name, "")))
    panels = [Panel(quantity, *SHOWN.get(unit, (1.0, unit)), lines, quantity.endswith("residual"))
              for (quantity, unit), lines in grouped.items()]
    return panels if globs else _few(panels)


def _wanted(name: str) -> str:
    """Column of what was wanted of an effector's column; a name that no file has for others."""
    for end, word in _PARTS.items():
        if name.endswith(end) and word in _TRACKED:
            return f"{target_name(name.removesuffix(end))}{end}"
    return ""


def _few(panels: list[Panel]) -> list[Panel]:
    """The panels that tell the most, in their order."""
    by_title = {panel.title: panel for panel in panels}
    # A length is told by how much of it is wound up, a volume by its growth.
    shortened = {line.label for line in by_title.get("shortening", Panel("", 1.0, "", [])).lines}
    lengths = by_title.get("length")
    if lengths is not None:
        left = [line for line in lengths.lines if line.label not in shortened]
        by_title["length"] = lengths._replace(lines=left)
    few = [by_title[title] for title in _FEW if title in by_title and by_title[title].lines]
    return few[:_MOST_PANELS] if few else panels[:_MOST_PANELS]


# --- the drawing ---------------------------------------------------------------------------------

_COLOURS = ("#1f6fb4", "#d1622b", "#2c9a5b", "#8a4fb0", "#b8961a", "#c2417c", "#4a4a4a", "#3aa6b9",
            "#7a5a3a", "#8fae2f")
_STATUS_COLOURS = {
    Status.OK: "#4caf70", Status.LINEARIZED: "#a9d8b3", Status.RATE_LIMITED: "#f0d264",
    Status.SATURATED: "#efa04a", Status.UNREACHABLE: "#dd7a53", Status.NOT_CONVERGED: "#c2417c",
    Status.INVERTED: "#8a2f8a", Status.REFUSED: "#b02a2a", Status.UNSOLVED: "#7c1f1f",
    Status.DIVERGED: "#3a0d0d",
}
_MOST_NAMED = 10
"""Most lines that a legend names."""

_MOST_LIMITS = 10
"""Most limits that have a row of their own."""


def _named(panel: Panel, series: Series) -> list[Line]:
    """Lines that the legend names: all, or those that change the most, in their order."""
    if len(panel.lines) <= _MOST_NAMED:
        return panel.lines
    spans = [float(np.ptp(values[np.isfinite(values)])) for values in
             (series.numbers[line.column] for line in panel.lines)]
    most = sorted(np.argsort(-np.array(spans), kind="stable")[: _MOST_NAMED - 1])
    return [panel.lines[index] for index in most]


def draw_run(series: Series, panels: Sequence[Panel], bands: Sequence[str], figure) -> None:
    """Draws panels, the status of each step and the active limits one above the other.

    Args:
        series: The columns.
        panels: What is drawn.
        bands: Columns of text that are drawn as bands.
        figure: An empty matplotlib figure.
    """
    limits = _limits(series) if ACTIVE_LIMITS in bands else {}
    bands = [name for name in bands if name != ACTIVE_LIMITS or limits]
    heights = [_panel_height(panel, series) for panel in panels]
    heights += [0.35 + 0.17 * (len(limits) if name == ACTIVE_LIMITS else 1) for name in bands]
    figure.set_size_inches(9.5, 0.7 + sum(heights))
    axes = figure.subplots(len(heights), 1, sharex=True, squeeze=False,
                           gridspec_kw={"height_ratios": heights})[:, 0]
    figure.align_ylabels(axes)
    edges = _edges(series.at)
    for axis, panel in zip(axes, panels):
        _draw_panel(axis, panel, series)
    for axis, name in zip(axes[len(panels):], bands):
        if name == ACTIVE_LIMITS:
            _draw_limits(axis, limits, edges)
        else:
            _draw_band(axis, name, series.texts[name], edges)
    axes[-1].set_xlabel("time [s]" if series.over == TIME else series.over)
    if len(edges) > 1:
        axes[-1].set_xlim(edges[0], edges[-1])


def _panel_height(panel: Panel, series: Series) -> float:
    """Height of a panel, with room for its legend [inch]."""
    entries = len(_named(panel, series))
    entries += (len(panel.lines) > _MOST_NAMED) + any(line.target for line in panel.lines)
    return max(1.35, 0.3 + 0.165 * entries)


def _edges(at: np.ndarray) -> np.ndarray:
    """Where each row begins, and where the last one ends."""
    if len(at) < 2:
        return np.array([at[0] - 0.5, at[0] + 0.5])
    return np.concatenate([[at[0] - (at[1] - at[0])], at])


def _draw_panel(axis, panel: Panel, series: Series) -> None:
    named = {line.column for line in _named(panel, series)}
    few = len(panel.lines) <= _MOST_NAMED
    style = {"marker": ".", "linestyle": "none", "markersize": 3} if series.over == SAMPLE else {
        "linewidth": 1.3 if few else 0.7}
    if len(series.at) == 1:
        style["marker"] = "."
    shown = 0
    for line in sorted(panel.lines, key=lambda one: one.column in named):
        is_named = line.column in named
        colour = _COLOURS[shown % len(_COLOURS)] if is_named else "#c4c4c4"
        shown += is_named
        if line.target:
            axis.plot(series.at, panel.factor * series.numbers[line.target], color=colour,
                      linestyle="--", linewidth=1.0, alpha=0.75)
        axis.plot(series.at, panel.factor * _positive(series.numbers[line.column], panel),
                  color=colour, label=line.label if is_named else None, **style)
    axis.set_ylabel(f"{panel.title}\n[{panel.unit}]" if panel.unit else panel.title)
    if panel.is_logarithmic and any(
            (series.numbers[line.column] > 0.0).any() for line in panel.lines):
        axis.set_yscale("log")
    if any(line.target for line in panel.lines):
        axis.plot([], [], color="#777777", linestyle="--", linewidth=1.0, label="target")
    if not few:
        axis.plot([], [], color="#c4c4c4", label=f"and {len(panel.lines) - len(named)} more")
    if len(panel.lines) > 1 or panel.lines[0].label != panel.title:
        axis.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.0, fontsize=8,
                    labelspacing=0.25, handlelength=1.4)


def _positive(values: np.ndarray, panel: Panel) -> np.ndarray:
    return np.where(values > 0.0, values, np.nan) if panel.is_logarithmic else values


def _draw_band(axis, name: str, words: Sequence[str], edges: np.ndarray) -> None:
    """A band with the colour of each row's word, such as its status."""
    severity = {status.value: place for place, status in enumerate(Status)}
    kinds = sorted(set(words), key=lambda word: (severity.get(word, -1), word))
    known = {status.value: colour for status, colour in _STATUS_COLOURS.items()}
    for place, word in enumerate(kinds):
        spans = _spans([one == word for one in words], edges)
        share = 100.0 * words.count(word) / len(words)
        axis.broken_barh(spans, (0.0, 1.0), label=f"{word or 'none'} {share:.3g} %",
                         facecolors=known.get(word, _COLOURS[place % len(_COLOURS)]))
    axis.set_ylim(0.0, 1.0)
    axis.set_yticks([])
    axis.grid(False)
    axis.set_ylabel(name.replace("_", " "), rotation=0, ha="right", va="center")
    axis.legend(loc="upper left", bbox_to_anchor=(1.0, 1.35), borderaxespad=0.0, fontsize=8,
                labelspacing=0.2, handlelength=1.0)


def _limits(series: Series) -> dict[str, list[bool]]:
    """In which rows each limit was active, the most frequent ones; the others together."""
    rows = [cell.split() for cell in series.texts[ACTIVE_LIMITS]]
    counts = Counter(name for row in rows for name in dict.fromkeys(row))
    most = [name for name, _ in counts.most_common()]
    shown = most if len(most) <= _MOST_LIMITS else most[: _MOST_LIMITS - 1]
    found = {name: [name in row for row in rows] for name in shown}
    if len(shown) < len(most):
        rest = set(most) - set(shown)
        found[f"{len(rest)} more"] = [bool(rest & set(row)) for row in rows]
    return found


def _draw_limits(axis, limits: dict[str, list[bool]], edges: np.ndarray) -> None:
    """A row for each limit, filled while it is active."""
    for place, is_active in enumerate(limits.values()):
        axis.broken_barh(_spans(is_active, edges), (place - 0.4, 0.8), facecolors="#efa04a")
    axis.set_yticks(range(len(limits)), list(limits), fontsize=7)
    axis.set_ylim(len(limits) - 0.5, -0.5)
    axis.grid(False)
    axis.yaxis.tick_right()
    axis.tick_params(axis="y", length=0)
    axis.set_ylabel("active\nlimits", rotation=0, ha="right", va="center")


def _spans(is_inside: Sequence[bool], edges: np.ndarray) -> list[tuple[float, float]]:
    """Begin and width of each interval of rows that are inside."""
    changes = np.flatnonzero(np.diff(np.array(is_inside, int), prepend=0, append=0)).reshape(-1, 2)
    return [(float(edges[a]), float(edges[b] - edges[a])) for a, b in changes]


# --- the command ---------------------------------------------------------------------------------


def plot(run: Path, globs: Sequence[str] = (), output: Path | None = None) -> int:
    """Draws what a run wrote.

    Args:
        run: File of ``simulate`` or ``workspace``, or a table of targets or commands.
        globs: Patterns of the columns that are drawn; empty for those that tell the most.
        output: Picture to write; None for ``<run>_plot.png`` beside the file.

    Returns:
        Exit code, always 0.

    Raises:
        TableFileError: The file is of another kind, or a pattern matches no column.
        MissingExtraError: matplotlib is not installed.
        OutputError: The picture cannot be written.
    """
    load_pyplot()
    series = read_series(run)
    panels = panels_of(series, globs)
    bands = [name for name in (STATUS, ACTIVE_LIMITS, DRIVEN_BY) if name in series.texts and (
        any(fnmatchcase(name, glob) for glob in globs) if globs else name != DRIVEN_BY)]
    if not panels and not bands:
        raise TableFileError(run, "has no column with a number to draw")
    path = run.with_name(f"{run.stem}_plot.png") if output is None else output
    foot = f"{len(series.at)} rows of {run.name}"
    with figure_file(path, (9.5, 4.0), run.stem, foot) as figure:
        draw_run(series, panels, bands, figure)
    console().print(f"written: {path}")
    return 0
