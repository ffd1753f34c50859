"""A demo in one picture: the way, the error over time, what the cables did."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from softrobot_twin.study.reports.sheet import sheet
from softrobot_twin.study.reports.tracking_record import TimedValues, TrackingRecord, distances

_RUN_COLOURS = {"open_loop": "#d95f02", "closed_loop": "#1b6ca8"}
_RUN_WORDS = {"open_loop": "open loop", "closed_loop": "closed loop"}
_TARGET_COLOUR = "#222222"
_TWIN_COLOUR = "#7fa87f"
_CABLE_COLOURS = ("#1b6ca8", "#d95f02", "#3a8f5c", "#a03b76",
                  "#c79a00", "#5f5aa2", "#7a5230", "#4d4d4d", "#0aa3a3", "#d0407a")


def draw_tracking(robot: str, runs: dict[str, TrackingRecord], path: Path) -> None:
    """Draws all runs of a demo and writes the picture.

    Args:
        robot: Name of the robot, for the title.
        runs: Records under ``open_loop`` and ``closed_loop``; at least one of them.
        path: Picture to write; its ending says the format.

    Raises:
        MissingExtraError: matplotlib is not installed.
        OutputError: The picture cannot be written.
    """
    title = f"{robot}: a simulated device driven through the twin"
    with sheet(path, (12.0, 11.0), title) as figure:
        grid = figure.add_gridspec(3, 2, height_ratios=(1.25, 0.8, 0.9))
        _draw_way_from_above(figure.add_subplot(grid[0, 0]), runs)
        _draw_way_from_the_side(figure.add_subplot(grid[0, 1]), runs)
        _draw_errors(figure.add_subplot(grid[1, :]), runs)
        _draw_cables(figure.add_subplot(grid[2, 0]), runs, "lengths", 1e3,
                     "Commanded change of lengths and positions", "change from the start [mm]",
                     from_start=True)
        _draw_cables(figure.add_subplot(grid[2, 1]), runs, "tensions", 1.0,
                     "Tensions and forces of the twin", "force [N]")


def _draw_way_from_above(axes, runs: dict[str, TrackingRecord]) -> None:
    _draw_way(axes, runs, (0, 1))
    axes.set(title="Way of the effector, from above")
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.12)
    axes.legend(loc="best", fontsize=8)


def _draw_way_from_the_side(axes, runs: dict[str, TrackingRecord]) -> None:
    """Heights are stretched: to scale, a millimetre of sag would be a hair's breadth."""
    _draw_way(axes, runs, (0, 2))
    axes.set(title="Way of the effector, from the side (heights stretched)")
    low, high = axes.get_ylim()
    spare = max(0.0, 4.0 - (high - low)) / 2.0
    axes.set_ylim(low - spare, high + spare)


def _draw_way(axes, runs: dict[str, TrackingRecord], plane: tuple[int, int]) -> None:
    """Target, twin and device in one plane of space."""
    for run, record in runs.items():
        axes.plot(*_millimetres(record.device, plane), color=_RUN_COLOURS[run], linewidth=1.5,
                  label=f"device, {_RUN_WORDS[run]}")
    last = list(runs.values())[-1]
    axes.plot(*_millimetres(last.twin, plane), color=_TWIN_COLOUR, linewidth=1.2,
              label=f"twin, {_RUN_WORDS[list(runs)[-1]]}")
    axes.plot(*_millimetres(last.target, plane), color=_TARGET_COLOUR, linewidth=1.1,
              linestyle=(0, (4, 2)), label="target")
    across, upward = ("xyz"[axis] for axis in plane)
    axes.set(xlabel=f"{across} [mm]", ylabel=f"{upward} [mm]")


def _millimetres(samples: TimedValues, plane: tuple[int, int]) -> np.ndarray:
    return 1e3 * samples.values[:, plane].T


def _draw_errors(axes, runs: dict[str, TrackingRecord]) -> None:
    """Distance of the device from the target at the same moment, and its mean."""
    for run, record in runs.items():
        errors = distances(record.target, record.device)
        if not len(errors.times):
            continue
        mean = 1e3 * float(errors.values.mean())
        axes.plot(errors.times - record.target.times[0], 1e3 * errors.values[:, 0],
                  color=_RUN_COLOURS[run], linewidth=1.2,
                  label=f"{_RUN_WORDS[run]}, mean {mean:.2f} mm")
        axes.axhline(mean, color=_RUN_COLOURS[run], linewidth=0.9, linestyle=(0, (2, 2)))
    axes.set(xlabel="time [s]", ylabel="distance [mm]",
             title="Tracking error: the device's effector against the target")
    axes.set_ylim(bottom=0.0)
    axes.margins(x=0.01)
    _legend_above(axes, 2)


def _draw_cables(axes, runs: dict[str, TrackingRecord], quantity: str, factor: float,
                 title: str, label: str, from_start: bool = False) -> None:
    """One line an actuator: the last run solid, the one before it dotted."""
    styles = [(0, (1, 1.5)), "solid"][-len(runs):]
    start = getattr(next(iter(runs.values())), quantity).values[:1]
    first = start if from_start and len(start) else 0.0
    for style, (run, record) in zip(styles, runs.items()):
        samples = getattr(record, quantity)
        values = factor * (samples.values - first)
        for index, name in enumerate(record.cable_names):
            axes.plot(samples.times - record.target.times[0], values[:, index],
                      color=_CABLE_COLOURS[index % len(_CABLE_COLOURS)], linestyle=style,
                      linewidth=1.3 if style == "solid" else 1.0,
                      label=name if style == "solid" else None)
    note = " (dotted: open loop)" if len(runs) > 1 else ""
    axes.set(xlabel=f"time [s]{note}", ylabel=label, title=title)
    axes.margins(x=0.01)
    _legend_above(axes, 4 if len(record.cable_names) <= 4 else 9)


def _legend_above(axes, columns: int) -> None:
    """At the title's height, where no curve runs; a long one below the axes."""
    long = columns > 4
    place = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.2)} if long else {
        "loc": "lower right", "bbox_to_anchor": (1.0, 0.98)}
    axes.legend(**place, ncols=columns, fontsize=7 if long else 8,
                columnspacing=0.9 if long else 1.2, handlelength=1.0 if long else 1.4)
