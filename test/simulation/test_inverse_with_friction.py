"""Facts of targets where contacts stick and slip: a finger on a rod, and a beam beside one."""

from pathlib import Path
from time import perf_counter

import numpy as np
import pytest
import yaml

from softrobot_twin.constraints.cable_friction import FrictionCables
from softrobot_twin.scene.loading import written_out
from softrobot_twin.simulation import CommandSetpoints, FollowTargets, Simulation, Status
from softrobot_twin.simulation.step.inverse_with_friction import tied_by_contacts
from softrobot_twin.simulation.step.time_budget import StageClock
from softrobot_twin.solvers.inverse_problem import Bounds
from test.builder import builder
from test.edge_of_touch import check_rest_at_the_edge
from test.grasped_cube import hand, lifted
from test.scene_changes import LEFT_OUT, built, entries_of, repeat_step, solved

FINGER = Path(__file__).resolve().parents[2] / "config" / "scenes" / "finger.yaml"
OCTOLEG, TRUNK = FINGER.with_name("octoleg.yaml"), FINGER.with_name("trunk_cylinders.yaml")
FINRAY = FINGER.with_name("finray.yaml")
TICK, MU = 0.05, 0.5
BENT = np.array([0.009, -0.006])
CABLE_MU = 0.3
RUBBING = {"cables.*.friction": CABLE_MU}


@pytest.fixture
def rng(drawn_rng):
    return drawn_rng


@builder
def finger(friction=MU, *changes) -> Simulation:
    """A finger of 100 mm with two cables, whose middle is pulled onto a rod below it."""
    mapping = written_out(yaml.safe_load(FINGER.read_text()))
    mapping["body"] |= {
        "mesh": {"box": {"size": [0.1, 0.018, 0.018], "cells": [14, 3, 3]},
                 "translation": [0.0, -0.009, -0.009]},
        "element": "linear",
        "fixed": [{"box": {"minimum": [-0.001, -0.02, -0.02], "maximum": [0.001, 0.02, 0.02]}}],
    }  # fmt: skip
    mapping["body"]["material"]["young_modulus"] = 150e3
    del mapping["markers"], mapping["effectors"][0]["measured_by"]
    rod = {"ends": [[0.055, -0.05, -0.020], [0.055, 0.05, -0.020]], "radius": 0.010}
    mapping["obstacles"] = [{"name": "rod", "cylinder": rod}]
    mapping["contact"] = {
        "friction": friction, "alarm_distance": 0.003, "between": [{"pair": ["body", "rod"]}],
    }  # fmt: skip
    return built(mapping, *changes, path=FINGER)


def pull(simulation, shortenings, longest=1e-3):
    """Shortens the cables at once, in steps of no more than a length."""
    begin = simulation.rest_setpoints - simulation.state.setpoints
    count = int(np.ceil(np.abs(shortenings - begin).max() / longest))
    for share in np.linspace(0.0, 1.0, count + 1)[1:]:
        at = simulation.rest_setpoints - begin - share * (shortenings - begin)
        simulation.step(CommandSetpoints(at, TICK))
    return repeat_step(simulation, CommandSetpoints(at, TICK), 3)


def follow(simulation, target, steps):
    return repeat_step(simulation, FollowTargets(np.atleast_2d(target), TICK), steps)


def check_cone(simulation, friction):
    """No contact bears more along its surface than its friction allows; gives what each presses with."""
    forces = simulation.model.contacts.last_multipliers.reshape(-1, 3)
    along = np.linalg.norm(forces[:, 1:], axis=1)
    assert (along <= friction * forces[:, 0] * (1.0 + 1e-6) + 1e-9).all()
    return forces[:, 0]


def capstan_shares(simulation):
    """ln(T_before / T_behind) / µβ of each point of each cable: 1 or -1 where it slips."""
    (term,) = (term for term in simulation.terms if isinstance(term, FrictionCables))
    same = np.flatnonzero(np.diff(term.cable_of_stretch) == 0)
    taut = same[term.tensions[same] > 0.0]
    ratios = np.log(term.tensions[taut] / term.tensions[taut + 1])
    return ratios / (CABLE_MU * term.angles[taut + 1])


