"""Stiffness that a fingertip felt in its presses, against the wanted one."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from softrobot_twin.harness.figure import figure_file
from softrobot_twin.study.tracking import TimedValues

_LEAST_SHARE = 0.5
"""A press that reaches less than this share of the deepest one was cut off, and is left out."""


class Press(NamedTuple):
    """One press.

    Attributes:
        time: When it began [s].
        depths: Displacement of the touched point along the press [m], shape (n,).
        forces: Force on the robot along it [N], same shape.
    """

    time: float
    depths: np.ndarray
    forces: np.ndarray

    @property
    def stiffness(self) -> float:
        """Force by depth where it is deepest [N/m]."""
        deepest = int(np.argmax(self.depths))
        return float(self.forces[deepest] / self.depths[deepest])


def presses_of(touch: TimedValues) -> list[Press]:
    """Presses in what was recorded of a touch.

    Args:
        touch: Displacements [m] and forces [N], each row six numbers.
    """
    if not len(touch.times):
        return []
    moves, forces = touch.values[:, :3], touch.values[:, 3:]
    sizes = np.linalg.norm(moves, axis=1)
    if not sizes.any():
        return []
    along = moves[int(np.argmax(sizes))] / sizes.max()
    edges = np.flatnonzero(np.diff(np.concatenate([[0], (sizes > 0.0).astype(int), [0]])))
    found = [
        Press(float(touch.times[first]), moves[first:last] @ along, forces[first:last] @ along)
        for first, last in edges.reshape(-1, 2)
    ]
    return [press for press in found if press.depths.max() >= _LEAST_SHARE * sizes.max()]


def untouched(values: TimedValues, touch: TimedValues) -> TimedValues:
    """The values at times at which the last record of a touch shows none.

    Args:
        values: Any values.
        touch: See `presses_of`.
    """
    if not len(touch.times):
        return values
    is_touched = np.any(touch.values != 0.0, axis=1)
    last = np.searchsorted(touch.times, values.times, side="right") - 1
    kept = (last < 0) | ~is_touched[np.maximum(last, 0)]
    return TimedValues(values.times[kept], values.values[kept])


def touch_report(device: TimedValues, twin: TimedValues, wanted: TimedValues) -> dict | None:
    """Stiffnesses that were felt, for a demo's report.

    Args:
        device: The touch as sensors of the device measured it; see `presses_of`.
        twin: The same as the twin answered.
        wanted: Wanted stiffnesses along x, y and z [N/m], NaN where free; may be empty.

    Returns:
        For each press when it began, the wanted stiffness then, and the felt ones of device and
        twin; NaN becomes None. None without a press.
    """
    presses = presses_of(device)
    if not presses:
        return None
    rows = []
    of_twin = presses_of(twin)
    for press in presses:
        target = _wanted_at(wanted, press.time)
        nearest = min(of_twin, key=lambda one: abs(one.time - press.time), default=None)
        felt = None if nearest is None else nearest.stiffness
        rows.append((press.time - presses[0].time, target, press.stiffness, felt))
    errors = [abs(felt / target - 1.0) for _, target, felt, _ in rows if target is not None]
    return {
        "presses": [
            dict(zip(("time_s", "target_n_per_m", "device_n_per_m", "twin_n_per_m"), row))
            for row in rows
        ],
        "median_error_percent": 100.0 * float(np.median(errors)) if errors else None,
        "max_error_percent": 100.0 * max(errors) if errors else None,
    }


def _wanted_at(wanted: TimedValues, time: float) -> float | None:
    """The wanted stiffness at a time along the one axis that has one; None without."""
    if not len(wanted.times):
        return None
    row = wanted.values[max(0, int(np.searchsorted(wanted.times, time, side="right")) - 1)]
    given = row[np.isfinite(row)]
    return float(given[0]) if len(given) == 1 else None


def draw_presses(robot: str, device: TimedValues, wanted: TimedValues, path: Path) -> None:
    """Draws force over depth of each press, and the wanted stiffness as a line.

    Args:
        robot: Name of the robot.
        device: The touch as sensors of the device measured it; see `presses_of`.
        wanted: Wanted stiffnesses [N/m]; see `touch_report`.
        path: Picture to write.
    """
    presses = presses_of(device)
    title = f"{robot}: presses on the device, open loop"
    with figure_file(path, (7.0, 5.0), title) as figure:
        plot = figure.subplots()
        for index, press in enumerate(presses):
            colour = f"C{index % 10}"
            plot.plot(1e3 * press.depths, press.forces, ".-", ms=3, lw=1.0, color=colour)
            target = _wanted_at(wanted, press.time)
            if target is not None:
                deepest = press.depths.max()
                plot.plot([0.0, 1e3 * deepest], [0.0, target * deepest], "--", lw=0.8, color=colour,
                          label=f"wanted {target:.0f}, felt {press.stiffness:.0f} N/m")
        plot.set_xlabel("depth [mm]")
        plot.set_ylabel("force [N]")
        if presses:
            plot.legend(fontsize=7)
