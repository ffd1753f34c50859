"""A summary of the ticks since the last diagnostics message: maxima, counts and names."""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from operator import attrgetter

import numpy as np

from softrobot_twin.control.twin_loop import TickOutcome
from softrobot_twin.simulation import Status, StepResult
from softrobot_twin.simulation.result import StrainOutside

_SEVERITY = {status: place for place, status in enumerate(Status)}
"""Statuses are told in the order of their severity."""


_LARGEST = {
    "residual": True, "iterations": False, "contact_count": False, "contact_sweeps": False,
    "contact_residual": True, "contact_force_residual": True,
    "linearization_error": False,  # A NaN tells that there are no effectors.
}  # fmt: skip
"""Fields of the reports of steps whose largest value is told, and whether NaN is larger than all."""
_LARGEST_OF = attrgetter(*_LARGEST)


class DiagnosticsWindow:
    """Summarises the ticks between two diagnostics messages. The scene bounds its memory.

    Attributes:
        newest: The last tick, or None before the first.
        ticks: Number of ticks.
        resting: The part of them that made no step, because nothing would have changed.
        worst: Their most severe status.
        statuses: Number of ticks of each status, by its word.
        largest: Largest value of fields of `StepReport`, by their names; where targets are followed
            in contact, ``contact_sweeps`` are quadratic programs of one linearization.
        overloaded: Ticks without time for a linearization before the deadline.
        late: The part of these ticks that made a complete linearization and ended late.
        projected: Ticks whose exact tangent was indefinite, so that its projection was used.
        qp_solvers: Names of the solvers that solved the inverse problem.
        stage_maxima: Longest duration of each stage [s].
        limits: Names of the limits that were active.
        strains: The last strain of each material beyond the range of its law, by its key.
        blocked: Number of commands that the gate rejected.
        violated: Limits that these commands violated.
        causes: Number of ticks that held or published nothing, by cause.
        sources: Kinds of messages that moved a target last, as `TargetReading.source` tells them.
        source_changes: How often the kind changed from tick to tick.
        tracking_error_max: Largest distance of an effector from its target [m]; NaN without one.
        left_out: Number of ticks in which a marker was left out as implausible, by its id.
        overlap_max: Greatest depth of overlap of two bodies [m].
        contact_forces: Largest force of one contact of each pair that touched [N], by both
            names.
        contact_resultants: Largest resultant on the first body of each pair [N], shape (3,).
        contact_magnitude_sums: Largest sum of the forces' magnitudes of each pair [N].
    """

    def __init__(self) -> None:
        self.newest: TickOutcome | None = None
        self.clear()

    def clear(self) -> None:
        """Starts a new window; the newest tick is kept."""
        self.ticks = self.resting = self.blocked = self.source_changes = 0
        self.overloaded = self.late = self.projected = 0
        self.largest: dict[str, float] = dict.fromkeys(_LARGEST, 0)
        self.worst, self.tracking_error_max, self.overlap_max = Status.OK, float("nan"), 0.0
        self.qp_solvers, self.limits, self.violated, self.sources = (set[str]() for _ in range(4))
        self.statuses, self.causes, self.left_out = Counter[str](), Counter[str](), Counter[int]()
        self.strains: dict[str, StrainOutside] = {}
        self.stage_maxima: dict[str, float] = defaultdict(float)
        self.contact_forces: dict[tuple[str, str], float] = defaultdict(float)
        self.contact_resultants: dict[tuple[str, str], np.ndarray] = {}
        self.contact_magnitude_sums: dict[tuple[str, str], float] = defaultdict(float)

    def add(self, outcome: TickOutcome) -> None:
        """Adds a tick.

        Args:
            outcome: What the tick told.
        """
        source = outcome.reading.source
        self.source_changes += self.newest is not None and self.newest.reading.source != source
        self.sources.add(source)
        self.add_again(outcome)
        result, report = outcome.result, outcome.result.report
        if result.status is not self.worst:
            self.worst = max(self.worst, result.status, key=_SEVERITY.__getitem__)
        for (field, tells_nan), before, value in zip(
            _LARGEST.items(), self.largest.values(), _LARGEST_OF(report)
        ):
            if value > before or (tells_nan and value != value):
                self.largest[field] = value
        self.overloaded += report.is_overloaded
        self.late += report.is_late
        self.projected += report.projected_tangent
        if report.qp_solver:
            self.qp_solvers.add(report.qp_solver)
        for stage, time in report.stage_times.items():
            if time > self.stage_maxima[stage]:
                self.stage_maxima[stage] = time
        self.limits.update(report.active_limits)
        if report.strains:
            self.strains |= {outside.key: outside for outside in report.strains}
        self.violated.update(outcome.violated)
        self.blocked += bool(outcome.violated)
        if result.contacts is not None:
            self._add_contacts(result)
        for error in outcome.tracking_errors.tolist():
            if not error <= self.tracking_error_max and not math.isnan(error):
                self.tracking_error_max = error
        if outcome.left_out:
            self.left_out.update(outcome.left_out)

    def add_again(self, outcome: TickOutcome) -> None:
        """Adds a tick that repeats one of this window: only what is counted changes.

        Args:
            outcome: What the tick told.
        """
        self.newest = outcome
        self.ticks += 1
        self.resting += outcome.result.report.is_resting
        self.statuses[outcome.result.status._value_] += 1  # As `value`, which takes two calls.
        if outcome.cause:
            self.causes[outcome.cause] += 1

    def _add_contacts(self, result: StepResult) -> None:
        contacts = result.contacts
        self.overlap_max = max(self.overlap_max, float(-contacts.gaps.min(initial=0.0)))
        forces = np.linalg.norm(contacts.forces, axis=1)
        for pair in np.unique(contacts.pairs):
            names, force = contacts.names[pair], float(forces[contacts.pairs == pair].max())
            self.contact_forces[names] = max(force, self.contact_forces[names])
        of_pairs = contacts.of_pairs()
        for names, resultant, magnitudes in zip(*of_pairs, strict=True):
            if magnitudes == 0.0:
                continue
            before = self.contact_magnitude_sums[names]
            self.contact_magnitude_sums[names] = max(float(magnitudes), before)
            largest = self.contact_resultants.setdefault(names, resultant)
            if resultant @ resultant > largest @ largest:
                self.contact_resultants[names] = resultant
