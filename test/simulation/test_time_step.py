"""Rows 33 and 41: the time step and the kind of motion change neither equilibrium nor forces."""

from dataclasses import replace

import numpy as np
import pytest

from softrobot_twin.simulation import CommandEfforts, CommandSetpoints, Hold, Status
from test.builder import builder

HELD = [{"box": {"minimum": [-1, -1, -1e-6], "maximum": [1, 1, 1e-6]}}]
STEPS = {1e-4: 600, 1e-3: 150, 1e-2: 60, 0.1: 30, 1.0: 20}
"""Enough of each to settle; a body of 2 cm and 1e6 Pa swings in some 8 ms."""


@builder
def finger(simulate, body_of, block, /, integration):
    """Makes a small bent finger with a cable, heavily braked."""
    mesh = block(size=(0.01, 0.01, 0.02), cells=(1, 1, 2))
    body = body_of(mesh, young_modulus=1e6, fixed=HELD, damping={"mass": 1000.0})
    cable = {
        "name": "tendon", "pull_point": [0.012, 0.005, -0.005],
        "points": [[0.01, 0.005, 0.005], [0.01, 0.005, 0.015]],
        "shortening": [-0.01, 0.01], "tension": [0.0, 50.0],
    }  # fmt: skip
    return simulate(body=body, cables=[cable], integration=integration)


def settled(scene, command_of, time_step, count):
    for _ in range(count):
        result = scene.step(command_of(time_step))
    assert result.status is Status.OK
    return result


def reference(finger, command_of):
    """The statics of the same scene."""
    result = settled(finger("quasi_static"), command_of, 0.1, 10)
    assert result.report.residual < 1e-9
    return result


@pytest.mark.sampled
@pytest.mark.parametrize("integration", ["first_order", "dynamic"])
@pytest.mark.parametrize("time_step", STEPS)
def test_a_pulled_finger_settles_at_the_static_equilibrium_of_its_tension(finger, integration, time_step):
    scene = finger(integration)
    lengths = scene.rest_setpoints - 0.001

    def wind(duration):
        return CommandSetpoints(lengths, duration)

    expected = reference(finger, wind)
    assert expected.efforts[0] > 1.0
    result = settled(scene, wind, time_step, STEPS[time_step])
    np.testing.assert_allclose(result.state.positions, expected.state.positions, atol=1e-8)
    np.testing.assert_allclose(result.efforts, expected.efforts, rtol=1e-5)
    np.testing.assert_allclose(result.state.velocities, 0.0, atol=1e-5)


@pytest.mark.sampled
@pytest.mark.parametrize("integration", ["first_order", "dynamic"])
@pytest.mark.parametrize("time_step", [1e-4, 1e-2, 1.0])
def test_a_tension_gives_the_same_length_at_any_rate(finger, integration, time_step):
    scene = finger(integration)

    def pull(duration):
        return CommandEfforts(np.array([2.0]), duration)

    expected = reference(finger, pull)
    result = settled(scene, pull, time_step, STEPS[time_step])
    assert result.efforts[0] == pytest.approx(2.0, rel=1e-9)
    np.testing.assert_allclose(result.displacements, expected.displacements, atol=1e-8)
    np.testing.assert_allclose(result.state.positions, expected.state.positions, atol=1e-8)


@pytest.mark.parametrize("integration", ["first_order", "dynamic"])
@pytest.mark.parametrize("time_step", STEPS)
def test_an_equilibrium_does_not_depend_on_the_time_step(finger, integration, time_step):
    """From the first step on: no force is an impulse in disguise."""
    scene = finger(integration)
    static = finger("quasi_static")
    lengths = static.rest_setpoints - 0.001
    expected = settled(static, lambda h: CommandSetpoints(lengths, h), 0.1, 10)
    scene.restore(replace(expected.state, velocities=np.zeros_like(scene.state.velocities)))
    for _ in range(5):
        result = scene.step(Hold(time_step))
        np.testing.assert_allclose(result.efforts, expected.efforts, rtol=1e-6)
        np.testing.assert_allclose(result.state.positions, expected.state.positions, atol=1e-9)


def test_a_moving_finger_s_tension_converges_as_the_time_step_shrinks(finger):
    """While its cable is shortened at a constant speed, after half the time."""
    found = []
    for count in (20, 40, 80, 160):
        scene = finger("dynamic")
        for index in range(count):
            wound = 0.001 * (index + 1) / count
            result = scene.step(CommandSetpoints(scene.rest_setpoints - wound, 0.02 / count))
        found.append(result.efforts[0])
    differences = np.abs(np.diff(found))
    assert differences[0] < 0.1 * found[-1]
    assert np.all(differences[1:] < 0.75 * differences[:-1])
