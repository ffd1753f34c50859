"""The commands of ``python -m softrobot_twin``: each is a function, and its help is its docstring.

A command imports its study when it runs: the simulation loads in a second or more, which neither a
help text nor a mistyped argument has to wait for, and no command needs the studies of the others.
"""

from __future__ import annotations

import argparse
import math
import os
import signal
from collections.abc import Callable, Sequence
from pathlib import Path
from textwrap import fill
from typing import Annotated, TypeAlias

from softrobot_twin.command_line.arguments import TEXT_WIDTH, Parser, Read, add_command
from softrobot_twin.errors import MOST_COUNTED, NamedError, SoftRobotTwinError
from softrobot_twin.harness.length_units import UNITS
from softrobot_twin.harness.machine_facts import installed_version
from softrobot_twin.reduction import training_options
from softrobot_twin.reduction.training_options import (
    AROUND,
    ENERGY,
    FRESH_STATES,
    SPARE_MODES,
    TEST_STATES,
    TOLERANCE,
    TargetBox,
    TrainingOptions,
)
from softrobot_twin.shared_files import given_file

EXIT_CODES = fill("exit codes: 0 done, 1 done but a row, a process or a check failed, 2 the input or "
                  "an argument cannot be used, 3 simulate: the last row is not_converged or "
                  "inverted, or a row beyond a limit; convert: something has no counterpart, 130 stopped by Ctrl-C",
                  TEXT_WIDTH)


class OptionError(NamedError):
    """An option has no effect in this combination."""


def refuse(reason: str, **given: object) -> None:
    """Refuses options, by their names, that have no effect in this combination.

    Args:
        reason: Why they have none here.
        **given: Value of each option by its name; None, False and no values stand for one that was
            not given.
    """
    for option, value in given.items():
        if value not in (None, False, (), []):
            raise OptionError(f"--{option.rstrip('_').replace('_', '-')}", reason)


# --- how values are read --------------------------------------------------------------------------


def number(
    kind: Callable[[str], float], is_good: Callable[[float], bool], reason: str, scale: float = 1.0
) -> Callable[[str], float]:  # fmt: skip
    """A function that reads a word of the command line as a number.

    Args:
        kind: `int` or `float`.
        is_good: Whether a number is taken.
        reason: What is told of one that is not.
        scale: What one is multiplied by.
    """
    def read(text: str) -> float:
        try:
            value = kind(text)
        except ValueError:
            what = "whole number" if kind is int else "number"
            raise argparse.ArgumentTypeError(f"{text} is no {what}") from None
        return _accepted(value if scale == 1.0 else scale * value, is_good(value), f"{text} {reason}")

    return read


def whole(least: int, most: int = MOST_COUNTED) -> Callable[[str], float]:
    """A function that reads a word of the command line as a count.

    Args:
        least: The least one that is taken.
        most: The greatest.
    """
    return number(int, lambda value: least <= value <= most, f"must lie in {least}..{most:,}")


seed = number(int, lambda value: value >= 0, "must not be negative")
fraction = number(float, lambda value: 0.0 <= value < 1.0, "must be at least 0 and below 1")
rate = number(float, lambda value: 0.1 <= value <= 10_000.0, "must lie in 0.1..10000 Hz")
seconds = number(float, lambda value: 1.0 <= value <= 3600.0, "must lie in 1..3600 s")
duration = number(float, lambda value: 0.0 < value <= 86_400.0, "must lie above 0 and up to 86400 s")
positive = number(float, lambda value: 0.0 < value < math.inf, "must be above zero")
instant = number(float, lambda value: 0.0 <= value < math.inf, "must be finite and not negative")
angle = number(float, math.isfinite, "must be finite")
tilt = number(float, lambda value: 0.0 < value <= 180.0,
              "must lie above 0 and up to 180 degrees", math.radians(1.0))


def length(text: str) -> float:
    """Parses a length with its unit, such as 6mm, 0.006m or, in metres, 6e-3 [m].

    Args:
        text: The word of the command line.
    """
    return _with_unit(text, UNITS, "a length such as 6mm, 0.6cm, 0.006m or 6e-3 (metres)")