def test_places_that_lengths_lead_to_are_reached_in_contact(finger, rng):
    near = missed_in_contact(finger(), rng, -0.8, 40)
    assert near.max() < 1e-4
    assert np.mean(near < 2e-5) >= 0.5


def missed_in_contact(simulation, rng, released, steps):
    """How far the tip stays from four places where pulls lead it, released by a share of them [m]."""
    pull(simulation, BENT)
    start, near = simulation.state, []
    for bend in rng.uniform(0.011, 0.016, 4):
        simulation.restore(start)
        reached = pull(simulation, bend * np.array([1.0, released]))
        assert reached.report.contact_count
        simulation.restore(start)
        near.append(follow(simulation, reached.effector_positions, steps).effector_errors[0])
    print(f"{1e3 * np.sort(near)} mm")
    return np.array(near)


ROD = {"rigid_bodies": [{
    "name": "rod", "motion": "guided", "position": [0.055, 0.0, -0.02],
    "cylinder": {"ends": [[0.0, -0.05, 0.0], [0.0, 0.05, 0.0]], "radius": 0.01},
}], "obstacles": LEFT_OUT}  # fmt: skip
MIDDLE = {"name": "middle", "points": [[0.08, 0.0, 0.0]], "directions": ["z"]}
TURN = {
    "effectors.0.orientation": {"pointing": [1.0, 0.0, 0.0]}, "effectors.0.directions": ["x"],
    "effectors.0.points": [[0.1, -0.009, -0.009], [0.1, 0.009, -0.009], [0.1, 0.0, 0.009]],
}  # fmt: skip


@pytest.mark.sampled
@pytest.mark.parametrize("change", [
    ROD, lambda mapping: mapping["effectors"].append(MIDDLE), TURN, {"contact.force_limit": 1.0},
], ids=["guided rod", "two effectors", "orientation", "force limit"])  # fmt: skip
def test_all_that_targets_may_ask_for_is_asked_with_friction(finger, change):
    simulation = finger(MU, change)
    pull(simulation, BENT)
    start = simulation.state
    for bend in (0.0116, 0.0121, 0.0130):
        simulation.restore(start)
        reached = pull(simulation, np.array([bend, -0.8 * bend]))
        simulation.restore(start)
        targets = FollowTargets(
            reached.effector_positions, TICK, None, reached.effector_orientations,
        )
        result = solved(simulation, targets, 40)
        assert result.report.contact_count
        assert np.nanmax(result.effector_errors) < 2e-5
        if result.orientation_errors is not None:
            assert result.orientation_errors[0] < 1e-3


def test_forces_of_contacts_that_rub_are_kept_to_their_limit(finger):
    limit = 0.2
    simulation = finger(MU, {"contact.force_limit": limit})
    for target in ([0.086, 0.0, -0.02], [0.09, 0.0, -0.04], [0.1, 0.0, 0.0]):
        result = follow(simulation, target, 60)
        forces = simulation.model.contacts.last_multipliers[::3]
        assert forces.max(initial=0.0) < 1.05 * limit
        if forces.max(initial=0.0) > 0.999 * limit:
            assert any("body.rod.force_limit" in name for name in result.report.active_limits)


def test_a_place_on_the_way_back_is_reached_by_a_detour(finger):
    """Straight to the same lengths, the tip ends 0.4 mm beside it; the cable is pulled further first."""
    simulation = finger()
    pull(simulation, BENT)
    start, lengths = simulation.state, np.array([0.0101, -0.0073])
    straight = pull(simulation, lengths).effector_positions[0]
    simulation.restore(start)
    pull(simulation, np.array([0.0165, -0.0146]))
    target = pull(simulation, lengths).effector_positions[0]
    assert np.linalg.norm(target - straight) > 2e-4
    simulation.restore(start)
    furthest = 0.0
    for _ in range(100):
        result = follow(simulation, target, 1)
        furthest = max(furthest, (simulation.rest_setpoints - result.setpoints)[0])
    assert result.status is Status.OK and result.effector_errors[0] < 1e-5
    assert furthest > (simulation.rest_setpoints - result.setpoints)[0] + 1e-3


