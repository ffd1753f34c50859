"""A state in balance under an unchanged command is kept, and its steps need not be made."""

from dataclasses import fields

import numpy as np
import pytest

from softrobot_twin.simulation import CommandEfforts, CommandSetpoints, FollowTargets, Hold
from test.scene_changes import repeat_step

STEP = 0.01


def rests(simulation, command=None, most=50):
    """Steps until one need not be made; None where that does not happen."""
    command = Hold(STEP) if command is None else command
    for _ in range(most):
        if (result := simulation.stay(command)) is not None:
            return result
        simulation.step(command)
    return None


def same(first, second):
    """Whether two results are the same to the bit, but for the account of how they were found."""
    pairs = [(getattr(first, field.name), getattr(second, field.name)) for field in fields(first)
             if field.name not in ("report", "state")]  # fmt: skip
    pairs += [(getattr(first.state, field.name), getattr(second.state, field.name))
              for field in fields(first.state)]  # fmt: skip
    return all(np.array_equal(one, other, equal_nan=True) if isinstance(one, np.ndarray)
               else one == other for one, other in pairs)  # fmt: skip


def draw_command(draw, simulation):
    """A command of any kind near the state."""
    kind, count = draw.choice(["hold", "setpoints", "efforts", "targets"]), len(simulation.rest_setpoints)
    if kind == "setpoints":
        return CommandSetpoints(simulation.rest_setpoints - draw.uniform(0.0, 0.01, count), STEP)
    if kind == "efforts":
        return CommandEfforts(simulation.state.efforts * draw.uniform(0.5, 1.5, count), STEP)
    if kind == "targets":
        places = simulation.effector_positions()
        return FollowTargets(places + draw.uniform(-0.005, 0.005, places.shape), STEP)
    return Hold(draw.uniform(0.5, 1.0) * STEP)


def on_free_slide(mapping):
    """Leaves the Trunk its slide, and nothing to touch."""
    for key in ("obstacles", "contact"):
        mapping.pop(key)


@pytest.fixture(params=["diamond", "trunk on a slide"])
def two_alike(request, diamond, coarse_trunk):
    """Two simulations of one scene."""
    if request.param == "diamond":
        return diamond(), diamond()
    return coarse_trunk(on_free_slide), coarse_trunk(on_free_slide)


@pytest.mark.sampled
def test_a_run_with_rests_and_one_that_steps_are_the_same_to_the_bit(two_alike, drawn_rng):
    stepping, resting = two_alike
    for _ in range(12):
        command = draw_command(drawn_rng, stepping)
        most = 250 if isinstance(command, FollowTargets) else 40
        for _ in range(drawn_rng.integers(1, most)):
            stepped, stayed = stepping.step(command), resting.stay(command)
            assert same(stepped, stayed or resting.step(command))
    assert rests(resting).status.is_success


def test_a_step_that_is_not_made_says_so_and_its_time_passes(diamond):
    simulation = diamond()
    result = rests(simulation)
    before = simulation.state
    result = simulation.stay(Hold(STEP))
    assert result.report.is_resting and result.report.iterations == 0
    assert set(result.report.stage_times.values()) == {0.0}
    assert result.state is simulation.state
    assert result.state.step_count == before.step_count + 1
    assert result.state.time == before.time + STEP
    assert not simulation.step(Hold(STEP)).report.is_resting


def test_another_command_a_restored_state_and_a_reset_end_the_rest(diamond):
    simulation = diamond()
    assert rests(simulation)
    pulled = CommandSetpoints(simulation.rest_setpoints - 0.002, STEP)
    assert simulation.stay(pulled) is None
    assert rests(simulation)
    simulation.restore(simulation.state)
    assert simulation.stay(Hold(STEP)) is None
    assert rests(simulation)
    simulation.reset()
    assert simulation.stay(Hold(STEP)) is None
    assert rests(simulation, pulled)
    assert simulation.stay(Hold(STEP)) is None


@pytest.mark.parametrize("away", [0.001, 0.5])
def test_a_robot_that_reached_its_target_or_cannot_come_nearer_rests(diamond, away):
    simulation = diamond()
    command = FollowTargets(simulation.effector_positions() + [[0.0, 0.0, -away]], STEP)
    told = rests(simulation, command, 2000)
    assert told.report.is_resting and told.status.is_success == (away < 0.1)
    assert simulation.step(command).status is told.status
    further = FollowTargets(command.targets + 1e-6, STEP)
    assert simulation.stay(further) is None and not simulation.step(further).report.is_resting


def test_it_is_the_same_how_long_a_step_is_but_for_one_without_time_to_move(diamond):
    simulation = diamond()
    targets = simulation.effector_positions() + 0.001
    for step in range(600):
        command = FollowTargets(targets, STEP, reach_time=STEP * (0.9 + 0.01 * (step % 10)))
        if simulation.stay(command) is not None:
            break
        simulation.step(command)
    assert simulation.stay(FollowTargets(targets, STEP, reach_time=0.3 * STEP)) is not None
    assert simulation.stay(FollowTargets(targets, STEP, reach_time=0.0)) is None


def test_a_robot_that_is_slow_is_not_taken_for_one_at_rest(diamond):
    simulation = diamond()
    command = FollowTargets(simulation.effector_positions() + 0.001, STEP, reach_time=1e-13)
    for _ in range(300):
        assert simulation.stay(command) is None
        simulation.step(command)
    assert 0.0 < np.abs(simulation.state.setpoints - simulation.rest_setpoints).max() < 1e-10


def test_a_kept_state_is_in_balance_to_round_off(diamond):
    simulation = diamond()
    command = CommandSetpoints(simulation.rest_setpoints - [0.008, 0.001, 0.0, 0.004], STEP)
    kept = rests(simulation, command).state
    simulation.may_rest = False
    repeat_step(simulation, command, 100)
    apart = np.abs(simulation.state.positions - kept.positions).max()
    assert apart < 1e-11 * simulation.model.nodes.size


def test_a_body_in_motion_and_one_in_contact_are_never_at_rest(scene_of):
    cube = {"name": "box", "mass": 0.03, "position": [0, 0, 0.02], "box": {"size": [0.04] * 3}}
    simulation = scene_of(
        integration="dynamic", obstacles=[{"name": "floor", "plane": {}}], rigid_bodies=[cube],
        contact={"friction": 0.5, "between": [{"pair": ["box", "floor"]}]},
    )  # fmt: skip
    assert rests(simulation) is None