def step_time(text: str) -> float:
    """Parses a time with its unit, such as 2ms or, in seconds, 0.002 [s].

    Args:
        text: The word of the command line.
    """
    return _with_unit(text, {"s": 1.0, "ms": 1e-3, "us": 1e-6},
                      "a time such as 2ms, 0.002s or 2e-3 (seconds)")


def _with_unit(text: str, units: dict[str, float], expected: str) -> float:
    """A number with a unit in SI; without a unit it is SI."""
    word = text.strip()
    name = next((one for one in sorted(units, key=len, reverse=True) if word.endswith(one)), "")
    try:
        number = float(word.removesuffix(name)) * units.get(name, 1.0)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text} is not {expected}") from None
    return _accepted(number, 0.0 < number < math.inf, f"{text} must be above zero and finite")


def share(text: str) -> float:
    """Parses a percentage, such as 1%, as a share.

    Args:
        text: The word of the command line [%].
    """
    number = positive(text.removesuffix("%")) / 100.0
    return _accepted(number, number <= 1.0, f"{text} must be at most 100 %")


def point(text: str) -> tuple[float, float, float]:
    """Parses a point [m], such as 0,0,0.1.

    Args:
        text: The word of the command line: three numbers with commas between [m].
    """
    values = tuple(map(float, text.split(",")))
    is_point = len(values) == 3 and all(map(math.isfinite, values))
    return _accepted(values, is_point, f"{text} must be three numbers, X,Y,Z [m]")


def target_box(text: str) -> TargetBox:
    """Parses a box of an effector's targets.

    Args:
        text: The word of the command line: an effector's name, ``=``, and three ranges ``FROM:TO``
            [m] with commas between.
    """
    name, _, ranges = text.partition("=")
    bounds = [tuple(map(float, part.split(":"))) for part in ranges.split(",")]
    is_box = len(bounds) == 3 and all(len(pair) == 2 and pair[0] <= pair[1] for pair in bounds)
    is_finite = all(math.isfinite(end) for pair in bounds for end in pair)
    _accepted(text, bool(name) and is_box and is_finite,
              f"{text} must be NAME=XLOW:XHIGH,YLOW:YHIGH,ZLOW:ZHIGH [m]")
    return TargetBox(name, *zip(*bounds))


def _accepted(value, is_good: bool, reason: str):
    """A value that is good; the argument is refused where it is not."""
    if not is_good:
        raise argparse.ArgumentTypeError(reason)
    return value


Seed: TypeAlias = Annotated[int, Read(seed)]
Count: TypeAlias = Annotated[int, Read(whole(0))]
Fraction: TypeAlias = Annotated[float, Read(fraction)]
GivenFile: TypeAlias = Annotated[Path, Read(given_file)]
PositiveCount: TypeAlias = Annotated[int, Read(whole(1))]
Rate: TypeAlias = Annotated[float, Read(rate)]
Length: TypeAlias = Annotated[float, Read(length)]
Positive: TypeAlias = Annotated[float, Read(positive)]
Tilt: TypeAlias = Annotated[float, Read(tilt)]
TargetBoxes: TypeAlias = Sequence[Annotated[TargetBox, Read(target_box)]]
Points: TypeAlias = Sequence[Annotated[tuple[float, float, float], Read(point, nargs="+")]]
View: TypeAlias = tuple[Annotated[float, Read(angle)], float]
Unit: TypeAlias = Annotated[str, Read(choices=tuple(sorted(UNITS)))]


# --- the commands ---------------------------------------------------------------------------------

def mesh(
    part: Path, *, size: Length | None = None, rate: Rate | None = None,
    step_time: Annotated[float, Read(step_time)] | None = None, output: Path | None = None,
    unit: Unit | None = None,
    element: Annotated[str, Read(choices=("linear", "smoothed", "quadratic"))] = "quadratic",
    repair: bool = False, turn: Count | None = None,
) -> int:  # fmt: skip
    """Fill a part from a CAD program with tetrahedra.

    Mesh a part with gmsh, in metres. Closed surfaces inside it become cavity_1, cavity_2, ...; solids
    of a STEP file become regions. An open surface, or solids that overlap, are refused.

    Examples:
        softrobot_twin mesh finger.stl --size 6mm --output finger.msh
        softrobot_twin mesh scan.obj --repair --output scan.stl

    Args:
        part (PART): CAD file: .stl, .obj, .ply, .off, .step or .stp.
        size (LENGTH): Edge of the tetrahedra, such as 6mm.
        rate (HZ): Search the least size whose steps keep this rate.
        step_time (TIME): Search the least size whose steps take at most this time, such as 5ms.
        output (FILE): Mesh file, .msh (default: the part's name, in the current folder); with --repair
            also .stl.
        unit: Unit of a file of triangles, which states none (default: mm).
        element: Elements whose step is measured (default: quadratic).
        repair: Close holes, and unite solids that overlap or touch.
        turn (N): Elements in a full turn of curved faces; 0 refines none (default: 16 in cavities).
    """
    from softrobot_twin.study.choice import MARGIN
    from softrobot_twin.study.meshing import mesh_part

    return mesh_part(part, output or Path(f"{part.stem}.msh"), size=size,
                     step=step_time if rate is None else MARGIN / rate, unit=unit, element=element,
                     repair=repair, turn=turn)


