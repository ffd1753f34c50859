"""How effectors curve, learnt from moves."""

import numpy as np
import pytest

from softrobot_twin.simulation import CommandSetpoints
from softrobot_twin.simulation.step.curvature import Curvature, jacobian_by_drives
from softrobot_twin.simulation.step.time_budget import StageClock
from test.scene_changes import repeat_step

SCALES = np.array([0.01, 2.0, 0.5])


@pytest.fixture
def bent(drawn_rng):
    """Misses w r whose curvature S is positive definite, J of places, and S, of places quadratic in three drives."""
    pull, first = drawn_rng.standard_normal(4), drawn_rng.standard_normal((4, 3)) / SCALES
    second = drawn_rng.standard_normal((4, 3, 3))
    second += second.transpose(0, 2, 1)
    root = drawn_rng.standard_normal((3, 3))
    second -= np.tensordot(pull, np.tensordot(pull, second, 1) - root @ root.T - np.eye(3), 0) / (pull @ pull)
    second /= np.outer(SCALES, SCALES)
    return pull, lambda drives: first + second @ drives, np.tensordot(pull, second, 1)


def learnt(bent, moves) -> Curvature:
    """What places from where each move begins teach."""
    pull, jacobian, _ = bent
    curvature = Curvature(SCALES)
    for drives in np.cumsum([np.zeros(3), *moves], axis=0):
        curvature.learn(drives, jacobian(drives), pull, b"")
    return curvature


def test_moves_of_each_drive_teach_the_whole_curvature(bent):
    curvature = learnt(bent, np.diag(0.1 * SCALES))
    scaled = np.outer(SCALES, SCALES)
    np.testing.assert_allclose(scaled * (curvature.rows.T @ curvature.rows), scaled * bent[2], atol=1e-9)
    move = np.array([0.002, -0.3, 0.1])
    assert curvature.rise(move) == pytest.approx(0.5 * move @ bent[2] @ move)


def test_curvature_is_used_only_where_it_told_better_what_came_of_a_move(bent):
    curvature = learnt(bent, np.diag(0.1 * SCALES))
    assert not curvature.is_used
    curvature.compare(decrease=0.4, promised=1.0, rise=0.5)
    assert curvature.is_used
    curvature.compare(decrease=0.9, promised=1.0, rise=0.5)
    assert not curvature.is_used


def test_curvature_vanishes_with_the_misses_and_learns_from_no_leap(bent):
    pull, jacobian, _ = bent
    curvature, move = learnt(bent, np.diag(0.1 * SCALES)), 0.1 * SCALES
    whole = curvature.rise(move)
    for drives in 2 * (np.zeros(3), move):
        curvature.learn(drives, jacobian(drives), 1e-3 * pull, b"")
    # Where other actuators bear, J leaps, and that is no curvature.
    curvature.learn(-move, jacobian(-9.0 * move), 1e-3 * pull, b"other")
    assert curvature.rise(move) == pytest.approx(1e-3 * whole, rel=1e-6)


def test_j_by_drives_agrees_with_differences(beam):
    simulation = beam(lambda m: m["solver"].update(newton_iterations=20, residual_tolerance=1e-10))

    def places(shortenings):
        command = CommandSetpoints(simulation.actuators.setpoints(shortenings), 1.0)
        return repeat_step(simulation, command, 12).effector_positions.ravel()

    setpoints = np.array([0.008, 0.004, 0.0, 0.0])
    places(setpoints)
    state, bears = simulation.state, simulation.state.efforts > 1e-6
    linear = simulation.newton.linearize(state.positions.copy(), state.efforts, StageClock())
    J = jacobian_by_drives(linear.W, linear.groups.effectors, bears, bears, np.zeros(4))
    assert bears.any()
    for cable in np.flatnonzero(bears):
        step = 1e-6 * np.eye(4)[cable]
        difference = (places(setpoints + step) - places(setpoints - step)) / 2e-6
        np.testing.assert_allclose(J[:, cable], difference, rtol=0.0, atol=1e-5 * np.abs(J).max())
