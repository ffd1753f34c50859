"""What happened since it was last told: the worst of each kind, not only the newest."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from softrobot_twin.control.tick_outcome import TickOutcome
from softrobot_twin.simulation import Status, StepResult

_BY_GRAVITY = (
    Status.OK,
    Status.RATE_LIMITED,
    Status.UNREACHABLE,
    Status.SATURATED,
    Status.NOT_CONVERGED,
    Status.INVERTED,
    Status.UNSOLVED,
    Status.DIVERGED,
)


class Tally:
    """Sums up ticks between two reports. Its size is bounded by the scene, not by the run.

    Attributes:
        newest: The last tick, or None.
        ticks: Ticks since the last report.
        worst: The gravest status among them.
        residual_max: Largest residual [N].
        iterations_max: Most linearizations in one step.
        linearization_error_max: Largest estimate of what a step left of the effectors' way [m].
        overloaded: Ticks that kept a stale factor to be on time.
        projected: Ticks whose exact tangent was indefinite, so that its projection stood in.
        qp_solvers: Names of the solvers that answered the inverse problem.
        stage_maxima: Longest time of each stage [s].
        limits: Names of the limits that were active.
        blocked: Commands that the last gate kept back.
        violated: Limits that those broke.
        causes: Why ticks held or published nothing, with how many did.
        tracking_error_max: Largest distance of an effector from its target [m]; NaN without one.
        left_out: Ticks in which each marker was left out as implausible, by its id.
        contact_count_max: Most contacts that carried force at once.
        contact_sweeps_max: Most sweeps of the contact solver in one linearization; where targets
            are followed in contact, most programs.
        contact_residual_max: How exactly gaps and sticking were solved, at worst [m].
        contact_force_residual_max: The same in forces [N].
        overlap_max: How deep bodies overlapped, at worst [m].
        contact_forces: Largest force of one contact on each pair that touched [N], by the names
            of both.
    """

    def __init__(self) -> None:
        self.newest: TickOutcome | None = None
        self.clear()

    def clear(self) -> None:
        """Begins anew; the newest tick stays known."""
        self.ticks = self.blocked = self.iterations_max = 0
        self.overloaded = self.projected = 0
        self.qp_solvers: set[str] = set()
        self.linearization_error_max = 0.0
        self.worst = Status.OK
        self.residual_max = 0.0
        self.stage_maxima: dict[str, float] = {}
        self.limits: set[str] = set()
        self.violated: set[str] = set()
        self.causes: dict[str, int] = {}
        self.tracking_error_max = float("nan")
        self.left_out: dict[int, int] = {}
        self.contact_count_max = self.contact_sweeps_max = 0
        self.contact_residual_max = self.contact_force_residual_max = self.overlap_max = 0.0
        self.contact_forces: dict[tuple[str, str], float] = {}

    def add(self, outcome: TickOutcome) -> None:
        """Adds a tick."""
        self.newest = outcome
        self.ticks += 1
        result, report = outcome.result, outcome.result.report
        if _BY_GRAVITY.index(result.status) > _BY_GRAVITY.index(self.worst):
            self.worst = result.status
        # Unlike max, this lets a residual that is not a number win.
        self.residual_max = float(np.maximum(self.residual_max, report.residual))
        self.iterations_max = max(self.iterations_max, report.iterations)
        error = report.linearization_error
        self.linearization_error_max = float(np.fmax(self.linearization_error_max, error))
        self.overloaded += report.is_overloaded
        self.projected += report.projected_tangent
        if report.qp_solver:
            self.qp_solvers.add(report.qp_solver)
        self._add_stages(report.stage_times)
        self.limits.update(report.active_limits)
        self.violated.update(outcome.violated)
        self.blocked += bool(outcome.violated)
        if result.contacts is not None:
            self._add_contacts(result)
        errors = outcome.tracking_errors
        worst = float(np.fmax.reduce(errors, initial=float("nan")))
        self.tracking_error_max = float(np.fmax(self.tracking_error_max, worst))
        for marker in outcome.left_out:
            self.left_out[marker] = self.left_out.get(marker, 0) + 1
        if outcome.cause:
            self.causes[outcome.cause] = self.causes.get(outcome.cause, 0) + 1

    def _add_stages(self, stage_times: Mapping[str, float]) -> None:
        for stage, time in stage_times.items():
            self.stage_maxima[stage] = max(time, self.stage_maxima.get(stage, 0.0))

    def _add_contacts(self, result: StepResult) -> None:
        report = result.report
        self.contact_count_max = max(self.contact_count_max, report.contact_count)
        self.contact_sweeps_max = max(self.contact_sweeps_max, report.contact_sweeps)
        self.contact_residual_max = float(
            np.maximum(self.contact_residual_max, report.contact_residual)
        )
        self.contact_force_residual_max = float(
            np.maximum(self.contact_force_residual_max, report.contact_force_residual)
        )
        contacts = result.contacts
        self.overlap_max = max(self.overlap_max, float(-contacts.gaps.min(initial=0.0)))
        forces = np.linalg.norm(contacts.forces, axis=1)
        for pair in np.unique(contacts.pairs):
            names, force = contacts.names[pair], float(forces[contacts.pairs == pair].max())
            self.contact_forces[names] = max(force, self.contact_forces.get(names, 0.0))
