"""``python -m softrobot_twin``: simulate, explain, bench, accuracy, choose, demo."""

import os

# One BLAS thread, said before numpy is first imported: with more, the small products of a step
# wait for each other on a busy machine.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse  # noqa: E402
import signal  # noqa: E402
import sys  # noqa: E402
from importlib.metadata import PackageNotFoundError, version  # noqa: E402
from pathlib import Path  # noqa: E402

from softrobot_twin.errors import SoftRobotTwinError  # noqa: E402

_EXIT_CODES = """exit codes: 0 done, 1 done but a row, a process or a check failed, 2 the input or
an argument cannot be used, 130 stopped by Ctrl-C"""


class NoRosError(SoftRobotTwinError):
    """rclpy cannot be imported."""

    def __init__(self, reason: str):
        super().__init__(f"ROS 2 is not here ({reason}): source ROS 2 Jazzy, or run 'make demo'")


class OptionError(SoftRobotTwinError):
    """An option was given that does nothing here."""

    def __init__(self, option: str, reason: str):
        super().__init__(f"{option}: {reason}")


def main(arguments: list[str] | None = None) -> int:
    """Runs one command and gives its exit code."""
    chosen = _parser().parse_args(arguments)
    try:
        return chosen.run(chosen)
    except SoftRobotTwinError as error:
        print(f"softrobot_twin: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("softrobot_twin: stopped", file=sys.stderr)
        return 130


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m softrobot_twin", epilog=_EXIT_CODES,
        description="Simulate soft robots, invert them and drive them. SI units throughout.")
    parser.add_argument("--version", action="version", version=f"softrobot_twin {_version()}")
    commands = parser.add_subparsers(title="commands", dest="command", required=True)
    _add_simulate(commands)
    _add_explain(commands)
    _add_bench(commands)
    _add_accuracy(commands)
    _add_choose(commands)
    _add_demo(commands)
    return parser


def _add_simulate(commands) -> None:
    parser = commands.add_parser(
        "simulate", help="run a scene offline, without ROS", epilog=_EXIT_CODES,
        description="Run a scene over a targets file, row by row, or over a commands file, at a "
        "fixed rate. Columns of a targets file: "
        "t,<effector>.x,<effector>.y,<effector>.z [s, m] for the inverse problem, "
        "t,<actuator>.length [m] or t,<actuator>.tension [N] for a direct run. A row's time step "
        "is its distance from the row before; the first row takes the second's, and a single row "
        "0.02 s. Columns of a commands file: time_s, <cable>_shortening_m, <cable>_length_m or "
        "<cable>_tension_N, <motor>_shortening_m for all its cables, <guided body>_x_m, _y_m, "
        "_z_m and, if it turns, _qx, _qy, _qz, _qw; evenly from row to row.")
    parser.add_argument("scene", metavar="SCENE", type=Path, help="scene file (YAML)")
    driven = parser.add_mutually_exclusive_group(required=True)
    driven.add_argument("--targets", metavar="FILE.csv", type=Path,
                        help="what to follow, row by row")
    driven.add_argument("--commands", metavar="FILE.csv", type=Path,
                        help="what cables, motors and guided bodies do, over time")
    parser.add_argument("--output", required=True, metavar="FILE.csv", type=Path,
                        help="where to write the run, one row a step")
    parser.add_argument("--settle", type=_count, metavar="N",
                        help="with --targets: run the first row N times before recording "
                        "(default 0)")
    parser.add_argument("--rate", type=_rate, metavar="HZ",
                        help="with --commands: steps a second (default 250)")
    parser.add_argument("--picture", metavar="FILE.png", type=Path,
                        help="draw the last state (needs matplotlib)")
    parser.add_argument("--picture-at", nargs="+", type=float, metavar="S",
                        help="with --commands: draw these times [s] side by side instead")
    parser.add_argument("--picture-view", nargs=2, type=float, metavar=("ELEVATION", "AZIMUTH"),
                        help="with --commands: where the eye is [degrees] (default 24 -58)")
    parser.set_defaults(run=_simulate)


def _add_explain(commands) -> None:
    parser = commands.add_parser(
        "explain", help="show what a scene calls for and what that makes", epilog=_EXIT_CODES,
        description="Print the effects a scene names, the terms they become, the stages of a "
        "step, and the size of the mesh.")
    parser.add_argument("scene", metavar="SCENE", type=Path, help="scene file (YAML)")
    parser.set_defaults(run=_explain)


