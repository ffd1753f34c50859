"""What is printed after a run: rows for what the scene has, few rows for many alike."""

from types import SimpleNamespace

import numpy as np
import pytest

from softrobot_twin.simulation.cable_actuator import CableActuator
from softrobot_twin.simulation.result import Status
from softrobot_twin.simulation.run_columns import RunRow
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


def lines_of(simulation, *rows, **options):
    summary = RunSummary(simulation, **options)
    for step, given in enumerate(rows):
        summary.add(row(simulation, step, **given))
    return dict(summary.lines())


def test_a_run_without_targets_contacts_or_limits_has_no_rows_of_them():
    lines = lines_of(scene_of(), {}, {"shortening": 1e-3})
    assert list(lines) == ["steps", "tip, at the end", "cable_0", "cable_1", "residual, max",
                           "compute time", "status ok"]


@pytest.mark.parametrize(
    ("statuses", "code"),
    [
        (["ok"], 0), (["not_converged", "ok"], 0), (["ok", "rate_limited"], 0),
        (["ok", "unreachable"], 0), (["ok", "not_converged"], 3), (["ok", "inverted"], 3),
        (["refused", "ok"], 1), (["ok", "refused", "not_converged"], 1),
    ],
)  # fmt: skip
def test_the_exit_code_tells_rows_without_solution_and_a_last_row_that_is_not_good(statuses, code):
    simulation = scene_of()
    summary = RunSummary(simulation)
    for step, status in enumerate(statuses):
        summary.add(row(simulation, step, status=Status(status)))
    assert summary.exit_code == code


def test_of_several_statuses_the_one_at_the_end_is_told():
    lines = lines_of(scene_of(), {"status": Status.LINEARIZED}, {}, {})
    assert lines["status linearized"] == "1 steps"
    assert lines["status ok"] == "2 steps, the last too"


def test_errors_are_told_for_each_effector_that_has_targets():
    simulation = scene_of(effectors=("tip", "side", "free"))
    lines = lines_of(simulation, {"errors": (1e-3, 0.0, np.nan)}, {"errors": (3e-3, 1e-3, np.nan)})
    assert lines["tip, tracking error"] == "mean 2.0000 mm, max 3.0000 mm at 0.1 s"
    assert lines["side, tracking error"].startswith("mean 0.5000 mm")
    assert not any(name.startswith("free") for name in lines)


def test_actuators_with_the_same_ranges_share_a_row():
    lines = lines_of(scene_of(cables=3), {"tension": 0.0}, {"tension": 2.5})
    assert lines["cable_0, cable_1, cable_2"] == "shortening [0, 0] mm, tension [0, 2.5] N"


def test_many_actuators_are_one_row_that_names_the_largest():
    lines = lines_of(scene_of(cables=40), {}, {"shortening": 1e-3})
    told = [text for name, text in lines.items() if "cable" in name]
    assert told == [lines["40 cables"]]
    assert told[0].startswith("shortening [0, 39] mm of cable_39, tension [1, 1] N")


def test_limits_are_told_by_how_often_they_were_met():
    lines = lines_of(scene_of(), {"limits": ("cable_0.rate",)},
                     {"limits": ("cable_0.rate", "cable_1.tension_max")}, {}, {})
    assert lines["limits met most"] == "cable_0.rate 50 %, cable_1.tension_max 25 % of steps"


def test_pairs_that_touched_are_told_and_no_others():
    simulation = scene_of(pairs=(("tip", "wall"), ("tip", "floor")))
    lines = lines_of(simulation, {"sums": (0.0, 0.0)}, {"sums": (2.0, 0.0)})
    assert "touching in 50 % of steps" in lines["force on tip by wall"]
    assert "force on tip by floor" not in lines and lines["contacts, maximum"] == "2"


@pytest.mark.parametrize(("bodies", "expected"), [
    (2, {"hub_0, highest": "+0.00 mm at 0.00 s", "hub_1, highest": "+2.00 mm at 0.20 s"}),
    (9, {"highest of 9": "hub_8 +16.00 mm at 0.20 s"}),
])
def test_of_many_bodies_the_highest_is_told(bodies, expected):
    lines = lines_of(scene_of(bodies=bodies), {}, {}, {})
    assert {name: text for name, text in lines.items() if "highest" in name} == expected
