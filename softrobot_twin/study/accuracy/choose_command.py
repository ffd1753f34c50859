"""``python -m softrobot_twin choose``: the most accurate setting that keeps a rate here."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from softrobot_twin.scene import Scene, load_scene
from softrobot_twin.study.accuracy.accuracy_command import LIBRARIES, hold_radius, tell
from softrobot_twin.study.accuracy.accuracy_error import AccuracyError
from softrobot_twin.study.accuracy.accuracy_row import MESH, AccuracyRow, read_rows, write_rows
from softrobot_twin.study.accuracy.accuracy_study import Limits, study_meshes
from softrobot_twin.study.accuracy.choice import (
    MARGIN,
    Candidate,
    Measured,
    Setting,
    cautions,
    measure_candidates,
    pick,
    refuse_unsure,
    undecided,
    words,
)
from softrobot_twin.study.accuracy.mesh_family import MeshLevel, mesh_family
from softrobot_twin.study.accuracy.only_body import check_one_body
from softrobot_twin.study.accuracy.scene_copy import write_scene_copy
from softrobot_twin.study.accuracy.scene_variant import with_element, with_hold_radius, with_law
from softrobot_twin.study.accuracy.setting_clock import SettingClock
from softrobot_twin.study.accuracy.study_time import (
    announce,
    in_words,
    shown_progress,
    study_parts,
    study_seconds,
)
from softrobot_twin.study.reports.machine_facts import machine_words
from softrobot_twin.study.reports.terminal import console, table, warn

QUICK = Limits(timed_dof=20_000, reference_dof=50_000)
"""How fine the study goes that is made when none is given."""
# What is this much slower than the period by the study's own times is not measured again.
_HOPELESS = 4.0


def choose(
    scene_path: Path, rate: float, accuracy_file: Path | None = None, write: Path | None = None,
    measure: Callable[[Scene, float, int], Measured] | None = None,
) -> int:
    """Times the candidates, names the best and writes the scene.

    Args:
        scene_path: Scene file.
        rate: Rate to keep [Hz].
        accuracy_file: What ``accuracy`` wrote; made by a quick study where it does not exist.
        write: Scene file to write; ``<name>_<rate>hz.yaml`` in the working folder when None.
        measure: Measures a scene at a rate with so many linearizations, in place of a clock.

    Returns:
        Exit code, always 0.

    Raises:
        SoftRobotTwinError: The scene cannot be used, no setting keeps the rate, or a file cannot
            be written.
    """
    scene = load_scene(scene_path)
    check_one_body(scene)
    write = write or Path(f"{scene.name}_{rate:g}hz.yaml")
    held = with_hold_radius(scene, hold_radius(scene))
    levels = mesh_family(held, write.resolve().parent / f"{write.stem}_meshes")
    rows = _rows(levels, accuracy_file)
    refuse_unsure(rows, scene.name)
    by_name = {level.name: level for level in levels}
    rows = [row for row in rows if row.mesh in by_name and row.step_ms < _HOPELESS * 1e3 / rate]

    def scene_of(setting: Setting) -> Scene:
        return _tuned(by_name[setting.mesh], setting)

    clock = None
    if measure is None:
        clock = SettingClock(held, rate, scene_of)

    def measure_setting(setting: Setting) -> Measured:
        tell(words(setting))
        if clock is not None:
            return clock.measure(setting)
        return measure(scene_of(setting), rate, setting.iterations)

    candidates = measure_candidates(rows, rate, measure_setting)
    if clock is not None:
        tell("the best of them again, in turns")
        candidates = clock.confirm(candidates)
    best = pick(candidates, rate, undecided(rows))
    chosen = _tuned(by_name[best.setting.mesh], best.setting)
    warned = cautions(best)
    remarks = [*_remarks(best, rows, rate, scene_path), *warned]
    if clock is not None:
        remarks.append(f"Times are those of a quiet machine; it was {clock.slowdown:.2f} times "
                       "slower in the median round of the timing.")
    write_scene_copy(write, scene_path, chosen, best.setting, remarks)
    load_scene(write)  # what was written can be read
    shown = console()
    shown.print(_table(candidates, best, rate))
    for line in remarks[1:]:
        if line not in warned:
            shown.print(line)
    for line in warned:
        warn(line)
    shown.print(f"written: {write}")
    return 0


def _tuned(level: MeshLevel, setting: Setting) -> Scene:
    return with_law(with_element(level.scene, setting.element), setting.law)


def _rows(levels: list[MeshLevel], file: Path | None) -> list[AccuracyRow]:
    """Errors by setting: read, or studied now and kept."""
    if file is not None and file.exists():
        known = {level.name for level in levels}
        rows = [row for row in read_rows(file) if row.knob == MESH]
        if not any(row.mesh in known for row in rows):
            raise AccuracyError(str(file), "knows none of the meshes of this scene: "
                                + ", ".join(sorted(known)))
        _refuse_other_meshes(file, rows, levels)
        return rows
    announce(f"no errors are known of these {len(levels)} meshes: studying them takes "
             f"{in_words(study_seconds(levels, QUICK))} on this machine, then the candidates are "
             "timed; --accuracy FILE keeps what is found")
    with shown_progress("meshes", study_parts(levels, QUICK)) as begun:
        rows = study_meshes(levels, QUICK, begun).rows
    if file is not None:
        write_rows(file, rows)
    return rows


def _refuse_other_meshes(file: Path, rows: list[AccuracyRow], levels: list[MeshLevel]) -> None:
    """Errors of meshes that only bear the same names say nothing of these."""
    nodes = {level.name: level.node_count for level in levels}
    for row in rows:
        if row.element == "linear" and row.node_count != nodes.get(row.mesh, row.node_count):
            raise AccuracyError(str(file), f"is of another mesh {row.mesh}: of {row.node_count} "
                                f"nodes, this scene's has {nodes[row.mesh]}")


def _remarks(best: Candidate, rows: list[AccuracyRow], rate: float, original: Path) -> list[str]:
    """What was chosen, what to expect, and why."""
    measured = best.measured
    row = next(row for row in rows if row.mesh == best.setting.mesh
               and (row.element, row.law) == (best.setting.element, best.setting.law))
    return [
        f"Made from {original.name} by 'choose' for {rate:g} Hz on {machine_words(LIBRARIES)}",
        f"{words(best.setting)}: p99 {1e3 * measured.p99:.2f} ms of a period of {1e3 / rate:.2f} "
        f"ms; at most {MARGIN:g} of it is asked.",
        f"Expected error of the effector for given cable lengths: {100 * best.error:.2f} % of its "
        f"displacement ({row.displacement_mm * best.error:.2f} mm of {row.displacement_mm:.1f} mm)"
        f", of which mesh, element and law make {100 * best.mesh_error:.2f} % and the "
        f"linearizations {100 * measured.linearization_error:.2g} %; the reference is sure to "
        f"{100 * row.uncertainty:.2f} %.",
        f"For given cable tensions the same mesh errs by {100 * row.error_tensions:.1f} %: "
        "command lengths where you can.",
    ]


def _table(candidates: list[Candidate], best: Candidate, rate: float):
    made = table(f"Candidates for {rate:g} Hz, the most accurate first", "setting", "median [ms]",
                 "p99 [ms]", "error [%]", f"within {MARGIN:g} of the period")
    for one in sorted(candidates, key=lambda one: one.error):
        mark = "yes: chosen" if one is best else "yes" if one.keeps_rate else "no"
        made.add_row(words(one.setting), f"{1e3 * one.measured.median:.2f}",
                     f"{1e3 * one.measured.p99:.2f}", f"{100 * one.error:.2f}", mark)
    return made