def _add_bench(commands) -> None:
    parser = commands.add_parser(
        "bench", help="time a step, stage by stage, over sizes", epilog=_EXIT_CODES,
        description="Time every stage of a step while the effector follows a circle, beside one "
        "SuperLU factorization of the same matrices and dense products in the same run. Without "
        "a scene: the Diamond at its four refinements, columns of 500 and 50 000 dof, and the "
        "Grasper and the Octoleg while they hold. With --compare: factorizations and QP solvers "
        "instead, in time and accuracy. With --contacts: one block on 10 to 200 contacts.")
    parser.add_argument("scenes", metavar="SCENE", type=Path, nargs="*", help="scene file (YAML)")
    parser.add_argument("--output", metavar="FOLDER", type=Path,
                        help="write bench.csv and bench.png (needs matplotlib) there; with "
                        "--compare factorizations.csv and qp_solvers.csv")
    parser.add_argument("--steps", default=1000, type=_positive_count, metavar="N",
                        help="steps to time for each size (default 1000)")
    parser.add_argument("--compare", action="store_true",
                        help="compare solvers on the first scene (default: the Diamond)")
    parser.add_argument("--commands", metavar="FILE.csv", type=Path,
                        help="time the longest hold of this commands file in place of a circle")
    parser.add_argument("--contacts", action="store_true",
                        help="time steps over numbers of contacts; with --output contacts.csv "
                        "and contacts.png")
    parser.add_argument("--docs", metavar="FOLDER", type=Path,
                        help="as --compare, and write its tables and what follows from them to "
                        "FOLDER/solvers.md")
    parser.set_defaults(run=_bench)


def _add_accuracy(commands) -> None:
    parser = commands.add_parser(
        "accuracy", help="show what each bit of accuracy costs in time", epilog=_EXIT_CODES,
        description="Measure the effector's error and the time of a step over meshes, elements, "
        "laws, linearizations, QP tolerances and the factor's precision, against quadratic meshes "
        "extrapolated. Meshes of one family stand beside the scene's and differ in the number at "
        "the end of their names; a mesh without family is refined uniformly. Takes minutes.")
    parser.add_argument("scene", metavar="SCENE", type=Path, help="scene file (YAML)")
    parser.add_argument("--output", default=Path("out/accuracy"), metavar="FOLDER", type=Path,
                        help="where accuracy.csv and accuracy.png go (default out/accuracy)")
    parser.add_argument("--timed-dof", default=60_000, type=_positive_count, metavar="N",
                        help="most dof of a setting that is timed (default 60000)")
    parser.add_argument("--reference-dof", default=200_000, type=_positive_count, metavar="N",
                        help="most dof of a mesh of the reference (default 200000)")
    parser.set_defaults(run=_accuracy)


def _add_choose(commands) -> None:
    parser = commands.add_parser(
        "choose", help="find the most accurate setting that keeps a rate", epilog=_EXIT_CODES,
        description="Time meshes, elements, laws and numbers of linearizations on this machine, "
        "name the most accurate setting that keeps the rate with margin, and write the scene.")
    parser.add_argument("scene", metavar="SCENE", type=Path, help="scene file (YAML)")
    parser.add_argument("--rate", required=True, type=_rate, metavar="HZ", help="rate to keep [Hz]")
    parser.add_argument("--accuracy", metavar="FILE.csv", type=Path,
                        help="errors that 'accuracy' wrote; a quick study makes the file where it "
                        "does not exist")
    parser.add_argument("--write", metavar="FILE.yaml", type=Path,
                        help="scene file to write (default <name>_<rate>hz.yaml here)")
    parser.set_defaults(run=_choose)


def _add_demo(commands) -> None:
    parser = commands.add_parser(
        "demo", help="drive a simulated robot live over ROS 2", epilog=_EXIT_CODES,
        description="Start twin, device and target as three processes, follow a path open loop "
        "and again closed loop, and report how well that went.")
    parser.add_argument("--robot", default="diamond", metavar="NAME",
                        help="config/NAME.yaml says which (default diamond)")
    parser.add_argument("--output", default=Path("out/demo"), metavar="FOLDER", type=Path,
                        help="where report.json, run.rrd and tracking.png go (default out/demo)")
    parser.add_argument("--seconds", default=30.0, type=_seconds, metavar="S",
                        help="length of each of the two runs [s] (default 30)")
    parser.add_argument("--no-view", dest="view", action="store_false",
                        help="serve no live view and open none; run.rrd is recorded all the same")
    parser.set_defaults(run=_demo)