@pytest.mark.exhaustive
@pytest.mark.parametrize("breaks", [True, False])
def test_contacts_are_broken_and_made_by_no_more_force_than_it_takes(finger, rng, breaks):
    """Towards places that lengths lead to: off the rod from a finger that presses on it, and onto it.

    Off the rod about one of 130 is never left for: far away, by a cable that has to be wound in first.
    """
    simulation, near = finger(), []
    pull(simulation, np.array([0.012, -0.009] if breaks else [-0.006, 0.009]))
    start = simulation.state
    while len(near) < 40:
        simulation.restore(start)
        reached = pull(simulation, rng.uniform([-0.006, -0.014], [0.019, 0.015]))
        pressed, tension = reached.contacts.forces[:, 2].sum(), reached.efforts.sum()
        if not 0.05 < tension < 12.0 or (pressed > 0.0 if breaks else pressed < 0.1):
            continue
        simulation.restore(start)
        result = follow(simulation, reached.effector_positions, 150)
        near.append(result.effector_errors[0])
        if near[-1] < 1e-4:
            assert result.efforts.sum() < 1.1 * tension
            assert result.contacts.forces[:, 2].sum() < 1.3 * pressed + 0.1 * tension
    print(f"{1e3 * np.sort(near)[-5:]} mm")
    near.sort()
    if breaks:
        assert near[-2] < 1e-5
    else:
        assert near[-1] < 1e-3 and np.mean(np.array(near) < 1e-4) >= 0.8


@pytest.mark.exhaustive
def test_of_60_places_in_contact_nearly_all_are_reached(finger, rng):
    def ends():
        end = rng.uniform(0.006, 0.019)
        return np.array([[end, -0.8 * end + rng.uniform(-0.002, 0.002)]])

    assert missed_places(finger(), ends, 60).max() < 1e-4


@pytest.mark.exhaustive
def test_of_25_places_that_random_pulls_of_both_cables_lead_to_nearly_all_are_reached(finger, rng):
    missed_places(finger(), lambda: rng.uniform([0.004, -0.015], [0.019, 0.01], (rng.integers(2, 6), 2)), 25)


def missed_places(simulation, ends, count):
    """How far the tip stays from places where pulls press it onto the rod, ascending [m]."""
    pull(simulation, BENT)
    start, near = simulation.state, []
    while len(near) < count:
        simulation.restore(start)
        for end in ends():
            reached = pull(simulation, end)
        if reached.contacts.forces[:, 2].sum() > 0.1 and reached.efforts.max() < 14.0:
            simulation.restore(start)
            near.append(follow(simulation, reached.effector_positions, 150).effector_errors[0])
    near = np.sort(near)
    print(f"{1e3 * near[-10:]} mm")
    assert np.mean(near < 5e-4) >= 0.9 and np.mean(near < 1e-4) >= 0.8
    return near


@pytest.mark.exhaustive
def test_with_hardly_any_friction_it_goes_as_near_as_without(finger, rng):
    """Where targets are out of reach, lengths rest within some 1e-5 m along which the miss is even.

    Each begins at rest: what was tried towards a target out of reach decides where the next one is left.
    """
    smooth, rough = finger(0.0), finger(1e-9)
    for _ in range(3):
        smooth.reset()
        rough.reset()
        target = [0.1 - rng.uniform(0.001, 0.02), 0.0, -rng.uniform(0.0, 0.03)]
        ends = [follow(one, target, 80) for one in (smooth, rough)]
        misses = [end.effector_errors[0] for end in ends]
        assert misses[0] == pytest.approx(misses[1], abs=1e-6)
        if max(misses) < 1e-6:
            np.testing.assert_allclose(*[end.effector_positions[0, [0, 2]] for end in ends], atol=1e-6)


