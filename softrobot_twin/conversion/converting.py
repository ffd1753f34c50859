"""``softrobot_twin convert``: writes a scene of SOFA as a scene of this package, and a report."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from softrobot_twin.conversion import (  # noqa: F401 (they register rules)
    actuator_rules,
    body_rules,
    contact_rules,
    frame_rules,
)
from softrobot_twin.conversion.computed_values import points_of
from softrobot_twin.conversion.rules import UNREADABLE, Conversion
from softrobot_twin.conversion.scene_text import scene_yaml
from softrobot_twin.conversion.scene_tree import (
    KINDS,
    TABLE,
    ConversionError,
    NotConverted,
    SceneComponent,
    SceneNode,
    components_below,
    from_plain,
    numbers,
)
from softrobot_twin.conversion.scene_xml import read_xml
from softrobot_twin.conversion.units import units_of
from softrobot_twin.errors import SceneError, SoftRobotTwinError, one_line
from softrobot_twin.harness.output_file import output_file, writing
from softrobot_twin.harness.terminal import console, print_apart, table, terminal_status
from softrobot_twin.scene.loading import read_yaml, scene_from_mapping
from softrobot_twin.simulation import Simulation
from softrobot_twin.study.first_scene import SceneExistsError, check_new_scene, made_name

CONVERTED, INCOMPLETE = 0, 3
"""Exit codes: all is converted; a scene, but something is not."""
SETTLING_STEPS = 20
"""Rows of the files of commands and targets."""


def convert(file: Path, output: Path, units: str | None, seconds: float, replace: bool) -> int:
    """Converts a file and reports.

    Args:
        file: The scene, ``.py``, or XML (``.scn``, ``.xml``).
        output: The scene that is written.
        units: Name of its units; None to find them by gravity.
        seconds: Longest time that the file may run [s].
        replace: Whether an existing scene is replaced.

    Returns:
        Exit code.

    Raises:
        SoftRobotTwinError: No scene can be made.
    """
    check_new_scene(output, replace)
    with terminal_status(f"reading {file.name}"):
        root, stopped = read_scene(file, seconds)
    try:
        conversion = converted(root, output, units)
    except NotConverted as error:
        raise ConversionError(file, f"its root node: {error}") from None
    conversion.missing[:0] = [(None, reason) for reason in stopped]
    if absent := root.fields.get("absent"):
        conversion.notes.append(f"modules that are not installed do nothing here: {', '.join(absent)}")
    if not any(map(conversion.scene.get, ("bodies", "beams", "rigid_bodies"))):
        raise ConversionError(file, _why_no_body(conversion))
    with terminal_status("building the scene"):
        write(conversion, file, replace)
    _report(conversion, file)
    return INCOMPLETE if conversion.missing else CONVERTED


def read_scene(file: Path, seconds: float) -> tuple[SceneNode, list[str]]:
    """The tree of a file, and why it is not whole.

    Args:
        file: The file.
        seconds: Longest time that Python may run [s].

    Raises:
        ConversionError: It is no scene.
    """
    if not file.is_file():
        raise ConversionError(file, "is no file")
    if file.suffix.lower() in (".scn", ".xml"):
        return read_xml(file), []
    if file.suffix.lower() not in (".py", ".pyscn"):
        raise ConversionError(file, "is neither .py nor .scn nor .xml")
    recorded = _recorded(file, seconds)
    reasons = []
    if "error" in recorded:
        if len(recorded["nodes"]) == 1 and not recorded["nodes"][0]["components"]:
            raise ConversionError(file, f"{recorded['error']}{recorded['at']}")
        reasons = [f"the file stopped{recorded['at']} ({recorded['error']}): what follows is not converted"]
    reasons += [f"{name} ({Path(place).name}:{line}) is not known: what it adds, moves or says is not converted"
                for name, place, line in recorded["unknown"]]  # fmt: skip
    root = from_plain(recorded)
    root.fields["absent"] = recorded["missing"]
    return root, reasons


def _recorded(file: Path, seconds: float) -> dict[str, Any]:
    """What `scene_process` writes; foreign code, in a process of its own, with a time limit."""
    with tempfile.TemporaryDirectory(prefix="softrobot_twin_convert_") as folder:
        tree = Path(folder, "tree.json")
        command = [sys.executable, "-m", "softrobot_twin.conversion.scene_process", str(file.resolve()), str(tree)]
        package = str(Path(__file__).resolve().parents[2])
        paths = os.pathsep.join(filter(None, (package, os.environ.get("PYTHONPATH"))))
        environment = {**os.environ, "PYTHONPATH": paths, "PYTHONDONTWRITEBYTECODE": "1"}
        process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
            start_new_session=True, cwd=folder, env=environment)  # fmt: skip
        try:
            _, errors = process.communicate(timeout=seconds)
        except subprocess.TimeoutExpired:
            raise ConversionError(file, f"ran longer than {seconds:g} s and was stopped: --time-limit gives "
                                  "it more") from None  # fmt: skip
        finally:
            # Processes that the scene began go too.
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
        try:
            return json.loads(tree.read_text())
        except (OSError, ValueError):
            last = one_line(Exception(errors))[-300:] or f"ended with code {process.returncode}"
            raise ConversionError(file, f"could not be run: {last}") from None


def converted(root: SceneNode, output: Path, units: str | None) -> Conversion:
    """A tree as the sections of a scene.

    Args:
        root: The tree.
        output: The scene file that will be written.
        units: Name of its units; None to find them by gravity.
    """
    # SOFA keeps its own value where a text is empty.
    gravity, steps = (numbers(root.fields.get(name, [])) for name in ("gravity", "dt"))
    step = float(steps[0]) if len(steps) else 0.01
    if len(steps) > 1 or step <= 0.0:
        raise NotConverted(f"dt {root.fields['dt']!r} must be a time above zero [s]")
    conversion = Conversion(root, units_of(gravity[:3], _extent(root), units), output, step)
    vector = gravity[:3] if len(gravity) else [0.0, -9.81, 0.0]
    conversion.scene = {"name": made_name(output.stem, "part"), "gravity": conversion.length(vector)}
    conversion.run()
    conversion.scene["solver"] = {"newton_iterations": body_rules.NEWTON_ITERATIONS}
    return conversion


def _extent(root: SceneNode) -> float:
    """Largest extent of what has points, in the unit of the file."""
    found = [0.0]
    for component in components_below(root, KINDS["states"]):
        with suppress(NotConverted, *UNREADABLE):
            found.append(float(np.ptp(points_of(component), axis=0).max()))
    return max(found)


def _why_no_body(conversion: Conversion) -> str:
    kinds = sorted({one.kind for one in conversion.components})
    told = "; ".join(_in_words(*one) for one in conversion.missing[:5]) or (
        f"its components are {', '.join(kinds[:20])}" if kinds else "it has no components")  # fmt: skip
    return f"no body can be converted: {told}"


def write(conversion: Conversion, file: Path, replace: bool) -> None:
    """Writes the scene and the files beside it, when it can be built.

    Args:
        conversion: The conversion.
        file: Its source.
        replace: Whether existing files are replaced.

    Raises:
        SoftRobotTwinError: The scene cannot be built, or a file exists.
    """
    output, folder = conversion.output, conversion.output.resolve().parent
    tables = {f"{output.stem}_{kind}.csv": (kind, getattr(conversion, kind)) for kind in ("commands", "targets")}
    there = [folder / name for name in (*conversion.files, *tables) if (folder / name).exists()]
    if there and not replace:
        raise SceneExistsError(there[0], "exists already, and would be written; --force replaces it")
    for name, write_file in conversion.files.items():
        with output_file(folder / name) as part:
            write_file(part)
    try:
        text = _buildable(conversion, file)
    except SoftRobotTwinError:
        for name in conversion.files:
            (folder / name).unlink(missing_ok=True)
        raise
    can_move = any(map(conversion.scene.get, (*TABLE["actuators"], "stiffeners")))
    for name, (kind, columns) in tables.items():
        if columns and (can_move if kind == "targets" else any(columns.values())):
            with output_file(folder / name) as part:
                _write_rows(conversion, kind, columns, part)
        else:
            with writing(folder / name):  # One of an earlier conversion does not belong to this scene.
                (folder / name).unlink(missing_ok=True)
    with output_file(output) as part:
        part.write_text(text, encoding="utf-8")


def _buildable(conversion: Conversion, file: Path) -> str:
    """The text of a scene that can be built: entries that cannot, and that nothing needs, are listed instead."""
    units = conversion.units
    while True:
        order = [*TABLE["order"], *conversion.scene]
        own = {key: conversion.scene[key] for key in order if conversion.scene.get(key)}
        text = scene_yaml(own, [
            f"Converted from {file.name}. SI units; the file's are {units.name} ({units.reason}).",
            f"Its step is {conversion.time_step:g} s: give simulate --rate {1.0 / conversion.time_step:g}.",
            *conversion.notes,
            *(f"Not converted: {_in_words(*one)}" for one in conversion.missing)])  # fmt: skip
        try:
            Simulation(scene_from_mapping(read_yaml(text), conversion.output.resolve()))
        except SceneError as error:
            if not conversion.drop(error.key, error.reason):
                raise
        else:
            return text


def _write_rows(conversion: Conversion, kind: str, columns: Mapping[str, Any], path: Path) -> None:
    """A file of commands or targets that holds the values of the scene; commands begin at rest."""
    steps, values = np.arange(SETTLING_STEPS + 1.0), np.array(list(columns.values()))
    rows = np.column_stack([steps * conversion.time_step, np.tile(values, (len(steps), 1))])
    rows[0, 1:] *= kind == "targets"
    np.savetxt(path, rows, "%.10g", ",", header=",".join(["time_s", *columns]), comments="")


def _in_words(component: SceneComponent | None, reason: str) -> str:
    return reason if component is None else f"{component.kind} ({component.where}) {reason}"


def _report(conversion: Conversion, file: Path) -> None:
    """Prints what was converted, in SI units, and what was not."""
    units = conversion.units
    head = f"{conversion.output}: {file.name} in {units.name} ({units.reason})"
    tables = [table(head, "component", "line", "became"), table("not converted", "component", "line", "why")]
    for filled, rows in zip(tables, (conversion.told, conversion.missing), strict=True):
        for component, told in rows:
            filled.add_row(*(("", "") if component is None else (component.kind, component.where)), told)
    print_apart(*(filled for filled in tables if filled.row_count), *conversion.notes)
    console().print(f"Look at it: softrobot_twin explain {conversion.output}\nRun it:     softrobot_twin simulate "
                    f"{conversion.output} --steps 20 --rate {1.0 / conversion.time_step:g} --output run.csv",
                    soft_wrap=True)  # fmt: skip

