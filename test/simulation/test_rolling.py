"""Balls on a slope: they roll where friction can turn them, slide where it cannot."""

import numpy as np
import pytest

from softrobot_twin.simulation import Hold

G, RADIUS, STEP, STEPS = 9.81, 0.02, 0.002, 200


def run_down(scene_of, tilt, friction):
    simulation = scene_of(
        gravity=[G * np.sin(tilt), 0.0, -G * np.cos(tilt)], integration="dynamic",
        rigid_bodies=[{"name": "ball", "mass": 0.03, "position": [0, 0, RADIUS],
                       "sphere": {"radius": RADIUS}}],
        obstacles=[{"name": "slope", "plane": {}}],
        contact={"friction": friction, "between": [{"pair": ["ball", "slope"]}]},
    )  # fmt: skip
    for _ in range(STEPS):
        result = simulation.step(Hold(STEP))
        assert result.status.is_success
    return result.state.positions[0], result.state.velocities[1]


@pytest.mark.parametrize("tilt", [0.1, 0.3])
def test_a_ball_rolls_with_five_sevenths_of_the_frictionless_acceleration(scene_of, tilt):
    place, turning = run_down(scene_of, tilt, 0.5)
    time = STEP * STEPS
    pull = 5.0 / 7.0 * G * np.sin(tilt)
    np.testing.assert_allclose(place, [0.5 * pull * time * (time + STEP), 0, RADIUS], atol=1e-7)
    np.testing.assert_allclose(turning, [0, pull * time / RADIUS, 0], rtol=1e-6, atol=1e-6)


def test_a_ball_on_a_steep_slope_slides_and_rotates_slower(scene_of):
    tilt, friction = 0.3, 0.05
    assert np.tan(tilt) > 3.5 * friction
    place, turning = run_down(scene_of, tilt, friction)
    time = STEP * STEPS
    pull = G * (np.sin(tilt) - friction * np.cos(tilt))
    np.testing.assert_allclose(place, [0.5 * pull * time * (time + STEP), 0, RADIUS], atol=1e-7)
    spin = 2.5 * friction * G * np.cos(tilt) / RADIUS
    np.testing.assert_allclose(turning, [0, spin * time, 0], rtol=1e-6, atol=1e-6)


def test_a_ball_without_friction_does_not_rotate(scene_of):
    _, turning = run_down(scene_of, 0.3, 0.0)
    np.testing.assert_array_equal(turning, 0.0)
