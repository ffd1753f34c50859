"""Facts of the trust in linearizations on the way to targets, and of the path of the actuators."""

import numpy as np
import pytest

from softrobot_twin.simulation import FollowTargets, Status
from softrobot_twin.simulation.step.target_trust import (
    ANOTHER_TARGET,
    CALM_STEPS,
    ELSEWHERE,
    FIRST,
    GREATEST,
    LATE,
    LONG_PATIENCE,
    LONGEST_MOVE,
    LONGEST_PATH,
    LOOSER,
    MOST_CAREFUL_STEPS,
    MOST_LOOKS,
    MUCH_SHORTER,
    OTHER_LOADS,
    PATH_SPACING,
    PATIENCE,
    SETTLING_STEPS,
    STEPS_TO_A_PLACE,
    TIGHTER,
    ActuatorPath,
    Approach,
    Situation,
    TargetTrust,
)
from test.scene_changes import repeat_step

TOLERANCE, SIZE = 1e-4, 10.0
NOWHERE = np.empty(0)
# A target 1 m away, of an effector with one coordinate; the shape at rest is at zero.
TARGET = 1.0


def situation(
    place=0.0, target=TARGET, displacement=0.0, commanded=np.nan, is_balanced=True, loads=(),
    is_stable=True,
) -> Situation:
    """A situation of one effector coordinate [m] and one actuator [m], under loads [N]."""
    return Situation(
        np.array([target]), np.ones(1), np.array([place]), np.array([displacement]),
        np.array([commanded]), is_balanced, np.atleast_1d(np.array(loads, dtype=float)), 2.0,
        is_stable=is_stable,
    )  # fmt: skip


class WithoutKinks(TargetTrust):
    """Of a robot without kinks, which looks beyond none."""

    def begin(self, situation):
        super().begin(situation)
        if self.approach is Approach.LOOK:
            self.end_look()


@pytest.fixture
def trust() -> TargetTrust:
    """Of one actuator, for which 1 m is large, and of an effector that is at zero at rest."""
    return WithoutKinks(np.ones(1), np.zeros(1), TOLERANCE, SIZE, 1)


def learns(trust, promised, came) -> float:
    """The factor by which one step changes the weight."""
    trust.begin(situation())
    for _ in range(3):
        trust.tighten()
    before = trust.weight
    trust.expect(np.array([promised]))
    trust.begin(situation(came, displacement=0.1))
    return trust.weight / before


def obey(trust, place=0.0, **given) -> None:
    """One step of a body that is in balance at any displacement, and comes no nearer."""
    displacement = trust.goal[0] if trust.approach is Approach.RETURN else 0.02
    trust.expect(np.array([0.1]))
    trust.begin(situation(place, displacement=displacement, **given))


def rests(trust, **given) -> bool:
    """Whether the actuators rest after all that is tried with care was in vain."""
    for _ in range(MOST_CAREFUL_STEPS):
        if trust.approach is Approach.REST:
            return True
        obey(trust, **given)
    return False


def to_and_fro(step: int) -> float:
    """A displacement [m] that alternates."""
    return 0.01 * (step % 2)


def test_full_trust_is_a_weight_of_zero(trust):
    trust.begin(situation())
    assert trust.weight == 0.0 and trust.approach is Approach.FOLLOW


@pytest.mark.parametrize("came, factor", [
    (0.1, LOOSER), (0.09, LOOSER), (0.05, 1.0), (0.01, TIGHTER), (0.0, TIGHTER), (-0.1, TIGHTER),
])  # fmt: skip
def test_the_weight_follows_the_gain(trust, came, factor):
    """Of a promise of 0.1 m, this much came."""
    assert learns(trust, 0.1, came) == pytest.approx(factor)


def test_a_promise_of_round_off_teaches_nothing(trust):
    assert learns(trust, 1e-13, -1e-13) == 1.0


def test_a_step_without_a_promise_teaches_nothing(trust):
    trust.begin(situation())
    trust.tighten()
    before = trust.weight
    trust.begin(situation(-0.1))
    assert trust.weight == before


def test_poor_gains_raise_the_weight_up_to_its_greatest_value_and_good_ones_take_it_away(trust):
    trust.begin(situation())
    for step in range(1, 21):
        trust.expect(np.array([0.1]))
        trust.begin(situation(0.0, displacement=0.01 * step))
    assert trust.weight == GREATEST
    for step in range(1, 21):
        trust.expect(np.array([0.01 * step]))
        trust.begin(situation(0.01 * step, displacement=0.01 * step))
    assert trust.weight == 0.0