def _count(text: str) -> int:
    number = int(text)
    if number < 0:
        raise argparse.ArgumentTypeError(f"{text} must not be negative")
    return number


def _positive_count(text: str) -> int:
    number = _count(text)
    if number == 0:
        raise argparse.ArgumentTypeError(f"{text} must be above zero")
    return number


def _rate(text: str) -> float:
    number = float(text)
    if not 0.1 <= number <= 10_000.0:
        raise argparse.ArgumentTypeError(f"{text} must lie in 0.1..10000 Hz")
    return number


def _seconds(text: str) -> float:
    number = float(text)
    if not 1.0 <= number <= 3600.0:
        raise argparse.ArgumentTypeError(f"{text} must lie in 1..3600 s")
    return number


def _simulate(chosen: argparse.Namespace) -> int:
    if chosen.targets is not None:
        _refuse(chosen, "--commands", "rate", "picture_at", "picture_view")
        from softrobot_twin.study.offline.simulate_command import simulate
        return simulate(chosen.scene, chosen.targets, chosen.output, chosen.settle or 0,
                        chosen.picture)
    _refuse(chosen, "--targets", "settle")
    if chosen.picture is None:
        _refuse(chosen, "--picture", "picture_at", "picture_view")
    from softrobot_twin.study.offline.direct_command import DEFAULT_RATE, Picture, simulate_commands
    picture = None if chosen.picture is None else Picture(
        chosen.picture, tuple(chosen.picture_at or ()),
        chosen.picture_view and tuple(chosen.picture_view))
    return simulate_commands(chosen.scene, chosen.commands, chosen.output,
                             chosen.rate or DEFAULT_RATE, picture)


def _refuse(chosen: argparse.Namespace, needed: str, *options: str) -> None:
    """Says that options do nothing without another, rather than ignore them."""
    for option in options:
        if getattr(chosen, option) is not None:
            name = option.replace("_", "-")
            raise OptionError(f"--{name}", f"goes with {needed}")


def _explain(chosen: argparse.Namespace) -> int:
    from softrobot_twin.study.offline.explain_command import explain
    return explain(chosen.scene)


def _bench(chosen: argparse.Namespace) -> int:
    if not chosen.scenes or chosen.contacts or chosen.compare or chosen.docs:
        _refuse(chosen, "a scene to time", "commands")
    if chosen.contacts:
        if chosen.scenes or chosen.compare or chosen.docs:
            raise OptionError("--contacts", "measures its own block; no scene goes with it")
        from softrobot_twin.study.bench.contacts_command import bench_contacts
        return bench_contacts(chosen.steps, chosen.output)
    if chosen.compare or chosen.docs:
        from softrobot_twin.study.compare.compare_command import compare
        return compare(chosen.scenes, chosen.steps, chosen.output, chosen.docs)
    from softrobot_twin.study.bench.bench_command import bench
    return bench(chosen.scenes, chosen.steps, chosen.output, chosen.commands)


def _accuracy(chosen: argparse.Namespace) -> int:
    from softrobot_twin.study.accuracy.accuracy_command import accuracy
    from softrobot_twin.study.accuracy.accuracy_study import Limits
    return accuracy(chosen.scene, chosen.output, Limits(chosen.timed_dof, chosen.reference_dof))


def _choose(chosen: argparse.Namespace) -> int:
    from softrobot_twin.study.accuracy.choose_command import choose
    return choose(chosen.scene, chosen.rate, chosen.accuracy, chosen.write)


def _demo(chosen: argparse.Namespace) -> int:
    # A shell starts a background job with Ctrl-C ignored; the processes must end all the same.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    # Before all else: the wheels of ROS start this process anew when rclpy is imported.
    try:
        import softrobot_twin.ros.demo  # noqa: F401
    except ImportError as error:
        raise NoRosError(str(error)) from error
    from softrobot_twin.demo_command import demo
    return demo(chosen.robot, chosen.output, chosen.seconds, chosen.view)


def _version() -> str:
    try:
        return version("softrobot_twin")
    except PackageNotFoundError:
        return "(not installed)"


if __name__ == "__main__":
    sys.exit(main())