def test_what_contacts_do_tells_how_effectors_follow_lengths(finger):
    """Finite differences of the solution with friction, in one linearization."""
    simulation = finger()
    pull(simulation, np.array([0.012, -0.006]))
    pull(simulation, np.array([0.0125, 0.0085]))
    model, state, direct = simulation.model, simulation.state, simulation.direct
    simulation.newton.begin_step(state.positions, state.velocities, TICK)
    model.contacts.begin_step(state.positions, state.velocities, TICK)
    linear = simulation.newton.linearize(
        state.positions.copy(), state.efforts, StageClock(perf_counter)
    )
    bounds = Bounds(*np.array([[-1.0, -1.0], [1.0, 1.0], [0.0, 0.0], [40.0, 40.0]]))
    ahead = -state.setpoints + simulation.rest_setpoints + [2e-4, 3e-4]

    def at(drives):
        found = direct.at_drives(linear, drives, bounds)
        return found, linear.effector_places(found.efforts, found.contact.multipliers)

    found, _ = at(ahead)
    assert (found.efforts > 0.0).all()
    forces = found.contact.multipliers.reshape(-1, 3)
    used = np.linalg.norm(forces[:, 1:], axis=1) / np.maximum(MU * forces[:, 0], 1e-12)
    assert (used[forces[:, 0] > 0.0] < 0.999).any() or (used > 0.999).any()
    tied = tied_by_contacts(linear, model.contacts, found)
    e, pressing = tied.groups.effectors, np.flatnonzero(forces[:, 0] > 0.0)
    # Contacts that press are closed wholly, not only to the tolerance of the solution.
    gaps = tied.W[:, tied.W.shape[1] - len(forces):] @ forces[:, 0] + tied.W[:, :2] @ found.efforts
    gaps = (gaps + tied.violation)[tied.groups.contacts][pressing]
    np.testing.assert_allclose(gaps, 0.0, atol=1e-14)
    kept = np.concatenate([np.arange(2), tied.groups.contacts.start + pressing])
    by_paths = tied.W[e][:, kept] @ np.linalg.inv(tied.W[np.ix_(kept, kept)])[:, :2]
    step = 1e-7
    differences = [
        (at(ahead + way)[1] - at(ahead - way)[1]) / (2 * step) for way in step * np.eye(2)
    ]
    np.testing.assert_allclose(by_paths.T, differences, rtol=1e-3, atol=1e-3)
    closed = tied_by_contacts(linear, model.contacts, found, closes=True)
    by_paths = closed.W_ea @ np.linalg.inv(closed.W_aa)
    np.testing.assert_allclose(by_paths.T, differences, rtol=1e-3, atol=1e-3)
    places, efforts = linear.effector_places(found.efforts, found.contact.multipliers), found.efforts
    np.testing.assert_allclose(closed.W_ea @ efforts + closed.effectors, places, atol=1e-8)


# The second is held by six contacts that stick, whose gaps depend on each other.
@pytest.mark.sampled
@pytest.mark.parametrize("shortenings, change", [
    ((0.0125, -0.01), None), ((0.01539, -0.01093), None), ((0.0125, -0.01), RUBBING),
])  # fmt: skip
def test_at_a_reached_target_lengths_rest(finger, shortenings, change):
    simulation = finger(MU, change)
    pull(simulation, BENT)
    start = simulation.state
    target = pull(simulation, np.array(shortenings)).effector_positions
    simulation.restore(start)
    before = follow(simulation, target, 150).setpoints
    for _ in range(100):
        result = follow(simulation, target, 1)
        assert result.status is Status.OK and result.report.contact_count
        np.testing.assert_allclose(result.setpoints, before, atol=1e-6 * 0.1)
        before = result.setpoints


