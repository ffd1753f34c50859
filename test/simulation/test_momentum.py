"""Without external forces momentum and angular momentum are conserved."""

from dataclasses import replace

import numpy as np
import pytest

from softrobot_twin.simulation import Hold, Status
from test.scene_changes import repeat_step

TURNING = np.array([2.0, -1.0, 3.0])
MOVING = np.array([0.1, 0.05, -0.02])


def masses_of(simulation):
    """The lumped mass of every free node [kg]."""
    return next(term for term in simulation.model.forces if term.name == "lumped inertia").masses


def thrown(simulation, stretch=1.0):
    """Stretch a free soft body along z, and let it go turning and moving."""
    rest = simulation.model.nodes.rest_positions
    positions = rest * [1.0, 1.0, stretch]
    arms = positions - masses_of(simulation) @ positions / masses_of(simulation).sum()
    velocities = MOVING + np.cross(TURNING, arms)
    simulation.restore(replace(simulation.state, positions=positions, velocities=velocities))
    return simulation


def momenta(simulation):
    """Momentum [kg m/s] and angular momentum about the origin [N m s] of a free soft body."""
    masses, state = masses_of(simulation), simulation.state
    return masses @ state.velocities, masses @ np.cross(state.positions, state.velocities)


@pytest.fixture
def soft(simulate, body_of, block):
    """A free soft body that no weight pulls."""
    mesh = block(size=(0.04, 0.05, 0.08), cells=(1, 1, 2))
    return simulate(body=body_of(mesh), integration="dynamic", gravity=[0, 0, 0],
                    solver={"newton_iterations": 40, "residual_tolerance": 1e-12})  # fmt: skip


def test_a_soft_body_keeps_its_momentum_exactly(soft):
    thrown(soft, stretch=1.1)
    before, _ = momenta(soft)
    repeat_step(soft, Hold(0.005), 20)
    np.testing.assert_allclose(momenta(soft)[0], before, rtol=0, atol=1e-10 * np.abs(before).max())


def test_a_soft_body_s_angular_momentum_error_is_proportional_to_the_time_step(soft):
    errors = []
    for count in (16, 32, 64):
        soft.reset()
        thrown(soft)
        before = momenta(soft)[1]
        repeat_step(soft, Hold(0.08 / count), count)
        errors.append(np.linalg.norm(momenta(soft)[1] - before) / np.linalg.norm(before))
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert errors[-1] < 0.05
    np.testing.assert_allclose(orders, 1.0, atol=0.15)


@pytest.mark.parametrize("element", ["linear", "smoothed", "quadratic"])
def test_a_body_of_consistent_mass_keeps_its_momentum_while_it_deforms(simulate, body_of, block, element):
    body = body_of(
        block(size=(0.04, 0.05, 0.08), cells=(1, 1, 2)), element=element, mass="consistent",
        damping={"stiffness": 0.002},
    )  # fmt: skip
    scene = simulate(body=body, integration="dynamic", gravity=[0, 0, 0],
                     solver={"newton_iterations": 40, "residual_tolerance": 1e-12})  # fmt: skip
    inertia = next(term for term in scene.model.forces if term.name == "consistent inertia")
    rest = scene.model.nodes.rest_positions
    velocities = MOVING + np.cross(TURNING, rest)
    stretched = rest * [1.0, 1.0, 1.1]
    scene.restore(replace(scene.state, positions=stretched, velocities=velocities))
    before = inertia.momentum(scene.state.velocities)
    moved = []
    for _ in range(20):
        state = scene.step(Hold(0.005)).state
        after = inertia.momentum(state.velocities)
        np.testing.assert_allclose(after, before, rtol=0, atol=1e-9 * np.abs(before).max())
        moved.append(np.ptp(state.positions[:, 2]))
    # Meanwhile it shortens, and turns.
    assert min(moved) < 0.082


def test_viscosity_changes_angular_momentum_by_a_time_step_error_only(simulate, body_of, block):
    """A strained body that turns while it creeps back: backward Euler's error, first order in h.

    It loses no more of it than later, when it is strained no more.
    """
    lost, lost_later = [], []
    for count in (20, 40, 80):
        body = body_of(block(size=(0.04, 0.05, 0.08), cells=(1, 1, 2)), damping={"stiffness": 0.01})
        scene = simulate(body=body, integration="dynamic", gravity=[0, 0, 0],
                         solver={"newton_iterations": 40, "residual_tolerance": 1e-12})  # fmt: skip
        thrown(scene, stretch=1.02)
        found = [momenta(scene)[1]]
        for _ in range(2):
            repeat_step(scene, Hold(0.06 / count), count)
            found.append(momenta(scene)[1])
        for losses, before, after in ((lost, *found[:2]), (lost_later, *found[1:])):
            losses.append(np.linalg.norm(after - before) / np.linalg.norm(before))
    np.testing.assert_allclose(np.log2(np.array(lost[:-1]) / lost[1:]), 1.0, atol=0.15)
    np.testing.assert_allclose(lost, lost_later, rtol=0.05)
    assert lost[-1] < 1e-3


def test_a_rigid_body_too_fast_for_its_step_is_reported_and_stays_rigid(simulate):
    """It turns by some radians a step, far beyond what a linearization sees."""
    scene = simulate(
        rigid_bodies=[{"name": "box", "box": {"size": [0.02, 0.05, 0.09]}, "density": 1000.0,
                       "angular_velocity": [200.0, 300.0, -100.0]}],
        integration="dynamic", gravity=[0, 0, 0],
    )  # fmt: skip
    inertia = next(term for term in scene.model.forces if term.name == "rigid inertia")
    energy = inertia.kinetic_energy(scene.state.positions, scene.state.velocities)
    statuses = set()
    for _ in range(20):
        result = scene.step(Hold(0.01))
        statuses.add(result.status)
        after = inertia.kinetic_energy(result.state.positions, result.state.velocities)
        assert after < energy
        assert np.isfinite(result.state.positions).all()
        frame = result.state.positions[1:4] - result.state.positions[0]
        np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-12)
    assert Status.NOT_CONVERGED in statuses
