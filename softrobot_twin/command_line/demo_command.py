"""``python -m softrobot_twin demo``: runs the demo's processes, then writes report and picture.

This module connects `ros`, which runs and records the demo, with `study`, which evaluates the
record. Neither of the two imports the other.
"""

from __future__ import annotations

import math
import os
import sys
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from softrobot_twin.calibration.calibration import calibrate
from softrobot_twin.calibration.calibration_report import tables, why_not, write_scene
from softrobot_twin.harness.terminal import console, live_line, table, terminal_status
from softrobot_twin.ros.demo import (
    CONTROLLED_RUNS,
    DIRECT_RUNS,
    NOTICEABLE_SHARE,
    RUNS,
    Demo,
    DemoCalibration,
    DemoOutcome,
    DemoPlan,
    DemoStatus,
    ProcessDiedError,
    isolate,
    plan_demo,
)
from softrobot_twin.shared_files import ScenePath
from softrobot_twin.simulation import Simulation
from softrobot_twin.study.calibration_demo import poses_of_device
from softrobot_twin.study.demo_table import demo_columns, write_demo_table
from softrobot_twin.study.touch_report import draw_presses, touch_report, untouched
from softrobot_twin.study.tracking import (
    TimedValues,
    TrackingRecord,
    draw_tracking,
    tracking_report,
    write_report,
)
from softrobot_twin.tables.column_names import TIME

RESULTS = ("report.json", "tracking.png", "presses.png", "run.rrd",
           *(f"{run}.csv" for run in (*RUNS, *CONTROLLED_RUNS, *DIRECT_RUNS)), "calibration.png")
"""Files that a demo writes into its folder, besides one log for each process."""

CALIBRATED = "calibrated"
"""Folder in that of a demo for the run with the calibrated twin."""
GLUED = 2.0e-4
"""How well the places of markers are known [m]: fitted freely they take what the tip is off."""
_FEWEST_SAMPLES = 10
"""A run with fewer commands at whose time all else is known is left out of the report."""
_STOPPED = 130
_SETTLING = 2.0
"""Presses count from so many transitions onto a path on."""


def demo(robot: str, folder: Path, run_time: float, view: bool, changes: Sequence[str] = ()) -> int:
    """Runs the demo and writes report.json, pictures and samples beside run.rrd.

    Args:
        robot: Name of the robot.
        folder: Folder for the results.
        run_time: Length of each run [s]: open loop and closed loop, or one of commands.
        view: Serve a live view, and open a viewer where there is a display.
        changes: Other values of entries of the twin's scene; see `read_changes`.

    Returns:
        Exit code: 0; 1 when a process ended too early or not cleanly; 130 after Ctrl-C.

    Raises:
        SoftRobotTwinError: The robot, its scene or an output cannot be used.
    """
    plan = plan_demo(robot, folder, run_time, view, changes)
    code, records = _shown(plan)
    if code or plan.calibration is None or RUNS[0] not in records:
        return code
    scene = _calibrated(plan, plan.calibration)
    if scene is None:
        return code
    again = replace(plan, scene_file=ScenePath(scene, ()), runs=RUNS[:1], folder=folder / CALIBRATED, calibration=None)
    again.folder.mkdir(exist_ok=True)
    code, after = _shown(again)
    if RUNS[0] in after:
        draw_tracking(plan.robot, {"before": records[RUNS[0]], "after": after[RUNS[0]]}, folder / "calibration.png")
        print(f"wrote {folder / 'calibration.png'}: the path before and after the calibration")
    return code


def _calibrated(plan: DemoPlan, how: DemoCalibration) -> Path | None:
    """Calibrates the twin by poses of the device; the scene that was written, None where none is better."""
    twin, device = (Simulation.from_scene_file(path) for path in (plan.scene_file, how.device_scene))
    with terminal_status(f"driving the device to {how.count} poses, and calibrating the twin by them"):
        poses = poses_of_device(twin, device, np.array(how.box), how.count, how.noise, how.seed)
        found = calibrate(twin.scene, poses, [], {f"+markers.*.point[{axis}]": GLUED for axis in range(3)})
    console().print(*tables(found))
    if not found.is_accepted:
        print(f"the twin stays as it is: {why_not(found)}")
        return None
    written = plan.folder / f"{plan.scene_file.stem}_calibrated.yaml"
    write_scene(found, plan.scene_file, written, f"{len(poses)} poses of the demo")
    print(f"wrote {written}")
    return written


def _shown(plan: DemoPlan) -> tuple[int, dict[str, TrackingRecord]]:
    """Runs a plan and reports it; its exit code, and the record of each run."""
    for name in RESULTS:
        # Old results must not remain after an interrupted demo.
        (plan.folder / name).unlink(missing_ok=True)
    _print_start(plan, isolate(os.environ))
    try:
        with live_line() as show:
            outcome = Demo(plan, _StatusLine(show)).run()
    except ProcessDiedError as died:
        print(f"softrobot_twin: {died}; its last lines:", file=sys.stderr)
        for text in died.last_lines:
            print(f"    {text}", file=sys.stderr)
        return 1, {}
    return _report(plan, outcome)


