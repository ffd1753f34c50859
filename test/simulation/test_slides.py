"""Slides: a platform as an actuator, with all attached bodies."""

import copy
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from softrobot_twin.errors import SceneError
from softrobot_twin.simulation import CommandSetpoints, FollowTargets, Hold, Status
from softrobot_twin.simulation.step.share_rule import Move
from softrobot_twin.simulation.step.time_budget import StageClock
from test.builder import builder
from test.scene_changes import LEFT_OUT, change_scene, changed, repeat_step, solved

AXIS = np.array([0.6, 0.0, 0.8])
SLIDE = {"name": "lift", "body": "cart", "axis": AXIS.tolist(), "travel": [-0.01, 0.03], "rate": 0.05}
CART = {"name": "cart", "motion": "guided", "box": {"size": [0.04, 0.04, 0.01]}, "position": [0.01, 0.01, -0.005]}
FOOT = {"minimum": [-1, -1, -1e-6], "maximum": [1, 1, 1e-6]}
FAR = np.array([[0.3, 0.01, 0.5]])


@builder
def sliding(beam, /, change=None):
    """Makes the beam on a cart that slides; a function may change its scene further."""

    def add(mapping):
        del mapping["body"]["fixed"]
        mapping["body"]["attached"] = [{"to": "cart", "box": FOOT}]
        mapping["rigid_bodies"] = [copy.deepcopy(CART)]
        mapping["slides"] = [copy.deepcopy(SLIDE)]
        for cable in mapping["cables"]:
            cable["pull_point_on"] = "cart"
        change_scene(mapping, change)

    return beam(add)


def slid_to(simulation, position, steps=20, time_step=1.0):
    lengths = simulation.state.setpoints.copy()
    lengths[-1] = position
    return repeat_step(simulation, CommandSetpoints(lengths, time_step), steps)


def in_way(mapping, rod):
    rod(mapping, x=0.03, z=0.08)


def test_two_slides_of_one_body_are_refused(sliding):
    with pytest.raises(SceneError, match="moves cart, which another slide moves"):
        sliding(lambda mapping: mapping["slides"].append({**SLIDE, "name": "other", "axis": [0, 1, 0]}))


def test_a_slide_moves_all_attached_bodies_by_the_same_displacement(sliding):
    simulation = sliding()
    wound = simulation.rest_setpoints - [0.004, 0.002, 0.0, 0.0, 0.0]
    for _ in range(20):
        before = simulation.step(CommandSetpoints(wound, 1.0)).state.positions
    result = slid_to(simulation, 0.02)
    moved = result.state.positions - before
    np.testing.assert_allclose(moved, np.tile(0.02 * AXIS, (len(moved), 1)), atol=1e-9)
    assert result.setpoints[-1] == pytest.approx(0.02, abs=1e-12)
    np.testing.assert_allclose(result.efforts[:4], simulation.step(Hold(1.0)).efforts[:4])


def test_its_columns_are_the_finite_differences_of_effectors_and_gaps(sliding, rod):
    simulation = sliding(lambda m: in_way(m, rod))
    simulation.step(FollowTargets(simulation.effector_positions() + [0.006, 0.0, -0.003], 1.0))
    model, x = simulation.model, simulation.state.positions
    slides, effectors, contacts = model.slides, model.effectors, model.contacts
    contacts.detect(x)
    assert contacts.count > 0
    G_e, G_c, step = slides.effector_columns(effectors), slides.contact_columns(contacts), 1e-6
    moved = [x.copy(), x.copy()]
    for positions, way in zip(moved, (step, -step), strict=True):
        slides.shift(positions, np.array([way]))
    tips = [effectors.positions(positions).ravel() for positions in moved]
    gaps = [contacts.gaps(positions) for positions in moved]
    np.testing.assert_allclose(G_e[:, 0], (tips[0] - tips[1]) / (2 * step), atol=1e-9)
    np.testing.assert_allclose(G_c[:, 0], (gaps[0] - gaps[1]) / (2 * step), atol=1e-9)
    assert np.abs(G_c).max() > 0.3


