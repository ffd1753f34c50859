"""Facts of robots whose cables act between patches of many nodes."""

from pathlib import Path

import numpy as np
import pytest

from softrobot_twin.analysis.apparent_compliance import apparent_compliance
from softrobot_twin.constraints import cable
from softrobot_twin.scene import load_scene
from softrobot_twin.simulation import CommandSetpoints, FollowTargets, Simulation
from softrobot_twin.simulation.building.limits import efforts_at_scale
from softrobot_twin.simulation.scene_warnings import linear_sag
from softrobot_twin.solvers.dense_stiffness import DenseStiffness

FINGER = Path(__file__).resolve().parents[2] / "config" / "scenes" / "finger.yaml"


@pytest.fixture
def fingers(monkeypatch):
    """The Finger with its cables' stiffness as blocks, and as dense rows."""
    scene = load_scene(FINGER)
    with monkeypatch.context() as patched:
        patched.setattr(cable, "MOST_COUPLED", 10**6)
        blocks = Simulation(scene)
    return blocks, Simulation(scene)


def test_a_finger_moves_as_with_all_blocks(fingers, drawn_rng):
    blocks, rows = fingers
    assert isinstance(rows.model.factorization, DenseStiffness)
    assert not isinstance(blocks.model.factorization, DenseStiffness)
    for k in range(12):
        wound = 0.004 * k * drawn_rng.uniform(0.2, 1.0, 2)
        command = CommandSetpoints(rows.rest_setpoints - wound, 0.02)
        results = [simulation.step(command) for simulation in fingers]
        assert results[0].status == results[1].status
        np.testing.assert_allclose(rows.state.positions, blocks.state.positions, atol=1e-9)
        np.testing.assert_allclose(rows.state.efforts, blocks.state.efforts, atol=1e-6)


def test_its_targets_are_followed_as_with_all_blocks(fingers):
    blocks, rows = fingers
    rest = rows.effector_positions()
    for k in range(20):
        target = rest + [[0.0, 0.01 * np.sin(0.2 * k), 0.015 * (1.0 - np.cos(0.2 * k))]]
        for simulation in fingers:
            simulation.step(FollowTargets(target, 0.02))
        np.testing.assert_allclose(rows.state.positions, blocks.state.positions, atol=1e-8)


def test_by_the_augmented_tangent_it_comes_to_the_same_rest(fingers):
    ends, augmented = [], []
    for simulation in fingers:
        count = 0
        for k in range(60):
            wound = np.array([min(0.0015 * k, 0.06), min(0.0012 * k, 0.05)])
            simulation.newton.tangent.take_augmented_tangent()
            simulation.step(CommandSetpoints(simulation.rest_setpoints - wound, 0.05))
            count += simulation.newton.tangent.is_augmented
        augmented.append(count)
        ends.append(simulation.state.positions.copy())
    assert min(augmented) > 20
    assert np.isfinite(ends).all()
    np.testing.assert_allclose(ends[1], ends[0], atol=1e-8)


def test_the_tip_yields_as_with_all_blocks(fingers):
    for simulation in fingers:
        for _ in range(6):
            simulation.step(CommandSetpoints(simulation.rest_setpoints - [0.01, 0.004], 0.05))
    found = [apparent_compliance(simulation) for simulation in fingers]
    np.testing.assert_allclose(found[1].compliance, found[0].compliance, rtol=1e-7, atol=1e-12)
    np.testing.assert_allclose(found[1].jacobian, found[0].jacobian, rtol=1e-7, atol=1e-9)


def test_the_sag_is_that_without_pulls(fingers):
    blocks, rows = fingers
    sag = linear_sag(blocks.model)
    assert linear_sag(rows.model) == pytest.approx(sag, rel=1e-9)
    rows.step(CommandSetpoints(0.2 * rows.limits.setpoint_range(rows.rest_setpoints)[1], 0.02))
    assert linear_sag(rows.model) == pytest.approx(sag, rel=1e-9)


def test_what_is_assembled_after_steps_has_no_rows_of_their_efforts(fingers):
    _, rows = fingers
    model = rows.model
    expected = efforts_at_scale(model, model.actuators.terms[0])
    for _ in range(4):
        rows.step(CommandSetpoints(rows.rest_setpoints - [0.01, 0.004], 0.05))
    assert len(model.rows.terms[0].dense_rows.stiffness) > 0
    np.testing.assert_array_equal(efforts_at_scale(model, model.actuators.terms[0]), expected)
