"""What is printed after a run: rows for what the scene has, few rows for many alike."""

from types import SimpleNamespace

import numpy as np
import pytest

from softrobot_twin.simulation.building.cable_actuator import CableActuator
from softrobot_twin.simulation.result import Status
from softrobot_twin.simulation.runs.run_columns import RunRow
from softrobot_twin.study.run_summary import RunSummary


def scene_of(cables=2, effectors=("tip",), pairs=(), bodies=0):
    """What a summary asks of a simulation."""
    names = [f"cable_{index}" for index in range(cables)]
    contacts = SimpleNamespace(pairs=[SimpleNamespace(names=pair) for pair in pairs])
    rigid = [SimpleNamespace(name=f"hub_{index}", is_free=True,
                             entry_pose=lambda _: (np.zeros(3), np.eye(3)))
             for index in range(bodies)]  # fmt: skip
    return SimpleNamespace(
        effector_names=effectors, scene=SimpleNamespace(gravity=(0.0, 0.0, -9.81)),
        actuators=SimpleNamespace(kind_of=dict.fromkeys(names, CableActuator())),
        model=SimpleNamespace(contacts=contacts if pairs else None, rigid=rigid),
        state=SimpleNamespace(positions=None))


def row(simulation, step, *, errors=(np.nan,), shortening=0.0, tension=1.0, limits=(), sums=(),
        status=Status.OK):
    """A row in which everything stays but what is given."""
    count, bodies = len(simulation.actuators.kind_of), len(simulation.model.rigid)
    poses = np.tile([0.0, 0, 0, 0, 0, 0, 1], (bodies, 1))
    poses[:, 2] = 1e-3 * step * np.arange(bodies)
    report = SimpleNamespace(
        contact_count=len(sums), residual=1e-3, linearization_error=np.nan, compute_time=2e-3,
        active_limits=limits, sampled_range=0.0)
    result = SimpleNamespace(
        effector_positions=np.zeros((len(simulation.effector_names), 3)),
        effector_errors=np.array(errors), orientation_errors=None, stiffness_errors=None,
        displacements=shortening * np.arange(count), efforts=np.full(count, tension),
        report=report, status=status)
    return RunRow(step, 0.1 * step, result, None, poses, np.zeros((len(sums), 3)),
                  np.array(sums, float))


BARE = """\
steps: 2, 0.1 s at their end
tip, at the end: [0, 0, 0] mm
cable_0: shortening [0, 0] mm, tension [1, 1] N
cable_1: shortening [0, 1] mm, tension [1, 1] N
residual, max: 0.001 N
compute time: median 2.00 ms, p99 2.00 ms, max 2.00 ms
status ok: 2 steps"""
FULL = """\
steps: 4, 0.3 s at their end
tip, tracking error: mean 2.0000 mm, max 3.0000 mm at 0.1 s
side, tracking error: mean 0.5000 mm, max 1.0000 mm at 0.1 s
hub_0, highest: +0.00 mm at 0.00 s
hub_1, highest: +3.00 mm at 0.30 s
cable_0, cable_1, cable_2: shortening [0, 0] mm, tension [0, 2.5] N
contacts, maximum: 2
force on tip by wall: resultant median 0.000 N, max 0.000 N; sum of magnitudes median 2.000 N, \
max 2.000 N; touching in 25 % of steps
limits met most: cable_0.rate 50 %, cable_1.tension_max 25 % of steps
residual, max: 0.001 N
compute time: median 2.00 ms, p99 2.00 ms, max 2.00 ms
status linearized: 1 steps
status ok: 3 steps, the last too"""
MANY = """\
steps: 3, 0.2 s at their end
tip, at the end: [0, 0, 0] mm
highest of 9: hub_8 +16.00 mm at 0.20 s
40 cables: shortening [0, 39] mm of cable_39, tension [1, 1] N of cable_0
residual, max: 0.001 N
compute time: median 2.00 ms, p99 2.00 ms, max 2.00 ms
status ok: 3 steps"""
WITH_ALL = scene_of(3, ("tip", "side", "free"), (("tip", "wall"), ("tip", "floor")), 2)


@pytest.mark.parametrize(("simulation", "rows", "printed"), [
    (scene_of(), ({}, {"shortening": 1e-3}), BARE),
    (WITH_ALL, (
        {"status": Status.LINEARIZED, "errors": (1e-3, 0.0, np.nan), "tension": 0.0,
         "limits": ("cable_0.rate",), "sums": (0.0, 0.0)},
        {"errors": (3e-3, 1e-3, np.nan), "tension": 2.5, "sums": (2.0, 0.0),
         "limits": ("cable_0.rate", "cable_1.tension_max")},
        *2 * ({"errors": (2e-3, 0.5e-3, np.nan), "sums": (0.0, 0.0)},)), FULL),
    (scene_of(cables=40, bodies=9), ({}, {"shortening": 1e-3}, {}), MANY),
], ids=["bare", "full", "many"])  # fmt: skip
def test_what_a_run_had_is_told_and_nothing_else(simulation, rows, printed):
    """Errors of effectors with targets, pairs that touched, limits met; alike things in one row."""
    summary = RunSummary(simulation)
    for step, given in enumerate(rows):
        summary.add(row(simulation, step, **given))
    assert "\n".join(f"{name}: {text}" for name, text in summary.lines()) == printed


@pytest.mark.parametrize("statuses, code", [
    (["ok"], 0), (["not_converged", "ok"], 0), (["ok", "rate_limited"], 0),
    (["ok", "unreachable"], 0), (["ok", "not_converged"], 3), (["ok", "inverted"], 3),
    (["refused", "ok"], 1), (["ok", "refused", "not_converged"], 1),
])  # fmt: skip
def test_the_exit_code_tells_rows_without_solution_and_a_last_row_that_is_not_good(statuses, code):
    simulation = scene_of()
    summary = RunSummary(simulation)
    for step, status in enumerate(statuses):
        summary.add(row(simulation, step, status=Status(status)))
    assert summary.exit_code == code
