"""The twin's ``/diagnostics``: one status for each part, with the worst values since the last
message.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import TYPE_CHECKING, Protocol

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

from softrobot_twin.control.diagnostics_window import DiagnosticsWindow
from softrobot_twin.control.loop_settings import Mode, WhenLost
from softrobot_twin.control.loop_timing import TickClock
from softrobot_twin.control.mesh_error_watch import MeshErrorWatch
from softrobot_twin.control.reduction_error_watch import ReductionErrorWatch
from softrobot_twin.control.tracking_cause import tracking_cause, tracking_signs
from softrobot_twin.control.twin_loop import TwinLoop
from softrobot_twin.ros.thread_priority import ThreadPriority
from softrobot_twin.ros.ticking_node import Clash, publisher_names
from softrobot_twin.scene.schema import Contact
from softrobot_twin.simulation import Status
from softrobot_twin.simulation.building.actuators import Actuators
from softrobot_twin.simulation.effects.vertebrae_watch import LARGE_BY_SIZE, LARGE_SHARE
from softrobot_twin.simulation.result import RATE

if TYPE_CHECKING:
    from softrobot_twin.record.run_recorder import RunRecorder
    from softrobot_twin.ros.run_recording import RunRecording
    from softrobot_twin.ros.view_feed import ViewFeed


_MILLI = 1.0e3


_BY_TURNS = 3
"""So many changes of the kind of targets in a second are of two that send by turns."""
_EXCEEDED = ".force_limit_exceeded"


def contact_status(
    contact: Contact, window: DiagnosticsWindow, follows: bool
) -> tuple[bytes, str, dict[str, object]]:
    """Status of the contacts: their number, the forces of each pair, and the accuracy of the
    solution.

    Args:
        contact: The scene's entry, for its tolerance.
        window: The ticks since the last message.
        follows: True when targets are followed, so that contacts are part of the inverse problem.

    Returns:
        Level, a sentence and values.
    """
    if window.newest is None:
        return DiagnosticStatus.OK, "no tick yet", {}
    count = window.newest.result.report.contact_count
    values = {
        "count": count,
        "count_max": window.largest["contact_count"],
        "programs_max" if follows else "sweeps_max": window.largest["contact_sweeps"],
        "residual_mm": window.largest["contact_residual"] * _MILLI,
        "force_residual_n": window.largest["contact_force_residual"],
        "overlap_max_mm": window.overlap_max * _MILLI,
    }
    for (first, second), force in sorted(window.contact_forces.items()):
        pair = f"{first} by {second}"
        resultant = window.contact_resultants[first, second]
        values[f"resultant_max_n: on {pair}"] = " ".join(f"{value:.6g}" for value in resultant)
        values[f"sum_of_magnitudes_max_n: on {pair}"] = window.contact_magnitude_sums[first, second]
        values[f"one_contact_max_n: on {pair}"] = force
    given_up = sorted(name for name in window.limits if name.endswith(_EXCEEDED))
    if contact.force_limit is not None:
        values |= {"force_limit_n": contact.force_limit, "given_up": " ".join(given_up)}
    # The comparison is written so that a NaN counts as not solved.
    if not window.largest["contact_residual"] <= contact.tolerance:
        return DiagnosticStatus.WARN, "not solved to the tolerance", values
    if given_up:
        return DiagnosticStatus.WARN, f"given up: {', '.join(given_up)}", values
    return DiagnosticStatus.OK, f"contacts: {count}" if count else "no contact", values


OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR


def setpoint_differences(actuators: Actuators, differences: np.ndarray) -> dict[str, float]:
    """The largest difference of each quantity, by its word and unit: ``length_difference_mm``.

    Args:
        actuators: The actuators.
        differences: Sizes of the differences of their setpoints, shape (actuator_count,).
    """
    largest: dict[str, float] = {}
    for kind, difference in zip(actuators.kinds, differences.tolist(), strict=True):
        word, unit = kind.setpoint
        factor, unit = (_MILLI, "mm") if unit == "m" else (1.0, unit.lower())
        key = f"{word}_difference_{unit}"
        largest[key] = max(largest.get(key, 0.0), factor * difference)
    return largest


class RunningTwin(Protocol):
    """What diagnostics read of the node that runs the loop, a `TickingNode`; see there."""

    priority: ThreadPriority
    clock_steps: int
    last_clock_step: float
    failed_ticks: int
    failure: str
    refused_requests: int
    is_simulated_time: bool
    recording: RunRecording | None
    clashes: list[Clash]

    def get_fully_qualified_name(self) -> str: ...

    def topics_of_targets(self) -> Iterable[str]: ...


class TwinDiagnostics:
    """Writes one status for each part of the twin.

    Args:
        loop: The loop.
        clock: Its ticks.
        window: The ticks since the last message; the caller clears it.
        feed: Feed of the view, or None.
        mesh_error: Estimate of the discretization error, or None.
        node: The node that runs the loop, for its name, priority, clocks and topics; None for a
            loop without a node.
        reduction: Estimates errors of reduced bodies, or None.
    """

    def __init__(
        self, loop: TwinLoop, clock: TickClock, window: DiagnosticsWindow, feed: ViewFeed | None,
        mesh_error: MeshErrorWatch | None = None, node: RunningTwin | None = None,
        reduction: ReductionErrorWatch | None = None,
    ):
        self._loop, self._clock, self._window, self._feed = loop, clock, window, feed
        self._node = node
        # Names of diagnostics have no leading slash.
        self._name = "twin" if node is None else node.get_fully_qualified_name().lstrip("/")
        self._last_counts: dict[str, int] = {}
        self._late = 0
        self._mesh_error, self.reduction = mesh_error, reduction

    @property
    def discretization_error(self) -> float:
        """Newest estimate of the effectors' error due to the mesh [m]; NaN without one."""
        return float("nan") if self._mesh_error is None else self._mesh_error.newest

    def statuses(self, now: float) -> list[DiagnosticStatus]:
        """All statuses at a time on the clock of the ticks [s]."""
        parts = {
            "loop": self._of_loop(),
            "solver": self._of_solver(),
            "limits": self._of_limits(),
            "markers": self._of_markers(now),
            "device": self._of_device(now),
            "target": self._of_target(now),
            "view": self._of_view(),
        }
        if self._node is not None:
            parts["graph"] = self._of_graph(self._node)
        if self._node is not None and self._node.recording is not None:
            parts["record"] = self._of_record(self._node.recording.recorder)
        if (contact := self._loop.simulation.scene.contact) is not None:
            follows = self._loop.mode is Mode.INVERSE
            parts["contact"] = contact_status(contact, self._window, follows)
        if self._loop.touches.names:
            parts["touch"] = self._of_touches()
        name = self._loop.simulation.scene.name
        return [
            DiagnosticStatus(
                level=level, name=f"{self._name}: {part}", message=message, hardware_id=name,
                values=[KeyValue(key=key, value=_text(value)) for key, value in values.items()],
            )
            for part, (level, message, values) in parts.items()
        ]

    def _new(self, key: str, count: int) -> int:
        """Increase of a count since the last message."""
        grown = count - self._last_counts.get(key, 0)
        self._last_counts[key] = count
        return grown

    def _of_loop(self):
        clock, summary = self._clock, self._clock.statistics.summary()
        skipped = self._new("skipped", clock.skipped)
        missed = self._new("missed", clock.missed)
        self._late = skipped + missed
        level, message = OK, "on time"
        if skipped or missed:
            level = ERROR if skipped > self._window.ticks else WARN
            message = f"{missed} ticks missed, {skipped} skipped"
        values = {
            "rate_hz": 1.0 / clock.period,
            "period_ms": summary.period_mean * _MILLI,
            "period_max_ms": summary.period_max * _MILLI,
            "compute_p50_ms": summary.compute_p50 * _MILLI,
            "compute_p99_ms": summary.compute_p99 * _MILLI,
            "compute_max_ms": summary.compute_max * _MILLI,
            "ticks": clock.ticks,
            "missed": clock.missed,
            "skipped": clock.skipped,
        }
        return (level, message, values) if self._node is None else self._of_running(
            self._node, level, message, values
        )

    def _of_running(self, node: RunningTwin, level: bytes, message: str, values: dict):
        """Adds the values of the node to the loop's status: priority, clocks, refused requests."""
        if self._new("given_back", node.priority.times_given_back):
            level, message = max(level, WARN), f"{message}; priority {node.priority.state}"
        if self._new("clock_steps", node.clock_steps):
            direction = "ahead" if node.last_clock_step > 0.0 else "back"
            level = max(level, WARN)
            message = f"clock set {direction} by {abs(node.last_clock_step):.3f} s; {message}"
        if self._new("failed_ticks", node.failed_ticks):
            level, message = ERROR, f"{message}; a tick failed: {node.failure}"
        if self._new("refused_requests", node.refused_requests):
            level, message = max(level, WARN), f"{message}; a request was refused, see the log"
        return level, message, values | {
            "priority": node.priority.state,
            "clock_steps": node.clock_steps,
            "simulated_time": node.is_simulated_time,
            "refused_requests": node.refused_requests,
            "failed_ticks": node.failed_ticks,
        }

    def _of_solver(self):
        window, simulation = self._window, self._loop.simulation
        if window.newest is None:
            return OK, "no tick yet", {}
        level = OK if window.worst.is_success or window.worst is Status.RATE_LIMITED else WARN
        if window.worst.is_failure:
            level = ERROR
        values = {
            "activity": window.newest.activity.value,
            "status": window.newest.result.status.value,
            "worst_status": window.worst.value,
            "statuses": " ".join(f"{word}:{n}" for word, n in sorted(window.statuses.items())),
            "residual_n": window.largest["residual"],
            "iterations": window.largest["iterations"],
            "resting": window.resting,
            "linearization_error_mm": window.largest["linearization_error"] * _MILLI,
            "discretization_error_mm": self.discretization_error * _MILLI,
            **self._of_mesh(),
            "overloaded": window.overloaded,
            "late": window.late,
            "projected": window.projected,
            "qp_solver": " ".join(sorted(window.qp_solvers)),
        }
        reduced = simulation.reduction_state(with_errors=False)
        if self.reduction is not None and not simulation.falls_back:
            for name, state in self.reduction.states.items():
                reduced[name] = state._replace(range=reduced[name].range)
        for name, state in reduced.items():
            values |= {f"{name}_sampled_range": state.range,
                       f"{name}_reduction_error_mm": state.error * _MILLI,
                       f"{name}_reduction_error_percent": 100.0 * state.share,
                       f"{name}_measured_error_percent": 100.0 * state.measured_median,
                       f"{name}_measured_error_worst_percent": 100.0 * state.measured_worst}
        values |= self._of_full_model()
        for key, outside in window.strains.items():
            values |= {f"{key}_least_strain_percent": 100.0 * outside.least,
                       f"{key}_greatest_strain_percent": 100.0 * outside.greatest}
        for stage, time in window.stage_maxima.items():
            values[f"time_{stage}_ms"] = time * _MILLI
        values |= {"nodes": simulation.node_count, "dof": simulation.dof_count}
        if window.overloaded and level == OK:
            return WARN, f"overload: {window.overloaded} ticks without time to linearize", values
        doubts = [f"{name}: {state.doubt}" for name, state in reduced.items() if state.doubt]
        doubts += [wrong] if (wrong := self._wrong_bodies()) else []
        if doubts and level == OK:
            return WARN, "; ".join(doubts), values
        if window.strains and level == OK:
            words = "; ".join(outside.in_words() for outside in window.strains.values())
            return WARN, words, values
        message = window.worst.value
        if window.worst in (Status.LINEARIZED, Status.NOT_CONVERGED):
            message += f": residual {window.largest['residual']:.2g} N"
        return level, "; ".join([message, *doubts]), values

    def _of_mesh(self) -> dict[str, object]:
        """Estimated error of the mesh at rest [%], or the reason why it is not estimated."""
        watch = self._mesh_error
        if watch is None:
            return {"mesh_error": "not requested"}
        values: dict[str, object] = {"mesh_error": watch.cause or "estimated"}
        if watch.at_rest is None and not watch.cause:
            values["mesh_error"] = "waiting for idle time"
        if watch.at_rest is not None:
            own, better = watch.at_rest.own, watch.at_rest.quadratic
            values |= {
                "mesh_error_at_forces_percent": 100.0 * own.forces,
                "mesh_error_at_lengths_percent": 100.0 * own.lengths,
                "quadratic_error_at_forces_percent": 100.0 * better.forces,
                "quadratic_error_at_lengths_percent": 100.0 * better.lengths,
                "quadratic_step_ms": better.step_time * _MILLI,
            }
        return values

    def _of_full_model(self) -> dict[str, object]:
        """Distance of the effectors from those of the full model, or why it is not known."""
        watch = self.reduction
        if watch is None:
            return {}
        state = "compared" if watch.answers else "waiting for idle time"
        values: dict[str, object] = {"full_model": watch.cause or state}
        for name, error in watch.newest.items():
            values |= {f"{name}_full_model_error_mm": error.distance * _MILLI,
                       f"{name}_full_model_error_percent": 100.0 * error.share}
        return values

    def _wrong_bodies(self) -> str:
        """Reduced bodies that the full model finds far from where it has them, in words."""
        if self.reduction is None or self._loop.simulation.falls_back:
            return ""
        least = LARGE_BY_SIZE * self._loop.simulation.model.nodes.size
        return "; ".join(
            f"{name}: {error.distance * _MILLI:.2g} mm ({100.0 * error.share:.0f} % of the "
            "displacement) from the full model"
            for name, error in self.reduction.newest.items()
            if error.distance > least and error.share > LARGE_SHARE
        )

    def _of_touches(self):
        inputs, newest = self._loop.touches, self._window.newest
        if newest is None:
            return OK, "no tick yet", {}
        touches, values = newest.result.touches, {}
        for index, name in enumerate(inputs.names):
            force, displacement = touches.forces[index], touches.displacements[index]
            values[f"{name}_force_n"] = float(np.linalg.norm(force))
            values[f"{name}_displacement_mm"] = float(np.linalg.norm(displacement)) * _MILLI
        values |= {"timed_out": inputs.timed_out, **inputs.refusals.by_word()}
        if self._new("refused_touches", inputs.refusals.total):
            return WARN, "a measured touch was refused", values
        touched = [n for n, acts in zip(inputs.names, touches.is_touched, strict=True) if acts]
        return OK, f"touched: {', '.join(touched)}" if touched else "not touched", values

    def _of_limits(self):
        window = self._window
        names = sorted(window.limits)
        values = {
            "active": " ".join(names), "kept_back": window.blocked, **self._of_pressures(),
        }  # fmt: skip
        if window.blocked:
            broken = " ".join(sorted(window.violated))
            return ERROR, f"{window.blocked} commands kept back: {broken}", values
        message = "active: " + ", ".join(names) if names else "none active"
        # Otherwise a more severe status would hide an active limit.
        severe = window.worst.is_failure or window.worst in (Status.NOT_CONVERGED, Status.INVERTED)
        hidden = severe and any(not name.endswith(RATE) for name in names)
        return (WARN if hidden or window.worst is Status.SATURATED else OK), message, values

    def _of_pressures(self) -> dict[str, object]:
        """Pressure of each cavity and its limits [Pa, gauge]; nothing without cavities."""
        loop, newest = self._loop, self._window.newest
        values: dict[str, object] = {}
        for name, index in loop.cavities.places.items():
            limits = loop.simulation.limits
            low, high = limits.effort_min[index], limits.effort_max[index]
            values[f"pressure_limits_pa: {name}"] = f"{low:.6g} {high:.6g}"
            if newest is not None:
                released = newest.result if newest.command is None else newest.command
                values[f"pressure_pa: {name}"] = float(released.efforts[index])
        if values:
            values["ambient_pressure_pa"] = loop.cavities.ambient_pressure
        return values

    def _of_markers(self, now: float):
        loop, newest = self._loop, self._window.newest
        markers, count = loop.markers, len(loop.simulation.marker_ids)
        refused = self._new("markers", markers.refusals.total)
        values = {"in_scene": count, "age_s": markers.age(now), "unknown": markers.unknown}
        values |= _refusals(markers.refusals)
        lost = False
        if newest is not None:
            lost = loop.markers_are_lost(newest.measured_markers)
            offsets = np.linalg.norm(loop.correction.offsets, axis=1)
            values |= {
                "visible": newest.misfit.visible,
                "misfit_rms_mm": newest.misfit.rms * _MILLI,
                "correction_mm": float(offsets.max(initial=0.0)) * _MILLI,
            }
        values["closed_loop"] = loop.settings.closed_loop
        left_out = ", ".join(
            f"{marker} ({ticks} ticks)" for marker, ticks in sorted(self._window.left_out.items())
        )
        values["left_out"] = left_out
        if lost:
            what = "markers lost"
            if left_out:
                what += f", left out as implausible: {left_out}"
            return *_loss(what, loop.settings.on_lost_markers), values
        if left_out:
            return WARN, f"left out as implausible: {left_out}", values
        if refused:
            return WARN, f"{refused} messages refused", values
        if not count:
            return OK, "the scene has no markers", values
        return OK, "visible" if values.get("visible") else "none visible", values

    def _of_device(self, now: float):
        loop = self._loop
        refused = self._new("device", loop.device.refusals.total)
        values = {
            "in_use": loop.use_device,
            "enabled": loop.is_enabled,
            "age_s": loop.device.age(now),
            "unheard": loop.unheard(now) if loop.device_is_lost(now) else "",
            **_refusals(loop.device.refusals),
        }
        newest = self._window.newest
        if loop.device.setpoints is not None and newest is not None:
            difference = np.abs(loop.device.setpoints - newest.result.setpoints)
            values |= setpoint_differences(loop.simulation.actuators, difference)
        implausible = loop.device.implausible
        if implausible is not None:
            values["implausible"] = implausible
        if loop.device_is_lost(now) and loop.is_enabled:
            what = "device lost" if implausible is None else f"device lost, {implausible}"
            return *_loss(what, loop.settings.on_lost_device), values
        if loop.why_given_up:
            return ERROR, f"disabled: {loop.why_given_up}", values
        if implausible is not None:
            return WARN, f"{implausible}", values
        if loop.device_is_lost(now):
            # Another robot's device sends, and all of it is refused.
            why = f"no message accepted: {refused} refused" if refused else "no message received"
            return WARN, why, values
        if refused:
            return WARN, f"{refused} messages refused", values
        if not loop.is_enabled:
            return OK, "disabled", values
        return OK, "enabled" if loop.use_device else "no device in use", values

    def _of_target(self, now: float):
        loop, window = self._loop, self._window
        inputs = (loop.targets.refusals, loop.targets.velocity_refusals,
                  loop.direct.refusals, loop.selected.refusals, loop.poses.refusals,
                  loop.stiffness.refusals)
        refused = self._new("target", sum(counts.total for counts in inputs))
        clamped = self._new("clamped", loop.targets.clamped + loop.poses.clamped)
        values: dict[str, object] = {"mode": loop.mode.value, "clamped": clamped,
                                     "slowed": self._new("slowed", loop.targets.slowed)}
        for counts in inputs:
            for key, count in _refusals(counts).items():
                values[key] = values.get(key, 0) + count
        for cause, ticks in window.causes.items():
            values[f"ticks: {cause}"] = ticks
        if window.newest is None:
            return OK, "no tick yet", values
        reading, errors = window.newest.reading, window.newest.tracking_errors
        given = errors[np.isfinite(errors)]
        direct = loop.mode.value == "direct"
        values |= {
            "source": "command" if direct else reading.source,
            "age_s": loop.direct.age(now) if direct else loop.targets.age(now),
            "error_mm": float(given.max()) * _MILLI if len(given) else float("nan"),
            "error_max_mm": window.tracking_error_max * _MILLI,
        }
        angles = window.newest.orientation_errors
        if angles is not None:
            values["orientation_error_deg"] = math.degrees(
                np.fmax.reduce(angles, initial=float("nan"))
            )
        off = window.newest.result.stiffness_errors
        if off is not None:
            values["stiffness_error_percent"] = 100.0 * float(
                np.fmax.reduce(off, initial=float("nan"))
            )
        cause = tracking_cause(tracking_signs(loop, window, self._late))
        values["error_cause"] = cause
        if loop.selected.setpoints is not None:
            names = zip(loop.simulation.actuator_names, loop.selected.setpoints, strict=True)
            values["commanded"] = " ".join(name for name, length in names if length == length)
            values["commanded_age_s"] = loop.selected.age(now)
        if refused:
            return WARN, f"{refused} messages refused", values
        if clamped:
            return WARN, f"{clamped} times limited to the workspace", values
        if window.source_changes >= _BY_TURNS:
            kinds = " and ".join(sorted(window.sources))
            return WARN, f"targets by turns as {kinds}, the newest counts: {self._senders()}", values
        message = window.newest.activity.value
        if cause:
            error = window.tracking_error_max * _MILLI
            return WARN, f"{message}, error {error:.1f} mm: {cause}", values
        if window.newest.cause:
            message += f": {window.newest.cause}"
        return (WARN if "timeout" in window.newest.cause else OK), message, values

    def _senders(self) -> str:
        """The topics of targets that nodes publish on, with their names."""
        node, found = self._node, []
        for topic in () if node is None else node.topics_of_targets():
            if names := publisher_names(node, topic):
                found.append(f"{topic} ({names})")
        return ", ".join(found)

    def _of_graph(self, node: RunningTwin):
        clashes = node.clashes
        values = {clash.key: clash.sentence for clash in clashes}
        if not clashes:
            return OK, "no other publisher on its topics", values
        level = ERROR if any(clash.is_severe for clash in clashes) else WARN
        return level, "; ".join(values.values()), values

    @staticmethod
    def _of_record(recorder: RunRecorder) -> tuple[bytes, str, dict[str, object]]:
        """The recording of the run: what it lost, and whether it still grows."""
        values = {"file": recorder.path} | {
            name: getattr(recorder, name) for name in ("ticks", "waiting", "lost")}
        if recorder.failure:
            return ERROR, f"nothing is recorded any more: {recorder.failure}", values
        if recorder.lost:
            return WARN, "ticks were dropped: the run can be replayed only up to there", values
        return OK, "recording", values

    def _of_view(self):
        if self._feed is None:
            return OK, "off", {}
        mirror = self._feed.mirror
        values = {name: getattr(mirror, name) or "" for name in ("address", "failure")} | {
            f"frames_{word}": getattr(mirror, f"frames_{word}")
            for word in ("offered", "logged", "dropped", "failed")}
        return (WARN, mirror.failure, values) if mirror.failure else (OK, "shown", values)


def _loss(what: str, policy: WhenLost) -> tuple[bytes, str]:
    """Level and sentence of a loss. Holding is an error, because the robot no longer follows
    targets.
    """
    if policy is WhenLost.HOLD:
        return ERROR, f"{what}: holding"
    return WARN, f"{what}: open loop"


def _refusals(counts) -> dict[str, int]:
    """Refused messages by reason, one key for each."""
    refused = {f"refused_{word}": count for word, count in counts.by_word().items()}
    return {"refused": counts.total, **refused}


def _text(value: object) -> str:
    """A value as text, numbers with six digits."""
    return f"{value:.6g}" if isinstance(value, float) else str(value)
