"""A demo in numbers: how far off open and closed loop, how long a step takes, on what machine."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from softrobot_twin.study.reports.machine_facts import machine, versions
from softrobot_twin.study.reports.output_error import OutputError
from softrobot_twin.study.reports.tracking_record import RecordError, TrackingRecord, distances

PUBLISHED_ERRORS_MM = {
    "diamond": {"mean": 1.4, "max": 2.9},
    "trunk": {"mean": 4.72, "max": None},
}
"""Errors of real robots, driven open loop, in the paper (Coevoet 2017, section 7.2) [mm]. Paths,
silicone and measurement were others: they are told beside ours, and compared with nothing."""


@dataclass(frozen=True)
class LoopFigures:
    """How the twin's loop went, over all runs.

    Attributes:
        compute_time_median: Median time of a tick's work [s]; None when nobody told.
        compute_time_p99: 99th percentile [s].
        compute_time_max: Longest [s].
        period: Asked time between ticks [s].
        ticks: Ticks done.
        missed_ticks: Ticks that were not done in time.
        skipped_ticks: Ticks left out because the one before took so long.
    """

    compute_time_median: float | None
    compute_time_p99: float | None
    compute_time_max: float | None
    period: float
    ticks: int
    missed_ticks: int
    skipped_ticks: int


@dataclass(frozen=True)
class MeshFigures:
    """Size of the twin's mesh."""

    nodes: int
    tets: int
    dof: int


def tracking_figures(name: str, record: TrackingRecord) -> dict[str, float | int]:
    """Errors of one run [mm]: the device against the target, and the twin against the device.

    Raises:
        RecordError: No sample of the device falls into the time of the target.
    """
    errors = 1e3 * distances(record.target, record.device).values[:, 0]
    if not errors.size:
        raise RecordError(name, "the device was never seen while a target was set")
    misfit = 1e3 * distances(record.twin, record.device).values[:, 0]
    return {
        "mean_error_mm": float(errors.mean()),
        "max_error_mm": float(errors.max()),
        "mean_twin_misfit_mm": float(misfit.mean()) if misfit.size else None,
        "samples": int(errors.size),
        "seconds": float(np.ptp(record.target.times)),
    }


def tracking_report(robot: str, runs: dict[str, TrackingRecord], loop: LoopFigures,
                    mesh: MeshFigures) -> dict:
    """The report of a demo; plain numbers and text, ready for JSON.

    Args:
        robot: Name of the robot.
        runs: Records under ``open_loop`` and ``closed_loop``; a demo that was broken off may lack
            the second.
        loop: How the twin's loop went.
        mesh: Size of the twin's mesh.

    Raises:
        RecordError: A run holds nothing to compare.
    """
    figures = {name: tracking_figures(name, record) for name, record in runs.items()}
    ratio = None
    if "open_loop" in figures and "closed_loop" in figures:
        ratio = figures["closed_loop"]["mean_error_mm"] / figures["open_loop"]["mean_error_mm"]
    return {
        "robot": robot,
        "open_loop": figures.get("open_loop"),
        "closed_loop": figures.get("closed_loop"),
        "closed_to_open_ratio": ratio,
        "published_open_loop_error_mm": PUBLISHED_ERRORS_MM.get(robot),
        "compute_time_ms": {"median": _milliseconds(loop.compute_time_median),
                            "p99": _milliseconds(loop.compute_time_p99),
                            "max": _milliseconds(loop.compute_time_max)},
        "period_ms": 1e3 * loop.period,
        "ticks": loop.ticks,
        "missed_ticks": loop.missed_ticks,
        "skipped_ticks": loop.skipped_ticks,
        "mesh": {"nodes": mesh.nodes, "tets": mesh.cells, "dof": mesh.dof},
        "versions": versions(),
        "machine": machine(),
    }


def write_report(path: Path, report: dict) -> None:
    """Writes a report as JSON.

    Raises:
        OutputError: The file cannot be written.
    """
    try:
        path.write_text(json.dumps(report, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    except OSError as error:
        raise OutputError(path, error.strerror or str(error)) from error


def _milliseconds(seconds: float | None) -> float | None:
    return None if seconds is None else 1e3 * seconds