def init(
    mesh: Path, *, output: Path | None = None, size: Length | None = None,
    unit: Unit | None = None, force: bool = False,
) -> int:  # fmt: skip
    """Write a first scene for a mesh.

    Write a commented scene for a mesh or CAD file. It runs as it is: what the file does not say is
    guessed and told.

    Examples:
        softrobot_twin init finger.msh

    Args:
        mesh (MESH): Mesh file (.msh, .vtk, .vtu, .inp) or CAD file.
        output (SCENE): Scene to write (default: beside the mesh, with its name).
        size (LENGTH): Edge of the tetrahedra of a CAD file, such as 6mm (default: a coarse mesh).
        unit: Unit of the file (default: guessed; STEP files state theirs).
        force: Replace a scene that exists.
    """
    from softrobot_twin.study import first_scene

    scale = None if unit is None else UNITS[unit]
    return first_scene.init(mesh, output, size=size, scale=scale, replace=force)


def convert(
    file: Path, *, output: Path | None = None,
    units: Annotated[str | None, Read(choices=("mm-kg-s", "mm-g-s", "cm-kg-s", "m-kg-s"))] = None,
    time_limit: Annotated[float, Read(seconds)] = 60.0, force: bool = False,
) -> int:  # fmt: skip
    """Convert a scene of SOFA.

    Write a scene from one of SOFA, with comments on its source. What has no counterpart is listed, with
    exit code 3. A Python scene is a program: it runs in a process of its own.

    Examples:
        softrobot_twin convert robot.scn --units mm-g-s --output robot.yaml

    Args:
        file (SCENE): Scene of SOFA: .py, .pyscn, .scn or .xml.
        output (FILE.yaml): Scene to write (default: the file's name, in the current folder).
        units: Units of the file, which states none (default: by its gravity).
        time_limit (S): Longest time that a Python scene may run (default 60 s).
        force: Replace a scene that exists.
    """
    from softrobot_twin.conversion.converting import convert as convert_scene

    return convert_scene(file, output or Path(f"{file.stem}.yaml"), units, time_limit, force)