FRICTIONS = [(MU, None), (10.0, None), (0.0, RUBBING), (MU, RUBBING)]


@pytest.mark.parametrize("ticks, friction, change", [
    *((100, *case) for case in FRICTIONS),
    pytest.param(4_000, *FRICTIONS[3], marks=pytest.mark.exhaustive),
])  # fmt: skip
def test_no_tick_leaves_rates_lengths_tensions_and_the_cone(finger, rng, ticks, friction, change):
    """Row 30; targets jump anywhere, rest, or are those of another robot's state."""
    simulation = finger(friction, change)
    limits = simulation.limits
    pull(simulation, BENT)
    start, target = simulation.state, simulation.effector_positions()
    for tick in range(ticks):
        way = rng.normal(size=(1, 3)) * rng.choice([0.0, 1e-4, 1e-3, 0.1])
        target = (target if rng.random() < 0.5 else simulation.effector_positions()) + way
        if tick % 500 == 499:
            simulation.restore(start)
            target = simulation.effector_positions()
        duration = rng.choice([0.0, 1e-3, 0.02, 0.1])
        before = simulation.state.setpoints
        result = simulation.step(FollowTargets(target, duration))
        after = result.setpoints
        assert not result.status.is_failure
        assert np.isfinite(after).all() and np.isfinite(result.state.positions).all()
        drives = simulation.rest_setpoints - after
        assert (drives >= limits.displacement_min - 1e-12).all()
        assert (drives <= limits.displacement_max + 1e-12).all()
        assert (np.abs(after - before) <= limits.rate * duration + 1e-12).all()
        assert (result.efforts >= limits.effort_min).all()
        assert (result.efforts <= limits.effort_max * (1.0 + 1e-9)).all()
        if friction:
            check_cone(simulation, friction)
        if change:
            assert (np.abs(capstan_shares(simulation)) <= 1.0 + 1e-6).all()


def test_pulled_and_released_both_the_cone_and_the_capstan_law_hold(finger):
    """A cable that rubs bends a finger around a rod that rubs; each step is in balance."""
    simulation = finger(MU, RUBBING, {"solver.newton_iterations": 60, "solver.residual_tolerance": 1e-8})
    slipping = []
    for bend in np.concatenate([np.linspace(0.001, 0.014, 14), np.linspace(0.013, 0.006, 8)]):
        lengths = simulation.rest_setpoints - bend * np.array([1.0, -0.8])
        assert simulation.step(CommandSetpoints(lengths, TICK)).status is Status.OK
        pressing, shares = check_cone(simulation, MU), capstan_shares(simulation)
        assert (np.abs(shares) <= 1.0 + 1e-6).all()
        slipping.append(shares[:5].mean() if pressing.any() else 0.0)
    assert slipping[13] == pytest.approx(1.0, abs=1e-6)
    assert slipping[18] == pytest.approx(-1.0, abs=1e-6)


@pytest.mark.sampled
@pytest.mark.parametrize("friction", [0.0, MU])
def test_with_hardly_any_friction_along_cables_targets_are_reached_as_without(finger, friction):
    smooth, rough = finger(friction), finger(friction, {"cables.*.friction": 1e-9})
    for shortenings in ((0.0125, -0.01), (0.0145, -0.0115)):
        ends = []
        for simulation in (smooth, rough):
            simulation.reset()
            pull(simulation, BENT)
            start = simulation.state
            target = pull(simulation, np.array(shortenings)).effector_positions
            simulation.restore(start)
            ends.append(follow(simulation, target, 60))
        assert ends[0].report.contact_count
        np.testing.assert_allclose(*[end.setpoints for end in ends], atol=1e-6)
        np.testing.assert_allclose(*[end.effector_positions for end in ends], atol=1e-6)