class _StatusLine:
    """Shows statuses of a demo; a new phase, and its first large error with a cause, at once."""

    def __init__(self, show: Callable[[str, bool], None]):
        self._show = show
        self._seen: set[tuple[str, bool]] = set()

    def __call__(self, status: DemoStatus) -> None:
        line = (f"{status.elapsed:6.1f} s  {status.phase:<11}  error {_thousandth(status.error, 'mm')}  "
                f"step {_thousandth(status.compute_time, 'ms')}  missed {status.missed_ticks}")
        now = status.phase, bool(status.cause)
        self._show(line + f"  cause: {status.cause}" * now[1], now not in self._seen)
        self._seen.add(now)


def _thousandth(value: float, unit: str) -> str:
    return f"   –   {unit}" if math.isnan(value) else f"{1e3 * value:6.2f} {unit}"


def _print_start(plan: DemoPlan, domain: str) -> None:
    output = console(sys.stderr)
    runs = " and then ".join(run.replace("_", " ") for run in plan.runs)
    output.print(f"{plan.robot}: {len(plan.runs) * plan.run_time:g} s, {runs}, after the nodes have "
                 f"started, and then the report; --seconds shortens it; ROS_DOMAIN_ID={domain}",
                 soft_wrap=True)
    if plan.view_port is not None and not plan.opens_viewer:
        output.print("no display; open the live view with: "
                     f"rerun rerun+http://127.0.0.1:{plan.view_port}/proxy", soft_wrap=True)


def _report(plan: DemoPlan, outcome: DemoOutcome) -> tuple[int, dict[str, TrackingRecord]]:
    """Writes the results and prints the summary; see `_shown`."""
    simulation = Simulation.from_scene_file(plan.scene_file)
    kinds = simulation.actuators.kind_of
    every = {run: _record(outcome, run, kinds) for run in outcome.starts}
    records = {run: record for run, record in every.items()
               if len(demo_columns(record, plan.effector, kinds)[TIME]) >= _FEWEST_SAMPLES}
    for run in every.keys() - records.keys():
        print(f"softrobot_twin: {run}: too few samples to compare; left out", file=sys.stderr)
    if records:
        mesh = {"nodes": simulation.node_count, "tets": simulation.tet_count, "dof": simulation.dof_count}
        report = tracking_report(plan.robot, records, {**_loop_figures(plan, outcome), "mesh": mesh})
        report["complete"] = not outcome.was_stopped
        report["twin_priority"] = outcome.recorder.priority or None
        report["processor_share_of_others"] = outcome.others
        report["steps"] = _step_counts(outcome)
        report["touch"] = _touches(plan, outcome)
        _print_table(plan, report)
        write_report(plan.folder / "report.json", report)
        for run, record in records.items():
            write_demo_table(plan.folder / f"{run}.csv", record, plan.effector, kinds)
        draw_tracking(plan.robot, records, plan.folder / "tracking.png")
    unclean = {name: code for name, code in outcome.exit_codes.items() if code != 0}
    for name, code in unclean.items():
        print(f"softrobot_twin: {name} did not end cleanly: exit code {code}, see "
              f"{plan.folder / name}.log", file=sys.stderr)
    if outcome.was_stopped:
        print("softrobot_twin: stopped", file=sys.stderr)
        return _STOPPED, records
    return int(bool(unclean)), records


def _touches(plan: DemoPlan, outcome: DemoOutcome) -> dict | None:
    """Stiffness that the device's fingertip felt in the first run, drawn too; None without presses.
    """
    recorder, (start, end) = outcome.recorder, outcome.span(plan.runs[0])
    # Presses of before the robot was where it is sent first are left out.
    span = min(start + _SETTLING * plan.ramp_time, end), end
    device, twin = (TimedValues(*samples.between(*span))
                    for samples in (recorder.device_touch, recorder.twin_touch))
    wanted = TimedValues(*recorder.stiffness.between(-np.inf, span[1]))
    report = touch_report(device, twin, wanted)
    if report is not None:
        draw_presses(plan.robot, device, wanted, plan.folder / "presses.png")
    return report


