"""Contact made and lost, found again after a reset, reported if it was not solved."""

import numpy as np
import pytest

from softrobot_twin.simulation import CommandSetpoints, FollowTargets, Hold, Simulation, Status
from test.builder import builder
from test.scene_changes import solved

STEP = 0.01
MATERIAL = {"young_modulus": 1e5, "poisson_ratio": 0.3, "density": 1000.0}


@builder
def finger(scene_of, write_block, /, integration="quasi_static", friction=0.4, **contact) -> Simulation:
    """A bar on a wall, with a cable below that pulls it against an obstacle."""
    return scene_of(
        gravity=[0, 0, 0], integration=integration,
        body={"name": "bar",
              "mesh": {"file": write_block((0.1, 0.02, 0.02), (10, 2, 2)),
                       "translation": [0.05, 0, 0]},
              "element": "linear",
              "material": MATERIAL, "damping": {"mass": 40.0},
              "fixed": [{"box": {"minimum": [-1, -1, -1], "maximum": [1e-6, 1, 1]}}]},
        cables=[{"name": "cable", "pull_point": [-0.01, 0, -0.007],
                 "points": [[x, 0, -0.007] for x in (0.01, 0.03, 0.05, 0.07, 0.095)],
                 "shortening": [0.0, 0.03], "tension": [0.0, 50.0]}],
        effectors=[{"name": "tip", "points": [[0.1, 0, 0]]}],
        obstacles=[{"name": "table", "position": [0, 0, -0.02], "plane": {}}],
        contact={"friction": friction, "between": [{"pair": ["bar", "table"]}], **contact},
        solver={"newton_iterations": 3},
    )  # fmt: skip


def wind(simulation, shortening, steps):
    for _ in range(steps):
        result = simulation.step(CommandSetpoints(simulation.rest_setpoints - shortening, STEP))
        assert result.status in (Status.OK, Status.LINEARIZED, Status.NOT_CONVERGED)
    return result


@pytest.mark.parametrize("friction", [0.0, 0.4])
def test_contact_is_made_and_lost_without_a_remaining_force(finger, friction):
    simulation = finger(friction=friction)
    free = wind(simulation, 0.0, 3)
    assert free.report.contact_count == 0 and len(free.contacts.forces) == 0
    pressed = wind(simulation, 0.006, 20)
    assert pressed.status is Status.OK
    total = pressed.contacts.forces.sum(axis=0)
    assert pressed.report.contact_count > 0 and total[2] > 0.02
    assert pressed.state.positions[:, 2].min() == pytest.approx(-0.02, abs=1e-7)
    assert pressed.contacts.names == (("bar", "table"),)
    np.testing.assert_allclose(pressed.contacts.positions[:, 2], -0.02, atol=1e-6)
    back = wind(simulation, 0.0, 20)
    assert back.report.contact_count == 0
    rest = simulation.model.nodes.rest_positions
    np.testing.assert_allclose(back.state.positions, rest, atol=1e-8)


def test_dynamic_and_quasi_static_contact_forces_agree(finger):
    statics = wind(finger(friction=0.0), 0.006, 40)
    dynamics = wind(finger("dynamic", friction=0.0), 0.006, 300)
    first_order = wind(finger("first_order", friction=0.0), 0.006, 300)
    force = statics.contacts.forces.sum(axis=0)
    assert force[2] > 0.02
    for other in (dynamics, first_order):
        np.testing.assert_allclose(other.state.positions, statics.state.positions, atol=2e-6)
        np.testing.assert_allclose(other.contacts.forces.sum(axis=0), force, atol=2e-3 * force[2])
        np.testing.assert_allclose(other.efforts, statics.efforts, rtol=2e-3)


@pytest.mark.exhaustive
def test_contact_forces_do_not_depend_on_the_time_step(finger):
    found = []
    for step in (1e-3, 1e-2, 1.0):
        simulation = finger("dynamic", friction=0.0)
        for _ in range(int(2.0 / step) if step < 1.0 else 30):
            result = simulation.step(CommandSetpoints(simulation.rest_setpoints - 0.006, step))
        found.append((result.contacts.forces.sum(axis=0), result.efforts[0]))
    for force, tension in found[1:]:
        np.testing.assert_allclose(force, found[0][0], atol=1e-3 * found[0][0][2])
        assert tension == pytest.approx(found[0][1], rel=1e-3)


def test_unsolved_contacts_are_reported(finger):
    simulation = finger(most_sweeps=1, tolerance=1e-14)
    unsolved = []
    for _ in range(12):
        result = simulation.step(CommandSetpoints(simulation.rest_setpoints - 0.008, STEP))
        if result.status is Status.NOT_CONVERGED:
            unsolved.append(result.report)
    assert unsolved
    worst = max(unsolved, key=lambda report: report.contact_residual)
    assert worst.contact_sweeps == 1
    # In metres and in newtons, and within the size of the thing.
    assert 1e-14 < worst.contact_residual < 0.1
    assert 0.0 < worst.contact_force_residual < 50.0


def test_a_target_where_the_effector_is_keeps_the_grip(finger):
    simulation = finger()
    pressed = wind(simulation, 0.006, 20)
    for _ in range(20):
        followed = simulation.step(FollowTargets(pressed.effector_positions, STEP))
    assert followed.status is Status.OK and followed.report.contact_count
    np.testing.assert_allclose(followed.effector_positions, pressed.effector_positions, atol=1e-5)


def test_holding_keeps_the_grip(finger):
    simulation = finger()
    pressed = wind(simulation, 0.006, 20)
    for _ in range(100):
        held = solved(simulation, Hold(STEP))
    np.testing.assert_allclose(held.state.positions, pressed.state.positions, atol=1e-6)
    np.testing.assert_allclose(held.efforts, pressed.efforts, rtol=1e-3)