def simulate(
    scene: GivenFile, *, targets: GivenFile | None = None, commands: GivenFile | None = None,
    seconds: Annotated[float, Read(duration)] | None = None, steps: PositiveCount | None = None,
    output: Path, settle: Count | None = None, rate: Rate | None = None,
    picture: Path | None = None, picture_at: Sequence[Annotated[float, Read(instant)]] | None = None,
    picture_view: View | None = None, axes: str | None = None, backwards: Sequence[str] = (),
) -> int:  # fmt: skip
    """Run a scene offline, without ROS.

    Run a scene over a targets file, a row a step, over a commands file at a fixed rate, or without
    commands. docs/files.md describes the columns; <effector>_by_cameras_* is an effector in marker_frame.

    Examples:
        softrobot_twin simulate config/scenes/diamond.yaml --targets config/targets/diamond_circle.csv --output run.csv
        softrobot_twin simulate config/scenes/grasper.yaml --commands config/commands/grasper_lift.csv \\
            --output run.csv --picture run.png --picture-at 0.2 2 14
        softrobot_twin simulate config/scenes/cantilever.yaml --seconds 1 --rate 500 --output run.csv

    Args:
        scene (SCENE): Scene file (YAML).
        targets (FILE.csv): Targets to follow, row by row.
        commands (FILE.csv): Commands over time.
        seconds (S): Run without commands for this time [s].
        steps (N): Run without commands for this number of steps.
        output (FILE.csv): File to write, one row per step.
        settle (N): Run the first row of --targets N times before recording (default 0).
        rate (HZ): Steps a second, without --targets (default 50).
        picture (FILE.png): Draw the last state (needs matplotlib).
        picture_at (S): Draw these times [s] side by side instead.
        picture_view (ELEVATION AZIMUTH): Direction of view [degrees] (default 24 -58).
        axes (AXES): Axes of the file that is read that are x, y and z of the scene (default: x,y,z).
        backwards (ACTUATOR): Actuators with the other sign in this file.
    """
    from softrobot_twin.study import offline_run
    from softrobot_twin.study.direct_run import (
        DEFAULT_RATE,
        simulate_alone,
        simulate_commands,
        step_count,
    )
    from softrobot_twin.tables.input_tables import Axes

    _check_outputs((scene, targets, commands), output=output, picture=picture)
    read_as = Axes.read(axes or "x,y,z", backwards)
    if targets is not None:
        refuse("requires --commands", rate=rate, picture_at=picture_at, picture_view=picture_view)
        return offline_run.simulate(scene, targets, output, settle or 0, picture, read_as)
    if settle is not None:
        raise OptionError("--settle", "requires --targets")
    if picture is None:
        refuse("requires --picture", picture_at=picture_at, picture_view=picture_view)
    drawn = None if picture is None else offline_run.Picture(picture, tuple(picture_at or ()), picture_view)
    steps_a_second = rate or DEFAULT_RATE
    if commands is not None:
        return simulate_commands(scene, commands, output, steps_a_second, drawn, read_as)
    refuse("requires --targets or --commands", axes=axes, backwards=backwards)
    time = seconds or (steps or 0) / steps_a_second
    step_count("--seconds" if seconds else "--steps", time, steps_a_second)
    return simulate_alone(scene, time, output, steps_a_second, drawn)


def _check_outputs(inputs: Sequence[Path | None], **outputs: Path | None) -> None:
    """Refuses inputs that are given twice, and outputs that would overwrite a file given or are folders."""
    taken = dict[str, Path]()
    for one in filter(None, inputs):
        if taken.setdefault(os.path.realpath(one), one) is not one:
            raise OptionError(str(one), "is given twice")
    for name, path in ((name.replace("_", "-"), path) for name, path in outputs.items() if path is not None):
        try:
            if path.is_dir():
                raise OptionError(f"--{name}", f"{path} is a folder, not a file")
            if path.exists() and not path.is_file():  # a device file can always be written
                continue
        except OSError as error:
            raise OptionError(f"--{name}", error.strerror or str(error)) from error
        target = os.path.realpath(path)  # That of pathlib refuses links in a circle, with no error of the system.
        if target in taken:
            raise OptionError(f"--{name}", f"{path} would overwrite {taken[target]}")
        taken[target] = path


def plot(file: Path, *, columns: Sequence[str] = (), output: Path | None = None) -> int:
    """Draw what a run wrote over time.

    Draw the file of a run, of workspace, targets or commands, a panel for each quantity.

    Examples:
        softrobot_twin plot run.csv --columns 'tip_*' '*_tension_N' --output tensions.png

    Args:
        file (RUN.csv): File of a run.
        columns (GLOB): Draw all columns that match.
        output (FILE.png): Picture to write (default RUN_plot.png beside the file).
    """
    from softrobot_twin.study import run_plot

    return run_plot.plot(file, columns, output)