@pytest.mark.sampled
@pytest.mark.parametrize("friction", [0.0, MU])
def test_places_are_reached_though_cables_and_contacts_rub(finger, rng, friction):
    """A cable that is slack at its target cannot help: then the place depends on the way there."""
    assert missed_in_contact(finger(friction, RUBBING), rng, -0.3, 60).max() < 1e-4


@pytest.mark.exhaustive
def test_fingers_whose_cables_rub_lead_a_cube_in_the_hand():
    mapping = hand()
    mapping["cables"][0]["friction"] = 0.1
    simulation = lifted(mapping, 0.018, 60)
    start = simulation.state
    for axis in range(3):
        simulation.restore(start)
        goal = simulation.effector_positions() + 1e-3 * np.eye(3)[axis]
        result = repeat_step(simulation, FollowTargets(goal, 0.02), 100)
        assert result.status.is_success and result.effector_errors[0] < 1e-6
        check_cone(simulation, 0.7)


def test_at_the_edge_of_touch_lengths_and_forces_rest(beam, rod):
    """Row 32: the target is where touch begins, and some nanometres to either side."""
    simulation = beam(lambda m: rod(m, friction=MU))
    check_rest_at_the_edge(simulation, settling=60, still=1e-7, pressed=1e-4, near=1e-4)


def test_redundant_lengths_rest_on_a_reached_target(eight, rod, rng):
    """Row 44: eight cables, one wanted direction, in touch."""
    simulation = eight(("x",), lambda m: rod(m, friction=0.3))
    for _ in range(3):
        reached = pull(simulation, np.append(rng.uniform([0.012, 0, 0, 0], [0.016, 0.003, 0, 0.003]), [0, 0, 0, 0]))
        target = reached.effector_positions[0]
        simulation.reset()
        before = follow(simulation, target, 300).setpoints
        for _ in range(20):
            result = follow(simulation, target, 1)
            assert result.status is Status.OK
            np.testing.assert_allclose(result.setpoints, before, atol=1e-6 * 0.1)
            before = result.setpoints


def lag(robot, leader, lengths):
    """Distances from the targets of a robot that shall be where another one is led to [m]."""
    errors = []
    for setpoints in lengths:
        target = leader.step(CommandSetpoints(leader.rest_setpoints + setpoints, TICK)).effector_positions
        errors.append(robot.step(FollowTargets(target, TICK)).effector_errors[0])
    return np.array(errors)


@pytest.mark.sampled
@pytest.mark.parametrize("iterations", [1, 3])
def test_moving_targets_are_followed_also_where_all_contacts_stick(finger, iterations):
    robot, leader = (finger(MU, {"solver.newton_iterations": iterations}) for _ in range(2))
    pull(robot, BENT)
    pull(leader, BENT)
    bends = 0.0125 - 0.0035 * np.cos(np.arange(180) / 25.0)
    errors = lag(robot, leader, bends[:, None] * [-1.0, 0.8])
    assert np.median(errors) < 5e-5 and errors.max() < 3e-4


@pytest.mark.exhaustive
def test_a_finger_that_rolls_on_a_roller_follows_moving_targets():
    robot, leader = (Simulation.from_scene_file(FINRAY) for _ in range(2))
    errors = lag(robot, leader, 0.15 + 0.12 * np.sin(np.arange(120) / 40.0 - 1.2)[:, None])[5:]
    assert np.median(errors) < 2e-5 and np.quantile(errors, 0.9) < 2e-4


@pytest.mark.parametrize("count", [3, pytest.param(20, marks=pytest.mark.exhaustive)])
def test_a_finger_of_many_contacts_goes_to_any_place_that_it_can_rest_at(rng, count):
    """Up to 91 contacts come and go; targets stay, and rates limit the way. It then rests.

    Each place is found by commands from where the robot is: contacts that stuck on another way
    lead elsewhere, by up to 0.1 mm.
    """
    robot, leader = (Simulation.from_scene_file(FINRAY) for _ in range(2))
    missed, told = [], set()
    for _ in range(count):
        leader.restore(robot.state)
        command = CommandSetpoints(leader.rest_setpoints + rng.uniform(0.02, 0.3), 0.02)
        assert repeat_step(leader, command, 60).status is Status.OK
        results = [follow(robot, leader.effector_positions(), 1) for _ in range(80)]
        missed.append(results[-1].effector_errors[0])
        told |= {result.status for result in results[-20:]}
        assert np.ptp([result.setpoints for result in results[-5:]]) < 1e-6
    print(f"{1e3 * np.array(missed)} mm")
    assert told == {Status.OK} and max(missed) < 2e-5


