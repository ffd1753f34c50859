"""``python -m softrobot_twin accuracy``: measures error and time of a step for meshes, elements and laws.

This file contains the tables, the picture and the command; `accuracy_study` measures.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich.table import Table

from softrobot_twin.harness.figure import figure_file, load_pyplot
from softrobot_twin.harness.machine_facts import NUMERICAL_LIBRARIES, describe_machine
from softrobot_twin.harness.output_file import make_folder
from softrobot_twin.harness.study_rows import write_rows
from softrobot_twin.harness.terminal import console, print_apart, table, tracked
from softrobot_twin.scene import load_scene
from softrobot_twin.scene.scene_changes import without_reductions
from softrobot_twin.study.accuracy_study import (
    ASSUMED_ORDER,
    CASES,
    MESH,
    REDUCED,
    AccuracyRow,
    Limits,
    Reference,
    check_one_body,
    hexahedral_family,
    mesh_family,
    study_meshes,
    study_reduced,
    with_hold_radius,
)
from softrobot_twin.study.reduced_models import (
    every_level,
    own_file,
    reduced_models,
)

_CASE_LABELS = {"lengths": "displacements prescribed", "tensions": "forces prescribed",
               "weightless": "displacements, no gravity"}


def _mesh_table(rows: Sequence[AccuracyRow]) -> Table:
    """Table of the error and time of every mesh, element and law."""
    return table(
        "Error of the effector, % of its displacement, and time of a step", "mesh", "element",
        "law", "dof", "step [ms]", "p99 [ms]", *(_CASE_LABELS[case] for case in CASES),
        rows=([row.mesh, row.element, row.law, str(row.dof_count), *_times_and_errors(row)]
              for row in rows if row.knob == MESH))


def _times_and_errors(row: AccuracyRow) -> list[str]:
    """Median and 99th percentile of a step, and the error of each load case."""
    errors = (100.0 * getattr(row, f"error_{case}") for case in CASES)
    return [f"{row.step_ms:.2f}", f"{row.step_p99_ms:.2f}",
            *(f"{error:.2f}" if np.isfinite(error) else "not converged" for error in errors)]


def _reduced_table(rows: Sequence[AccuracyRow]) -> Table | None:
    """Table of the reduced models, each beside the full model of its mesh; None without any."""
    reduced = [row for row in rows if row.knob == REDUCED]
    if not reduced:
        return None
    return table(
        "Reduced models: errors include that of the mesh, in brackets those of its full model",
        "file", "mesh", "element", "modes", "points", "step [ms]", "p99 [ms]",
        *(_CASE_LABELS[case] for case in CASES),
        rows=([row.file, row.mesh, row.element, str(row.mode_count), str(row.point_count),
               *_beside(row, full_row(rows, row))] for row in reduced))


def _beside(row: AccuracyRow, full: AccuracyRow | None) -> list[str]:
    """Times and errors, in brackets those of the full model."""
    own = _times_and_errors(row)
    if full is None:
        return own
    return [f"{text} ({other})" for text, other in zip(own, _times_and_errors(full), strict=True)]


def full_row(rows: Sequence[AccuracyRow], reduced: AccuracyRow) -> AccuracyRow | None:
    """The row of the full model of a reduced one; None where it was not measured.

    Args:
        rows: All rows of a study.
        reduced: The row of the reduced model.
    """
    own = reduced.mesh, reduced.element, reduced.law
    return next((row for row in rows if (row.mesh, row.element, row.law) == own
                 and row.knob == MESH), None)


def _reference_table(references: dict[str, Reference]) -> Table:
    """Table of the reference solutions and their uncertainty."""
    made = table("Reference: quadratic meshes, extrapolated", "case", "displacement [mm]",
                 "extrapolated by", "uncertainty [%]", "meshes")
    for case, reference in references.items():
        order = reference.limit.order
        by = ("elements of higher order" if order is None else f"order {order:.2f}"
              if np.isfinite(order) else f"order {ASSUMED_ORDER:g}, assumed")  # fmt: skip
        made.add_row(_CASE_LABELS[case], f"{1e3 * reference.displacement:.2f}", by,
                     f"{100.0 * reference.uncertainty:.2f}", ", ".join(reference.meshes))
    return made


# Curves of the picture: colour, name, and how far the name is above the end of the line [point].
_CURVES = {"linear": ("#1b6ca8", "linear tetrahedra", 2), "smoothed": ("#c51b7d", "smoothed tetrahedra", 2),
           "quadratic": ("#d95f02", "quadratic tetrahedra", -14), "hexahedral": ("#4d9221", "hexahedra", 2)}
_REDUCED_COLOUR = "#7b3294"
_RATES = (50, 100, 200, 500)
# Panels of the picture: the error, its title, and the uncertainty of its reference.
_PANELS = (("error_tensions", "Forces given", "uncertainty_tensions"),
           ("error", "Lengths given, with or without weight", "uncertainty"))


def draw_accuracy(path: Path, name: str, rows: Sequence[AccuracyRow], conditions: str) -> None:
    """Draws error against time of a step, one line for each kind of elements, and reduced models.

    Args:
        path: Picture to write; its suffix determines the format.
        name: Name of the robot.
        rows: All rows of a study.
        conditions: Machine and versions, for the bottom of the picture.

    Raises:
        MissingExtraError: matplotlib is not installed.
        OutputError: The picture cannot be written.
    """
    with figure_file(path, (12.0, 4.6), f"{name}: what accuracy costs", conditions) as figure:
        for axes, panel in zip(figure.subplots(1, 2, sharex=True), _PANELS, strict=True):
            _draw_errors(axes, rows, *panel)


def _draw_errors(axes, rows: Sequence[AccuracyRow], error: str, title: str, doubt: str) -> None:
    """One panel: the points of a line are the meshes of one kind of elements."""
    for element, (colour, words, height) in _CURVES.items():
        drawn = sorted((row for row in rows if (row.knob, row.element, row.law) == (MESH, element, "corotational")
                        and np.isfinite(getattr(row, error))), key=lambda row: row.dof_count)
        if drawn:
            times, errors = _places(drawn, error)
            axes.plot(times, errors, "o-", color=colour, linewidth=2.0, markersize=4)
            axes.annotate(words, (times[-1], errors[-1]), (7, height), textcoords="offset points", color=colour)
    for row in rows:
        if row.knob == REDUCED and np.isfinite(getattr(row, error)):
            place = _places([row], error)
            axes.plot(*place, "*", color=_REDUCED_COLOUR, markersize=12)
            axes.annotate("reduced", (place[0][0], place[1][0]), (6, 6), textcoords="offset points",
                          color=_REDUCED_COLOUR)
    unsure = 100.0 * max(getattr(row, doubt) for row in rows)
    axes.axhline(unsure, color="#9a9a9a", linewidth=1.0, linestyle=(0, (4, 2)))
    axes.annotate("uncertainty of the reference", (0.0, unsure), (4, 3), xycoords=("axes fraction", "data"),
                  textcoords="offset points", fontsize=8, color="#666666")
    # Where a step takes 0.7 of a period.
    for rate in _RATES:
        axes.axvline(0.7e3 / rate, color="#bbbbbb", linewidth=1.0, zorder=0)
        axes.annotate(f"{rate} Hz", (0.7e3 / rate, 1.0), (-9, -30), xycoords=("data", "axes fraction"),
                      textcoords="offset points", rotation=90, fontsize=8, color="#777777")
    axes.set(xscale="log", yscale="log", xlabel="time of a step [ms]", ylabel="error [% of the displacement]",
             title=title)
    # Space for names of lines and rates.
    axes.set_xlim(right=8.0 * max(row.step_ms for row in rows))
    axes.set_ylim(top=2.5 * axes.get_ylim()[1])
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter(lambda value, _: f"{value:g}")


def _places(rows: Sequence[AccuracyRow], error: str) -> tuple[list[float], list[float]]:
    """Times of a step [ms] and one of the errors [%], as they are drawn."""
    return [row.step_ms for row in rows], [100.0 * getattr(row, error) for row in rows]


def accuracy(
    scene_path: Path, output: Path, limits: Limits = Limits(), reduced: Sequence[Path] = ()
) -> int:
    """Measures error and time of every setting; prints tables and writes a CSV and a picture.

    Args:
        scene_path: Scene file; the reduced model that it names is measured beside the full ones.
        output: Folder for ``accuracy.csv`` and ``accuracy.png``.
        limits: Largest sizes to compute.
        reduced: Files of further reduced models of its meshes.

    Returns:
        Exit code, always 0.

    Raises:
        SoftRobotTwinError: The scene or a file cannot be used or an output not be written.
    """
    load_pyplot()  # An error is raised now, not after minutes of computing.
    scene = load_scene(scene_path)
    check_one_body(scene)
    make_folder(output)
    named = own_file(scene)
    scene = without_reductions(scene)
    held = with_hold_radius(scene)
    levels = mesh_family(held, output / "meshes")
    hexahedra = hexahedral_family(held)
    models = reduced_models([*([named] if named else []), *reduced], (), every_level(levels, hexahedra))
    study = study_meshes(levels, limits, hexahedra)
    rows = [*study.rows, *(study_reduced(model, study, limits.timed_steps)
                           for model in tracked(models, "reduced models", len(models)))]
    conditions = describe_machine(NUMERICAL_LIBRARIES)
    shown = console()
    shown.print(conditions)
    if held.cables:
        shown.print("The force of a cable at a point acts on the material within "
                    f"{1e3 * held.cables[0].hold_radius:.1f} mm.")
    shown.print()
    print_apart(_reference_table(study.references), _mesh_table(rows), _reduced_table(rows))
    write_rows(output / "accuracy.csv", rows)
    draw_accuracy(output / "accuracy.png", scene.name, rows, conditions)
    shown.print(f"written: {output / 'accuracy.csv'}, {output / 'accuracy.png'}")
    return 0
