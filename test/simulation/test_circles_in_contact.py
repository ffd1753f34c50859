"""Facts of circles that a robot follows while it leans on something, wherever exactly that is."""

import numpy as np
import pytest

from softrobot_twin.simulation import FollowTargets

STEP, RAMP, TURN = 0.02, 2.0, 10.0  # s
RUNS = 4
MEAN, LARGEST = 2.0e-6, 1.0e-4  # m
BALL = [-0.022, 0.0, 0.150]  # m
# Centre, radius [m] and second axis of each circle.
CIRCLES = {
    "between cylinders": ([0.020, 0.0, 0.215], 0.005, 2),
    "on a ball": ([0.0, 0.0, 0.188], 0.020, 1),
}


def moved(random) -> np.ndarray:
    """A displacement in a random direction, between a micrometre and 0.1 mm [m]."""
    way = random.standard_normal(3)
    return way / np.linalg.norm(way) * 10.0 ** random.uniform(-6.0, -4.0)


def leaning(name, random):
    """Changes the Trunk between cylinders into one that leans on something at a random place."""

    def change(mapping):
        if name == "on a ball":
            centre = (BALL + moved(random)).tolist()
            mapping["obstacles"] = [{"name": "ball", "sphere": {"centre": centre, "radius": 0.015}}]
            mapping["contact"]["between"] = [{"pair": ["trunk", "ball"]}]
        else:
            for obstacle in mapping["obstacles"]:
                ends = obstacle["cylinder"]["ends"]
                obstacle["cylinder"]["ends"] = (np.array(ends) + moved(random)).tolist()

    return change


def target_at(name, time, start) -> np.ndarray:
    """The target on the circle; from where the tip is, it goes there smoothly [m]."""
    centre, radius, second = CIRCLES[name]
    angle = 2.0 * np.pi * max(time - RAMP, 0.0) / TURN
    place = np.array(centre)
    place[0] += radius * np.cos(angle)
    place[second] += radius * np.sin(angle)
    share = min(time / RAMP, 1.0)
    return start + share * share * (3.0 - 2.0 * share) * (place - start)


@pytest.mark.slow
@pytest.mark.parametrize("name", CIRCLES)
def test_a_circle_in_contact_is_met_wherever_exactly_the_obstacle_is(
    coarse_trunk, drawn_rng, name
):
    for _ in range(RUNS):
        trunk = coarse_trunk(leaning(name, drawn_rng))
        start, errors, pressed = trunk.effector_positions()[0].copy(), [], 0
        for step in range(1, round((RAMP + TURN) / STEP) + 1):
            result = trunk.step(FollowTargets(target_at(name, step * STEP, start)[None], STEP))
            if step * STEP > RAMP:
                errors.append(result.effector_errors[0])
                pressed += result.report.contact_count > 0
        print(f"mean {1e3 * np.mean(errors):.5f} mm, largest {1e3 * max(errors):.4f} mm, "
              f"{pressed} of {len(errors)} steps press")  # fmt: skip
        assert pressed > 50
        assert np.mean(errors) <= MEAN and max(errors) <= LARGEST
