"""The Flexo: an arm of beams and hubs with soft fingers, driven by cables over all of them."""

import numpy as np
import pytest

from softrobot_twin.simulation import CommandSetpoints, FollowTargets, Simulation
from test.places import SCENES

HEIGHT, CLOSING, STEP = -0.82, 0.010, 0.05
ARM, HAND = slice(0, 9), slice(9, 12)


@pytest.fixture(scope="module")
def flexo():
    return Simulation.from_scene_file(SCENES / "flexo.yaml")


def place(radius, angle):
    return np.array([radius * np.cos(angle), radius * np.sin(angle), HEIGHT])


def follow(flexo, begin, end, lengths, steps, time_step=STEP):
    """Leads the tip from a place to another while the hand's cables go to lengths [m]."""
    at = flexo.state.setpoints[HAND].copy()
    for share in np.arange(1, steps + 1) / steps:
        commanded = np.full(12, np.nan)
        commanded[HAND] = at + share * (lengths - at)
        target = begin + share * (end - begin)
        flexo.step(FollowTargets(target[None], time_step, commanded))
    return np.linalg.norm(flexo.effector_positions()[0] - end)


def bend(flexo, radius, angle):
    """The arm bent, its hand open and the hand's cables just tight."""
    flexo.reset()
    lengths = flexo.rest_setpoints[HAND]
    begin, end = flexo.effector_positions()[0].copy(), place(radius, angle)
    follow(flexo, begin, end, lengths, 60)
    assert follow(flexo, end, end, lengths, 10) < 1e-5
    group = flexo.actuators.groups[0]
    paths = group.kind.paths(group, flexo.state.positions)[HAND]
    tight = np.array([np.linalg.norm(np.diff(path, axis=0), axis=1).sum() for path in paths])
    assert follow(flexo, end, end, np.minimum(tight, lengths), 20) < 1e-5
    return end


def tip_error_with_the_arm_held(flexo, target):
    held = flexo.state.setpoints.copy()
    for share in np.minimum(1.0, np.arange(1, 31) / 20):
        lengths = held.copy()
        lengths[HAND] -= share * CLOSING
        flexo.step(CommandSetpoints(lengths, STEP))
    return np.linalg.norm(flexo.effector_positions()[0] - target)


def test_closing_the_hand_loads_the_arm_and_the_inverse_corrects_it(flexo):
    for angle in (np.pi / 2, np.pi):
        target = bend(flexo, 0.06, angle)
        bent = flexo.state
        moved = tip_error_with_the_arm_held(flexo, target)
        assert flexo.state.efforts[HAND].min() > 0.15
        flexo.restore(bent)
        corrected = follow(flexo, target, target, bent.setpoints[HAND] - CLOSING, 40)
        assert flexo.state.efforts[HAND].min() > 0.15
        assert moved > 3e-3 and corrected < 1e-5


@pytest.mark.parametrize("radius", [0.1])
def test_the_tip_follows_a_circle_at_100_hz(flexo, radius):
    start = bend(flexo, radius, 0.0)
    lengths = flexo.rest_setpoints[HAND] - 0.02
    follow(flexo, start, start, lengths, 20)
    errors = []
    for angle in np.linspace(0.0, 2.0 * np.pi, 200):
        target = place(radius, angle)
        errors.append(follow(flexo, target, target, lengths, 1, 0.01))
    assert max(errors) < 2e-4


@pytest.mark.exhaustive
def test_the_softer_device_is_some_millimetres_off_and_converges(flexo):
    device = Simulation.from_scene_file(SCENES / "flexo_device.yaml")
    target = bend(flexo, 0.06, 0.5)
    twin = flexo.state.setpoints
    begin = device.rest_setpoints.copy()
    for share in np.minimum(1.0, np.arange(1, 41) / 30):
        result = device.step(CommandSetpoints(begin + share * (twin - flexo.rest_setpoints), STEP))
    assert not result.status.is_failure and result.report.residual < 1e-3
    off = np.linalg.norm(device.effector_positions()[0] - target)
    assert 1e-4 < off < 8e-3
