"""Effectors that are asked for a stiffness beside their place."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from softrobot_twin.analysis.apparent_compliance import apparent_compliance
from softrobot_twin.errors import CommandError
from softrobot_twin.scene.loading import written_out
from softrobot_twin.simulation import CommandSetpoints, FollowTargets, Status, Touched
from softrobot_twin.simulation.effects.stiffness_targets import StiffnessTargets
from test.scene_changes import built, changed, repeat_step

FILE = Path(__file__).resolve().parents[3] / "config" / "scenes" / "stifface.yaml"
WHERE, NOWHERE = np.array([[0.0, 0.0, -1.0e-3]]), np.full((1, 3), np.nan)


def make(change=None, **stiffness):
    """The Stifface; its middle is asked for a stiffness with these entries, if there are any."""
    mapping = written_out(yaml.safe_load(FILE.read_text()))
    mapping["effectors"][0].pop("stiffness", None)
    if stiffness:
        mapping["effectors"][0]["stiffness"] = stiffness
    return built(mapping, change, path=FILE)


@pytest.fixture(scope="module")
def pad():
    """The pad with a wanted stiffness in the scene's own weights, at rest for each test."""
    simulation = make(weight=1.0)
    tip = simulation.effector_positions()

    def follow(stiffness, moved=WHERE, steps=60, simulation=simulation):
        target = None if stiffness is None else np.array([[np.nan, np.nan, stiffness]])
        return [
            simulation.step(FollowTargets(tip + moved, 0.02, stiffness=target))
            for _ in range(steps)
        ]

    simulation.follow = follow
    return simulation


@pytest.fixture(autouse=True)
def from_rest(pad):
    pad.reset()


def stiffness_at_state(simulation):
    return 1.0 / apparent_compliance(simulation).compliance[0, 2, 2]


@pytest.mark.sampled
@pytest.mark.parametrize("wanted", [190.0, 250.0])
def test_the_pad_shows_the_wanted_stiffness_and_stays_where_it_is(pad, wanted):
    result = pad.follow(wanted)[-1]
    assert result.status is Status.OK
    assert result.effector_errors[0] < 1e-6
    assert result.effector_stiffness[0, 2] == pytest.approx(wanted, rel=1e-4)
    assert stiffness_at_state(pad) == pytest.approx(wanted, rel=1e-4)
    assert result.stiffness_errors[0] < 1e-4
    assert np.isnan(result.effector_stiffness[0, :2]).all()


def test_a_stiffness_alone_may_be_asked_for(pad):
    result = pad.follow(300.0, moved=NOWHERE)[-1]
    assert result.status is Status.OK and np.isnan(result.effector_errors[0])
    assert stiffness_at_state(pad) == pytest.approx(300.0, rel=1e-4)


def test_an_effector_may_ask_for_its_orientation_too():
    points = changed({"effectors.0.orientation": dict(pointing=[0.0, 0.0, 1.0])})
    simulation = make(points, weight=1.0)
    tip, level = simulation.effector_positions() + WHERE, np.array([[0.0, 0.0, 0.0, 1.0]])
    for _ in range(60):
        result = simulation.step(
            FollowTargets(tip, 0.02, None, level, np.array([[np.nan, np.nan, 250.0]]))
        )
    assert result.status is Status.OK and result.orientation_errors[0] < 1e-3
    assert stiffness_at_state(simulation) == pytest.approx(250.0, rel=1e-3)


def test_what_is_told_of_a_stiffness_is_that_of_the_new_shape(pad):
    """To first order from the last linearization, in a step that goes on moving."""
    for result in pad.follow(250.0, steps=12):
        if result.report.residual < 1e-5:
            told = result.effector_stiffness[0, 2]
            assert told == pytest.approx(stiffness_at_state(pad), rel=2e-2)


def test_a_stiffness_out_of_reach_ends_at_the_nearest_and_is_told(pad):
    result = pad.follow(2000.0)[-1]
    assert result.status is Status.SATURATED
    assert {f"{name}.tension_max" for name in ("east", "north")} <= set(result.report.active_limits)
    nearest = stiffness_at_state(pad)
    assert result.stiffness_errors[0] == pytest.approx(1.0 - nearest / 2000.0, rel=1e-3)
    # No cable that is longer makes it stiffer, but for what a cable gains that holds its length again:
    # at its greatest tension it holds nothing.
    lengths = pad.state.setpoints
    for cable in range(4):
        longer = lengths.copy()
        longer[cable] += 1e-4
        repeat_step(pad, CommandSetpoints(longer, 10.0), 5)
        assert stiffness_at_state(pad) < 1.05 * nearest


@pytest.mark.exhaustive
@pytest.mark.parametrize("wanted", [250.0, 300.0, 330.0])
def test_nothing_goes_to_and_fro_over_500_steps(pad, wanted):
    results = pad.follow(wanted, steps=500)
    efforts = np.array([result.efforts for result in results])
    assert np.ptp(efforts[-300:], axis=0).max() < 1e-5
    assert results[-1].status in (Status.OK, Status.UNREACHABLE)