def test_the_first_poor_gain_takes_effect(trust):
    trust.begin(situation())
    trust.expect(np.array([0.1]))
    trust.begin(situation(0.0, displacement=0.1))
    assert trust.weight == FIRST * TIGHTER


def test_promises_of_which_nothing_came_because_no_actuator_moved_loosen(trust):
    """So it ends at a bound, or where a move is restrained to round-off."""
    trust.begin(situation())
    for _ in range(8):
        trust.tighten()
    assert trust.weight == GREATEST
    for _ in range(20):
        trust.expect(np.array([0.1]))
        trust.begin(situation(displacement=1e-9))
    assert trust.weight == 0.0 and trust.approach is Approach.FOLLOW


@pytest.mark.parametrize("share, is_another", [(0.5, False), (2.0, True)])
def test_another_target_starts_with_full_trust(trust, share, is_another):
    trust.begin(situation())
    trust.tighten()
    trust.begin(situation(target=TARGET * (1.0 + share * ANOTHER_TARGET)))
    assert (trust.weight == 0.0) is is_another


def test_many_small_moves_of_the_target_are_another_target_in_the_end(trust):
    trust.begin(situation())
    trust.tighten()
    for step in range(1, 5):
        trust.begin(situation(target=TARGET + 0.4 * step * ANOTHER_TARGET))
    assert trust.weight == 0.0


def test_what_is_free_has_no_say(trust):
    """Coordinates without weight may have any target and any place."""
    trust.begin(Situation(
        np.array([TARGET, 0.0]), np.array([1.0, 0.0]), np.zeros(2), np.zeros(1),
        np.array([np.nan]), True,
    ))  # fmt: skip
    trust.tighten()
    trust.expect(np.array([0.1, 7.0]))
    trust.begin(Situation(
        np.array([TARGET, 5.0]), np.array([1.0, 0.0]), np.array([0.1, -9.0]), np.ones(1),
        np.array([np.nan]), True,
    ))  # fmt: skip
    assert trust.weight == pytest.approx(FIRST * TIGHTER * LOOSER)


def test_freeing_a_coordinate_is_another_target(trust):
    two = Situation(
        np.array([TARGET, TARGET]), np.ones(2), np.zeros(2), np.zeros(1), np.array([np.nan]), True
    )
    trust.begin(two)
    trust.tighten()
    trust.begin(two._replace(weights=np.array([1.0, 0.0])))
    assert trust.weight == 0.0


def test_a_target_that_is_reached_loosens_and_begins_a_new_path(trust):
    trust.begin(situation(displacement=0.0))
    trust.begin(situation(displacement=0.1))
    trust.tighten()
    trust.begin(situation(place=TARGET, displacement=0.2))
    assert trust.weight == pytest.approx(FIRST * TIGHTER * LOOSER)
    assert trust.path.last == [0.2]
    trust.path.go_back()
    assert trust.path.last is None


@pytest.mark.parametrize("patience, move", [
    (PATIENCE, to_and_fro), (LONG_PATIENCE, lambda step: 0.01 * step),
], ids=["to and fro", "drift"])  # fmt: skip
def test_actuators_that_move_without_gain_rest_those_that_drift_later(trust, patience, move):
    for step in range(patience + 1):
        assert trust.approach is Approach.FOLLOW
        trust.begin(situation(displacement=move(step)))
    assert trust.approach is Approach.RETURN and rests(trust)


@pytest.mark.parametrize("at", [
    lambda step: situation(place=1e-3 * step, displacement=to_and_fro(step)),
    lambda step: situation(displacement=0.3), lambda step: situation(0.3, displacement=0.5),
], ids=["gain", "stand still", "are nearer than at rest, so were not caught"])  # fmt: skip
def test_actuators_follow_that(trust, at):
    for step in range(3 * LONG_PATIENCE):
        trust.begin(at(step))
        assert trust.approach is Approach.FOLLOW


@pytest.mark.parametrize("move", [to_and_fro, lambda step: 0.0], ids=["moves", "is stuck"])
def test_a_body_that_does_not_come_to_balance_goes_back_to_where_it_was_in_balance(trust, move):
    trust.begin(situation(-0.5, displacement=0.7))
    for step in range(PATIENCE + 1):
        assert trust.approach is Approach.FOLLOW
        trust.begin(situation(displacement=move(step), is_balanced=False))
    assert trust.approach is Approach.RETURN and trust.goal == [0.7]


