"""A soft pad dragged over a plane: the cone of friction holds for µ = 0 and for µ = 10."""

import numpy as np
import pytest

from softrobot_twin.simulation import Hold, Simulation, Status

STEP = 0.004
PRESSED = [0.0, 0.0, 0.0290]


def pad(scene_of, write_block, friction) -> Simulation:
    """A block of 20 mm, its top on a guided plate."""
    return scene_of(
        gravity=[0, 0, 0], integration="dynamic",
        body={
            "name": "pad",
            "mesh": {"file": write_block((0.04, 0.04, 0.02), (4, 4, 2)),
                     "translation": [0, 0, 0.01]},
            "element": "linear",
            "material": {"young_modulus": 1e5, "poisson_ratio": 0.3, "density": 1000.0},
            "damping": {"mass": 5.0},
            "attached": [{"to": "plate", "box": {"minimum": [-1, -1, 0.0199],
                                                 "maximum": [1, 1, 1]}}],
        },
        rigid_bodies=[{"name": "plate", "motion": "guided", "speed": 0.05,
                       "position": [0, 0, 0.03], "box": {"size": [0.05, 0.05, 0.02]}}],
        obstacles=[{"name": "floor", "plane": {}}],
        contact={"friction": friction, "between": [{"pair": ["pad", "floor"]}]},
    )  # fmt: skip


def drag(simulation, to, steps, friction, most_unsolved=0):
    """Move the plate; forces must be in the cone in every step, also where it is not converged."""
    simulation.model.guides.aim("plate", to)
    unsolved = 0
    for _ in range(steps):
        result = simulation.step(Hold(STEP))
        unsolved += not result.status.is_success
        assert result.status in (Status.OK, Status.LINEARIZED, Status.NOT_CONVERGED)
        force = result.contacts.forces
        assert np.all(force[:, 2] > 0.0)
        excess = np.linalg.norm(force[:, :2], axis=1) - friction * force[:, 2]
        assert excess.max(initial=0.0) < 1e-12
    assert unsolved <= most_unsolved
    return result


def test_without_friction_the_pad_is_not_dragged(scene_of, write_block):
    simulation = pad(scene_of, write_block, 0.0)
    pressed = drag(simulation, PRESSED, 60, 0.0)
    dragged = drag(simulation, [0.02, 0.0, 0.0290], 140, 0.0)
    total = dragged.contacts.forces.sum(axis=0)
    np.testing.assert_allclose(total[:2], 0.0, atol=1e-12)
    assert total[2] == pytest.approx(pressed.contacts.forces.sum(axis=0)[2], rel=2e-6)
    # The pad moved as it is, undistorted.
    change = dragged.state.positions - pressed.state.positions
    np.testing.assert_allclose(change, np.tile([0.02, 0, 0], (len(change), 1)), atol=1e-8)


def test_with_great_friction_the_pad_shears_and_sticks(scene_of, write_block):
    simulation = pad(scene_of, write_block, 10.0)
    pressed = drag(simulation, PRESSED, 60, 10.0)
    # Coulomb's problem of so much friction may have no solution while corners lift off.
    dragged = drag(simulation, [0.004, 0.0, 0.0290], 60, 10.0, most_unsolved=4)
    sole = simulation.model.nodes.rest_positions[:, 2] < 1e-9
    inside = sole & (np.abs(pressed.state.positions[:, :2]).max(axis=1) < 0.015)
    change = (dragged.state.positions - pressed.state.positions)[inside]
    # Sticking, except for the slip of unconverged steps, of 4 mm displacement of the top.
    assert np.abs(change).max() < 2.5e-5
    total = dragged.contacts.forces.sum(axis=0)
    assert abs(total[0]) < 10.0 * total[2] and total[0] < -1.0


def test_a_dragged_pad_is_resisted_by_friction_times_load(scene_of, write_block):
    simulation = pad(scene_of, write_block, 0.5)
    drag(simulation, PRESSED, 60, 0.5)
    for way, direction in (([0.03, 0.0, 0.0290], [-1, 0]), ([0.03, 0.03, 0.0290], [0, -1])):
        result = drag(simulation, way, 200, 0.5)
        if direction == [-1, 0]:
            # While it slides on, along x only.
            simulation.model.guides.aim("plate", [0.06, 0.0, 0.0290])
        else:
            simulation.model.guides.aim("plate", [0.06, 0.06, 0.0290])
        result = simulation.step(Hold(STEP))
        total = result.contacts.forces.sum(axis=0)
        assert np.linalg.norm(total[:2]) <= 0.5 * total[2] + 1e-12
        assert total[:2] @ direction > 0.4975 * total[2]
