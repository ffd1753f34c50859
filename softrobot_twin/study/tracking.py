"""Tracking errors of recorded runs, as a report and a picture.

The error at the time t of a device sample is ‖x_device(t) - x_target(t)‖ or, for a robot that is
driven by commands, ‖x_device(t) - x_twin(t)‖: how far the twin predicts wrongly. Target and twin
are interpolated linearly in time. An error therefore includes a delay.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from softrobot_twin.errors import NamedError
from softrobot_twin.harness.figure import figure_file, legend_below
from softrobot_twin.harness.length_units import SHOWN
from softrobot_twin.harness.machine_facts import machine, versions
from softrobot_twin.harness.output_file import writing
from softrobot_twin.tables.input_tables import between_rows


class TimedValues(NamedTuple):
    """Samples of one quantity in the order of their times.

    Attributes:
        times: Time of each sample [s], shape (sample_count,), increasing.
        values: The samples, shape (sample_count, width).
    """

    times: np.ndarray
    values: np.ndarray

    def at(self, times: np.ndarray) -> np.ndarray:
        """Values at other times, interpolated linearly; NaN outside, shape (n, width).

        Args:
            times: The other times [s], shape (n,).
        """
        if not len(self.times):
            return np.full((len(times), self.values.shape[1]), np.nan)
        return between_rows(times, self.times, self.values, np.nan)


@dataclass(frozen=True)
class TrackingRecord:
    """One run along a path.

    Attributes:
        target: Target positions [m], width 3, without correction; None where commands were played.
        twin: Positions predicted by the twin [m], width 3.
        device: True positions [m], width 3.
        actuator_names: Actuators, in the order of the columns below.
        setpoint_units: Unit of each actuator's setpoint, such as ``m`` or ``Pa``.
        effort_units: Unit of each actuator's effort.
        setpoints: Commanded lengths of cables [m], pressures [Pa] or volumes [m³] of cavities,
            width actuator_count.
        efforts: Efforts of the twin, such as tensions [N], width actuator_count.
    """

    target: TimedValues | None
    twin: TimedValues
    device: TimedValues
    actuator_names: tuple[str, ...]
    setpoint_units: tuple[str, ...]
    effort_units: tuple[str, ...]
    setpoints: TimedValues
    efforts: TimedValues

    @property
    def reference(self) -> TimedValues:
        """What the device is compared with: the target, or the twin without one."""
        return self.twin if self.target is None else self.target


class RecordError(NamedError):
    """A record of a run has too few samples."""


def distances(reference: TimedValues, measured: TimedValues) -> TimedValues:
    """Distance of measurements from a reference at the same time [m], width 1.

    Samples at times without a reference are left out.

    Args:
        reference: Where it should be [m], width 3.
        measured: Where it was [m], width 3.
    """
    apart = np.linalg.norm(measured.values - reference.at(measured.times), axis=1)
    known = np.isfinite(apart)
    return TimedValues(measured.times[known], apart[known, None])


PUBLISHED_ERRORS_MM = {"diamond": {"mean": 1.4, "max": 2.9}, "trunk": {"mean": 4.72, "max": None}}
"""Errors of real robots, driven open loop, in the paper (Coevoet 2017, section 7.2) [mm]. Paths,
silicone and measurement differ from ours, so they are reported but not compared.
"""


def tracking_figures(name: str, record: TrackingRecord) -> dict[str, float | int]:
    """Errors of one run [mm]: the device against its reference, and the twin against the device.

    Args:
        name: Name of the run, for the error.
        record: Its record.

    Raises:
        RecordError: The device has no sample at a time with a reference.
    """
    errors = 1e3 * distances(record.reference, record.device).values[:, 0]
    if not errors.size:
        raise RecordError(name, "no sample of the device at a time with a target or of the twin")
    misfit = 1e3 * distances(record.twin, record.device).values[:, 0]
    return {
        "mean_error_mm": float(errors.mean()),
        "max_error_mm": float(errors.max()),
        "mean_twin_misfit_mm": float(misfit.mean()) if misfit.size else None,
        "samples": int(errors.size),
        "seconds": float(np.ptp(record.reference.times)),
    }


def tracking_report(robot: str, runs: dict[str, TrackingRecord], figures_of_twin: dict) -> dict:
    """The report of a demo; plain numbers and text, ready for JSON.

    Args:
        robot: Name of the robot.
        runs: Records under ``open_loop`` and ``closed_loop``, under ``direct``, or under ``dynamic`` and
            ``quasi_static``, without those of runs that did not begin or cannot be compared.
        figures_of_twin: Timing of the twin's loop, and the size of its mesh.

    Raises:
        RecordError: A run has no samples that can be compared.
    """
    figures = {name: tracking_figures(name, record) for name, record in runs.items()}
    ratio = None
    if "open_loop" in figures and "closed_loop" in figures:
        ratio = figures["closed_loop"]["mean_error_mm"] / figures["open_loop"]["mean_error_mm"]
    return {
        "robot": robot,
        **{name: None for name in ("open_loop", "closed_loop", "direct", "dynamic", "quasi_static")}, **figures,
        "closed_to_open_ratio": ratio,
        "published_open_loop_error_mm": PUBLISHED_ERRORS_MM.get(robot),
        **figures_of_twin,
        "versions": versions(),
        "machine": machine(),
    }


def write_report(path: Path, report: dict) -> None:
    """Writes a report as JSON.

    Args:
        path: The file.
        report: Names and values, without NaN.

    Raises:
        OutputError: The file cannot be written.
    """
    with writing(path):
        path.write_text(json.dumps(report, indent=2, allow_nan=False) + "\n", encoding="utf-8")


_RUN_COLOURS = {"open_loop": "#d95f02", "closed_loop": "#1b6ca8", "direct": "#1b6ca8",
                "quasi_static": "#d95f02", "dynamic": "#1b6ca8", "before": "#d95f02", "after": "#1b6ca8"}
_RUN_LABELS = {"open_loop": "open loop", "closed_loop": "closed loop", "direct": "commands",
               "quasi_static": "as if it stood", "dynamic": "by prediction",
               "before": "before the calibration", "after": "after it"}
_TARGET_COLOUR = "#222222"
_TWIN_COLOUR = "#7fa87f"
_ACTUATOR_COLOURS = ("#1b6ca8", "#d95f02", "#3a8f5c", "#a03b76",
                  "#c79a00", "#5f5aa2", "#7a5230", "#4d4d4d", "#0aa3a3", "#d0407a")


def draw_tracking(robot: str, runs: dict[str, TrackingRecord], path: Path) -> None:
    """Draws all runs of a demo and writes the picture.

    Args:
        robot: Name of the robot, for the title.
        runs: Records under ``open_loop`` and ``closed_loop``, or ``direct``; at least one of them.
        path: Picture to write; its suffix determines the format.

    Raises:
        MissingExtraError: matplotlib is not installed.
        OutputError: The picture cannot be written.
    """
    title = f"{robot}: a simulated device driven through the twin"
    with figure_file(path, (12.0, 11.5), title) as figure:
        draw_panels(figure, runs)


def draw_panels(figure, runs: dict[str, TrackingRecord]) -> None:
    """Draws the panels of `draw_tracking` on a figure.

    Args:
        figure: A matplotlib figure.
        runs: Record of each run, by its name.
    """
    grid = figure.add_gridspec(3, 2, height_ratios=(1.25, 0.8, 0.9))
    _draw_path_from_above(figure.add_subplot(grid[0, 0]), runs)
    _draw_path_from_the_side(figure.add_subplot(grid[0, 1]), runs)
    _draw_errors(figure.add_subplot(grid[1, :]), runs)
    _draw_actuators(figure.add_subplot(grid[2, 0]), runs, "setpoint",
                    "Commanded change of setpoints", "change from the start", from_start=True)
    _draw_actuators(figure.add_subplot(grid[2, 1]), runs, "effort", "Efforts of the twin", "effort")


# Width of a panel of a half and of the whole width [inch].
_HALF, _WHOLE = 5.2, 11.0


def _draw_path_from_above(axes, runs: dict[str, TrackingRecord]) -> None:
    _draw_path(axes, runs, (0, 1))
    axes.set(title="Path of the effector, from above")
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.12)
    legend_below(axes, _HALF)


def _draw_path_from_the_side(axes, runs: dict[str, TrackingRecord]) -> None:
    """Draws the path from the side, with heights enlarged so that a sag of 1 mm is visible."""
    _draw_path(axes, runs, (0, 2))
    axes.set(title="Path of the effector, from the side (heights enlarged)")
    low, high = axes.get_ylim()
    spare = max(0.0, 4.0 - (high - low)) / 2.0
    axes.set_ylim(low - spare, high + spare)


def _draw_path(axes, runs: dict[str, TrackingRecord], plane: tuple[int, int]) -> None:
    """Twin, device and, where there is one, the target in one plane of space."""
    for run, record in runs.items():
        axes.plot(*_millimetres(record.device, plane), color=_RUN_COLOURS[run], linewidth=1.5,
                  label=f"device, {_RUN_LABELS[run]}")
    last = list(runs.values())[-1]
    axes.plot(*_millimetres(last.twin, plane), color=_TWIN_COLOUR, linewidth=1.2,
              label=f"twin, {_RUN_LABELS[list(runs)[-1]]}")
    if last.target is not None:
        axes.plot(*_millimetres(last.target, plane), color=_TARGET_COLOUR, linewidth=1.1,
                  linestyle=(0, (4, 2)), label="target")
    across, upward = ("xyz"[axis] for axis in plane)
    axes.set(xlabel=f"{across} [mm]", ylabel=f"{upward} [mm]")


def _millimetres(samples: TimedValues, plane: tuple[int, int]) -> np.ndarray:
    return 1e3 * samples.values[:, plane].T


def _draw_errors(axes, runs: dict[str, TrackingRecord]) -> None:
    """Distance of the device from its reference at the same moment, and its mean."""
    for run, record in runs.items():
        errors = distances(record.reference, record.device)
        if not len(errors.times):
            continue
        mean = 1e3 * float(errors.values.mean())
        axes.plot(errors.times - record.reference.times[0], 1e3 * errors.values[:, 0],
                  color=_RUN_COLOURS[run], linewidth=1.2,
                  label=f"{_RUN_LABELS[run]}, mean {mean:.2f} mm")
        axes.axhline(mean, color=_RUN_COLOURS[run], linewidth=0.9, linestyle=(0, (2, 2)))
    axes.set(xlabel="time [s]", ylabel="distance [mm]",
             title="The device's effector against the twin's" if record.target is None
             else "Tracking error: the device's effector against the target")
    axes.set_ylim(bottom=0.0)
    axes.margins(x=0.01)
    legend_below(axes, _WHOLE)


def _draw_actuators(axes, runs: dict[str, TrackingRecord], quantity: str, title: str, label: str,
                    from_start: bool = False) -> None:
    """Draws one line for each actuator: the last run solid, the run before it dotted.

    One unit stands at the axis; several stand in the legend.
    """
    styles = [(0, (1, 1.5)), "solid"][-len(runs):]
    start = getattr(next(iter(runs.values())), f"{quantity}s").values[:1]
    first = start if from_start and len(start) else 0.0
    for style, (run, record) in zip(styles, runs.items()):
        samples = getattr(record, f"{quantity}s")
        units = [SHOWN.get(unit, (1.0, unit)) for unit in getattr(record, f"{quantity}_units")]
        values = [factor for factor, _ in units] * (samples.values - first)
        is_common = len({unit for _, unit in units}) == 1
        for index, name in enumerate(record.actuator_names):
            name = name if is_common else f"{name} [{units[index][1]}]"
            axes.plot(samples.times - record.reference.times[0], values[:, index],
                      color=_ACTUATOR_COLOURS[index % len(_ACTUATOR_COLOURS)], linestyle=style,
                      linewidth=1.3 if style == "solid" else 1.0,
                      label=name if style == "solid" else None)
    note = f" (dotted: {_RUN_LABELS[next(iter(runs))]})" if len(runs) > 1 else ""
    unit = f" [{units[0][1]}]" if is_common else ""
    axes.set(xlabel=f"time [s]{note}", ylabel=f"{label}{unit}", title=title)
    axes.margins(x=0.01)
    legend_below(axes, _HALF)