def _record(outcome: DemoOutcome, run: str, kinds: dict) -> TrackingRecord:
    """Samples recorded during a run."""
    recorder, span = outcome.recorder, outcome.span(run)
    target, twin, device, setpoints, efforts = (
        TimedValues(*samples.between(*span))
        for samples in (recorder.target, recorder.twin_effector, recorder.device_effector,
                        recorder.setpoints, recorder.efforts))
    # What a fingertip displaces is no error of tracking.
    device = untouched(device, TimedValues(*recorder.device_touch.between(*span)))
    names = recorder.actuator_names
    return TrackingRecord(
        None if recorder.is_direct else target, twin, device, names,
        tuple(kinds[name].setpoint.unit for name in names),
        tuple(kinds[name].effort.unit for name in names), setpoints, efforts,
    )  # fmt: skip


def _loop_figures(plan: DemoPlan, outcome: DemoOutcome) -> dict:
    """Timing of the loop, from the reports that the twin published once a second during the runs.

    Each report covers the last seconds. The result is the median of their medians, and the largest
    of their 99th percentiles and maxima, which are never smaller than the true ones; None where
    there is no report.
    """
    before, during = (outcome.recorder.loop_reports[: outcome.reports_before],
                      outcome.recorder.loop_reports[outcome.reports_before:])
    times = dict.fromkeys(("median", "p99", "max"))
    ticks = dict.fromkeys(("ticks", "missed", "skipped"), 0)
    if during:
        times = {"median": 1e3 * float(np.median([report.compute_p50 for report in during])),
                 "p99": 1e3 * max(report.compute_p99 for report in during),
                 "max": 1e3 * max(report.compute_max for report in during)}
        ticks = {name: getattr(during[-1], name) - (getattr(before[-1], name) if before else 0)
                 for name in ticks}
    return {"compute_time_ms": times, "period_ms": 1e3 * plan.period, "ticks": ticks["ticks"],
            "missed_ticks": ticks["missed"], "skipped_ticks": ticks["skipped"]}


def _step_counts(outcome: DemoOutcome) -> dict[str, int]:
    """Number of the twin's steps of each status during the runs, by its word."""
    counts: Counter[str] = Counter()
    for report in outcome.recorder.loop_reports[outcome.reports_before:]:
        counts.update(report.statuses)
    return dict(sorted(counts.items()))


def _add_touch(made, touch: dict) -> None:
    """Adds what a fingertip felt to the table."""
    presses = touch["presses"]
    felt = [press["device_n_per_m"] for press in presses]
    made.add_row("stiffness felt on the device, open loop",
                 f"{len(presses)} presses, {min(felt):.0f} to {max(felt):.0f} N/m")
    if touch["median_error_percent"] is not None:
        targets = [press["target_n_per_m"] for press in presses if press["target_n_per_m"]]
        made.add_row("its error against the target",
                     f"median {touch['median_error_percent']:.1f} %, "
                     f"max {touch['max_error_percent']:.1f} %; targets {min(targets):.0f} to "
                     f"{max(targets):.0f} N/m")


def _print_table(plan: DemoPlan, report: dict) -> None:
    made = table(f"{plan.robot}, driven live", "what", "value")
    for run in plan.runs:
        if figures := report[run]:
            made.add_row("device against twin" if plan.is_direct else
                         f"tracking error, {run.replace('_', ' ')}",
                         f"mean {figures['mean_error_mm']:.3f} mm, "
                         f"max {figures['max_error_mm']:.3f} mm")
    if (ratio := report["closed_to_open_ratio"]) is not None:
        made.add_row("closed loop / open loop", f"{ratio:.3f}")
    if (published := report["published_open_loop_error_mm"]) is not None:
        values = [f"{key} {value:g} mm" for key, value in published.items() if value is not None]
        made.add_row("published, a real robot, open loop", ", ".join(values))
    if (touch := report["touch"]) is not None:
        _add_touch(made, touch)
    compute = report["compute_time_ms"]
    made.add_row("compute time", ", ".join(
        f"{key} {value:.2f} ms" for key, value in compute.items() if value is not None) or "–")
    late = 100.0 * report["missed_ticks"] / report["ticks"] if report["ticks"] else 0.0
    made.add_row("ticks", f"{report['ticks']} of {report['period_ms']:g} ms, "
                 f"{report['missed_ticks']} missed ({late:.2f} %), "
                 f"{report['skipped_ticks']} skipped")
    made.add_row("steps", ", ".join(
        f"{count} {word}" for word, count in report["steps"].items()) or "–")
    made.add_row("priority of the twin's ticks", report["twin_priority"] or "unknown")
    if (others := report["processor_share_of_others"]) is not None and others > NOTICEABLE_SHARE:
        made.add_row("other programs", f"used {100.0 * others:.0f} % of the processor meanwhile: "
                     "the times above are not representative")
    mesh = report["mesh"]
    made.add_row("mesh", f"{mesh['nodes']} nodes, {mesh['tets']} tets, "
                 f"{mesh['dof']} degrees of freedom")
    made.add_row("written", ", ".join(str(plan.folder / name) for name in (
        "report.json", "tracking.png", "run.rrd")))
    console().print(made)