def test_the_condensed_system_moves_by_its_displacement_as_all_rows_do(sliding, rod):
    simulation = sliding(lambda m: in_way(m, rod))
    simulation.step(FollowTargets(simulation.effector_positions() + [0.006, 0.0, -0.003], 1.0))
    model, x = simulation.model, simulation.state.positions.copy()
    linear = simulation.newton.linearize(x, simulation.state.efforts, StageClock())
    assert linear.groups.actuators == slice(0, 5) and linear.contact_row_count > 0
    values, step = [], 1e-6
    for way in (step, -step):
        moved = x.copy()
        # A displacement is against the axis, as a shortening.
        model.slides.shift(moved, np.array([-way]))
        model.rows.evaluate(moved)
        own = model.rows.groups.actuators.stop
        values.append(np.insert(model.rows.values, own, -model.slides.positions(moved)))
    column = (values[0] - values[1]) / (2 * step)
    np.testing.assert_allclose(linear.W[:, 4], column, atol=1e-8)
    np.testing.assert_array_equal(linear.W[4], np.arange(len(column)) == 4)


def test_its_travel_and_rate_limits_are_kept_and_reported(sliding):
    simulation = sliding()
    before, seen = 0.0, set()
    for _ in range(60):
        result = simulation.step(FollowTargets(FAR, 0.02))
        position = result.setpoints[-1]
        assert abs(position - before) <= 0.05 * 0.02 + 1e-12
        assert -0.01 - 1e-12 <= position <= 0.03 + 1e-12
        before = position
        seen |= {name for name in result.report.active_limits if name.startswith("lift")}
    assert position == pytest.approx(0.03, abs=1e-9)
    assert result.status is Status.SATURATED
    # Positive moves are negative shortenings: the end of the travel is the least shortening.
    assert seen == {"lift.rate", "lift.shortening_min"}


def test_a_target_that_the_slide_reaches_needs_no_cable(sliding):
    simulation = sliding()
    target = simulation.effector_positions() + 0.015 * AXIS
    result = solved(simulation, FollowTargets(target, 0.05), 60)
    assert result.setpoints[-1] == pytest.approx(0.015, abs=2e-4)
    assert result.efforts[:4].max() < 0.2


def test_given_lengths_move_it_at_its_rate_up_to_its_travel(sliding):
    simulation = sliding()
    for step in range(1, 11):
        result = slid_to(simulation, 1.0, 1, 0.02)
        assert result.setpoints[-1] == pytest.approx(min(step * 1e-3, 0.03), abs=1e-12)
    result = slid_to(simulation, 1.0, 40, 0.05)
    assert result.setpoints[-1] == pytest.approx(0.03, abs=1e-12)
    assert result.status is Status.SATURATED


def test_its_load_is_the_weight_and_contact_force_along_it(sliding, rod):
    simulation = sliding(changed({"gravity": [1.0, 0.0, -9.81]}, lambda m: in_way(m, rod)))
    target = simulation.effector_positions() + [0.03, 0.0, 0.0]
    result = repeat_step(simulation, FollowTargets(target, 0.05), 60)
    assert len(result.contacts.forces)
    weight = 1000.0 * 0.02 * 0.02 * 0.1 * np.array([1.0, 0.0, -9.81])
    outer = weight + result.contacts.forces.sum(axis=0)
    assert result.efforts[-1] == pytest.approx(-outer @ AXIS, rel=1e-6)


def test_it_may_be_commanded_while_the_cables_are_optimised(sliding, rod):
    simulation = sliding(lambda m: in_way(m, rod))
    target = simulation.effector_positions() + [0.004, 0.0, -0.006]
    commanded = np.full(5, np.nan)
    for position in np.linspace(0.0, -0.005, 20):
        commanded[-1] = position
        result = simulation.step(FollowTargets(target, 0.05, commanded))
        assert result.setpoints[-1] == pytest.approx(position, abs=1e-12)
        assert "lift.rate" not in result.report.active_limits
    result = repeat_step(simulation, FollowTargets(target, 0.05, commanded), 20)
    assert result.effector_errors[0] < 5e-3


def test_reset_and_restore_give_the_same_run_to_the_bit(sliding, rod):
    simulation = sliding(lambda m: in_way(m, rod))
    targets = [simulation.effector_positions() + [0.02 * k / 20, 0.0, 0.01] for k in range(20)]
    runs = []
    for _ in range(2):
        simulation.reset()
        runs.append([simulation.step(FollowTargets(t, 0.05)) for t in targets])
    for one, two in zip(*runs, strict=True):
        np.testing.assert_array_equal(one.state.positions, two.state.positions)
        np.testing.assert_array_equal(one.setpoints, two.setpoints)
    state = simulation.state
    after = []
    for _ in range(2):
        simulation.restore(state)
        after.append(simulation.step(FollowTargets(targets[0], 0.05)).state.positions)
    np.testing.assert_array_equal(*after)
    simulation.reset()
    assert simulation.state.setpoints[-1] == 0.0


