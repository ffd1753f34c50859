"""``python -m softrobot_twin accuracy``: measures error and time of a step for many settings.

This file contains the tables, the picture and the command; `accuracy_study` measures.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich.table import Table

from softrobot_twin.scene import load_scene
from softrobot_twin.scene.scene_changes import without_reductions
from softrobot_twin.study.accuracy_study import (
    ASSUMED_ORDER,
    CASES,
    MESH,
    NEWTON,
    PRECISION,
    QP,
    REDUCED,
    AccuracyError,
    AccuracyRow,
    Limits,
    MeshLevel,
    Reference,
    Study,
    check_one_body,
    hexahedral_family,
    mesh_family,
    shown_progress,
    study_meshes,
    study_reduced,
    study_seconds,
    vary_knobs,
    with_hold_radius,
    write_rows,
)
from softrobot_twin.study.figure import figure_file, load_pyplot
from softrobot_twin.study.machine_facts import NUMERICAL_LIBRARIES, describe_machine
from softrobot_twin.study.output_file import make_folder
from softrobot_twin.study.reduced_models import (
    every_level,
    own_file,
    reduced_models,
    train_level,
)
from softrobot_twin.study.terminal import (
    approximate_duration,
    console,
    print_apart,
    print_to_stderr,
    report_activity,
    table,
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


def _knob_table(rows: Sequence[AccuracyRow]) -> Table:
    """Table of the errors that are added by the other settings."""
    return table(
        "Error added by other settings, on the scene's own mesh", "varied", "setting", "step [ms]",
        "added error [%]",
        rows=([row.knob, row.setting, f"{row.step_ms:.2f}", f"{100.0 * row.error_added:.2g}"]
              for row in rows if row.knob not in (MESH, REDUCED)))


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


_COLOURS = {"linear": "#1b6ca8", "smoothed": "#c51b7d", "quadratic": "#d95f02", "hexahedral": "#4d9221"}
_REDUCED_COLOUR = "#7b3294"
_CELLS = {"linear": "linear tets", "smoothed": "smoothed tets", "quadratic": "quadratic tets",
          "hexahedral": "hexahedra"}  # fmt: skip
# Where the sizes of meshes are written, above or below their points.
_UPWARDS = {"linear": 6, "smoothed": -11, "quadratic": -11, "hexahedral": -11}
_KNOB_COLOURS = {NEWTON: "#3a8f5c", QP: "#a03b76", PRECISION: "#7a5230"}
_KNOB_LABELS = {NEWTON: "linearizations a step, at 100 Hz", QP: "QP solver and tolerance",
               PRECISION: "precision of the factor (SuperLU)"}
_RATES = (50, 100, 200, 500)
# Smaller errors are drawn at this share.
_FLOOR = 1.0e-9
_CASE_LINES = {"tensions": (0, (1, 1.2)), "lengths": "solid", "weightless": (0, (5, 2))}
_LAW_LINES = {"corotational": "solid", "linear": (0, (4, 2))}


def draw_accuracy(path: Path, name: str, rows: Sequence[AccuracyRow], conditions: str) -> None:
    """Draws all rows and writes the picture.

    Args:
        path: Picture to write; its suffix determines the format.
        name: Name of the robot.
        rows: All measured rows, including those that vary the mesh.
        conditions: Machine and versions, for the bottom of the picture.

    Raises:
        MissingExtraError: matplotlib is not installed.
        OutputError: The picture cannot be written.
    """
    with figure_file(path, (13.0, 13.0), f"{name}: accuracy and time", conditions) as figure:
        grid = figure.add_gridspec(3, 2, height_ratios=(1.0, 0.95, 0.55))
        _draw_error_over_mesh(figure.add_subplot(grid[0, 0]), rows)
        _draw_time_over_mesh(figure.add_subplot(grid[0, 1]), rows)
        forces, displacements = (figure.add_subplot(grid[1, column]) for column in (0, 1))
        _draw_error_against_time(forces, rows, "error_tensions")
        _draw_error_against_time(displacements, rows, "error")
        if any(row.knob in _KNOB_COLOURS for row in rows):
            _draw_added_against_time(figure.add_subplot(grid[2, :]), rows)


def curve(rows: Sequence[AccuracyRow], element: str, law: str) -> list[AccuracyRow]:
    """Meshes with one element and law, the coarsest first.

    Args:
        rows: All rows of a study.
        element: Kind of the elements.
        law: Name of the law.
    """
    found = [row for row in rows if (row.knob, row.element, row.law) == (MESH, element, law)]
    return sorted(found, key=lambda row: row.dof_count)


def _drawn(rows: Sequence[AccuracyRow]) -> dict[str, str]:
    """Colour of each kind of elements that was measured."""
    measured = {row.element for row in rows}
    return {element: colour for element, colour in _COLOURS.items() if element in measured}


def _draw_error_over_mesh(axes, rows: Sequence[AccuracyRow]) -> None:
    """Error over mesh size (Coevoet 2017, figure 8), all elements, with the reference's
    uncertainty.
    """
    for element, colour in _drawn(rows).items():
        shown = curve(rows, element, "corotational")
        dofs = [row.dof_count for row in shown]
        for case, text in _CASE_LABELS.items():
            errors = [100.0 * getattr(row, f"error_{case}") for row in shown]
            axes.plot(dofs, errors, "o", linestyle=_CASE_LINES[case], color=colour, markersize=4,
                      linewidth=1.6, label=f"{text}, {_CELLS[element]}")
    first = next(row for row in rows if row.knob == MESH)
    uncertainty = {case: 100.0 * getattr(first, f"uncertainty_{case}") for case in _CASE_LABELS}
    low = min(uncertainty.values()) / 4.0
    axes.set(xscale="log", yscale="log", xlabel="degrees of freedom",
             ylabel="effector error [% of its displacement]",
             title="Error over the mesh (all cables but the last, and all cavities, actuated)")
    axes.set_ylim(low, 1500.0)  # space for the legend
    for case, value in uncertainty.items():
        _draw_uncertainty(axes, low, value, f"uncertainty, {_CASE_LABELS[case]}", (0.0, 4))
    axes.legend(loc="upper center", ncols=2, fontsize=7.5)
    _plain_percent(axes)


def _draw_time_over_mesh(axes, rows: Sequence[AccuracyRow]) -> None:
    for element, colour in _drawn(rows).items():
        for law, line in _LAW_LINES.items():
            shown = curve(rows, element, law)
            axes.plot([row.dof_count for row in shown], [row.step_ms for row in shown], "o",
                      linestyle=line, color=colour, markersize=4,
                      linewidth=1.6, label=f"{_CELLS[element]}, {law} law")
    axes.set(xscale="log", yscale="log", xlabel="degrees of freedom", ylabel="median [ms]",
             title="Time of one step with one linearization")
    axes.legend(loc="upper left", fontsize=8)


# What is prescribed where an error is drawn, and the uncertainty of its reference.
_GIVEN = {
    "error_tensions": ("forces prescribed", "uncertainty_tensions"),
    "error": ("displacements prescribed, with or without weight", "uncertainty"),
}


def _draw_error_against_time(axes, rows: Sequence[AccuracyRow], error: str) -> None:
    """One error of `_GIVEN` over time of a step for every mesh, element and law."""
    given, doubt = _GIVEN[error]
    for element, colour in _drawn(rows).items():
        for law, line in _LAW_LINES.items():
            shown, is_thick = curve(rows, element, law), law == "corotational"
            times, errors = _places(shown, error)
            axes.plot(times, errors, "o", linestyle=line, color=colour,
                      linewidth=2.4 if is_thick else 1.2, markersize=5 if is_thick else 3.5,
                      label=f"{_CELLS[element]}, {law} law")
            for row, *place in zip(shown, times, errors) if is_thick else ():
                axes.annotate(_number_of(row), place, (0, _UPWARDS[element]), ha="center",
                              textcoords="offset points", fontsize=7, color=colour)
    _draw_reduced(axes, rows, error)
    axes.set(xscale="log", yscale="log", ylabel="effector error [% of its displacement]",
             xlabel="median time of a step [ms]; numbers: nodes of the mesh",
             title=f"Error against time: {given}")
    value = 100.0 * getattr(next(row for row in rows if row.knob == MESH), doubt)
    _draw_uncertainty(axes, 0.4 * value, value, "uncertainty of the reference", (1.0, -4))
    axes.set_ylim(0.4 * value, 4.0 * axes.get_ylim()[1])  # space for the legend
    _draw_rates(axes)
    _plain_percent(axes)
    axes.legend(loc="upper right", ncols=2, fontsize=7)


def _draw_reduced(axes, rows: Sequence[AccuracyRow], error: str) -> None:
    """Reduced models, each with a line to the full model of its mesh."""
    reduced = [row for row in rows if row.knob == REDUCED and np.isfinite(getattr(row, error))]
    for row in reduced:
        full = full_row(rows, row)
        if full is not None:
            axes.plot(*_places([row, full], error), linestyle=(0, (1, 2)), color=_REDUCED_COLOUR,
                      linewidth=1.1, zorder=1)
        axes.annotate(f"{_number_of(row)} {row.element}, {row.mode_count} modes",
                      (row.step_ms, 100.0 * getattr(row, error)), (6, -11),
                      textcoords="offset points", fontsize=7.5, color=_REDUCED_COLOUR)
    if reduced:
        axes.plot(*_places(reduced, error), "*", color=_REDUCED_COLOUR, markersize=13, zorder=4,
                  label="reduced models of these meshes")


def _places(rows: Sequence[AccuracyRow], error: str) -> tuple[list[float], list[float]]:
    """Times of a step [ms] and one of the errors [%], as they are drawn."""
    return [row.step_ms for row in rows], [100.0 * getattr(row, error) for row in rows]


def _number_of(row: AccuracyRow) -> str:
    """The number at the end of the name of a mesh."""
    return row.mesh.rpartition("_")[2]


def _draw_added_against_time(axes, rows: Sequence[AccuracyRow]) -> None:
    """Added error over time of a step for the other settings, each varied alone on the scene's own
    mesh.
    """
    for knob, colour in _KNOB_COLOURS.items():
        shown = [row for row in rows if row.knob == knob]
        errors = [100.0 * max(row.error_added, _FLOOR) for row in shown]
        axes.plot([row.step_ms for row in shown], errors, "D", linestyle=(0, (1, 1.5)),
                  color=colour, markersize=5, linewidth=1.1, label=_KNOB_LABELS[knob])
        _name_settings(axes, shown, errors, colour)
    axes.set(xscale="log", yscale="log", xlabel="median time of a step [ms]",
             ylabel="added error [% of its displacement]",
             title="Error added by each other setting, varied alone on the scene's own mesh "
             f"(smaller ones are drawn at {100.0 * _FLOOR:g} %)")
    _draw_rates(axes, named=False)
    axes.legend(loc="upper right", fontsize=8)


def _draw_rates(axes, named: bool = True) -> None:
    """Draws lines where a step takes 0.7 of a period."""
    for rate in _RATES:
        time = 0.7e3 / rate
        axes.axvline(time, color="#bbbbbb", linewidth=1.0, zorder=0)
        if named:
            axes.annotate(f"{rate} Hz", (time, 0.0), (-9, 4), xycoords=("data", "axes fraction"),
                          textcoords="offset points", rotation=90, fontsize=8, color="#777777")


def _name_settings(axes, shown: Sequence[AccuracyRow], errors: list[float], colour: str) -> None:
    """Writes names of settings; neighbouring points at the same place share one name."""
    groups: list[list[int]] = []
    for index, error in enumerate(errors):
        if groups and abs(np.log10(error / errors[groups[-1][-1]])) < 0.2:
            groups[-1].append(index)
        else:
            groups.append([index])
    for members in groups:
        text = ", ".join(_short(shown[index].setting) for index in members)
        right = max(members, key=lambda index: shown[index].step_ms)
        axes.annotate(text, (shown[right].step_ms, errors[right]), (7, -3),
                      textcoords="offset points", fontsize=7.5, color=colour)


def _short(setting: str) -> str:
    return setting.replace("OSQP at ", "OSQP ").partition(" linearization")[0].replace(
        ", SuperLU", "")


def _draw_uncertainty(
    axes, low: float, value: float, words: str, side: tuple[float, int]
) -> None:
    """A band below an uncertainty [%], told at one side: share of the width, and shift [point]."""
    axes.axhspan(low, value, color="#9a9a9a", alpha=0.16, linewidth=0)
    axes.annotate(f"{words}: {value:.2g} %", (side[0], value), (side[1], -3), va="top", fontsize=7.5,
                  ha="right" if side[0] else "left", xycoords=("axes fraction", "data"),
                  textcoords="offset points", color="#666666")


def _plain_percent(axes) -> None:
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")


KNOB_STEPS = 100


def accuracy(
    scene_path: Path, output: Path, limits: Limits = Limits(), reduced: Sequence[Path] = (),
    train: Sequence[str] | None = None,
) -> int:  # fmt: skip
    """Measures error and time of every setting; prints tables and writes a CSV and a picture.

    Args:
        scene_path: Scene file; the reduced model that it names is measured beside the full ones.
        output: Folder for ``accuracy.csv`` and ``accuracy.png``.
        limits: Largest sizes to compute.
        reduced: Files of further reduced models of its meshes.
        train: Meshes whose reduced models are trained first, as MESH or MESH:ELEMENT; where none
            is named, the most accurate one; None for no training.

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
    every = every_level(levels, hexahedra)
    models = reduced_models([*([named] if named else []), *reduced], (), every)
    trained = [level_named(name, every) for name in train or ()]
    print_to_stderr(f"{len(levels)} meshes: this takes "
                    f"{approximate_duration(study_seconds(levels, limits))} on this machine"
                    + (", and the training of reduced models" if train is not None else ""))
    with shown_progress(levels, limits, hexahedra) as begun:
        study = study_meshes(levels, limits, begun, hexahedra)
    if train is not None:
        trained = trained or [_most_accurate(study, every)]
        models += [train_level(scene_path, level, output / "reduced") for level in trained]
    report_activity("settings besides the mesh")
    displacement = study.references["lengths"].displacement
    rows = [*study.rows,
            *(study_reduced(model, study, limits.timed_steps, report_activity) for model in models),
            *vary_knobs(held, displacement, KNOB_STEPS)]
    conditions = describe_machine(NUMERICAL_LIBRARIES)
    shown = console()
    shown.print(conditions)
    if held.cables:
        shown.print("The force of a cable at a point acts on the material within "
                    f"{1e3 * held.cables[0].hold_radius:.1f} mm.")
    shown.print()
    print_apart(_reference_table(study.references), _mesh_table(rows), _reduced_table(rows),
                _knob_table(rows))
    write_rows(output / "accuracy.csv", rows)
    draw_accuracy(output / "accuracy.png", scene.name, rows, conditions)
    shown.print(f"written: {output / 'accuracy.csv'}, {output / 'accuracy.png'}")
    return 0


def level_named(name: str, levels: Sequence[MeshLevel]) -> MeshLevel:
    """The mesh of a name such as ``diamond_2700:quadratic``; linear where no element is named.

    Args:
        name: Name of a mesh, perhaps with an element.
        levels: Meshes with their elements; see `every_level`.

    Raises:
        AccuracyError: There is none.
    """
    mesh, _, element = name.partition(":")
    own = [level for level in levels if level.name == mesh]
    wanted = [level for level in own if level.scene.body.element == element or not element]
    if not wanted:
        known = ", ".join(f"{level.name}:{level.scene.body.element}" for level in own or levels)
        raise AccuracyError(name, f"is not one of {known}")
    return wanted[0]


def _most_accurate(study: Study, levels: Sequence[MeshLevel]) -> MeshLevel:
    """The mesh and element with the least error, with the law of the scene."""
    law = levels[0].scene.body.material.law
    known = [row for row in study.rows if row.law == law and np.isfinite(row.error)]
    best = min(known, key=lambda row: row.error)
    return level_named(f"{best.mesh}:{best.element}", levels)
