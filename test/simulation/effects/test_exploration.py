"""Where a robot rests away from its targets, nearer poses are sought by simulation while it stays."""

import compare_inverse
import numpy as np
import pytest

import softrobot_twin as st
from softrobot_twin.simulation import FollowTargets
from softrobot_twin.simulation.effects.exploration import NEARER, RANDOM_MOVES, Exploration
from softrobot_twin.simulation.step.newton import Newton
from test.control.conftest import coarse
from test.scene_changes import repeat_step

MOST = 2000


@pytest.fixture
def limited():
    """A beam whose five limited cables rest far from a place and an orientation, which they could bring nearer."""
    robot = compare_inverse.random_robot(np.random.default_rng([33, 34]))

    def make(**solver):
        solver = dict(exploration=True) | solver
        scene = robot.scene | dict(solver=robot.scene["solver"] | solver)
        return st.build(**scene), st.targets(robot.targets)

    make.robot = robot
    return make


def until(twin, asked, found, most=MOST):
    """Steps until a result is as asked."""
    results = (twin.step(asked) for _ in range(most))
    return next(result for result in results if found(result.outcome.report))


def missed(robot, result):
    return np.linalg.norm(compare_inverse.missed_targets(robot, result))


def test_a_robot_goes_to_a_nearer_pose_and_rests_there(limited):
    twin, asked = limited()
    before = until(twin, asked, lambda report: report.is_exploring)
    after = until(twin, asked, lambda report: report.is_resting)
    assert missed(limited.robot, after) < 0.5 * missed(limited.robot, before)
    for _ in range(5):
        assert twin.step(asked).outcome.setpoints is after.outcome.setpoints


def test_while_it_explores_a_robot_stays_to_the_bit(limited):
    twin, asked = limited()
    first = until(twin, asked, lambda report: report.is_exploring)
    count, state = 0, twin.state
    while (result := twin.step(asked)).outcome.report.is_exploring:
        assert result.outcome.setpoints is first.outcome.setpoints
        assert twin.state.positions is state.positions and result.status is first.status
        count += 1
        assert twin.simulation.state.step_count == state.step_count + count
    assert count > 5


def test_another_command_ends_an_exploration_which_left_no_trace(limited):
    twin, asked = limited()
    until(twin, asked, lambda report: report.is_exploring)
    fresh, _ = limited(exploration=False)
    for _ in range(twin.simulation.state.step_count):
        assert not fresh.step(asked).outcome.report.is_exploring
    repeat_step(twin, asked, 7)
    home = st.setpoints({f"{name}_shortening_m": 0.0 for name in ("c0", "c1", "c2", "c3", "c4")})
    repeat_step(twin, home, 3)
    np.testing.assert_array_equal(repeat_step(fresh, home, 3).outcome.state.positions, twin.positions)


@pytest.mark.parametrize("entry, told", [
    (dict(touches=[dict(name="hand", points=[[0.0, 0.0, 0.125]])]), dict(touches={"hand_force_N": [0.0, 0.1, 0.0]})),
    (dict(grips=[dict(name="cup", points=[[0.0, 0.0, 0.125]], holds="world")]), dict(grips={"cup": True})),
    (dict(moving_base={}), dict(base=([0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]))),
])  # fmt: skip
def test_what_is_told_of_a_touch_a_grip_or_the_base_ends_an_exploration(entry, told):
    twin = st.build(**coarse("diamond", "diamond_400") | entry | dict(solver=dict(exploration=True)))
    asked = st.targets(tip=[0.5, 0.0, 0.0])
    memory = until(twin, asked, lambda report: report.is_exploring).outcome.state.memory
    result = twin.step(asked, **told).outcome
    assert not result.report.is_exploring
    assert any(not np.array_equal(one, result.state.memory[key]) for key, one in memory.items())


def test_a_trial_that_raises_leaves_the_robot_where_it_is(limited, monkeypatch):
    twin, asked = limited()
    until(twin, asked, lambda report: report.is_exploring)
    state, correct = twin.state, Newton.correct

    def broken(*arguments):
        correct(*arguments)
        raise ArithmeticError("in a trial")

    monkeypatch.setattr(Newton, "correct", broken)
    with pytest.raises(ArithmeticError):
        twin.step(asked)
    assert twin.state is state
    monkeypatch.undo()
    result = twin.step(asked)
    assert np.abs(result.outcome.state.positions - state.positions).max() < 1e-6
    assert result.outcome.report.is_exploring is False


def goals(twin, commanded=None):
    simulation = twin.simulation
    result = twin.step(st.hold()).outcome
    command = FollowTargets(np.zeros((1, 3)), 0.02, commanded)
    exploration, found = Exploration(command, result, np.ones(1), simulation.actuators), []
    while exploration.trial is not None:
        found.append(exploration.trial - simulation.actuators.drives(result.setpoints))
        exploration.next_trial()
    return np.array(found)


def test_trials_stay_within_limits_and_leave_commanded_actuators_alone(limited):
    twin, _ = limited()
    limits = twin.simulation.limits
    moves = goals(twin)
    assert len(moves) > RANDOM_MOVES
    assert (moves >= limits.drive_min - 1e-12).all() and (moves <= limits.drive_max + 1e-12).all()
    commanded = np.full(len(limits.drive_min), np.nan)
    commanded[1] = twin.simulation.state.setpoints[1]
    moves = goals(twin, commanded)
    assert len(moves) and (moves[:, 1] == 0.0).all() and (moves != 0.0).any(axis=1).all()


@pytest.mark.parametrize("share, has_gone, is_stable, is_calm, is_found, most", [
    (0.9, True, True, True, True, 100), (1.1, True, True, True, False, 50), (0.9, False, True, True, False, 400),
    (0.9, True, False, True, False, 400), (0.9, True, True, False, False, 400),
])  # fmt: skip
def test_a_trial_is_found_only_where_it_rests_nearer(limited, share, has_gone, is_stable, is_calm, is_found, most):
    twin, _ = limited()
    result, command = twin.step(st.hold()).outcome, FollowTargets(np.zeros((1, 3)), 0.02)
    exploration, count = Exploration(command, result, np.ones(1), twin.simulation.actuators), 0
    first = exploration.trial
    while exploration.trial is first and not exploration.is_found:
        exploration.judge(np.array([(share * NEARER) ** 0.5]), has_gone, is_stable, is_calm)
        count += 1
    assert exploration.is_found is is_found and count < most
