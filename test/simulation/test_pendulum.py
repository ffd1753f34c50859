"""Pendulums swing with their closed-form period, the better the shorter the step."""

import numpy as np
import pytest
from scipy.special import ellipk

from softrobot_twin.simulation import Hold

G = 9.81


def period(times, heights):
    """Time between zero crossings of the same direction [s], by lines between samples."""
    down = np.flatnonzero((heights[:-1] > 0.0) & (heights[1:] <= 0.0))
    crossings = times[down] + (times[down + 1] - times[down]) * heights[down] / (
        heights[down] - heights[down + 1]
    )
    return np.diff(crossings).mean()


def swing(simulation, time_step, duration, read):
    """A reading after each step, and its time."""
    count = int(duration / time_step)
    values = [read(simulation.step(Hold(time_step)).state) for _ in range(count)]
    return time_step * np.arange(1, len(values) + 1), np.array(values)


def mass_on_a_string(simulate, angle, length=0.25, mass=0.1, stiffness=1e4):
    """A mass on a string so stiff that it is longer by no more than its weight makes it."""
    at = [length * np.sin(angle), 0.0, -length * np.cos(angle)]
    return simulate(
        mass_springs=[{"name": "bob", "points": [at], "masses": [mass]}],
        springs=[{
            "name": "string", "stiffness": stiffness, "rest_length": length - mass * G / stiffness,
            "ends": [{"on": "bob", "point": at}, {"point": [0, 0, 0]}],
        }],
        integration="dynamic",
    )  # fmt: skip


def test_a_mass_on_a_string_swings_with_the_period_of_small_angles(simulate):
    scene = mass_on_a_string(simulate, angle=0.05)
    times, x = swing(scene, 0.002, 2.2, lambda state: state.positions[0, 0])
    omega = np.sqrt(G / 0.25)
    # Backward Euler is slower by atan(ωh)/ωh.
    slower = np.arctan(0.002 * omega) / (0.002 * omega)
    assert period(times, x) == pytest.approx(2 * np.pi / omega / slower, rel=1e-3)


def test_the_period_of_a_wide_swing_converges_to_the_closed_form(simulate):
    """From 60°: the first half period is longer than at small angles, by an elliptic integral."""
    half = 2.0 * np.sqrt(0.25 / G) * ellipk(np.sin(np.pi / 6) ** 2)
    errors = []
    for time_step in (0.004, 0.002, 0.001):
        scene = mass_on_a_string(simulate, angle=np.pi / 3)
        times, speeds = swing(scene, time_step, 0.75, lambda s: float(s.velocities[0, 0]))
        # It turns back where its speed changes its sign; velocities are those of a step's middle.
        turn = np.flatnonzero((speeds[:-1] < 0.0) & (speeds[1:] >= 0.0))[0]
        share = speeds[turn] / (speeds[turn] - speeds[turn + 1])
        errors.append(times[turn] + share * time_step - 0.5 * time_step - half)
    assert half > 1.07 * np.pi * np.sqrt(0.25 / G)
    # Numerical dissipation reduces the amplitude and so the period: an error of first order.
    assert abs(errors[2]) < 0.01 * half
    ratios = np.array(errors[:-1]) / errors[1:]
    np.testing.assert_allclose(ratios, 2.0, atol=0.4)
