"""The twin's ``/diagnostics``: one status for each part, with the worst values since the last
message.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from itertools import chain, compress
from typing import TYPE_CHECKING, Protocol

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

from softrobot_twin.analysis.reduction_error import LARGE_BY_SIZE, LARGE_SHARE, ReductionStates
from softrobot_twin.control.diagnostics_window import DiagnosticsWindow
from softrobot_twin.control.dynamic_control import DynamicControl
from softrobot_twin.control.live_calibration import LiveCalibration
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
from softrobot_twin.simulation.result import GRIP, RATE
from softrobot_twin.tables.channels import measured

if TYPE_CHECKING:
    from softrobot_twin.record.run_recorder import RunRecorder
    from softrobot_twin.ros.run_recording import RunRecording
    from softrobot_twin.ros.view_feed import ViewFeed


_MILLI = 1.0e3


_BY_TURNS = 3
"""So many changes of the kind of targets in a second are of two that send by turns."""
_EXCEEDED = ".force_limit_exceeded"


OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR
Part = tuple[bytes, str, dict[str, object]]
"""Level, a sentence and values."""


def first_of(values: dict[str, object], fine: str, *rows: tuple[object, bytes, str]) -> Part:
    """The level and the sentence of the first row whose condition holds, with the values.

    Args:
        values: The values.
        fine: The sentence where no condition holds.
        rows: Conditions, levels and sentences.
    """
    level, message = next((row[1:] for row in rows if row[0]), (OK, fine))
    return level, message, values


def status_message(name: str, robot: str, part: Part) -> DiagnosticStatus:
    """A part of a robot as a message; numbers have six digits.

    Args:
        name: Name of the status.
        robot: Name of the robot.
        part: Level, sentence, and values by name.
    """
    level, message, values = part
    pairs = [
        KeyValue(key=key, value=f"{value:.6g}" if isinstance(value, float) else str(value))
        for key, value in values.items()
    ]
    return DiagnosticStatus(level=level, name=name, message=message, hardware_id=robot, values=pairs)


def contact_status(contact: Contact, window: DiagnosticsWindow, follows: bool) -> Part:
    """Status of the contacts: their number, the forces of each pair, and the accuracy of the
    solution.

    Args:
        contact: The scene's entry, for its tolerance.
        window: The ticks since the last message, at least one.
        follows: True when targets are followed, so that contacts are part of the inverse problem.
    """
    count, largest = window.newest.result.report.contact_count, window.largest
    values = {
        "count": count,
        "count_max": largest["contact_count"],
        "programs_max" if follows else "sweeps_max": largest["contact_sweeps"],
        "residual_mm": largest["contact_residual"] * _MILLI,
        "force_residual_n": largest["contact_force_residual"],
        "overlap_max_mm": window.overlap_max * _MILLI,
    }
    for pair, force in sorted(window.contact_forces.items()):
        on = "on {} by {}".format(*pair)
        resultant = window.contact_resultants[pair]
        values[f"resultant_max_n: {on}"] = " ".join(f"{value:.6g}" for value in resultant)
        values[f"sum_of_magnitudes_max_n: {on}"] = window.contact_magnitude_sums[pair]
        values[f"one_contact_max_n: {on}"] = force
    for name, margin in window.newest.result.report.figures.items():
        if name.startswith(GRIP):
            values["grip_margin: on {} by {}".format(*name.split(".")[1:])] = margin
    given_up = sorted(name for name in window.limits if name.endswith(_EXCEEDED))
    if contact.force_limit is not None:
        values |= {"force_limit_n": contact.force_limit, "given_up": " ".join(given_up)}
    return first_of(
        values, f"contacts: {count}" if count else "no contact",
        # The comparison is written so that a NaN counts as not solved.
        (not largest["contact_residual"] <= contact.tolerance, WARN, "not solved to the tolerance"),
        (given_up, WARN, f"given up: {', '.join(given_up)}"),
        (near := sorted(name for name in window.limits if name.endswith(GRIP)), WARN,
         f"near slipping: {', '.join(name.removesuffix('.' + GRIP) for name in near)}"))


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
    calibration: LiveCalibration | None
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
        """All statuses at a time on the clock of the ticks [s].

        Args:
            now: Time on the clock of the ticks [s].
        """
        loop, node, window = self._loop, self._node, self._window
        contact = loop.simulation.scene.contact
        recording = None if node is None else node.recording
        has_ticked = window.newest is not None
        waits: Part = OK, "no tick yet", {}
        parts = {
            "loop": self._of_loop(),
            "solver": self._of_solver() if has_ticked else waits,
            "limits": self._of_limits(),
            "markers": self._of_markers(now),
            "device": self._of_device(now),
            "target": self._of_target(now),
            "view": self._of_view(),
        }
        if node is not None:
            parts["graph"] = self._of_graph(node)
        if recording is not None:
            parts["record"] = self._of_record(recording.recorder)
        if node is not None and node.calibration is not None:
            parts["calibration"] = self._of_calibration(node.calibration)
        if contact is not None:
            follows = loop.mode is Mode.INVERSE
            parts["contact"] = contact_status(contact, window, follows) if has_ticked else waits
        if loop.touches is not None:
            parts["touch"] = self._of_touches() if has_ticked else waits
        if loop.observer is not None:
            parts["observer"] = self._of_observer()
        if loop.dynamic is not None:
            parts["control"] = self._of_control(loop.dynamic)
        name = self._loop.simulation.scene.name
        return [status_message(f"{self._name}: {key}", name, part) for key, part in parts.items()]

    def _new(self, key: str, count: int) -> int:
        """Increase of a count since the last message."""
        grown = count - self._last_counts.get(key, 0)
        self._last_counts[key] = count
        return grown

    def _of_loop(self) -> Part:
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
            **_attributes(clock, "ticks", "missed", "skipped"),
        }
        if (node := self._node) is None:
            return level, message, values
        # What happened to the node since the last message.
        priority, direction = node.priority, "ahead" if node.last_clock_step > 0.0 else "back"
        for key, count, least, before, after in (
            ("given_back", priority.times_given_back, WARN, "", f"; priority {priority.state}"),
            ("clock_steps", node.clock_steps, WARN,
             f"clock set {direction} by {abs(node.last_clock_step):.3f} s; ", ""),
            ("failed_ticks", node.failed_ticks, ERROR, "", f"; a tick failed: {node.failure}"),
            ("refused", node.refused_requests, WARN, "", "; a request was refused, see the log"),
        ):
            if self._new(key, count):
                level, message = max(level, least), f"{before}{message}{after}"
        return level, message, values | {
            "priority": priority.state, "simulated_time": node.is_simulated_time,
            **_attributes(node, "clock_steps", "refused_requests", "failed_ticks"),
        }

    def _of_solver(self) -> Part:
        window, simulation = self._window, self._loop.simulation
        values = {
            "activity": window.newest.activity.value,
            "status": window.newest.result.status.value,
            "worst_status": window.worst.value,
            "statuses": " ".join(f"{word}:{n}" for word, n in sorted(window.statuses.items())),
            "residual_n": window.largest["residual"],
            "iterations": window.largest["iterations"],
            "linearization_error_mm": window.largest["linearization_error"] * _MILLI,
            "discretization_error_mm": self.discretization_error * _MILLI,
            **self._of_mesh(),
            **_attributes(window, "resting", "overloaded", "late", "projected"),
            "qp_solver": " ".join(sorted(window.qp_solvers)),
        }
        reduced = ReductionStates(simulation).read(with_errors=False)
        if self.reduction is not None:
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
        values |= {f"time_{stage}_ms": time * _MILLI for stage, time in window.stage_maxima.items()}
        values |= {"nodes": simulation.node_count, "dof": simulation.dof_count}
        doubts = [f"{name}: {state.doubt}" for name, state in reduced.items() if state.doubt]
        doubts += [wrong] if (wrong := self._wrong_bodies()) else []
        message = window.worst.value
        if window.worst in (Status.LINEARIZED, Status.NOT_CONVERGED):
            message += f": residual {window.largest['residual']:.2g} N"
        message = "; ".join([message, *doubts])
        strains = "; ".join(outside.in_words() for outside in window.strains.values())
        overload = f"overload: {window.overloaded} ticks without time to linearize"
        return first_of(
            values, message,
            (window.worst.is_failure, ERROR, message),
            (not (window.worst.is_success or window.worst is Status.RATE_LIMITED), WARN, message),
            (window.overloaded, WARN, overload),
            (doubts, WARN, "; ".join(doubts)),
            (strains, WARN, strains))

    def _of_mesh(self) -> dict[str, object]:
        """Estimated error of the mesh at rest [%], or the reason why it is not estimated."""
        watch = self._mesh_error
        if watch is None:
            return {"mesh_error": "not requested"}
        found = watch.at_rest
        state = "waiting for idle time" if found is None else "estimated"
        values: dict[str, object] = {"mesh_error": watch.cause or state}
        if found is not None:
            for word, error in (("mesh", found.own), ("quadratic", found.quadratic)):
                values |= {f"{word}_error_at_{given}_percent": 100.0 * getattr(error, given)
                           for given in ("forces", "lengths")}  # fmt: skip
            values["quadratic_step_ms"] = found.quadratic.step_time * _MILLI
        return values

    def _of_full_model(self) -> dict[str, object]:
        """Distance of the effectors from those of the full model, or why it is not known."""
        watch = self.reduction
        if watch is None:
            return {}
        values: dict[str, object] = {
            "full_model": watch.cause or ("compared" if watch.answers else "waiting for idle time")}
        for name, error in watch.newest.items():
            values |= {f"{name}_full_model_error_mm": error.distance * _MILLI,
                       f"{name}_full_model_error_percent": 100.0 * error.share}
        return values

    def _wrong_bodies(self) -> str:
        """Reduced bodies that the full model finds far from where it has them, in words."""
        if self.reduction is None:
            return ""
        least = LARGE_BY_SIZE * self._loop.simulation.model.nodes.size
        return "; ".join(
            f"{name}: {error.distance * _MILLI:.2g} mm ({100.0 * error.share:.0f} % of the "
            "displacement) from the full model"
            for name, error in self.reduction.newest.items()
            if error.distance > least and error.share > LARGE_SHARE
        )

    def _of_touches(self) -> Part:
        inputs, touches = self._loop.touches, self._window.newest.result.touches
        values: dict[str, object] = {}
        for index, name in enumerate(inputs.names):
            force, displacement = touches.forces[index], touches.displacements[index]
            values[f"{name}_force_n"] = float(np.linalg.norm(force))
            values[f"{name}_displacement_mm"] = float(np.linalg.norm(displacement)) * _MILLI
        values |= {"timed_out": inputs.timed_out, **inputs.refusals.by_word()}
        touched = ", ".join(compress(inputs.names, touches.is_touched))
        return first_of(
            values, "not touched",
            (self._new("refused_touches", inputs.refusals.total), WARN, "a measured touch was refused"),
            (touched, OK, f"touched: {touched}"))

    def _of_observer(self) -> Part:
        observer, values = self._loop.observer, dict[str, object]()
        forces, spreads = observer.found.wrenches[:, :3], observer.found.deviations[:, :3]
        for name, force, spread in zip(observer.names, forces, spreads, strict=True):
            values[f"{name}_force_n"] = " ".join(f"{one:.3g}" for one in force)
            values[f"{name}_deviation_n"] = " ".join(f"{one:.2g}" for one in spread)
        values["support"] = round(observer.belief, 2)
        found = ", ".join(compress(observer.names, observer.found.is_detected))
        return first_of(
            values, "no force beyond noise",
            (observer.is_blind, WARN, "the robot buckles in the model: forces stay what they were"),
            (found, OK, f"found: {found}"))

    def _of_control(self, dynamic: DynamicControl) -> Part:
        values: dict[str, object] = {
            "frequencies_hz": " ".join(f"{one:.3g}" for one in dynamic.model.frequencies),
            "fallbacks": dynamic.fallbacks, "surprise": dynamic.surprise,
        }  # fmt: skip
        if dynamic.margin is None:
            return OK, "quasi-static", values
        why, values["margin"] = dynamic.why_quasi_static, dynamic.margin.in_words()
        return first_of(values, "by prediction", (why, WARN, f"quasi-static: {why}"))

    def _of_limits(self) -> Part:
        window = self._window
        names = sorted(window.limits)
        values = {"active": " ".join(names), "kept_back": window.blocked, **self._of_pressures()}
        # Otherwise a more severe status would hide an active limit.
        severe = window.worst.is_failure or window.worst in (Status.NOT_CONVERGED, Status.INVERTED)
        hidden = severe and any(not name.endswith(RATE) for name in names)
        broken = f"{window.blocked} commands kept back: {' '.join(sorted(window.violated))}"
        message = "active: " + ", ".join(names) if names else "none active"
        limited = hidden or window.worst is Status.SATURATED
        return first_of(values, message, (window.blocked, ERROR, broken), (limited, WARN, message))

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

    def _of_markers(self, now: float) -> Part:
        loop, newest = self._loop, self._window.newest
        markers, count = loop.markers, len(loop.simulation.marker_ids)
        values: dict[str, object] = {
            "in_scene": count, "age_s": markers.age(now), "unknown": markers.unknown,
            **_refusals(markers.refusals),
        }
        if newest is not None:
            offsets = np.linalg.norm(loop.correction.offsets, axis=1)
            values |= {
                "visible": newest.misfit.visible,
                "misfit_rms_mm": newest.misfit.rms * _MILLI,
                "correction_mm": float(offsets.max(initial=0.0)) * _MILLI,
                "correction_by": loop.correction.law.value,
                "delay_ms": loop.lead.delay * _MILLI,
                "lead_mm": float(np.linalg.norm(loop.lead.ways, axis=1).max(initial=0.0)) * _MILLI,
            }
            for one in measured():
                names = one.names(loop.simulation)
                for name, off in zip(names, one.misfits(newest.measured, newest.result)):
                    values |= {f"{column}_misfit": float(part)
                               for column, part in zip(one.columns(name), off) if np.isfinite(part)}
        left_out = ", ".join(
            f"{marker} ({ticks} ticks)" for marker, ticks in sorted(self._window.left_out.items())
        )
        values |= {"closed_loop": loop.settings.closed_loop, "left_out": left_out}
        implausible = left_out and f"left out as implausible: {left_out}"
        lost = newest is not None and loop.markers_are_lost(newest.measured_markers)
        loss = ", ".join(filter(None, ("markers lost", implausible)))
        return first_of(
            values, "visible" if values.get("visible") else "none visible",
            (lost, *_loss(loss, loop.settings.on_lost_markers)),
            (implausible, WARN, implausible),
            self._refused("markers", markers.refusals.total),
            (not count, OK, "the scene has no markers"))

    def _refused(self, key: str, count: int) -> tuple[int, bytes, str]:
        """The row of messages that were refused since the last report; see `first_of`."""
        refused = self._new(key, count)
        return refused, WARN, f"{refused} messages refused"

    def _of_device(self, now: float) -> Part:
        loop, device, newest = self._loop, self._loop.device, self._window.newest
        is_lost, implausible = loop.device_is_lost(now), device.implausible
        values: dict[str, object] = {
            "in_use": loop.use_device,
            "enabled": loop.is_enabled,
            "age_s": device.age(now),
            "unheard": loop.unheard(now) if is_lost else "",
            **_refusals(device.refusals),
        }
        if device.setpoints is not None and newest is not None:
            difference = np.abs(device.setpoints - newest.result.setpoints)
            values |= setpoint_differences(loop.simulation.actuators, difference)
        if implausible is not None:
            values["implausible"] = implausible
        refused = self._refused("device", device.refusals.total)
        # Another robot's device sends, and all of it is refused.
        why = f"no message accepted: {refused[0]} refused" if refused[0] else "no message received"
        loss = "device lost" if implausible is None else f"device lost, {implausible}"
        return first_of(
            values, "enabled" if loop.use_device else "no device in use",
            (is_lost and loop.is_enabled, *_loss(loss, loop.settings.on_lost_device)),
            (loop.why_given_up, ERROR, f"disabled: {loop.why_given_up}"),
            (implausible is not None, WARN, f"{implausible}"),
            (is_lost, WARN, why),
            refused,
            (not loop.is_enabled, OK, "disabled"))

    def _of_target(self, now: float) -> Part:
        loop, window, newest = self._loop, self._window, self._window.newest
        targets, selected = loop.targets, loop.selected
        # Inputs of single actuators count with those that keep their values.
        inputs = dict.fromkeys(one.refusals for one in loop.wishes)
        refused = self._refused("target", sum(counts.total for counts in inputs))
        clamped = self._new("clamped", sum(one.clamped for one in loop.wishes))
        slowed = 0 if targets is None else self._new("slowed", targets.slowed)
        values: dict[str, object] = {"mode": loop.mode.value, "clamped": clamped, "slowed": slowed}
        for key, count in chain.from_iterable(_refusals(counts).items() for counts in inputs):
            values[key] = values.get(key, 0) + count
        values |= {f"ticks: {cause}": ticks for cause, ticks in window.causes.items()}
        if newest is None:
            return OK, "no tick yet", values
        errors = newest.tracking_errors
        values |= {
            "source": newest.reading.source if loop.direct is None else "command",
            "age_s": (loop.direct or loop.targets).age(now),
            "error_mm": _greatest(errors[np.isfinite(errors)]) * _MILLI,
            "error_max_mm": window.tracking_error_max * _MILLI,
        }
        if newest.orientation_errors is not None:
            values["orientation_error_deg"] = math.degrees(_greatest(newest.orientation_errors))
        if newest.result.stiffness_errors is not None:
            values["stiffness_error_percent"] = 100.0 * _greatest(newest.result.stiffness_errors)
        cause = tracking_cause(tracking_signs(loop, window, self._late))
        values["error_cause"] = cause
        if selected is not None and selected.setpoints is not None:
            names = zip(loop.simulation.actuator_names, selected.setpoints, strict=True)
            values["commanded"] = " ".join(name for name, length in names if length == length)
            values["commanded_age_s"] = selected.age(now)
        by_turns = ""
        if window.source_changes >= _BY_TURNS:
            kinds = " and ".join(sorted(window.sources))
            by_turns = f"targets by turns as {kinds}, the newest counts: {self._senders()}"
        message, error = newest.activity.value, window.tracking_error_max * _MILLI
        caused = f"{message}: {newest.cause}" if newest.cause else message
        return first_of(
            values, caused, refused,
            (clamped, WARN, f"{clamped} times limited to the workspace"),
            (by_turns, WARN, by_turns),
            (cause, WARN, f"{message}, error {error:.1f} mm: {cause}"),
            ("timeout" in newest.cause, WARN, caused))

    def _senders(self) -> str:
        """The topics of targets that nodes publish on, with their names."""
        node, found = self._node, []
        for topic in () if node is None else node.topics_of_targets():
            if names := publisher_names(node, topic):
                found.append(f"{topic} ({names})")
        return ", ".join(found)

    def _of_graph(self, node: RunningTwin) -> Part:
        sentences = {clash.key: clash.sentence for clash in node.clashes}
        level = ERROR if any(clash.is_severe for clash in node.clashes) else WARN
        return first_of(dict(sentences), "no other publisher on its topics",
                        (sentences, level, "; ".join(sentences.values())))

    @staticmethod
    def _of_record(recorder: RunRecorder) -> Part:
        """The recording of the run: what it lost, and whether it still grows."""
        return first_of(
            {"file": recorder.path, **_attributes(recorder, "ticks", "waiting", "lost")}, "recording",
            (recorder.failure, ERROR, f"nothing is recorded any more: {recorder.failure}"),
            (recorder.lost, WARN, "ticks were dropped: the run can be replayed only up to there"))

    @staticmethod
    def _of_calibration(calibration: LiveCalibration) -> Part:
        """The poses for a calibration, and what the last one gave."""
        watch, outcome = calibration.watch, calibration.outcome
        values = {"poses": len(watch.found), "dropped": sum(watch.dropped.values()),
                  "proposal": calibration.proposal if calibration.code == 0 else ""}  # fmt: skip
        return first_of(
            values, f"{len(watch.found)} poses at rest",
            (calibration.cause, WARN, f"no fits any more: {calibration.cause}"),
            (calibration.is_fitting, OK, "fitting"), (calibration.code == 0, OK, outcome),
            (outcome, WARN, outcome))  # fmt: skip

    def _of_view(self) -> Part:
        if self._feed is None:
            return OK, "off", {}
        mirror = self._feed.mirror
        values = {"address": mirror.address or "", "failure": mirror.failure or ""} | _attributes(
            mirror, *(f"frames_{word}" for word in ("offered", "logged", "dropped", "failed")))
        return first_of(values, "shown", (mirror.failure, WARN, mirror.failure))


def _attributes(owner: object, *names: str) -> dict[str, object]:
    """Attributes of an object as values."""
    return {name: getattr(owner, name) for name in names}


def _greatest(numbers: np.ndarray) -> float:
    """The greatest of the numbers that are not NaN; NaN without any."""
    return float(np.fmax.reduce(numbers, initial=float("nan")))


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