def takes_care(trust) -> None:
    """A robot that goes to and fro, and is back at the nearest place that it was at, 0.4 m away."""
    for step in range(PATIENCE + 1):
        trust.begin(situation(0.6 - to_and_fro(step), displacement=to_and_fro(step)))
    trust.begin(situation(0.6, displacement=trust.goal[0]))
    assert trust.approach is Approach.FOLLOW and trust.is_careful


def tries(trust, place, is_balanced=True, promised=0.7) -> None:
    """A step with care that is to lead to 0.7 m, and where the body is after it."""
    trust.expect(np.array([promised]))
    trust.begin(situation(place, displacement=0.05, is_balanced=is_balanced))


@pytest.mark.parametrize("place, is_kept", [(0.601, True), (0.65, True), (0.599, False)])
def test_with_care_a_place_is_kept_where_it_is_nearer(trust, place, is_kept):
    takes_care(trust)
    before = trust.weight
    tries(trust, place)
    assert trust.approach is (Approach.FOLLOW if is_kept else Approach.RETURN)
    assert trust.weight > before if place < 0.61 else trust.weight == before
    if not is_kept:
        assert trust.goal == [0.0]


def test_with_care_a_trial_is_half_as_long_as_one_that_was_left_again(trust):
    takes_care(trust)
    begin, least = np.zeros(1), 1e-6
    assert not trust.is_too_long(begin, np.array([9.0]))
    tries(trust, 0.5)
    trust.begin(situation(0.6, displacement=trust.goal[0]))
    assert trust.approach is Approach.FOLLOW and trust.is_careful
    assert trust.is_too_long(begin, np.array([0.025 + least]))
    assert not trust.is_too_long(begin, np.array([0.025 - least]))
    tries(trust, 0.65)
    assert not trust.is_too_long(begin, np.array([9.0]))


def test_with_care_a_place_is_judged_in_balance(trust):
    """Out of balance it seemed much nearer than it is."""
    takes_care(trust)
    tries(trust, 0.9, is_balanced=False)
    for place in (0.89, 0.8):
        assert trust.approach is Approach.RETURN and trust.goal == [0.05]
        trust.begin(situation(place, displacement=0.05, is_balanced=False))
    trust.begin(situation(0.5, displacement=0.05))
    assert trust.approach is Approach.RETURN and trust.goal == [0.0]


def test_a_body_that_stays_out_of_balance_goes_further_and_further_back(trust):
    """Each place with care is nearer, until one where it is caught, and at each before it too."""
    takes_care(trust)
    for step in range(1, 9):
        trust.expect(np.array([0.6 + 0.01 * step]))
        trust.begin(situation(0.6 + 0.01 * step, displacement=0.1 * step))
    goals, weight = [], trust.weight
    while len(goals) < 4:
        trust.begin(situation(0.68, displacement=0.9, is_balanced=False))
        if trust.approach is Approach.RETURN and trust.goal[0] not in (*goals, 0.9):
            goals.append(float(trust.goal[0]))
    np.testing.assert_allclose(goals, [0.8, 0.7, 0.5, 0.1], atol=1e-12)
    trust.begin(situation(0.61, displacement=goals[-1]))
    assert trust.approach is Approach.FOLLOW and trust.weight > weight


def test_a_step_with_care_that_a_rate_hinders_is_no_trial(trust):
    takes_care(trust)
    for step in range(3 * MOST_CAREFUL_STEPS):
        trust.expect(np.array([0.6 + 1e-6 * (step + 1)]), is_hindered=True)
        trust.begin(situation(0.6 + 1e-6 * (step + 1), displacement=1e-4 * step))
        assert trust.approach is Approach.FOLLOW and trust.is_careful


def test_with_care_a_target_may_be_reached(trust):
    takes_care(trust)
    tries(trust, TARGET, is_balanced=False)
    assert trust.approach is Approach.RETURN
    trust.begin(situation(TARGET, displacement=0.05))
    assert trust.approach is Approach.FOLLOW and not trust.is_careful


def test_a_reached_target_is_left_where_the_body_creeps_away_from_it(trust):
    trust.begin(situation(0.9, displacement=-0.3))
    for step in range((MOST_LOOKS + 2) * SETTLING_STEPS):
        if not trust.is_careful:
            trust.begin(situation(TARGET, displacement=1e-4 * step, is_balanced=False))
    assert trust.approach is Approach.RETURN and trust.goal == [-0.3]


@pytest.mark.parametrize("creeps", [0.0, 1e-9])
def test_a_reached_target_is_kept_where_the_actuators_rest(trust, creeps):
    """However the tolerance of the residual is set."""
    trust.begin(situation(0.9, displacement=-0.3))
    for step in range(3 * MOST_LOOKS * SETTLING_STEPS):
        trust.begin(situation(TARGET, displacement=creeps * step, is_balanced=False))
        assert trust.approach is Approach.FOLLOW and not trust.is_careful


