"""``python -m softrobot_twin calibrate``: fits, tells, and writes a scene where it has become better."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import numpy as np

from softrobot_twin.calibration.calibration import (
    POINTS,
    UNUSUAL,
    Calibration,
    CalibrationError,
    Given,
    Suggestion,
    Unknown,
    calibrate,
    suggestions,
)
from softrobot_twin.control.rest_watch import RestPose
from softrobot_twin.harness.figure import figure_file
from softrobot_twin.harness.output_file import output_file
from softrobot_twin.harness.terminal import console, print_apart, table, terminal_status, warn
from softrobot_twin.record.rest_poses import read_poses
from softrobot_twin.record.run_description import files_named
from softrobot_twin.scene import load_scene
from softrobot_twin.scene.loading import changes_of
from softrobot_twin.scene.scene_editing import EditedValue, edited_text
from softrobot_twin.scene.scene_parameters import full_keys
from softrobot_twin.simulation import Simulation
from softrobot_twin.simulation.mounting import MountingError
from softrobot_twin.tables.input_tables import Axes

NOT_BETTER = 1
FARTHER, LEAST_INSIDE = 1.5, 0.85
"""Errors outside of the poses that grow by more, and shares inside intervals that are less, are warned of."""
DIGITS = 6
"""Digits of a number in a scene file."""


def measured_poses(data: Any, simulation: Simulation) -> tuple[list[RestPose], list[str]]:
    """Poses at rest of files, tables, or poses themselves, and a sentence on each file.

    Args:
        data: A file, a table of columns, a list of these, or a list of `RestPose`.
        simulation: The model.

    Raises:
        SoftRobotTwinError: A file cannot be used.
    """
    is_one = isinstance(data, str | Path) or hasattr(data, "keys") or not isinstance(data, Iterable)
    given = [data] if is_one else list(data)
    poses = [one for one in given if isinstance(one, RestPose)]
    found, words = read_poses([one for one in given if not isinstance(one, RestPose)], simulation)
    return [*poses, *found], words


def calibrate_scene(
    path: Path, data: Sequence[Path], fit: Sequence[str], known: Sequence[str] = (),
    output: Path | None = None, picture: Path | None = None, suggest: bool = False,
    check: Sequence[Path] = (), axes: Axes = Axes(),
) -> int:  # fmt: skip
    """Calibrates a scene, prints what was found, and writes another scene where it is better.

    Args:
        path: Scene file.
        data: Files of runs.
        fit: Keys of the numbers.
        known: What is known before, each as KEY=DEVIATION.
        output: Scene to write; None for one beside the first.
        picture: Picture to write; None for none.
        suggest: Whether to tell what should be measured next.
        check: Files that judge in place of every fourth pose.
        axes: How the tables name them.

    Returns:
        Exit code: 1 where no scene was written.

    Raises:
        SoftRobotTwinError: The scene or the data cannot be used.
    """
    scene = load_scene(path)
    with terminal_status("reading what was measured"):
        simulation = Simulation(scene, with_warnings=False)
        poses, words = read_poses(data, simulation, axes)
        judges, more = read_poses(check, simulation, axes)
    for sentence in words + more:
        print(sentence)
    with terminal_status("fitting"):
        found = calibrate(scene, poses, fit, _known(known), judges)
    print_apart(*tables(found))
    for sentence in found.set_aside:
        warn(f"left out: {sentence}")
    for sentence in doubts(found):
        warn(sentence)
    advice: tuple[Suggestion, ...] = ()
    if suggest or (fit and found.not_told):
        with terminal_status("looking for what would tell more"):
            advice = suggestions(found)
    if fit:
        for group in found.not_told:
            warn(refusal(group, found, advice))
    elif found.not_told:
        print(f"as they were, because they bring nothing beside the others: "
              f"{', '.join(key for (key,) in found.not_told)}")
    if suggest:
        print_advice(found, advice, simulation.actuator_names)
    if words := hysteresis_in_words(found):
        print(words)
    if len(found.reach.sessions) == 1:
        print("one session: the spread between sessions cannot be told, and is in no interval")
    elif np.isfinite(found.reach.between):
        print(f"between sessions: ±{1e3 * found.reach.between:.2f} mm along each axis, in the intervals of others")
    if picture is not None:
        draw(found, picture)
        print(f"wrote {picture}")
    if found.is_accepted and found.systematic_error:
        print(f"with these numbers an observer needs systematic_error: {found.systematic_error:.2g}  # m")
    if not found.is_accepted:
        print(f"no scene is written: {why_not(found)}")
        return NOT_BETTER
    if scene.mounting:
        try:
            Simulation(found.scene, with_warnings=False)
        except MountingError as error:
            print(f"no scene is written: with these numbers it cannot be mounted: {error}")
            return NOT_BETTER
    written = output or path.with_name(f"{path.stem}_calibrated.yaml")
    write_scene(found, path, written, ", ".join(one.name for one in data))
    print(f"wrote {written}")
    return 0


def _known(texts: Iterable[str]) -> dict[str, Given]:
    found = dict[str, Given]()
    for text in texts:
        key, _, said = text.partition("=")
        value, sign, deviation = said.replace("±", "+-").rpartition("+-")
        try:
            numbers = float(value or "0"), float(deviation)
        except ValueError:
            numbers = np.nan, np.nan
        if not (np.isfinite(numbers[0]) and 0.0 < numbers[1] < np.inf) or key in found:
            raise CalibrationError(f"--known {text}", "must be KEY=DEVIATION or KEY=VALUE±DEVIATION, with a "
                                   "deviation above zero, and each key once")  # fmt: skip
        found[key] = numbers if sign else numbers[1]
    return found


def doubts(found: Calibration) -> list[str]:
    """What a person should know before the numbers are trusted.

    Args:
        found: The calibration.
    """
    told = [f"{key} went as far as it may; --known {key}=DEVIATION lets it go further"
            for key in found.estimate.at_bounds()]  # fmt: skip
    for one in found.unusual:
        if one.parameter.key not in found.estimate.at_bounds():
            told.append(f"{one.parameter.key} is more than {UNUSUAL:g} deviations from what is known "
                        f"({deviation_in_words(one, one.known)}): it may stand for another error of the model")
    if found.reach.factor > FARTHER:
        told.append(f"outside of the measured poses the error is expected to be {found.reach.factor:.1f} times as "
                    "large: measure where the robot shall work")  # fmt: skip
    for kind, share in found.validation.inside.items():
        if share < LEAST_INSIDE:
            told.append(f"only {share:.0%} of the {kind} that were held back lie inside their 95 % intervals: at "
                        "other places the error is larger than promised")  # fmt: skip
    return told


def why_not(found: Calibration) -> str:
    """Why a calibration is not accepted.

    Args:
        found: The calibration.
    """
    if found.is_elsewhere:
        before, after = 1e3 * np.median(found.validation.by_pose, axis=1)
        return (f"the robot stands {before:.0f} mm from the model at most poses before any number is fitted, and "
                f"{after:.0f} mm after: it may rest in another place than the model; move it by hand to where the "
                "model rests, which explain --picture draws, and measure anew")
    alike = [" and ".join(group) for group in found.not_told if len(group) > 1]
    if alike:
        return f"fit only one of {', and of '.join(alike)}, or measure what tells them apart"
    if not found.estimate.unknowns:
        return "the data tell none of the numbers"
    return "the poses that were held back are not predicted better than before"


# --- in words ------------------------------------------------------------------------------------


def tables(found: Calibration) -> list:
    """Tables of the numbers and of the poses that were held back.

    Args:
        found: The calibration.
    """
    estimate, held = found.estimate, found.validation
    numbers = table(
        f"{found.start.name}: numbers by {found.pose_count} poses", "key", "before", "after",
        "95 % interval", "unit",
        rows=([one.parameter.key, f"{one.parameter.read(found.start):.6g}", f"{value:.6g}", f"{low:.6g} to {high:.6g}",
               one.parameter.unit]
              for one, value, (low, high) in zip(estimate.unknowns, estimate.values,
                                                 estimate.intervals, strict=True)))  # fmt: skip
    kinds = table(
        f"{len(held.origins)} poses that were held back, root mean square errors", "measured",
        "before", "after", "noise of the fit", "inside 95 %",
        rows=([kind, _of_kind(kind, held.before[kind]), _of_kind(kind, held.after[kind]),
               *([_of_kind(kind, estimate.noise[kind]), f"{held.inside[kind]:.0%}"]
                 if kind in held.inside else ["", ""])]
              for kind in held.before))  # fmt: skip
    return [*_steps(found), numbers, kinds]


def _steps(found: Calibration) -> list:
    """What each number brought that was chosen, where points were measured."""
    noise = next((found.estimate.noise[kind] for kind in POINTS if kind in found.estimate.noise), None)
    if not found.steps or noise is None:
        return []
    estimate = found.estimate
    values = {one.parameter.key: f"{value:.3g} ± {0.5 * (high - low) / 1.96:.2g} {one.parameter.unit}"
              for one, value, (low, high) in zip(estimate.unknowns, estimate.values, estimate.intervals,
                                                 strict=True)}  # fmt: skip
    in_mm = 1e3 * np.sqrt(3.0 * found.estimate.alike) * noise
    rows = ([key, values[key], f"{in_mm * (one.after - one.before):+.2f} mm", f"{in_mm * one.after:.2f} mm"]
            for key, one in found.steps)  # fmt: skip
    return [table("what each number brings at poses that are held back", "key", "value", "brings", "error", rows=rows)]


def hysteresis_in_words(found: Calibration) -> str:
    """The part of the error that depends on the direction of motion; empty without one.

    Args:
        found: The calibration.
    """
    if found.hysteresis is None:
        return ""
    told = [f"±{1e3 * abs(value):.2f} mm along {'xyz'[row]} by the direction along {'xyz'[column]}"
            for (row, column), value in np.ndenumerate(found.hysteresis.amplitudes) if value]  # fmt: skip
    before, after = (1e3 * np.sqrt(np.sum(one**2)) for one in (found.hysteresis.before, found.hysteresis.after))
    return f"hysteresis: {', '.join(told)}; without it poses are off by {after:.2f} mm in place of {before:.2f} mm"


def _of_kind(kind: str, value: float) -> str:
    return f"{1e3 * value:.3g} mm" if kind in POINTS else f"{value:.3g}"


def deviation_in_words(one: Unknown, deviation: float) -> str:
    """A standard deviation with its unit.

    Args:
        one: The number.
        deviation: In its unit, or a share; see `Estimate.deviations`.
    """
    if one.is_relative:
        return f"{100.0 * deviation:.2g} %"
    if one.parameter.unit == "m":
        return f"{1e3 * deviation:.2g} mm"
    return f"{deviation:.2g} {one.parameter.unit}".strip()


def refusal(group: tuple[str, ...], found: Calibration, advice: Sequence[Suggestion]) -> str:
    """Why numbers are refused, and what would tell them.

    Args:
        group: Their keys.
        found: The calibration.
        advice: See `suggestions`.
    """
    what = (f"{group[0]}: the data do not tell it, so it stays as it was" if len(group) == 1
            else f"{', '.join(group)}: the data do not tell them apart")
    told, unknowns = [], found.joint.unknowns
    for place, one in enumerate(unknowns):
        if one.parameter.key not in group or not advice:
            continue
        best = min(advice, key=lambda each: each.deviations[place])
        told.append(f"{best.words}: the standard deviation of {one.parameter.key} falls from "
                    f"{deviation_in_words(one, found.joint.deviations[place])} to "
                    f"{deviation_in_words(one, best.deviations[place])}")
    return "; ".join([what, *told])


def suggestion_table(found: Calibration, advice: Sequence[Suggestion]) -> Any:
    """Standard deviations of the numbers now and after each of the suggestions, in their order.

    Args:
        found: The calibration.
        advice: See `suggestions`.
    """
    rows = ([one.parameter.key, deviation_in_words(one, found.joint.deviations[place]),
             *(deviation_in_words(one, each.deviations[place]) for each in advice)]
            for place, one in enumerate(found.joint.unknowns))  # fmt: skip
    return table("standard deviations", "key", "now",
                 *(f"after {number}" for number in range(1, len(advice) + 1)), rows=rows)


def print_advice(found: Calibration, advice: Sequence[Suggestion], names: Sequence[str]) -> None:
    """Prints what to measure next, the most telling first.

    Args:
        found: The calibration.
        advice: See `suggestions`.
        names: Names of the actuators.
    """
    console().print(suggestion_table(found, advice))
    for number, one in enumerate(advice, 1):
        print(f"{number}: {one.words}")
        if one.words.endswith("new poses"):
            for pose in one.poses:
                print("   " + ", ".join(f"{name} {value:.5g}" for name, value in
                                        zip(names, pose.setpoints, strict=True)))  # fmt: skip


# --- files ---------------------------------------------------------------------------------------


def write_scene(found: Calibration, path: Path, written: Path, data: str) -> None:
    """Writes the scene file with the fitted numbers, each with a comment.

    Args:
        found: The calibration.
        path: The scene file.
        written: File to write; in another folder the paths of meshes are changed.
        data: Where the numbers are from.

    Raises:
        SceneError: The file cannot be changed.
        OutputError: It cannot be written.
    """
    estimate, day = found.estimate, f"{datetime.now(timezone.utc):%Y-%m-%d}"
    told = {key: float(f"{value:.{DIGITS}g}") for key, value in found.values.items()}
    numbers = dict[str, EditedValue]()
    for one, value, ends in zip(estimate.unknowns, estimate.values, estimate.intervals, strict=True):
        words = (f"calibrated {day} by {data}: {_name(one.parameter.key)} {value:.5g}, 95 % "
                 f"{ends[0]:.5g} to {ends[1]:.5g} {one.parameter.unit}").strip()  # fmt: skip
        for key in one.parameter.changes(value):
            numbers[key] = EditedValue(told[key], "; ".join([numbers[key].comment, words]) if key in numbers else words)
    scene = found.start
    if scene.observer is not None:
        numbers["observer.systematic_error"] = EditedValue(
            float(f"{found.systematic_error:.2g}"), f"calibrated {day} by {data}: by poses held back")
    for key, value in changes_of(path).items():
        for place in full_keys(scene, key):
            numbers.setdefault(place, EditedValue(value, "as it was set for the calibration"))
    text = edited_text(scene.path.read_text(encoding="utf-8-sig"), scene, numbers)
    if written.resolve().parent != scene.path.resolve().parent:
        for name in dict.fromkeys(files_named(scene)):
            there = os.path.relpath(scene.file_path(name).resolve(), written.resolve().parent)
            text = text.replace(str(name), there)
    with output_file(written) as partial:
        partial.write_text(text, encoding="utf-8")


def _name(key: str) -> str:
    return "moved together by" if "+" in key else key.rpartition(".")[2]


def draw(found: Calibration, path: Path) -> None:
    """Draws distances of the points at poses held back, before and after, and the numbers.

    Args:
        found: The calibration.
        path: Picture to write.

    Raises:
        OutputError: It cannot be written.
    """
    held, estimate = found.validation, found.estimate
    count = len(estimate.unknowns)
    with figure_file(path, (9.0, max(3.2, 0.28 * count + 1.4)),
                     f"{found.start.name}, calibrated by {found.pose_count} poses") as figure:
        left, right = figure.subplots(1, 2, width_ratios=(1.0, 1.2))
        places = np.arange(len(held.origins))
        left.bar(places - 0.2, 1e3 * held.by_pose[0], 0.4, label="before", color="#bbbbbb")
        left.bar(places + 0.2, 1e3 * held.by_pose[1], 0.4, label="after", color="#2b7bba")
        left.set_xticks(places, [str(place + 1) for place in places])
        left.set_xlabel("pose that was held back")
        left.set_ylabel("distance of the points [mm]")
        left.legend()
        wide = 1.96 * np.sqrt(np.diag(estimate.covariance))
        rows = np.arange(count)[::-1]
        right.axvspan(-1.0, 1.0, color="#eeeeee", label="known before, ±1 deviation")
        right.errorbar(estimate.z, rows, xerr=wide, fmt="o", color="#2b7bba", capsize=2,
                       label="95 % interval")  # fmt: skip
        right.set_yticks(rows, [one.parameter.key for one in estimate.unknowns], fontsize=7)
        right.set_xlabel("change, in deviations of what was known before")
        right.set_ylim(-0.6, count - 0.4)
        right.legend(loc="best", fontsize=7)

