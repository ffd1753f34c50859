"""Bodies with `volume: patches`: what is built, refused and told, and rubber that does not lock."""

from dataclasses import replace

import numpy as np
import pytest

from softrobot_twin.mechanics.inertia import lumped_masses
from softrobot_twin.mechanics.material import INCOMPRESSIBLE
from softrobot_twin.mechanics.patch_volumes import PatchVolumes
from softrobot_twin.simulation import Hold
from test.builder import builder
from test.scene_changes import in_balance, solved

SIZE = (0.06, 0.01, 0.01)


@builder
def bar(simulate, body_of, block, /, poisson=0.4999, element="linear", law="neo_hookean", body=(),
        **entries):  # fmt: skip
    """Makes a bar that is clamped at one end and bends under its weight."""
    foot = [{"box": {"minimum": [-1, -1, -1], "maximum": [1e-6, 1, 1]}}]
    mesh = block(SIZE, (12, 2, 2), 0.0)
    made = body_of(mesh, "bar", 1e5, poisson, element=element, fixed=foot, **dict(body))
    made["material"]["law"] = law
    entries = {"gravity": [0.0, 0.0, -9.81], "solver": {"newton_iterations": 20}, **entries}
    return simulate(body=made, **entries)


def sag(simulation):
    """From rest at once: Newton's method follows the valley of constant volume in a few steps."""
    result = in_balance(simulation, Hold(), 10)
    rest = simulation.model.nodes.rest_positions
    end = rest[:, 0] > SIZE[0] - 1e-9
    return -float((result.state.positions - rest)[end, 2].mean())


def test_a_body_without_much_bulk_modulus_needs_no_patches(bar):
    terms = bar(poisson=0.1, element="quadratic", body={"volume": "patches"}).model.forces
    assert not any(isinstance(term, PatchVolumes) for term in terms)


def test_incompressible_rubber_sags_as_a_nearly_incompressible_one(bar):
    patches = {"volume": "patches"}
    reference = sag(bar(0.49, "quadratic", body=patches))
    for poisson in (0.4999, 0.5):
        assert sag(bar(poisson, "quadratic", body=patches)) == pytest.approx(reference, rel=0.03)
        assert sag(bar(poisson, body=patches)) > 0.55 * reference
        assert sag(bar(poisson)) < 0.25 * reference


def test_volume_patches_hold_the_volume_of_the_body(bar):
    simulation = bar(0.5, body={"volume": "patches"})
    assert sag(simulation) > 1e-3
    (term,) = [t for t in simulation.model.forces if isinstance(t, PatchVolumes)]
    pressures = np.abs(term.pressures(simulation.state.positions)).max()
    error = np.abs(term.volume_ratios(simulation.state.positions) - 1.0).max()
    shear = 1e5 / 3.0
    assert 0.0 < error < 1.01 * pressures / (INCOMPRESSIBLE * shear) + 1e-12 < 1e-4


def test_a_scene_tells_what_incompressible_means_and_warns_of_locking(bar):
    (told,) = [note for note in bar(0.5, body={"volume": "patches"}).model.notes if "0.5" in note]
    assert "incompressible" in told and "3.33e+08 Pa" in told
    (warned,) = [note for note in bar(0.48).model.notes if "lock" in note]
    assert "body.material.poisson_ratio = 0.48" in warned and "volume: patches" in warned
    for quiet in (bar(0.46), bar(0.48, body={"volume": "patches"}), bar(0.48, "quadratic")):
        assert not any("lock" in note for note in quiet.model.notes)


def test_a_thrown_block_with_patches_keeps_its_momentum(simulate, body_of, block):
    mesh = block((0.02, 0.02, 0.02), (2, 2, 2), 0.2)
    body = body_of(mesh, "cube", 1e5, 0.4999, volume="patches")
    body["material"]["law"] = "neo_hookean"
    simulation = simulate(
        gravity=[0.0, 0.0, 0.0], integration="dynamic", body=body,
        solver={"newton_iterations": 20, "residual_tolerance": 1e-9},
    )  # fmt: skip
    rest = simulation.model.nodes.rest_positions
    pushed = np.random.default_rng(5).uniform(-1.0, 1.0, rest.shape) + [0.5, 0.2, 0.1]
    simulation.restore(replace(simulation.state, velocities=pushed))
    masses = lumped_masses(mesh, 1000.0)
    before = masses @ pushed
    for _ in range(10):
        result = solved(simulation, Hold(1e-3))
        np.testing.assert_allclose(masses @ result.state.velocities, before, rtol=1e-6)


def test_patches_leave_the_bulk_viscosity_to_elements(simulate, body_of, block):
    """A damped block of incompressible rubber, dropped, comes to the sag of an undamped one."""

    def make(damping, integration):
        foot = [{"box": {"minimum": [-1, -1, -1], "maximum": [1, 1, 1e-6]}}]
        body = body_of(block((0.02, 0.02, 0.02), (2, 2, 2), 0.0), "cube", 2e4, 0.5, fixed=foot,
                       volume="patches", damping=damping)  # fmt: skip
        body["material"]["law"] = "neo_hookean"
        return simulate(gravity=[0.0, 0.0, -9.81], integration=integration, body=body,
                        solver={"newton_iterations": 20})  # fmt: skip

    still, damped = make({}, "quasi_static"), make({"stiffness": 0.05}, "dynamic")
    for _ in range(5):
        at_rest = still.step(Hold()).state.positions
    for _ in range(40):
        reached = damped.step(Hold(0.02)).state.positions
    rest = still.model.nodes.rest_positions
    assert np.abs(at_rest - rest).max() > 1e-4
    np.testing.assert_allclose(reached, at_rest, atol=0.01 * np.abs(at_rest - rest).max())