@pytest.mark.parametrize("seed", [1, 2])
def test_slow_progress_is_seen_in_spite_of_noise_of_the_target(trust, seed):
    """Progress is 0.01 mm a step, noise 2 mm."""
    print(f"seed {seed}")
    random = np.random.default_rng(seed)
    for step in range(4 * LONG_PATIENCE):
        target = TARGET + 2e-3 * random.standard_normal() if step else TARGET
        trust.begin(situation(1e-5 * step, target, displacement=1e-5 * step))
        assert trust.approach is Approach.FOLLOW


def test_noise_of_the_target_does_not_keep_actuators_from_resting(trust):
    random = np.random.default_rng(1)
    for step in range(2 * PATIENCE):
        target = TARGET + 1e-3 * random.standard_normal()
        if trust.approach is Approach.FOLLOW and not trust.is_careful:
            trust.begin(situation(target=target, displacement=to_and_fro(step)))
    assert rests(trust)


def rest(trust, **given) -> None:
    """Lets the actuators of a trust rest."""
    for step in range(PATIENCE + 1):
        trust.begin(situation(displacement=to_and_fro(step), **given))
    assert rests(trust, **given)


def test_another_target_ends_the_rest(trust):
    rest(trust)
    trust.begin(situation(target=-TARGET))
    assert trust.approach is Approach.FOLLOW


def test_the_same_target_does_not_end_the_rest(trust):
    rest(trust)
    for _ in range(3 * LONG_PATIENCE):
        trust.begin(situation())
    assert trust.approach is Approach.REST


@pytest.mark.parametrize("moved, approach", [(0.5, Approach.REST), (2.0, Approach.FOLLOW)])
def test_a_resting_robot_that_something_else_moves_follows_again(trust, moved, approach):
    rest(trust)
    trust.begin(situation(place=moved * TOLERANCE))
    assert trust.approach is approach


def test_a_resting_robot_that_settles_goes_on_resting(trust):
    rest(trust)
    trust.resting = situation(is_balanced=False)
    trust.begin(situation(place=5 * TOLERANCE, is_balanced=False))
    trust.begin(situation(place=9 * TOLERANCE, is_balanced=True))
    assert trust.approach is Approach.REST
    trust.begin(situation(place=9.5 * TOLERANCE))
    assert trust.approach is Approach.REST
    trust.begin(situation(place=12 * TOLERANCE))
    assert trust.approach is Approach.FOLLOW


def test_steps_at_rest_do_not_change_the_trust(trust):
    rest(trust)
    before = trust.weight
    for _ in range(10):
        trust.tighten()
        trust.begin(situation())
    assert trust.weight == before


@pytest.mark.parametrize("then", [0.2, np.nan])
def test_a_commanded_actuator_that_changes_starts_again(trust, then):
    rest(trust, commanded=0.1)
    trust.begin(situation(commanded=then))
    assert trust.approach is Approach.FOLLOW and trust.weight == 0.0


@pytest.mark.parametrize("moved, weight", [(0.5, True), (2.0, False)])
def test_what_was_learnt_holds_for_its_loads(trust, moved, weight):
    """A load of 10 N of all, 100 N, changes by some of what counts as other loads."""
    def loaded(force):
        return situation()._replace(loads=np.array([force]), load=100.0)

    trust.begin(loaded(10.0))
    for _ in range(4):
        trust.tighten()
    trust.begin(loaded(10.0 + moved * OTHER_LOADS * 100.0))
    assert (trust.weight > 0.0) == weight


@pytest.mark.parametrize("moved, weight", [(0.5, True), (2.0, False)])
def test_what_was_learnt_holds_for_the_places_of_guided_bodies(trust, moved, weight):
    """A guided body that moves counts as a target that moves as far."""
    trust.begin(situation()._replace(guided=np.zeros(12)))
    for _ in range(4):
        trust.tighten()
    trust.begin(situation()._replace(guided=np.full(12, moved * ANOTHER_TARGET * TARGET)))
    assert (trust.weight > 0.0) == weight


def test_a_promise_is_not_judged_where_a_guided_body_moved(trust):
    trust.begin(situation()._replace(guided=np.zeros(12)))
    trust.expect(np.array([0.5 * TARGET]))
    trust.begin(situation(displacement=0.1)._replace(guided=np.full(12, 1e-4)))
    assert trust.weight == 0.0


