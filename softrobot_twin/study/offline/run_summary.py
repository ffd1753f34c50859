"""A run in a few numbers: how far off, how long a step took, how the steps ended."""

from __future__ import annotations

from collections import Counter
from typing import NamedTuple

import numpy as np

from softrobot_twin.study.offline.offline_run import RunRow


class Spread(NamedTuple):
    """Middle and tail of a set of numbers, in their unit."""

    median: float
    p99: float
    maximum: float


def spread(values: np.ndarray) -> Spread:
    """Median, 99th percentile and maximum over the finite values; NaN when there is none."""
    finite = np.asarray(values, dtype=float)
    finite = finite[np.isfinite(finite)]
    if not finite.size:
        return Spread(np.nan, np.nan, np.nan)
    return Spread(float(np.median(finite)), float(np.percentile(finite, 99.0)),
                  float(finite.max()))


class RunSummary:
    """Gathers rows as they come; keeps two numbers a row and no state."""

    def __init__(self) -> None:
        self._errors: list[np.ndarray] = []
        self._compute_times: list[float] = []
        self.statuses: Counter[str] = Counter()
        self._residual = 0.0

    def add(self, row: RunRow) -> None:
        """Counts one row."""
        self._errors.append(row.result.effector_errors)
        self._compute_times.append(row.result.report.compute_time)
        self.statuses[row.result.status.value] += 1
        self._residual = float(np.fmax(self._residual, row.result.report.residual))

    def lines(self) -> list[tuple[str, str]]:
        """What was found, as name and value with its unit."""
        compute = spread(1e3 * np.array(self._compute_times))
        lines = [("rows", str(len(self._errors)))]
        errors = 1e3 * np.concatenate(self._errors) if self._errors else np.empty(0)
        errors = errors[np.isfinite(errors)]
        if errors.size:
            lines += [("tracking error, mean", f"{errors.mean():.4f} mm"),
                      ("tracking error, max", f"{errors.max():.4f} mm")]
        lines += [("residual, max", f"{self._residual:.2g} N"),
                  ("compute time, median", f"{compute.median:.2f} ms"),
                  ("compute time, p99", f"{compute.p99:.2f} ms"),
                  ("compute time, max", f"{compute.maximum:.2f} ms")]
        lines += [(f"status {name}", f"{count} rows")
                  for name, count in sorted(self.statuses.items())]
        return lines
