"""Measured sizes as a CSV file: one row for each stage of each size."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from softrobot_twin.study.bench.bench_tables import exponent, families_of
from softrobot_twin.study.bench.size_measurement import SizeMeasurement
from softrobot_twin.study.reports.output_error import OutputError

COLUMNS = (
    "scene", "family", "nodes", "tets", "dof", "rows", "contacts", "factorization", "steps",
    "stage", "median_ms",
    "p99_ms", "max_ms", "ratio_to_superlu", "growth_exponent", "superlu_ms", "superlu_samples",
    "superlu_page_faults",
    "interrupted_share",
    "factor_flop", "solves_flop", "dgemm_flop_per_s", "share_of_dgemm_speed", "factor_bytes",
    "resident_bytes",
)


def write_bench(path: Path, sizes: Sequence[SizeMeasurement]) -> None:
    """Writes all sizes; what is not known is left empty.

    Raises:
        OutputError: The file cannot be written.
    """
    families = families_of(sizes)
    try:
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(COLUMNS)
            for size in sizes:
                for stage in size.stages:
                    growth = exponent(families[size.case.family], stage)
                    writer.writerow(map(_cell, _row(size, stage, growth)))
    except OSError as error:
        raise OutputError(path, error.strerror or str(error)) from error


def _row(size: SizeMeasurement, stage: str, growth: float) -> tuple:
    times, flops = size.stages[stage], size.flops
    return (
        size.case.name, size.case.family, size.node_count, size.tet_count, size.dof_count,
        size.row_count, size.contact_count, size.factorization, size.step_count, stage,
        1e3 * times.median, 1e3 * times.p99,
        1e3 * times.maximum, times.median / size.superlu.median, growth,
        1e3 * size.superlu.median, size.superlu_count, size.superlu_page_faults,
        size.interrupted_share,
        flops and flops.factor,
        flops and flops.solves, size.dense_speed, size.share_of_dense_speed, size.factor_bytes,
        size.resident,
    )


def _cell(value) -> str:
    if value is None or (isinstance(value, float) and not np.isfinite(value)):
        return ""
    return f"{value:.6g}" if isinstance(value, float) else str(value)
