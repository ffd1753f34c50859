"""Where a robot goes back to, and the path along which its effectors are led back."""

import numpy as np
import pytest

from softrobot_twin.simulation.step.effector_path import STEPS_TO_A_PLACE, EffectorPath
from softrobot_twin.simulation.step.passed_places import MOST_RETURNS, PATIENCE, RISES, SNAPPED, PassedPlaces, Place
from softrobot_twin.simulation.step.situation import Situation

REACHED = 1.0e-3
"""T at which targets count as reached [m²]."""


def pass_by(places, now, drive=0.0, *, is_balanced=True, is_stable=True, settles=False):
    """Whether the robot is to go back, when a step begins at T = `now` with its actuator at `drive`."""
    none = np.empty(0)
    situation = Situation(none, none, none, np.array([drive]), none, is_balanced, is_stable=is_stable)
    if not places.balanced:
        places.balanced.append(Place(situation.displacements, now))
    return places.pass_by(situation, now, REACHED, settles)


def test_where_it_comes_no_nearer_a_robot_goes_back_to_the_nearest_balance():
    places = PassedPlaces()
    assert not any(pass_by(places, now, now) for now in (4.0, 3.0, 2.0))
    waited = [pass_by(places, 2.5, 9.0) for _ in range(PATIENCE + 1)]
    assert waited == PATIENCE * [False] + [True]
    assert places.nearest.drives == [2.0] and places.nearest.now == 2.0


def test_while_it_settles_or_is_at_its_targets_a_robot_does_not_go_back():
    places = PassedPlaces()
    assert not any(pass_by(places, 2.0, settles=True) for _ in range(3 * PATIENCE))
    assert not any(pass_by(places, 0.5 * REACHED) for _ in range(3 * PATIENCE))


@pytest.mark.parametrize("is_stable", [True, False])
def test_a_body_that_snaps_goes_back_at_once_where_its_linearization_tells_where_it_goes(is_stable):
    places = PassedPlaces()
    pass_by(places, 1.0)
    rising = 1.1 * SNAPPED + np.arange(RISES)
    assert [pass_by(places, now, is_stable=is_stable) for now in rising] == (RISES - 1) * [False] + [is_stable]


def test_after_some_returns_it_stays_at_the_nearest_stable_place_though_it_was_no_balance():
    places = PassedPlaces()
    pass_by(places, 4.0, 4.0)
    pass_by(places, 3.0, 3.0, is_balanced=False)
    assert [places.go_back() for _ in range(MOST_RETURNS + 1)] == MOST_RETURNS * [False] + [True]
    assert places.nearest.drives == [3.0]
    # A body that has not come back there is led to the place before.
    assert places.drop_lost(4.5, REACHED, True) and places.nearest.drives == [4.0]
    assert not places.drop_lost(9.0, REACHED, True)


def test_effectors_are_led_back_through_the_places_where_they_were():
    path, targets = EffectorPath(slice(None), 3, 0.1), np.array([1.0, 0.0, 0.0, 0.5])
    here = np.array([0.0, 0.0, 0.0, 0.2])
    for x in (0.0, 0.01, 0.1, 0.2):
        path.follow(here + [x, 0.0, 0.0, 0.0], targets)
    path.turn()
    led = []
    while path.back:
        led.append(path.back[-1][0])
        # Their orientations are free on the way back.
        assert np.isnan(path.back[-1][3])
        for _ in range(STEPS_TO_A_PLACE):
            path.follow(here + [9.0, 0.0, 0.0, 0.0], targets)
    assert led == [0.2, 0.1, 0.0] and path.has_turned
    path.follow(here, 2.0 * targets)
    assert not path.has_turned
