"""A reduced body knows its training range and its error, by modes that a step does not use."""

import numpy as np
import pytest

from softrobot_twin.analysis import reduction_error
from softrobot_twin.analysis.reduction_error import ReductionState, ReductionStates, has_spare_modes
from softrobot_twin.mechanics.element_batches import BATCH
from softrobot_twin.scene import load_scene
from softrobot_twin.scene.scene_changes import without_reductions
from softrobot_twin.simulation import (
    CommandEfforts,
    CommandSetpoints,
    Simulation,
    Status,
)
from test.scene_changes import repeat_step

ANY_TIME = 1.0e3
TRAINED = 0.011


@pytest.fixture(scope="module")
def pair(half_trained):
    """The full and the reduced simulation, solved to balance without rates."""
    scene = load_scene(half_trained)
    cables = tuple(cable.model_copy(update={"rate": None}) for cable in scene.cables)
    solver = scene.solver.model_copy(update={"newton_iterations": 30, "residual_tolerance": 1.0e-8})
    scene = scene.model_copy(update={"cables": cables, "solver": solver})
    return Simulation(without_reductions(scene), with_warnings=False), Simulation(
        scene, with_warnings=False
    )


def wound(simulation, shortening, from_rest=False):
    """Go to an equilibrium at shortenings of the cables [m]."""
    if from_rest:
        simulation.reset()
    begin = simulation.state.setpoints
    for share in np.linspace(0.0, 1.0, 5)[1:]:
        lengths = begin + share * (simulation.rest_setpoints - shortening - begin)
        for _ in range(5):
            result = simulation.step(CommandSetpoints(lengths, ANY_TIME))
            if result.report.residual < 1.0e-8:
                break
    assert result.report.residual < 1.0e-5
    return result


def drawn(most, count, seed):
    """Shortenings up to one, of which one cable has the largest [m], shape (count, 4)."""
    rng = np.random.default_rng(seed)
    shortenings = most * rng.random((count, 4))
    shortenings[np.arange(count), rng.integers(0, 4, count)] = most
    return shortenings


def judged(pair, shortenings):
    """Error, its estimate [m], share of the displacement, and range at each."""
    (full, reduced), states = pair, ReductionStates(pair[1])
    rest, rows = full.model.effectors.positions(full.model.nodes.rest_positions), []
    for simulation in pair:
        simulation.reset()
    for shortening in shortenings:
        truth = wound(full, shortening).effector_positions
        result = wound(reduced, shortening)
        error = np.linalg.norm(result.effector_positions - truth)
        state = states.read()["body"]
        rows.append([error, state.error, state.range, error / np.linalg.norm(truth - rest),
                     state.share, "body.sampled_range" in result.report.active_limits])  # fmt: skip
    return np.array(rows).T


def test_at_twice_the_training_range_the_estimate_is_within_a_factor_of_two(pair):
    """Row 39 of the hard cases; the true error is that of the full model at the same lengths."""
    true, estimate, ranges, share, told, named = judged(pair, drawn(2.0 * TRAINED, 40, 3))
    ratio = estimate / true
    print(f"errors {100 * share.min():.2f} to {100 * share.max():.2f} %, estimate by error "
          f"{ratio.min():.2f} to {ratio.max():.2f}")  # fmt: skip
    assert np.mean((ratio > 0.5) & (ratio < 2.0)) >= 0.9
    # At the others the full model tells; see test_full_model_error.py.
    # The status names the body in all of them.
    assert named.all() and (ranges > 1.0).all()
    np.testing.assert_allclose(told / share, ratio, rtol=0.1)


def test_inside_of_its_training_a_body_is_not_named(pair):
    true, estimate, ranges, share, _, named = judged(pair, TRAINED * np.random.default_rng(
        4).random((20, 4)))  # fmt: skip
    assert not named.any() and (ranges < 1.0).all()
    ratio = estimate / true
    assert np.mean((ratio > 0.5) & (ratio < 2.0)) >= 0.9
    assert np.median(share) < 0.005


def test_range_and_spare_modes_judge_a_body_together():
    """Each sees poses that the other misses."""
    fine = ReductionState(0.8, 1e-4, 0.001, 0.01, share=0.005, negligible=2e-4)
    assert not fine.doubt
    assert fine._replace(range=1.2).doubt == "outside of the range of its reduction"
    off = "3 % of the displacement off by its spare modes"
    by_modes = fine._replace(error=6e-4, share=0.03)
    assert by_modes.doubt == f"{off} (1 % at the worst fresh state)"
    both = by_modes._replace(range=1.2).doubt
    assert "outside of the range" in both and off in both
    assert not fine._replace(share=0.03).doubt  # near rest a tenth of a millimetre
    # A file that was not judged, and a step without an estimate.
    assert not by_modes._replace(measured_worst=np.nan).doubt
    assert by_modes._replace(measured_worst=np.nan, share=0.06).doubt
    assert not fine._replace(error=np.nan, share=np.nan).doubt