def test_other_loads_end_the_rest(trust):
    rest(trust, loads=0.0)
    trust.begin(situation(loads=1.0))
    assert trust.approach is Approach.FOLLOW


def reached(trust, displacement) -> None:
    """A step that begins at the target."""
    trust.begin(situation(TARGET, displacement=displacement))


def test_at_a_reached_target_what_goes_to_and_fro_comes_to_rest(trust):
    """Each step goes beyond the least energy by four times the distance, less the share held."""
    place, places = 0.1, []
    for _ in range(30 * SETTLING_STEPS):
        reached(trust, place)
        place -= 1.0 / (1.0 + trust.open_weight) * 2.0 * np.tanh(place / 0.05) * 0.05
        places.append(place)
    assert trust.open_weight > 0.0
    assert np.ptp(places[-60:]) <= 1e-6


def test_at_a_reached_target_slow_drift_ends(trust):
    places = 1e-4 * np.arange(MOST_LOOKS * SETTLING_STEPS)
    for place in places:
        reached(trust, place)
    assert trust.open_weight == 0.0
    place, moves = places[-1], []
    for _ in range(20 * SETTLING_STEPS):
        moves.append(1e-4 / (1.0 + trust.open_weight))
        place += moves[-1]
        reached(trust, place)
    assert moves[-1] <= 1e-6
    trust.begin(situation(target=2.0 * TARGET))
    assert trust.open_weight == 0.0


def test_convergence_at_a_reached_target_is_not_slowed(trust):
    for step in range(20 * SETTLING_STEPS):
        reached(trust, 0.1 * (-0.3) ** step)
    assert trust.open_weight == 0.0


def caught(trust, count, commanded=np.nan) -> None:
    """Comes from far away, 10 m near to the target, and stays there for some steps."""
    for step in range(11):
        place = -9.0 - 0.1 * (10 - step)
        trust.begin(situation(place, displacement=0.05 * step, commanded=commanded))
    for _ in range(count):
        trust.begin(situation(-9.0, displacement=0.5, commanded=commanded))


# Steps until it lets go, until it has waited in vain for its shape at rest, and until it is caught again.
TWICE_CAUGHT = 3 * (PATIENCE + 1)


def go_back(trust, target=TARGET) -> list[float]:
    """Follows the path back to its begin; the displacements that it led through."""
    passed = []
    while trust.approach is Approach.RETRACE:
        place = trust.path.last
        if place is not None:
            passed.append(float(place[0]))
            trust.path.go_back()
        trust.begin(situation(-9.0, target, displacement=passed[-1]))
    return passed


def test_a_robot_that_was_caught_lets_go_and_tries_again_from_rest(trust):
    caught(trust, PATIENCE + 1)
    assert trust.approach is Approach.DEPART and not trust.goal.any()
    trust.begin(situation(-12.0, displacement=0.2))
    assert trust.approach is Approach.DEPART
    trust.begin(situation(0.0))
    assert trust.approach is Approach.FOLLOW


def test_a_robot_is_caught_too_that_hangs_near_the_target_at_rest(trust):
    """At rest it is drawn 20 m away from the target, and hangs 1 m away from it."""
    target = -20.0
    trust.begin(situation(-19.0, target))
    for step in range(PATIENCE + 2):
        trust.begin(situation(-10.0, target, displacement=0.5 + to_and_fro(step)))
    assert trust.approach is Approach.DEPART


def test_a_robot_that_was_caught_goes_back_along_its_path(trust):
    caught(trust, TWICE_CAUGHT)
    assert trust.approach is Approach.RETRACE
    np.testing.assert_allclose(go_back(trust), 0.05 * np.arange(10, -1, -1), atol=1e-15)
    assert trust.approach is Approach.FOLLOW


def test_in_another_shape_than_on_the_way_the_effectors_are_led_back_where_they_were(trust):
    """From place to place: at once where they are near, else after some steps."""
    trust.begin(situation(-14.0))
    caught(trust, TWICE_CAUGHT)
    assert trust.approach is Approach.RETRACE
    trust.path.go_back()
    trust.begin(situation(-9.0 - 0.9 * ELSEWHERE * SIZE, displacement=0.45))
    assert trust.approach is Approach.RETRACE
    trust.begin(situation(-9.1 - 1.1 * ELSEWHERE * SIZE, displacement=0.45))
    assert trust.approach is Approach.LEAD_BACK
    np.testing.assert_allclose(trust.path.last_effectors, [-9.1])
    for _ in range(STEPS_TO_A_PLACE):
        np.testing.assert_allclose(trust.path.last_effectors, [-9.1])
        trust.begin(situation(-12.0, displacement=0.45))
    for place in -9.2 - 0.1 * np.arange(8):
        np.testing.assert_allclose(trust.path.last_effectors, [place])
        trust.begin(situation(place, displacement=0.3))
        assert trust.approach is Approach.LEAD_BACK
    np.testing.assert_allclose(trust.path.last_effectors, [-14.0])
    trust.begin(situation(-14.0))
    assert trust.approach is Approach.FOLLOW


