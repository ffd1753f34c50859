"""Blocks on a slope: they stick below tan θ = µ, and slide as Coulomb's law says above it."""

import numpy as np
import pytest

from softrobot_twin.simulation import Hold
from test.scene_changes import repeat_step, solved

G, FRICTION, EDGE = 9.81, 0.5, 0.04
STEP = 0.002


def on_slope(scene_of, angle, **body):
    """A scene whose plane is level and whose gravity is tilted: the same, and easier to read."""
    return scene_of(
        gravity=[G * np.sin(angle), 0.0, -G * np.cos(angle)], integration="dynamic",
        obstacles=[{"name": "slope", "plane": {}}],
        contact={"friction": FRICTION, "between": [{"pair": ["box", "slope"]}]}, **body
    )  # fmt: skip


def rigid(**more):
    return {"rigid_bodies": [{
        "name": "box", "mass": 0.03, "position": [0, 0, EDGE / 2], "box": {"size": [EDGE] * 3},
        **more,
    }]}  # fmt: skip


def soft(soft_block):
    return {"body": soft_block("box", (0.04, 0.04, 0.02), (4, 4, 2), [0, 0, 0.01], damping={"mass": 0.0})}


def slide(simulation, steps):
    """Way down the slope after each step [m]: of the centre, of soft blocks the mean node."""
    nodes = slice(0, 1) if simulation.model.rigid else slice(None)
    start, way = simulation.state.positions[nodes, 0].mean(), []
    for _ in range(steps):
        result = solved(simulation, Hold(STEP))
        way.append(result.state.positions[nodes, 0].mean() - start)
    return np.array(way), result


def test_a_rigid_block_sticks_two_percent_below_the_limit(scene_of):
    simulation = on_slope(scene_of, np.arctan(0.98 * FRICTION), **rigid())
    way, _ = slide(simulation, 500)
    # Sticking is exact to far below the solver's tolerance, step by step: it must not add up.
    assert np.abs(way).max() < 1e-8
    assert abs(way[-1] - way[249]) < 1e-9


def test_a_rigid_block_slides_two_percent_above_the_limit(scene_of):
    angle = np.arctan(1.02 * FRICTION)
    simulation = on_slope(scene_of, angle, **rigid())
    way, _ = slide(simulation, 500)
    time = STEP * np.arange(1, 501)
    pull = G * (np.sin(angle) - FRICTION * np.cos(angle))
    # Backward Euler goes ½ a t (t + h), which is ½ a t² as h goes to 0.
    np.testing.assert_allclose(way, 0.5 * pull * time * (time + STEP), atol=1e-7)
    assert way[-1] == pytest.approx(0.5 * pull * time[-1] ** 2, rel=2.5e-3)


def test_a_tilted_plane_and_tilted_gravity_give_the_same_slope(scene_of):
    angle = np.arctan(1.1 * FRICTION)
    flat = on_slope(scene_of, angle, **rigid())
    place = [EDGE / 2 * np.sin(angle), 0.0, EDGE / 2 * np.cos(angle)]
    tilted = scene_of(
        gravity=[0.0, 0.0, -G], integration="dynamic",
        obstacles=[{"name": "slope", "rotation": [0, angle, 0], "plane": {}}],
        contact={"friction": FRICTION, "between": [{"pair": ["box", "slope"]}]},
        **rigid(position=place, rotation=[0, angle, 0]),
    )  # fmt: skip
    way, _ = slide(flat, 200)
    repeat_step(tilted, Hold(STEP), 200)
    gone = tilted.state.positions[0] - place
    np.testing.assert_allclose(
        gone, way[-1] * np.array([np.cos(angle), 0.0, -np.sin(angle)]), atol=1e-7
    )


@pytest.mark.parametrize("start", [0.2, -0.2])
def test_a_thrown_block_is_decelerated_in_both_directions(scene_of, start):
    simulation = on_slope(scene_of, 0.0, **rigid(velocity=[start, 0.0, 0.0]))
    way, _ = slide(simulation, 200)
    # It stops after v / µg, at a distance of v² / 2µg.
    expected = start**2 / (2.0 * FRICTION * G) * np.sign(start)
    assert way[-1] == pytest.approx(expected, rel=0.05)
    assert abs(way[-1] - way[100]) < 1e-7


def test_a_soft_block_sticks_two_percent_below_the_limit(scene_of, soft_block):
    simulation = on_slope(scene_of, np.arctan(0.98 * FRICTION), **soft(soft_block))
    way, result = slide(simulation, 500)
    # It shears downhill, and sticks.
    assert abs(way[-1] - way[249]) < 1e-7
    weight = 0.04 * 0.04 * 0.02 * 1000.0 * G
    angle = np.arctan(0.98 * FRICTION)
    expected = weight * np.array([-np.sin(angle), 0.0, np.cos(angle)])
    np.testing.assert_allclose(result.contacts.forces.sum(axis=0), expected, atol=1e-3 * weight)


def test_a_soft_block_slides_as_a_rigid_one(scene_of, soft_block):
    angle = np.arctan(1.2 * FRICTION)
    simulation = on_slope(scene_of, angle, **soft(soft_block))
    way, result = slide(simulation, 500)
    # Its acceleration, once it has stopped swinging on its feet.
    time = STEP * np.arange(1, 501)
    acceleration = 2.0 * np.polyfit(time[150:], way[150:], 2)[0]
    pull = G * (np.sin(angle) - FRICTION * np.cos(angle))
    assert acceleration == pytest.approx(pull, rel=5e-3)
    force = result.contacts.forces
    sliding = np.linalg.norm(force[:, :2], axis=1)
    np.testing.assert_allclose(sliding, FRICTION * force[:, 2], rtol=1e-6)
    # Friction is against the sliding.
    assert np.all(force[:, 0] < 0.0)
