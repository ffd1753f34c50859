"""``python -m softrobot_twin accuracy``: what each bit of accuracy costs in time."""

from __future__ import annotations

import sys
from pathlib import Path

from softrobot_twin.scene import Scene, load_scene
from softrobot_twin.study.accuracy.accuracy_knobs import turn_knobs
from softrobot_twin.study.accuracy.accuracy_row import write_rows
from softrobot_twin.study.accuracy.accuracy_study import Limits, study_meshes
from softrobot_twin.study.accuracy.accuracy_tables import knob_table, mesh_table, reference_table
from softrobot_twin.study.accuracy.mesh_family import mesh_family
from softrobot_twin.study.accuracy.only_body import check_one_body, only_body
from softrobot_twin.study.accuracy.scene_variant import with_hold_radius
from softrobot_twin.study.accuracy.study_time import (
    announce,
    in_words,
    shown_progress,
    study_parts,
    study_seconds,
)
from softrobot_twin.study.reports.machine_facts import machine_words
from softrobot_twin.study.reports.terminal import console

LIBRARIES = ("numpy", "scipy", "numba", "osqp", "daqp")
HOLD_SHARE = 0.0125
"""Radius that cables hold within where the scene names none, as a share of the body's size."""
KNOB_STEPS = 100


def accuracy(scene_path: Path, output: Path, limits: Limits = Limits()) -> int:
    """Measures error and time of every setting; prints tables and writes a CSV and a picture.

    Args:
        scene_path: Scene file.
        output: Folder for ``accuracy.csv`` and ``accuracy.png``.
        limits: How fine to go.

    Returns:
        Exit code, always 0.

    Raises:
        SoftRobotTwinError: The scene cannot be used or an output not be written.
    """
    from softrobot_twin.study.accuracy.accuracy_picture import draw_accuracy
    from softrobot_twin.study.bench.bench_command import make_folder
    from softrobot_twin.study.reports.extras import load_pyplot

    load_pyplot()  # refused before minutes are spent, not after
    scene = load_scene(scene_path)
    check_one_body(scene)
    make_folder(output)
    held = with_hold_radius(scene, hold_radius(scene))
    levels = mesh_family(held, output / "meshes")
    announce(f"{len(levels)} meshes: this takes {in_words(study_seconds(levels, limits))} on this "
             "machine")
    with shown_progress("meshes", study_parts(levels, limits)) as begun:
        study = study_meshes(levels, limits, begun)
    own = next(level for level in levels if level.is_own)
    tell("knobs besides the mesh")
    displacement = study.references["lengths"].displacement
    rows = [*study.rows, *turn_knobs(own.scene, displacement, KNOB_STEPS)]
    conditions = machine_words(LIBRARIES)
    shown = console()
    shown.print(f"{conditions}\nCables hold on what lies within "
                f"{1e3 * held.cables[0].hold_radius:.1f} mm of their points.\n")
    for made in (reference_table(study.references), mesh_table(rows), knob_table(rows)):
        shown.print(made)
        shown.print()
    write_rows(output / "accuracy.csv", rows)
    draw_accuracy(output / "accuracy.png", scene.name, rows, conditions)
    shown.print(f"written: {output / 'accuracy.csv'}, {output / 'accuracy.png'}")
    return 0


def hold_radius(scene: Scene) -> float:
    """Radius for cables that hold on points [m]: points have no limit under refinement."""
    return round(HOLD_SHARE * only_body(scene).size, 6)


def tell(words: str) -> None:
    """What was begun, for who waits at a terminal."""
    if sys.stderr.isatty():
        print(f"{words} …", file=sys.stderr)
