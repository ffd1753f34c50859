"""``docs/solvers.md``: the comparison of solvers, and what follows from it.

Every figure in the text is taken from the measurement it stands beside.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from textwrap import fill

from softrobot_twin.study.compare.comparison_tables import factorization_table, qp_table
from softrobot_twin.study.compare.factorization_comparison import FactorizationComparison
from softrobot_twin.study.compare.qp_comparison import AS_SHIPPED, DAQP, OSQP, TIGHT_DAQP, QPFigures
from softrobot_twin.study.reports.output_error import OutputError

_PAGE = """# Which solvers, and why

Made by `python -m softrobot_twin bench --docs docs`; run it again to have the figures of your own
machine.

{conditions}

## Factorization

{factorization_table}

*W and dx* is what a step needs of a factorization: the compliance of all rows of H, and the motion
for one λ. *Residual* is relative to the right-hand side; *error of W*, relative to its largest
entry, is taken against iterative refinement in extended precision. SuperLU orders, analyses and
allocates anew at every call, as scipy offers no other (new memory costs it page faults at the
allocator's whim, up to a quarter of its time); the others keep what depends on the mesh
only.{absent}

{factorization_words}

## Inverse problem

{qp_table}

Problems are posed as a step poses them: the Hessian is the identity, rows and gradient have unit
length. Each solver follows a sequence of problems, OSQP with its workspace kept and warm-started.
*Error of λ* is relative to the largest λ of the problem, over those answered. Up to four unknowns
it is taken against all active sets tried one by one, above against DAQP's active set at a
tolerance of 1e-11, solved anew and checked against the optimality conditions; *judged* counts the
problems for which such an answer exists. The random ones ask for more than the robot can reach, so
that many bounds are active; in the last set every cable stands twice.

{qp_words}
"""


def write_solver_page(
    path: Path, found: FactorizationComparison, figures: Sequence[QPFigures], conditions: str
) -> None:
    """Writes the page.

    Args:
        path: File to write.
        found: Factorizations.
        figures: QP solvers.
        conditions: Machine and versions.

    Raises:
        OutputError: The file cannot be written.
    """
    absent = f" Not installed here: {', '.join(found.absent)}." if found.absent else ""
    text = _PAGE.format(
        conditions=_wrapped(f"{conditions}. One thread, garbage collection off."),
        factorization_table=factorization_table(found).as_markdown(),
        absent=absent, factorization_words=_factorization_words(found),
        qp_table=qp_table(figures).as_markdown(), qp_words=_qp_words(figures))
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise OutputError(path, error.strerror or str(error)) from error


def _factorization_words(found: FactorizationComparison) -> str:
    times = {one.name: one.factor.median + one.solves.median for one in found.figures}
    used = found.figures[0]
    others = ", ".join(f"{times[name] / times[used.name]:.1f} × for {name}"
                       for name in times if name != used.name)
    worst = max(one.residual for one in found.figures)
    return _wrapped(
        f"In use is {used.name}: {1e3 * times[used.name]:.3f} ms together, against {others}. "
        f"Accuracy does not decide: the largest residual is {worst:.1e}. It releases the "
        "interpreter's lock, keeps its buffers from step to step and installs with pip on x86_64 "
        "and aarch64. SuperLU stays behind the same interface (`factorization: superlu`), as the "
        "oracle of its tests and for whoever distrusts compiled kernels; Pardiso is proprietary "
        "and has no wheel for aarch64.")


def _qp_words(figures: Sequence[QPFigures]) -> str:
    own = {one.solver: one for one in figures if one.problems == figures[0].problems}
    fewest = min((one for one in figures if one.solver == OSQP), key=lambda one: one.solved_share)
    shipped = [one for one in figures if one.solver == AS_SHIPPED]
    loose = max(one.worst_error for one in figures if one.solver == DAQP)
    tight = max(one.worst_error for one in figures if one.solver == TIGHT_DAQP)
    faster = [one.time.median for one in figures if one.solver == OSQP]
    daqp = [one.time.median for one in figures if one.solver == DAQP]
    ratios = [a / b for a, b in zip(faster, daqp, strict=True)]
    return "\n\n".join(map(_wrapped, (
        f"**DAQP is the faster one**, by {min(ratios):.0f} to {max(ratios):.0f} times here, and "
        f"answers every problem. It is exact up to what it lets a bound be broken by: at its own "
        f"default of 1e-6 λ was wrong by up to {loose:.0e}, at our 1e-9 by up to {tight:.0e}, in the "
        f"same time.",
        f"**OSQP is the default**, for what it is and not for these times: widely used, well "
        f"maintained, a first-order method that starts from the last step's answer. Where a robot "
        f"stays inside its workspace that is enough. On {figures[0].problems} along a circle "
        f"(n = {own[OSQP].count}) it answers {100.0 * own[OSQP].solved_share:.0f} % with a worst "
        f"error of {own[OSQP].worst_error:.0e} in {1e6 * own[OSQP].time.median:.0f} µs (DAQP: "
        f"{1e6 * own[DAQP].time.median:.0f} µs), a small part of a step. A loose tolerance is no "
        "bargain: at 1e-3 and 1e-5 it calls answers solved that are far off.",
        f"**DAQP stands behind it**, because OSQP alone would not do: of the set "
        f"\"{fewest.problems}\" at n = {fewest.count} it leaves "
        f"{100.0 * (1.0 - fewest.solved_share):.0f} % unanswered at its iteration limit. There "
        f"DAQP finishes, and the step's report names it: together they answered "
        f"{100.0 * min(one.solved_share for one in shipped):.0f} % of every set. The price is the "
        f"iterations that OSQP has spent by then: up to "
        f"{1e3 * max(one.time.p99 for one in shipped):.1f} ms (p99). A robot with many cables, or "
        "one that often stands at its bounds, is better off with `qp_solver: daqp`.",
    )))


def _wrapped(words: str) -> str:
    return fill(words, width=100, break_long_words=False, break_on_hyphens=False)
