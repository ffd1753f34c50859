"""Facts of the trust in linearizations on the way to targets, and of the path of the actuators."""

import numpy as np
import pytest

from softrobot_twin.simulation import FollowTargets, Status
from softrobot_twin.simulation.step.target_trust import (
    ANOTHER_TARGET,
    FIRST,
    GREATEST,
    LONG_PATIENCE,
    LOOSER,
    MOST_CAREFUL_STEPS,
    MOST_LOOKS,
    PATIENCE,
    SETTLING_STEPS,
    TIGHTER,
    Approach,
    Situation,
    TargetTrust,
)
from test.scene_changes import repeat_step

TOLERANCE, SIZE = 1e-4, 10.0
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


@pytest.mark.parametrize("share, is_another", [(0.5, False), (2.0, True)])
def test_another_target_starts_with_full_trust(trust, share, is_another):
    trust.begin(situation())
    trust.tighten()
    trust.begin(situation(target=TARGET * (1.0 + share * ANOTHER_TARGET)))
    assert (trust.weight == 0.0) is is_another


def test_a_target_that_is_reached_loosens_and_begins_a_new_path(trust):
    trust.begin(situation(displacement=0.0))
    trust.begin(situation(displacement=0.1))
    trust.tighten()
    trust.begin(situation(place=TARGET, displacement=0.2))
    assert trust.weight == pytest.approx(FIRST * TIGHTER * LOOSER)
    assert trust.path.last == [0.2]
    trust.path.go_back()
    assert trust.path.last is None


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


def test_steps_at_rest_do_not_change_the_trust(trust):
    rest(trust)
    before = trust.weight
    for _ in range(10):
        trust.tighten()
        trust.begin(situation())
    assert trust.weight == before


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


def caught(trust, count, commanded=np.nan) -> None:
    """Comes from far away, 10 m near to the target, and stays there for some steps."""
    for step in range(11):
        place = -9.0 - 0.1 * (10 - step)
        trust.begin(situation(place, displacement=0.05 * step, commanded=commanded))
    for _ in range(count):
        trust.begin(situation(-9.0, displacement=0.5, commanded=commanded))


def test_a_robot_that_was_caught_lets_go_and_tries_again_from_rest(trust):
    caught(trust, PATIENCE + 1)
    assert trust.approach is Approach.DEPART and not trust.goal.any()
    trust.begin(situation(-12.0, displacement=0.2))
    assert trust.approach is Approach.DEPART
    trust.begin(situation(0.0))
    assert trust.approach is Approach.FOLLOW


def test_forgetting_leaves_nothing(trust):
    rest(trust)
    trust.forget()
    assert trust.approach is Approach.FOLLOW and trust.weight == 0.0 and trust.path.last is None
    for step in range(PATIENCE):
        trust.begin(situation(displacement=to_and_fro(step)))
        assert trust.approach is Approach.FOLLOW


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
