"""Forces between two free bodies are equal and opposite: momentum is conserved to round-off."""

from dataclasses import replace

import numpy as np
import pytest

from softrobot_twin.mechanics.inertia import lumped_masses
from softrobot_twin.simulation import Hold, Simulation
from test.builder import builder
from test.scene_changes import repeat_step

DENSITY = 1000.0


def rigid(name, x, velocity, **more):
    return {"name": name, "mass": 0.03, "position": [x, 0.01 * np.sign(x), 0.003],
            "velocity": velocity, "box": {"size": [0.04] * 3}, **more}  # fmt: skip


def soft(name, file, x):
    place = {"translation": [x, 0, 0], "rotation": [0, 1.3, 0.1]}
    return {"name": name, "mesh": {"file": file, **place},
            "element": "linear",
            "material": {"young_modulus": 1e5, "poisson_ratio": 0.3,
                         "density": DENSITY}}  # fmt: skip


def momentum(simulation: Simulation) -> tuple[np.ndarray, np.ndarray]:
    """Linear [N s] and angular momentum about the origin [N m s] of all bodies."""
    bodies = simulation.model.bodies
    masses = np.concatenate([[], *(lumped_masses(body.mesh, DENSITY) for body in bodies)])
    count = len(masses)
    x, v = simulation.state.positions, simulation.state.velocities
    carried = masses[:, None] * v[:count]
    linear, angular = carried.sum(axis=0), np.cross(x[:count], carried).sum(axis=0)
    for index, part in enumerate(simulation.model.rigid):
        frame = x[part.first_node : part.first_node + 4]
        turned = (frame[1:] - frame[0]).T
        pushed = part.mass * v[count + 2 * index]
        linear = linear + pushed
        spin = turned @ part.inertia @ turned.T @ v[count + 2 * index + 1]
        angular = angular + np.cross(frame[0], pushed) + spin
    return linear, angular


@builder
def collision(scene_of, write_block, /, kinds, friction) -> Simulation:
    """Two bodies, each rigid or soft, that approach each other in zero gravity."""
    file = write_block((0.04, 0.04, 0.02), (4, 4, 2))
    rigids, softs = [], []
    for name, kind, x in (("left", kinds[0], -0.032), ("right", kinds[1], 0.032)):
        if kind == "rigid":
            rigids.append(
                rigid(name, x, [-10.0 * x, 0.05, 0.0], rotation=[0.2, x, 0.1],
                      angular_velocity=[0.0, 0.3, 1.0])
            )  # fmt: skip
        else:
            softs.append(soft(name, file, x))
    simulation = scene_of(
        gravity=[0, 0, 0], integration="dynamic", rigid_bodies=rigids, bodies=softs,
        contact={"friction": friction, "between": [{"pair": ["left", "right"]}]},
    )  # fmt: skip
    velocities = simulation.state.velocities.copy()
    for body in simulation.model.bodies:
        own = slice(body.first_node, body.first_node + body.mesh.node_count)
        x = simulation.state.positions[own].mean(axis=0)
        velocities[own] = [-10.0 * x[0], 0.0, 0.1]
    simulation.restore(replace(simulation.state, velocities=velocities))
    return simulation


@pytest.mark.sampled
@pytest.mark.parametrize("friction", [0.0, 0.5])
@pytest.mark.parametrize(
    "kinds", [("rigid", "rigid"), ("rigid", "soft"), ("soft", "soft")], ids="-".join
)
def test_a_collision_keeps_momentum(collision, kinds, friction):
    lost = []
    for step in (0.002, 0.001):
        simulation = collision(kinds, friction)
        linear, angular = momentum(simulation)
        touched = 0
        for _ in range(int(0.1 / step)):
            result = simulation.step(Hold(step))
            touched += result.report.contact_count
        assert touched > 0
        after = momentum(simulation)
        scale = np.linalg.norm(linear) + 0.03 * 0.3
        np.testing.assert_allclose(after[0], linear, atol=1e-12 * scale)
        lost.append(np.abs(after[1] - angular).max() / (0.02 * scale))
    # Rows and inertia are linear in a step's turn: some of the turning is lost, little at 1 ms.
    assert max(lost) < 0.02 and lost[1] < 0.006


def test_friction_on_a_sliding_block_opposes_its_motion(scene_of):
    for angle in np.linspace(0.0, 6.0, 7):
        way = np.array([np.cos(angle), np.sin(angle), 0.0])
        simulation = scene_of(
            integration="dynamic", obstacles=[{"name": "floor", "plane": {}}],
            rigid_bodies=[{"name": "box", "mass": 0.03, "position": [0, 0, 0.005],
                           "velocity": list(0.5 * way), "box": {"size": [0.08, 0.08, 0.01]}}],
            contact={"friction": 0.4, "between": [{"pair": ["box", "floor"]}]},
        )  # fmt: skip
        result = repeat_step(simulation, Hold(0.002), 5)
        total = result.contacts.forces.sum(axis=0)
        np.testing.assert_allclose(total[:2], -0.4 * total[2] * way[:2], rtol=1e-3, atol=1e-4)
