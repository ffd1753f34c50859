"""Bodies that rest on or fall onto each other: contact forces equal the weight, without jitter."""

import itertools

import numpy as np
import pytest

from softrobot_twin.mechanics.inertia import lumped_masses
from softrobot_twin.simulation import Hold
from test.scene_changes import repeat_step

G, STEP = 9.81, 0.004
MASS, EDGE = 0.03, 0.04
MATERIAL = {"young_modulus": 1.0e5, "poisson_ratio": 0.3, "density": 1000.0}
CORNERS = 0.5 * EDGE * np.array(list(itertools.product((-1.0, 1.0), repeat=3)))


def cube(name="box", **more):
    return {"name": name, "mass": MASS, "box": {"size": [EDGE] * 3}, **more}


def soft(write_block, **place):
    return {
        "name": "box", "mesh": {"file": write_block((0.04, 0.04, 0.02), (4, 4, 2)), **place},
        "element": "linear",
        "material": MATERIAL, "damping": {"mass": 20.0},
    }  # fmt: skip


def lying(scene_of, friction=0.5, tolerance=1e-10, **bodies):
    return scene_of(
        integration="dynamic", obstacles=[{"name": "floor", "plane": {}}],
        contact={"friction": friction, "tolerance": tolerance,
                 "between": [{"pair": ["box", "floor"]}]},
        **bodies,
    )  # fmt: skip


@pytest.mark.sampled
@pytest.mark.parametrize("friction", [0.0, 0.5])
@pytest.mark.parametrize("kind", ["rigid", "soft"])
def test_the_contact_forces_on_a_resting_body_equal_its_weight_and_it_stays(
    scene_of, write_block, kind, friction
):
    if kind == "rigid":
        bodies = {"rigid_bodies": [cube(position=[0, 0, EDGE / 2])]}
        weight, settling = MASS * G, 1
    else:
        bodies = {"body": soft(write_block, translation=[0, 0, 0.01])}
        weight, settling = 0.04 * 0.04 * 0.02 * 1000.0 * G, 300
    simulation = lying(scene_of, friction, **bodies)
    repeat_step(simulation, Hold(STEP), settling)
    start = simulation.state.positions
    for _ in range(1000):
        result = simulation.step(Hold(STEP))
        assert result.status.is_success
        force = result.contacts.forces.sum(axis=0)
        np.testing.assert_allclose(force, [0.0, 0.0, weight], atol=3e-6 * weight)
        # No faster than what the solver's tolerance leaves: 1e-10 m a step, turning on an
        # arm of 20 mm.
        assert np.abs(result.state.velocities).max() < 1e-10 / STEP / (EDGE / 2)
    # Frames of rigid bodies have arms of a metre, so a turn shows there.
    assert np.abs(result.state.positions - start).max() < 1e-8


@pytest.mark.sampled
@pytest.mark.parametrize("step", [0.001, 0.01])
@pytest.mark.parametrize("friction", [0.0, 0.5])
def test_a_dropped_cube_gains_no_energy_and_comes_to_rest(scene_of, friction, step):
    simulation = lying(
        scene_of, friction, 1e-8,
        rigid_bodies=[cube(position=[0, 0, 0.08], rotation=[0.3, 0.4, 0.0])],
    )  # fmt: skip
    moment = MASS * EDGE**2 / 6.0
    energy, lowest = [MASS * G * 0.08], 1.0
    for _ in range(int(0.6 / step)):
        result = simulation.step(Hold(step))
        frame, v = result.state.positions, result.state.velocities
        kinetic = 0.5 * MASS * (v[0] @ v[0]) + 0.5 * moment * (v[1] @ v[1])
        energy.append(kinetic + MASS * G * frame[0, 2])
        lowest = min(lowest, (frame[0] + CORNERS @ (frame[1:] - frame[0]))[:, 2].min())
        assert result.status.is_success
    # Up to the work of its weight over the contact solver's tolerance.
    assert np.diff(energy).max() < MASS * G * 1e-8
    assert energy[-1] == pytest.approx(MASS * G * EDGE / 2, rel=1e-4)
    # Rows are linear in the turn: a corner that swings down on the floor dips a little.
    assert lowest > -5e-5


@pytest.mark.parametrize("step", [0.001, 0.01])
def test_a_dropped_soft_block_gains_no_energy(scene_of, write_block, step):
    body = soft(write_block, translation=[0, 0, 0.06], rotation=[0.3, 0.4, 0.0])
    simulation = lying(scene_of, 0.5, 1e-8, body=body)
    masses = lumped_masses(simulation.model.bodies[0].mesh, MATERIAL["density"])
    elastic = simulation.model.forces[0]

    def energy(state):
        kinetic = 0.5 * masses @ (state.velocities**2).sum(axis=1)
        return kinetic + G * masses @ state.positions[:, 2] + elastic.energy(state.positions)

    energies = [energy(simulation.state)]
    for _ in range(int(0.4 / step)):
        result = simulation.step(Hold(step))
        energies.append(energy(result.state))
        assert result.state.positions[:, 2].min() > -1e-7
    assert np.diff(energies).max() < 1e-6 * energies[0]
    # It does not return to its initial height: an impact dissipates energy.
    height = masses @ result.state.positions[:, 2] / masses.sum()
    assert height == pytest.approx(0.01, abs=1e-4)


def test_a_cube_with_its_centre_beyond_the_edge_falls_off(scene_of):
    simulation = scene_of(
        integration="dynamic",
        rigid_bodies=[cube("high", position=[0.022, 0, 0.02])],
        obstacles=[{"name": "table", "box": {"centre": [0, 0, -0.02], "size": [EDGE] * 3}}],
        contact={"friction": 0.5, "between": [{"pair": ["high", "table"]}]},
    )  # fmt: skip
    result = repeat_step(simulation, Hold(STEP), 100)
    assert result.state.positions[0, 2] < -0.04
