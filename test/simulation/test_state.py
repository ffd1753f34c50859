"""Facts of states: reset, restore, failures, and scenes with little in them."""

import numpy as np
import pytest

from softrobot_twin.errors import CommandError
from softrobot_twin.simulation import CommandSetpoints, FollowTargets, Hold, State, Status


def run(simulation, targets):
    return [simulation.step(FollowTargets(target, 0.05)) for target in targets]


def same(first, second) -> bool:
    return all(
        np.array_equal(a.state.positions, b.state.positions)
        and np.array_equal(a.setpoints, b.setpoints)
        and np.array_equal(a.efforts, b.efforts)
        and a.status is b.status
        for a, b in zip(first, second, strict=True)
    )


def test_a_run_after_reset_is_the_same_to_the_bit(diamond, circle):
    simulation = diamond()
    first = run(simulation, circle(10))
    simulation.reset()
    second = run(simulation, circle(10))
    simulation.reset()
    simulation.reset()
    assert same(first, second) and same(first, run(simulation, circle(10)))


def test_a_run_after_warming_up_and_after_a_failure_is_the_same_to_the_bit(diamond, circle):
    simulation = diamond()
    simulation.warm_up()
    first = run(simulation, circle(5))
    broken = State(
        np.full_like(simulation.state.positions, np.nan), simulation.state.setpoints,
        simulation.state.efforts,
    )  # fmt: skip
    simulation.restore(broken)
    assert simulation.step(Hold()).status is Status.DIVERGED
    simulation.reset()
    assert same(first, run(simulation, circle(5)))


def test_two_simulations_of_one_scene_take_the_same_steps(diamond, circle):
    assert same(run(diamond(), circle(5)), run(diamond(), circle(5)))


def test_a_saved_state_can_be_restored(diamond, circle, settle):
    simulation = diamond()
    run(simulation, circle(5))
    saved = simulation.state
    first = simulation.step(Hold())
    simulation.restore(saved)
    assert np.array_equal(simulation.step(Hold()).state.positions, first.state.positions)


def test_a_state_of_another_mesh_is_refused(diamond):
    simulation = diamond()
    with pytest.raises(CommandError, match="shapes"):
        simulation.restore(State(np.zeros((2, 3)), np.zeros(4), np.zeros(4)))


def test_a_state_is_read_only(diamond):
    with pytest.raises(ValueError, match="read-only"):
        diamond().state.positions[0, 0] = 1.0


def test_a_failed_step_keeps_the_last_good_state(diamond):
    simulation = diamond()
    good = simulation.step(Hold())
    simulation.model.forces[1].weights[0, 0] = np.nan
    failed = simulation.step(Hold())
    assert failed.status is Status.DIVERGED and failed.status.is_failure
    np.testing.assert_array_equal(failed.state.positions, good.state.positions)
    np.testing.assert_array_equal(failed.setpoints, good.setpoints)
    assert np.all(np.isfinite(failed.efforts))


def test_a_scene_with_nothing_to_do_runs(diamond):
    def bare(mapping):
        for key in ("cables", "effectors", "markers"):
            mapping.pop(key)

    simulation = diamond(bare)
    simulation.warm_up()
    result = simulation.step(Hold())
    assert result.status.is_success
    assert result.setpoints.shape == (0,) and result.effector_positions.shape == (0, 3)
    with pytest.raises(CommandError, match="no effectors"):
        simulation.step(FollowTargets(np.zeros((0, 3)), 0.1))


def test_every_stage_of_a_step_is_timed_and_adds_up(diamond, circle):
    simulation = diamond()
    report = simulation.step(FollowTargets(circle(1)[0], 0.1)).report
    assert tuple(report.stage_times) == simulation.stages
    assert sum(report.stage_times.values()) == pytest.approx(report.compute_time)


def test_several_linearizations_reduce_the_residual_below_its_tolerance(diamond):
    simulation = diamond(
        lambda m: m.update(solver={"newton_iterations": 20, "residual_tolerance": 1e-8})
    )
    result = simulation.step(CommandSetpoints(simulation.rest_setpoints - 0.015, 10.0))
    assert result.report.residual <= 1e-8
    assert 2 < result.report.iterations < 15


def test_a_single_linearization_that_increases_the_residual_is_reported(diamond):
    simulation = diamond()
    state = simulation.state
    positions = state.positions.copy()
    free = simulation.model.nodes.free_nodes
    positions[free] += 2e-3 * np.random.default_rng(0).standard_normal((len(free), 3))
    simulation.restore(State(positions, state.setpoints, state.efforts))
    statuses = [simulation.step(Hold()).status for _ in range(30)]
    assert statuses[0] in (Status.NOT_CONVERGED, Status.INVERTED)
    assert statuses[-1] is Status.OK


def test_a_residual_above_its_tolerance_is_reported(diamond):
    simulation = diamond(
        lambda m: m.update(solver={"newton_iterations": 2, "residual_tolerance": 1e-12})
    )
    result = simulation.step(CommandSetpoints(simulation.rest_setpoints - 0.015, 10.0))
    assert result.status is Status.NOT_CONVERGED