def explain(
    scene: GivenFile, *, mesh_error: bool = True, picture: Path | None = None,
    picture_view: View | None = None, stiffness: bool = False, effects: bool = False,
    at: Sequence[str] | None = None,
) -> int:  # fmt: skip
    """Show the effects of a scene and the terms they become.

    Print what a scene contains: actuators, effectors, size, mass, sag, terms, stages of a step, and an
    estimate of the mesh's error.

    Examples:
        softrobot_twin explain config/scenes/diamond.yaml --stiffness --at north_shortening_m=0.01
        softrobot_twin explain config/scenes/grasper.yaml --effects

    Args:
        scene (SCENE): Scene file (YAML).
        mesh_error: Leave out this estimate, which takes the longest.
        picture (FILE.png): Draw the robot at rest with names (needs matplotlib).
        picture_view (ELEVATION AZIMUTH): Direction of view [degrees] (default 24 -58).
        stiffness: Print instead how effectors yield to forces, and how each actuator moves them.
        effects: Print instead what each effect costs in time, and what changes without it.
        at (COLUMN=VALUE): With these two: the actuation, such as north_shortening_m=0.01 (default: at rest).
    """
    from softrobot_twin.study.effect_costs import print_effects
    from softrobot_twin.study.explain import explain as print_scene
    from softrobot_twin.study.stiffness import print_stiffness

    _check_outputs((scene,), picture=picture)
    if stiffness or effects:
        refuse(f"cannot be combined with --{'stiffness' if stiffness else 'effects'}",
               effects=stiffness and effects, picture=picture)
        return (print_stiffness if stiffness else print_effects)(scene, at or ())
    refuse("requires --stiffness or --effects", at=at)
    if picture is None:
        refuse("requires --picture", picture_view=picture_view)
    return print_scene(scene, mesh_error, picture, picture_view)


def calibrate(
    scene: GivenFile, *, data: Sequence[GivenFile], fit: Sequence[str] = (), known: Sequence[str] = (),
    check: Sequence[GivenFile] = (), output: Path | None = None, picture: Path | None = None,
    suggest: bool = False, axes: str | None = None, backwards: Sequence[str] = (),
) -> int:  # fmt: skip
    """Fit numbers of a scene to what was measured on the robot.

    Fit numbers of a scene to markers and efforts that were measured at rest. One of four poses is held
    back to judge the result. A new scene is written only where it predicts these poses better.

    Examples:
        softrobot_twin calibrate config/scenes/diamond.yaml --data run.mcap \\
            --fit body.material.young_modulus cables.*.offset marker_frame --picture fit.png
        softrobot_twin calibrate finger.yaml --data poses.csv --fit body.material.young_modulus --suggest

    Args:
        scene (SCENE): Scene file (YAML).
        data (FILE): Recorded runs (.mcap), or tables (.csv) with setpoints, markers and efforts.
        fit (KEY): Numbers to fit, perhaps with *; keys joined by + change together, # moves copies of a
            repeated entry (default: those that lower the error of poses held back).
        known (KEY=DEVIATION): Standard deviation before the fit, in the unit of the number, or as a
            share of moduli and densities. Or KEY=VALUE±DEVIATION of what was measured otherwise.
        check (FILE): Runs and tables that judge the result (default: every fourth pose).
        output (FILE.yaml): Scene to write (default: beside the scene, SCENE_calibrated.yaml).
        picture (FILE.png): Draw the errors before and after, and the intervals.
        suggest: Tell what should be measured next.
        axes (AXES): Axes of the tables that are x, y and z of the scene (default: x,y,z).
        backwards (ACTUATOR): Actuators with the other sign in the tables.
    """
    from softrobot_twin.calibration.calibration_report import calibrate_scene
    from softrobot_twin.tables.input_tables import Axes

    _check_outputs((scene, *data, *check), output=output, picture=picture)
    return calibrate_scene(scene, data, fit, known, output, picture, suggest, check,
                           Axes.read(axes or "x,y,z", backwards))  # fmt: skip


def workspace(
    scene: GivenFile, *, output: Path, picture: Path | None = None, samples: PositiveCount = 200,
    seed: Seed = 0, range_: Sequence[str] = (), workers: PositiveCount | None = None,
    scheduler: str | None = None,
) -> int:  # fmt: skip
    """Sample where a robot gets, and how stiff it is there.

    Sample the actuators over their bounds, and write where the effectors come to rest, their stiffness,
    and the efforts. After Ctrl-C the command goes on.

    Examples:
        softrobot_twin workspace config/scenes/diamond.yaml --samples 160 --output workspace.csv --picture workspace.png
        softrobot_twin workspace config/scenes/diamond.yaml --range north_shortening_m=0:0.01 --output workspace.csv

    Args:
        scene (SCENE): Scene file (YAML).
        output (FILE.csv): File to write.
        picture (FILE.png): Draw the places, coloured by stiffness (needs matplotlib).
        samples (N): Samples (default $default).
        seed (S): Seed of their places (default $default).
        range_ (COLUMN=LOW:HIGH): Bounds in place of the scene's, such as north_shortening_m=0:0.01.
        workers (N): Processes on this machine (default: one on each core).
        scheduler (ADDRESS): Compute on the Dask cluster of this scheduler instead, such as
            tcp://10.0.0.1:8786 (needs distributed).
    """
    from softrobot_twin.study.workspace import workspace as sample

    _check_outputs((scene,), output=output, picture=picture)
    if scheduler is not None:
        refuse("has no effect with --scheduler", workers=workers)
    enable_interrupts()
    return sample(scene, output, picture, samples, seed, range_, workers, scheduler)


