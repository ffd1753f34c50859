"""Facts of statuses: none hides a graver one, and none says more than is so."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from softrobot_twin.simulation import (
    CommandEfforts,
    CommandSetpoints,
    FollowTargets,
    Hold,
    Status,
)
from softrobot_twin.simulation.result import RATE
from softrobot_twin.simulation.step import inverse_actuation
from softrobot_twin.simulation.step.actuation import INVERSION, Actuation
from softrobot_twin.simulation.step.goals import ENERGY, REACH
from softrobot_twin.simulation.step.step_report import NEAR_BALANCE, Balance, judge
from softrobot_twin.solvers.inverse_problem import LEAST_ENERGY_WEIGHT
from test.scene_changes import repeat_step, solved

FAILURES = {Status.REFUSED, Status.UNSOLVED, Status.DIVERGED}


def without_rates(mapping) -> None:
    for cable in mapping["cables"]:
        cable.pop("rate", None)


def with_weight(weight):
    def change(mapping):
        without_rates(mapping)
        mapping.setdefault("solver", {})["energy_weight"] = weight

    return change


def load_of(simulation, result) -> float:
    return simulation.newton.balance.constant_load + result.efforts.sum()


@pytest.mark.parametrize("limits", [(), ("east.rate",), ("east.tension_max",), (REACH,)])
@pytest.mark.parametrize("met", [True, False])
def test_no_limit_hides_that_a_step_did_not_converge(limits, met):
    done = Actuation(np.zeros(1), np.zeros(1))
    assert judge(done, 0, Balance.MISSED, met, limits, True) is Status.NOT_CONVERGED
    assert judge(done, 1, Balance.MISSED, met, limits, True) is Status.INVERTED
    unsolved = done._replace(solved=False)
    assert judge(unsolved, 1, Balance.MISSED, met, limits, True) is Status.UNSOLVED


def test_no_status_is_both_a_success_and_a_failure():
    assert {status for status in Status if status.is_success} == {Status.OK, Status.LINEARIZED}
    assert {status for status in Status if status.is_failure} == FAILURES


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("budget", [None, 10.0])
def test_status_ok_needs_the_residual_tolerance_and_linearized_a_quarter_of_the_loads(
    diamond, budget, seed
):
    simulation = diamond(without_rates)
    tolerance = simulation.scene.solver.residual_tolerance
    rng, seen = np.random.default_rng(seed), set()
    home = simulation.effector_positions()
    for way in (0.0, 1e-4, 1e-3, 1e-2, 3e-2):
        target = home + rng.uniform(-way, way, (1, 3))
        for _ in range(6):
            result = simulation.step(FollowTargets(target, 0.02), budget=budget)
            residual, load = result.report.residual, load_of(simulation, result)
            if result.status is Status.OK:
                assert residual <= tolerance
            if result.status is Status.LINEARIZED:
                assert tolerance < residual <= NEAR_BALANCE * load
            if residual > max(tolerance, NEAR_BALANCE * load):
                assert result.status is Status.NOT_CONVERGED
            seen.add(result.status)
    assert Status.OK in seen and (budget is not None or Status.LINEARIZED in seen)


def test_several_linearizations_above_the_tolerance_are_not_converged(diamond):
    simulation = diamond(lambda m: m.update(solver={"newton_iterations": 2}))
    result = simulation.step(CommandSetpoints(simulation.rest_setpoints - [0.02, 0, 0, 0], 10.0))
    assert result.status is Status.NOT_CONVERGED


def test_a_binding_limit_is_reported_beside_an_unconverged_step(diamond):
    simulation = diamond()
    result = simulation.step(CommandSetpoints(simulation.rest_setpoints - [0.5, 0, 0, 0], 100.0))
    assert result.status is Status.NOT_CONVERGED
    assert "north.shortening_max" in result.report.active_limits


def test_a_rate_limit_is_reported_beside_an_unconverged_step(beam, rod):
    simulation = beam(rod)
    target = simulation.effector_positions() + [[0.06, 0.08, 0.0]]
    result = simulation.step(FollowTargets(target, 0.01))
    assert result.status is Status.NOT_CONVERGED
    assert any(name.endswith(RATE) for name in result.report.active_limits)
    assert not simulation.step(Hold(0.01)).report.active_limits


@pytest.mark.parametrize("time_step", [0.0, 0.01, 0.25])
def test_time_and_step_count_advance_also_when_a_step_fails(diamond, monkeypatch, time_step):
    simulation = diamond()
    newton = simulation.newton
    correct, ends = newton.correct, []
    for fails in (False, True, False, True, True):
        failing = lambda _, actuation, *__: (0.0, actuation)  # noqa: E731
        monkeypatch.setattr(newton, "correct", failing if fails else correct)
        before = simulation.state
        result = simulation.step(Hold(time_step))
        ends.append(result.status.is_failure)
        assert result.state is simulation.state
        assert simulation.state.step_count == before.step_count + 1
        assert simulation.state.time == before.time + time_step
        if fails:
            np.testing.assert_array_equal(simulation.state.positions, before.positions)
    assert ends == [False, True, False, True, True]


def test_keeping_a_state_because_every_step_inverts_is_a_failure(diamond, monkeypatch):
    simulation = diamond()
    term, before = simulation.model.forces[0], simulation.state
    add_forces = term.add_forces
    # Upright where the step begins, and folded wherever it looks then.
    looks = itertools.count()
    monkeypatch.setattr(
        term, "add_forces", lambda *given: add_forces(*given) + (3 if next(looks) else 0)
    )
    target = simulation.effector_positions() + [[0.01, 0.0, 0.0]]
    result = simulation.step(FollowTargets(target, 0.02))
    assert result.status is Status.REFUSED and result.status.is_failure
    assert INVERSION in result.report.active_limits
    np.testing.assert_array_equal(result.state.positions, before.positions)
    np.testing.assert_array_equal(result.setpoints, before.setpoints)
    # From a folded state a step without a target is complete, and reported as such.
    simulation.restore(before)
    told = simulation.step(CommandSetpoints(simulation.rest_setpoints, 0.02))
    assert told.status is Status.INVERTED and told.report.inverted_count == 3


# In contact the energy weighs less near targets: at 0.05 it keeps the tip by less than the tolerance.
@pytest.mark.sampled
@pytest.mark.parametrize("robot, weight", [
    *itertools.product(["beam", "diamond"], [0.05, 0.5, 1.0]),
    *itertools.product(["beam beside a rod"], [0.2, 0.5, 1.0]),
])  # fmt: skip
def test_an_energy_weight_that_keeps_the_tip_from_its_target_is_named(request, rod, robot, weight):
    def change(mapping):
        with_weight(weight)(mapping)
        if "rod" in robot:
            rod(mapping)

    simulation = request.getfixturevalue(robot.split()[0])(change)
    target = simulation.effector_positions() + [[0.006, 0.002, -0.004]]
    result = repeat_step(simulation, FollowTargets(target, 0.02), 60)
    assert result.status is Status.SATURATED
    assert ENERGY in result.report.active_limits
    # It is the weight: with less of it the tip is nearer by more than the tolerance.
    light = request.getfixturevalue(robot.split()[0])(
        lambda mapping: change(mapping) or mapping["solver"].update(energy_weight=1e-6)
    )
    other = repeat_step(light, FollowTargets(target, 0.02), 60)
    assert other.effector_errors[0] < result.effector_errors[0] - 1e-4
    assert ENERGY not in other.report.active_limits


def test_in_contact_a_small_energy_weight_is_not_blamed_for_a_target_out_of_reach(beam, rod):
    errors = []
    for weight in (1e-6, 0.05):
        simulation = beam(lambda mapping: rod(mapping) or with_weight(weight)(mapping))
        target = simulation.effector_positions() + [[0.006, 0.002, -0.004]]
        result = repeat_step(simulation, FollowTargets(target, 0.02), 60)
        assert result.status is Status.UNREACHABLE and not result.report.active_limits
        errors.append(result.effector_errors[0])
    assert errors[0] > 5e-4 and errors[1] < errors[0] + 1e-4


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("robot", ["beam", "diamond"])
def test_a_target_out_of_reach_is_not_attributed_to_a_small_energy_weight(request, robot, seed):
    simulation = request.getfixturevalue(robot)(without_rates)
    way = np.random.default_rng(seed).normal(size=3)
    way *= simulation.model.nodes.size / np.linalg.norm(way)
    target, ends = simulation.effector_positions() + way, set()
    for _ in range(80):
        result = simulation.step(FollowTargets(target, 0.02))
        assert ENERGY not in result.report.active_limits
        ends.add(result.status)
    assert not ends & {Status.OK, Status.LINEARIZED}


def test_a_target_that_takes_several_steps_is_not_reported_as_unreachable(diamond, monkeypatch):
    monkeypatch.setattr(inverse_actuation, "LONGEST_REACH", 0.01)
    simulation = diamond(without_rates)
    target = simulation.effector_positions() + [[0.01, 0.02, 0.012]]
    ends = []
    for _ in range(30):
        result = simulation.step(FollowTargets(target, 0.02))
        ends.append(result.status)
        if result.status is Status.RATE_LIMITED:
            assert REACH in result.report.active_limits
    assert Status.UNREACHABLE not in ends and ends[0] is Status.RATE_LIMITED
    assert ends[-1].is_success


WEIGHTS = (0.0, 1e-16, 1e-14, 1e-12, 1e-10, 1e-8)


@pytest.mark.sampled
@pytest.mark.parametrize("robot", ["diamond", "beam", "eight", "coarse_trunk"])
def test_the_inverse_converges_to_one_answer_for_any_small_energy_weight(request, robot):
    """A weight below the limit of the arithmetic counts as this limit."""
    made, ends = request.getfixturevalue(robot), []
    for weight in (*WEIGHTS, LEAST_ENERGY_WEIGHT):
        def change(mapping, weight=weight):
            mapping.setdefault("solver", {})["energy_weight"] = weight

        simulation = made(["x", "y", "z"], change) if robot == "eight" else made(change)
        assert any("energy_weight" in note for note in simulation.notes) == (
            weight < LEAST_ENERGY_WEIGHT
        )
        home = simulation.effector_positions()
        for way in ([0.002, 0.001, -0.002], [-0.002, 0.002, -0.003]):
            for _ in range(8):
                result = simulation.step(FollowTargets(home + way, 0.02))
                assert result.status is not Status.UNSOLVED
        ends.append(result.state.positions)
    for other in ends[1:]:
        np.testing.assert_array_equal(other, ends[0])


@pytest.mark.parametrize("weight", [1e-12, 1e-6])
def test_a_reachable_target_is_reached_for_any_small_energy_weight(eight, weight):
    simulation = eight(["x", "y", "z"], with_weight(weight))
    target = simulation.effector_positions() + [[0.003, 0.001, -0.004]]
    result = solved(simulation, FollowTargets(target, 0.02), 60)
    assert result.effector_errors[0] < 2e-5


def test_tensions_beyond_the_length_limits_are_saturated_and_named(diamond):
    simulation = diamond()
    for _ in range(10):
        result = simulation.step(CommandEfforts(np.full(4, 40.0), 0.5))
        assert not result.status.is_success
    assert result.status is Status.SATURATED
    names = {f"{name}.shortening_max" for name in simulation.actuator_names}
    assert set(result.report.active_limits) == names
    solved(simulation, CommandEfforts(np.full(4, 5.0), 0.5), 10)


@pytest.mark.parametrize("time_step", [0.005, 0.05])
@pytest.mark.parametrize("seed", range(3))
def test_in_dynamics_no_status_overstates_the_result(diamond, seed, time_step):
    simulation = diamond(lambda m: m.update(integration="dynamic"))
    rng = np.random.default_rng(seed)
    tolerance, reach = simulation.scene.solver.residual_tolerance, simulation.model.reach_tolerance
    home = simulation.effector_positions()
    for tick in range(60):
        if tick % 15 == 0:
            target = home + rng.uniform(-0.02, 0.02, (1, 3))
        result = simulation.step(FollowTargets(target, time_step))
        if result.status.is_success:
            assert result.effector_errors[0] <= reach
        if result.status is Status.OK:
            assert result.report.residual <= tolerance
        if result.status in (Status.SATURATED, Status.RATE_LIMITED):
            assert result.report.active_limits and result.effector_errors[0] > reach
        assert simulation.state.time == pytest.approx((tick + 1) * time_step)


@pytest.mark.parametrize("beside_a_rod", [False, True])
def test_targets_in_zero_time_are_rate_limited_and_move_no_cable(eight, rod, beside_a_rod):
    simulation = eight(change=rod if beside_a_rod else lambda mapping: None)
    assert np.isfinite(simulation.limits.rate).all()
    home = simulation.effector_positions()
    for way in ([0.004, 0.0, -0.002], [-0.004, 0.003, -0.004]):
        repeat_step(simulation, FollowTargets(home + way, 0.02), 10)
        before = simulation.state.setpoints
        for _ in range(3):
            result = simulation.step(FollowTargets(home - way, 0.0))
            assert result.status is Status.RATE_LIMITED
            np.testing.assert_allclose(result.setpoints, before, atol=1e-12)
