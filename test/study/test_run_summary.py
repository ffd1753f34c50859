"""The exit code of a run."""

from types import SimpleNamespace

import numpy as np
import pytest

from softrobot_twin.simulation.command import CommandSetpoints
from softrobot_twin.simulation.result import Status
from softrobot_twin.study.run_summary import RunSummary
from softrobot_twin.tables.run_columns import RunRow

SIMULATION = SimpleNamespace(
    effector_names=(), scene=SimpleNamespace(gravity=(0.0, 0.0, 0.0)),
    actuators=SimpleNamespace(kind_of={}, told_efforts=np.array), model=SimpleNamespace(contacts=None, rigid=[]),
    state=SimpleNamespace(positions=None))
NONE = np.zeros((0, 3))


def row(step, status):
    """A row of a robot without anything."""
    report = SimpleNamespace(contact_count=0, residual=1e-3, linearization_error=np.nan, compute_time=2e-3,
                             active_limits=(), sampled_range=0.0)
    result = SimpleNamespace(
        effector_positions=NONE, effector_errors=np.empty(0), orientation_errors=None, stiffness_errors=None,
        displacements=np.empty(0), efforts=np.empty(0), report=report, status=status)
    return RunRow(step, 0.1 * step, result, None, np.zeros((0, 7)), NONE, np.empty(0))


@pytest.mark.parametrize("statuses, code", [
    (["ok"], 0), (["not_converged", "ok"], 0), (["ok", "rate_limited"], 0),
    (["ok", "unreachable"], 0), (["ok", "not_converged"], 3), (["ok", "inverted"], 3),
    (["refused", "ok"], 1), (["ok", "refused", "not_converged"], 1),
])  # fmt: skip
def test_the_exit_code_tells_rows_without_solution_and_a_last_row_that_is_not_good(statuses, code):
    summary = RunSummary(SIMULATION)
    for step, status in enumerate(statuses):
        summary.add(row(step, Status(status)))
    assert summary.exit_code == code


def test_a_row_between_that_is_not_followed_is_told_by_the_exit_code():
    summary, command = RunSummary(SIMULATION), CommandSetpoints(np.zeros(1), 1.0)
    for step, status in enumerate(["ok", "saturated", "ok"]):
        summary.add(row(step, Status(status))._replace(command=command))
    assert (summary.exit_code, summary.not_followed) == (3, 1)
