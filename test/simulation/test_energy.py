"""Without input, energy is only lost: backward Euler damps, and creates nothing."""

from dataclasses import replace

import numpy as np
import pytest

from softrobot_twin.simulation import Hold
from test.scene_changes import solved


def let_go(simulation, positions, velocities=None):
    """Start from given positions."""
    if velocities is None:
        velocities = np.zeros_like(simulation.state.velocities)
    simulation.restore(replace(simulation.state, positions=positions, velocities=velocities))


def totals(simulation, energies, time_step, count):
    """Total energy before and after each step [J], and the largest share that moves [J]."""
    stored, moving = energies(simulation)
    found, fastest = [stored + moving], moving
    for _ in range(count):
        solved(simulation, Hold(time_step))
        stored, moving = energies(simulation)
        found.append(stored + moving)
        fastest = max(fastest, moving)
    return np.array(found), fastest


def bent(rest):
    """A shape that hangs over, and is stretched."""
    along = rest[:, 2] / rest[:, 2].max()
    return rest + np.stack([0.02 * along**2, 0.01 * along**2, 0.01 * along], axis=1)


HELD = [{"box": {"minimum": [-1, -1, -1e-6], "maximum": [1, 1, 1e-6]}}]


@pytest.mark.parametrize("time_step", [0.0005, 0.005, 0.1])
@pytest.mark.parametrize("held", [True, False])
def test_energy_of_a_soft_body_never_grows(simulate, body_of, block, energies, held, time_step):
    mesh = block(size=(0.03, 0.03, 0.1), cells=(1, 1, 4))
    body = body_of(mesh, fixed=HELD if held else [])
    # A free body would fall without end: it is tested without gravity.
    scene = simulate(body=body, integration="dynamic", gravity=[0.0, 0.0, -9.81 if held else 0.0])
    let_go(scene, bent(scene.model.nodes.rest_positions) if not held else _held_bent(scene))
    found, fastest = totals(scene, energies, time_step, 60)
    start = found[0] - found.min()
    assert np.diff(found).max() <= 1e-9 * start
    assert found[-1] < found[0] - 0.05 * start
    if time_step < 0.001:
        assert fastest > 0.2 * start


def _held_bent(scene):
    rest = scene.model.nodes.rest_positions
    positions = rest.copy()
    free = scene.model.nodes.free_nodes
    positions[free] = bent(rest)[free]
    return positions


@pytest.mark.parametrize(
    "element, mass, law",
    [("quadratic", "consistent", "corotational"), ("quadratic", "lumped", "corotational"),
     ("linear", "consistent", "corotational"), ("linear", "lumped", "linear")],
)  # fmt: skip
def test_energy_never_grows_whatever_the_element(simulate, body_of, block, energies, element, mass, law):
    mesh = block(size=(0.03, 0.03, 0.1), cells=(1, 1, 3))
    body = body_of(mesh, fixed=HELD, element=element, mass=mass)
    body["material"]["law"] = law
    scene = simulate(body=body, integration="dynamic")
    let_go(scene, _held_bent(scene))
    found, _ = totals(scene, energies, 0.004, 40)
    assert np.diff(found).max() <= 1e-9 * (found[0] - found.min())


@pytest.mark.sampled
@pytest.mark.parametrize("element", ["linear", "smoothed", "quadratic"])
@pytest.mark.parametrize("damping", [{"stiffness": 0.01}, {"mass": 10.0}])
def test_damping_dissipates_energy_and_adds_none(simulate, body_of, block, energies, element, damping):
    """Of a free body too, which is strained and turns."""
    left = []
    for braked in ({}, damping):
        body = body_of(block(size=(0.03, 0.03, 0.1), cells=(1, 1, 3)), element=element,
                       damping=braked)  # fmt: skip
        scene = simulate(body=body, integration="dynamic", gravity=[0, 0, 0])
        rest = scene.model.nodes.rest_positions
        let_go(scene, bent(rest), np.cross([3.0, 5.0, 2.0], rest))
        found, _ = totals(scene, energies, 0.001, 60)
        assert np.diff(found).max() <= 1e-9 * found[0]
        left.append(found[-1] / found[0])
    assert left[1] < 0.95 * left[0]
