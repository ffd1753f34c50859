"""The commands of ``python -m softrobot_twin`` and the arguments that each takes.

A command imports its study when it runs: the simulation loads in a second or more, which neither a
help text nor a mistyped argument has to wait for, and no command needs the studies of the others.
"""

from __future__ import annotations

import argparse
import math
import signal
from collections.abc import Callable
from dataclasses import replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from textwrap import fill

import shtab

from softrobot_twin.errors import SoftRobotTwinError
from softrobot_twin.study.length_units import UNITS
from softrobot_twin.study.training_options import (
    AROUND,
    ENERGY,
    FIRST_SNAPSHOTS,
    FRESH_STATES,
    SNAPSHOTS,
    SPARE_MODES,
    TEST_STATES,
    TOLERANCE,
    TargetBox,
    TrainingOptions,
)

TEXT_WIDTH = 78
"""Columns of the texts of a command's help."""

EXIT_CODES = fill("exit codes: 0 done, 1 done but a row, a process or a check failed, 2 the input or "
                  "an argument cannot be used, 3 simulate: the last row is not_converged or "
                  "inverted, 130 stopped by Ctrl-C", TEXT_WIDTH)


class OptionError(SoftRobotTwinError):
    """An option has no effect in this combination."""

    def __init__(self, option: str, reason: str):
        super().__init__(f"{option}: {reason}")


