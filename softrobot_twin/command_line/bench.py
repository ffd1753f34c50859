"""``bench``: what steps, solvers and contacts cost."""

from __future__ import annotations

import argparse
from pathlib import Path

from softrobot_twin.command_line.arguments import OptionError, add_command, positive_count, refuse


def add_bench(commands) -> None:
    """Declares ``bench``."""
    parser = add_command(
        commands, "bench", _bench, "time a step, stage by stage, over sizes",
        "Time every stage of a step while the effector follows a circle, beside one "
        "SuperLU factorization of the same matrices and dense products in the same run. Without "
        "a scene: the Diamond at its four refinements, columns of 500 and 50 000 dof, and the "
        "Grasper and the Octoleg while they hold. With --compare: factorizations and QP solvers "
        "instead, in time and accuracy. With --contacts: one block on 10 to 200 contacts.")
    parser.add_argument("scenes", metavar="SCENE", type=Path, nargs="*", help="scene file (YAML)")
    parser.add_argument("--output", metavar="FOLDER", type=Path,
                        help="write bench.csv and bench.png (needs matplotlib) there; with "
                        "--compare factorizations.csv and qp_solvers.csv")
    parser.add_argument("--steps", default=1000, type=positive_count, metavar="N",
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


def _bench(chosen: argparse.Namespace) -> int:
    if not chosen.scenes or chosen.contacts or chosen.compare or chosen.docs:
        refuse(chosen, "a scene to time", "commands")
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