def bench(
    scenes: Sequence[GivenFile] = (), *, output: Path | None = None,
    steps: Annotated[int, Read(whole(1, 100_000))] = 1000, commands: GivenFile | None = None,
    threads: PositiveCount | None = None,
) -> int:  # fmt: skip
    """Time a step, stage by stage.

    Time every stage of a step while the effector follows a circle, or the actuators move over their
    limits; by default of the Diamond.

    Examples:
        softrobot_twin bench config/scenes/diamond.yaml --steps 300

    Args:
        scenes (SCENE): Scene file (YAML).
        output (FOLDER): Write bench.csv there.
        steps (N): Steps to time for each size (default $default).
        commands (FILE.csv): Time the longest hold of this commands file instead.
        threads (N): Most threads of large systems, in place of `solver.threads`.
    """
    from softrobot_twin.study.bench import bench as measure

    if not scenes:
        refuse("requires a scene to time", commands=commands)
    return measure(list(scenes), steps, output, commands, threads)


def accuracy(
    scene: GivenFile, *, output: Path = Path("out/accuracy"), timed_dof: PositiveCount = 60_000,
    reference_dof: PositiveCount = 200_000, reduced: Sequence[Path] = (),
) -> int:  # fmt: skip
    """Measure accuracy against computing time.

    Measure the effector's error and the time of a step over meshes, elements and laws. Meshes lie
    beside the mesh of the scene, with other numbers at the end of their names.

    Examples:
        softrobot_twin accuracy config/scenes/diamond.yaml

    Args:
        scene (SCENE): Scene file (YAML).
        output (FOLDER): Folder for accuracy.csv and accuracy.png (default $default).
        timed_dof (N): Most dof of a setting that is timed (default $default).
        reference_dof (N): Most dof of a mesh of the reference (default $default).
        reduced (FILE.npz): Reduced models of these meshes, written by 'reduce'.
    """
    from softrobot_twin.study.accuracy import accuracy as measure
    from softrobot_twin.study.accuracy_study import Limits

    return measure(scene, output, Limits(timed_dof, reference_dof), reduced)


def choose(
    scene: GivenFile, *, rate: Rate, accuracy: Path | None = None, write: Path | None = None,
    reduced: Sequence[Path] = (),
) -> int:  # fmt: skip
    """Find the most accurate setting that keeps a rate.

    Time meshes, elements, laws and reduced models on this machine, print the most accurate setting that
    keeps the rate, and write its scene.

    Examples:
        softrobot_twin choose config/scenes/diamond.yaml --rate 200

    Args:
        scene (SCENE): Scene file (YAML).
        rate (HZ): Rate to keep [Hz].
        accuracy (FILE.csv): File of errors written by accuracy; made quickly if it does not exist.
        write (FILE.yaml): Scene file to write (default <name>_<rate>hz.yaml here).
        reduced (FILE.npz): Further reduced models of these meshes, written by 'reduce'.
    """
    from softrobot_twin.study.choice import choose as choose_setting

    _check_outputs((scene, accuracy), write=write)
    return choose_setting(scene, rate, accuracy, write, reduced=reduced)