def test_where_leading_back_comes_near_no_place_the_actuators_go_where_they_began(trust):
    trust.begin(situation(-14.0))
    caught(trust, TWICE_CAUGHT)
    far = situation(-12.0 - 1.1 * ELSEWHERE * SIZE, displacement=0.45)
    trust.begin(far)
    assert trust.approach is Approach.LEAD_BACK
    for _ in range(PATIENCE):
        assert trust.approach is Approach.LEAD_BACK
        trust.begin(far)
    np.testing.assert_allclose(trust.path.last, [0.0])
    for _ in range(PATIENCE):
        trust.begin(far)
        assert trust.approach is Approach.RETRACE


def test_on_its_way_back_it_follows_as_soon_as_it_is_much_nearer(trust):
    caught(trust, TWICE_CAUGHT)
    trust.begin(situation(-0.1, displacement=0.1))
    assert trust.approach is Approach.FOLLOW


def test_it_lets_go_and_goes_back_once_for_each_target(trust):
    for target in (TARGET, 1.5 * TARGET):
        for step in range(PATIENCE + 1):
            trust.begin(situation(-9.0, target, displacement=to_and_fro(step)))
        assert trust.approach is Approach.DEPART
        for step in range(PATIENCE + 2):
            trust.begin(situation(-9.0, target, displacement=to_and_fro(step)))
        assert trust.approach is Approach.RETRACE
        go_back(trust, target)
        for step in range(PATIENCE + 2):
            trust.begin(situation(-9.0, target, displacement=to_and_fro(step)))
        assert trust.is_careful and rests(trust, place=-9.0, target=target)


def test_a_robot_of_which_actuators_are_commanded_does_not_go_back(trust):
    caught(trust, LONG_PATIENCE + PATIENCE, commanded=0.5)
    assert trust.approach is not Approach.RETRACE


def test_forgetting_leaves_nothing(trust):
    rest(trust)
    trust.forget()
    assert trust.approach is Approach.FOLLOW and trust.weight == 0.0 and trust.path.last is None
    for step in range(PATIENCE):
        trust.begin(situation(displacement=to_and_fro(step)))
        assert trust.approach is Approach.FOLLOW


def places_back(path) -> np.ndarray:
    """All places of a path, the last one first."""
    found = []
    while path.last is not None:
        found.append(path.last.copy())
        path.go_back()
    return np.array(found)


def test_a_path_leads_back_through_its_places():
    path = ActuatorPath(np.ones(2), 0)
    places = np.array([[0.0, 0.0], [0.1, 0.0], [0.1, 0.2], [0.0, 0.3]])
    for place in places:
        path.add(place, NOWHERE)
    np.testing.assert_array_equal(places_back(path), places[::-1])
    assert path.last is None
    path.go_back()
    assert path.last is None


def test_a_path_keeps_no_places_that_are_near_each_other_by_its_scales():
    scales = np.array([1.0, 100.0])
    path = ActuatorPath(scales, 0)
    for step in range(11):
        path.add(0.3 * PATH_SPACING * step * scales, NOWHERE)
    np.testing.assert_allclose(
        places_back(path)[::-1] / (PATH_SPACING * scales), np.array([[0.0], [1.2], [2.4]]) * [1, 1]
    )


def test_a_long_path_thins_out_and_keeps_its_begin():
    path, count = ActuatorPath(np.ones(1), 0), 10 * LONGEST_PATH
    for step in range(count):
        path.add(np.array([2.0 * PATH_SPACING * step]), NOWHERE)
    places = places_back(path)[::-1, 0] / (2.0 * PATH_SPACING)
    assert LONGEST_PATH // 4 < len(places) <= LONGEST_PATH
    assert places[0] == 0.0 and count - places[-1] < 0.01 * count
    gaps = np.diff(places)
    assert gaps.min() > 0.0 and gaps.max() < 0.01 * count


