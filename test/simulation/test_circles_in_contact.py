"""Facts of circles that a robot follows while it leans on something, wherever exactly that is."""

import numpy as np
import pytest

from softrobot_twin.simulation import FollowTargets

STEP, RAMP, TURN = 0.02, 2.0, 10.0  # s
RUNS = 2
MEAN, LARGEST = 2.0e-6, 1.0e-4  # m
BALL = [-0.022, 0.0, 0.150]  # m
# Centre, radius [m] and second axis of each circle.
CIRCLES = {"between cylinders": ([0.020, 0.0, 0.215], 0.005, 2), "on a ball": ([0.0, 0.0, 0.188], 0.020, 1)}
# In motion the platform stands still. Places of obstacles [m], and circles that statics reach.
BALL_IN_MOTION, CYLINDERS_IN_MOTION = [-0.028, 0.0, 0.150], [0.025, 0.160]
CIRCLES_IN_MOTION = {
    "between cylinders": ([0.0, 0.0, 0.186], 0.005, 1),
    "on a ball": ([0.0, 0.0, 0.186], 0.015, 1),
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


def leaning_in_motion(name, random):
    """Changes the Trunk into one in motion, without slide, that leans on something."""

    def change(mapping):
        mapping["integration"] = "dynamic"
        for section in ("slides", "rigid_bodies"):
            mapping.pop(section)
        body = mapping["body"]
        body["fixed"] = [{"box": entry["box"]} for entry in body.pop("attached")]
        for cable in mapping["cables"]:
            cable.pop("pull_point_on")
        if name == "on a ball":
            centre = (BALL_IN_MOTION + moved(random)).tolist()
            mapping["obstacles"] = [{"name": "ball", "sphere": {"centre": centre, "radius": 0.015}}]
            mapping["contact"]["between"] = [{"pair": ["trunk", "ball"]}]
            return
        x, z = CYLINDERS_IN_MOTION
        for obstacle, side in zip(mapping["obstacles"], (-1.0, 1.0), strict=True):
            ends = np.array([[side * x, -0.1, z], [side * x, 0.1, z]]) + moved(random)
            obstacle["cylinder"]["ends"] = ends.tolist()

    return change


def target_at(circle, time, start) -> np.ndarray:
    """The target on a circle; from where the tip is, it goes there smoothly [m]."""
    centre, radius, second = circle
    angle = 2.0 * np.pi * max(time - RAMP, 0.0) / TURN
    place = np.array(centre)
    place[0] += radius * np.cos(angle)
    place[second] += radius * np.sin(angle)
    share = min(time / RAMP, 1.0)
    return start + share * share * (3.0 - 2.0 * share) * (place - start)


def follow(trunk, circle, time_step) -> None:
    """Assert that the tip meets the circle while the Trunk leans on something."""
    start, errors, pressed = trunk.effector_positions()[0].copy(), [], 0
    for step in range(1, round((RAMP + TURN) / time_step) + 1):
        target = target_at(circle, step * time_step, start)
        result = trunk.step(FollowTargets(target[None], time_step))
        if step * time_step > RAMP:
            errors.append(result.effector_errors[0])
            pressed += result.report.contact_count > 0
    print(f"mean {1e3 * np.mean(errors):.5f} mm, largest {1e3 * max(errors):.4f} mm, "
          f"{pressed} of {len(errors)} steps press")  # fmt: skip
    assert pressed > 50
    assert np.mean(errors) <= MEAN and max(errors) <= LARGEST


@pytest.mark.exhaustive
@pytest.mark.parametrize("name", CIRCLES)
def test_a_circle_in_contact_is_met_wherever_exactly_the_obstacle_is(coarse_trunk, drawn_rng, name):
    for _ in range(RUNS):
        follow(coarse_trunk(leaning(name, drawn_rng)), CIRCLES[name], STEP)


@pytest.mark.exhaustive
@pytest.mark.parametrize("time_step", [0.01, 0.02])
@pytest.mark.parametrize("name", CIRCLES_IN_MOTION)
def test_in_motion_a_trunk_that_leans_below_its_tip_meets_a_circle(coarse_trunk, drawn_rng, name, time_step):
    for _ in range(RUNS):
        trunk = coarse_trunk(leaning_in_motion(name, drawn_rng))
        follow(trunk, CIRCLES_IN_MOTION[name], time_step)
