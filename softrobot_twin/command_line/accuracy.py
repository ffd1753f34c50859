"""``accuracy`` and ``choose``: what accuracy costs, and the best setting for a rate."""

from __future__ import annotations

import argparse
from pathlib import Path

from softrobot_twin.command_line.arguments import add_command, add_scene, positive_count, rate


def add_accuracy(commands) -> None:
    """Declares ``accuracy``."""
    parser = add_command(
        commands, "accuracy", _accuracy, "show what each bit of accuracy costs in time",
        "Measure the effector's error and the time of a step over meshes, elements, "
        "laws, linearizations, QP tolerances and the factor's precision, against quadratic meshes "
        "extrapolated. Meshes of one family stand beside the scene's and differ in the number at "
        "the end of their names; a mesh without family is refined uniformly. Takes minutes.")
    add_scene(parser)
    parser.add_argument("--output", default=Path("out/accuracy"), metavar="FOLDER", type=Path,
                        help="where accuracy.csv and accuracy.png go (default out/accuracy)")
    parser.add_argument("--timed-dof", default=60_000, type=positive_count, metavar="N",
                        help="most dof of a setting that is timed (default 60000)")
    parser.add_argument("--reference-dof", default=200_000, type=positive_count, metavar="N",
                        help="most dof of a mesh of the reference (default 200000)")


def add_choose(commands) -> None:
    """Declares ``choose``."""
    parser = add_command(
        commands, "choose", _choose, "find the most accurate setting that keeps a rate",
        "Time meshes, elements, laws and numbers of linearizations on this machine, "
        "name the most accurate setting that keeps the rate with margin, and write the scene.")
    add_scene(parser)
    parser.add_argument("--rate", required=True, type=rate, metavar="HZ", help="rate to keep [Hz]")
    parser.add_argument("--accuracy", metavar="FILE.csv", type=Path,
                        help="errors that 'accuracy' wrote; a quick study makes the file where it "
                        "does not exist")
    parser.add_argument("--write", metavar="FILE.yaml", type=Path,
                        help="scene file to write (default <name>_<rate>hz.yaml here)")


def _accuracy(chosen: argparse.Namespace) -> int:
    from softrobot_twin.study.accuracy.accuracy_command import accuracy
    from softrobot_twin.study.accuracy.accuracy_study import Limits
    return accuracy(chosen.scene, chosen.output, Limits(chosen.timed_dof, chosen.reference_dof))


def _choose(chosen: argparse.Namespace) -> int:
    from softrobot_twin.study.accuracy.choose_command import choose
    return choose(chosen.scene, chosen.rate, chosen.accuracy, chosen.write)
