"""A body's mass: given by density or in all, and spread over its nodes in one of three ways."""

import numpy as np
import pytest

from softrobot_twin.geometry.tet_mesh import TetMesh
from softrobot_twin.simulation import Hold
from test.builder import builder

TOTAL, GRAVITY = 0.5, 9.81
MODELS = ("lumped", "consistent", "uniform")


def material(**weight) -> dict:
    return {"young_modulus": 1e5, "poisson_ratio": 0.0, **weight}


def term(simulation, name):
    return next(term for term in simulation.model.forces if name in term.name)


@pytest.fixture
def graded(block):
    """A slim column along z whose ten layers grow by a fifth each, and their heights [m]."""
    mesh = block(size=(0.02, 0.02, 0.2), cells=(2, 2, 10), shake=0.0)
    heights = np.cumsum(np.append(0.0, 1.2 ** np.arange(10)))
    heights *= 0.2 / heights[-1]
    x = mesh.node_positions.copy()
    x[:, 2] = np.interp(x[:, 2], np.linspace(0.0, 0.2, 11), heights)
    return TetMesh(x, mesh.cells), heights


@builder
def column(simulate, body_of, graded, /, integration="quasi_static", held=True, **entries):
    """Makes the column, of a mass in all, held at its upper end or free."""
    body = body_of(graded[0], **entries)
    body["material"] = entries.get("material", material(total_mass=TOTAL))
    if held:
        body["fixed"] = [{"box": {"minimum": [-1, -1, 0.2 - 1e-9], "maximum": [1, 1, 1]}}]
    return simulate(body=body, integration=integration, gravity=[0, 0, -GRAVITY])


@pytest.mark.sampled
@pytest.mark.parametrize("element", ["linear", "smoothed", "quadratic"])
@pytest.mark.parametrize("model", [None, *MODELS])
@pytest.mark.parametrize("integration", ["quasi_static", "dynamic"])
def test_a_body_has_the_weight_of_its_total_mass_for_any_distribution(column, element, model, integration):
    is_free = integration == "dynamic"
    simulation = column(integration, held=not is_free, element=element, mass=model)
    body = simulation.model.bodies[0]
    assert body.mass == TOTAL
    weights = term(simulation, "gravity").weights
    np.testing.assert_array_equal(weights[:, :2], 0.0)
    if is_free:
        assert weights[:, 2].sum() == pytest.approx(-TOTAL * GRAVITY, rel=1e-12)
    if model == "uniform":
        share = -TOTAL * GRAVITY / body.mesh.node_count
        np.testing.assert_allclose(weights[:, 2], share, rtol=1e-12)


def test_a_total_mass_is_a_density_over_the_volume(column, graded):
    volume = graded[0].volume
    by_mass, by_density = (
        column("dynamic", held=False, material=material(**weight))
        for weight in ({"total_mass": TOTAL}, {"density": TOTAL / volume})
    )
    for name in ("gravity", "inertia"):
        key = "weights" if name == "gravity" else "masses"
        values = [getattr(term(simulation, name), key) for simulation in (by_mass, by_density)]
        np.testing.assert_allclose(*values, rtol=1e-12)


@pytest.mark.parametrize("element", ["linear", "quadratic"])
@pytest.mark.parametrize("model", MODELS)
def test_in_equilibrium_every_node_carries_its_weight_in_the_mass_model(column, element, model):
    simulation = column(element=element, mass=model)
    result = simulation.step(Hold())
    inner = np.zeros((simulation.model.nodes.free_node_count, 3))
    simulation.model.forces[0].add_forces(result.state.positions, inner)
    weights = term(simulation, "gravity").weights
    np.testing.assert_allclose(inner, -weights, atol=1e-8)
    if model == "consistent" and element == "quadratic":
        # Corners of quadratic elements are pulled up by the weight of the shape functions.
        assert weights[:, 2].max() > 0.0


@pytest.mark.parametrize("model", MODELS)
def test_a_hanging_column_extends_by_the_weight_of_its_masses(column, graded, model):
    """By the weight below: m g L / 2EA, or that of equal masses where nodes are crowded."""
    mesh, heights = graded
    simulation = column(mass=model)
    way = simulation.step(Hold()).state.positions[:, 2] - mesh.node_positions[:, 2]
    grown = -way[mesh.node_positions[:, 2] < 1e-9].mean()
    lengths, layers = np.diff(heights), np.arange(1, 11)
    below = layers / 11.0 if model == "uniform" else (heights[1:] + heights[:-1]) / 2.0 / 0.2
    expected = TOTAL * GRAVITY * (below @ lengths) / (1e5 * 0.02**2)
    assert grown == pytest.approx(expected, rel=0.01)
    if model == "uniform":
        assert not 0.8 < grown / (TOTAL * GRAVITY * 0.2 / (2.0 * 1e5 * 0.02**2)) < 1.2


@pytest.mark.parametrize("element", ["linear", "smoothed", "quadratic"])
@pytest.mark.parametrize("model", MODELS)
def test_a_body_falls_undeformed_with_any_mass_model(column, element, model):
    simulation = column("dynamic", held=False, element=element, mass=model)
    x = simulation.state.positions.copy()
    step = 0.01
    for count in range(1, 4):
        state = simulation.step(Hold(step)).state
        x[:, 2] -= GRAVITY * step**2 * count
        np.testing.assert_allclose(state.positions, x, atol=1e-10)
    energy = term(simulation, "inertia").kinetic_energy(state.positions, state.velocities)
    assert energy == pytest.approx(0.5 * TOTAL * (GRAVITY * 3 * step) ** 2, rel=1e-9)


@pytest.mark.parametrize("element, model", [
    ("linear", "lumped"), ("linear", "uniform"), ("linear", "consistent"), ("quadratic", "lumped"),
    ("quadratic", "uniform"),
])  # fmt: skip
def test_drag_by_mass_lets_a_free_body_sink_at_g_over_alpha(column, element, model):
    simulation = column("first_order", held=False, element=element, mass=model,
                        damping={"mass": 4.0})  # fmt: skip
    rest = simulation.state.positions
    for count in range(1, 4):
        state = simulation.step(Hold(0.01)).state
        expected = rest - [0.0, 0.0, GRAVITY / 4.0 * 0.01 * count]
        np.testing.assert_allclose(state.positions, expected, atol=1e-9)
