"""``python -m softrobot_twin bench --compare``: factorizations and QP solvers side by side."""

from __future__ import annotations

from pathlib import Path

from softrobot_twin.simulation import Simulation
from softrobot_twin.study.bench.bench_cases import default_scene_path, given_cases
from softrobot_twin.study.bench.bench_command import LIBRARIES, make_folder
from softrobot_twin.study.compare.comparison_tables import factorization_table, qp_table
from softrobot_twin.study.compare.factorization_comparison import compare_factorizations
from softrobot_twin.study.compare.qp_comparison import compare_qp_solvers
from softrobot_twin.study.compare.qp_problems import SIZES, random_problems, recorded_problems
from softrobot_twin.study.compare.solver_page import write_solver_page
from softrobot_twin.study.reports.machine_facts import machine_words
from softrobot_twin.study.reports.terminal import console, warn

_OPTIONAL = ("qdldl", "pypardiso")
# Far fewer repetitions than steps are asked for tell a median of a factorization; the problems of
# every fifth step, those of a run.
_STEPS_A_REPEAT = 10
_STEPS_A_PROBLEM = 5
_TWICE = 8


def compare(scenes: list[Path], steps: int, output: Path | None = None,
            docs: Path | None = None) -> int:
    """Compares solvers and prints what was found.

    Args:
        scenes: The scene to take matrices and problems from; none for the Diamond.
        steps: How much is measured: a tenth as many factorizations, a fifth as many problems.
        output: Folder for ``factorizations.csv`` and ``qp_solvers.csv``, or None.
        docs: Folder for ``solvers.md``, or None.

    Returns:
        Exit code, always 0.

    Raises:
        SoftRobotTwinError: The scene cannot be used or an output not be written.
    """
    for folder in (output, docs):
        if folder is not None:
            make_folder(folder)
    case = given_cases(scenes[:1] or [default_scene_path()])[0]
    for ignored in scenes[1:]:
        warn(f"{ignored} is left out: solvers are compared on one scene")
    simulation = Simulation(case.scene)
    simulation.warm_up()
    found = compare_factorizations(simulation, max(1, steps // _STEPS_A_REPEAT))
    count = max(1, steps // _STEPS_A_PROBLEM)
    each = max(1, count // 5)
    figures = compare_qp_solvers([
        recorded_problems(case, count), *(random_problems(n, each) for n in SIZES),
        random_problems(_TWICE, each, twice=True)])
    conditions = machine_words((*LIBRARIES, *_OPTIONAL))
    tables = {"factorizations": factorization_table(found), "qp_solvers": qp_table(figures)}
    shown = console()
    shown.print(conditions + "\n")
    for made in tables.values():
        shown.print(made.for_terminal())
        shown.print()
    for package in found.absent:
        shown.print(f"{package} is not installed and was left out: pip install {package}")
    if output is not None:
        for name, made in tables.items():
            made.write_csv(output / f"{name}.csv")
        shown.print(f"written: {output / 'factorizations.csv'}, {output / 'qp_solvers.csv'}")
    if docs is not None:
        write_solver_page(docs / "solvers.md", found, figures, conditions)
        shown.print(f"written: {docs / 'solvers.md'}")
    return 0
