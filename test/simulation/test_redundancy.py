"""Facts of more actuators than directions, in contact: one answer, the least energy, no jumps."""

import numpy as np
import pytest

from softrobot_twin.simulation import FollowTargets, Status

ALONG_X = ["x"]


def follow(simulation, target, steps=40, time_step=1.0, commanded=None):
    """The result when nothing has moved for three steps, or after so many."""
    still, before = 0, simulation.state.positions
    for _ in range(steps):
        result = simulation.step(FollowTargets(np.atleast_2d(target), time_step, commanded))
        is_still = np.abs(result.state.positions - before).max() < 1e-12
        still, before = still + 1 if is_still else 0, result.state.positions
        if still == 3:
            break
    return result


def energy(simulation) -> float:
    """Energy stored in the body [J]."""
    x = simulation.state.positions
    return sum(t.energy(x) for t in simulation.model.forces)


@pytest.mark.parametrize("way", [[0.006, 0.0, 0.0]])
def test_the_answer_of_eight_cables_for_one_direction_does_not_depend_on_the_past(eight, way):
    answers = []
    for before in ([0.0, 0.0, 0.0], [-0.01, 0.0, 0.0], [0.008, 0.0, 0.0]):
        simulation = eight(ALONG_X)
        home = simulation.effector_positions()[0]
        follow(simulation, home + before)
        answers.append(follow(simulation, home + way, 250))
    for other in answers[1:]:
        np.testing.assert_allclose(other.efforts, answers[0].efforts, atol=1e-4)
        np.testing.assert_allclose(other.setpoints, answers[0].setpoints, atol=1e-6)


def test_eight_cables_for_one_direction_move_smoothly_in_time(eight):
    simulation = eight(ALONG_X)
    home = simulation.effector_positions()[0]
    follow(simulation, home + [0.001, 0.0, 0.0])
    lengths = [follow(simulation, home + [x, 0.0, 0.0], 1, 0.1).setpoints
               for x in np.linspace(0.001, 0.006, 120)]  # fmt: skip
    steps = np.diff(lengths, axis=0)
    assert np.abs(steps).max() < 3e-4
    assert np.abs(np.diff(steps, axis=0)).max() < 3e-5


def test_of_all_efforts_that_hold_the_tip_those_of_least_energy_are_chosen(eight):
    simulation = eight()
    home = simulation.effector_positions()[0]
    target = home + [0.003, 0.001, -0.004]
    result = follow(simulation, target, 60)
    assert result.effector_errors[0] < 2e-5
    # Commanding any cable to another length keeps the tip there at no less energy.
    least, state, compared = energy(simulation), simulation.state, 0
    for cable in range(8):
        for change in (-2e-4, 2e-4):
            simulation.restore(state)
            commanded = np.full(8, np.nan)
            commanded[cable] = result.setpoints[cable] + change
            other = follow(simulation, target, 30, commanded=commanded)
            if other.effector_errors[0] < 3e-5:
                assert energy(simulation) > least * (1 - 2e-3)
                compared += 1
    assert compared >= 4


def test_the_same_cable_twice_shares_its_load_in_contact(beam, rod):
    def double(mapping):
        rod(mapping)
        mapping["cables"].append({**mapping["cables"][0], "name": "east_again"})

    single, twice = beam(rod), beam(double)
    home = single.effector_positions()[0]
    for way in ([0.005, 0.0, -0.004], [0.03, 0.004, -0.012], [0.02, -0.004, -0.008]):
        one, two = (follow(simulation, home + way, 150) for simulation in (single, twice))
        assert two.efforts[0] == pytest.approx(two.efforts[4], abs=1e-3)
        assert two.efforts[[0, 4]].sum() == pytest.approx(one.efforts[0], rel=0.01, abs=0.02)
        np.testing.assert_allclose(two.effector_positions, one.effector_positions, atol=2e-5)


def test_the_error_is_proportional_to_the_energy_weight(beam, rod):
    errors = []
    for weight in (1e-8, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2):
        def weigh(mapping, w=weight):
            rod(mapping)
            mapping["solver"]["energy_weight"] = w

        simulation = beam(weigh)
        home = simulation.effector_positions()[0]
        result = follow(simulation, home + [0.004, 0.001, -0.006])
        assert result.status is not Status.UNSOLVED
        errors.append(result.effector_errors[0])
        print(f"energy weight {weight:g}: tip error {1e6 * errors[-1]:.3f} µm")
    assert errors[1] < 1e-5
    assert errors[3] / errors[2] == pytest.approx(10.0, rel=0.1)
    # The least two weights are far below what the target alone weighs.
    assert errors[0] <= errors[1] + 1e-12 and np.all(np.diff(errors[1:]) > 0.0)


def test_cables_go_slack_and_taut_once_each_turn_without_chatter(beam, rod):
    """Row 10: the tip goes round; every cable is let go and taken up again."""
    simulation = beam(rod)
    home = simulation.effector_positions()[0]
    taut, tensions = [], []
    for angle in np.linspace(0.0, 4 * np.pi, 480):
        target = home + [0.003 * np.cos(angle), 0.003 * np.sin(angle), -0.001]
        result = follow(simulation, target, 1, 0.1)
        tensions.append(result.efforts)
        taut.append(result.efforts > 1e-6)
    tensions, taut = np.array(tensions)[20:], np.array(taut)[20:]
    assert tensions.min() >= 0.0
    assert taut.any(axis=0).all() and not taut.all(axis=0).any()
    switches = np.count_nonzero(np.diff(taut, axis=0), axis=0)
    print("switches", switches)
    assert switches.max() <= 8
    assert np.abs(np.diff(tensions, axis=0)).max() < 0.2


def test_eight_cables_for_one_direction_hold_still_against_the_rod(eight):
    """Row 32: leaning harder gains next to nothing, and the linearized optimum overshoots."""
    simulation = eight(ALONG_X)
    home = simulation.effector_positions()[0]
    lengths = [follow(simulation, home + [0.02, 0.0, 0.0], 1, 0.02).setpoints for _ in range(200)]
    assert np.ptp(lengths[-60:], axis=0).max() < 1e-5


def test_a_robot_that_rests_at_its_target_is_solved_at_every_step(eight):
    """All that the program holds is round-off then."""
    simulation = eight(["z"])
    home = simulation.effector_positions()[0]
    statuses = {follow(simulation, home + [0.0, 0.9, 0.0], 1, 0.02).status for _ in range(100)}
    assert statuses == {Status.OK}
