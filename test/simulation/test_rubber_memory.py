"""Scenes of viscous and softening materials: creep, states, and what is refused."""

from dataclasses import fields

import numpy as np
import pytest

from softrobot_twin.mechanics.laws import law_named
from softrobot_twin.simulation import Hold
from test.builder import builder

SHARE, TIME = 0.3, 0.5
VISCOSITY = [{"share": SHARE, "time": TIME}]
SOFTENING = {"r": 1.5, "m": 30.0, "beta": 0.1}
RUBBER = {"law": "neo_hookean", "young_modulus": 2e5, "poisson_ratio": 0.49, "density": 1000.0}


@builder
def bar(simulate, write_block, /, material=None, integration="quasi_static", element="linear",
        gravity=-9.81, **entries):  # fmt: skip
    """Makes a bar that is held at one end."""
    return simulate(
        integration=integration, gravity=[0.0, 0.0, gravity],
        body={
            "name": "bar", "mesh": {"file": write_block((0.06, 0.01, 0.01), (3, 1, 1))},
            "element": element, "material": RUBBER | (material or {}),
            "fixed": [{"box": {"minimum": [-1, -1, -1], "maximum": [-0.029, 1, 1]}}],
        }, **entries,
    )  # fmt: skip


def sag(simulation):
    moved = simulation.state.positions - simulation.model.nodes.rest_positions
    return -moved[:, 2].min()


def test_a_bar_creeps_under_its_weight_in_quasi_static_integration(bar):
    # Little weight: small strain. Without time the bar has its modulus at once.
    simulation = bar({"viscosity": VISCOSITY}, gravity=-0.5)
    simulation.step(Hold(0.0))
    sags, times = [sag(simulation)], np.append(0.0, np.linspace(0.05, 2.0, 40))
    for _ in times[1:]:
        simulation.step(Hold(0.05))
        sags.append(sag(simulation))
    simulation.step(Hold(1e6))
    own = law_named("neo_hookean").of_moduli(RUBBER["young_modulus"], RUBBER["poisson_ratio"])
    mu, kappa = own.shear_modulus / (1.0 - SHARE), own.bulk_modulus
    plain, fast = bar(gravity=-0.5), bar({
        "young_modulus": 9.0 * kappa * mu / (3.0 * kappa + mu),
        "poisson_ratio": 0.5 * (3.0 * kappa - 2.0 * mu) / (3.0 * kappa + mu),
    }, gravity=-0.5)  # fmt: skip
    plain.step(Hold(0.0))
    fast.step(Hold(0.0))
    assert sag(simulation) == pytest.approx(sag(plain), rel=1e-6)
    assert sags[0] == pytest.approx(sag(fast), rel=1e-4)
    # A standard linear solid creeps more slowly than it relaxes; shares of the volume differ.
    begin = sag(fast) / sag(plain)
    expected = 1.0 - (1.0 - begin) * np.exp(-times * begin / TIME)
    np.testing.assert_allclose(np.array(sags) / sag(plain), expected, atol=0.01)


def remembered(state):
    """All values that materials remember."""
    return np.concatenate([array.ravel() for array in state.memory.values()])


@pytest.mark.parametrize("integration", ["quasi_static", "dynamic"])
def test_a_restored_state_goes_on_to_the_bit_and_a_reset_is_new_material(bar, integration):
    simulation = bar({"viscosity": VISCOSITY, "softening": SOFTENING}, integration)
    start = simulation.state

    def run(count):
        return [simulation.step(Hold(step)).state for step in [0.02, 0.05, 0.01][:count]]

    run(3)
    middle = simulation.state
    assert len(remembered(middle)) and remembered(middle).any() and not remembered(start).any()
    ahead = run(3)
    simulation.restore(middle)
    for found, expected in zip(run(3), ahead, strict=True):
        np.testing.assert_array_equal(found.positions, expected.positions)
        np.testing.assert_array_equal(remembered(found), remembered(expected))
    simulation.reset()
    assert not remembered(simulation.state).any()
    np.testing.assert_array_equal(run(3)[-1].positions, middle.positions)


def test_a_viscous_bar_stops_swinging_and_settles_where_the_law_alone_holds_it(bar):
    swung = {}
    for name, material in (("plain", {}), ("viscous", {"viscosity": VISCOSITY})):
        simulation = bar(material, "dynamic", time_scheme="backward_euler")
        sags = []
        for _ in range(60):
            simulation.step(Hold(0.01))
            sags.append(sag(simulation))
        simulation.step(Hold(1e4))
        simulation.step(Hold(1e4))
        swung[name] = (max(sags), sag(simulation))
    assert swung["viscous"][0] < 0.95 * swung["plain"][0]
    assert swung["viscous"][1] == pytest.approx(swung["plain"][1], rel=1e-4)


def test_a_softened_bar_sags_further_when_it_is_loaded_again(bar):
    simulation = bar({"softening": SOFTENING})
    simulation.step(Hold())
    first = sag(simulation)
    simulation.step(Hold())
    # Held at the same load, it stays on the curve of new material.
    assert sag(simulation) == pytest.approx(first, rel=1e-6)
    lighter = bar({"softening": SOFTENING}, gravity=-4.9)
    lighter.step(Hold())
    softened = lighter.state.positions
    lighter.restore(type(lighter.state)(
        **{field.name: getattr(lighter.state, field.name) for field in fields(lighter.state)}
        | {"memory": simulation.state.memory}
    ))  # fmt: skip
    lighter.step(Hold())
    assert -lighter.state.positions[:, 2].min() > -softened[:, 2].min() + 1e-5


def test_a_part_may_be_viscous_alone_or_be_left_out(simulate, write_block):
    half = {"minimum": [-1, -1, -1], "maximum": [0, 1, 1]}
    for own, part, count in (([], VISCOSITY, 1), (VISCOSITY, [], 1), (VISCOSITY, None, 2)):
        other = {} if part is None else {"viscosity": part}
        simulation = simulate(body={
            "name": "bar", "mesh": {"file": write_block((0.06, 0.01, 0.01), (2, 1, 1))},
            "element": "linear", "material": RUBBER | {"viscosity": own},
            "materials": [{"box": half, "young_modulus": 1e5, **other}],
            "fixed": [{"box": {"minimum": [-1, -1, -1], "maximum": [-0.029, 1, 1]}}],
        })  # fmt: skip
        assert len(simulation.parts) == count