def test_a_path_that_begins_anew_has_its_first_spacing():
    path = ActuatorPath(np.ones(1), 0)
    for step in range(3 * LONGEST_PATH):
        path.add(np.array([2.0 * PATH_SPACING * step]), NOWHERE)
    path.forget()
    path.add(np.zeros(1), NOWHERE)
    path.add(np.array([1.5 * PATH_SPACING]), NOWHERE)
    assert len(places_back(path)) == 2


def test_targets_of_nan_do_no_harm(beam):
    """What is free for a while is followed afterwards as if it had never been free."""
    simulation = beam()
    home = simulation.effector_positions()
    free = np.full_like(home, np.nan)
    near, far = home + [0.005, 0.0, -0.004], home + [0.6, 0.6, -0.6]
    trust = simulation.inverse.trust
    for target in (free, far, free, near):
        for _ in range(2 * LONG_PATIENCE):
            result = simulation.step(FollowTargets(target, 0.02))
            assert np.isfinite(trust.weight) and not result.status.is_failure
        if target is free:
            assert trust.approach is Approach.FOLLOW and trust.weight == 0.0
    assert result.status is Status.OK


def test_the_weight_does_not_stay_where_the_nearest_place_is_reached(beam):
    """What is left of the promise there is round-off: the target is 1.2 mm out of reach."""
    simulation = beam()
    target = simulation.effector_positions() + [0.01, 0.0, -0.005]
    result = repeat_step(simulation, FollowTargets(target, 0.02), 100)
    assert result.status is Status.UNREACHABLE
    assert simulation.inverse.trust.weight == 0.0


def test_what_is_learnt_is_forgotten_by_a_reset(beam, rod):
    simulation = beam(rod, {"body.element": "quadratic"})
    target = simulation.effector_positions() + [0.9, 0.9, 0.0]

    def follow() -> tuple[list, list]:
        simulation.reset()
        lengths, weights = [], []
        for _ in range(100):
            lengths.append(simulation.step(FollowTargets(target, 0.02)).setpoints)
            weights.append(simulation.inverse.trust.weight)
        return lengths, weights

    (first, weights), (again, _) = follow(), follow()
    assert max(weights) > 0.0
    np.testing.assert_array_equal(first, again)


@pytest.fixture
def looking() -> TargetTrust:
    """Of a robot that rests 0.5 m away, and looks beyond kinks."""
    trust = TargetTrust(np.ones(1), np.zeros(1), TOLERANCE, SIZE, 1)
    for _ in range(PATIENCE + 2):
        trust.begin(situation(0.5, displacement=0.3))
    assert trust.approach is Approach.LOOK
    return trust


def leaps(trust, promised=0.6) -> None:
    """Follow in a branch that promises to come to this place."""
    trust.offer(np.array([True]), np.array([promised]))
    trust.end_look()


@pytest.mark.parametrize("promised, is_chosen", [(0.6, True), (0.501, False), (0.4, False)])
def test_only_a_branch_that_promises_a_nearer_place_is_followed(looking, promised, is_chosen):
    leaps(looking, promised)
    assert looking.approach is Approach.FOLLOW
    assert (looking.branch is not None) is is_chosen


def test_beyond_a_kink_it_stays_where_it_is_nearer_in_balance(looking):
    leaps(looking)
    looking.begin(situation(0.45, displacement=0.35, is_balanced=False))
    looking.begin(situation(0.55, displacement=0.4))
    for _ in range(PATIENCE - 2):
        looking.begin(situation(0.55, displacement=0.4))
        assert looking.approach is Approach.FOLLOW and looking.branch is not None


@pytest.mark.parametrize("place, steps", [(0.45, PATIENCE + 2), (-1.0, 1)])
def test_from_beyond_a_kink_it_returns_where_it_is_no_nearer(looking, place, steps):
    leaps(looking)
    for _ in range(steps):
        assert looking.approach is Approach.FOLLOW
        looking.begin(situation(place, displacement=0.4))
    assert looking.approach is Approach.RETURN and looking.goal[0] == 0.3
    assert looking.branch is None
    for _ in range(2 * LONG_PATIENCE):
        looking.begin(situation(0.5, displacement=0.3))
        assert looking.approach is Approach.FOLLOW


def test_another_target_ends_what_was_chosen_beyond_a_kink(looking):
    leaps(looking)
    looking.begin(situation(0.5, target=2.0 * TARGET, displacement=0.3))
    assert looking.approach is Approach.FOLLOW and looking.branch is None