far_and_fast = changed({"slides.0.travel": [-0.1, 0.1], "slides.0.rate": LEFT_OUT})


without_cables = changed(far_and_fast, {
    "cables": LEFT_OUT, "effectors": LEFT_OUT, "gravity": [3.0, -2.0, -9.81],
    "solver.newton_iterations": 1,
})  # fmt: skip


def curled(simulation, radius):
    """Positions of the beam, bent to an arc of a circle [m]."""
    x = simulation.model.nodes.rest_positions.copy()
    height, out = np.maximum(x[:, 2], 0.0), radius - x[:, 0]
    x[:, 0] = radius - out * np.cos(height / radius)
    x[:, 2] = np.where(x[:, 2] > 0.0, out * np.sin(height / radius), x[:, 2])
    return x


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_seen_from_the_base_no_step_raises_the_energy_however_the_slide_moves(
    sliding, energies, monkeypatch, seed
):
    print(f"seed {seed}")
    random, simulation = np.random.default_rng(seed), sliding(without_cables)
    slides, shares, make = simulation.model.slides, [], Move.make
    monkeypatch.setattr(Move, "make", lambda move, at, share: (shares.append(share), make(move, at, share)))
    simulation.restore(replace(simulation.state, positions=curled(simulation, 0.05)))

    def energy(positions):
        state = replace(simulation.state, positions=positions)
        return energies(SimpleNamespace(model=simulation.model, state=state))[0]

    first = energy(simulation.state.positions)
    for position in random.uniform(-0.1, 0.1, 30):
        carried = simulation.state.positions.copy()
        slides.shift(carried, position - slides.positions(carried))
        result = simulation.step(CommandSetpoints(np.array([position]), 0.02))
        assert slides.positions(result.state.positions)[0] == pytest.approx(position, abs=1e-12)
        after, before = energy(result.state.positions), energy(carried)
        assert after <= before + 1e-9 * first
    assert result.report.residual < 1e-9
    assert min(shares) < 1.0


@pytest.mark.parametrize("jump", [0.002, 0.069])
def test_a_jump_of_the_slide_changes_nothing_seen_from_it(sliding, jump):
    """Also where moves are shortened: cables are wound at once, far beyond one linearization.
    """
    standing, moved = sliding(far_and_fast), sliding(far_and_fast)
    wound = standing.rest_setpoints - [0.03, 0.0, 0.0, 0.01, 0.0]
    for _ in range(30):
        there = standing.step(CommandSetpoints(wound, 1.0))
        here = moved.step(CommandSetpoints(wound + [0.0, 0.0, 0.0, 0.0, jump], 1.0))
        np.testing.assert_allclose(here.state.positions, there.state.positions + jump * AXIS, atol=1e-8)
    assert here.status is there.status and here.report.residual < 1e-9


def test_a_jump_of_the_slide_against_a_rod_settles_where_small_steps_lead(sliding, rod):
    change = changed(far_and_fast, lambda m: rod(m, x=0.065, z=0.08))
    fast, slow = sliding(change), sliding(change)
    result = slid_to(fast, 0.069, 40)
    assert result.status is Status.OK and result.report.contact_count > 0
    for position in np.linspace(0.0, 0.069, 70):
        slid_to(slow, position, 1)
    end = slid_to(slow, 0.069, 40)
    np.testing.assert_allclose(result.state.positions, end.state.positions, atol=1e-6)


def test_the_work_of_forces_along_a_move_is_the_change_of_energy_by_finite_differences(
    sliding, rod, energies
):
    simulation = sliding(changed(lambda m: in_way(m, rod), {"solver.newton_iterations": 1}))
    for position in np.linspace(0.0, 0.02, 21):
        result = slid_to(simulation, position, 1)
    assert result.report.contact_count > 0
    newton, move, model = simulation.newton, simulation.newton.move, simulation.model
    before = move.start.copy()
    move.take_back(before)
    slid = model.slides.positions(move.start) - model.slides.positions(before)
    assert newton.share_rule.is_judging and slid == pytest.approx(1e-3)

    def energy(share):
        at = move.start.copy()
        move.make(at, share)
        state = replace(simulation.state, positions=at)
        return energies(SimpleNamespace(model=model, state=state))[0]

    slope = (energy(1e-4) - energy(-1e-4)) / 2e-4
    newton.balance.gather_forces(move.start)
    assert newton.share_rule.work() == pytest.approx(-slope, rel=1e-5)