def test_the_range_is_in_each_report_and_none_without_reduced_bodies(pair):
    full, reduced = pair
    first = wound(reduced, 0.002, True).report.sampled_range
    second = wound(reduced, 0.010).report.sampled_range
    assert 0.0 < first < second < 1.0
    assert wound(full, 0.002, True).report.sampled_range == 0.0


def test_steps_build_no_second_model_and_reading_changes_nothing(half_trained, monkeypatch):
    build, built = reduction_error.ReductionErrors, []
    monkeypatch.setattr(
        reduction_error, "ReductionErrors", lambda *given: built.append(given[0]) or build(*given)
    )
    read, unread = (Simulation(load_scene(half_trained), with_warnings=False) for _ in range(2))
    states, lengths = ReductionStates(read), read.rest_setpoints - [0.004, 0.0, 0.006, 0.001]
    for number in range(6):
        command = CommandSetpoints(lengths, 0.05)
        results = [simulation.step(command) for simulation in (read, unread)]
        np.testing.assert_array_equal(*(result.state.positions for result in results))
        np.testing.assert_array_equal(*(result.efforts for result in results))
        if number >= 2:
            before = read.state
            assert np.isfinite(states.read()["body"].error)
            assert read.state is before
    assert built == [read]


def test_the_estimate_holds_lengths_where_tensions_are_commanded(pair):
    """With three equal tensions pulled the pose is not stable at fixed tensions; lengths are held.
    """
    _, reduced = pair
    tensions = wound(reduced, [0.010, 0.010, 0.010, 0.002], True).efforts
    result = reduced.step(CommandEfforts(tensions, ANY_TIME))
    assert not result.status.is_failure
    error = ReductionStates(reduced).read()["body"].error
    assert 0.0 < error < 0.01 * np.linalg.norm(
        result.effector_positions - reduced.model.effectors.positions(
            reduced.model.nodes.rest_positions))  # fmt: skip


def test_spare_modes_in_use_are_the_better_model_that_tells_no_error(pair, half_trained):
    full, reduced = pair
    scene = reduced.scene.with_deformables({"reduced": {"spare_modes": True}})
    extended = Simulation(scene, with_warnings=False)
    assert extended.dof_count == 2 * reduced.dof_count == 48
    errors = []
    for shortening in drawn(1.5 * TRAINED, 6, 1):
        places = [wound(simulation, shortening, True).effector_positions
                  for simulation in (full, reduced, extended)]  # fmt: skip
        errors.append([np.linalg.norm(place - places[0]) for place in places[1:]])
    used, all_modes = np.mean(errors, axis=0)
    assert all_modes < 0.7 * used
    state = ReductionStates(extended).read()["body"]
    assert np.isnan(state.error) and np.isnan(state.share) and state.range > 0.0
    assert not has_spare_modes(extended.model)


def test_the_strain_range_is_watched_at_the_sampled_points(half_trained):
    def bent(strain_range):
        scene = load_scene(half_trained)
        material = scene.body.material.model_copy(update={"strain_range": strain_range})
        body = scene.body.model_copy(update={"material": material})
        simulation = Simulation(scene.model_copy(update={"body": body}), with_warnings=False)
        lengths = simulation.rest_setpoints - [0.010, 0.0, 0.010, 0.0]
        result = repeat_step(simulation, CommandSetpoints(lengths, ANY_TIME), 10)
        return simulation, result

    _, inside = bent((-0.9, 2.0))
    assert inside.report.strains == ()
    simulation, outside = bent((-0.9, 0.05))
    (strained,) = outside.report.strains
    assert "body.strain_range" in outside.report.active_limits
    (watch,) = simulation.model.strain_watches
    F = watch.elements.deformations.reshape(-1, 3, 3, BATCH)
    stretches = np.linalg.svd(F.transpose(0, 3, 1, 2), compute_uv=False)
    assert strained.greatest == pytest.approx(stretches.max() - 1.0, rel=1e-6)
    assert outside.status in (Status.OK, Status.LINEARIZED)
