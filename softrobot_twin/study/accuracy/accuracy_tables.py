"""What accuracy costs, as tables for the terminal."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from rich.table import Table

from softrobot_twin.study.accuracy.accuracy_row import MESH, AccuracyRow
from softrobot_twin.study.accuracy.accuracy_study import CASES, Reference
from softrobot_twin.study.accuracy.richardson import ASSUMED_ORDER
from softrobot_twin.study.reports.terminal import table

_CASE_WORDS = {"lengths": "displacements prescribed", "tensions": "forces prescribed",
               "weightless": "displacements, no gravity"}


def mesh_table(rows: Sequence[AccuracyRow]) -> Table:
    """Every mesh, element and law."""
    made = table("Error of the effector, % of its displacement, and time of a step", "mesh",
                 "element", "law", "dof", "step [ms]", "p99 [ms]",
                 *(_CASE_WORDS[case] for case in CASES))
    for row in rows:
        if row.knob == MESH:
            made.add_row(row.mesh, row.element, row.law, str(row.dof_count), f"{row.step_ms:.2f}",
                         f"{row.step_p99_ms:.2f}",
                         *(_percent(getattr(row, f"error_{case}")) for case in CASES))
    return made


def knob_table(rows: Sequence[AccuracyRow]) -> Table:
    """What the other knobs add."""
    made = table("What other knobs add to the error on the scene's own mesh", "knob", "setting",
                 "step [ms]", "adds [%]")
    for row in rows:
        if row.knob != MESH:
            made.add_row(row.knob, row.setting, f"{row.step_ms:.2f}",
                         f"{100.0 * row.error_added:.2g}")
    return made


def reference_table(references: dict[str, Reference]) -> Table:
    """What all errors are measured against, and how sure it is."""
    made = table("Reference: quadratic meshes, extrapolated", "case", "displacement [mm]",
                 "observed order", "uncertainty [%]", "meshes")
    for case, reference in references.items():
        order = reference.limit.order
        made.add_row(_CASE_WORDS[case], f"{1e3 * reference.displacement:.2f}",
                     f"{order:.2f}" if np.isfinite(order) else f"none; {ASSUMED_ORDER:g} assumed",
                     f"{100.0 * reference.uncertainty:.2f}", ", ".join(reference.meshes))
    return made


def _percent(share: float) -> str:
    return f"{100.0 * share:.2f}" if np.isfinite(share) else "not converged"