@pytest.mark.parametrize("friction", [0.2, 1.0])
def test_a_beam_is_led_along_a_rod(beam, rod, friction):
    simulation = beam(lambda m: rod(m, friction=friction))
    for shortenings in ([0.012, 0, 0, 0], [0.015, 0.004, 0, 0], [0.014, 0, 0, 0.003]):
        simulation.reset()
        reached = pull(simulation, np.array(shortenings))
        assert reached.report.contact_count
        simulation.reset()
        result = follow(simulation, reached.effector_positions, 60)
        assert result.effector_errors[0] < 1e-4 and result.report.contact_count


def test_the_octoleg_curls_to_where_its_tip_shall_be():
    """By one cable, hence as near as the way of its contacts leaves it: 0.003 to 0.06 mm, by its speed."""
    simulation = Simulation.from_scene_file(OCTOLEG)
    rest, step = simulation.rest_setpoints, 0.02
    for shortening in np.linspace(0.0, 0.03, 76)[1:]:
        simulation.step(CommandSetpoints(rest - shortening, step))
    curled = repeat_step(simulation, CommandSetpoints(rest - shortening, step), 60)
    target = curled.effector_positions
    assert curled.report.contact_count == 7
    simulation.reset()
    assert np.linalg.norm(simulation.effector_positions() - target) > 0.15
    result = solved(simulation, FollowTargets(target, step), 140)
    assert result.effector_errors[0] < 1e-4
    assert result.report.contact_count == 7


@pytest.mark.exhaustive
@pytest.mark.parametrize("friction, along_cables", [
    (0.5, 0.0), pytest.param(0.1, 0.0, marks=pytest.mark.exhaustive),
    pytest.param(0.5, 0.03, marks=pytest.mark.exhaustive),
])  # fmt: skip
def test_the_trunk_goes_between_cylinders_that_rub(friction, along_cables):
    """Its platform is at its rate on the way in; without friction it lags by up to 1.6 mm in contact.

    With friction of 0.1 along cables, 3 of 16 frictions between 0.46 and 0.54 leave it behind a cylinder.
    """
    simulation = built(entries_of(TRUNK), {"contact.friction": friction, "cables.*.friction": along_cables},
                       path=TRUNK)
    targets = np.loadtxt(TRUNK.parents[1] / "targets" / "trunk_path.csv", delimiter=",", skiprows=1)
    missed = []
    for target in targets[:, 1:]:
        result = simulation.step(FollowTargets(target[None], 0.02))
        if result.report.contact_count:
            missed.append(result.effector_errors[0])
    assert len(missed) > 60 and np.mean(missed) < 6e-4 and max(missed) < 4e-3
    missed = follow(simulation, targets[-1, 1:], 40).effector_errors[0]
    assert missed < 1e-5


def test_a_missed_target_tells_whether_contacts_stick_slip_or_were_lost(finger):
    simulation, told = finger(), set()
    pull(simulation, np.array([0.013, -0.01]))
    touched = simulation.effector_positions()
    for way in ([0.0, 0.0, -0.004], [0.0, 0.0, 0.02], [0.003, 0.0, 0.03]):
        for _ in range(40):
            result = follow(simulation, touched + way, 1)
            own = {name for name in result.report.active_limits if name.startswith("body.rod.")}
            assert not (own and result.status.is_success)
            told |= own
    assert told == {"body.rod.sticks", "body.rod.slips", "body.rod.lost"}
