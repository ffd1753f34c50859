"""What is printed after a run: only what its scene and the way it was driven call for."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence

import numpy as np

from softrobot_twin.harness.length_units import SHOWN
from softrobot_twin.harness.terminal import by_key
from softrobot_twin.harness.timing import spread
from softrobot_twin.simulation import CommandEfforts, CommandSetpoints, Simulation, Status
from softrobot_twin.simulation.building.actuator_kinds import ActuatorKind, Quantity
from softrobot_twin.tables.run_columns import RunRow, pair_names, rigid_poses

_SHOWN = 6
"""Most rows of things that are alike; more are put together."""

BAD_END = 3
"""Exit code of a run whose last row is not good."""
_BAD_ENDS = (Status.NOT_CONVERGED.value, Status.INVERTED.value)


# What a summary needs of a row, of its result and of the report; the state and the command, which
# are large, are of no use here.
_OF_ROW = ("time", "rigid_poses", "pair_resultants", "pair_magnitude_sums", "reduction_errors")
_OF_RESULT = ("effector_positions", "effector_errors", "orientation_errors", "stiffness_errors",
              "displacements", "efforts")
_OF_REPORT = ("contact_count", "residual", "linearization_error", "compute_time")


class RunSummary:
    """Collects a few numbers of each row for a summary.

    Attributes:
        unit: What rows are called.
        statuses: Number of rows of each status.
        sampled_range: Largest share of the range of reduced bodies.
        failed: Number of rows without a solution.
        last_status: Status of the last row.
        not_followed: Number of rows in which actuators are at a limit, and not where they were commanded.
    """

    def __init__(self, simulation: Simulation, hold: tuple[float, float] = (math.nan, math.nan),
                 unit: str = "steps"):
        """Records the state before the run.

        Args:
            simulation: Heights are measured from its present state.
            hold: Start and end of the interval in which creep is measured [s]; NaN for none.
            unit: What rows are called.
        """
        self.unit, self._hold = unit, hold
        self._effectors = simulation.effector_names
        self._kinds, self._told = simulation.actuators.kind_of, simulation.actuators.told_efforts
        self._pairs = pair_names(simulation)
        self._free = [index for index, part in enumerate(simulation.model.rigid) if part.is_free]
        self._free_names = [simulation.model.rigid[index].name for index in self._free]
        gravity = np.array(simulation.scene.gravity)
        weight = np.linalg.norm(gravity)
        self._up = -gravity / weight if weight > 0.0 else np.array([0.0, 0.0, 1.0])
        self._before = rigid_poses(simulation)[self._free, :3]
        self._values: dict[str, list] = {name: [] for name in (*_OF_ROW, *_OF_RESULT, *_OF_REPORT)}
        self._limits: Counter[str] = Counter()
        self.statuses: Counter[str] = Counter()
        self.last_status, self.sampled_range = "", 0.0
        self.failed = self.not_followed = 0

    def add(self, row: RunRow) -> None:
        """Adds one row.

        Args:
            row: The row.
        """
        report = row.result.report
        for source, names in ((row, _OF_ROW), (row.result, _OF_RESULT), (report, _OF_REPORT)):
            for name in names:
                self._values[name].append(getattr(source, name))
        self._limits.update(list(dict.fromkeys(report.active_limits)))
        self.sampled_range = max(self.sampled_range, report.sampled_range)
        self.last_status = row.result.status.value
        is_given = isinstance(row.command, CommandSetpoints | CommandEfforts)
        self.not_followed += is_given and row.result.status is Status.SATURATED
        self.statuses[self.last_status] += 1
        self.failed += row.result.status.is_failure

    @property
    def exit_code(self) -> int:
        """Exit code of the run: 1 where a row has no solution, `BAD_END` where the last row's state
        is not in balance or inside out, or in any row actuators are not where they were commanded, else 0."""
        if self.failed:
            return 1
        return BAD_END if self.last_status in _BAD_ENDS or self.not_followed else 0

    def _series(self, field: str) -> np.ndarray:
        """A field of all rows; empty where it is None."""
        values = self._values[field]
        return np.empty((0, 0)) if not values or values[0] is None else np.array(values)

    def heights(self) -> dict[str, tuple[float, float]]:
        """Greatest rise of each free body [m], and its time [s]."""
        places = self._series("rigid_poses")[:, self._free, :3]
        risen, times = (places - self._before) @ self._up, self._values["time"]
        return {name: (float(rise.max()), times[int(rise.argmax())])
                for name, rise in zip(self._free_names, risen.T, strict=True)}

    def creep(self) -> dict[str, float]:
        """Greatest distance of each body from its position at the start of the hold [m]; empty
        without a hold.

        Bodies are the free bodies or, if there are none, the effectors.
        """
        begin, end = self._hold
        times = self._series("time")
        held = np.flatnonzero((times > begin - 1e-9) & (times < end + 1e-9))
        if not held.size:
            return {}
        names = self._free_names
        places = self._series("rigid_poses")[:, self._free, :3]
        if not names:
            names, places = self._effectors, self._series("effector_positions")
        distances = np.linalg.norm(places[held] - places[held[0]], axis=2)
        return dict(zip(names, map(float, distances.max(axis=0)), strict=True))

    def lines(self) -> list[tuple[str, str]]:
        """The summary as names and values with units."""
        times = self._values["time"]
        if not times:
            return [(self.unit, "0")]
        return [(self.unit, f"{len(times)}, {times[-1]:.6g} s at their end"), *self._of_effectors(),
                *self._of_bodies(), *self._of_actuators(), *self._of_contacts(), *self._of_limits(),
                *self._of_steps()]

    def _of_effectors(self) -> list[tuple[str, str]]:
        """Errors of the effectors that have targets; else where they are at the end."""
        lines, times = [], self._values["time"]
        for field, word, factor, form in (
            ("effector_errors", "tracking error", 1e3, "{:.4f} mm"),
            ("orientation_errors", "orientation error", 180.0 / math.pi, "{:.4f}°"),
            ("stiffness_errors", "stiffness error", 100.0, "{:.3f} %"),
        ):
            series = factor * self._series(field)
            told = [(name, errors) for name, errors in zip(self._effectors, series.T)
                    if np.isfinite(errors).any()]
            if len(told) > _SHOWN:
                every = np.array([errors for _, errors in told])
                worst = told[int(np.nanmax(every, axis=1).argmax())][0]
                lines.append((f"{len(told)} effectors, {word}",
                              f"mean {form.format(np.nanmean(every))}, max "
                              f"{form.format(np.nanmax(every))} of {worst}"))
                continue
            lines += [(f"{name}, {word}", f"mean {form.format(np.nanmean(errors))}, max "
                       f"{form.format(np.nanmax(errors))} at "
                       f"{times[int(np.nanargmax(errors))]:g} s") for name, errors in told]
        if lines or len(self._effectors) > _SHOWN:
            return lines
        places = 1e3 * self._series("effector_positions")[-1] if self._effectors else ()
        return [(f"{name}, at the end", f"[{', '.join(f'{x:.5g}' for x in place)}] mm")
                for name, place in zip(self._effectors, places)]

    def _of_bodies(self) -> list[tuple[str, str]]:
        """How high free bodies rose, and how far they crept; of many the one that did most."""
        begin, end = self._hold
        lines = []
        for word, found in (
            ("highest", {name: (rise, f"{1e3 * rise:+.2f} mm at {time:.2f} s")
                         for name, (rise, time) in self.heights().items()}),
            ("creep while held", {name: (rise, f"{1e3 * rise:.3f} mm in {begin:g}..{end:g} s")
                                  for name, rise in self.creep().items()}),
        ):  # fmt: skip
            if len(found) > _SHOWN:
                most = max(found, key=lambda name: found[name][0])
                lines.append((f"{word} of {len(found)}", f"{most} {found[most][1]}"))
            else:
                lines += [(f"{name}, {word}", told) for name, (_, told) in found.items()]
        return lines

    def _of_actuators(self) -> list[tuple[str, str]]:
        """Ranges of displacement and effort of each actuator; those that are alike in one row."""
        displacements, efforts = self._series("displacements"), self._told(self._series("efforts"))
        alike: dict[tuple[str, str], list[str]] = {}
        names, of = tuple(self._kinds), tuple(self._kinds.values())
        for noun, places in by_key((kind.noun, index) for index, kind in enumerate(of)).items():
            if len(places) > _SHOWN:
                both = displacements[:, places], efforts[:, places]
                told = _ranges(of[places[0]], *both, [names[place] for place in places])
                alike[noun, told] = [f"{len(places)} {of[places[0]].section}"]
                continue
            for place in places:
                told = _ranges(of[place], displacements[:, [place]], efforts[:, [place]])
                alike.setdefault((noun, told), []).append(names[place])
        return [(", ".join(own), told) for (_, told), own in alike.items()]

    def _of_contacts(self) -> list[tuple[str, str]]:
        """Contacts of each pair that touched, the hardest first; nothing without contact."""
        if not self._pairs:
            return []
        resultants = np.linalg.norm(self._series("pair_resultants"), axis=2)
        sums = self._series("pair_magnitude_sums")
        lines = [("contacts, maximum", str(max(self._values["contact_count"])))]
        order = [index for index in np.argsort(-sums.max(axis=0), kind="stable")
                 if sums[:, index].any()]
        for index in sorted(order[:_SHOWN]):
            first, second = self._pairs[index]
            touched = sums[:, index] > 0.0
            whole, summed = resultants[touched, index], sums[touched, index]
            lines.append((f"force on {first} by {second}",
                          f"resultant median {np.median(whole):.3f} N, max "
                          f"{whole.max():.3f} N; sum of magnitudes median "
                          f"{np.median(summed):.3f} N, max {summed.max():.3f} N; "
                          f"touching in {100 * touched.mean():.0f} % of {self.unit}"))
        if len(order) > _SHOWN:
            lines.append((f"{len(order) - _SHOWN} more pairs that touched", "press less"))
        return lines

    def _of_limits(self) -> list[tuple[str, str]]:
        """Limits that were met, the most frequent first; nothing where none was."""
        met = self._limits.most_common()
        if not met:
            return []
        rows = len(self._values["time"])
        told = [f"{name} {_share(count, rows)}" for name, count in met[:_SHOWN]]
        more = f", and {len(met) - _SHOWN} more" if len(met) > _SHOWN else ""
        return [("limits met most", f"{', '.join(told)} of {self.unit}{more}")]

    def _of_steps(self) -> list[tuple[str, str]]:
        """Residual, error estimates, time and statuses."""
        compute = spread(1e3 * self._series("compute_time"))
        lines = [("residual, max", f"{_largest(self._series('residual')):.2g} N")]
        linearization = _largest(self._series("linearization_error"))
        if math.isfinite(linearization):
            lines.append(("linearization error, max", f"{1e3 * linearization:.2g} mm"))
        if self.sampled_range > 0.0:
            lines.append(("range of the training, max", f"{self.sampled_range:.2g} of it"))
        errors = self._series("reduction_errors")
        if errors.size:
            lines.append(("reduction error, max", f"{1e3 * _largest(errors):.3g} mm, estimated"))
        lines.append(("compute time", f"median {compute.median:.2f} ms, p99 {compute.p99:.2f} ms, "
                      f"max {compute.maximum:.2f} ms"))
        return lines + self._of_statuses()

    def _of_statuses(self) -> list[tuple[str, str]]:
        """How often each status came; of several, which one the run ended with."""
        lines = []
        for name, count in sorted(self.statuses.items()):
            is_last = len(self.statuses) > 1 and name == self.last_status
            end = ", the last too" if is_last else ""
            lines.append((f"status {name}", f"{count} {self.unit}{end}"))
        return lines


def _largest(values: np.ndarray) -> float:
    """The largest finite value; NaN without any."""
    finite = values[np.isfinite(values)]
    return float(finite.max()) if finite.size else math.nan


def _share(count: int, whole: int) -> str:
    percent = 100.0 * count / whole
    return f"{percent:.0f} %" if percent >= 1.0 else f"{percent:.1g} %"


def _ranges(
    kind: ActuatorKind, displacements: np.ndarray, efforts: np.ndarray, names: Sequence[str] = ()
) -> str:
    """Ranges of the displacement and the effort of actuators of a kind, as text.

    Args:
        kind: Their kind.
        displacements: Shape (row_count, count).
        efforts: Shape (row_count, count).
        names: Their names, to tell which has the largest value; empty for one actuator.
    """
    told = []
    for quantity, values in ((kind.displacement, displacements), (kind.effort, efforts)):
        # A slide has no effort, and a cavity without wall none.
        if not np.isfinite(values).any() or (quantity == kind.effort and not values.any()):
            continue
        most = f" of {names[int(np.nanmax(np.abs(values), axis=0).argmax())]}" if names else ""
        told.append(f"{told_range(quantity, values)}{most}")
    return ", ".join(told)


def told_range(quantity: Quantity, values: np.ndarray) -> str:
    """A quantity, its least and its greatest value with the unit that is told.

    Args:
        quantity: The quantity.
        values: In its unit; at least one is finite.
    """
    factor, unit = SHOWN.get(quantity.unit, (1.0, quantity.unit))
    low, high = factor * np.nanmin(values), factor * np.nanmax(values)
    # A rounding error is no displacement.
    rounding = 1e-9 * max(abs(low), abs(high), 1.0)
    low, high = (0.0 if abs(end) < rounding else end for end in (low, high))
    return f"{quantity.word} [{low:.3g}, {high:.3g}] {unit}"