@pytest.mark.parametrize("end", [TARGET + 3.0 * TOLERANCE, TARGET], ids=["missed", "unbalanced"])
def test_moves_at_reached_targets_get_shorter_each_time_that_one_leads_away(trust, end):
    trust.begin(situation(0.0))
    assert trust.move_limit == LONGEST_MOVE and not trust.is_at_targets
    for time in range(3):
        trust.begin(situation(TARGET, is_stable=False))
        assert trust.is_at_targets
        trust.begin(situation(
            end, displacement=0.1 * MUCH_SHORTER**time, is_balanced=end != TARGET, is_stable=False
        ))  # fmt: skip
        trust.begin(situation(TARGET, is_stable=False))
        assert trust.move_limit == pytest.approx(0.1 * MUCH_SHORTER ** (time + 1))
    trust.begin(situation(0.0))
    assert trust.move_limit == LONGEST_MOVE
    trust.begin(situation(2.0 * TARGET, target=2.0 * TARGET))
    assert trust.is_at_targets and trust.move_limit == LONGEST_MOVE


@pytest.mark.parametrize("place, is_balanced, wanted, is_at_targets", [
    (TARGET + 0.005 * TOLERANCE, True, {}, True), (TARGET + 0.02 * TOLERANCE, False, {}, False),
    (0.0, False, {"targets": np.zeros(1), "weights": np.zeros(1)}, False),
], ids=["keep them in balance", "may come nearer", "want nothing"])  # fmt: skip
def test_moves_at_reached_targets_are_not_shortened_that(
    trust, place, is_balanced, wanted, is_at_targets
):
    for step in range(5):
        moved = situation(place, displacement=0.1 * step, is_balanced=is_balanced)
        trust.begin(moved._replace(**wanted))
        assert trust.is_at_targets is is_at_targets and trust.move_limit == LONGEST_MOVE


@pytest.mark.parametrize("end", [TARGET + 3.0 * TOLERANCE, TARGET], ids=["missed", "unstable"])
def test_actuators_go_back_and_stay_where_the_body_was_stable_at_its_targets_last(trust, end):
    for displacement in (0.2, 0.3):
        trust.begin(situation(TARGET, displacement=displacement))
    trust.begin(situation(TARGET, displacement=0.4, is_balanced=False, is_stable=False))
    assert trust.approach is Approach.FOLLOW
    trust.begin(situation(end, displacement=0.5, is_stable=False))
    assert trust.approach is Approach.DEPART and trust.goal[0] == 0.3
    for displacement in (0.4, 0.3, 0.3):
        trust.begin(situation(TARGET + 0.5 * TOLERANCE, displacement=displacement))
    assert trust.approach is Approach.REST
    trust.begin(situation(2.0 * TARGET, displacement=0.3, target=2.0 * TARGET))
    assert trust.approach is Approach.FOLLOW


@pytest.mark.parametrize(
    "given", [{"is_stable": False}, {"commanded": 0.0}, {}], ids=["unstable", "commanded", "once"]
)
def test_who_was_not_stable_at_targets_for_two_free_steps_goes_back_nowhere(trust, given):
    for place in (TARGET, *([TARGET] if given else []), TARGET + 3.0 * TOLERANCE, TARGET):
        trust.begin(situation(place, **given))
        assert trust.approach is Approach.FOLLOW


@pytest.mark.parametrize("is_hindered", [False, True])
def test_actuators_that_creep_for_long_rest_unless_a_rate_hinders_them(trust, is_hindered):
    for step in range(LATE + 3 * PATIENCE):
        trust.begin(situation(1e-6 * step, displacement=1e-5 * step))
        assert step >= LATE - 1 or trust.approach is Approach.FOLLOW
        trust.expect(np.array([1e-6 * (step + 1)]), is_hindered)
    assert trust.approach is (Approach.FOLLOW if is_hindered else Approach.REST)


def test_who_departs_goes_to_the_goal_and_follows_or_stays(trust):
    for follows in (True, False):
        trust.depart(np.array([0.5]), follows, 0.0)
        for displacement in (0.0, 0.25, 0.5):
            trust.begin(situation(0.1, displacement=displacement))
            if displacement < 0.5:
                assert trust.approach is Approach.DEPART and trust.goal[0] == 0.5
        assert trust.approach is (Approach.FOLLOW if follows else Approach.REST)
        assert trust.misses[0] == pytest.approx(0.1 - TARGET)


def test_who_departed_rests_where_it_is_calm_and_near_enough(trust):
    trust.depart(np.array([0.0]), True, 0.5 * 0.6**2)
    for _ in range(CALM_STEPS + 5):
        trust.begin(situation(0.1))
    assert trust.approach is Approach.FOLLOW
    for _ in range(CALM_STEPS + 5):
        trust.begin(situation(0.5))
    assert trust.approach is Approach.REST