def reduce(
    scene: GivenFile, *, body: str | None = None, output: Path | None = None,
    snapshots: PositiveCount | None = None, range_: Sequence[str] = (), targets: TargetBoxes = (),
    along: GivenFile | None = None, around: Positive | None = None, loads: Positive = 0.0,
    load_points: Points | None = None,
    surface_loads: PositiveCount | None = None, tilts: Tilt = 0.0, seed: Seed = 0,
    error: Annotated[float, Read(share)] | None = None, energy: Fraction | None = None,
    modes: PositiveCount | None = None, spare_modes: Count = SPARE_MODES,
    vibration_modes: Count | None = None, tolerance: Fraction = TOLERANCE, states: Count = FRESH_STATES,
    workers: PositiveCount | None = None, scheduler: str | None = None,
) -> int:  # fmt: skip
    """Make the reduced model of a deformable body.

    Train a reduced model, and write a file that the scene names by 'reduced: {file: ...}'. Sample what
    the robot will meet: loads, tilts and the whole range. After Ctrl-C the command goes on.

    Examples:
        softrobot_twin reduce config/scenes/diamond_reduced.yaml --error 1% \\
            --targets tip=-0.02:0.02,-0.02:0.02,0.122:0.140

    Args:
        scene (SCENE): Scene file (YAML).
        body (NAME): Body to reduce, where there are several.
        output (FILE.npz): File to write (default <name of the scene>_reduced.npz beside the mesh).
        workers (N): Processes on this machine (default: one on each core).
        scheduler (ADDRESS): Compute states on the Dask cluster of this scheduler instead, such as
            tcp://10.0.0.1:8786 (needs distributed).

    What is sampled:
        snapshots (N): States of the full model (default $SNAPSHOTS; with --error $FIRST_SNAPSHOTS to
            begin with).
        range_ (COLUMN=LOW:HIGH): Bounds in place of the scene's.
        targets (BOX): Sample where the inverse brings the effectors:
            NAME=XLOW:XHIGH,YLOW:YHIGH,ZLOW:ZHIGH [m]; fewer modes, valid only there.
        along (TARGETS.csv): Sample along a path of targets, in contact.
        around (M): Shift of each pass of that path, at most [m] (default $AROUND).
        loads (N): Forces up to this [N] in any direction, in half of the states (default none).
        load_points (X,Y,Z): Points of --loads at rest [m] (default the effectors).
        surface_loads (COUNT): So many further points, spread over the surface.
        tilts (DEGREES): Directions of gravity up to this angle from the scene's.
        seed (S): Seed of all samples (default $default).

    How accurate it is:
        error (PERCENT): Wanted largest error at fresh states, such as 1%.
        energy (SHARE): Share of the energy that the modes leave out (default $ENERGY).
        modes (N): Number of modes instead, rounded up to a multiple of three.
        spare_modes (N): Modes beyond, for the estimate of the error (default $default).
        vibration_modes (N): Slowest vibrations among the modes (default $VIBRATIONS where the scene has
            inertia, else none).
        tolerance (SHARE): Virtual work that the sampled points leave out (default $default).
        states (N): Fresh states for the error (default $default; 0 for none).
    """
    from softrobot_twin.reduction import body_training

    _check_outputs((scene, along), output=output)
    if scheduler is not None:
        refuse("has no effect with --scheduler", workers=workers)
    if not loads:
        refuse("requires --loads", load_points=load_points, surface_loads=surface_loads)
    if targets:
        refuse("has no effect with --targets", range_=range_)
    if along is None:
        refuse("requires --along", around=around)
    else:
        refuse("has no effect with --along", targets=targets, range_=range_, loads=loads,
               tilts=tilts, error=error)
    if modes is not None and energy is not None:
        raise OptionError("--energy", "has no effect with --modes")
    enable_interrupts()
    options = TrainingOptions(
        body, output, snapshots, tuple(range_), tuple(targets), loads, tuple(load_points or ()),
        surface_loads or 0, tilts, ENERGY if energy is None else energy, modes, spare_modes,
        tolerance, error, states, seed, workers, scheduler, along, around or AROUND, vibration_modes,
    )  # fmt: skip
    return body_training.reduce(scene, options)


def reduce_vertebrae(
    scene: GivenFile, *, again: bool = False, seed: Seed = 1, states: Count = TEST_STATES
) -> int:  # fmt: skip
    """Make the superelements of bodies with vertebrae.

    Make superelements that are missing or out of date, and state their error at fresh states.

    Examples:
        softrobot_twin reduce-vertebrae config/scenes/fetch_reduced.yaml

    Args:
        scene (SCENE): Scene file (YAML).
        again: Make them even where they are current.
        seed: Of setpoints and samples (default $default).
        states (N): Fresh states for the error (default $default; 0 for none).
    """
    from softrobot_twin.reduction import vertebrae_reduction

    return vertebrae_reduction.reduce_vertebrae(scene, seed, states, again)


