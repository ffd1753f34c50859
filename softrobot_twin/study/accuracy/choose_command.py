"""``python -m softrobot_twin choose``: the most accurate setting that keeps a rate here."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

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
    measure_candidates,
    pick,
    undecided,
    words,
)
from softrobot_twin.study.accuracy.mesh_family import MeshLevel, mesh_family
from softrobot_twin.study.accuracy.moving_path import (
    follow_exactly,
    follow_lengths,
    length_path,
    time_steps,
)
from softrobot_twin.study.accuracy.only_body import check_one_body
from softrobot_twin.study.accuracy.scene_copy import write_scene_copy
from softrobot_twin.study.accuracy.scene_variant import with_element, with_hold_radius, with_law
from softrobot_twin.study.reports.machine_facts import machine_words
from softrobot_twin.study.reports.terminal import console, table

QUICK = Limits(timed_dof=20_000, reference_dof=50_000)
"""How fine the study goes that is made when none is given."""
STEPS = 120
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
    by_name = {level.name: level for level in levels}
    rows = [row for row in rows if row.mesh in by_name and row.step_ms < _HOPELESS * 1e3 / rate]
    measure = measure or measure_here

    def measure_setting(setting: Setting) -> Measured:
        tell(words(setting))
        return measure(_tuned(by_name[setting.mesh], setting), rate, setting.iterations)

    candidates = measure_candidates(rows, rate, measure_setting)
    best = pick(candidates, rate, undecided(rows))
    chosen = _tuned(by_name[best.setting.mesh], best.setting)
    remarks = _remarks(best, rows, rate, scene_path)
    write_scene_copy(write, scene_path, chosen, best.setting, remarks)
    load_scene(write)  # what was written can be read
    shown = console()
    shown.print(_table(candidates, best, rate))
    for line in remarks[1:]:
        shown.print(line)
    shown.print(f"written: {write}")
    return 0


def measure_here(scene: Scene, rate: float, iterations: int) -> Measured:
    """Time of a step on this machine, and what the linearizations leave out."""
    path = length_path(scene, rate, STEPS)
    times = time_steps(scene, path, iterations)
    if times.p99 > MARGIN / rate:
        return Measured(times.median, times.p99, float("nan"))
    exact, start = follow_exactly(scene, path)
    followed = follow_lengths(scene, path, start, iterations)
    apart = np.linalg.norm(followed.positions - exact, axis=2)
    way = np.linalg.norm(exact - _rest(scene), axis=2)
    added = float(np.sqrt(np.mean(apart**2) / np.mean(way**2)))
    return Measured(times.median, times.p99, added)


def _rest(scene: Scene) -> np.ndarray:
    from softrobot_twin.simulation import Simulation
    return Simulation(scene).effector_positions()


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
        return rows
    rows = study_meshes(levels, QUICK, tell).rows
    if file is not None:
        write_rows(file, rows)
    return rows


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