def add_command(
    commands, name: str, run: Callable[[argparse.Namespace], int], purpose: str, description: str,
    examples: tuple[str, ...],
) -> argparse.ArgumentParser:
    """Declares a command.

    Args:
        commands: Subparsers of the program.
        name: Name of the command.
        run: Runs the command with the parsed arguments and returns the exit code.
        purpose: Short purpose, for the list of commands.
        description: Text of the command's own help.
        examples: Arguments of some uses, shown below the options; a percent sign is written twice.

    Returns:
        Its parser, to which its arguments are added.
    """
    # argparse fills a text of one paragraph or none at all; here the examples keep their lines.
    shown = "\n".join(f"  %(prog)s {arguments}" for arguments in examples)
    parser = commands.add_parser(
        name, help=purpose, description=fill(description, TEXT_WIDTH),
        epilog=f"examples:\n{shown}\n\n{EXIT_CODES}",
        formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.set_defaults(run=run, examples=examples)
    return parser


def add_scene(parser: argparse.ArgumentParser) -> None:
    """Declares the scene argument of a command that takes one scene."""
    parser.add_argument("scene", metavar="SCENE", type=Path, help="scene file (YAML)")


def refuse(chosen: argparse.Namespace, needed: str, *options: str) -> None:
    """Refuses options that have no effect without another one."""
    for option in options:
        if getattr(chosen, option) is not None:
            name = option.replace("_", "-")
            raise OptionError(f"--{name}", f"requires {needed}")


def count(text: str) -> int:
    """Parses an integer of at least 0."""
    number = int(text)
    if number < 0:
        raise argparse.ArgumentTypeError(f"{text} must not be negative")
    return number


def positive_count(text: str) -> int:
    """Parses an integer of at least 1."""
    number = count(text)
    if number == 0:
        raise argparse.ArgumentTypeError(f"{text} must be above zero")
    return number


def rate(text: str) -> float:
    """Parses a rate between 0.1 and 10000 Hz."""
    number = float(text)
    if not 0.1 <= number <= 10_000.0:
        raise argparse.ArgumentTypeError(f"{text} must lie in 0.1..10000 Hz")
    return number


def seconds(text: str) -> float:
    """Parses the length of a run [s]."""
    number = float(text)
    if not 1.0 <= number <= 3600.0:
        raise argparse.ArgumentTypeError(f"{text} must lie in 1..3600 s")
    return number


def duration(text: str) -> float:
    """Parses the duration of a run without commands [s]."""
    number = float(text)
    if not 0.0 < number <= 86_400.0:
        raise argparse.ArgumentTypeError(f"{text} must lie above 0 and up to 86400 s")
    return number


MOST_STEPS = 10_000_000
"""Most steps of a run without commands."""


def add_simulate(commands) -> None:
    """Declares ``simulate``."""
    parser = add_command(
        commands, "simulate", _simulate, "run a scene offline, without ROS",
        "Run a scene over a targets file, row by row; over a commands file, at a fixed rate; or "
        "without commands, for some seconds or steps: actuators hold, bodies sag and fall. "
        "Both have the column time_s. A targets file has, for the inverse problem, <effector>_x_m, "
        "_y_m, _z_m, and where the scene asks for them _qx, _qy, _qz, _qw and _kx_N_per_m. Either "
        "drives actuators by <cable>_shortening_m, _length_m or _tension_N, <motor>_shortening_m "
        "for all its cables, <cavity>_pressure_Pa, or <cavity>_growth_m3 or _volume_m3 where the "
        "scene controls its volume. The time step of a row of a targets file is the time since the "
        "row before; for the first row it is that of the second, for a single row 0.02 s. A commands "
        "file is interpolated between rows, and has <guided body>_x_m, _y_m, _z_m and _qx, _qy, "
        "_qz, _qw too. What a run wrote can be given back as either.",
        examples=(
            "config/scenes/diamond.yaml --targets config/targets/diamond_circle.csv --output run.csv",
            "config/scenes/grasper.yaml --commands config/commands/grasper_lift.csv \\\n"
            "    --output run.csv --picture run.png --picture-at 0.2 2 14",
            "config/scenes/cantilever.yaml --seconds 1 --rate 500 --output run.csv",
        ),
    )
    add_scene(parser)
    driven = parser.add_mutually_exclusive_group(required=True)
    driven.add_argument("--targets", metavar="FILE.csv", type=Path,
                        help="targets to follow, row by row")
    driven.add_argument("--commands", metavar="FILE.csv", type=Path,
                        help="commands of actuators, motors and guided bodies over time")
    driven.add_argument("--seconds", metavar="S", type=duration,
                        help="run without commands for this time [s]")
    driven.add_argument("--steps", metavar="N", type=positive_count,
                        help="run without commands for this number of steps")
    parser.add_argument("--output", required=True, metavar="FILE.csv", type=Path,
                        help="file to write, one row per step")
    parser.add_argument("--settle", type=count, metavar="N",
                        help="with --targets: run the first row N times before recording "
                        "(default 0)")
    parser.add_argument("--rate", type=rate, metavar="HZ",
                        help="steps a second (default 50); not with --targets")
    parser.add_argument("--picture", metavar="FILE.png", type=Path,
                        help="draw the last state (needs matplotlib)")
    parser.add_argument("--picture-at", nargs="+", type=float, metavar="S",
                        help="draw these times [s] side by side instead; not with --targets")
    parser.add_argument("--picture-view", nargs=2, type=float, metavar=("ELEVATION", "AZIMUTH"),
                        help="direction of view [degrees] (default 24 -58); not with --targets")


def add_explain(commands) -> None:
    """Declares ``explain``."""
    parser = add_command(
        commands, "explain", _explain, "show the effects of a scene and the terms they become",
        "Print what a scene contains: actuators and effectors, size, mass and sag, elements across "
        "the thinnest part, cables at rest, all entries and the terms that they become, the stages "
        "of a step, and an estimate of the error of its mesh.",
        examples=(
            "config/scenes/diamond.yaml",
            "config/scenes/diamond.yaml --picture diamond.png",
            "config/scenes/diamond.yaml --stiffness --at north_shortening_m=0.01",
            "config/scenes/grasper.yaml --effects",
        ),
    )
    add_scene(parser)
    parser.add_argument("--no-mesh-error", dest="mesh_error", action="store_false",
                        help="leave out this estimate, which takes longer than everything else")
    parser.add_argument("--picture", metavar="FILE.png", type=Path,
                        help="draw the robot at rest with the names of all its things (needs "
                        "matplotlib)")
    parser.add_argument("--picture-view", nargs=2, type=float, metavar=("ELEVATION", "AZIMUTH"),
                        help="direction of view [degrees] (default 24 -58)")
    parser.add_argument("--stiffness", action="store_true",
                        help="print instead how the effectors yield to forces while the actuators "
                        "hold, and how each actuator moves them")
    parser.add_argument("--effects", action="store_true",
                        help="print instead what each effect of the scene costs in time, and what "
                        "changes without it")
    parser.add_argument("--at", nargs="+", metavar="COLUMN=VALUE",
                        help="with --stiffness or --effects: the actuation, with columns of a "
                        "commands file, such as north_shortening_m=0.01 (default: at rest; of "
                        "--effects: the first actuator by a third of its travel)")


def _simulate(chosen: argparse.Namespace) -> int:
    from softrobot_twin.study.direct_run import (
        DEFAULT_RATE,
        Picture,
        simulate_alone,
        simulate_commands,
    )
    from softrobot_twin.study.offline_run import simulate

    _check_outputs(chosen)
    if chosen.targets is not None:
        refuse(chosen, "--commands", "rate", "picture_at", "picture_view")
        return simulate(chosen.scene, chosen.targets, chosen.output, chosen.settle or 0,
                        chosen.picture)
    refuse(chosen, "--targets", "settle")
    if chosen.picture is None:
        refuse(chosen, "--picture", "picture_at", "picture_view")
    picture = None if chosen.picture is None else Picture(
        chosen.picture, tuple(chosen.picture_at or ()),
        chosen.picture_view and tuple(chosen.picture_view))
    steps_a_second = chosen.rate or DEFAULT_RATE
    if chosen.commands is not None:
        return simulate_commands(chosen.scene, chosen.commands, chosen.output, steps_a_second,
                                 picture)
    seconds = chosen.seconds or chosen.steps / steps_a_second
    if seconds * steps_a_second > MOST_STEPS:
        option = "--seconds" if chosen.seconds else "--steps"
        raise OptionError(option, f"makes more than {MOST_STEPS:,} steps at {steps_a_second:g} Hz")
    return simulate_alone(chosen.scene, seconds, chosen.output, steps_a_second, picture)


def _check_outputs(chosen: argparse.Namespace) -> None:
    """Refuses an output that would overwrite an input or another output."""
    taken = {str(path.resolve()): path
             for path in (chosen.scene, getattr(chosen, "targets", None),
                          getattr(chosen, "commands", None)) if path is not None}
    for option in ("output", "picture"):
        path = getattr(chosen, option)
        if path is None:
            continue
        try:
            if path.exists() and not path.is_file():  # a device file can always be written
                continue
        except OSError as error:
            raise OptionError(f"--{option}", error.strerror or str(error)) from error
        if str(path.resolve()) in taken:
            raise OptionError(f"--{option}", f"{path} would overwrite {taken[str(path.resolve())]}")
        taken[str(path.resolve())] = path


def _explain(chosen: argparse.Namespace) -> int:
    from softrobot_twin.study.effect_costs import print_effects
    from softrobot_twin.study.explain import explain
    from softrobot_twin.study.stiffness import print_stiffness

    if chosen.stiffness and chosen.effects:
        raise OptionError("--effects", "cannot be combined with --stiffness")
    for option, prints in (("stiffness", print_stiffness), ("effects", print_effects)):
        if getattr(chosen, option):
            if chosen.picture is not None:
                raise OptionError("--picture", f"cannot be combined with --{option}")
            return prints(chosen.scene, chosen.at or ())
    refuse(chosen, "--stiffness or --effects", "at")
    if chosen.picture is None:
        refuse(chosen, "--picture", "picture_view")
    return explain(chosen.scene, chosen.mesh_error, chosen.picture,
                   chosen.picture_view and tuple(chosen.picture_view))


def add_bench(commands) -> None:
    """Declares ``bench``."""
    parser = add_command(
        commands, "bench", _bench, "time a step, stage by stage, over sizes",
        "Time every stage of a step while the effector follows a circle, or, in a scene without "
        "effectors, while the actuators move over their limits, together with one SuperLU "
        "factorization of the same matrices and with dense products. Without "
        "a scene: the Diamond at its four refinements, columns of 500 and 50 000 dof, and the "
        "Grasper and the Octoleg while they hold. tools/contact_growth.py times 10 to 200 "
        "contacts, tools/compare_solvers.py compares factorizations and QP solvers.",
        examples=(
            "",
            "config/scenes/diamond.yaml config/scenes/fetch_reduced.yaml --steps 300",
        ),
    )
    parser.add_argument("scenes", metavar="SCENE", type=Path, nargs="*", help="scene file (YAML)")
    parser.add_argument("--output", metavar="FOLDER", type=Path,
                        help="write bench.csv and bench.png (needs matplotlib) there")
    parser.add_argument("--steps", default=1000, type=positive_count, metavar="N",
                        help="steps to time for each size (default 1000)")
    parser.add_argument("--commands", metavar="FILE.csv", type=Path,
                        help="time the longest hold of this commands file in place of a circle")
    parser.add_argument("--compare", metavar="FILE.csv", type=Path,
                        help="bench.csv of an earlier run: steps that are slower by a tenth, in "
                        "units of SuperLU, or make more calls of Python are marked")


def _bench(chosen: argparse.Namespace) -> int:
    from softrobot_twin.study.bench import bench

    if not chosen.scenes:
        refuse(chosen, "a scene to time", "commands")
    return bench(chosen.scenes, chosen.steps, chosen.output, chosen.commands, chosen.compare)


def add_plot(commands) -> None:
    """Declares ``plot``."""
    parser = add_command(
        commands, "plot", _plot, "draw what a run wrote over time",
        "Draw the file of a run, a panel for each quantity: places of effectors with their targets, "
        "errors, shortenings, tensions, pressures, contact forces, the residual, the status of each "
        "step and the limits that were active. It draws what workspace writes over the samples, and "
        "tables of targets and commands too.",
        examples=(
            "run.csv",
            "run.csv --columns 'tip_*' '*_tension_N' --output tensions.png",
        ),
    )
    parser.add_argument("file", metavar="RUN.csv", type=Path, help="file of a run")
    parser.add_argument("--columns", nargs="+", default=(), metavar="GLOB",
                        help="draw all columns that match, in place of those that tell the most")
    parser.add_argument("--output", metavar="FILE.png", type=Path,
                        help="picture to write (default RUN_plot.png beside the file)")


def _plot(chosen: argparse.Namespace) -> int:
    from softrobot_twin.study.run_plot import plot

    return plot(chosen.file, chosen.columns, chosen.output)


def add_workspace(commands) -> None:
    """Declares ``workspace``."""
    parser = add_command(
        commands, "workspace", _workspace, "sample where a robot gets, and how stiff it is there",
        "Sample the setpoints of a scene's actuators over their bounds, and write where the "
        "effectors come to rest, their stiffness, and the efforts of the actuators, a row for each "
        "sample; samples that do not come to rest are written with their status. Sample 0 is the "
        "robot at rest; each other one is reached from there on a straight line of setpoints, so "
        "that the file does not depend on the workers. After Ctrl-C the rows so far are in "
        "FILE.csv.part, and the same command goes on from there.",
        examples=(
            "config/scenes/diamond.yaml --samples 160 --output workspace.csv --picture workspace.png",
            "config/scenes/diamond.yaml --range north_shortening_m=0:0.01 --output workspace.csv",
        ),
    )
    add_scene(parser)
    parser.add_argument("--output", required=True, metavar="FILE.csv", type=Path,
                        help="file to write")
    parser.add_argument("--picture", metavar="FILE.png", type=Path,
                        help="draw the places, coloured by stiffness (needs matplotlib)")
    parser.add_argument("--samples", type=positive_count, default=200, metavar="N",
                        help="samples, that at rest included (default 200); more of them begin "
                        "with the same ones")
    parser.add_argument("--seed", type=count, default=0, metavar="S",
                        help="seed of their places (default 0)")
    parser.add_argument("--range", nargs="+", default=(), metavar="COLUMN=LOW:HIGH", dest="ranges",
                        help="bounds in place of the scene's, with columns of a commands file, "
                        "such as north_shortening_m=0:0.01")
    parser.add_argument("--workers", type=positive_count, metavar="N",
                        help="processes on this machine (default: one on each core)")
    parser.add_argument("--scheduler", metavar="ADDRESS",
                        help="compute on the Dask cluster of this scheduler instead, such as "
                        "tcp://10.0.0.1:8786 (needs distributed)")


def _workspace(chosen: argparse.Namespace) -> int:
    from softrobot_twin.study.workspace import workspace

    _check_outputs(chosen)
    if chosen.scheduler is not None and chosen.workers is not None:
        raise OptionError("--workers", "has no effect with --scheduler")
    enable_interrupts()
    return workspace(chosen.scene, chosen.output, chosen.picture, chosen.samples, chosen.seed,
                     chosen.ranges, chosen.workers, chosen.scheduler)


def add_accuracy(commands) -> None:
    """Declares ``accuracy``."""
    parser = add_command(
        commands, "accuracy", _accuracy, "measure accuracy against computing time",
        "Measure the effector's error and the time of a step over meshes, elements, "
        "laws, linearizations, QP tolerances and the factor's precision, against an extrapolation "
        "from quadratic meshes. Meshes of one family are in the folder of the scene's mesh, and "
        "their names differ only in the number at the end; a mesh without a family is refined "
        "uniformly. Meshes of hexahedra have _hexa before that number and are compared too. "
        "Reduced models are measured beside their full ones: that of the scene, and those of --reduced and "
        "--train. This takes minutes.",
        examples=(
            "config/scenes/diamond.yaml",
            "config/scenes/diamond.yaml --train diamond_600:quadratic",
        ),
    )
    add_scene(parser)
    parser.add_argument("--output", default=Path("out/accuracy"), metavar="FOLDER", type=Path,
                        help="folder for accuracy.csv and accuracy.png (default out/accuracy)")
    parser.add_argument("--timed-dof", default=60_000, type=positive_count, metavar="N",
                        help="most dof of a setting that is timed (default 60000)")
    parser.add_argument("--reference-dof", default=200_000, type=positive_count, metavar="N",
                        help="most dof of a mesh of the reference (default 200000)")
    parser.add_argument("--reduced", nargs="+", default=(), metavar="FILE.npz", type=Path,
                        help="reduced models of these meshes, written by 'reduce'")
    parser.add_argument("--train", nargs="*", metavar="MESH:ELEMENT",
                        help="first train reduced models of these meshes, such as "
                        "robot_4500:quadratic; without a name, of the most accurate one. They are "
                        "kept in FOLDER/reduced. A training takes minutes")


def add_choose(commands) -> None:
    """Declares ``choose``."""
    parser = add_command(
        commands, "choose", _choose, "find the most accurate setting that keeps a rate",
        "Time meshes, elements, laws, reduced models and numbers of linearizations on this "
        "machine, print the most accurate setting that keeps the rate with a margin, and write its scene. "
        "Reduced models are that of the scene, files *_reduced.npz beside its mesh and beside "
        "the scene that is written, and those of --reduced. Where one that is not there would be "
        "better, a trial on the coarsest mesh tells its error and the time of its training.",
        examples=(
            "config/scenes/diamond.yaml --rate 200",
            "config/scenes/diamond.yaml --rate 100 --given forces",
        ),
    )
    add_scene(parser)
    parser.add_argument("--rate", required=True, type=rate, metavar="HZ", help="rate to keep [Hz]")
    parser.add_argument("--accuracy", metavar="FILE.csv", type=Path,
                        help="file of errors written by 'accuracy'; a quick study writes it if it "
                        "does not exist")
    parser.add_argument("--write", metavar="FILE.yaml", type=Path,
                        help="scene file to write (default <name>_<rate>hz.yaml here)")
    parser.add_argument("--reduced", nargs="+", default=(), metavar="FILE.npz", type=Path,
                        help="further reduced models of these meshes, written by 'reduce'")
    parser.add_argument("--given", choices=("lengths", "forces"), default="lengths",
                        help="choose by the error at given lengths, or volumes (default), or at given "
                        "forces, or pressures")
    parser.add_argument("--train", action="store_true",
                        help="first train the reduced model that is expected to be the best, where "
                        "one is expected to be better than what there is; the file is beside the "
                        "scene that is written. After Ctrl-C the same command goes on")
    sampled = parser.add_argument_group("what a training samples, see 'reduce'")
    sampled.add_argument("--range", nargs="+", default=(), metavar="COLUMN=LOW:HIGH",
                         dest="ranges",
                         help="bounds of the actuators (default: cables up to 0.4 of their limits, "
                         "as the poses in which errors are measured; others their own bounds)")
    sampled.add_argument("--targets", nargs="+", default=(), type=target_box, metavar="BOX",
                         help="targets in place of the box of the actuators: "
                         "NAME=XLOW:XHIGH,YLOW:YHIGH,ZLOW:ZHIGH [m]")
    sampled.add_argument("--loads", type=positive, default=0.0, metavar="N",
                         help="forces up to this [N] at the effectors (default none)")
    sampled.add_argument("--tilts", type=tilt, default=0.0, metavar="DEGREES",
                         help="directions of gravity up to this angle from the scene's")


def _accuracy(chosen: argparse.Namespace) -> int:
    from softrobot_twin.study.accuracy import accuracy
    from softrobot_twin.study.accuracy_study import Limits

    if chosen.train is not None:
        enable_interrupts()
    return accuracy(chosen.scene, chosen.output, Limits(chosen.timed_dof, chosen.reference_dof),
                    chosen.reduced, chosen.train)


def _choose(chosen: argparse.Namespace) -> int:
    from softrobot_twin.study.choice import choose
    from softrobot_twin.study.reduced_models import STUDY

    if chosen.train:
        enable_interrupts()
    if chosen.targets and chosen.ranges:
        raise OptionError("--range", "has no effect with --targets")
    if chosen.train and chosen.given == "forces":
        raise OptionError("--train", "trains for given lengths; leave out --given forces")
    options = replace(STUDY, ranges=tuple(chosen.ranges), targets=tuple(chosen.targets),
                      load=chosen.loads, tilt=chosen.tilts)
    return choose(chosen.scene, chosen.rate, chosen.accuracy, chosen.write,
                  reduced=chosen.reduced, train=chosen.train, options=options,
                  forces_given=chosen.given == "forces")


class NoRosError(SoftRobotTwinError):
    """rclpy cannot be imported."""

    def __init__(self, reason: str):
        super().__init__(f"ROS 2 was not found ({reason}): source ROS 2 Jazzy, or run 'make demo'")


def add_replay(commands) -> None:
    """Declares ``replay``."""
    parser = add_command(
        commands, "replay", _replay, "run a recorded run of a twin again",
        "Run a run again that a twin recorded with its parameter record: each message, service "
        "call and tick in its order, at its time. Prints whether all results are equal to the bit, "
        "or the first difference and the largest of each quantity. With another scene it prints "
        "how the run would have differed, and the exit code is 0. ROS is not needed.",
        examples=(
            "run.mcap",
            "run.mcap --set body.material.young_modulus=1.5e5",
            "run.mcap --scene config/scenes/diamond.yaml --output run.csv",
        ),
    )
    parser.add_argument("recorded", metavar="FILE.mcap", type=Path, help="file of the run")
    other = parser.add_mutually_exclusive_group()
    other.add_argument("--scene", metavar="FILE.yaml", type=Path,
                       help="another scene, with the same actuators and effectors")
    other.add_argument("--set", nargs="+", default=(), dest="changes", metavar="KEY=VALUE",
                       help="other values of entries of the recorded scene, such as "
                       "body.material.young_modulus=1.5e5 or cables[0].tension=[0,5]")
    parser.add_argument("--output", metavar="FILE.csv", type=Path,
                        help="file to write, one row per tick of the replay")
    parser.add_argument("--record-view", metavar="FILE.rrd", type=Path,
                        help="file of pictures of the replay, for rerun")


def _replay(chosen: argparse.Namespace) -> int:
    for option, path in (("--output", chosen.output), ("--record-view", chosen.record_view)):
        if path is not None and path.resolve() == chosen.recorded.resolve():
            raise OptionError(option, f"{path} would overwrite the run")
    # The loop is loaded only for a run of it.
    from softrobot_twin.replay_command import replay
    return replay(chosen.recorded, chosen.scene, tuple(chosen.changes), chosen.output,
                  chosen.record_view)


def add_demo(commands) -> None:
    """Declares ``demo``."""
    parser = add_command(
        commands, "demo", _demo, "drive a simulated robot live over ROS 2",
        "Start twin, device and target as three processes, follow a path open loop "
        "and again closed loop, and report the tracking errors; a robot that is driven directly "
        "plays its commands, and the device is compared with the twin.",
        examples=(
            "",
            "--robot trunk --seconds 10 --no-view",
        ),
    )
    parser.add_argument("--robot", default="diamond", metavar="NAME",
                        help="name of a file config/NAME.yaml (default diamond)")
    parser.add_argument("--output", default=Path("out/demo"), metavar="FOLDER", type=Path,
                        help="folder for report.json, run.rrd and tracking.png (default out/demo)")
    parser.add_argument("--seconds", default=30.0, type=seconds, metavar="S",
                        help="length of each run [s] (default 30)")
    parser.add_argument("--no-view", dest="view", action="store_false",
                        help="neither serve nor open a live view; run.rrd is still recorded")


def enable_interrupts() -> None:
    """Lets Ctrl-C interrupt this process and its children, also when a shell started it in the
    background, where it would be ignored.
    """
    signal.signal(signal.SIGINT, signal.default_int_handler)


def _demo(chosen: argparse.Namespace) -> int:
    enable_interrupts()
    # This comes first: the ROS wheels restart this process when rclpy is imported.
    try:
        import softrobot_twin.ros.demo  # noqa: F401
    except ImportError as error:
        raise NoRosError(str(error)) from error
    from softrobot_twin.demo_command import demo
    return demo(chosen.robot, chosen.output, chosen.seconds, chosen.view)


def length(text: str) -> float:
    """Parses a length with its unit, such as 6mm, 0.006m or, in metres, 6e-3 [m]."""
    return _with_unit(text, UNITS, "a length such as 6mm, 0.6cm, 0.006m or 6e-3 (metres)")


def step_time(text: str) -> float:
    """Parses a time with its unit, such as 2ms or, in seconds, 0.002 [s]."""
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
    if not 0.0 < number < math.inf:
        raise argparse.ArgumentTypeError(f"{text} must be above zero and finite")
    return number


def add_mesh(commands) -> None:
    """Declares ``mesh``."""
    parser = add_command(
        commands, "mesh", _mesh, "fill a part from a CAD program with tetrahedra",
        "Mesh a part with gmsh. Closed surfaces inside it become the named surfaces cavity_1, "
        "cavity_2, ..., that cavities of a scene name as their part; the solids of a STEP file become "
        "named regions. The mesh is in metres. Quality, the time of a step on this machine and an "
        "estimate of the mesh's error are printed. With --rate or --step-time the size is searched: "
        "some meshes are made and measured.",
        examples=("finger.stl --size 6mm --output finger.msh",
                  "finger.step --rate 50 --output finger.msh",
                  "finger.stl --unit cm --step-time 5ms --element linear"),
    )
    parser.add_argument("part", metavar="PART", type=Path, help="CAD file: .stl, .step or .stp")
    wanted = parser.add_mutually_exclusive_group(required=True)
    wanted.add_argument("--size", type=length, metavar="LENGTH",
                        help="edge of the tetrahedra, such as 6mm")
    wanted.add_argument("--rate", type=rate, metavar="HZ",
                        help="search the least size whose steps keep this rate")
    wanted.add_argument("--step-time", type=step_time, metavar="TIME",
                        help="search the least size whose steps take at most this time, such as 5ms")
    parser.add_argument("--output", type=Path, metavar="FILE",
                        help="mesh file, .msh (default: the part's name, in the current folder)")
    parser.add_argument("--unit", choices=sorted(UNITS),
                        help="unit of an STL file, which states none (default: mm)")
    parser.add_argument("--element", choices=("linear", "smoothed", "quadratic"), default="quadratic",
                        help="elements whose step is measured (default: quadratic)")


def _mesh(chosen: argparse.Namespace) -> int:
    from softrobot_twin.study.meshing import mesh_part, rate_step

    step = chosen.step_time if chosen.rate is None else rate_step(chosen.rate)
    return mesh_part(chosen.part, chosen.output or Path(f"{chosen.part.stem}.msh"),
                     size=chosen.size, step=step, unit=chosen.unit, element=chosen.element)


def add_init(commands) -> None:
    """Declares ``init``."""
    parser = add_command(
        commands, "init", _init, "write a first scene for a mesh",
        "Write a commented scene for a mesh or CAD file that loads and runs as it is: fixed region, "
        "scale, material, effector and limits of pressure are guessed and told; examples of cables "
        "and markers at places of this part are in comments. Nothing is asked.",
        examples=("finger.msh", "finger.stl --size 6mm --output scenes/finger.yaml"),
    )
    parser.add_argument("mesh", metavar="MESH", type=Path,
                        help="mesh file (.msh, .vtk, .vtu, .inp), or CAD file (.stl, .step, .stp)")
    parser.add_argument("--output", type=Path, metavar="SCENE",
                        help="scene to write (default: beside the mesh, with its name)")
    parser.add_argument("--size", type=length, metavar="LENGTH",
                        help="edge of the tetrahedra of a CAD file, such as 6mm (default: a coarse "
                        "mesh)")
    parser.add_argument("--unit", choices=sorted(UNITS),
                        help="unit of the file (default: guessed; STEP files state theirs)")
    parser.add_argument("--force", action="store_true", help="replace a scene that exists")


def _init(chosen: argparse.Namespace) -> int:
    from softrobot_twin.study.first_scene import init

    scale = None if chosen.unit is None else UNITS[chosen.unit]
    return init(chosen.mesh, chosen.output, size=chosen.size, scale=scale, replace=chosen.force)


def add_reduce_vertebrae(commands) -> None:
    """Declares ``reduce-vertebrae``."""
    parser = add_command(
        commands, "reduce-vertebrae", _reduce_vertebrae,
        "make the superelements of bodies with vertebrae",
        "Make the superelements of a scene's bodies with vertebrae where there are none, or where "
        "mesh, material, vertebrae or walls of cavities have changed, and state the error of the "
        "reduced model against the full one at fresh states of the whole range of the actuators.",
        examples=(
            "config/scenes/fetch_reduced.yaml",
        ),
    )
    add_scene(parser)
    parser.add_argument("--again", action="store_true", help="make them even where they are current")
    parser.add_argument("--seed", type=count, default=1, help="of setpoints and samples (default 1)")
    parser.add_argument("--states", type=count, default=TEST_STATES, metavar="N",
                        help=f"fresh states for the error (default {TEST_STATES}; 0 for none)")


def _reduce_vertebrae(chosen: argparse.Namespace) -> int:
    from softrobot_twin.study.vertebrae_reduction import reduce_vertebrae

    return reduce_vertebrae(chosen.scene, chosen.seed, chosen.states, chosen.again)


def add_reduce(commands) -> None:
    """Declares ``reduce``."""
    parser = add_command(
        commands, "reduce", _reduce, "make the reduced model of a deformable body",
        "Bring the full model to states of the actuators' box, or near targets, take modes from "
        "its displacements (proper orthogonal decomposition) and few weighted quadrature points "
        "that do the work of all along them (energy-conserving sampling), and write a file that "
        "the scene names by 'reduced: {file: ...}'. The result is judged at fresh states. What the "
        "robot will meet must be sampled: loads, tilts, and the whole range of the actuators. "
        "After Ctrl-C the states so far are in a folder beside the file, and the same command goes "
        "on from there.",
        examples=(
            "config/scenes/diamond.yaml --error 1%% \\\n    --targets tip=-0.02:0.02,-0.02:0.02,0.122:0.140",
            "config/scenes/fetch.yaml --snapshots 200 --modes 48",
            "config/scenes/diamond_reduced.yaml --export robot.npz",
        ),
    )
    add_scene(parser)
    parser.add_argument("--body", metavar="NAME", help="body to reduce, where there are several")
    parser.add_argument("--output", metavar="FILE.npz", type=Path,
                        help="file to write (default <name of the scene>_reduced.npz beside the "
                        "mesh)")
    parser.add_argument("--export", metavar="ROBOT.npz", type=Path,
                        help="write a file with all that steps the reduced robot without a mesh "
                        "library, see docs/reduced_controller.md; a scene whose body is reduced "
                        "already is not trained again unless another option asks for it")
    sampled = parser.add_argument_group("what is sampled")
    sampled.add_argument("--snapshots", type=positive_count, metavar="N",
                         help=f"states of the full model (default {SNAPSHOTS}; with --error "
                         f"{FIRST_SNAPSHOTS} to begin with)")
    sampled.add_argument("--range", nargs="+", default=(), metavar="COLUMN=LOW:HIGH", dest="ranges",
                         help="bounds in place of the scene's, with columns of a commands file, "
                         "such as north_shortening_m=0:0.01")
    sampled.add_argument("--targets", nargs="+", default=(), type=target_box, metavar="BOX",
                         help="sample where the inverse brings the effectors, in place of the box "
                         "of the actuators: NAME=XLOW:XHIGH,YLOW:YHIGH,ZLOW:ZHIGH [m]; it takes "
                         "fewer modes, and knows nothing beyond")
    sampled.add_argument("--along", type=Path, metavar="TARGETS.csv",
                         help="sample along a path of targets instead, in the contact of the "
                         "scene: what presses on the body is trained as it will be met")
    sampled.add_argument("--around", type=positive, metavar="M",
                         help="each pass of that path is shifted as a whole, by up to this along "
                         f"each axis [m] (default {AROUND:g})")
    sampled.add_argument("--loads", type=positive, default=0.0, metavar="N",
                         help="forces up to this [N] in any direction at points, one at a time, in "
                         "half of the states (default none)")
    sampled.add_argument("--load-points", nargs="+", action="extend", type=point,
                         metavar="X,Y,Z",
                         help="points that --loads act on, at rest [m] (default the effectors); "
                         "--load-points=-0.01,0,0.1 where the first number is negative")
    sampled.add_argument("--surface-loads", type=positive_count, metavar="COUNT",
                         help="so many further points, spread over the surface, where something "
                         "may touch it")
    sampled.add_argument("--tilts", type=tilt, default=0.0, metavar="DEGREES",
                         help="directions of gravity up to this angle from the scene's")
    sampled.add_argument("--seed", type=count, default=0, metavar="S",
                         help="seed of all samples (default 0)")
    size = parser.add_argument_group("how accurate it is")
    size.add_argument("--error", type=share, metavar="PERCENT",
                      help="wanted largest error of the effectors at fresh states, such as 1%%, by "
                      "their displacement: states, modes and points are added where the estimated "
                      "error is worst until it is met")
    size.add_argument("--energy", type=float, metavar="SHARE",
                      help=f"share of the energy that the modes leave out (default {ENERGY:g})")
    size.add_argument("--modes", type=positive_count, metavar="N",
                      help="number of modes in place of that, rounded up to a multiple of three")
    size.add_argument("--spare-modes", type=count, default=SPARE_MODES, metavar="N",
                      help=f"modes beyond, for the estimate of the error (default {SPARE_MODES})")
    size.add_argument("--tolerance", type=float, default=TOLERANCE, metavar="SHARE",
                      help="virtual work that the sampled points leave out "
                      f"(default {TOLERANCE:g})")
    size.add_argument("--states", type=count, default=FRESH_STATES, metavar="N",
                      help=f"fresh states for the error (default {FRESH_STATES}; 0 for none)")
    parser.add_argument("--workers", type=positive_count, metavar="N",
                        help="processes on this machine (default: one on each core)")
    parser.add_argument("--scheduler", metavar="ADDRESS",
                        help="compute states on the Dask cluster of this scheduler instead, such "
                        "as tcp://10.0.0.1:8786 (needs distributed)")


def add_completion(commands) -> None:
    """Declares ``completion``."""
    parser = add_command(
        commands, "completion", _completion, "print what lets a shell complete these commands",
        "Print a script that lets the Tab key complete commands, options and file names of "
        "'softrobot_twin'. A shell reads it when it starts.",
        examples=(
            "bash > ~/.local/share/bash-completion/completions/softrobot_twin",
            'zsh > "${fpath[1]}/_softrobot_twin"',
        ),
    )
    parser.add_argument("shell", choices=("bash", "zsh", "tcsh"), help="shell to write for")


def _completion(chosen: argparse.Namespace) -> int:
    print(shtab.complete(program("softrobot_twin"), chosen.shell))
    return 0


def positive(text: str) -> float:
    """Parses a finite number above zero."""
    number = float(text)
    if not (math.isfinite(number) and number > 0.0):
        raise argparse.ArgumentTypeError(f"{text} must be above zero")
    return number


def share(text: str) -> float:
    """Parses a percentage, such as 1%, as a share."""
    number = positive(text.removesuffix("%")) / 100.0
    if number > 1.0:
        raise argparse.ArgumentTypeError(f"{text} must be at most 100 %")
    return number


def tilt(text: str) -> float:
    """Parses an angle in degrees; gives it in radians."""
    number = float(text)
    if not 0.0 < number <= 180.0:
        raise argparse.ArgumentTypeError(f"{text} must lie above 0 and up to 180 degrees")
    return math.radians(number)


def point(text: str) -> tuple[float, float, float]:
    """Parses a point [m], such as 0,0,0.1."""
    values = tuple(map(float, text.split(",")))
    if len(values) != 3 or not all(map(math.isfinite, values)):
        raise argparse.ArgumentTypeError(f"{text} must be three numbers, X,Y,Z [m]")
    return values


def target_box(text: str) -> TargetBox:
    """Parses a box of an effector's targets."""
    name, _, ranges = text.partition("=")
    bounds = [tuple(map(float, part.split(":"))) for part in ranges.split(",")]
    is_box = len(bounds) == 3 and all(len(pair) == 2 and pair[0] <= pair[1] for pair in bounds)
    if not name or not is_box or not all(math.isfinite(end) for pair in bounds for end in pair):
        raise argparse.ArgumentTypeError(
            f"{text} must be NAME=XLOW:XHIGH,YLOW:YHIGH,ZLOW:ZHIGH [m]"
        )
    return TargetBox(name, *zip(*bounds))


def _reduce(chosen: argparse.Namespace) -> int:
    from softrobot_twin.study.body_training import reduce
    from softrobot_twin.study.controller_export import reduce_and_export

    if chosen.scheduler is not None and chosen.workers is not None:
        raise OptionError("--workers", "has no effect with --scheduler")
    if not chosen.loads:
        refuse(chosen, "--loads", "load_points", "surface_loads")
    if chosen.targets and chosen.ranges:
        raise OptionError("--range", "has no effect with --targets")
    if chosen.along is None:
        refuse(chosen, "--along", "around")
    else:
        for option in ("targets", "ranges", "loads", "tilts", "error"):
            if getattr(chosen, option):
                name = "--range" if option == "ranges" else f"--{option}"
                raise OptionError(name, "has no effect with --along")
    if chosen.modes is not None and chosen.energy is not None:
        raise OptionError("--energy", "has no effect with --modes")
    enable_interrupts()
    options = TrainingOptions(
        chosen.body, chosen.output, chosen.snapshots, tuple(chosen.ranges), tuple(chosen.targets),
        chosen.loads, tuple(chosen.load_points or ()), chosen.surface_loads or 0, chosen.tilts,
        ENERGY if chosen.energy is None else chosen.energy, chosen.modes, chosen.spare_modes,
        chosen.tolerance, chosen.error, chosen.states, chosen.seed, chosen.workers,
        chosen.scheduler, chosen.along, chosen.around or AROUND,
    )  # fmt: skip
    if chosen.export is not None:
        return reduce_and_export(chosen.scene, options, chosen.export)
    return reduce(chosen.scene, options)


COMMANDS = (
    add_mesh, add_init, add_simulate, add_plot, add_explain, add_workspace, add_bench, add_accuracy,
    add_choose, add_reduce, add_reduce_vertebrae, add_replay, add_demo, add_completion,
)  # fmt: skip
"""What declares each command, in the order of the list of commands."""


def program(name: str) -> argparse.ArgumentParser:
    """The one parser of all commands.

    Args:
        name: How the program was called.
    """
    made = argparse.ArgumentParser(
        prog=name, description="Simulate and control soft robots. All values are in SI units.",
        epilog=f"COMMAND --help shows the options of a command, with examples.\n\n{EXIT_CODES}",
        formatter_class=argparse.RawDescriptionHelpFormatter)
    made.add_argument("--version", action="version", version=f"softrobot_twin {_version()}")
    commands = made.add_subparsers(title="commands", dest="command", metavar="COMMAND",
                                   required=True)
    for add in COMMANDS:
        add(commands)
    for command in commands.choices.values():
        _complete_paths(command)
    return made


def _complete_paths(command: argparse.ArgumentParser) -> None:
    """Tells shells which arguments are files and folders."""
    for action in command._actions:  # argparse has no public list of them
        if action.type is Path:
            is_folder = action.metavar == "FOLDER"
            action.complete = shtab.DIRECTORY if is_folder else shtab.FILE  # type: ignore[attr-defined]


def _version() -> str:
    try:
        return version("softrobot_twin")
    except PackageNotFoundError:
        return "(not installed)"