class NoRosError(SoftRobotTwinError):
    """rclpy cannot be imported."""

    def __init__(self, reason: str):
        super().__init__(f"ROS 2 was not found ({reason}): source ROS 2 Jazzy, or run 'make demo'")


def replay(
    recorded: Path, *, scene: GivenFile | None = None,
    set_: Sequence[str] | None = None,
    output: Path | None = None, record_view: Path | None = None,
) -> int:  # fmt: skip
    """Run a recorded run of a twin again.

    Repeat a recorded run, each message and tick in its order, and print whether all results are equal to
    the bit, or the differences.

    Examples:
        softrobot_twin replay run.mcap --set body.material.young_modulus=1.5e5
        softrobot_twin replay run.mcap --scene config/scenes/diamond.yaml --output run.csv

    Args:
        recorded (FILE.mcap): File of the run.
        scene (FILE.yaml): Another scene, with the same actuators and effectors.
        set_ (KEY=VALUE): Other values of the recorded scene.
        output (FILE.csv): File to write, one row per tick of the replay.
        record_view (FILE.rrd): File of pictures of the replay, for rerun.
    """
    _check_outputs((recorded, scene), output=output, record_view=record_view)
    # The loop is loaded only for a run of it.
    from softrobot_twin.command_line import replay_command
    return replay_command.replay(recorded, scene, set_ or (), output, record_view)


def enable_interrupts() -> None:
    """Lets Ctrl-C interrupt this process and its children, also when a shell started it in the
    background, where it would be ignored.
    """
    signal.signal(signal.SIGINT, signal.default_int_handler)


def demo(
    *, robot: str = "diamond", output: Path = Path("out/demo"),
    seconds: Annotated[float, Read(seconds)] = 30.0,
    set_: Sequence[str] | None = None, view: bool = True,
) -> int:  # fmt: skip
    """Drive a simulated robot live over ROS 2.

    Start twin, device and target, follow a path open loop and then closed loop, and report the tracking
    errors.

    Examples:
        softrobot_twin demo --robot trunk --seconds 10 --no-view

    Args:
        robot (NAME): Name of a file config/NAME.yaml (default $default).
        output (FOLDER): Folder for report.json, run.rrd and tracking.png (default $default).
        seconds (S): Length of each run [s] (default 30).
        set_ (KEY=VALUE): Other values of the twin's scene; the device keeps its own.
        view: No live view; run.rrd is still recorded.
    """
    enable_interrupts()
    # This comes first: the ROS wheels restart this process when rclpy is imported.
    try:
        import softrobot_twin.ros.demo  # noqa: F401
    except ImportError as error:
        raise NoRosError(str(error)) from error
    from softrobot_twin.command_line import demo_command
    return demo_command.demo(robot, output, seconds, view, set_ or ())


COMMANDS = (
    mesh, init, convert, simulate, plot, explain, calibrate, workspace, bench, accuracy, choose, reduce,
    reduce_vertebrae, replay, demo,
)  # fmt: skip
"""The commands in the order of their list."""
EXCLUSIVE = {
    mesh: (("size", "rate", "step_time"), False),
    simulate: (("targets", "commands", "seconds", "steps"), True),
    replay: (("scene", "set_"), False),
}
"""Options of which at most one may be given, and whether one must be."""


NODES = ("twin", "device", "target")
"""Nodes, which take the arguments of `ros2 run softrobot_twin NODE`."""


def program(name: str) -> argparse.ArgumentParser:
    """The one parser of all commands.

    Args:
        name: How the program was called.
    """
    made = Parser(
        prog=name, description="Simulate and control soft robots. All values are in SI units.",
        epilog="COMMAND --help shows the options of a command, with examples. "
               f"{', '.join(NODES)}: nodes, as with ros2 run.\n\n{EXIT_CODES}",
        formatter_class=argparse.RawDescriptionHelpFormatter)
    made.add_argument("--version", action="version",
                      version=f"softrobot_twin {installed_version('softrobot_twin') or '(not installed)'}")
    commands = made.add_subparsers(title="commands", dest="command", metavar="COMMAND", required=True)
    for command in COMMANDS:
        add_command(commands, command, *EXCLUSIVE.get(command, ((), False)),
                    vars(training_options), EXIT_CODES)
    return made