def test_weights_choose_between_place_and_stiffness():
    """At this place the pad cannot be as stiff: the heavier is met more nearly."""
    missed = []
    for weight in (1e-4, 1.0, 1e4):
        simulation = make(weight=weight, target=[None, None, 330.0])
        tip = simulation.effector_positions()
        result = repeat_step(simulation, FollowTargets(tip + WHERE, 0.02), 80)
        missed.append((result.effector_errors[0], result.stiffness_errors[0]))
    places, stiffnesses = np.array(missed).T
    assert places[0] < places[1] < places[2] and places[0] < 0.05 * places[2]
    assert stiffnesses[0] > stiffnesses[1] > stiffnesses[2]
    assert stiffnesses[2] < 0.05 * stiffnesses[0]


def test_a_stiffness_that_changes_slowly_is_followed_without_jumps(pad):
    pad.follow(200.0, steps=30)
    before, errors, moves = pad.state.efforts, [], []
    for step in range(100):
        wanted = 225.0 + 25.0 * np.sin(0.1 * step - 0.5 * np.pi)
        (result,) = pad.follow(wanted, steps=1)
        errors.append(result.stiffness_errors[0])
        moves.append(np.abs(result.efforts - before).max())
        before = result.efforts
    assert max(errors) < 0.01
    # A tenth of the change of the tension from the softest to the stiffest, in each step.
    assert max(moves) < 0.25


def same_to_the_bit(first, second, steps=10):
    tip = first.effector_positions()
    for step in range(steps):
        target = tip + WHERE * np.sin(0.3 * step)
        one, other = (simulation.step(FollowTargets(target, 0.02)) for simulation in (first, second))
        assert (one.state.positions == other.state.positions).all()
        assert (one.efforts == other.efforts).all()
    return one, other


def test_without_weight_nothing_is_computed_and_nothing_changes():
    plain, unweighed = make(), make(weight=0.0, target=[None, None, 250.0])
    one, other = same_to_the_bit(plain, unweighed)
    assert other.effector_stiffness is None and other.stiffness_errors is None
    assert "stiffness" not in other.report.stage_times
    assert unweighed.stages == plain.stages


def test_without_a_target_nothing_is_computed(pad):
    result = pad.follow(np.nan, steps=1)[0]
    assert "stiffness" not in result.report.stage_times and result.effector_stiffness is None
    assert "stiffness" in pad.follow(250.0, steps=1)[0].report.stage_times


def test_warming_up_runs_what_a_message_may_ask_for(pad, monkeypatch):
    asked, rows = [], StiffnessTargets.rows_of
    monkeypatch.setattr(
        StiffnessTargets, "rows_of", lambda *given: asked.append(given[2]) or rows(*given)
    )
    before = pad.state
    pad.warm_up()
    assert len(asked) >= 2 and np.isfinite(asked[0]).all()
    assert pad.state is before


def test_while_a_finger_holds_a_point_no_stiffness_is_looked_for():
    counteract = changed({"touches.0.while_touched": "follow_targets"})
    pad = make(counteract, weight=1.0, target=[None, None, 250.0])
    tip = pad.effector_positions()
    follow = FollowTargets(tip + WHERE, 0.02)
    assert pad.step(follow).effector_stiffness is not None
    pressed = Touched(NOWHERE, pad.effector_positions() - [[0.0, 0.0, 1e-4]])
    result = pad.step(follow, measured=pressed)
    assert result.effector_stiffness is None and not result.status.is_failure
    weight = Touched(np.array([[0.0, 0.0, -0.02]]), NOWHERE)
    result = repeat_step(pad, follow, 40, measured=weight)
    assert result.effector_stiffness[0, 2] == pytest.approx(250.0, rel=1e-3)
    assert result.effector_errors[0] < 1e-5


def test_other_commands_ask_for_no_stiffness(pad):
    result = pad.step(CommandSetpoints(pad.rest_setpoints, 0.02))
    assert result.effector_stiffness is None


@pytest.mark.parametrize("wanted, why", [
    (np.array([[np.nan, np.nan, -3.0]]), "-3.0 N/m is not a positive stiffness"),
    (np.array([[np.nan, np.nan, 0.0]]), "0.0 N/m is not a positive stiffness"),
    (np.array([[np.nan, np.nan, np.inf]]), "inf"),
    (np.array([300.0]), "must have shape"),
])  # fmt: skip
def test_a_bad_stiffness_is_refused_and_the_state_kept(pad, wanted, why):
    state = pad.state
    with pytest.raises(CommandError, match=why):
        pad.step(FollowTargets(pad.effector_positions(), 0.02, stiffness=wanted))
    assert pad.state is state


def test_a_stiffness_of_an_effector_that_asks_for_none_is_refused():
    simulation = make()
    with pytest.raises(CommandError, match="tip.*asks for no stiffness"):
        simulation.step(FollowTargets(NOWHERE, 0.02, stiffness=np.full((1, 3), 300.0)))
